"""``assemble``: columns to the parts of records. Which column is time, what the units are, where trials begin."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import DataWarning, RecordError
from bayeq.records.columns import Columns, listed
from bayeq.records.truth import FloatArray
from bayeq.records.validate import SECONDS, check_time, time_from, trial_starts

__all__ = ["Trial", "assemble"]


class Trial(NamedTuple):
    """What a `Record` is made of: channels, time [s], units, name."""

    channels: dict[str, FloatArray]
    time: FloatArray | None
    units: dict[str, str]
    name: str


def assemble(
    data: Columns,
    *,
    time: str | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    group: str | None = None,
    columns: Sequence[str] | str | None = None,
    name: str | None = None,
) -> list[Trial]:
    """The columns as one record, or as one for each run of equal values of the column `group`.

    Parameters are those of `bayeq.records.read`; `name` labels the records.
    """
    where = data.headers.where
    for doubt in data.doubts:
        warnings.warn(doubt, DataWarning, stacklevel=3)  # the caller of `read` or `Record.from_dataframe`
    if time is not None and fs is not None:
        raise RecordError(f"{where}: time and fs are both given; give one of them")
    known_units: dict[int, str | None] = dict(enumerate(data.headers.units))
    for key, unit in (units or {}).items():
        known_units[data.headers.find(key)] = unit
    time_column = None if fs is not None else data.headers.find(time) if time is not None else data.headers.time
    group_column = None if group is None else data.headers.find(group)
    wanted = None if columns is None else {data.headers.find(c) for c in listed(columns)}

    n = len(data.values[0]) if data.values else 0
    starts = [0]
    if group_column is not None:
        place = f"{where}, column {data.headers.texts[group_column] or data.names[group_column]!r}"
        starts = trial_starts(data.values[group_column], n, place)
    stops = [*starts[1:], n]
    seconds, kept_units = _time(data, time_column, known_units, np.asarray(starts, dtype=np.intp))

    channels: dict[str, FloatArray] = {}
    for i, (column, values) in enumerate(zip(data.names, data.values, strict=True)):
        if i not in (time_column, group_column) and (wanted is None or i in wanted):
            channels[column] = values
            if own := known_units[i]:
                kept_units[column] = own
    if not channels:
        raise RecordError(f"{where}: no channels besides time; the columns are {', '.join(data.names)}")

    label = where if name is None else name
    trials = []
    for trial, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        rows = {column: values[start:stop] for column, values in channels.items()}
        t = None if seconds is None else seconds[start:stop]
        title = label if group is None else f"{label} [trial {trial}]"
        trials.append(Trial(rows, time_from(rows, t, fs, where), kept_units, title))
    return trials


def _time(
    data: Columns,
    column: int | None,
    units: Mapping[int, str | None],
    starts: NDArray[np.intp],
) -> tuple[FloatArray | None, dict[str, str]]:
    """Time in seconds, checked, and the unit it has if that cannot be turned into seconds."""
    if column is None:
        return None, {}
    seconds, unit = data.values[column], units[column]
    if unit is not None and unit in SECONDS:
        factor = SECONDS[unit]
        # Dividing by 1000 rounds once; multiplying by 0.001, itself rounded, would round twice.
        seconds = seconds * factor if factor >= 1 else seconds / round(1 / factor)
        unit = "s"
    where = f"{data.headers.where}, column {data.headers.texts[column] or data.names[column]!r}"
    check_time(seconds, where, starts)
    others = [name for i, name in enumerate(data.names) if i != column]
    return seconds, {"t": unit} if unit and "t" not in others else {}
