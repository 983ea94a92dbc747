"""From a dictionary's specification to its terms, and from terms to columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import comb
from os.path import isdir, isfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import oscillator, polynomial
from bayeq.dictionary.family import Variables
from bayeq.errors import ExpressionError, FileFormatError, InputError, UnknownNameError
from bayeq.expressions import Evaluator, Expression, parse
from bayeq.expressions.functions import FUNCTIONS
from bayeq.records.io import near_files

__all__ = ["FAMILIES", "MAX_TERMS", "build_dictionary", "evaluate_terms", "read_terms"]

# A family is a module with terms(variables, argument) -> list of term texts; the argument follows a colon.
FAMILIES = {"oscillator": oscillator.terms, "polynomial": polynomial.terms}

MAX_TERMS = 20_000
MAX_DEGREE = 20
MAX_FILE_BYTES = 1_000_000
MAX_PATH = 250

Floats = NDArray[np.float64]


def build_dictionary(specification: str | Sequence[str], variables: Variables) -> tuple[Expression, ...]:
    """Candidate terms.

    Parameters
    ----------
    specification : str or sequence of str
        ``oscillator`` (eq. (31)), ``polynomial:3``, a file with one term per line (``#`` starts a comment), terms
        separated by commas, or a list of terms.
    variables : Variables
        States and inputs that the terms may use.

    Raises
    ------
    InputError
        Neither a family, nor a file, nor terms; a malformed or forbidden term; a term given twice; no terms.

    Examples
    --------
    >>> len(build_dictionary("oscillator", Variables(("x", "v"), ("u",))))
    36
    >>> [t.text for t in build_dictionary("x, v, sign( v )", Variables(("x", "v")))]
    ['x', 'v', 'sign(v)']
    """
    if not isinstance(specification, str):
        return _parse_terms([(str(text), f"term {k + 1}") for k, text in enumerate(specification)], variables)
    name, colon, argument = specification.partition(":")
    if name in FAMILIES:
        texts = _family_terms(name, argument if colon else None, variables)
        return _parse_terms([(text, f"dictionary {specification!r}") for text in texts], variables)
    if isfile(specification):
        found = read_terms(specification)
        if not found:
            raise FileFormatError(f"{specification}: no terms in the file; write one per line")
        return _parse_terms(found, variables)
    texts = _split_at_commas(specification)
    if len(texts) > 1:
        return _parse_terms([(text, f"dictionary, term {k + 1}") for k, text in enumerate(texts)], variables)
    try:
        return _parse_terms([(specification, "dictionary")], variables)
    except InputError as error:
        raise _not_a_dictionary(specification.strip(), variables, error) from None


def _split_at_commas(text: str) -> list[str]:
    """The parts between the commas outside of brackets.

    Examples
    --------
    >>> _split_at_commas("x, sin(x, v)")
    ['x', 'sin(x, v)']
    """
    parts, depth = [""], 0
    for c in text:
        depth += (c == "(") - (c == ")")
        if c == "," and depth <= 0:
            parts.append("")
        else:
            parts[-1] += c
    return [part.strip() for part in parts]


def _not_a_dictionary(text: str, variables: Variables, error: InputError) -> InputError:
    """What is wrong with a specification that is no term: what it looks like decides."""
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
    return error


def read_terms(path: str | Path) -> list[tuple[str, str]]:
    """Terms of a file, one per line, each with the place it stands at; ``#`` starts a comment.

    Raises
    ------
    FileFormatError
        A file that is missing, too large or not text.
    """
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
    if argument is None:
        return FAMILIES[name](variables, None)
    if not (argument.isascii() and argument.isdigit() and len(argument) < 4 and 1 <= int(argument) <= MAX_DEGREE):
        raise InputError(
            f"dictionary '{name}:{argument[:40]}': the degree after the colon must be a whole number from 1 to"
            f" {MAX_DEGREE}, as in {name}:3"
        )
    count = comb(len(variables.states) + int(argument), int(argument))
    if count > MAX_TERMS:
        raise InputError(
            f"dictionary '{name}:{argument}' of {len(variables.states)} states would have {count} terms, more than"
            f" {MAX_TERMS}; lower the degree or list the terms"
        )
    return FAMILIES[name](variables, argument)


def _parse_terms(texts: Sequence[tuple[str, str]], variables: Variables) -> tuple[Expression, ...]:
    if not texts:
        raise InputError("the dictionary has no terms; give at least one")
    if len(texts) > MAX_TERMS:
        raise InputError(f"the dictionary has {len(texts)} terms; at most {MAX_TERMS} are allowed")
    terms: dict[Expression, str] = {}
    for text, where in texts:
        if not text.strip():
            raise ExpressionError(f"{where}: empty; write a term there, or leave out the comma before or after")
        try:
            term = parse(text, variables.known)
        except UnknownNameError as error:
            raise InputError(f"{where}: {error}") from error
        except ExpressionError as error:
            raise ExpressionError(f"{where}: {error}") from error
        if term in terms:
            raise InputError(f"{where}: term {term.text!r} was already given ({terms[term]})")
        terms[term] = where
    return tuple(terms)


def evaluate_terms(terms: Sequence[Expression], columns: Mapping[str, Floats]) -> Floats:
    """Columns of the dictionary at all samples, (n, P), in Fortran order."""
    n = len(next(iter(columns.values())))
    out = np.empty((len(terms), n))
    evaluate = Evaluator(columns)
    for row, term in zip(out, terms, strict=True):
        row[:] = evaluate(term)
    return out.T
