"""Terms and right-hand sides as text: parsed safely, evaluated fast, handed to kernels and to SymPy.

`parse` makes an `Expression`; `Evaluator` evaluates it on columns of samples, `Tape` point by point inside
kernels; `to_sympy` and `latex` show it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayeq.expressions.evaluate import Evaluator, FloatArray
from bayeq.expressions.functions import FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, number
from bayeq.expressions.parse import parse
from bayeq.expressions.symbolic import latex, to_sympy

if TYPE_CHECKING:
    from bayeq.expressions.tape import Tape, run_tape
else:

    def __getattr__(name: str) -> object:
        """Tapes need numba, which is slow to import: they are loaded where used."""
        if name in ("Tape", "run_tape"):
            from bayeq.expressions import tape

            return getattr(tape, name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "FUNCTIONS",
    "Binary",
    "Call",
    "Constant",
    "Evaluator",
    "Expression",
    "FloatArray",
    "Negate",
    "Node",
    "Number",
    "Symbol",
    "Tape",
    "latex",
    "number",
    "parse",
    "run_tape",
    "to_sympy",
]
