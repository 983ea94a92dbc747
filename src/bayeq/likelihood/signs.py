"""Jumps of what is known with an error: their mean, which changes smoothly where the term jumps.

Where friction acts is known no better than the velocity is. A linearised model has no use for a jump: its derivative is
zero but for a place that no sample meets. The mean of the sign over the error of its argument, m +- w, is
erf(m / (sqrt(2) w)), taken here as tanh(m / (1.25 w)), which has the same slope at zero (statistical linearisation,
Roberts and Spanos 1990). Steps, comparisons and what rounds down are signs of something. Kinks (abs, max, relu) have a
derivative on both sides, and stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Binary, Call, Evaluator, Expression, Negate, Node, Number, number
from bayeq.expressions.nodes import arguments_of, is_comparison, with_arguments

__all__ = ["error_where_it_changes", "jumps_of", "mean_of_jumps", "variance_of_jumps"]

Floats = NDArray[np.float64]

# Variance of a uniform distribution over an interval of length 1.
UNIFORM = 1.0 / 12.0

# Errors along the path are no less than this share of those that means are taken over.
LEAST = 1e-3

# Slope of the mean of a sign at zero: sqrt(2 / pi) / w.
SLOPE = math.sqrt(2.0 / math.pi)


def jumps_of(node: Node) -> Iterator[Call]:
    """The jumps in a term, as signs and floors of what they happen in."""
    jump = _jump(node)
    if jump is not None:
        yield jump
    for part in arguments_of(node):
        yield from jumps_of(part)


def _jump(node: Node) -> Call | None:
    """The sign or floor that a node jumps with."""
    match node:
        case Call("sign" | "heaviside", arguments):
            return Call("sign", arguments)
        case Call("floor", arguments):
            return Call("floor", arguments)
        case Call("ceil", (argument,)):
            return Call("floor", (Negate(argument),))
        case Call("mod", (left, right)):
            return Call("floor", (Binary("/", left, right),))
        case Binary("<" | "<=" | ">" | ">=", left, right):
            return Call("sign", (Binary("-", left, right),))
    return None


def mean_of_jumps(node: Node, blur: Mapping[Node, float]) -> Node:
    """A term with the mean of each jump in `blur`, which has the error of the argument.

    Parameters
    ----------
    node : Node
        The term.
    blur : mapping of Node to float
        By what `jumps_of` gives.
    """

    def mean(jump: Call) -> Node | None:
        width = blur.get(jump, 0.0)
        return _mean(jump, mean_of_jumps(jump.arguments[0], blur), width) if width > 0.0 else None

    return _with_values(node, mean)


def _with_values(node: Node, value_of: Callable[[Call], Node | None]) -> Node:
    """A term with values in place of jumps, where there are any."""
    parts = tuple(_with_values(part, value_of) for part in arguments_of(node))
    jump = _jump(node)
    mean = None if jump is None else value_of(jump)
    if isinstance(node, Call) and node.function == "where":
        return _mixed(*parts)
    if mean is None:
        return with_arguments(node, parts)
    match node:
        case Call("heaviside"):
            return _share(mean, "+")
        case Call("ceil"):
            return Negate(mean)
        case Call("mod"):
            return Binary("-", parts[0], Binary("*", parts[1], mean))
        case Binary(op):
            return _share(mean, "+" if op in (">", ">=") else "-")
    return mean


def _mean(jump: Call, argument: Node, width: float) -> Node:
    """Mean of a sign or a floor."""
    if jump.function == "sign":
        return Call("tanh", (Binary("*", argument, number(SLOPE / width)),))
    nearest = _nearest(argument)
    step = Call("tanh", (Binary("*", Binary("-", argument, nearest), number(SLOPE / width)),))
    return Binary("-", nearest, _share(step, "-"))


def _nearest(argument: Node) -> Node:
    """The whole number at which a floor jumps next."""
    return Call("floor", (Binary("+", argument, number(0.5)),))


def _sides(jump: Call) -> tuple[Node, Node, Node]:
    """Values of a sign or a floor above and below its jump, and the distance of the argument from there."""
    argument = jump.arguments[0]
    if jump.function == "sign":
        return number(1.0), number(-1.0), argument
    nearest = _nearest(argument)
    return nearest, Binary("-", nearest, number(1.0)), Binary("-", argument, nearest)


def variance_of_jumps(
    terms: Sequence[Expression],
    coef: Floats,
    columns: Mapping[str, Floats],
    blur: Mapping[Node, float],
    errors: Mapping[Node, float],
) -> Floats:
    """What the mean of jumps leaves out of a sum of terms.

    Parameters
    ----------
    terms : sequence of Expression
        The terms.
    coef : (r,) array
        Their coefficients.
    columns : mapping of str to (n,) array
        States and inputs.
    blur : mapping of Node to float
        Errors of what jumps by which means were taken, by what `jumps_of` gives.
    errors : mapping of Node to float
        Errors along the path alone.

    Returns
    -------
    (n,) array
        The mean square of what the sum is off.
    """
    evaluate = Evaluator(columns)
    out = np.zeros(len(next(iter(columns.values()))))
    present = {jump for term in terms for jump in jumps_of(term.tree)}
    for jump in sorted(present, key=lambda jump: Expression(jump).text):
        width = blur.get(jump, 0.0)
        if width <= 0.0:
            continue
        above, below, distance = _sides(jump)
        half = np.zeros(len(out))
        for term, theta in zip(terms, coef.tolist(), strict=True):
            upper, lower = (_with_values(term.tree, {jump: side}.get) for side in (above, below))
            if upper != lower:
                half += 0.5 * theta * (evaluate(Expression(upper)) - evaluate(Expression(lower)))
        values = SLOPE * evaluate(Expression(distance))
        taken, true = np.tanh(values / width), np.tanh(values / max(errors[jump], LEAST * width))
        out += half**2 * (1.0 - 2.0 * taken * true + taken**2)
    return out


def _share(mean: Node, sign: str) -> Node:
    """(1 +- mean of a sign)/2: how much of the time it is positive, or negative."""
    return Binary("/", Binary(sign, Number(1), mean), Number(2))


def _mixed(condition: Node, first: Node, second: Node) -> Node:
    """``where`` with a condition that holds some of the time; what never counts may be undefined."""
    if is_comparison(condition):
        return Call("where", (condition, first, second))
    rest = Binary("-", Number(1), condition)
    first = Call("where", (Binary("!=", condition, Number(0)), first, Number(0)))
    second = Call("where", (Binary("!=", rest, Number(0)), second, Number(0)))
    return Binary("+", Binary("*", condition, first), Binary("*", rest, second))


def error_where_it_changes(jump: Call, columns: Mapping[str, Floats], covariance: Floats) -> tuple[float, float]:
    """Standard deviation of what jumps at the samples between which it does, and next to them.

    It has an error along the path, and changes from one sample to the next. Both are 0 if it does not jump.

    Parameters
    ----------
    jump : Call
        A sign or floor, from `jumps_of`.
    columns : mapping of str to (n,) array
        The states, first and in the order of `covariance`, and the exact inputs.
    covariance : (n, S, S) array
        Of the states.
    """
    expression = Expression(jump.arguments[0])
    values = Evaluator(columns)(expression)
    sides = np.signbit(values) if jump.function == "sign" else np.floor(values)
    places = np.flatnonzero(np.diff(sides))
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
