"""Dropped samples: a record put back on its uniform grid of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.records import Record

__all__ = ["on_grid"]

# No more than this share of the samples may be missing, and steps may be off the grid by this share of one.
MOST_MISSING = 0.4
OFF_GRID = 0.02


def on_grid(record: Record, chain_channels: Sequence[str], inputs: Sequence[str]) -> Record:
    """The record with a row for every sample of its grid: the same record, if none is missing or there is no grid.

    Channels of chains are NaN in rows that are filled in, for the smoother to bridge; inputs are interpolated by a
    cubic spline, since nothing else is known of them.
    """
    if record.time is None or record.n < 3:
        return record
    time = np.asarray(record.time)
    steps = np.diff(time)
    step = float(np.median(steps))
    # the median step, made precise by all of them
    step = float(np.sum(steps) / np.sum(np.round(steps / step)))
    places = (time - time[0]) / step
    index = np.round(places).astype(np.int64)
    n = int(index[-1]) + 1
    regular = bool((np.abs(places - index) < OFF_GRID).all()) and bool((np.diff(index) > 0).all())
    if not regular or n == record.n or record.n < (1.0 - MOST_MISSING) * n:
        return record
    # takes a second to import, and few records have gaps
    from scipy.interpolate import CubicSpline

    grid = time[0] + step * np.arange(n)
    channels = {}
    for name in (*chain_channels, *inputs):
        values = np.full(n, np.nan)
        values[index] = record[name]
        if name in inputs:
            values = CubicSpline(time, record[name])(grid)
            values[index] = record[name]
        channels[name] = values
    return Record(channels=channels, time=grid, units=record.units, name=record.name)
