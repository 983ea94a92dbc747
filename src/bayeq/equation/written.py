"""Units of coefficients from the units of channels; numbers, terms and constants as they are written in answers.

``m/s^2`` per ``mm`` is ``m/s^2/mm``: symbols are multiplied and cancelled, never converted. Parameters of an oscillator
are in SI units if the units of the channels are known.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import ConstantEstimate, Forms, beside
from bayeq.errors import InputError
from bayeq.expressions import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown
from bayeq.expressions.functions import TIME
from bayeq.expressions.nodes import arguments_of, with_arguments
from bayeq.expressions.symbolic import step_latex
from bayeq.records.names import Unit, conversion, derivative_ratio, in_si, multiply_units, parse_unit, written_unit
from bayeq.states import Chain

# A constant at this many times the lower end of its range, or one over this times the upper end, is far beyond it.
BEYOND = 1e-9

# Functions of dimensionless arguments; functions of angles, and the units of angles.
PURE = (
    "sin", "cos", "tan", "asin", "acos", "atan", "exp", "log", "log10", "log1p", "sinh", "cosh", "tanh", "asinh",
    "acosh", "atanh", "erf",
)  # fmt: skip
OF_ANGLES = ("sin", "cos", "tan")
RADIANS, DEGREES = (Unit(), parse_unit("rad")), (parse_unit("deg"), parse_unit("°"))
# Factors by which a term converts degrees to radians itself.
CONVERTING = (180.0, math.pi / 180.0, 180.0 / math.pi)

# Functions whose values have the unit of an argument, or of its root.
_LIKE_ARGUMENTS = ("abs", "cbrt", "max", "min", "mod", "relu", "sqrt", "where")


def _of(node: Node, units: Mapping[str, str]) -> Unit | None:
    """Unit of a term; None if the unit of a channel is not known, or if units do not fit together."""
    match node:
        case Number() | Constant():
            return {}
        case Symbol(name):
            return parse_unit(units[name]) if name in units else None
        case Unknown(name):
            return parse_unit(units[f"{{{name}}}"]) if f"{{{name}}}" in units else None
        case Negate(operand) | Call("abs" | "relu", (operand,)) | Call("mod", (operand, _)):
            return _of(operand, units)
        case Call("sqrt" | "cbrt" as root, (operand,)):
            inside = _of(operand, units)
            return None if inside is None else multiply_units({}, inside, Fraction(1, 2 if root == "sqrt" else 3))
        case Call("max" | "min", arguments) | Call("where", (_, *arguments)):
            found = [_of(one, units) for one in arguments if one != Number(0)]  # 0 has every unit
            return found[0] if found and all(one == found[0] for one in found) else None
        case Call():
            return {}
        case Binary("+" | "-", left, right):
            first, second = _of(left, units), _of(right, units)
            return first if first == second else None
        case Binary("**", left, Number(value)):
            base = _of(left, units)
            return None if base is None else multiply_units({}, base, Fraction(value).limit_denominator(1000))
        case Binary("*" | "/" as operator, left, right):
            first, second = _of(left, units), _of(right, units)
            if first is None or second is None:
                return None
            return multiply_units(dict(first), second, 1 if operator == "*" else -1)
    return None


def quotient_unit(target: str, term: Expression, units: Mapping[str, str]) -> str | None:
    """Unit of the coefficient of a term in the equation of a target, from the units of the channels.

    None where the unit of the target or of a channel in the term is not known.

    >>> from bayeq.expressions import parse
    >>> units = {"x": "mm", "v": "m/s", "a": "m/s2", "u": "N"}
    >>> [quotient_unit("a", parse(t), units) for t in ("x", "v", "x**3", "v*abs(v)", "sign(v)", "u")]
    ['m/s^2/mm', '1/s', 'm/s^2/mm^3', '1/m', 'm/s^2', 'm/s^2/N']
    """
    if target not in units:
        return None
    below = _of(term.tree, units)
    return None if below is None else written_unit(multiply_units(parse_unit(units[target]), below, -1))


def constant_units(terms: Sequence[Expression], units: Mapping[str, str]) -> dict[str, str]:
    """Units of the constants inside terms: that of their other summand or dividend, or one over that of their factor.

    Constants in a product that is not the argument of a function are left out, and so are exponents.

    >>> from bayeq.expressions import parse
    >>> constant_units([parse("tanh(v/{v0})"), parse("exp(-{a}*t)")], {"v": "m/s", "t": "s"})
    {'v0': 'm/s', 'a': '1/s'}
    """
    out: dict[str, str] = {}
    for term in terms:
        for name in term.unknowns:
            place, known = beside(term, name), {**units, **{f"{{{one}}}": unit for one, unit in out.items()}}
            unit = None if place.other is None or name in out or place.operation == "**" else _of(place.other, known)
            if unit is None or (place.operation in ("*", "below") and not _is_plain(place.path)):
                continue
            power = Fraction(-1 if place.operation == "*" else 1)
            if isinstance(place.power, Number):
                power /= Fraction(place.power.value)
            if place.power is None or isinstance(place.power, Number):
                out[name] = written_unit(multiply_units({}, unit, power))
    return out


def in_radians(term: Expression, units: Mapping[str, str]) -> Expression:
    """The term with sines, cosines and tangents of degrees written as those of radians.

    >>> from bayeq.expressions import parse
    >>> in_radians(parse("v*sin(th)"), {"th": "deg", "v": "deg/s"}).text
    'v*sin(pi*th/180)'
    """
    return replace(term, tree=_in_radians(term.tree, units))


def _in_radians(node: Node, units: Mapping[str, str]) -> Node:
    node = with_arguments(node, tuple(_in_radians(part, units) for part in arguments_of(node)))
    match node:
        case Call(function, (angle,)) if function in OF_ANGLES and _of(angle, units) in DEGREES:
            if not _converts(angle):
                return Call(function, (Binary("/", Binary("*", Constant("pi"), angle), Number(180)),))
    return node


def _converts(node: Node) -> bool:
    """Whether an angle holds pi or another factor that converts degrees to radians."""
    match node:
        case Constant("pi"):
            return True
        case Number(value):
            return any(math.isclose(value, factor, rel_tol=1e-3) for factor in CONVERTING)
    return any(map(_converts, arguments_of(node)))


def arguments_with_units(term: Expression, units: Mapping[str, str]) -> Iterator[str]:
    """Units of arguments of exponentials, logarithms and sines in a term, which should have none; t may have one."""
    parts = [term.tree]
    while parts:
        node = parts.pop()
        parts += arguments_of(node)
        if isinstance(node, Call) and node.function in PURE and Expression(node).names != {TIME}:
            unit = _of(node.arguments[0], units)
            fine = RADIANS + DEGREES if node.function in OF_ANGLES else RADIANS
            if unit is not None and unit not in fine:
                yield written_unit(unit)


def unlike_summands(term: Expression, units: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Pairs of channels of which a term holds the sum or difference though one is in another unit of the same quantity.

    >>> from bayeq.expressions import parse
    >>> list(unlike_summands(parse("(x2-x1)**3"), {"x1": "m", "x2": "mm"}))
    [('x2', 'x1')]
    """
    parts = [term.tree]
    while parts:
        node = parts.pop()
        parts += arguments_of(node)
        match node:
            case Binary("+" | "-", Symbol(left), Symbol(right)) if left in units and right in units:
                if conversion(units[left], units[right]) not in (None, 1.0):
                    yield left, right


