"""Ranges of the constants inside terms, such as v0 of ``tanh(v/{v0})``, and grids on which they are sought.

A range that is not written, ``{v0: 0.01..3}``, follows from the record and the position of the constant: docs/terms.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.expressions import Binary, Call, Evaluator, Expression, Negate, Node, Number, Unknown
from bayeq.expressions.functions import COMPARISONS
from bayeq.expressions.nodes import arguments_of, is_comparison, nodes_of, unknowns_of

Columns = Sequence[Mapping[str, Floats]]

# A scale reaches from RESOLVED times the step between samples to the largest value, a constant added to a state to
# BEYOND times that value: there tanh(v/v0) and x/(K + x) still bend by a quarter over the record.
RESOLVED, BEYOND = 0.2, 3.0

# A range is logarithmic if its ends differ by at least this factor.
WIDE = 10.0

# Safety factor on the least constant for which a sum that must be positive is so.
CLEAR = 1.1

# Range of an unknown exponent, if none is written.
POWERS = 0.25, 4.0

# Fewest and most waves over the range of their argument; over even steps the sampling rate limits them instead.
FEWEST_WAVES, MOST_WAVES = 0.5, 20.0

# Number of nodes of a scale, an offset or a power; nodes of a phase about its middle, where half a turn suffices,
# because the coefficient has either sign.
NODES = 13
PHASES = -0.25 * math.pi, 0.25 * math.pi

# Number of nodes of a threshold where a term jumps, which is known to about one step of this grid.
JUMP_NODES = 1000

# Number of nodes of a threshold where a term bends: between distant nodes a bend looks like a polynomial. The grid of
# several constants together has about BEND_GRID nodes.
BEND_NODES, BEND_GRID = 100, 2500

# Further nodes of a rate in an exponential: those with which the exponent changes by these amounts along the record.
# Between nodes that are farther apart polynomials compensate for a wrong rate.
EXPONENTS = np.arange(0.5, 15.1, 0.5)

# Step between frequencies, as a share of the frequency resolution of the record.
APART = 0.8

# A grid of all constants of a term has no more nodes than this.
MOST_NODES = 20_000

_WAVES = ("sin", "cos")
_POSITIVE = ("sqrt", "log", "log10", "log1p")


# Log posteriors of the members of an either-or, by its text and the text of the member.
Forms = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class ConstantEstimate:
    """The estimate of a constant inside terms.

    Attributes
    ----------
    name : str
        The name between braces.
    value : float
        The most probable value.
    sd : float or None
        Standard deviation (of the logarithm for a scale); None if no term of the model has the constant.
    ci95 : (float, float)
        95 % interval, within the range.
    low, high : float
        The range in which it was sought.
    logarithmic : bool
        Whether it is a scale, with a flat prior on its logarithm.
    terms : tuple of str
        Terms of the model that contain it, or if there are none, those of the dictionary.
    """

    name: str
    value: float
    sd: float | None
    ci95: tuple[float, float]
    low: float
    high: float
    logarithmic: bool
    terms: tuple[str, ...]


def is_scale(constant: Unknown) -> bool:
    """Whether the range of a constant is logarithmic."""
    return constant.low > 0.0 and constant.high >= WIDE * constant.low


def to_scale(constant: Unknown, value: float) -> float:
    """A value on the scale on which the constant has a flat prior."""
    return math.log(value) if is_scale(constant) else value


def to_plain(constant: Unknown, value: float) -> float:
    """The plain value, from its value on that scale."""
    return math.exp(value) if is_scale(constant) else value


def constants_of(terms: Sequence[Expression]) -> dict[str, Unknown]:
    """The constants of some terms, by name."""
    return {name: one for term in terms for name, one in term.unknowns.items()}


def middle(constant: Unknown) -> float:
    """The value in the middle of the range of a constant, on its scale."""
    return to_plain(constant, 0.5 * (to_scale(constant, constant.low) + to_scale(constant, constant.high)))


def extent(constant: Unknown) -> float:
    """The range of a constant, on its scale."""
    return to_scale(constant, constant.high) - to_scale(constant, constant.low)


def families(terms: Sequence[Expression]) -> list[list[int]]:
    """Groups of terms, by their numbers, that share constants; terms without constants are left out."""
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


def with_ranges(terms: Sequence[Expression]) -> tuple[Expression, ...]:
    """The terms with a range that is written once set at every place of its constant; InputError for two ranges."""
    written: dict[str, Unknown] = {}
    for term in terms:
        for one in unknowns_of(term.tree):
            other = written.setdefault(one.name, one)
            if math.isnan(other.low):
                written[one.name] = one
            elif not math.isnan(one.low) and (one.low, one.high) != (other.low, other.high):
                raise InputError(
                    f"{term.text}: {{{one.name}}} has two ranges, {other.low:g}..{other.high:g} and"
                    f" {one.low:g}..{one.high:g}: it is one constant; write one range, or two names"
                )
    return tuple(term.with_unknowns(written) for term in terms)


def located(terms: Sequence[Expression], columns: Columns) -> dict[str, Unknown]:
    """The constants of some terms, by name, with the ranges in which they may be.

    Terms have the ranges that are written; columns (n,) are the states, inputs and time of each record. InputError for
    a range that is not written and that the record does not give, or in which a term is singular.
    """
    out = constants_of(terms)
    places = {name: [path for term in terms for path in _paths(term.tree, name)] for name in out}
    missing = [name for name, one in out.items() if math.isnan(one.low)]
    while missing:
        ends = {name: _two_sided(places[name], out, columns) for name in missing}
        found = {name: one for name, one in ends.items() if one is not None and -math.inf < one[0] < one[1] < math.inf}
        left = [name for name in missing if name not in found]
        if left == missing:
            raise InputError(
                f"the record does not tell where {{{left[0]}}} may be: give its range, as in {{{left[0]}: 0.01..3}}"
            )
        out |= {name: replace(out[name], low=low, high=high) for name, (low, high) in found.items()}
        missing = left
    for term in terms:
        _require_regular(term, out, columns)
    return out


def _require_regular(term: Expression, constants: Mapping[str, Unknown], columns: Columns) -> None:
    """Raise InputError for a term whose divisor is zero for some values of its constants."""
    for own in [Expression(one.right) for one in nodes_of(term.tree) if isinstance(one, Binary) and one.op == "/"]:
        if not own.unknowns:
            continue
        signs = set()
        for ends in itertools.product(*((constants[name].low, constants[name].high) for name in own.unknowns)):
            at = own.with_unknowns(
                {name: replace(constants[name], value=end) for name, end in zip(own.unknowns, ends, strict=True)}
            )
            for one in columns:
                with np.errstate(all="ignore"):
                    signs.update(np.sign(Evaluator(one)(at)).ravel().tolist())
        if {-1.0, 1.0} <= signs or 0.0 in signs:
            name = next(iter(own.unknowns))
            low, high = constants[name].low, constants[name].high
            raise InputError(
                f"term {term.text}: {own.text}, which divides, is zero in this record for some {name} of {low:.3g} .."
                f" {high:.3g}: give a range where it is not, as in {{{name}: 0.01..3}}"
            )


def grids(
    terms: Sequence[Expression], constants: Mapping[str, Unknown], columns: Columns
) -> Iterator[dict[str, float]]:
    """Values of the constants of a family, on the product of the grids of each."""
    names = sorted({name for term in terms for name in term.unknowns})
    each = []
    for name in names:
        path = next(path for term in terms for path in _paths(term.tree, name))
        each.append(_nodes(constants[name], path, constants, columns, len(names)))
    count = math.prod(map(len, each))
    if count > MOST_NODES:
        raise InputError(
            f"term {terms[0].text}: {count:,} values of its constants would be tried, more than {MOST_NODES:,}; give"
            f" narrower ranges, as in {{{names[0]}: low..high}}"
        )
    for values in itertools.product(*each):
        yield dict(zip(names, values, strict=True))


def jumps_at(term: Expression, name: str) -> bool:
    """Whether a constant is a threshold at which a term jumps."""
    return any(_jumps(path) for path in _paths(term.tree, name))


def beside(term: Expression, name: str) -> Place:
    """The first position of a constant in a term."""
    return _place(next(_paths(term.tree, name)))


def _paths(node: Node, name: str) -> Iterator[tuple[Node, ...]]:
    """The nodes from the root to each occurrence of a constant."""
    if isinstance(node, Unknown):
        if node.name == name:
            yield (node,)
        return
    for part in arguments_of(node):
        for path in _paths(part, name):
            yield (node, *path)


def _wave(path: tuple[Node, ...]) -> bool:
    return any(isinstance(node, Call) and node.function in _WAVES for node in path)


class Place(NamedTuple):
    """The position of a constant in a term."""

    operation: str  # operator or function around it; in a product "*", in a divisor "below"
    other: Node | None  # the other operand; in a product, all other factors
    power: Node | None  # the exponent, if the constant is the base of a power
    path: tuple[Node, ...]  # from the root to the operation


def _place(path: tuple[Node, ...]) -> Place:
    k, power = len(path) - 1, None
    while k:
        match path[k - 1]:
            case Negate():
                pass
            case Binary("**", left, right) if left is path[k] and power is None:
                power = right
            case _:
                break
        k -= 1
    other: Node | None = None
    below, first = False, k
    while k:
        match path[k - 1]:
            case Negate() if k < first:
                pass
            case Binary("*" | "/" as op, left, right):
                divides = op == "/" and right is path[k]
                factor = left if right is path[k] else right
                if other is None:
                    other = Binary("/", Number(1), right) if op == "/" and not divides else factor
                else:
                    other = Binary(op, factor, other) if divides else Binary(op, other, factor)
                below ^= divides
            case Binary(op, left, right) if other is None:
                return Place(op, left if right is path[k] else right, power, path[:k])
            case Call(function, arguments) if other is None:
                rest = [one for one in arguments if one is not path[k]]
                return Place(function, rest[0] if rest else None, power, path[:k])
            case _:
                break
        k -= 1
    return Place("below" if below else "*" if other is not None else "", other, power, path[: k + 1])


def _is_positive(path: tuple[Node, ...]) -> bool:
    """Whether the sum at the end of a path must be positive: in a divisor, a power, a root or a logarithm."""
    child = path[-1]
    for parent in reversed(path[:-1]):
        match parent:
            case Binary("/", _, right) if right is child:
                return True
            case Binary("**", left, right) if left is child and not isinstance(right, Number):
                return True
            case Call(function):
                return function in _POSITIVE
        child = parent
    return False


def _two_sided(
    paths: Sequence[tuple[Node, ...]], constants: Mapping[str, Unknown], columns: Columns
) -> tuple[float, float] | None:
    """The range of a constant by its first position; from 0 if both g and -g are thresholds of x.

    A negative g is then the same law in another form: f(-g) = 2x - f(g) for f(g) = max(x + g, 0) + min(x - g, 0).
    """
    ends = _range(paths[0], constants, columns)
    if ends is None or not ends[0] < 0.0 < ends[1]:
        return ends
    passed = []
    for place in map(_place, paths):
        if place.operation in ("+", "-") and place.other is not None and place.power is None:
            values = _values(place.other, constants, columns)
            if values is not None:
                passed.append(np.concatenate(values) * (1.0 if place.operation == "-" else -1.0))
    both = any(np.array_equal(one, -other) for one, other in itertools.combinations(passed, 2))
    return (0.0, ends[1]) if both else ends


def _range(path: tuple[Node, ...], constants: Mapping[str, Unknown], columns: Columns) -> tuple[float, float] | None:
    """The range of a constant, by its position in a term; None if the record does not determine it."""
    place = _place(path)
    operation = place.operation
    if operation == "**":
        return POWERS
    if _wave(path) and operation in ("+", "-"):
        return -math.pi, math.pi
    values = None if place.other is None else _values(place.other, constants, columns)
    if values is None:
        return None
    ends = _beside(operation, values, place.path, _wave(path))
    if ends is None or place.power is None:
        return ends
    power = _values(place.power, constants, columns)
    if ends[0] <= 0.0 or power is None or not power[0].ravel()[0] > 0.0:
        return None
    root = 1.0 / float(power[0].ravel()[0])
    return ends[0] ** root, ends[1] ** root


def _beside(operation: str, values: Sequence[Floats], path: tuple[Node, ...], wave: bool) -> tuple[float, float] | None:
    """The range of a constant from the values of the other operand."""
    largest = max(float(np.abs(one).max(initial=0.0)) for one in values)
    lowest, highest = min(float(one.min()) for one in values), max(float(one.max()) for one in values)
    steps = np.concatenate([np.abs(np.diff(one)) for one in values])
    if not largest > 0.0 or not len(steps):
        return None
    if wave and operation in ("*", "below"):
        low, high = _waves(values, steps)
        return (low, high) if operation == "*" else (1.0 / high, 1.0 / low)
    least = max(RESOLVED * float(np.median(steps)), 1e-3 * largest)
    if operation == "below":
        return least, largest
    if operation == "*":
        return 1.0 / (BEYOND * largest), 1.0 / least
    if operation == "+" and _is_positive(path):
        least += CLEAR * max(0.0, -lowest)
        return (least, BEYOND * largest) if least < 0.5 * BEYOND * largest else None
    if operation == "-" and _is_positive(path):
        return None
    if highest > lowest:
        if operation == "+":
            return -highest, -lowest
        if operation in ("-", "max", "min", *COMPARISONS):
            return lowest, highest
    return None


def _waves(values: Sequence[Floats], steps: Floats) -> tuple[float, float]:
    """Range of angular frequencies of waves over values; over even steps up to a quarter of the sampling rate."""
    span, step = _span(values), float(np.median(steps))
    even = step > 0.0 and bool(np.all(np.abs(steps - step) < 0.5 * step))
    return 2.0 * math.pi * FEWEST_WAVES / span, 0.5 * math.pi / step if even else 2.0 * math.pi * MOST_WAVES / span


def _span(values: Sequence[Floats]) -> float:
    return max(float(np.ptp(one)) for one in values) or 1.0


def _values(node: Node, constants: Mapping[str, Unknown], columns: Columns) -> list[Floats] | None:
    """Values of a node in each record, constants at the middle of their ranges; None if any is not finite."""
    values = {name: replace(one, value=middle(one)) for name, one in constants.items()}
    expression = Expression(node).with_unknowns(values)
    with np.errstate(all="ignore"):
        found = [np.atleast_1d(Evaluator(one)(expression)) for one in columns]
    return found if all(np.isfinite(one).all() for one in found) else None


def _nodes(
    constant: Unknown, path: tuple[Node, ...], constants: Mapping[str, Unknown], columns: Columns, of: int
) -> list[float]:
    place = _place(path)
    low, high = constant.low, constant.high
    if _wave(path) and place.operation in ("+", "-") and high - low > math.pi:
        return [0.5 * (low + high) + phase for phase in PHASES]
    values = None if place.other is None else _values(place.other, constants, columns)
    if _wave(path) and values is not None and place.operation in ("*", "below") and place.power is None:
        below = place.operation == "below"
        if below:
            low, high = 1.0 / high, 1.0 / low
        step = APART * 2.0 * math.pi / _span(values)
        found = np.linspace(low, high, max(NODES, math.ceil((high - low) / step) + 1))
        return (1.0 / found if below else found).tolist()
    count = NODES
    if _jumps(path):
        count = JUMP_NODES
    elif _bends(path):
        count = min(BEND_NODES, max(NODES, int(BEND_GRID ** (1.0 / of))))
    found = (np.geomspace if is_scale(constant) else np.linspace)(low, high, count)
    if of == 1 and values is not None and place.operation in ("*", "below") and place.power is None and _grows(path):
        further = _span(values) / EXPONENTS if place.operation == "below" else EXPONENTS / _span(values)
        further = np.append(further, -further)
        found = np.unique(np.append(found, further[(low < further) & (further < high)]))
    return found.tolist()


def _grows(path: tuple[Node, ...]) -> bool:
    """Whether a constant stands in the exponent of an exponential."""
    return any(isinstance(node, Call) and node.function == "exp" for node in path)


def _jumps(path: tuple[Node, ...]) -> bool:
    """Whether a term jumps at a threshold given by the constant, which only a fine grid finds."""
    steps = ("sign", "heaviside", "floor", "ceil")
    return any(is_comparison(node) or (isinstance(node, Call) and node.function in steps) for node in path)


def _bends(path: tuple[Node, ...]) -> bool:
    """Whether a term has a corner at a threshold given by the constant."""
    return any(isinstance(node, Call) and node.function in ("abs", "max", "min") for node in path)
