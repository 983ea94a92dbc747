"""From a dictionary's specification to its terms, and from terms to columns."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from os.path import isdir, isfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import families
from bayeq.dictionary.ranges import with_ranges
from bayeq.dictionary.specification import Member, Specification, Variables, members, of_equations, split_at, written
from bayeq.errors import ExpressionError, FileFormatError, InputError, UnknownNameError, require_kind
from bayeq.expressions import Binary, Evaluator, Expression, Negate, Node, Unknown, parse
from bayeq.expressions.functions import CONSTANTS, FUNCTIONS, TIME
from bayeq.expressions.implicit import MOST_COUPLED, multiplied
from bayeq.expressions.nodes import arguments_of, nodes_of
from bayeq.expressions.parse import EARLIER
from bayeq.plugins import Table
from bayeq.records.io import near_files


class Family(NamedTuple):
    """A family of terms, a row of `FAMILIES`."""

    terms: Callable[[Variables, str | None], list[str]]  # texts of terms, from variables and text after the colon
    argument: str = ""  # meaning of the number after the colon; empty if the family takes none
    by_equation: bool = False  # whether each equation has terms of its own


_OWN = {
    "oscillator": Family(families.oscillator, "degree"),
    "polynomial": Family(families.polynomial, "degree"),
    "fourier": Family(families.fourier, "number of harmonics"),
    "neighbours": Family(families.neighbours, by_equation=True),
}
FAMILIES = Table("families", Family, _OWN)

MAX_TERMS = 20_000
MAX_ARGUMENT = 20
MAX_FILE_BYTES = 1_000_000
MAX_PATH = 250

# Constants inside one term, at most: they are sought on a grid.
MOST_UNKNOWN = 3


def build_dictionary(specification: str | Sequence[str], variables: Variables) -> tuple[Expression, ...]:
    """Candidate terms in the variables, from a specification as in docs/terms.md or a list of such.

    InputError: neither a family, nor a file, nor terms; a malformed or forbidden term; a term given twice; no terms.

    >>> len(build_dictionary("oscillator", Variables(("x", "v"), ("u",))))
    36
    >>> [t.text for t in build_dictionary("x, v, sign( v )", Variables(("x", "v")))]
    ['x', 'v', 'sign(v)']
    >>> [t.text for t in build_dictionary("polynomial:2 + abs(v) - x*v", Variables(("x", "v")))]
    ['x', 'v', 'x**2', 'v**2', 'abs(v)']
    """
    _require_families(specification, variables)
    text = isinstance(specification, str)
    texts = split_at(specification) if isinstance(specification, str) else [str(one) for one in specification]
    union = members(texts, FAMILIES.keys())
    if union is not None:
        return _union(union, f"dictionary {written(specification)[:60]!r}", variables)
    if isinstance(specification, str) and isfile(specification):
        found = read_terms(specification)
        if not found:
            raise FileFormatError(f"{specification}: no terms in the file; write one per line")
        return _parse_terms(found, variables)
    if not text or len(texts) > 1:
        label = "dictionary, term" if text else "term"
        return _parse_terms([(one, f"{label} {k + 1}") for k, one in enumerate(texts)], variables)
    try:
        return _parse_terms([(texts[0], "dictionary")], variables)
    except InputError as error:
        raise _not_a_dictionary(texts[0], variables, error) from None


def build_dictionaries(
    specification: Specification, targets: Sequence[str], variables: Variables
) -> tuple[tuple[Expression, ...], Bools]:
    """Candidate terms of several equations: the P terms of all together, and (C, P) which of them each may have.

    The specification is the same for every equation, or one for each by its target; chains of the variables are in the
    order of the C targets. InputError: as `build_dictionary`; a target that is not there, or that has no dictionary.
    """
    require_kind(specification, Iterable, "dictionary", "text, a list of terms, or a mapping of these")
    given = of_equations(specification, targets)
    _require_families(specification, variables)
    words = re.findall(r"\w+", written(specification))
    if given is None and not any(FAMILIES[word].by_equation for word in words if word in FAMILIES):
        assert not isinstance(specification, Mapping)
        terms = build_dictionary(specification, variables)
        return terms, _apart(terms, targets, np.ones((len(targets), len(terms)), dtype=np.bool_))
    own = []
    for k, target in enumerate(targets):
        one = given[target] if given is not None else specification
        assert not isinstance(one, Mapping)
        try:
            own.append(build_dictionary(one, replace(variables, own=k)))
        except InputError as error:
            if given is None:
                raise
            raise InputError(f"equation {target}: {error}") from error
    whole = tuple(dict.fromkeys(with_ranges([term for terms in own for term in terms])))
    choices = {term.text: term.choice for term in whole}
    for target, terms in zip(targets, own, strict=True):
        for term in terms:
            if term.choice != choices[term.text]:
                raise InputError(
                    f"equation {target}: {term.text} stands in {term.choice or 'no either-or'} here, and in"
                    f" {choices[term.text] or 'none'} in another equation: write the same in both"
                )
    texts = [{term.text for term in terms} for terms in own]
    allowed = np.array([[term.text in one for term in whole] for one in texts], dtype=np.bool_)
    return whole, _apart(whole, targets, allowed)


def _apart(terms: Sequence[Expression], targets: Sequence[str], allowed: Bools) -> Bools:
    """`allowed` (C, P) without terms in an equation's own target; InputError for a term left to no equation."""
    out = allowed.copy()
    for j, term in enumerate(terms):
        try:
            part = multiplied(term, targets)
        except ValueError as error:
            raise InputError(f"term {error}: a highest derivative may only be a factor of a term") from None
        if part is not None:
            out[part[0], j] = False
            if len(targets) > MOST_COUPLED:
                raise InputError(
                    f"term {term.text}: highest derivatives are solved for in at most {MOST_COUPLED} equations"
                )
            if not out[:, j].any():
                target = targets[part[0]]
                raise InputError(
                    f"term {term.text}: {target} would stand on both sides of its equation; for a law with a"
                    " denominator write a constant inside a term, as in x/({K} + x)"
                )
    return out


