"""Jumps of what is known with an error: their mean, which changes smoothly where the term jumps.

Where friction acts is known no better than the velocity is. A linearised model has no use for a jump: its derivative is
zero but for a place that no sample meets. The mean of the sign over the error of its argument, m +- w, is
erf(m / (sqrt(2) w)), taken here as tanh(m / (1.25 w)), which has the same slope at zero (statistical linearisation,
Roberts and Spanos 1990). Steps, comparisons and what rounds down are signs of something. Kinks (abs, max, relu) have a
derivative on both sides, and stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from bayeq.arrays import Floats
from bayeq.expressions import Binary, Call, Evaluator, Expression, Negate, Node, Number, number
from bayeq.expressions.nodes import arguments_of, is_comparison, jump_of, with_arguments

# Slope of the mean of a sign at zero: sqrt(2 / pi) / w.
SLOPE = math.sqrt(2.0 / math.pi)


def mean_of_jumps(node: Node, blur: Mapping[Node, Node]) -> Node:
    """A term with the mean of each jump in `blur`, which has the error of its argument by what `jumps_of` gives."""

    def mean(jump: Call) -> Node | None:
        width = blur.get(jump)
        return None if width is None else _mean(jump, mean_of_jumps(jump.arguments[0], blur), width)

    return _with_values(node, mean)


def _with_values(node: Node, value_of: Callable[[Call], Node | None]) -> Node:
    """A term with values in place of jumps, where there are any."""
    parts = tuple(_with_values(part, value_of) for part in arguments_of(node))
    jump = jump_of(node)
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


def _mean(jump: Call, argument: Node, width: Node) -> Node:
    """Mean of a sign or a floor."""
    above, _, distance = _sides(Call(jump.function, (argument,)))
    sign = Call("tanh", (Binary("/", Binary("*", distance, number(SLOPE)), width),))
    return sign if jump.function == "sign" else Binary("-", above, _share(sign, "-"))


def _sides(jump: Call) -> tuple[Node, Node, Node]:
    """Values of a sign or a floor above and below its jump, and the distance of the argument from there."""
    argument = jump.arguments[0]
    if jump.function == "sign":
        return number(1.0), number(-1.0), argument
    nearest = Call("floor", (Binary("+", argument, number(0.5)),))  # where it jumps next
    return nearest, Binary("-", nearest, number(1.0)), Binary("-", argument, nearest)


def half_of_jump(term: Expression, jump: Call, evaluate: Evaluator) -> Floats | float:
    """Half of what a term changes by where it jumps, (n,); 0 of one that does not jump there."""
    above, below, _ = _sides(jump)
    upper, lower = (_with_values(term.tree, {jump: side}.get) for side in (above, below))
    return 0.5 * (evaluate(Expression(upper)) - evaluate(Expression(lower))) if upper != lower else 0.0


def middle_of_jump(term: Expression, jump: Call, evaluate: Evaluator) -> Floats | float:
    """A term halfway through a jump of a sign, (n,)."""
    return evaluate(Expression(_with_values(term.tree, {jump: number(0.0)}.get)))


def unresolved_share(jump: Call, evaluate: Evaluator, width: Floats, error: Floats) -> Floats:
    """Mean square of what the mean of a jump over `width`, (n,), is off where the path errs by `error`, (n,), in
    units of the square of its half."""
    values = SLOPE * evaluate(Expression(_sides(jump)[2]))
    taken, true = np.tanh(values / width), np.tanh(values / error)
    return np.asarray(1.0 - 2.0 * taken * true + taken**2)


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
