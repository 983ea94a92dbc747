"""Noise with a different variance for every sample, estimated alternately with the fit.

Several records: each channel has a variance in every record, if these are likelier than common ones by the Bayesian
information criterion (Schwarz 1978).

Heavy tails: Student's t is such noise (Lange, Little and Taylor 1989); degrees of freedom are estimated per channel,
and Gaussian noise stays as it is.

In proportion to the reading: variance a + b x^2 of a channel that measures x, both learned, or b x^2 if the share
sqrt(b) is given.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, adjoints, marginal
from bayeq.likelihood.layout import Layout, Series
from bayeq.likelihood.model import Task, fit
from bayeq.states import Sensors

# Degrees of freedom that are compared; infinitely many are Gaussian noise.
FREEDOM = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 20.0, np.inf)

# Least share of the mean variance that does not depend on the reading.
CONSTANT = 1e-12

# The first variances follow the squares of the smoothed motion, with this share of their mean for its errors.
AT_FIRST = 1e-2

# Most alternations of fit and variances, and most EM steps for the scale of a t distribution or for variances of
# records. The first end when the median relative change of the samples' variances, the steps to the scale when its
# change, is below SETTLED.
ROUNDS, STEPS, SETTLED = 8, 50, 1e-3

# Variances of records are settled at these changes of their logarithms: in a step on a fixed path, and by another fit.
STEADY, STILL = 0.01, 0.05


class Tails(NamedTuple):
    """A t distribution."""

    freedom: float  # degrees of freedom; infinite of Gaussian noise
    variance: float  # square of its scale

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


def proportion_of(squares: Floats, readings: Floats) -> tuple[Floats, float]:
    """The likeliest variances a + b x^2 of some errors, as multiples of their mean, and that mean.

    `squares`, (n,), are the squared errors, `readings`, (n,), the squared measured values.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x = np.sin(np.linspace(0.0, 40.0, 4000))
    >>> spread, variance = proportion_of((0.05 * x * rng.standard_normal(4000)) ** 2 + 1e-16, x**2 + 1e-12)
    >>> round(float(np.sqrt(variance / np.mean(x**2))), 3)
    0.05
    """
    from scipy.optimize import minimize_scalar

    own = readings / readings.mean()

    def spread(log_constant: float) -> Floats:
        constant = np.exp(log_constant)
        return np.asarray(constant + (1.0 - constant) * own)

    def loss(log_constant: float) -> float:
        found = spread(log_constant)
        return float(len(own) * np.log(np.mean(squares / found)) + np.log(found).sum())

    best = spread(float(minimize_scalar(loss, bounds=(np.log(CONSTANT), 0.0), method="bounded").x))
    return best, float(np.mean(squares / best))


def in_proportion(
    layout: Layout, sensors: Sensors, series: tuple[Series, ...], readings: list[Floats]
) -> tuple[Series, ...]:
    """Series with noise variances as the squares of smoothed readings, (n, M) each, where noise is given as a share."""
    out = [one.spread.copy() for one in series]
    for i, (name, _) in enumerate(layout.channels):
        if sensors.of_reading.get(name, 0.0) > 0.0:
            mean = float(np.mean(np.concatenate([one[:, i] ** 2 for one in readings])))
            for own, one in zip(out, readings, strict=True):
                own[:, i] = AT_FIRST + (1.0 - AT_FIRST) * one[:, i] ** 2 / mean
    return tuple(one._replace(spread=own) for one, own in zip(series, out, strict=True))


def with_unequal_noise(task: Task, state: State, sensors: Sensors) -> tuple[Task, State]:
    """The task with a variance of each sample, by record or as sensors ask for, and the fit of the same model to it."""
    if sensors.tails != "student" and not sensors.of_reading:
        return with_noise_of_records(task, state)
    before = [one.spread for one in task.series]
    for _ in range(ROUNDS):
        task, state = _spread(task, state, sensors)
        state = fit(task, state).state
        now = [one.spread for one in task.series]
        change = np.concatenate([np.abs(a / b - 1.0).ravel() for a, b in zip(now, before, strict=True)])
        if np.median(change) < SETTLED:
            break
        before = now
    return task, state


def with_noise_of_records(task: Task, state: State) -> tuple[Task, State]:
    """The task with noise of its own in every record, if that is clearly likelier, and the fit of the same model."""
    for _ in range(ROUNDS if len(task.series) > 1 else 0):
        before = np.log([one.spread[0] for one in task.series])
        variance, weights = _of_records(task, state)
        channels = (weights * variance).sum(axis=0)
        now = np.log(variance / channels)
        if np.abs(now - before).max() < STILL:
            break
        series = [
            one._replace(spread=_rows_of(own, one.samples)) for own, one in zip(np.exp(now), task.series, strict=True)
        ]
        task = replace(task, series=tuple(series))
        state = fit(task, replace(state, levels=replace(state.levels, channels=channels))).state
    return task, state


def _of_records(task: Task, state: State) -> tuple[Floats, Floats]:
    """Variances of the channels' noise in the records, (R, M), and each record's share of the channel's samples.

    They maximise the marginal likelihood on the path of the state, by expectation and maximisation (Shumway and Stoffer
    1982), or stay common where the slopes there promise too little.
    """
    levels, precision, linears = state.levels, task.precision_of(state), task.linearised(state)
    counts = np.array([np.isfinite(one.residual).sum(axis=0) for one in linears], dtype=np.float64)
    weights, least = counts / np.maximum(counts.sum(axis=0), 1.0), np.exp(levels.bounds[0][: counts.shape[1]])
    ratio, free = np.array([one.spread[0] for one in task.series]), levels.learned & (counts > 0.0)
    common = bool((ratio == 1.0).all())
    needed = 0.5 * (len(counts) - 1) * np.count_nonzero(levels.learned) * math.log(counts.sum())
    for _ in range(STEPS):
        own = [one._replace(spread=_rows_of(r, one.residual)) for r, one in zip(ratio, linears, strict=True)]
        found = marginal(own, state, levels, precision)
        slopes = adjoints(own, levels, found, found.delta, found.covariance)
        step = 2.0 * levels.channels * np.array([one.channels for one in slopes]) / np.maximum(counts, 1.0)
        if common and float((0.25 * counts * step**2)[free].sum()) < needed:
            break
        common = False
        ratio = np.where(free, np.maximum(ratio * np.maximum(1.0 + step, 0.1), least / levels.channels), ratio)
        if np.abs(step[free]).max(initial=0.0) < STEADY:
            break
    return levels.channels * ratio, weights


def _rows_of(ratio: Floats, samples: Floats) -> Floats:
    return np.tile(ratio, (len(samples), 1))


def _spread(task: Task, state: State, sensors: Sensors) -> tuple[Task, State]:
    """The task with variances of the samples from a fit's errors, and the state with channel levels to match."""
    squares, readings = _squares(task, state)
    channels = state.levels.channels.copy()
    spread = [one.spread.copy() for one in task.series]
    for i, (name, _) in enumerate(task.layout.channels):
        learned, proportional = bool(state.levels.learned[i]), name in sensors.of_reading
        if not (proportional or (learned and sensors.tails == "student")):
            continue
        there = [np.isfinite(one[:, i]) for one in squares]
        errors = np.concatenate([one[rows, i] for one, rows in zip(squares, there, strict=True)])
        if proportional:
            values = np.concatenate([one[rows, i] for one, rows in zip(readings, there, strict=True)])
            found, variance = proportion_of(errors, values) if learned else (values / values.mean(), channels[i])
        else:
            tails = tails_of(errors)
            found, variance = tails.spread(errors), tails.variance
        if learned:
            channels[i] = max(variance, float(np.exp(state.levels.bounds[0][i])))
        parts = np.split(found, np.cumsum([rows.sum() for rows in there])[:-1])
        for own, rows, part in zip(spread, there, parts, strict=True):
            own[:, i] = 1.0
            own[rows, i] = part
    series = tuple(one._replace(spread=own) for one, own in zip(task.series, spread, strict=True))
    return replace(task, series=series), replace(state, levels=replace(state.levels, channels=channels))


def _squares(task: Task, state: State) -> tuple[list[Floats], list[Floats]]:
    """Expected squared errors of samples, (n, M) of every record, and squared measured values; NaN without a sample."""
    out, readings = [], []
    for linear, one in zip(task.linearised(state), task.series, strict=True):
        # smoothed covariances are about half of the filtered ones: the future tells as much as the past
        covariance = 0.5 * run_filter(linear, state.chosen, state.levels.noise).covariance
        squares, reading = linear.residual**2, (one.samples - linear.residual) ** 2
        for i, kind in enumerate(linear.kinds):
            if kind >= 0:
                own = covariance[:, kind, kind]
            else:
                slope = linear.gradient[:, -1 - kind]
                own = np.einsum("ni,nij,nj->n", slope, covariance, slope)
            squares[:, i] += own
            reading[:, i] += own
        out.append(squares)
        readings.append(reading)
    return out, readings
