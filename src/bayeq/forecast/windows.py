"""Errors of free runs over windows of records: how well equations hold for some periods of their motion."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import mean_run, state_range
from bayeq.forecast.rows import Rows
from bayeq.states import rates

__all__ = ["apart", "correlation_time", "typical_period", "window_runs"]

Floats = NDArray[np.float64]

# Windows over all records, and the least rows of one.
WINDOWS = 12
LEAST_ROWS = 8

# Autocorrelations have fallen below this one; motion that comes back above it within some periods repeats itself.
FALLEN = math.exp(-1.0)
RETURNS = 3.0


def typical_period(dynamics: Dynamics, pieces: Sequence[Rows]) -> float:
    """Shortest of the chains' periods [s]: 2 pi times the spread of the coordinate over that of its derivative."""
    periods = []
    for law in dynamics.laws:
        low, above = (np.concatenate([rows.columns[name] for rows in pieces]) for name in law.chain.names[:2])
        spread = abs(rates(law.chain, law.unit_gains)[0]) * float(above.std())
        periods.append(2.0 * math.pi * float(low.std()) / spread if spread > 0 else math.inf)
    return min(periods)


def correlation_time(dynamics: Dynamics, pieces: Sequence[Rows], period: float) -> float:
    """First lag [s] at which the autocorrelation of chaotic motion falls to 1/e; infinite for other motion.

    Chaotic is what nothing drives and what does not come back: within three typical periods the autocorrelation, the
    mean over the states of the longest record, does not rise above 1/e again, as that of an oscillation does; motion
    that dies out at once is taken for it. The time is that of a window's least rows or more.
    """
    rows = max(pieces, key=lambda one: one.n)
    if dynamics.roles.drivers or not math.isfinite(period):
        return math.inf
    step = float(np.median(np.diff(rows.time)))
    states = rows.stack(dynamics.states)
    states = (states - states.mean(axis=0)) / np.where(np.ptp(states, axis=0) > 0, states.std(axis=0), 1.0)
    power = np.mean(np.abs(np.fft.rfft(states, 2 * rows.n, axis=0)) ** 2, axis=1)
    lags = min(round(RETURNS * period / step) + 1, rows.n // 2)
    low = np.fft.irfft(power)[:lags] / (rows.n - np.arange(lags)) < FALLEN
    fallen = int(np.argmax(low))
    return max(fallen, LEAST_ROWS - 1) * step if low[fallen:].all() and low.any() else math.inf


def window_runs(
    dynamics: Dynamics, pieces: Sequence[Rows], duration: float, theta: Floats | None = None, unit: Floats | None = None
) -> list[tuple[Floats, Floats]]:
    """Free runs over windows of some seconds, and the states that they are to follow, in some unit.

    Each starts at the states of its first row. Windows are at most half a record, and overlap where it is short; there
    is none where no record is long enough.

    Parameters
    ----------
    dynamics : Dynamics
        The equations.
    pieces : sequence of Rows
        Records, even or uneven steps of time.
    duration : float
        [s].
    theta : (p,) array, optional
        Of the equations; by default their posterior means.
    unit : (d,) array, optional
        Of each state; by default its spread over these rows.
    """
    theta = dynamics.mean if theta is None else theta
    states = [rows.stack(dynamics.states) for rows in pieces]
    whole = np.concatenate(states)
    spread = whole.std(axis=0) if unit is None else unit
    scale = np.where(spread > 0, spread, 1.0)
    limits = state_range(np.concatenate([whole, [-scale], [scale]]))
    out = []
    for rows, known in zip(pieces, states, strict=True):
        drive = rows.drive(*limits)
        intervals = duration / drive.step
        length = min(round(intervals) + 1 if math.isfinite(intervals) else rows.n, rows.n // 2)
        if length < LEAST_ROWS:
            continue
        count = max(1, round(WINDOWS * rows.n / len(whole)))
        for first in np.linspace(0, rows.n - length, count).astype(int):
            end = first + length
            run, _, _ = mean_run(dynamics, theta, known[first], drive.part(first, end))
            out.append((run / scale, known[first:end] / scale))
    return out


def apart(pairs: Iterable[tuple[Floats, Floats]]) -> float:
    """Root mean square difference of pairs, the median of them; infinite for one that blew up, NaN for none."""
    squares = [float(np.mean((one - other) ** 2)) for one, other in pairs]
    roots = [math.sqrt(square) if math.isfinite(square) else math.inf for square in squares]
    return float(np.median(roots)) if roots else math.nan