def _require_families(specification: Specification, variables: Variables) -> None:
    """Load the families of other packages if a word of the specification has no known meaning."""
    known = {*FAMILIES, *variables.known, *FUNCTIONS, *CONSTANTS}
    if not known.issuperset(re.findall(r"[^\W\d]\w*", written(specification))):
        FAMILIES.load()


def _union(union: Sequence[Member], where: str, variables: Variables) -> tuple[Expression, ...]:
    """The terms of a union of families and terms, without those left out."""
    terms: dict[Expression, None] = {}
    gone: list[tuple[str, tuple[Expression, ...]]] = []
    for member in union:
        name, colon, argument = member.text.partition(":")
        texts = [member.text]
        if name.strip() in FAMILIES:
            texts = _family_terms(name.strip(), argument.strip() if colon else None, variables)
        found = _parse_terms([(text, where) for text in texts], variables)
        if member.left_out:
            gone.append((member.text, found))
            continue
        for term in found:
            if term.choice:
                terms.pop(term, None)  # a term of a family becomes a member of the either-or
            terms.setdefault(term)
    for text, found in gone:
        if not any(term in terms for term in found):
            near = UnknownNameError("term", text, [term.text for term in terms], where)
            raise InputError(f"{near}: there is nothing to leave out")
    left_out = {term for _, found in gone for term in found}
    kept = tuple(dict.fromkeys(with_ranges([term for term in terms if term not in left_out])))
    if not kept:
        raise InputError(f"{where}: no terms are left")
    if len(kept) > MAX_TERMS:
        raise InputError(f"{where}: {len(kept)} terms; at most {MAX_TERMS} are allowed")
    return kept


