"""The functions that a term may call: one table for parsing, evaluating, compiling and SymPy.

A new function is a row here, an opcode, and in `bayeq.expressions.tape.apply_function` a line for its value and its
derivative.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["FUNCTIONS", "Function"]

# Opcodes below 16 are the arithmetic of the tape.
SIN, COS, TAN, ASIN, ACOS, ATAN, EXP, LOG, SQRT, ABS, SIGN, SINH, COSH, TANH = range(16, 30)


class Function(NamedTuple):
    """A function of one real argument."""

    numpy: np.ufunc
    opcode: int
    sympy: str


FUNCTIONS: dict[str, Function] = {
    "sin": Function(np.sin, SIN, "sin"),
    "cos": Function(np.cos, COS, "cos"),
    "tan": Function(np.tan, TAN, "tan"),
    "asin": Function(np.arcsin, ASIN, "asin"),
    "acos": Function(np.arccos, ACOS, "acos"),
    "atan": Function(np.arctan, ATAN, "atan"),
    "exp": Function(np.exp, EXP, "exp"),
    "log": Function(np.log, LOG, "log"),
    "sqrt": Function(np.sqrt, SQRT, "sqrt"),
    "abs": Function(np.abs, ABS, "Abs"),
    "sign": Function(np.sign, SIGN, "sign"),
    "sinh": Function(np.sinh, SINH, "sinh"),
    "cosh": Function(np.cosh, COSH, "cosh"),
    "tanh": Function(np.tanh, TANH, "tanh"),
}
