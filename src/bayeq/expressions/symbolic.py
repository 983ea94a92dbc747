"""Expressions as SymPy objects, in LaTeX, and in MathML, which browsers set without scripts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from bayeq.expressions.functions import COMPARISONS, FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown
from bayeq.expressions.parse import substituted, template

# SymPy computes 9**9**9 with all its digits: numbers that do not fit into a float are computed in floating point.
_MAX_BITS = 1024
_LARGE_POWER = 64


def to_sympy(expression: Expression) -> Any:
    """The expression as a SymPy object, built from the tree; no text is handed to ``sympify``.

    Integers become `sympy.Integer` (so that ``1/3`` is the rational), other numbers `sympy.Float`, names plain symbols,
    ``pi`` and ``e`` SymPy's numbers. SymPy's automatic simplification applies (``x + x`` is ``2*x``); numbers beyond
    the range of a float become infinite, as they do in evaluation.

    >>> from bayeq.expressions import parse
    >>> to_sympy(parse("v*abs(v)+x**2/3"))
    v*Abs(v) + x**2/3
    """
    return _convert(expression.tree)


def _convert(node: Node) -> Any:
    import sympy

    match node:
        case Number(value):
            return sympy.Integer(value) if isinstance(value, int) else sympy.Float(value)
        case Unknown(name, value=value):
            # real: another symbol than a channel of this name
            return sympy.Float(value) if math.isfinite(value) else sympy.Symbol(name, real=True)
        case Constant(name):
            return {"pi": sympy.pi, "e": sympy.E}[name]
        case Symbol(name):
            return sympy.Symbol(name)
        case Negate(operand):
            return -_convert(operand)
        case Call(function, arguments):
            return _called(function, arguments)
        case Binary("**", left, right):
            return _power(_convert(left), _convert(right))
        case Binary(op, left, right) if op in COMPARISONS:
            try:
                return getattr(sympy, COMPARISONS[op].sympy)(_convert(left), _convert(right))
            except TypeError:  # of numbers that are not real; NaN compares as false too
                return sympy.false
        case Binary(op, left, right):
            a, b = _convert(left), _convert(right)
            return _bounded(a + b if op == "+" else a - b if op == "-" else a * b if op == "*" else a / b)


def _called(function: str, arguments: Sequence[Node]) -> Any:
    import sympy

    if function == "where":
        condition, first, second = map(_convert, arguments)
        return sympy.Piecewise((first, condition), (second, True))
    shown = FUNCTIONS[function].sympy
    if not shown.isidentifier():
        return _convert(substituted(template(shown), arguments))
    converted = list(map(_convert, arguments))
    try:
        return getattr(sympy, shown)(*converted)
    except (TypeError, ValueError, ZeroDivisionError):  # not defined there: mod(x, 0), or of complex numbers
        return sympy.nan


def _numerical(factor: Any, bits: float) -> Any:
    """A number: exact as it is if it has up to `bits` bits, else in floating point with a float's range."""
    import sympy

    if factor.is_Rational and max(abs(int(factor.p)).bit_length(), int(factor.q).bit_length()) <= bits:
        return factor
    approximate = factor.evalf()
    if not approximate.is_Float:
        return factor  # infinite, NaN or complex
    value = float(approximate)
    return approximate if math.isfinite(value) and (value != 0 or approximate == 0) else sympy.Float(value)


def _bounded(value: Any) -> Any:
    """`value`, with its numerical factor in floating point where that is a long number."""
    factor, rest = value.as_coeff_Mul()
    return _numerical(factor, _MAX_BITS) * rest


def _power(base: Any, exponent: Any) -> Any:
    if exponent.is_Number and exponent.is_finite:
        size = max(abs(float(exponent)), 1.0)
        factor, rest = base.as_independent(*base.free_symbols, as_Add=False)
        if factor.is_Rational or size > _LARGE_POWER:
            base = _numerical(factor, _MAX_BITS / size) * rest
    return _bounded(base**exponent)


