"""Expressions as SymPy objects and LaTeX."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from bayeq.expressions.functions import COMPARISONS, FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown
from bayeq.expressions.parse import substituted, template

__all__ = ["latex", "to_sympy"]

# SymPy computes powers of numbers exactly, 9**9**9 with all its digits. Numbers that do not fit into a float
# are computed in floating point instead, as they are everywhere else.
_MAX_BITS = 1024
_LARGE_POWER = 64


def to_sympy(expression: Expression) -> Any:
    """The expression as a SymPy object, built from the tree; no text is handed to ``sympify``.

    Integers become `sympy.Integer` (so that ``1/3`` is the rational), other numbers `sympy.Float`, names plain symbols,
    ``pi`` and ``e`` SymPy's numbers. SymPy's automatic simplification applies (``x + x`` is ``2*x``); numbers beyond
    the range of a float become infinite, as they do in evaluation.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> to_sympy(parse("v*abs(v)+x**2/3"))
    v*Abs(v) + x**2/3
    """
    return _convert(expression.tree)


def latex(expression: Expression) -> str:
    r"""The expression in LaTeX, as written by SymPy.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> latex(parse("x**2*sin(theta)"))
    'x^{2} \\sin{\\left(\\theta \\right)}'
    """
    import sympy

    return str(sympy.latex(to_sympy(expression)))


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
