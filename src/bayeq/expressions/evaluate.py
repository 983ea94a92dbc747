"""``Evaluator``: expressions on whole columns of samples, sharing what they have in common."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions.functions import COMPARISONS, CONSTANTS, FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Constant, Expression, Negate, Node, Number, Symbol, Unknown

# Integer powers up to here are products, x**5 = x**4*x, so that the monomials of a dictionary share them.
MAX_INTEGER_POWER = 16

ARITHMETIC: dict[str, np.ufunc] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "**": np.power,
}


class Evaluator:
    """Evaluates expressions on columns; every sub-expression is computed once.

    Columns are the channels (arrays of one common shape, usually ``(n,)``) and parameters (floats) by name; InputError
    if the arrays differ in shape. Results are read-only, since later results may share them; all intermediate results
    live as long as the evaluator. Numerical trouble (division by zero, overflow, the logarithm of a negative number)
    gives non-finite values and no warning: the caller judges. ``sign(0)`` is 0.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> evaluate = Evaluator({"x": [1.0, 2.0, 3.0], "k": 2.0})
    >>> evaluate(parse("k*x**2"))
    array([ 2.,  8., 18.])
    """

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        # Values are float64 arrays of the common shape, or np.float64 where constant; never 0-d arrays.
        self._memo: dict[Node, Floats | np.float64] = {}
        self._powers: dict[Node, list[Floats | np.float64]] = {}
        self._names = list(columns)
        shapes: dict[tuple[int, ...], str] = {}
        for name, column in columns.items():
            array = np.asarray(column, dtype=np.float64)
            if array.ndim == 0:
                self._memo[Symbol(name)] = np.float64(array)
                continue
            shapes.setdefault(array.shape, name)
            view = array.view()
            view.flags.writeable = False
            self._memo[Symbol(name)] = view
        if len(shapes) > 1:
            (one, first), (two, second) = list(shapes.items())[:2]
            raise InputError(f"columns differ in shape: {first!r} has {one}, {second!r} has {two}")
        self._shape = next(iter(shapes), ())

    def __call__(self, expression: Expression) -> Floats:
        """Values of the expression, of the columns' shape (``()`` if there are only floats); read-only.

        UnknownNameError: if the expression uses a name that is not a column.
        """
        with np.errstate(all="ignore"):
            value = self._value(expression.tree)
        if isinstance(value, np.float64):
            value = np.full(self._shape, value)
        value.flags.writeable = False
        return value

    def _value(self, node: Node) -> Floats | np.float64:
        value = self._memo.get(node)
        if value is None:
            value = self._memo[node] = self._compute(node)
        return value

    def _compute(self, node: Node) -> Floats | np.float64:
        result: Floats | np.float64
        if isinstance(node, Binary):
            if node.op == "**":
                return self._power(node.left, self._value(node.right))
            if node.op in COMPARISONS:
                return COMPARISONS[node.op].numpy(self._value(node.left), self._value(node.right)) * np.float64(1.0)
            result = ARITHMETIC[node.op](self._value(node.left), self._value(node.right))
            return result
        if isinstance(node, Call):
            result = FUNCTIONS[node.function].numpy(*map(self._value, node.arguments))
            return result
        if isinstance(node, Negate):
            return -self._value(node.operand)
        if isinstance(node, Number | Unknown):
            return np.float64(node.value)
        if isinstance(node, Constant):
            return np.float64(CONSTANTS[node.name])
        raise UnknownNameError("channel", node.name, self._names)

    def _power(self, base: Node, exponent: Floats | np.float64) -> Floats | np.float64:
        value = self._value(base)
        if not isinstance(exponent, np.float64) or not exponent.is_integer() or abs(exponent) > MAX_INTEGER_POWER:
            result: Floats | np.float64 = np.power(value, exponent)
            return result
        k = int(exponent)
        if k == 0:
            return np.float64(1.0)
        powers = self._powers.get(base)
        if powers is None:
            powers = self._powers[base] = [value]
        while len(powers) < abs(k):
            powers.append(powers[-1] * value)
        return powers[k - 1] if k > 0 else np.float64(1.0) / powers[-k - 1]
