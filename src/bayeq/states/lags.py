"""Channels that are late: their samples moved to the times that they are of."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayeq.records import Record, correct_delay
from bayeq.states.prepare import on_grid
from bayeq.states.sensors import Lag
from bayeq.states.unit_gains import bridged


def without_lags(record: Record, lags: Mapping[str, Lag], whole: bool = False) -> Record:
    """The record with the lags of some channels taken out, by band-limited interpolation, which keeps noise white.

    Parameters
    ----------
    record : Record
        Sampled at even steps of time, but for rows that are missing.
    lags : mapping of str to Lag
        Of channels.
    whole : bool
        Whether the rows at an end of which a channel has no sample repeat the nearest one, rather than lack it.

    Raises
    ------
    RecordError
        Uneven time, or a lag as long as the record.
    """
    lags = {name: lag for name, lag in lags.items() if name in record.channels and lag.value != 0.0}
    if not lags:
        return record
    record = on_grid(record, list(record.channels))
    changed = {}
    for name, lag in lags.items():
        samples = record[name]
        moved = correct_delay(record.with_channels({name: bridged(samples)}), name, lag.value)
        assert record.time is not None
        assert moved.time is not None
        first = int(np.searchsorted(record.time, moved.time[0]))
        values = np.full(record.n, np.nan)
        values[first : first + moved.n] = moved[name]
        lacking = np.interp(record.time + lag.value, record.time, np.isnan(samples)) > 0.0
        changed[name] = bridged(values) if whole else np.where(lacking, np.nan, values)
    return record.with_channels(changed, {name: record.units[name] for name in changed if name in record.units})
