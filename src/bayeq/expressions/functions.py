"""The functions, comparisons and constants of a term: one table for parsing, evaluating, compiling and SymPy.

A new function is a row here. Where its row defines it by other functions, that is all. Otherwise it has an opcode, and
in the kernels below a line for its value and its derivative, which `bayeq.expressions.evaluate` calls.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from bayeq.kernels import kernel

# The time [s], where no channel has that name.
TIME = "t"

# Names of numbers, where no channel has them.
CONSTANTS = {"pi": math.pi, "e": math.e}

# Opcodes below 16 are the arithmetic of the tape, those from PAIRS on take two operands.
SIN, COS, TAN, ASIN, ACOS, ATAN, EXP, LOG, SQRT, ABS, SIGN, SINH, COSH, TANH = range(16, 30)
ASINH, ACOSH, ATANH, LOG10, LOG1P, CBRT, ERF, FLOOR = range(30, 38)
PAIRS = 64
MAX, MIN, ATAN2, MOD, LESS, AT_MOST, MORE, AT_LEAST, EQUAL, OTHER, PICK, UNLESS = range(PAIRS, PAIRS + 12)
NONE = 0


class Function(NamedTuple):
    """A function of real arguments."""

    numpy: Callable[..., Any]  # its values on columns
    opcode: int  # its instruction on the tape; NONE for a function compiled from others
    sympy: str  # SymPy's name, or an expression of other functions in a and b, which SymPy shows instead
    arguments: tuple[int, int | None] = (1, 1)  # how many it takes, at least and at most
    definition: str = ""  # by other functions in a and b, for the tape
    meaning: str = ""  # for the documentation
    also: tuple[str, ...] = ()  # other spellings


class Comparison(NamedTuple):
    """A comparison of two numbers, 1 where it holds and 0 elsewhere."""

    numpy: np.ufunc
    opcode: int
    sympy: str


COMPARISONS: dict[str, Comparison] = {
    "<": Comparison(np.less, LESS, "Lt"),
    "<=": Comparison(np.less_equal, AT_MOST, "Le"),
    ">": Comparison(np.greater, MORE, "Gt"),
    ">=": Comparison(np.greater_equal, AT_LEAST, "Ge"),
    "==": Comparison(np.equal, EQUAL, "Eq"),
    "!=": Comparison(np.not_equal, OTHER, "Ne"),
}


def _erf(a: Any) -> Any:
    from scipy.special import erf

    return erf(a)


def _where(condition: Any, a: Any, b: Any) -> Any:
    return np.where(condition, a, b)[()]


def _over(pair: np.ufunc) -> Callable[..., Any]:
    """A function of several numbers, from one of two."""
    return lambda *values: reduce(pair, values)


FUNCTIONS: dict[str, Function] = {
    "sin": Function(np.sin, SIN, "sin", meaning="sine"),
    "cos": Function(np.cos, COS, "cos", meaning="cosine"),
    "tan": Function(np.tan, TAN, "tan", meaning="tangent"),
    "asin": Function(np.arcsin, ASIN, "asin", meaning="inverse sine", also=("arcsin",)),
    "acos": Function(np.arccos, ACOS, "acos", meaning="inverse cosine", also=("arccos",)),
    "atan": Function(np.arctan, ATAN, "atan", meaning="inverse tangent", also=("arctan",)),
    "exp": Function(np.exp, EXP, "exp", meaning="exponential"),
    "log": Function(np.log, LOG, "log", meaning="natural logarithm", also=("ln",)),
    "sqrt": Function(np.sqrt, SQRT, "sqrt", meaning="square root"),
    "abs": Function(np.abs, ABS, "Abs", meaning="magnitude", also=("Abs", "fabs")),
    "sign": Function(np.sign, SIGN, "sign", meaning="-1, 0 or 1", also=("sgn",)),
    "sinh": Function(np.sinh, SINH, "sinh", meaning="hyperbolic sine"),
    "cosh": Function(np.cosh, COSH, "cosh", meaning="hyperbolic cosine"),
    "tanh": Function(np.tanh, TANH, "tanh", meaning="hyperbolic tangent"),
    "asinh": Function(np.arcsinh, ASINH, "asinh", meaning="inverse hyperbolic sine", also=("arcsinh",)),
    "acosh": Function(np.arccosh, ACOSH, "acosh", meaning="inverse hyperbolic cosine", also=("arccosh",)),
    "atanh": Function(np.arctanh, ATANH, "atanh", meaning="inverse hyperbolic tangent", also=("arctanh",)),
    "log10": Function(np.log10, LOG10, "log(a)/log(10)", meaning="logarithm to base 10"),
    "log1p": Function(np.log1p, LOG1P, "log(1+a)", meaning="log(1 + a), accurate for small a"),
    "cbrt": Function(np.cbrt, CBRT, "sign(a)*abs(a)**(1/3)", meaning="cube root, of negative numbers too"),
    "erf": Function(_erf, ERF, "erf", meaning="error function"),
    "floor": Function(np.floor, FLOOR, "floor", meaning="the next whole number below"),
    "ceil": Function(
        np.ceil, NONE, "ceiling", definition="-floor(-a)", meaning="the next whole number above", also=("ceiling",)
    ),
    "relu": Function(
        lambda a: np.maximum(a, 0.0), NONE, "max(0,a)", definition="max(a,0)", meaning="a where it is positive, else 0"
    ),
    "heaviside": Function(
        lambda a: np.heaviside(a, 0.5),
        NONE,
        "Heaviside",
        definition="(1+sign(a))/2",
        meaning="unit step: 0 below zero, 1 above, 1/2 at zero",
        also=("step", "Heaviside"),
    ),
    "sigmoid": Function(
        lambda a: 0.5 + 0.5 * np.tanh(0.5 * a),
        NONE,
        "1/(1+exp(-a))",
        definition="0.5+0.5*tanh(0.5*a)",
        meaning="logistic function 1/(1 + exp(-a))",
    ),
    "max": Function(
        _over(np.maximum), MAX, "Max", (2, None), meaning="the largest of two or more", also=("maximum", "Max")
    ),
    "min": Function(
        _over(np.minimum), MIN, "Min", (2, None), meaning="the smallest of two or more", also=("minimum", "Min")
    ),
    "atan2": Function(
        np.arctan2, ATAN2, "atan2", (2, 2), meaning="angle of the point (b, a), from -pi to pi", also=("arctan2",)
    ),
    "mod": Function(
        np.mod, MOD, "Mod", (2, 2), meaning="a - b floor(a/b): the remainder, with the sign of b", also=("Mod",)
    ),
    "where": Function(_where, NONE, "Piecewise", (3, 3), meaning="the second where the first holds, else the third"),
}

# Other spellings of functions; the function's own name is what is printed.
ALIASES: dict[str, str] = {other: name for name, function in FUNCTIONS.items() for other in function.also}

# square(a) is a**2.
SQUARE = "square"


@kernel(borrowing=True)
def apply_function(opcode: int, a: float, slope: bool) -> float:
    """Value of the function with this opcode at `a`, or its derivative there; NaN if there is no such opcode."""
    if opcode == ABS:
        return (1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0) if slope else abs(a)
    if opcode == SIGN:
        return 0.0 if slope else 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0 if a == 0.0 else a
    if opcode == SIN:
        return math.cos(a) if slope else math.sin(a)
    if opcode == COS:
        return -math.sin(a) if slope else math.cos(a)
    if opcode == TAN:
        return 1.0 + math.tan(a) ** 2 if slope else math.tan(a)
    if opcode == ASIN:
        return 1.0 / math.sqrt(1.0 - a * a) if slope else math.asin(a)
    if opcode == ACOS:
        return -1.0 / math.sqrt(1.0 - a * a) if slope else math.acos(a)
    if opcode == ATAN:
        return 1.0 / (1.0 + a * a) if slope else math.atan(a)
    if opcode == EXP:
        return math.exp(a)
    if opcode == LOG:
        return 1.0 / a if slope else math.log(a)
    if opcode == SQRT:
        return 0.5 / math.sqrt(a) if slope else math.sqrt(a)
    if opcode == SINH:
        return math.cosh(a) if slope else math.sinh(a)
    if opcode == COSH:
        return math.sinh(a) if slope else math.cosh(a)
    if opcode == TANH:
        return 1.0 - math.tanh(a) ** 2 if slope else math.tanh(a)
    return _further_function(opcode, a, slope)


@kernel(borrowing=True)
def _further_function(opcode: int, a: float, slope: bool) -> float:
    """As `apply_function`, for the rarer functions."""
    if opcode == FLOOR:
        return 0.0 if slope else np.floor(a)
    if opcode == ASINH:
        return 1.0 / math.sqrt(1.0 + a * a) if slope else math.asinh(a)
    if opcode == ACOSH:
        return 1.0 / math.sqrt(a * a - 1.0) if slope else math.acosh(a)
    if opcode == ATANH:
        return 1.0 / (1.0 - a * a) if slope else math.atanh(a)
    if opcode == LOG10:
        return 1.0 / (a * math.log(10.0)) if slope else math.log10(a)
    if opcode == LOG1P:
        return 1.0 / (1.0 + a) if slope else math.log1p(a)
    if opcode == CBRT:
        root = np.cbrt(a)
        return 1.0 / (3.0 * root * root) if slope else root
    if opcode == ERF:
        return 2.0 / math.sqrt(math.pi) * math.exp(-a * a) if slope else math.erf(a)
    return math.nan


@kernel(borrowing=True)
def apply_pair(opcode: int, a: float, b: float) -> tuple[float, float, float]:
    """Value of a function of two numbers, and its derivatives by them; NaN if there is no such opcode."""
    if opcode == PICK:
        return (b, 0.0, 1.0) if a != 0.0 else (0.0, 0.0, 0.0)
    if opcode == UNLESS:
        return (0.0, 0.0, 0.0) if a != 0.0 else (b, 0.0, 1.0)
    if opcode == MAX:
        return (a, 1.0, 0.0) if a >= b or a != a else (b, 0.0, 1.0)
    if opcode == MIN:
        return (a, 1.0, 0.0) if a <= b or a != a else (b, 0.0, 1.0)
    if opcode == ATAN2:
        # by the ratio that is at most 1: squares overflow
        steep = abs(a) > abs(b)
        ratio, larger = (b / a, a) if steep else (a / b, b)
        unit = 1.0 / (larger * (1.0 + ratio * ratio))
        return math.atan2(a, b), (ratio if steep else 1.0) * unit, (-1.0 if steep else -ratio) * unit
    if opcode == MOD:
        return np.mod(a, b), 1.0, -np.floor(a / b)
    holds = math.nan
    if opcode == LESS:
        holds = 1.0 if a < b else 0.0
    elif opcode == AT_MOST:
        holds = 1.0 if a <= b else 0.0
    elif opcode == MORE:
        holds = 1.0 if a > b else 0.0
    elif opcode == AT_LEAST:
        holds = 1.0 if a >= b else 0.0
    elif opcode == EQUAL:
        holds = 1.0 if a == b else 0.0
    elif opcode == OTHER:
        holds = 1.0 if a != b else 0.0
    return holds, 0.0, 0.0
