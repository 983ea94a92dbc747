"""A record put on its uniform grid of time: dropped samples put back, rounded times made even."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.records import Record

__all__ = ["on_grid"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# No more than this share of the samples may be missing, and steps may be off the grid by this share of one.
MOST_MISSING = 0.4
OFF_GRID = 0.02

# Times that are multiples of such a power of ten may have been rounded to it, which moves them by half of it at most;
# the grid fitted to them may be off by a little more.
DECIMALS = range(1, 10)
ROUNDED_BY = 0.6


def on_grid(record: Record, chain_channels: Sequence[str], inputs: Sequence[str]) -> Record:
    """The record with a row for every sample of its grid: the same record, if none is missing or there is no grid.

    Channels of chains are NaN in rows that are filled in, for the smoother to bridge; inputs are interpolated by a
    cubic spline, since nothing else is known of them. Times that were written with few decimals (0.033, 0.067, 0.100
    at 30 Hz) become the even ones that they were before.
    """
    if record.time is None or record.n < 3:
        return record
    time = np.asarray(record.time)
    index, step = _places(time)
    n = int(index[-1]) + 1
    if not (np.diff(index) > 0).all() or record.n < (1.0 - MOST_MISSING) * n:
        return record
    rounded = _as_rounded(time, index)
    grid: Floats
    if rounded is not None:
        grid = rounded[0] + rounded[1] * np.arange(n, dtype=np.float64)
    elif (np.abs((time - time[0]) / step - index) < OFF_GRID).all():
        grid = time[0] + step * np.arange(n, dtype=np.float64)
    else:
        return record
    if n == record.n:
        return record if rounded is None else Record(record.channels, grid, record.units, record.name, record.truth)
    # takes a second to import, and few records have gaps
    from scipy.interpolate import CubicSpline

    channels = {}
    for name in (*chain_channels, *inputs):
        values = np.full(n, np.nan)
        values[index] = record[name]
        if name in inputs:
            values = CubicSpline(grid[index], record[name])(grid)
            values[index] = record[name]
        channels[name] = values
    units = {name: unit for name, unit in record.units.items() if name in channels or name == "t"}
    return Record(channels=channels, time=grid, units=units, name=record.name)


def _places(time: Floats) -> tuple[Ints, float]:
    """Number of each sample on a grid that begins with the first, and its step."""
    steps = np.diff(time)
    step = float(np.median(steps))
    # the median step, made precise by all of them
    step = float(np.sum(steps) / np.sum(np.round(steps / step)))
    return np.round((time - time[0]) / step).astype(np.int64), step


def _as_rounded(time: Floats, index: Ints) -> tuple[float, float] | None:
    """Begin and step of the even grid that times are the decimal rounding of; None if they are even as they are, or
    uneven by more."""
    centre = index - index.mean()
    step = float(centre @ time / (centre @ centre))
    start = float(time.mean() - step * index.mean())
    off = float(np.abs(time - start - step * index).max())
    if off <= 1e-6 * step:
        return None
    for decimals in DECIMALS:
        unit = 10.0**-decimals
        if np.abs(time - np.round(time, decimals)).max() <= 1e-6 * unit:
            return (start, step) if off <= ROUNDED_BY * unit and unit < step else None
    return None
