"""Where the constants inside terms may be, such as v0 of ``tanh(v/{v0})``, and grids on which they are sought.

A constant beside a state is a scale of it, a place on it, or a power; one that multiplies time inside a sine is a
frequency. What is not written, ``{v0: 0.01..3}``, is read from the record: scales from what samples resolve to the
largest value, places from the smallest value to the largest, frequencies from half a wave over the record to a quarter
of the sampling rate.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.expressions import Binary, Call, Evaluator, Expression, Negate, Node, Unknown
from bayeq.expressions.functions import COMPARISONS, TIME
from bayeq.expressions.nodes import arguments_of

__all__ = ["NODES", "beside", "families", "grids", "is_scale", "located", "to_plain", "to_scale"]

Floats = NDArray[np.float64]
Columns = Sequence[Mapping[str, Floats]]

# Scales reach from this share of the step between samples to the largest value, and what is added to a state to this
# many times that: at the end tanh(v/v0) still bends by a quarter over the record, and x/(K + x) too.
RESOLVED, BEYOND = 0.2, 3.0

# A range whose ends are further apart by this factor is divided on a logarithmic scale.
WIDE = 10.0

# Powers, where nothing is written.
POWERS = 0.25, 4.0

# Waves over the range of what they are waves of, at least and, where that is not time, at most.
FEWEST_WAVES, MOST_WAVES = 0.5, 20.0

# Nodes of a scale, a place or a power; of a phase, those of half a turn, for the coefficient has either sign.
NODES = 13
PHASES = 0.0, 0.5 * math.pi

# Frequencies are this share of what the record resolves apart.
APART = 0.8

# A grid of all constants of a term has no more nodes than this.
MOST_NODES = 20_000

_WAVES = ("sin", "cos")


def is_scale(constant: Unknown) -> bool:
    """Whether a constant is known on a logarithmic scale."""
    return constant.low > 0.0 and constant.high >= WIDE * constant.low


def to_scale(constant: Unknown, value: float) -> float:
    """A value on the scale on which the constant has a flat prior."""
    return math.log(value) if is_scale(constant) else value


def to_plain(constant: Unknown, value: float) -> float:
    """The value from that on the scale."""
    return math.exp(value) if is_scale(constant) else value


def families(terms: Sequence[Expression]) -> list[list[int]]:
    """Terms that share constants, as their numbers; terms without any are in none."""
    found: list[tuple[set[str], list[int]]] = []
    for j, term in enumerate(terms):
        names, own = set(term.unknowns), [j]
        if not names:
            continue
        for other in [one for one in found if one[0] & names]:
            found.remove(other)
            names, own = names | other[0], other[1] + own
        found.append((names, own))
    return [sorted(own) for _, own in sorted(found, key=lambda one: one[1])]


def located(terms: Sequence[Expression], columns: Columns) -> dict[str, Unknown]:
    """The constants of some terms, by name, with the ranges in which they may be.

    Parameters
    ----------
    terms : sequence of Expression
        Candidates.
    columns : sequence of mapping of str to (n,) array
        States, inputs and time of each record.

    Raises
    ------
    InputError
        A range that is not written, and that the record does not give.
    """
    out: dict[str, Unknown] = {}
    for term in terms:
        for name, constant in term.unknowns.items():
            if name not in out or math.isnan(out[name].low):
                out[name] = constant
    for name, constant in out.items():
        if math.isnan(constant.low):
            paths = [path for term in terms for path in _paths(term.tree, name)]
            low, high = _range(paths[0], out, columns, name)
            out[name] = replace(constant, low=low, high=high)
    return out


def grids(
    terms: Sequence[Expression], constants: Mapping[str, Unknown], columns: Columns
) -> Iterator[dict[str, float]]:
    """Values of the constants of a family, on the product of the grids of each."""
    names = sorted({name for term in terms for name in term.unknowns})
    each = []
    for name in names:
        path = next(path for term in terms for path in _paths(term.tree, name))
        each.append(_nodes(constants[name], path, constants, columns))
    count = math.prod(map(len, each))
    if count > MOST_NODES:
        raise InputError(
            f"term {terms[0].text}: {count:,} values of its constants would be tried, more than {MOST_NODES:,}; give"
            f" narrower ranges, as in {{{names[0]}: low..high}}"
        )
    for values in itertools.product(*each):
        yield dict(zip(names, values, strict=True))


def beside(term: Expression, name: str) -> tuple[str, Node | None]:
    """The operation or function that a constant stands in, ``"below"`` where it divides, and what stands beside it."""
    return _beside(next(_paths(term.tree, name)))


def _paths(node: Node, name: str) -> Iterator[tuple[Node, ...]]:
    """From the root to a constant."""
    if isinstance(node, Unknown):
        if node.name == name:
            yield (node,)
        return
    for part in arguments_of(node):
        for path in _paths(part, name):
            yield (node, *path)


def _wave(path: tuple[Node, ...]) -> bool:
    return any(isinstance(node, Call) and node.function in _WAVES for node in path)


def _beside(path: tuple[Node, ...]) -> tuple[str, Node | None]:
    """The operation that a constant stands in, and what stands beside it."""
    child: Node = path[-1]
    for parent in reversed(path[:-1]):
        match parent:
            case Negate():
                child = parent
                continue
            case Binary(op, left, right):
                return ("below" if op == "/" and right is child else op), (left if right is child else right)
            case Call(function, arguments):
                rest = [one for one in arguments if one is not child]
                return function, rest[0] if rest else None
        break
    return "", None


def _range(
    path: tuple[Node, ...], constants: Mapping[str, Unknown], columns: Columns, name: str
) -> tuple[float, float]:
    """The range of a constant, by its place in a term."""
    operation, other = _beside(path)
    if operation == "**":
        return POWERS
    if _wave(path) and operation in ("+", "-"):
        return -math.pi, math.pi
    values = None if other is None else _values(other, constants, columns)
    if values is not None:
        largest = float(np.abs(values).max(initial=0.0))
        steps = np.abs(np.diff(values))
        least = max(RESOLVED * float(np.median(steps)) if len(steps) else 0.0, 1e-3 * largest)
        if _wave(path) and operation in ("*", "below"):
            low, high = _waves(values, other, columns)
            return (low, high) if operation == "*" else (1.0 / high, 1.0 / low)
        if largest > 0.0 and operation in ("below", "+"):
            return least, largest if operation == "below" else BEYOND * largest
        if largest > 0.0 and operation == "*":
            return 1.0 / (BEYOND * largest), 1.0 / least
        if operation in ("-", "max", "min", *COMPARISONS) and values.max() > values.min():
            return float(values.min()), float(values.max())
    raise InputError(f"the record does not tell where {{{name}}} may be: give its range, as in {{{name}: 0.01..3}}")


def _waves(values: Floats, other: Node | None, columns: Columns) -> tuple[float, float]:
    """Angular frequencies of waves over some values: over time up to a quarter of the sampling rate."""
    span = _span(values, other, columns)
    high = 2.0 * math.pi * MOST_WAVES / span
    if _times(other):
        steps = np.concatenate([np.diff(one[TIME]) for one in columns])
        high = 0.5 * math.pi / float(np.median(steps))
    return 2.0 * math.pi * FEWEST_WAVES / span, high


def _times(node: Node | None) -> bool:
    return node is not None and Expression(node).names == {TIME}


def _span(values: Floats, other: Node | None, columns: Columns) -> float:
    if _times(other):
        return max(float(np.ptp(one[TIME])) for one in columns)
    return float(np.ptp(values)) or 1.0


def _values(node: Node, constants: Mapping[str, Unknown], columns: Columns) -> Floats | None:
    """What stands beside a constant, other constants in the middle of their ranges; None where that is not known."""
    middle = {
        name: replace(one, value=math.sqrt(one.low * one.high) if is_scale(one) else 0.5 * (one.low + one.high))
        for name, one in constants.items()
    }
    expression = Expression(node).with_unknowns(middle)
    found = np.concatenate([np.atleast_1d(Evaluator(one)(expression)) for one in columns])
    return found if np.isfinite(found).all() else None


def _nodes(
    constant: Unknown, path: tuple[Node, ...], constants: Mapping[str, Unknown], columns: Columns
) -> list[float]:
    operation, other = _beside(path)
    low, high = constant.low, constant.high
    if _wave(path) and operation in ("+", "-") and high - low > math.pi:
        return [low + phase for phase in PHASES]
    values = None if other is None else _values(other, constants, columns)
    if _wave(path) and values is not None and operation == "*":
        step = APART * 2.0 * math.pi / _span(values, other, columns)
        return np.linspace(low, high, max(NODES, math.ceil((high - low) / step) + 1)).tolist()
    return (np.geomspace if is_scale(constant) else np.linspace)(low, high, NODES).tolist()
