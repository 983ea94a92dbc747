"""Signs of what is known with an error: their mean, which changes smoothly where the sign jumps.

Where friction acts is known no better than the velocity is. A linearised model has no use for a jump: its derivative is
zero but for a place that no sample meets. The mean of the sign over the error of its argument, m +- w, is
erf(m / (sqrt(2) w)), taken here as tanh(m / (1.25 w)), which has the same slope at zero (statistical linearisation,
Roberts and Spanos 1990).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Binary, Call, Evaluator, Expression, Negate, Node, Number, Symbol, number

__all__ = ["arguments_of_signs", "error_where_it_changes", "mean_of_signs", "variance_of_signs"]

Floats = NDArray[np.float64]

# Variance of a uniform distribution over an interval of length 1.
UNIFORM = 1.0 / 12.0

# Errors along the path are no less than this share of those that means are taken over.
LEAST = 1e-3

# Slope of the mean of a sign at zero: sqrt(2 / pi) / w.
SLOPE = math.sqrt(2.0 / math.pi)


def arguments_of_signs(node: Node) -> Iterator[Node]:
    """What a term takes the sign of."""
    if isinstance(node, Call):
        if node.function == "sign":
            yield node.argument
        yield from arguments_of_signs(node.argument)
    elif isinstance(node, Negate):
        yield from arguments_of_signs(node.operand)
    elif isinstance(node, Binary):
        yield from arguments_of_signs(node.left)
        yield from arguments_of_signs(node.right)


def mean_of_signs(node: Node, blur: Mapping[Node, float]) -> Node:
    """A term with the mean of each sign whose argument has an error in `blur`."""
    if isinstance(node, Number | Symbol):
        return node
    if isinstance(node, Negate):
        return Negate(mean_of_signs(node.operand, blur))
    if isinstance(node, Binary):
        return Binary(node.op, mean_of_signs(node.left, blur), mean_of_signs(node.right, blur))
    argument = mean_of_signs(node.argument, blur)
    width = blur.get(node.argument, 0.0) if node.function == "sign" else 0.0
    if width > 0.0:
        return Call("tanh", Binary("*", argument, number(SLOPE / width)))
    return Call(node.function, argument)


def variance_of_signs(
    terms: Sequence[Expression],
    coef: Floats,
    columns: Mapping[str, Floats],
    blur: Mapping[Node, float],
    errors: Mapping[Node, float],
) -> Floats:
    """What the mean of signs leaves out of a sum of terms.

    Parameters
    ----------
    terms : sequence of Expression
        The terms.
    coef : (r,) array
        Their coefficients.
    columns : mapping of str to (n,) array
        States and inputs.
    blur : mapping of Node to float
        Errors by which the mean of their signs was taken.
    errors : mapping of Node to float
        Errors along the path alone.

    Returns
    -------
    (n,) array
        The mean square of what the sum is off.
    """
    evaluate = Evaluator(columns)
    out = np.zeros(len(next(iter(columns.values()))))
    for argument, width in blur.items():
        if width <= 0.0:
            continue
        jump = np.zeros(len(out))
        for term, theta in zip(terms, coef.tolist(), strict=True):
            above, below = (_with_sign(term.tree, argument, side) for side in (1.0, -1.0))
            if above != below:
                jump += 0.5 * theta * (evaluate(Expression(above)) - evaluate(Expression(below)))
        if jump.any():
            values = SLOPE * evaluate(Expression(argument))
            taken, true = np.tanh(values / width), np.tanh(values / max(errors[argument], LEAST * width))
            out += jump**2 * (1.0 - 2.0 * taken * true + taken**2)
    return out


def _with_sign(node: Node, argument: Node, value: float) -> Node:
    """A term with a value in place of the sign of an argument."""
    if isinstance(node, Number | Symbol):
        return node
    if isinstance(node, Negate):
        return Negate(_with_sign(node.operand, argument, value))
    if isinstance(node, Binary):
        return Binary(node.op, _with_sign(node.left, argument, value), _with_sign(node.right, argument, value))
    if node.function == "sign" and node.argument == argument:
        return number(value)
    return Call(node.function, _with_sign(node.argument, argument, value))


def error_where_it_changes(argument: Node, columns: Mapping[str, Floats], covariance: Floats) -> tuple[float, float]:
    """Standard deviation of an argument at the samples between which its sign changes, and next to them.

    It has an error along the path, and changes from one sample to the next. Both are 0 if the sign does not change.

    Parameters
    ----------
    argument : Node
        What a term takes the sign of.
    columns : mapping of str to (n,) array
        The states, first and in the order of `covariance`, and the exact inputs.
    covariance : (n, S, S) array
        Of the states.
    """
    expression = Expression(argument)
    values = Evaluator(columns)(expression)
    places = np.flatnonzero(np.diff(np.signbit(values)))
    if not len(places):
        return 0.0, 0.0
    here = {name: column[places] for name, column in columns.items()}
    gradient = np.zeros((len(places), covariance.shape[1]))
    for i, name in enumerate(list(columns)[: covariance.shape[1]]):
        if name in expression.names:
            sd = np.sqrt(np.maximum(covariance[places, i, i], 0.0)) + np.finfo(float).tiny
            gradient[:, i] = (Evaluator(here | {name: here[name] + sd})(expression) - values[places]) / sd
    along = np.einsum("ni,nij,nj->n", gradient, covariance[places], gradient)
    steps = np.diff(values)[places]
    own = float(np.mean(along))
    return math.sqrt(own), math.sqrt(own + UNIFORM * float(np.mean(steps**2)))
