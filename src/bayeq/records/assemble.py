"""``assemble``: columns to the parts of records. Which column is time, what the units are, where trials begin."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.errors import DataWarning, RecordError
from bayeq.records.columns import Columns, listed
from bayeq.records.names import time_unit
from bayeq.records.units import gain_and_unit
from bayeq.records.validate import SECONDS, check_time, in_seconds, time_from, trial_starts

#: Names of a single number that is the time step [s], or the sampling rate [Hz].
STEP_NAMES = ("dt", "Dt", "DT", "Ts", "dT", "delta_t", "time_step", "sampling_time", "sample_time", "wf_increment")
RATE_NAMES = (
    "fs", "Fs", "FS", "fsamp", "sample_rate", "sampling_rate", "SampleRate", "samplerate", "sampling_frequency",
)  # fmt: skip


class Trial(NamedTuple):
    """What a `Record` is made of: channels, time [s], units, name."""

    channels: dict[str, Floats]
    time: Floats | None
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
    gains: dict[int, float] = {}
    for key, unit in (units or {}).items():
        place = data.headers.find(key)
        gain, known_units[place] = gain_and_unit(unit, known_units[place])
        if gain != 1.0:
            gains[place] = gain
    time_column = find_time(data, known_units, time, fs)
    group_column = None if group is None else data.headers.find(group)
    wanted = None if columns is None else {data.headers.find(c) for c in listed(columns)}

    n = len(data.values[0]) if data.values else 0
    starts = [0]
    if group_column is not None:
        starts = trial_starts(data.values[group_column], n, _place(data, group_column))
    stops = [*starts[1:], n]
    if gains:
        data = replace(data, values=[x * gains[i] if i in gains else x for i, x in enumerate(data.values)])
    seconds, kept_units = _time(data, time_column, known_units)
    if seconds is not None:
        again = check_time(seconds, _place(data, time_column), np.asarray(starts, dtype=np.intp), repeated=True)
        if again.size:
            _warn_of_repeated(again, _place(data, time_column))
            kept = np.delete(np.arange(n), again)
            seconds, data = seconds[kept], replace(data, values=[values[kept] for values in data.values])
            starts = np.searchsorted(kept, starts).tolist()
            stops = [*starts[1:], len(kept)]

    step, step_column = (None, None) if seconds is not None else _stated_step(data, fs)
    channels: dict[str, Floats] = {}
    for i, (column, values) in enumerate(zip(data.names, data.values, strict=True)):
        if i not in (time_column, group_column) and (i != step_column if wanted is None else i in wanted):
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
        if t is None and fs is None and step is not None:
            t = data.start + step * np.arange(stop - start, dtype=np.float64)
        trials.append(Trial(rows, time_from(rows, t, fs, where), kept_units, title))
    return trials


def find_time(
    data: Columns, units: Mapping[int, str | None], time: str | None = None, fs: float | None = None
) -> int | None:
    """The column that is time: the one named, else by its name, else the first rising one whose unit is a time.

    `units` are those of the columns; with a rate `fs` no column is time.
    """
    if fs is not None:
        return None
    if time is not None:
        return data.headers.find(time)
    if data.time is not None:
        return data.time
    if data.headers.time is not None or data.step is not None or len(data.values) < 2:
        return data.headers.time
    return next((i for i, x in enumerate(data.values) if units.get(i) in SECONDS and _rises(x)), None)


def _rises(values: Floats) -> bool:
    with np.errstate(invalid="ignore"):
        return len(values) > 1 and bool(np.all(np.isfinite(values))) and bool(np.all(np.diff(values) > 0))


def _stated_step(data: Columns, fs: float | None) -> tuple[float | None, int | None]:
    """The time step [s] that the file states, in its header or a column such as Ts whose one value it is; which."""
    step = data.step
    if step is None and fs is None:
        for i, (name, values) in enumerate(zip(data.names, data.values, strict=True)):
            known = values[np.isfinite(values)]
            if known.size and values[0] == known[0] and np.all(known == known[0]) and known[0] > 0:
                if name in STEP_NAMES:
                    return float(known[0]), i
                if name in RATE_NAMES:
                    return 1.0 / float(known[0]), i
    if step is not None and fs is not None and fs > 0 and not 0.99 < fs * step < 1.01:
        raise RecordError(
            f"{data.headers.where}: fs {fs:g} contradicts the file, whose sampling rate is {1 / step:.6g} Hz; leave fs"
            " out, or name a column as time"
        )
    return step, None


def _time(data: Columns, column: int | None, units: Mapping[int, str | None]) -> tuple[Floats | None, dict[str, str]]:
    """Time in seconds, and the unit it has if that cannot be turned into seconds."""
    if column is None:
        return None, {}
    seconds, unit = data.values[column], units[column] or time_unit(data.names[column])
    seconds, unit = in_seconds(seconds, unit, data.names[column])
    others = [name for i, name in enumerate(data.names) if i != column]
    return seconds, {"t": unit} if unit and "t" not in others else {}


def _place(data: Columns, column: int | None) -> str:
    return f"{data.headers.where}, column {data.headers.texts[column or 0] or data.names[column or 0]!r}"


def _warn_of_repeated(rows: NDArray[np.intp], where: str) -> None:
    listed = ", ".join(str(row + 1) for row in rows[:5]) + (", ..." if len(rows) > 5 else "")
    counted = f"{len(rows)} rows repeat times" if len(rows) > 1 else "1 row repeats the time"
    message = f"{where}: {counted} of the row before ({listed}): the first of each is kept; check the acquisition"
    warnings.warn(message, DataWarning, stacklevel=4)
