"""A record put on its uniform grid of time: dropped samples put back, rounded times made even."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.records import Record
from bayeq.records.sampling import JITTER, is_step
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.model import ChainSeries
from bayeq.states.kinematic.smoother import smooth_kinematic

__all__ = ["filled_in", "on_grid"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# No more than this share of the samples may be missing.
MOST_MISSING = 0.4

# Times that are multiples of such a power of ten may have been rounded to it, which moves them by half of it at most;
# the grid fitted to them may be off by a little more.
DECIMALS = range(1, 10)
ROUNDED_BY = 0.6

# ... and are such multiples if they are off by a smaller share of it.
SAME_DECIMALS = 1e-6

# Steps that count as one when the grid's own is sought, as shares of the median.
SINGLE = (0.5, 1.5)


def on_grid(record: Record, names: Sequence[str]) -> Record:
    """The record with a row for every sample of its grid: the same record, if none is missing or there is no grid.

    The channels named are NaN in rows that are filled in, for a smoother to bridge. Times that are off their grid by
    little (0.033, 0.067, 0.100 at 30 Hz, written with three decimals) become even.
    """
    if record.time is None or record.n < 3:
        return record
    time = np.asarray(record.time)
    index = _places(time)
    n = int(index[-1]) + 1
    if not (np.diff(index) > 0).all() or record.n < (1.0 - MOST_MISSING) * n:
        return record
    start, step = _fitted(time, index)
    off = float(np.abs(time - start - step * index).max())
    if off > JITTER * step and not _is_rounding(time, off, step):
        return record
    if record.n == n and is_step(time, float(time[-1] - time[0]) / (n - 1), 0.0).all():
        return record
    grid = start + step * np.arange(n, dtype=np.float64)
    if n == record.n:
        return Record(record.channels, grid, record.units, record.name, record.truth)
    channels = {}
    for name in names:
        channels[name] = np.full(n, np.nan)
        channels[name][index] = record[name]
    units = {name: unit for name, unit in record.units.items() if name in channels or name == "t"}
    return Record(channels=channels, time=grid, units=units, name=record.name)


def filled_in(time: Floats, samples: Floats) -> Floats:
    """Samples with missing ones interpolated; a spline through noisy samples would overshoot in a gap."""
    if np.isfinite(samples).all():
        return samples
    series = ChainSeries(time, (samples,))
    try:
        values = smooth_kinematic(series, fit_kinematic([series])).mean[:, 0]
    except InputError:  # a few samples, or one value throughout
        known = np.isfinite(samples)
        values = np.interp(time, time[known], samples[known])
    return np.where(np.isnan(samples), values, samples)


def _places(time: Floats) -> Ints:
    """Number of each sample on a grid that begins with the first."""
    steps = np.diff(time)
    median = float(np.median(steps))
    single = steps[(steps > SINGLE[0] * median) & (steps < SINGLE[1] * median)]
    index = np.append(0, np.cumsum(np.round(steps / single.mean()).astype(np.int64)))
    # once more with the grid of all samples, which a long gap asks for
    start, step = _fitted(time, index)
    again = np.round((time - start) / step).astype(np.int64)
    return again - again[0]


def _fitted(time: Floats, index: Ints) -> tuple[float, float]:
    """Begin and step of the grid, by least squares."""
    centre = index - index.mean()
    step = float(centre @ time / (centre @ centre))
    return float(time.mean() - step * index.mean()), step


def _is_rounding(time: Floats, off: float, step: float) -> bool:
    """Whether times are multiples of a power of ten, and off a grid by no more than rounding to it."""
    for decimals in DECIMALS:
        unit = 10.0**-decimals
        if np.abs(time - np.round(time, decimals)).max() <= SAME_DECIMALS * unit:
            return off <= ROUNDED_BY * unit and unit < step
    return False
