"""Expressions as SymPy objects and LaTeX."""

from __future__ import annotations

import math
from typing import Any

from bayeq.expressions.functions import FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Expression, Negate, Node, Number, Symbol

__all__ = ["latex", "to_sympy"]

# SymPy computes powers of integers exactly, 9**9**9 with all its digits. What exceeds the range of a float
# becomes a SymPy Float, whose size does not grow with its exponent.
_MAX_BITS = 1024


def to_sympy(expression: Expression) -> Any:
    """The expression as a SymPy object.

    Integers become `sympy.Integer` (so that ``1/3`` is the rational), other numbers `sympy.Float`, names
    plain symbols. Built from the tree; no text is handed to ``sympify``.

    Parameters
    ----------
    expression : Expression
        From `parse`.

    Returns
    -------
    sympy.Expr
        SymPy's automatic simplification applies (``x + x`` is ``2*x``); exact numbers beyond 1024 bits
        become `sympy.Float`.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> to_sympy(parse("v*abs(v)+x**2/3"))
    v*Abs(v) + x**2/3
    """
    return _convert(expression.tree)


def latex(expression: Expression) -> str:
    r"""The expression in LaTeX, as written by SymPy.

    Parameters
    ----------
    expression : Expression
        From `parse`.

    Returns
    -------
    str

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
        case Symbol(name):
            return sympy.Symbol(name)
        case Negate(operand):
            return -_convert(operand)
        case Call(function, argument):
            return getattr(sympy, FUNCTIONS[function].sympy)(_convert(argument))
        case Binary("**", left, right):
            return _power(_convert(left), _convert(right))
        case Binary(op, left, right):
            a, b = _convert(left), _convert(right)
            return _bounded(a + b if op == "+" else a - b if op == "-" else a * b if op == "*" else a / b)


def _bits(rational: Any) -> int:
    return max(abs(int(rational.p)).bit_length(), int(rational.q).bit_length())


def _bounded(value: Any, bits: float = _MAX_BITS) -> Any:
    """`value`, its numerical factor as a Float if that has more than `bits` bits."""
    import sympy

    factor, rest = value.as_coeff_Mul()
    if factor.is_Rational and not factor.is_infinite and _bits(factor) > bits:
        return sympy.Float(factor) * rest
    return value


def _power(base: Any, exponent: Any) -> Any:
    import sympy

    if exponent.is_Rational and exponent.is_finite and exponent != 0:
        size = abs(float(exponent))
        if size > _MAX_BITS:
            exponent = sympy.Float(exponent)
        base = _bounded(base, _MAX_BITS / max(size, 1.0) if size < math.inf else 0)
    return base**exponent
