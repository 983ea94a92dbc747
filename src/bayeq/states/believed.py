"""Records that are believed up to a frequency: what is faster is taken out, hum or the resonance of a sensor.

All channels go through the same low-pass filter without delay, which leaves an equation between them as it is where the
motion itself is slower, and are sampled again no finer than what is left: noise stays white, which the likelihood takes
it for. What varies slower than is believed is a state of the likelihood (`bayeq.likelihood.layout`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import RecordError
from bayeq.records import Record
from bayeq.states.uniform_grid import on_grid

__all__ = ["low_passed"]

Floats = NDArray[np.float64]

# Samples in a cycle of the highest frequency that is believed. From it to half of them the filter goes down, to
# ATTENUATION [dB] (Kaiser's window).
RATE, ATTENUATION = 2.4, 50.0

# A sample of which less than this share is known is missing.
LEAST_KNOWN = 0.8

# New samples that are worked out at once.
TOGETHER = 4096


def low_passed(
    records: Sequence[Record], names: Sequence[str], low: float, high: float, fewest: int
) -> tuple[list[Record], float]:
    """Records without what is faster than a frequency.

    Parameters
    ----------
    records : sequence of Record
        With time; NaN where a sample is missing.
    names : sequence of str
        The channels that are wanted.
    low, high : float
        Frequencies that are believed [Hz].
    fewest : int
        Rows that a record has to have left.

    Returns
    -------
    list of Record
        As they are where they are sampled no finer than that.
    float
        Factor of the standard deviation of white noise.

    Raises
    ------
    RecordError
        Records that are not sampled evenly and at one rate, or that hold too few periods.
    """
    even = [on_grid(record, names, ()) for record in records]
    steps = np.concatenate([np.diff(np.asarray(record.time)) for record in even if record.time is not None])
    name = records[0].name or "record"
    if not len(steps) or np.ptp(steps) > 1e-3 * steps.mean():
        raise RecordError(
            f"{name}: a band of frequencies needs records sampled evenly and all at one rate; leave the band out, or"
            " resample"
        )
    fs = float(1.0 / steps.mean())
    if low >= 0.5 * fs:
        raise RecordError(
            f"{name}: the band {low:g} to {high:g} Hz is above half of the sampling rate, {0.5 * fs:g} Hz"
        )
    if RATE * high >= fs:
        return list(records), 1.0
    beta = 0.5842 * (ATTENUATION - 21.0) ** 0.4 + 0.07886 * (ATTENUATION - 21.0)
    half = (ATTENUATION - 8.0) / (2.285 * 2.0 * np.pi * (0.5 * RATE - 1.0) * high) / 2.0
    cutoff = 0.5 * (1.0 + 0.5 * RATE) * high

    def weights(lag: Floats) -> Floats:
        window = np.i0(beta * np.sqrt(np.maximum(1.0 - (lag / half) ** 2, 0.0))) / np.i0(beta)
        return np.asarray(np.where(np.abs(lag) <= half, 2.0 * cutoff / fs * np.sinc(2.0 * cutoff * lag) * window, 0.0))

    counts = [int(((record.n - 1) / fs - 2.0 * half) * RATE * high) + 1 for record in even]
    found = [
        _sampled(record, names, fs, half, RATE * high, count, weights)
        for record, count in zip(even, counts, strict=True)
        if count >= fewest
    ]
    if not found:
        raise RecordError(
            f"{name}: of frequencies up to {high:g} Hz alone fewer than {fewest} rows are left; widen the band, or"
            " leave it out"
        )
    lag = np.arange(-np.floor(half * fs), half * fs) / fs
    return found, float(np.sqrt(np.sum(weights(lag) ** 2)))


def _sampled(
    record: Record,
    names: Sequence[str],
    fs: float,
    half: float,
    rate: float,
    count: int,
    weights: Callable[[Floats], Floats],
) -> Record:
    """A record filtered and sampled at another rate, as far from its ends as the filter reaches."""
    time = np.asarray(record.time)
    places = (half + np.arange(count) / rate) * fs  # in rows
    reach = int(half * fs)
    offsets = np.arange(-reach, reach + 1)
    values = np.column_stack([np.asarray(record[name], dtype=np.float64) for name in names])
    known = np.isfinite(values)
    out = np.empty((count, len(names)))
    for first in range(0, count, TOGETHER):
        own = places[first : first + TOGETHER, None]
        rows = np.clip(np.rint(own).astype(np.int64) + offsets, 0, len(time) - 1)
        factors = weights((rows - own) / fs)[:, :, None] * known[rows]
        total = factors.sum(axis=1)
        mean = np.einsum("kij,kij->kj", factors, np.where(known, values, 0.0)[rows])
        with np.errstate(all="ignore"):
            out[first : first + TOGETHER] = np.where(total > LEAST_KNOWN, mean / total, np.nan)
    units = {name: unit for name, unit in record.units.items() if name in names or name == "t"}
    channels = dict(zip(names, out.T, strict=True))
    return Record(channels, time[0] + places / fs, units, record.name)
