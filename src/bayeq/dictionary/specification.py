"""Syntax of dictionaries: families and terms, joined by + and left out by -, for all equations or one each."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions.functions import TIME

# A family, a file, terms or unions of them; or one of these by the target of each equation.
Specification: TypeAlias = str | Sequence[str] | Mapping[str, str | Sequence[str]]

# Text in front of a sign that belongs to a number or an operand, and does not divide a union.
_OPERATOR = re.compile(r"(?:^|[-+*/^(,<>=:|]|(?:^|[^\w.])[0-9.]+[eE])$")


class Member(NamedTuple):
    """A family or a term of a dictionary, or one to leave out."""

    text: str
    left_out: bool


def members(texts: Sequence[str], families: Set[str]) -> list[Member] | None:
    """Families and terms of a union; None where there is no family, and each text is a term.

    A text is divided at its + and - outside of brackets if one of the parts is a family, or if others have one and it
    begins with -.

    >>> [(m.text, m.left_out) for m in members(["oscillator + sign(v)*x**2 - x**-1"], {"oscillator"})]
    [('oscillator', False), ('sign(v)*x**2', False), ('x**-1', True)]
    >>> members(["x + v"], {"oscillator"}) is None
    True
    """
    divided = [_parts(text) for text in texts]
    unions = [any(part.text.partition(":")[0].strip() in families for part in parts) for parts in divided]
    if not any(unions):
        return None
    out: list[Member] = []
    for text, parts, union in zip(texts, divided, unions, strict=True):
        if union:
            out += parts
        else:
            bare = text.strip()
            out.append(Member(bare.removeprefix("-").strip(), bare.startswith("-")))
    return out


def _parts(text: str) -> list[Member]:
    """The parts between + and - outside of brackets, each with its sign."""
    parts, left_out, depth = [""], [False], 0
    for c in text:
        depth += (c in "({[") - (c in ")}]")
        before = parts[-1].rstrip()
        if c in "+-" and depth <= 0 and not before and len(parts) == 1:
            left_out[0] = c == "-"
        elif c in "+-" and depth <= 0 and not _OPERATOR.search(before):
            parts.append("")
            left_out.append(c == "-")
        else:
            parts[-1] += c
    return [Member(part.strip(), out) for part, out in zip(parts, left_out, strict=True)]


def split_at(text: str, mark: str = ",") -> list[str]:
    """The parts between the marks outside of brackets.

    >>> split_at("x, atan2(x, v)"), split_at("tanh(v/{v0}) | sign(v)", "|")
    (['x', 'atan2(x, v)'], ['tanh(v/{v0})', 'sign(v)'])
    """
    parts, depth = [""], 0
    for c in text:
        depth += (c in "({") - (c in ")}")
        if c == mark and depth <= 0:
            parts.append("")
        else:
            parts[-1] += c
    return [part.strip() for part in parts]


def without_names(text: str, names: Set[str], families: Set[str]) -> str:
    """A dictionary without the terms that contain some names, and without the equations of these names.

    >>> without_names("a: oscillator + f - x*f, v, u-f, f | sign(v); df: u", {"f", "df"}, {"oscillator"})
    'a: oscillator, v, sign(v)'
    """
    if names.isdisjoint(re.findall(r"\w+", text)):
        return text
    if (pieces := split_at(text, ";"))[1:]:
        own = [(target.strip(), terms) for target, _, terms in (piece.partition(":") for piece in pieces)]
        return "; ".join(f"{one}: {without_names(terms, names, families)}" for one, terms in own if one not in names)
    for mark, between in ((",", ", "), ("|", " | ")):
        if (pieces := split_at(text, mark))[1:]:
            return between.join(filter(None, (without_names(piece, names, families) for piece in pieces)))
    kept = [part for part in members([text], families) or () if names.isdisjoint(re.findall(r"\w+", part.text))]
    return " ".join(f"{'-' if part.left_out else '+'} {part.text}" for part in kept).removeprefix("+ ")


def of_equations(specification: Specification, targets: Sequence[str]) -> dict[str, str | Sequence[str]] | None:
    """The dictionary of each equation, by its target, or an InputError; None where all have the same."""
    if isinstance(specification, Mapping):
        found = [(str(target), one) for target, one in specification.items()]
    elif isinstance(specification, str) and (
        specification.partition(":")[0].strip() in targets or (";" in specification and ":" in specification)
    ):
        found = []
        for piece in specification.split(";"):
            target, colon, rest = piece.partition(":")
            if not colon:
                raise InputError(
                    f"dictionary {piece.strip()!r}: write the target of its equation in front, as in"
                    f" {targets[0]}: oscillator"
                )
            found.append((target.strip(), rest.strip()))
    else:
        return None
    out: dict[str, str | Sequence[str]] = {}
    for target, one in found:
        if target not in targets:
            raise UnknownNameError("equation", target, targets, where="dictionary")
        if target in out:
            raise InputError(f"dictionary: equation {target} has two; join them with +")
        out[target] = one
    missing = [target for target in targets if target not in out]
    if missing:
        raise InputError(f"dictionary: none is given for equation {', '.join(missing)}; give one for each equation")
    return out


def written(specification: Specification) -> str:
    """A dictionary as one text."""
    if isinstance(specification, str):
        return specification
    if isinstance(specification, Mapping):
        return "; ".join(f"{target}: {written(one)}" for target, one in specification.items())
    return ", ".join(map(str, specification))


@dataclass(frozen=True, slots=True)
class Variables:
    """The variables that terms are made of."""

    states: tuple[str, ...]  # coordinates and their derivatives below the target
    inputs: tuple[str, ...] = ()  # forces and other inputs
    chains: tuple[tuple[str, ...], ...] = ()  # the states chain by chain; empty where that is not known
    own: int | None = None  # the chain whose equation the terms are for; None for all
    targets: tuple[str, ...] = ()  # highest derivatives, which terms of other equations may be proportional to
    discrete: bool = False  # whether terms may have earlier samples of states and inputs, as x[-1]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The lowest state of each chain; all states where chains are not known."""
        return tuple(chain[0] for chain in self.chains if chain) if self.chains else self.states

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.states, *self.inputs)

    @property
    def known(self) -> tuple[str, ...]:
        """The names, those of the targets, and t, the time."""
        names = (*self.names, *self.targets)
        return names if TIME in names else (*names, TIME)