def _is_plain(path: Sequence[Node]) -> bool:
    """Whether the product that ends a path is dimensionless: inside a function, or added to a number."""
    child = path[-1]
    for parent in reversed(path[:-1]):
        match parent:
            case Binary("+" | "-", left, right) if isinstance(left if right is child else right, Number):
                return True
            case Negate() | Binary("+" | "-"):
                child = parent
            case Binary("**", _, right):
                return right is child or isinstance(right, Unknown)
            case Call(function):
                return function not in _LIKE_ARGUMENTS
            case _:
                return False
    return False


def channel_units(
    stated: Sequence[Mapping[str, str]], chains: Sequence[Chain], inputs: Sequence[str], clock: str
) -> tuple[dict[str, str], list[str]]:
    """Units of states, targets and inputs, as far as any of the records states them, and the conflicts.

    A derivative that is not measured has the unit of the nearest one that is, divided or multiplied by that of time. A
    conflict is a sentence on a channel whose unit differs between records; its unit is left out.
    """
    units: dict[str, str] = {}
    conflicts = []
    for name in dict.fromkeys([*(m for chain in chains for m in chain.measured if m is not None), *inputs]):
        found = sorted({one[name] for one in stated if name in one})
        if len(found) > 1:
            conflicts.append(f"{name} is in {' and in '.join(found)}, depending on the record: give it one unit")
        elif found:
            units[name] = found[0]
    for chain in chains:
        known = [k for k, m in enumerate(chain.measured) if m in units]
        for k, name in enumerate(chain.names):
            if chain.measured[k] is None and known:
                nearest = min((abs(k - other), other) for other in known)[1]
                power = Fraction(0 if chain.discrete else nearest - k)
                units[name] = written_unit(multiply_units(parse_unit(units[chain.names[nearest]]), {clock: power}))
    return units, conflicts