# Binding strength: what binds less than its place asks for gets brackets.
_COMPARISON, _SUM, _PRODUCT, _UNARY, _POWER, _ATOM = range(6)
_STRENGTH = {"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _ATOM, "**": _POWER}

_SIGNS = {"+": "+", "-": "\N{MINUS SIGN}", "<=": "≤", ">=": "≥", "==": "=", "!=": "≠", "<": "&lt;", ">": "&gt;"}
_CONSTANTS = {"pi": "π", "e": "e"}
_FUNCTIONS = {"sign": "sgn", "log": "ln"}
_INVISIBLE_TIMES = '<mo rspace="0.17em">&#x2062;</mo>'


def mathml(expression: Expression, names: Mapping[str, str] | None = None, factor: bool = False) -> str:
    """The expression in presentation MathML, one ``mrow``; a `factor` after a coefficient gets brackets if needed.

    `names` has MathML of symbols that are not written by their names, such as ``symbol_mathml("x", dots=1)`` of v.

    >>> from bayeq.expressions import parse
    >>> mathml(parse("x**3"))
    '<mrow><msup><mi>x</mi><mn>3</mn></msup></mrow>'
    """
    text = _set(expression.tree, names or {}, _PRODUCT if factor else _COMPARISON)
    if factor and text.startswith("<mn>"):
        text = f"<mo>(</mo>{text}<mo>)</mo>"
    return f"<mrow>{text}</mrow>"


def symbol_mathml(name: str, dots: int = 0) -> str:
    """A name, letters after the first underscore as its index, with a dot above for each derivative.

    >>> symbol_mathml("x", dots=1)
    '<mover><mi>x</mi><mo stretchy="false">˙</mo></mover>'
    >>> symbol_mathml("x_1")
    '<msub><mi>x</mi><mi>1</mi></msub>'
    """
    base, _, index = name.partition("_")
    if not base or not index:
        base, index = name, ""
    letter = f"<mi>{escape(base)}</mi>"
    if dots:
        mark = ("", "˙", "¨", "⃛", "⃜")[dots]
        letter = f'<mover>{letter}<mo stretchy="false">{mark}</mo></mover>'
    return f"<msub>{letter}<mi>{escape(index)}</mi></msub>" if index else letter


def step_mathml(name: str) -> str:
    """A channel of a map at its sample: x[-1] is x with the index k-1.

    >>> step_mathml("x[-1]")
    '<msub><mi>x</mi><mrow><mi>k</mi><mo>−</mo><mn>1</mn></mrow></msub>'
    """
    name, _, step = name.rstrip("]").partition("[")
    base, _, index = name.partition("_")
    front = f"<mi>{escape(index)}</mi><mo>,</mo>" if base and index else ""
    away = f"<mo>{_SIGNS[step[0]]}</mo><mn>{step[1:]}</mn>" if step else ""
    letter = escape(base if front else name)
    return f"<msub><mi>{letter}</mi><mrow>{front}<mi>k</mi>{away}</mrow></msub>"


def step_latex(name: str) -> str:
    r"""A channel of a map at its sample, in LaTeX.

    >>> step_latex("x[+1]"), step_latex("x_a")
    ('x_{k+1}', 'x_{a,k}')
    """
    import sympy

    name, _, step = name.rstrip("]").partition("[")
    base, _, index = sympy.latex(sympy.Symbol(name)).partition("_")
    front = index.strip("{}") + "," if index else ""
    return f"{base}_{{{front}k{step}}}"


def number_mathml(text: str) -> str:
    """A number without sign as Python prints it, powers of ten written out.

    >>> number_mathml("9.96e+04")
    '<mn>9.96</mn><mo>×</mo><msup><mn>10</mn><mn>4</mn></msup>'
    """
    mantissa, e, power = text.partition("e")
    if not e:
        return f"<mn>{escape(mantissa)}</mn>"
    sign = "<mo>\N{MINUS SIGN}</mo>" if power.startswith("-") else ""
    digits = f"<mn>{int(power.lstrip('+-'))}</mn>"
    exponent = f"<mrow>{sign}{digits}</mrow>" if sign else digits
    return f"<mn>{escape(mantissa)}</mn><mo>×</mo><msup><mn>10</mn>{exponent}</msup>"


def _set(node: Node, names: Mapping[str, str], least: int) -> str:
    """MathML of a node, in brackets if it binds less than `least`."""
    text, strength = _bare(node, names)
    return f"<mrow><mo>(</mo>{text}<mo>)</mo></mrow>" if strength < least else text


def _bare(node: Node, names: Mapping[str, str]) -> tuple[str, int]:
    """MathML of a node, and how strongly it binds."""
    match node:
        case Number(value):
            return number_mathml(f"{value:.6g}" if isinstance(value, float) else str(value)), _ATOM
        case Constant(name):
            return f"<mi>{_CONSTANTS.get(name, escape(name))}</mi>", _ATOM
        case Unknown(name):
            return symbol_mathml(name), _ATOM
        case Symbol(name):
            return names.get(name) or symbol_mathml(name), _ATOM
        case Negate(operand):
            return f"<mo>\N{MINUS SIGN}</mo>{_set(operand, names, _PRODUCT)}", _SUM
        case Call(function, arguments):
            return _call(function, [_set(one, names, _COMPARISON) for one in arguments]), _ATOM
        case Binary("/", left, right):
            above, below = (f"<mrow>{_set(one, names, _COMPARISON)}</mrow>" for one in (left, right))
            return f"<mfrac>{above}{below}</mfrac>", _ATOM
        case Binary("**", left, right):
            base, power = _one(_set(left, names, _ATOM)), _one(_set(right, names, _COMPARISON))
            return f"<msup>{base}{power}</msup>", _POWER
        case Binary("*", left, right):
            return f"{_set(left, names, _PRODUCT)}{_INVISIBLE_TIMES}{_set(right, names, _UNARY)}", _PRODUCT
        case Binary(op, left, right):
            strength = _STRENGTH.get(op, _COMPARISON)
            sign = f"<mo>{_SIGNS[op]}</mo>"
            return f"{_set(left, names, strength)}{sign}{_set(right, names, strength + 1)}", strength


def _one(text: str) -> str:
    """Several elements in one ``mrow``; a single one stays as it is."""
    single = text.startswith(("<mi>", "<mn>")) and text.count("<") == 2
    return text if single else f"<mrow>{text}</mrow>"


def _call(function: str, arguments: list[str]) -> str:
    if function == "abs":
        return f'<mrow><mo fence="true">|</mo>{arguments[0]}<mo fence="true">|</mo></mrow>'
    if function == "sqrt":
        return f"<msqrt>{arguments[0]}</msqrt>"
    if function == "exp":
        return f"<msup><mi>e</mi><mrow>{arguments[0]}</mrow></msup>"
    inside = "<mo>,</mo>".join(arguments)
    name = escape(_FUNCTIONS.get(function, function))
    return f"<mi>{name}</mi><mo>&#x2061;</mo><mrow><mo>(</mo>{inside}<mo>)</mo></mrow>"
