"""Inputs that rest at their extremes: a sensor is clipped there, or an actuator has reached its limit.

The motion decides which. Where a sensor is clipped the force exceeds its samples, and the motion responds to the
excess: the highest derivative of a chain, regressed on its states, their cubes and squares with a sign, the inputs, and
the sign of the extreme that an input is at, has a coefficient of the latter. Inputs go through the smoother that the
derivative is from, since it rounds edges. The standard error is that of clusters of rows, from one visit of an extreme
to the next: what the regression lacks is correlated in time (docs/tables/limits.csv).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.states.kinematic.smoother import ChainSeries, KinematicModel, smooth_kinematic

# A sensor is clipped if this coefficient and that of the input are both this many standard errors from zero.
SIGNIFICANT = 3.0

# A mean excess of the force over its samples below this share of their standard deviation does not matter.
LEAST_EXCESS = 0.05

# Samples at extremes are left out without this test if they are at most this share of a record: that costs nothing.
FEW = 0.05


class Inputs(NamedTuple):
    """Inputs of a record."""

    own: Floats  # (n,), samples of the input
    at_end: Bools  # (n,), those at an extreme
    others: Floats  # (n, m), other inputs

    @property
    def columns(self) -> Floats:
        """The sign of the extreme, the input and the others, (n, 2 + m)."""
        sign = np.where(self.at_end, np.sign(self.own - np.nanmedian(self.own)), 0.0)
        return np.column_stack([sign, self.own, self.others])


def is_clipped(inputs: Sequence[Inputs], motions: Sequence[ChainSeries], model: KinematicModel) -> bool:
    """Whether the motion of a chain shows that an input is larger than its samples at its extremes, of all records."""
    rows, targets, clusters, count = [], [], [], 0
    for one, series in zip(inputs, motions, strict=True):
        mean = smooth_kinematic(series, model).mean
        highest = min(len(series.channels), mean.shape[1]) - 1
        z = mean[:, :highest]
        through = [_smoothed(column, series, model, highest) for column in one.columns.T]
        rows.append(np.column_stack([*through, np.ones(series.n), z, z * np.abs(z), z**3]))
        targets.append(mean[:, highest])
        clusters.append(count + np.cumsum(one.at_end & ~np.append(False, one.at_end[:-1])))
        count = int(clusters[-1][-1]) + 1
    X, y, of = np.concatenate(rows), np.concatenate(targets), np.concatenate(clusters)
    known = np.isfinite(X).all(axis=1) & np.isfinite(y)
    X, y, of = X[known], y[known], of[known]
    scale = np.sqrt((X**2).mean(axis=0))
    X = X / np.where(scale > 0.0, scale, 1.0)
    inverse = np.linalg.pinv(X.T @ X, hermitian=True)
    coef = inverse @ (X.T @ y)
    left = y - X @ coef
    scores = np.zeros((count, X.shape[1]))
    np.add.at(scores, of, X * left[:, None])
    error = np.sqrt(np.maximum(np.diagonal(inverse @ (scores.T @ scores) @ inverse), left.var() * np.diagonal(inverse)))
    if not (np.abs(coef[:2]) > SIGNIFICANT * error[:2]).all():
        return False
    excess, own = coef[:2] / scale[:2]
    return bool(excess / own > LEAST_EXCESS * np.nanstd(np.concatenate([one.own for one in inputs])))


def _smoothed(column: Floats, series: ChainSeries, model: KinematicModel, highest: int) -> Floats:
    """A column in place of the highest derivative, its integrals in place of the others, by the smoother, (n,)."""
    known, t = np.isfinite(column), series.times
    below = [np.interp(t, t[known], column[known])]
    for _ in range(highest):
        below.insert(0, np.append(0.0, np.cumsum(0.5 * (below[0][1:] + below[0][:-1]) * np.diff(t))))
    channels = (None if one is None or k > highest else below[k] for k, one in enumerate(series.channels))
    return smooth_kinematic(ChainSeries(t, tuple(channels)), model).mean[:, highest]
