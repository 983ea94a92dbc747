"""Noise with heavy tails: Student's t as Gaussian noise whose variance is another for every sample (Lange, Little and
Taylor 1989). Degrees of freedom are estimated per channel; of Gaussian noise nothing changes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State
from bayeq.likelihood.search import Task, fit

__all__ = ["Tails", "tails_of", "with_heavy_tails"]

Floats = NDArray[np.float64]

# Degrees of freedom that are compared; infinitely many are Gaussian noise.
FREEDOM = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, np.inf)

# Rounds of fit and variances, and steps to the scale of a channel; both end where a variance of half of the samples
# or a scale changes by less than a share.
ROUNDS, STEPS, SETTLED = 8, 50, 1e-3


class Tails(NamedTuple):
    """A t distribution.

    Attributes
    ----------
    freedom : float
        Degrees of freedom; infinite of Gaussian noise.
    variance : float
        Square of its scale.
    """

    freedom: float
    variance: float

    def spread(self, squares: Floats) -> Floats:
        """Variance of each sample as a multiple of `variance`, given the squares of the errors."""
        if np.isinf(self.freedom):
            return np.ones(len(squares))
        return np.asarray((self.freedom + squares / self.variance) / (self.freedom + 1.0))


def tails_of(squares: Floats) -> Tails:
    """The likeliest t distribution of some errors, given their squares, by expectation and maximisation.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> tails_of(rng.standard_t(3, 4000) ** 2).freedom
    3.0
    >>> tails_of(rng.standard_normal(4000) ** 2).freedom
    inf
    """
    found = []
    for freedom in FREEDOM:
        tails = Tails(freedom, float(np.mean(squares)) if np.isinf(freedom) else float(np.median(squares)))
        for _ in range(STEPS):
            variance = float(np.mean(squares / tails.spread(squares)))
            done = abs(variance - tails.variance) < SETTLED * variance
            tails = tails._replace(variance=variance)
            if done:
                break
        found.append((_log_likelihood(tails, squares), tails))
    return max(found, key=lambda one: one[0])[1]


def _log_likelihood(tails: Tails, squares: Floats) -> float:
    v, s = tails
    level = -0.5 * len(squares) * np.log(s)
    if np.isinf(v):
        return float(level - 0.5 * len(squares) * np.log(2.0 * np.pi) - 0.5 * squares.sum() / s)
    unit = math.lgamma(0.5 * (v + 1.0)) - math.lgamma(0.5 * v) - 0.5 * np.log(v * np.pi)
    return float(level + len(squares) * unit - 0.5 * (v + 1.0) * np.log1p(squares / (v * s)).sum())


def with_heavy_tails(task: Task, state: State) -> tuple[Task, State]:
    """The task with a variance of each sample, and the fit of the same model to it.

    Channels whose noise is known keep it.
    """
    before = [one.spread for one in task.series]
    for _ in range(ROUNDS):
        task, state = _spread(task, state)
        state = fit(task, state).state
        now = [one.spread for one in task.series]
        change = np.concatenate([np.abs(a / b - 1.0).ravel() for a, b in zip(now, before, strict=True)])
        if np.median(change) < SETTLED:
            break
        before = now
    return task, state


def _spread(task: Task, state: State) -> tuple[Task, State]:
    """Variances of the samples where a fit stands, and the levels of the channels that go with them."""
    squares = _squared_errors(task, state)
    channels = state.levels.channels.copy()
    spread = [one.spread.copy() for one in task.series]
    for i in np.flatnonzero(state.levels.learned):
        columns = [one[:, i] for one in squares]
        tails = tails_of(np.concatenate([column[np.isfinite(column)] for column in columns]))
        channels[i] = max(tails.variance, float(np.exp(state.levels.bounds[0][i])))
        for own, column in zip(spread, columns, strict=True):
            own[:, i] = np.where(np.isfinite(column), tails.spread(column), 1.0)
    series = tuple(one._replace(spread=own) for one, own in zip(task.series, spread, strict=True))
    return replace(task, series=series), replace(state, levels=replace(state.levels, channels=channels))


def _squared_errors(task: Task, state: State) -> list[Floats]:
    """Expected squares of the errors of all samples, (n, M) of every record; NaN where there is none."""
    out = []
    for linear in task.linearised(state):
        # the future determines a sample as well as the past does
        covariance = 0.5 * run_filter(linear, state.chosen, state.levels.noise).covariance
        squares = linear.residual**2
        for i, kind in enumerate(linear.kinds):
            if kind >= 0:
                squares[:, i] += covariance[:, kind, kind]
            else:
                slope = linear.gradient[:, -1 - kind]
                squares[:, i] += np.einsum("ni,nij,nj->n", slope, covariance, slope)
        out.append(squares)
    return out
