"""Jumps of an uncertain argument, replaced by their mean, which changes smoothly where the term jumps.

The direction of friction is known no better than the velocity. In a linearised model a jump does nothing: its
derivative is zero except at a point that no sample hits. The mean of the sign of a normal argument, m +- w, is
erf(m / (sqrt(2) w)), taken here as tanh(m / (1.25 w)), which has the same slope at zero (statistical linearisation,
Roberts and Spanos 1990). Steps, comparisons and roundings are written with such signs. Kinks (abs, max, relu) have a
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
    """A term with each jump in `blur` replaced by its mean; `blur` has the width of each jump from `jumps_of`."""

    def mean(jump: Call) -> Node | None:
        width = blur.get(jump)
        return None if width is None else _mean(jump, mean_of_jumps(jump.arguments[0], blur), width)

    return _with_values(node, mean)


def _with_values(node: Node, value_of: Callable[[Call], Node | None]) -> Node:
    """A term with each jump replaced by its ``value_of(jump)``, unless that is None."""
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
    """Mean of a sign or a floor over the width of its argument."""
    above, _, distance = _sides(Call(jump.function, (argument,)))
    sign = Call("tanh", (Binary("/", Binary("*", distance, number(SLOPE)), width),))
    return sign if jump.function == "sign" else Binary("-", above, _share(sign, "-"))


def _sides(jump: Call) -> tuple[Node, Node, Node]:
    """Values of a sign or a floor above and below its nearest jump, and the argument's signed distance from that."""
    argument = jump.arguments[0]
    if jump.function == "sign":
        return number(1.0), number(-1.0), argument
    nearest = Call("floor", (Binary("+", argument, number(0.5)),))  # the nearest jump
    return nearest, Binary("-", nearest, number(1.0)), Binary("-", argument, nearest)


def half_of_jump(term: Expression, jump: Call, evaluate: Evaluator) -> Floats | float:
    """Half of the change of a term across a jump, (n,); 0 if the term does not contain it."""
    above, below, _ = _sides(jump)
    upper, lower = (_with_values(term.tree, {jump: side}.get) for side in (above, below))
    return 0.5 * (evaluate(Expression(upper)) - evaluate(Expression(lower))) if upper != lower else 0.0


def middle_of_jump(term: Expression, jump: Call, evaluate: Evaluator) -> Floats | float:
    """A term with a sign in it set to 0, halfway through its jump, (n,)."""
    return evaluate(Expression(_with_values(term.tree, {jump: number(0.0)}.get)))


def unresolved_share(jump: Call, evaluate: Evaluator, width: Floats, error: Floats) -> Floats:
    """Mean square error of a jump smoothed over `width`, (n,), if the standard deviation of its argument is `error`,
    (n,); in units of the squared half of the jump."""
    values = SLOPE * evaluate(Expression(_sides(jump)[2]))
    taken, true = np.tanh(values / width), np.tanh(values / error)
    return np.asarray(1.0 - 2.0 * taken * true + taken**2)


def _share(mean: Node, sign: str) -> Node:
    """(1 +- mean of a sign)/2: the probability that it is positive, or negative."""
    return Binary("/", Binary(sign, Number(1), mean), Number(2))


def _mixed(condition: Node, first: Node, second: Node) -> Node:
    """``where`` with a condition that is a probability: both cases weighted by it; one of weight 0 may be undefined."""
    if is_comparison(condition):
        return Call("where", (condition, first, second))
    rest = Binary("-", Number(1), condition)
    first = Call("where", (Binary("!=", condition, Number(0)), first, Number(0)))
    second = Call("where", (Binary("!=", rest, Number(0)), second, Number(0)))
    return Binary("+", Binary("*", condition, first), Binary("*", rest, second))