# Products of SI units that have a shorter name.
SHORTER: Mapping[str, str] = {"N*s^2/m": "kg", "N*m*s^2": "kg*m^2", "Nm*s^2": "kg*m^2"}


class OscillatorUnits:
    """Factors from the units of an oscillator's channels to consistent units, SI where the units are known.

    In consistent units velocity and acceleration are derivatives of the displacement by seconds; the factors convert
    coefficients from channel units to these. `gains` are the ratios of channels that the motion shows
    (`bayeq.states.sensors`), empty if none; `force` is the input that is a force, if any. With `in_kg` the mass is
    given: in kg (kg m^2, if the displacement is an angle) where the displacement's unit is known.

    InputError for units that do not fit a displacement and its derivatives, or that the motion contradicts.
    """

    def __init__(
        self, units: Mapping[str, str], chain: Chain, gains: Sequence[float], force: str | None, in_kg: bool = False
    ) -> None:
        x = chain.names[0]
        self.length: Unit | None = parse_unit(units[x]) if x in units else None
        self.force: Unit | None = parse_unit(units[force]) if force is not None and force in units else None
        self.per_length = self.per_force = 1.0
        # channel = ratio times the derivative of the displacement's channel
        self.velocity, self.acceleration = (_ratio(units, chain, k, gains[k] if gains else None) for k in (1, 2))
        stated = self.length
        if self.length is not None:
            self.per_length, self.length = in_si(self.length) or (1.0, self.length)
        self.turns = bool(stated) and not self.length  # whether the displacement is an angle
        if self.force is not None:
            self.per_force, self.force = in_si(self.force) or (1.0, self.force)
        elif in_kg and self.length in ({}, {"m": Fraction(1)}):
            self.force = multiply_units({"N": Fraction(1)}, {} if self.length else {"m": Fraction(1)})

    def scale(self, powers: tuple[int, int]) -> float:
        """Factor to consistent units for the coefficient of x**p v**q in the equation of the acceleration."""
        p, q = powers
        return self.velocity**q / self.acceleration * self.per_length ** (1 - p - q)

    def scale_force(self) -> float:
        """Factor to consistent units for the coefficient of the force."""
        return self.scale((0, 0)) / self.per_force

    def displacement(self) -> str | None:
        """Unit of the displacement; None where it is not known."""
        return None if self.length is None else _written(self.length)

    def mass(self) -> str | None:
        """Unit of the mass, a force over an acceleration; None where it is not known."""
        return self.unit((-1, 2), with_mass=True)

    def unit(self, powers: tuple[int, int], with_mass: bool) -> str | None:
        """Unit of the parameter of x**p v**q, with the mass in it or per unit of mass; None where it is not known."""
        p, q = powers
        of_term = self.force if with_mass else multiply_units(dict(self.length or {}), {"s": Fraction(-2)})
        if self.length is None or of_term is None:
            return None
        out = multiply_units(dict(of_term), self.length, -(p + q))
        return _written(multiply_units(out, {"s": Fraction(q)}))


