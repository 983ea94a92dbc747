"""Records of maps: time in samples, and earlier samples of inputs as channels of their own."""

from __future__ import annotations

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import RecordError
from bayeq.expressions.parse import EARLIER
from bayeq.records import SAMPLES, Record
from bayeq.states.prepare import fitted_grid, on_grid
from bayeq.states.roles import Roles

# Times are on a grid if they are off by no more than this share of its step.
OFF_GRID = 0.1


def in_samples(record: Record, roles: Roles) -> Record:
    """The record with the number of the sample as time, and with earlier samples of inputs as channels of their own.

    The first of them, before the record, are taken to be like the first one of the input.

    Raises
    ------
    RecordError
        Uneven steps of time.
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
        shifted = moved(on_grid(Record({base: record[base]}, time), [base])[base], back)
        shifted[:back] = record[base][0]
        channels[name] = shifted[time.astype(int)]
        if base in record.units:
            units[name] = record.units[base]
    return Record(channels, time, units, record.name, record.truth)


def moved(values: Floats, back: int) -> Floats:
    """The samples that are so many back, or ahead; NaN where there is none."""
    out = np.full(len(values), np.nan)
    if back >= 0:
        out[back:] = values[: len(values) - back]
    else:
        out[:back] = values[-back:]
    return out
