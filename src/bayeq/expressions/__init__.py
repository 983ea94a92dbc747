"""Terms and right-hand sides as text: parsed safely, evaluated fast, handed to kernels and to SymPy.

`parse` makes an `Expression`; `Evaluator` evaluates it on columns of samples, `Tape` point by point inside
kernels; `to_sympy` shows it.
"""

from bayeq.expressions.evaluate import Evaluator, Tape, run_tape
from bayeq.expressions.functions import FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown, number
from bayeq.expressions.parse import parse
from bayeq.expressions.symbolic import to_sympy

__all__ = [
    "FUNCTIONS", "Binary", "Call", "Constant", "Evaluator", "Expression", "Negate", "Node", "Number", "Symbol",
    "Tape", "Unknown", "number", "parse", "run_tape", "to_sympy",
]  # fmt: skip
