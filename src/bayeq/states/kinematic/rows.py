"""A record as the kernels see it, and the filter on it.

Records are taken to units of their own (time in median steps, the coordinate in its size over a step), so that the
numbers in the kernels are near 1 whatever the units of the data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.records.sampling import is_step
from bayeq.states.kinematic.kalman import Tables, run_filter, score
from bayeq.states.kinematic.model import ChainSeries

__all__ = ["Filtered", "Rows", "prepare"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """What the forward passes over a record leave."""

    noise: Floats  # lower root of Qd over a regular step
    steady: int
    tables: Tables
    log_likelihood: float


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """A record in units of its own, and the filter on it. States below `lowest` are left out."""

    samples: Floats  # (n, c), 0 where missing
    present: NDArray[np.bool_]  # (n, c)
    steps: Floats  # (n,) in `step`, 1 where regular
    measured: NDArray[np.int64]  # (c,)
    lowest: int
    step: float
    scale: float
    centre: float

    @property
    def irregular(self) -> int:
        """Rows after an odd step or with a missing sample, on which gains cannot settle."""
        return int(np.count_nonzero((self.steps[1:] != 1.0) | ~self.present[1:].all(axis=1)))

    @property
    def count(self) -> int:
        """Number of samples."""
        return int(np.count_nonzero(self.present))

    def take(self, rows: slice) -> Rows:
        """A stretch of the record."""
        return replace(self, samples=self.samples[rows], present=self.present[rows], steps=self.steps[rows])

    def units(self, derivatives: ArrayLike) -> Floats:
        """Units of some derivatives."""
        return self.scale / self.step ** np.asarray(derivatives, dtype=np.float64)

    @property
    def log_jacobian(self) -> float:
        """What takes a log density of the samples in own units to the data's."""
        return -float(self.present.sum(axis=0) @ np.log(self.units(self.measured)))

    def filter(self, order: int, density: float, noise_sd: Floats, initial_sd: Floats, keep: bool = False) -> Filtered:
        """Filter the record.

        Parameters
        ----------
        order, density : int, float
            m and Q.
        noise_sd, initial_sd : (K+1,) and (m,) arrays
            Standard deviations of the channels' noise and of the first state.
        keep : bool
            Whether to keep the filtered states, which the smoother needs.
        """
        (n, c), m = self.samples.shape, order - self.lowest
        orders = self.measured - self.lowest
        variances = (noise_sd[self.measured] / self.units(self.measured)) ** 2
        start = initial_sd[self.lowest :] / self.units(np.arange(self.lowest, order))
        noise = math.sqrt(density) * self.step ** (order - 0.5) / self.scale * _unit_root(m)
        tables = Tables(
            entry=np.empty(n, np.int64),
            anew=np.empty(n, np.bool_),
            gains=np.empty((n, c, m)),
            inverse=np.empty((n, c)),
            roots=np.empty((n * keep, m, m)),
            innovations=np.empty((n, c)),
            means=np.empty((n * keep, m)),
        )
        entries, steady, deviance = run_filter(
            self.samples, self.present, self.steps, orders, variances, noise, start, tables
        )
        value = -0.5 * (deviance + self.count * math.log(2.0 * math.pi)) + self.log_jacobian
        filled = {name: getattr(tables, name)[:entries] for name in ("gains", "inverse", "roots")}
        return Filtered(noise, steady, tables._replace(**filled), value)

    def score(self, filtered: Filtered, noise_sd: Floats) -> tuple[Floats, float]:
        """Derivatives of the log-likelihood by ln R_k, K+1 of them, and ln Q; the leave-one-out log density."""
        own, gradient = np.empty(len(self.measured) + 1), np.zeros(len(noise_sd) + 1)
        orders = self.measured - self.lowest
        left_out = score(self.steps, orders, filtered.tables, filtered.steady, filtered.noise, own, np.empty((0, 0, 2)))
        gradient[self.measured] = own[:-1] * (noise_sd[self.measured] / self.units(self.measured)) ** 2
        gradient[-1] = own[-1]
        return gradient, left_out + self.log_jacobian

    def left_out(self, filtered: Filtered) -> Floats:
        """Error of each sample against what all others predict, and its standard deviation, (n, c, 2); NaN without."""
        errors = np.full((*self.samples.shape, 2), np.nan)
        orders, gradient = self.measured - self.lowest, np.empty(len(self.measured) + 1)
        score(self.steps, orders, filtered.tables, filtered.steady, filtered.noise, gradient, errors)
        return errors * self.units(self.measured)[:, None]


def prepare(series: ChainSeries, initial_sd: Floats, all_states: bool = False) -> Rows:
    """A record for the filter.

    Parameters
    ----------
    series : ChainSeries
        The record.
    initial_sd : (m,) array
        Sizes of the derivatives, which the units are taken from.
    all_states : bool
        Whether the states below the lowest measured derivative are wanted too: they say nothing about the samples,
        and never settle.
    """
    seen = [k for k, channel in enumerate(series.channels) if channel is not None and np.isfinite(channel).any()]
    measured = np.array(seen or series.measured, dtype=np.int64)
    step = series.step
    steps = np.append(0.0, np.where(is_step(series.times, step, 0.0), 1.0, np.diff(series.times) / step))
    samples = np.stack([channel for k in measured if (channel := series.channels[k]) is not None], axis=1)
    present = np.isfinite(samples)
    centre, scale = 0.0, float(initial_sd[measured[0]]) * step ** int(measured[0])
    if measured[0] == 0 and present[:, 0].any():
        centre = float(samples[present[:, 0], 0].mean())
        samples[:, 0] -= centre
    samples[~present] = 0.0
    rows = Rows(samples, present, steps, measured, 0 if all_states else int(measured[0]), step, scale, centre)
    samples /= rows.units(measured)
    return rows


@lru_cache(maxsize=16)
def _unit_root(m: int) -> Floats:
    """Lower root of Qd over a step of 1 with Q = 1: Qd_ij = 1/((2m-1-i-j) (m-1-i)! (m-1-j)!)."""
    back = np.arange(m - 1, -1, -1)
    factorials = np.array([math.factorial(k) for k in back], dtype=np.float64)
    root = np.asarray(
        np.linalg.cholesky(1.0 / ((back[:, None] + back + 1) * np.outer(factorials, factorials))), np.float64
    )
    root.setflags(write=False)
    return root