def _not_a_dictionary(text: str, variables: Variables, error: InputError) -> InputError:
    """The error for a specification that is no term, by what it resembles: a family, a file, a misspelt name."""
    if re.fullmatch(r"(?:[^\W\d]\w*)?(?::.*)?", text) and text not in FUNCTIONS:
        ways = [*FAMILIES, "polynomial:3", "a file (one term per line)", f"terms of {', '.join(variables.names)}"]
        return UnknownNameError("dictionary", text[:60], ways)
    if len(text) < MAX_PATH and isdir(text):
        return FileFormatError(f"{text}: is a directory; name a file of terms, one per line")
    if len(text) < MAX_PATH and re.fullmatch(r"[\w./~ -]*[./][\w./~ -]*", text):
        reason = str(error).removeprefix("dictionary: ")
        return FileFormatError(
            f"no such file of terms: {text!r}{near_files(Path(text))}; and it is not a term either ({reason})"
        )
    for word in re.findall(r"[^\W\d]\w*", text):
        near = difflib.get_close_matches(word, FAMILIES, n=1, cutoff=0.8)
        if near and word not in variables.known:
            return InputError(f"dictionary: no channel named {word!r}; did you mean the dictionary {near[0]!r}?")
    return error


def read_terms(path: str | Path) -> list[tuple[str, str]]:
    """Terms of a file, one per line, each with its file and line; ``#`` starts a comment."""
    path = Path(path)
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise FileFormatError(f"{path}: larger than {MAX_FILE_BYTES} bytes; expected one term per line")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FileFormatError(f"{path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: not a text file; expected one term per line") from error
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return [(line, f"{path}, line {number}") for number, line in enumerate(lines, 1) if line]


def _family_terms(name: str, argument: str | None, variables: Variables) -> list[str]:
    family = FAMILIES[name]
    if argument is None:
        return family.terms(variables, None)
    if not family.argument:
        raise InputError(f"dictionary '{name}:{argument[:40]}': {name} takes nothing after a colon")
    if not (argument.isascii() and argument.isdigit() and len(argument) < 4 and 1 <= int(argument) <= MAX_ARGUMENT):
        raise InputError(
            f"dictionary '{name}:{argument[:40]}': the {family.argument} after the colon must be a whole number from 1"
            f" to {MAX_ARGUMENT}, as in {name}:3"
        )
    count = families.count(len(variables.states), int(argument)) if family.argument == "degree" else 0
    if count > MAX_TERMS:
        raise InputError(
            f"dictionary '{name}:{argument}' of {len(variables.states)} states would have {count} terms, more than"
            f" {MAX_TERMS}; lower the degree or list the terms"
        )
    return family.terms(variables, argument)


def _parse_terms(texts: Sequence[tuple[str, str]], variables: Variables) -> tuple[Expression, ...]:
    if not texts:
        raise InputError("the dictionary has no terms; give at least one")
    if len(texts) > MAX_TERMS:
        raise InputError(f"the dictionary has {len(texts)} terms; at most {MAX_TERMS} are allowed")
    terms: dict[str, Expression] = {}
    places: dict[str, str] = {}
    for text, where in texts:
        if not text.strip():
            raise ExpressionError(f"{where}: empty; write a term there, or leave out the comma before or after")
        members = [_parsed(one, where, variables) for one in split_at(text, "|")]
        choice = " | ".join(term.text for term in members) if len(members) > 1 else ""
        for k, term in enumerate(members):
            if term in members[:k]:
                raise InputError(f"{where}: {term.text!r} stands on both sides of '|': write different terms")
            if term.text in terms:
                raise InputError(f"{where}: term {term.text!r} was already given ({places[term.text]})")
        for term in members:
            terms[term.text], places[term.text] = Expression(term.tree, choice), where
    return with_ranges(tuple(terms.values()))