def _ratio(units: Mapping[str, str], chain: Chain, order: int, gain: float | None) -> float:
    """Ratio of a derivative's channel to the derivative of the displacement's; `gain` is the one that motion shows."""
    x, other = chain.names[0], chain.names[order]
    if x not in units or other not in units:
        return 1.0 if gain is None else gain
    stated, what = derivative_ratio(units[x], units[other], order), f"{'second ' * (order == 2)}derivative of {x}"
    if stated is None:
        raise InputError(f"{other} in {units[other]} is no {what} in {units[x]}: state units that fit, or none")
    if gain is not None and not math.isclose(abs(gain), stated, rel_tol=1e-9):
        raise InputError(
            f"{other} in {units[other]} should be {stated:.4g} times the {what} in {units[x]}, but it is {gain:.4g}"
            " times that: state the units that the channels have, or none"
        )
    return stated if gain is None else gain


def _written(unit: Unit) -> str:
    """A unit as text, ``N*s/m``, by its shorter name if it has one; empty for a pure number."""
    order = sorted(unit.items(), key=lambda item: ({"N": 0, "m": 1, "s": 2}.get(item[0], -1), item[0]))
    text = written_unit(dict(order)) if unit else ""
    return SHORTER.get(text, text)


# A value is at an end of its range if it is within this share of the range from it.
AT_END = 0.01


def plain_sd(one: ConstantEstimate) -> float:
    """Standard deviation of a constant itself, not of its logarithm; 0 where it is in no term."""
    return (one.sd or 0.0) * (abs(one.value) if one.logarithmic else 1.0)


def limit_of(one: ConstantEstimate, terms: Sequence[Expression], end: str) -> str:
    """Text on the limit of a constant's only term far beyond an end of its range: ``sign(v)`` for tanh(v/{v0})."""
    own = [term for term in terms if term.text in one.terms and len(term.names) == 1]
    if len(own) != 1 or not one.low > 0.0:
        return "the term without it"
    (term,), (name,), places = own, own[0].names, np.array([-2.0, -1.0, 1.0, 2.0])
    far = replace(term.unknowns[one.name], value=one.low * BEYOND if end == "lower" else one.high / BEYOND)
    with np.errstate(all="ignore"):
        values = evaluate_terms([term.with_unknowns({one.name: far})], {name: places})[:, 0]
    for text, shape in ((f"sign({name})", np.sign(places)), (name, places)):
        ratio = values / shape
        if np.isfinite(ratio).all() and ratio[0] and np.allclose(ratio, ratio[0], rtol=1e-6, atol=0.0):
            return f"{text} in its place"
    return "the term without it"


def place_of(one: ConstantEstimate) -> float:
    """Where a constant is in its range: from 0 at the lower end to 1, by its logarithm if the range is logarithmic."""
    low, value, high = (math.log(end) if one.logarithmic else end for end in (one.low, one.value, one.high))
    return (value - low) / (high - low)


def is_at_end(one: ConstantEstimate) -> bool:
    """Whether the value of a constant reaches an end of its range."""
    return min(place_of(one), 1.0 - place_of(one)) < AT_END


def at_end(one: ConstantEstimate, unit: str = "", terms: Sequence[Expression] = ()) -> Iterator[str]:
    """A message if the value or the interval of a constant reaches an end of its range; none otherwise."""
    shown = f"({one.low:.3g} .. {one.high:.3g}{f' {unit}' if unit not in ('', '1') else ''})"
    cure = f"give a wider one, {{{one.name}: low..high}}, or "
    if is_at_end(one):
        end = "lower" if place_of(one) < 0.5 else "upper"
        yield f"{one.name} is at the {end} end of its range {shown}: {cure}{limit_of(one, terms, end)}"
        return
    ends = [end for end, reached in (("lower", one.ci95[0] <= one.low), ("upper", one.ci95[1] >= one.high)) if reached]
    if ends:
        cure += limit_of(one, terms, ends[0]) if len(ends) == 1 else "the term without it"
        yield f"the interval of {one.name} reaches the {' and the '.join(ends)} end of its range {shown}: {cure}"


