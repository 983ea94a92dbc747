"""Factors of channels as the likelihood finds them: one number each for all records, by the motion that they share.

A channel that may be off by a factor is a measurement ``(1 + g) s`` of s, about s as it is along the path: the filter
of these samples alone gives the derivative of the innovations by g, beside those by the coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.adequacy import standardised
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, solved
from bayeq.likelihood.layout import NOTHING
from bayeq.likelihood.model import Task
from bayeq.states import Gain


class Calibration(NamedTuple):
    """What is known of the factors of some channels."""

    gains: Mapping[str, Gain]  # by the names of the channels
    covariance: Floats  # of the factors, coefficients integrated out
    moved: float  # how far they are from what was taken out of the samples, in standard deviations


def calibration_of(task: Task, state: State, power: float = 1.0) -> Calibration:
    """The factors of channels about a fit, those that were taken out of the samples included.

    The likelihood is raised to `power`.
    """
    channels = [i for i, _ in task.layout.uncertain]
    if not channels:
        return Calibration({}, np.zeros((0, 0)), 0.0)
    found = task.marginal(state)
    taken = np.array([gain.value for _, gain in task.layout.uncertain])
    known = np.array([gain.prior_sd for _, gain in task.layout.uncertain]) ** -2.0 * taken**2
    count, r = len(channels), len(state.theta)
    information, across, slope = np.zeros((count, count)), np.zeros((r, count)), np.zeros(count)
    still = state.levels.noise._replace(mean=np.zeros(task.layout.size))
    for one, linear, filtered in zip(task.series, task.linearised(state), found.filtered, strict=True):
        left, columns = standardised(filtered, found.delta)
        by_gain = np.empty((*left.shape, count))
        for k, i in enumerate(channels):
            samples = 0.0 * linear.residual
            samples[:, i] = one.samples[:, i] - linear.residual[:, i]
            at_rest = linear._replace(path=0.0 * linear.path, end=0.0 * linear.end, residual=samples)
            by_gain[..., k] = standardised(run_filter(at_rest, NOTHING, still), np.zeros(0))[0]
        information += np.einsum("tmi,tmj->ij", by_gain, by_gain)
        across += np.einsum("tmr,tmi->ri", columns, by_gain)
        slope += np.einsum("tmi,tm->i", by_gain, left)
    information -= across.T @ found.covariance @ across
    covariance = solved(power * information + np.diag(known), np.eye(count))
    change = covariance @ (power * slope + known * (1.0 / taken - 1.0))
    sizes = taken * np.sqrt(np.diagonal(covariance))
    gains = {
        task.layout.channels[i][0]: Gain(float(value), float(sd), gain.prior_sd)
        for (i, gain), value, sd in zip(task.layout.uncertain, taken * (1.0 + change), sizes, strict=True)
    }
    moved = float(np.sqrt(change @ solved(covariance, change) / count))
    return Calibration(gains, covariance * np.outer(taken, taken), moved)