def _parsed(text: str, where: str, variables: Variables) -> Expression:
    if not text:
        raise ExpressionError(f"{where}: a term is missing beside '|', which stands between terms of which one is in")
    earlier = [found[0] for found in EARLIER.finditer(text) if found["name"] in variables.names]
    try:
        term = parse(text, (*variables.known, *earlier) if variables.discrete else variables.known)
    except UnknownNameError as error:
        if EARLIER.fullmatch(error.name) and not variables.discrete:
            raise InputError(
                f"{where}: {error.name} is an earlier sample: only maps have these, discrete=True (--discrete)"
            ) from error
        unknown = "" if "(" not in text else f"; an unknown constant is written {{{error.name}}}"
        raise InputError(f"{where}: {error}{unknown}") from error
    except ExpressionError as error:
        raise ExpressionError(f"{where}: {error}") from error
    _require_inside(term, where, variables)
    return term


def _require_inside(term: Expression, where: str, variables: Variables) -> None:
    """Refuse unknown constants that are coefficients, that have the name of something else, or too many of them."""
    if not term.unknowns:
        return
    if len(term.unknowns) > MOST_UNKNOWN:
        raise InputError(f"{where}: {term.text} has {len(term.unknowns)} unknown constants; at most {MOST_UNKNOWN}")
    for name in term.unknowns:
        if name in (*variables.names, TIME) or name in FUNCTIONS or name in CONSTANTS:
            what = "a channel" if name in variables.names else "the time" if name == TIME else "a name with a meaning"
            raise InputError(
                f"{where}: {name} is {what}; braces are for unknown constants: leave them out, or write another name"
            )
    outside = [node.name for node in factors_of(term.tree) if isinstance(node, Unknown)]
    if outside:
        raise InputError(f"{where}: {outside[0]} multiplies {term.text}: it is its coefficient; leave it out")
    if not term.names:
        raise InputError(f"{where}: {term.text} is a constant; every equation has one beside its terms")
    for factor in factors_of(term.tree):
        sums = arguments_of(factor) if isinstance(factor, Binary) and factor.op in "+-" else ()
        if any(isinstance(one, Unknown) for part in sums for one in factors_of(part)):
            raise InputError(f"{where}: write the parts of {term.text} as two terms, without {{}}")
    for node in nodes_of(term.tree):
        together = [one.name for one in factors_of(node) if isinstance(one, Unknown)]
        if len(together) > 1:
            raise InputError(
                f"{where}: {' and '.join(together)} of {term.text} stand for one constant, their product: leave one out"
            )


def factors_of(node: Node) -> Iterator[Node]:
    """The factors of a term, numbers included; of its divisors, unknown constants alone."""
    match node:
        case Negate(operand):
            yield from factors_of(operand)
        case Binary("*", left, right):
            yield from factors_of(left)
            yield from factors_of(right)
        case Binary("/", left, right):
            yield from factors_of(left)
            if isinstance(right, Unknown):
                yield right
        case _:
            yield node


def evaluate_terms(terms: Sequence[Expression], columns: Mapping[str, Floats]) -> Floats:
    """Columns of the dictionary at all samples, (n, P), in Fortran order."""
    n = len(next(iter(columns.values())))
    out = np.empty((len(terms), n))
    evaluate = Evaluator(columns)
    for row, term in zip(out, terms, strict=True):
        row[:] = evaluate(term)
    return out.T


def slopes_of(term: Expression, states: Sequence[str]) -> Floats | None:
    """Slopes (S,) of a term that is affine in S states, with constant slopes; None for any other term."""
    if not term.names & set(states):
        return None
    rng, size = np.random.default_rng(0), len(states)
    points = np.vstack([np.zeros(size), np.eye(size), rng.standard_normal((8, size))])
    columns = {name: rng.standard_normal(len(points)) for name in sorted(term.names - set(states))}
    moved, at_zero = ({**columns, **dict(zip(states, part.T, strict=True))} for part in (points, 0.0 * points))
    with np.errstate(all="ignore"):
        values = (evaluate_terms([term], moved) - evaluate_terms([term], at_zero))[:, 0]
    slope = values[1 : size + 1]
    same = np.allclose(points @ slope, values, rtol=1e-9, atol=1e-9 * float(np.abs(slope).max(initial=0.0)))
    return np.asarray(slope) if same and np.isfinite(values).all() else None
