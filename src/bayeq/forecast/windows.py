"""Errors of free runs over windows of records: how well equations hold for some periods of their motion."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import mean_run, state_range
from bayeq.forecast.rows import Rows

__all__ = ["typical_period", "window_error"]

Floats = NDArray[np.float64]

# Windows over all records, and the least rows of one.
WINDOWS = 12
LEAST_ROWS = 8


def typical_period(dynamics: Dynamics, pieces: Sequence[Rows]) -> float:
    """Shortest of the chains' periods [s]: 2 pi times the spread of the coordinate over that of its derivative."""
    periods = []
    for chain in dynamics.chains:
        low, rate = (np.concatenate([rows.columns[name] for rows in pieces]) for name in chain.names[:2])
        spread = float(rate.std())
        periods.append(2.0 * math.pi * float(low.std()) / spread if spread > 0 else math.inf)
    return min(periods)


def window_error(dynamics: Dynamics, parameters: Floats, pieces: Sequence[Rows], duration: float) -> float:
    """Normalised error of free runs over windows of some seconds, the median of the windows.

    Each starts at the states of its first row. The error is the root mean square over the states, each over its
    standard deviation in all rows; infinite where a run blows up. Windows are at most half a record, and overlap where
    it is short.

    Parameters
    ----------
    dynamics, parameters
        The equations.
    pieces : sequence of Rows
        Records, even or uneven steps of time.
    duration : float
        [s].

    Returns
    -------
    float
        NaN where no record is long enough for a window.
    """
    whole = np.concatenate([rows.stack(dynamics.states) for rows in pieces])
    scale = whole.std(axis=0)
    low, high = state_range(whole)
    errors = []
    for rows in pieces:
        length = min(round(duration / float(np.median(np.diff(rows.time)))) + 1, rows.n // 2)
        if length < LEAST_ROWS:
            continue
        count = max(1, round(WINDOWS * rows.n / len(whole)))
        states = rows.stack(dynamics.states)
        for first in np.linspace(0, rows.n - length, count).astype(int):
            window = rows.part(slice(first, first + length))
            run = mean_run(dynamics, parameters, states[first], window.driven, window.time, low, high)[1]
            difference = (run - states[first : first + length]) / np.where(scale > 0, scale, 1.0)
            square = float(np.mean(difference**2))
            errors.append(math.sqrt(square) if math.isfinite(square) else math.inf)
    return float(np.median(errors)) if errors else math.nan
