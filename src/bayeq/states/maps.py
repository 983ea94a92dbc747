"""Records of maps: time in samples, and earlier samples of inputs as channels of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import RecordError
from bayeq.expressions.parse import EARLIER
from bayeq.records import SAMPLES, Record
from bayeq.states.prepare import fitted_grid
from bayeq.states.roles import Roles
from bayeq.states.sensors import bridged

# Times are on a grid if they are off by no more than this share of its step.
OFF_GRID = 0.1

# Samples before and after a missing one that are compared with those around others.
AROUND = (2, 1, -1, -2)


def in_samples(record: Record, roles: Roles) -> Record:
    """The record with the number of the sample as time, and with earlier samples of inputs as channels of their own.

    The first of them, before the record, are taken to be like the first one of the input. A RecordError refuses uneven
    steps of time.
    """
    time = np.arange(record.n, dtype=np.float64)
    if record.time is not None and record.n > 2:
        index, start, step = fitted_grid(np.asarray(record.time))
        off = np.abs(np.asarray(record.time) - start - step * index).max()
        if not (np.diff(index) > 0).all() or off > OFF_GRID * step:
            raise RecordError(
                f"{record.name or 'record'}: steps of time are uneven, and a map goes from sample to sample: resample"
                " evenly, or leave time out"
            )
        time = index.astype(np.float64)
    channels, units = dict(record.channels), {**record.units, "t": SAMPLES}
    for name in roles.inputs:
        found = EARLIER.fullmatch(name)
        if found is None:
            continue
        base, back = found["name"], int(found["back"])
        places = np.searchsorted(time, time - back)
        there = time[places] == time - back
        channels[name] = np.where(there | (time - back < time[0]), record[base][places], np.nan)
        if base in record.units:
            units[name] = record.units[base]
    return Record(channels, time, units, record.name, record.truth)


def likened(channels: Sequence[Floats]) -> list[Floats]:
    """Channels with missing samples taken from where those around them were most alike.

    A chaotic map may be anywhere between two samples: a straight line would lead the likelihood astray.
    """
    samples = np.column_stack(channels)
    scale = np.nanstd(samples, axis=0)
    around = np.hstack([np.column_stack([moved(column, back) for column in samples.T]) for back in AROUND])
    around /= np.tile(np.where(scale > 0.0, scale, 1.0), len(AROUND))
    out = samples.copy()
    for row in np.flatnonzero(np.isnan(samples).any(axis=1)):
        seen = np.isfinite(around[row])
        apart = np.sum((around[:, seen] - around[row, seen]) ** 2, axis=1)
        for i in np.flatnonzero(np.isnan(samples[row])):
            alike = np.where(np.isnan(apart) | np.isnan(samples[:, i]), np.inf, apart)
            out[row, i] = samples[int(np.argmin(alike)), i] if np.isfinite(alike).any() else np.nan
    return [bridged(column) for column in out.T]


def moved(values: Floats, back: int) -> Floats:
    """The sample so far back at each row, or ahead where that is negative; NaN where there is none."""
    out = np.full(len(values), np.nan)
    if back >= 0:
        out[back:] = values[: len(values) - back]
    else:
        out[:back] = values[-back:]
    return out
