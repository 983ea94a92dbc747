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

__all__ = ["apart", "typical_period", "window_runs"]

Floats = NDArray[np.float64]

# Windows over all records, and the least rows of one.
WINDOWS = 12
LEAST_ROWS = 8


def typical_period(dynamics: Dynamics, pieces: Sequence[Rows]) -> float:
    """Shortest of the chains' periods [s]: 2 pi times the spread of the coordinate over that of its derivative."""
    periods = []
    for law in dynamics.laws:
        low, above = (np.concatenate([rows.columns[name] for rows in pieces]) for name in law.chain.names[:2])
        spread = abs(rates(law.chain, law.unit_gains)[0]) * float(above.std())
        periods.append(2.0 * math.pi * float(low.std()) / spread if spread > 0 else math.inf)
    return min(periods)


def window_runs(
    dynamics: Dynamics, pieces: Sequence[Rows], duration: float, parameters: Floats | None = None
) -> list[tuple[Floats, Floats]]:
    """Free runs over windows of some seconds, and the states that they are to follow, in units of their spread.

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
    parameters : (p,) array, optional
        Of the equations; by default their posterior means.
    """
    theta = dynamics.mean if parameters is None else parameters
    states = [rows.stack(dynamics.states) for rows in pieces]
    whole = np.concatenate(states)
    spread = whole.std(axis=0)
    scale = np.where(spread > 0, spread, 1.0)
    limits = state_range(whole)
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
