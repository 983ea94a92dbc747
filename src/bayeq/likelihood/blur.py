"""`Blur`: the width over which each jump of a term is smoothed, sample by sample.

The width of a jump at a sample is the standard deviation of its argument there: from the smoothed covariance of the
states and, next to a crossing, from the change of the argument over an integration step. It is at least about the
change of the argument that the jump itself causes in such a step, so that it can be integrated. The difference between
jump and smoothed jump counts as noise, of samples of the target and of the force over a step. Where both sides of a
jump drive its argument to zero it stays there: friction holds a body at rest with exactly the force that this needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.expressions import Call, Evaluator, Expression
from bayeq.likelihood.layout import NOTHING, Candidates, Layout, Series
from bayeq.likelihood.signs import SLOPE, half_of_jump, middle_of_jump, unresolved_share
from bayeq.numerics.settings import LIKELIHOOD

# Variance of a uniform distribution over an interval of length 1.
UNIFORM = 1.0 / 12.0

# Least width as a share of the largest argument, and least error of an argument as a share of its width.
LEAST, LEAST_ERROR = 1e-9, 1e-3


class Hold(NamedTuple):
    """Intervals in which a jump holds its argument at zero because both sides drive it there (sticking friction)."""

    jump: int  # index in `Layout.jumps`
    rows: NDArray[np.intp]  # (k,), number of the sample at which each interval begins
    half: Floats  # (k, C), half of the jump of each equation's right-hand side
    gradient: Floats  # (k, motion), the argument at the intervals' ends is ``gradient @ states + offset``
    offset: Floats  # (k,)
    wide: float  # a width so large that it switches the jump off

    def projectors(self, push: Floats) -> tuple[Floats, Floats]:
        """Projection of changes of the states by the force that holds the argument (Filippov 1988), and its offset.

        (k, motion, motion) and (k, motion); `push`, (k, motion, C), is the change of the states over an interval by a
        force of 1 in each equation.
        """
        push = np.einsum("knc,kc->kn", push, self.half)
        push = push / np.einsum("kn,kn->k", self.gradient, push)[:, None]
        return np.eye(push.shape[1]) - push[:, :, None] * self.gradient[:, None, :], -push * self.offset[:, None]


class Blur(NamedTuple):
    """Widths of the jumps along the path of a record."""

    width: Floats  # (n, J), of `Layout.jumps`, in the unit of the argument
    unresolved: Floats  # (n, M), variance added to each sample's noise for the error of the smoothed jumps
    force: Floats  # (n - 1, C), variance over a step of that error as a force in each equation
    holds: tuple[Hold, ...] = ()  # intervals in which jumps hold their arguments

    def beside(self, inputs: Floats) -> Floats:
        """Inputs (n, m, 4) followed by the widths, interpolated linearly between samples: (n, m + J, 4)."""
        own = np.zeros((*self.width.shape, 4))
        own[:, :, 0] = self.width
        own[:, :, 1] = np.concatenate([self.width[1:], self.width[-1:]])
        for hold in self.holds:
            own[hold.rows, hold.jump, :2] = hold.wide
        return np.concatenate([inputs, own], axis=1)


def _columns(layout: Layout, series: Series, path: Floats) -> dict[str, Floats]:
    columns = dict(zip(layout.names, path.T, strict=True))
    return columns | dict(zip(layout.given, series.inputs[:, :, 0].T, strict=True))


def crossings(layout: Layout, series: Series, path: Floats, wanted: Bools) -> Bools:
    """Whether the path crosses each wanted jump between two samples, (n - 1, J)."""
    out = np.zeros((len(path) - 1, len(layout.jumps)), dtype=np.bool_)
    evaluate = Evaluator(_columns(layout, series, path))
    for j in np.flatnonzero(wanted):
        jump = layout.jumps[j]
        values = evaluate(Expression(jump.arguments[0]))
        out[:, j] = np.diff(np.signbit(values) if jump.function == "sign" else np.floor(values)) != 0
    return out


def first_blur(layout: Layout, series: Series, path: Floats, substeps: int = 1) -> Blur:
    """Widths along a path of unknown error, from the change of the arguments between samples that enclose a jump."""
    n, size = path.shape
    if not layout.jumps:
        return Blur(np.zeros((n, 0)), np.zeros(series.samples.shape), np.zeros((n - 1, layout.chains)))
    covariance, push = np.zeros((n, size, size)), np.zeros((n - 1, size, layout.chains))
    return blur_of(layout, series, path, covariance, push, NOTHING, np.zeros(0), np.full(n - 1, substeps))


def blur_of(
    layout: Layout,
    series: Series,
    path: Floats,
    covariance: Floats,
    push: Floats,
    chosen: Candidates,
    theta: Floats,
    substeps: Ints,
) -> Blur:
    """Widths of jumps along a smoothed path, (n, S), with covariance (n, S, S), for the model `chosen`, `theta`.

    `push`, (n - 1, S, C), is the change of the states over an interval by a force of 1 in each equation; `substeps`,
    (n - 1,), is the number of integration steps of each interval.
    """
    n, columns = len(path), _columns(layout, series, path)
    if layout.implicit:
        free, shared = layout.targets_along(columns, chosen, theta, layout.terms)
        targets = free + np.einsum("nij,nj->ni", shared, path[:, layout.discrepancy])
        columns |= dict(zip(layout.roles.targets, targets.T, strict=True))
    evaluate = Evaluator(columns)
    width = np.zeros((n, len(layout.jumps)))
    left_out = np.zeros((n, layout.chains))
    passing = crossings(layout, series, path, np.ones(len(layout.jumps), dtype=np.bool_))
    inside, holds = layout.jumps_in(chosen), []
    for j, jump in enumerate(layout.jumps):
        argument = Expression(jump.arguments[0])
        values, gradient = evaluate(argument), _gradient(columns, layout.names, covariance, argument)
        own = np.flatnonzero(gradient.any(axis=0))
        slope = gradient[:, own]
        error = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", slope, covariance[:, own[:, None], own], slope), 0.0))
        steps = substeps if inside[j] else np.full(n - 1, substeps.min())
        change = _at_both_ends(np.where(passing[:, j], np.abs(np.diff(values)), 0.0) / steps)
        half = _halves(layout, chosen, theta, j, evaluate, n)
        moved = np.abs(np.einsum("ni,nic->nc", slope[:-1], push[:, own]) * half[:-1]).sum(axis=1) / steps
        floor = np.maximum(SLOPE * _at_both_ends(moved), LEAST * np.abs(values).max() + np.finfo(float).tiny ** 0.5)
        width[:, j] = np.maximum(np.sqrt(error**2 + UNIFORM * change**2), floor)
        share = unresolved_share(jump, evaluate, width[:, j], np.maximum(error, LEAST_ERROR * width[:, j]))
        left_out += half**2 * share[:, None]
        if inside[j] and jump.function == "sign":
            rows = _held(layout, path, chosen, theta, jump, evaluate, gradient, half, share)
            ends, slopes = rows + 1, gradient[:, : layout.motion]
            offset = values[ends] - np.einsum("ki,ki->k", slopes[ends], path[ends, : layout.motion])
            wide = (np.abs(values).max() + width[:, j].max()) / LEAST
            if not len(rows):
                continue
            holds.append(Hold(j, rows, half[rows], slopes[ends], offset, wide))
    for hold in holds:
        left_out[hold.rows] = 0.0
    unresolved = np.zeros(series.samples.shape)
    targets = np.flatnonzero(layout.kinds < 0)
    unresolved[:, targets] = left_out[:, -1 - layout.kinds[targets]]
    force = 0.5 * (left_out[1:] + left_out[:-1])
    for hold in holds:
        force[hold.rows] = 0.0
    return Blur(width, unresolved, force, tuple(holds))


def _held(
    layout: Layout,
    path: Floats,
    chosen: Candidates,
    theta: Floats,
    jump: Call,
    evaluate: Evaluator,
    gradient: Floats,
    half: Floats,
    share: Floats,
) -> NDArray[np.intp]:
    """Intervals in which both sides of a sign drive its argument to zero and at whose end the sign is unresolved."""
    target = path[:, layout.discrepancy].copy()
    for c, t, value in zip(chosen.chain, chosen.term, theta.tolist(), strict=True):
        target[:, c] += value * (middle_of_jump(layout.terms[t], jump, evaluate) if t < len(layout.terms) else 1.0)
    rest, pull = np.zeros(len(path)), np.zeros(len(path))
    for c, (last, rates) in enumerate(zip(layout.last, layout.rates, strict=True)):
        if not rates:  # a static law moves nothing
            continue
        first = last + 1 - len(rates)
        below = np.column_stack([path[:, first + 1 : last + 1], target[:, c]]) * rates
        rest += np.einsum("ni,ni->n", gradient[:, first : last + 1], below)
        pull += gradient[:, last] * rates[-1] * half[:, c]
    drawn = np.abs(rest) < -pull
    return np.flatnonzero(drawn[:-1] & drawn[1:] & (share[1:] > LIKELIHOOD.unresolved))


def _at_both_ends(values: Floats) -> Floats:
    """At each sample the larger of the values of the two adjacent intervals."""
    return np.maximum(np.append(values, 0.0), np.append(0.0, values))


def _gradient(columns: Mapping[str, Floats], names: Sequence[str], covariance: Floats, argument: Expression) -> Floats:
    """Derivatives of an argument with respect to states, (n, S): differences over one standard deviation of each."""
    values, out = Evaluator(columns)(argument), np.zeros(covariance.shape[:2])
    for i, name in enumerate(names):
        if name in argument.names:
            x = columns[name]
            sd = np.sqrt(np.maximum(covariance[:, i, i], 0.0)) + 1e-9 * np.abs(x).max() + 1e-150
            out[:, i] = (Evaluator({**columns, name: x + sd})(argument) - values) / sd
    return out


def _halves(layout: Layout, chosen: Candidates, theta: Floats, j: int, evaluate: Evaluator, n: int) -> Floats:
    """Half of the change of each equation's right-hand side across jump j, (n, C)."""
    out = np.zeros((n, layout.chains))
    for c, t, value in zip(chosen.chain, chosen.term, theta.tolist(), strict=True):
        if t < len(layout.terms):
            out[:, c] += value * half_of_jump(layout.terms[t], layout.jumps[j], evaluate)
    return out