def left_out_forms(forms: Forms, pip: Mapping[str, float]) -> Iterator[str]:
    """Messages on members of either-ors that are not finite and so were not compared with the others."""
    for choice, found in forms.items():
        left = [name for name in choice.split(" | ") if name in pip and name not in found]
        if any(pip.get(name) for name in found):
            yield from (
                f"{one} is left out, not finite beside the motion: write abs() in its powers and roots" for one in left
            )


def row_of(one: ConstantEstimate, unit: str | None) -> dict[str, Any]:
    """The row of a constant in an equation's table."""
    row = {"term": f"{{{one.name}}}", "included": True, "shown": True, "why": "", "effective": False, "unit": unit}
    numbers = {"coef": one.value, "sd": plain_sd(one), "ci_low": one.ci95[0], "ci_high": one.ci95[1]}
    return {**row, **numbers, **{f"shown_{name}": value for name, value in numbers.items()}}


def factor_of(term: str) -> str:
    """A term as the factor of a product: in parentheses if it is a sum or a quotient."""
    depth = 0
    for k, character in enumerate(term):
        depth += (character in "([") - (character in ")]")
        exponent = k > 0 and term[k - 1] in "eE" and k > 1 and term[k - 2].isdigit()
        if depth == 0 and character in "+-/" and not exponent:
            return f"({term})"
    return term


def round_to(value: float, sd: float) -> str:
    """A number with digits down to a tenth of its standard deviation, between 3 and 12 significant ones."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = 12 if sd <= 0 else math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2
    return f"{value:.{min(max(digits, 3), 12)}g}"


def with_interval(value: float, sd: float, interval: Sequence[float]) -> tuple[str, str, str]:
    """A number, its standard deviation and its interval, as text."""
    low, high = (round_to(end, sd) for end in interval)
    return round_to(value, sd), f"{sd:.2g}", f"{low} .. {high}"


def difference(enters: str | None, leaves: str | None) -> str:
    """How a model differs from another, by the terms that enter it and those that leave it."""
    if enters and leaves:
        return f"{enters} instead of {leaves}"
    return f"without {leaves}" if leaves else f"with {enters} added"


def odds_text(log_odds: float) -> str:
    """Odds as text from their logarithm: ``1:20`` against, ``20:1`` for.

    >>> odds_text(-2.0), odds_text(3.0), odds_text(-280.0)
    ('1:7.4', '20:1', '1:4e+121')
    """
    ratio = math.exp(min(abs(log_odds), 700.0))
    number = f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}" if ratio < 1e6 else f"{ratio:.0e}"
    return f"1:{number}" if log_odds <= 0 else f"{number}:1"


def chance(p: float, digits: int = 2) -> str:
    """A p-value as text."""
    return f"p = {p:.{digits}g}" if p >= 1e-4 else "p < 0.0001"


def moment(time: float, discrete: bool) -> str:
    """A time of a record, in samples where the equations are a map."""
    return f"sample {time:.6g}" if discrete else f"{time:.6g} s"


def finite(value: Any) -> Any:
    """A value, list or mapping for JSON: None in place of numbers that are infinite or NaN."""
    if isinstance(value, Mapping):
        return {name: finite(one) for name, one in value.items()}
    if isinstance(value, list):
        return [finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def in_latex(chains: Sequence[Chain], names: Iterable[str]) -> dict[str, str]:
    """Coordinates and their derivatives in LaTeX, derivatives as dots; for maps the names with their steps."""
    import sympy

    if any(chain.discrete for chain in chains):
        return {name: step_latex(name) for name in names}
    symbols: dict[str, str] = {}
    for chain in chains:
        base = sympy.latex(sympy.Symbol(chain.names[0]))
        symbols |= {name: rf"\{'d' * k}ot{{{base}}}" if k else base for k, name in enumerate(chain.names)}
    return symbols
