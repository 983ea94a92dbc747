"""``Columns``: the columns of a file before they become a record; `Headers`: their names; `Request`: which to read."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import DataWarning, FileFormatError, InputError, RecordError, UnknownNameError, WordsError, some_of
from bayeq.records.names import clean_name, clean_names, gain_and_unit, is_time_name, time_unit, unit_in_name
from bayeq.records.validate import SECONDS, as_column, as_time, check_time, in_seconds, time_from, trial_starts

if TYPE_CHECKING:
    import pandas as pd

#: Names of columns; a string is split at commas.
Names = Sequence[str] | str | None

#: Wildcard for the number of an array in a path; each match makes one record.
STAR = "[*]"

# A last row that goes back in time after at least this many rows is a summary, and is left out.
LEAST_ABOVE = 20


def listed(names: Sequence[str] | str) -> list[str]:
    """Names as a list; a single string is split at its commas.

    >>> listed("x, acc [g]")
    ['x', 'acc [g]']
    """
    return [part.strip() for part in names.split(",")] if isinstance(names, str) else list(names)


@dataclass(frozen=True, slots=True)
class Headers:
    """Names of columns: as written, as cleaned, and their units.

    >>> headers = Headers.parse(["Time [s]", "x (mm)"], "run.csv")
    >>> headers.find("Time [s]"), headers.find("Time"), headers.time
    (0, 0, 0)
    """

    texts: list[str]
    names: list[str]
    units: list[str | None]
    where: str = ""

    @classmethod
    def parse(cls, texts: Iterable[str], where: str = "", stated: Mapping[str, str] | None = None) -> Headers:
        """Clean the texts of headers; `stated` units, by header text, take precedence over those in the texts."""
        texts = [str(text).strip() for text in texts]
        names, units = clean_names(texts)
        found = [unit or unit_in_name(text) for text, unit in zip(texts, units, strict=True)]
        if stated:
            found = [stated.get(text, unit) or None for text, unit in zip(texts, found, strict=True)]
        return cls(texts, names, found, where)

    @classmethod
    def of_dataframe(cls, df: pd.DataFrame, time: str | None) -> Headers:
        """Headers of a data frame; an index that is time (by its name or `time`, or as dates) comes first."""
        index = [] if df.index.name is None else [str(df.index.name)]
        if index and not (is_time_name(clean_name(index[0])[0]) or time == index[0]):
            index = []
        columns = list(map(str, df.columns))
        timed = time is not None or any(is_time_name(name) for name in clean_names(columns)[0])
        if not index and not timed and getattr(df.index.dtype, "kind", "O") in "Mm":
            index = ["t"]  # dates can only be time
        return cls.parse([*index, *columns], "data frame")

    def __len__(self) -> int:
        return len(self.names)

    def find(self, key: str) -> int:
        """Index of the column called `key`: its cleaned name, its original header, or the header without its unit."""
        as_path = key.strip().strip("/").replace("/", ".")  # as HDF5 writes paths
        places = ((self.names, key), (self.texts, key.strip()), (self.names, clean_name(key)[0]), (self.texts, as_path))
        for keys, asked in places:
            if asked in keys:
                return keys.index(asked)
        raise UnknownNameError("column", key, self.names, self.where)

    def clashes(self, rows: Sequence[int]) -> list[str]:
        """Warnings about columns `rows` that share their cleaned header with other columns."""
        alike: dict[str, list[int]] = {}
        for i, text in enumerate(self.texts):
            alike.setdefault(clean_name(text, i + 1)[0], []).append(i)
        return [
            f"{self.where}: columns {' and '.join(str(i + 1) for i in columns)} have the same name: they are read as"
            f" {some_of([self.names[i] for i in columns], 30)}; rename them"
            for columns in alike.values()
            if len(columns) > 1 and not set(columns).isdisjoint(rows)
        ]

    @property
    def time(self) -> int | None:
        """Index of the first column named like time; T, which may be temperature, only in front and without another."""
        found = [i for i, name in enumerate(self.names) if is_time_name(name) and (name != "T" or i == 0)]
        return next((i for i in found if self.names[i] != "T"), found[0] if found else None)

    def at(self, rows: Sequence[int]) -> Headers:
        """Headers of the columns with indices `rows`."""
        texts, names = ([column[i] for i in rows] for column in (self.texts, self.names))
        return Headers(texts, names, [self.units[i] for i in rows], self.where)

    def renamed(self, names: Names) -> Headers:
        """The same columns under the names that the caller gives, in order."""
        if names is None:
            return self
        if isinstance(names, str):
            names = names.replace(",", " ").split()
        if len(names) != len(self):
            raise FileFormatError(f"{self.where}: names gives {len(names)} names for {len(self)} columns")
        new = Headers.parse(names, self.where)
        return replace(new, units=[unit or old for unit, old in zip(new.units, self.units, strict=True)])


#: Function of the headers that returns the indices of the columns to read.
Select = Callable[[Headers], Sequence[int]]


@dataclass(frozen=True, eq=False, slots=True)
class Columns:
    """Columns of a file, in order."""

    headers: Headers
    values: list[Floats]  # samples, (n,) each; missing cells are NaN
    doubts: tuple[str, ...] = ()  # warnings to issue
    time: int | None = None  # index of the time column, if the file marks it other than by its name
    step: float | None = None  # time step [s] that the file states
    start: float = 0.0  # time of the first row [s], where `step` is given
    begins: float | None = None  # reading of the clock at time 0 [s since 1970], if the file has dates

    @property
    def names(self) -> list[str]:
        """The cleaned names."""
        return self.headers.names

    @classmethod
    def build(
        cls, headers: Headers, values: Callable[[int], Any], chosen: Select | None = None, group: str | None = None
    ) -> Columns:
        """Take the chosen columns; `values(i)` gives the samples of column i, numbers, or of the `group` also words."""
        rows = list(chosen(headers)) if chosen else list(range(len(headers)))
        arrays, begins = [], None
        kept = headers.at(rows)
        labels = None if group is None else headers.find(group)
        for place, i in enumerate(rows):
            raw = np.asanyarray(values(i))
            if i == labels and raw.dtype.kind == "O":
                raw = np.unique(raw.astype(str), return_inverse=True)[1]
            what = f"column {headers.texts[i] or headers.names[i]!r}"
            try:
                if raw.dtype.kind in "mM":
                    arrays.append(as_time(raw, headers.where))
                    if raw.dtype.kind == "M" and raw.size and not np.isnat(raw[0]):
                        begins = float(raw[0].astype("datetime64[us]").astype(np.int64)) * 1e-6
                    kept.units[place] = "s"
                else:
                    arrays.append(as_column(raw, what, headers.where))
            except RecordError as error:
                if raw.dtype.kind in "biufc":
                    raise FileFormatError(str(error)) from None
                others = [headers.names[j] for j in rows if j != i]
                hint = "; name the columns to read if this one is not needed"
                raise WordsError(f"{error}{hint}", headers.names[i], others) from None
        return cls(kept, arrays, tuple(headers.clashes(rows)), begins=begins)

    @classmethod
    def from_dataframe(cls, df: pd.DataFrame, request: Request) -> Columns:
        """The columns of a data frame; columns of words are left out, with a warning, unless columns are requested."""
        time, headers = request.time, Headers.of_dataframe(df, request.time)
        first = len(headers) - len(df.columns)  # 1 with an index

        def values(i: int) -> Any:
            series: Any = df.index if i < first else df.iloc[:, i - first]
            if getattr(series.dtype, "kind", "O") in "biuf":  # nullable columns hold NA, which is not a float
                return series.to_numpy(dtype=float, na_value=np.nan)
            if getattr(series.dtype, "tz", None) is not None:
                series = series.tz_convert(None) if i < first else series.dt.tz_convert(None)
            if getattr(series.dtype, "kind", "O") == "O":
                return _of_objects(series)
            return series.to_numpy()

        rows = request.rows(headers)
        words = [i for i in rows if np.asarray(values(i)).dtype.kind == "O"]
        asked = {headers.find(time)} if time is not None else set()
        if request.columns is not None or len(words) == len(rows) or not asked.isdisjoint(words):
            words = []  # `build` refuses them by name
        found = cls.build(headers, values, lambda _: [i for i in rows if i not in words])
        names = ", ".join(repr(headers.texts[i]) for i in words)
        hold = "holds" if len(words) == 1 else "hold"
        doubt = f"{headers.where}: {names} {hold} words, not numbers: left out; give the columns to keep"
        return replace(found, doubts=(*found.doubts, doubt)) if words else found


def _of_objects(series: Any) -> Any:
    """Objects as float64 if all are numbers or missing, else as dates if all are ISO 8601, else unchanged."""
    import pandas as pd

    try:
        found = pd.to_numeric(series)  # also of text, and with None
        if found.dtype.kind == "O":  # decimals, huge integers
            return found.to_numpy().astype(float)
        return found.to_numpy(dtype=float, na_value=np.nan)
    except (ValueError, TypeError, OverflowError):
        pass
    try:
        return pd.to_datetime(series, format="ISO8601").to_numpy()
    except (ValueError, TypeError, OverflowError):
        return series.to_numpy()


@dataclass(frozen=True, slots=True)
class Request:
    """Columns, time and trials that `bayeq.records.read` is to read."""

    columns: Names = None  # columns to keep under their own names
    channels: Mapping[str, str] = field(default_factory=dict)  # columns to keep: new name to path or header
    time: str | None = None  # the time column
    group: str | None = None  # the column that numbers the trials
    fs: float | None = None  # sampling rate [Hz]; no column is time then

    @property
    def names(self) -> list[str] | None:
        """The requested columns, without time and group; None for all columns."""
        if self.columns is None and not self.channels:
            return None
        return [*listed(self.columns or []), *self.channels.values()]

    def rows(self, headers: Headers) -> list[int]:
        """Indices of the columns to read: those requested, time (or columns with a unit of time) and the group."""
        if self.names is None:
            return list(range(len(headers)))
        needed = {headers.find(name) for name in self.names}
        needed.update(headers.find(name) for name in (self.time, self.group) if name is not None)
        if self.time is None and self.fs is None:
            if headers.time is not None:
                needed.add(headers.time)
            else:
                needed.update(i for i, unit in enumerate(headers.units) if unit in SECONDS)
        return sorted(needed)

    def renamed(self, data: Columns) -> Columns:
        """The columns under their new names in `channels`; a column with two new names is repeated."""
        if not self.channels:
            return data
        headers = data.headers
        found = {name: headers.find(path) for name, path in self.channels.items()}
        others = [i for i in range(len(headers)) if i not in found.values()]
        rows = [*others, *found.values()]
        names = [*(headers.names[i] for i in others), *found]
        again = sorted({name for name in names if names.count(name) > 1})
        if again:
            raise InputError(f"{headers.where}: the name {again[0]!r} is given to one column and is that of another")
        new = replace(headers.at(rows), names=names)
        time = None if data.time is None else rows.index(data.time)
        return replace(data, headers=new, values=[data.values[i] for i in rows], time=time)

    def each(self, paths: Sequence[str], where: str) -> list[Request]:
        """One request for each array of `paths` that ``[*]`` matches; this request alone if it has no ``[*]``."""
        starred = [p for p in (*(self.names or ()), self.time, self.group) if p is not None and STAR in p]
        numbers: dict[str, set[int]] = {}
        for path in starred:
            if path.count(STAR) > 1:
                raise InputError(f"{where}: {path!r} has two stars; write one")
            before, after = map(re.escape, path.split(STAR))
            pattern = re.compile(rf"{before}\[(\d+)\]{after}")
            numbers[path] = {int(match[1]) for p in paths if (match := pattern.fullmatch(p))}
            if not numbers[path]:
                raise UnknownNameError("array", path, paths, where)
        if not starred:
            return [self]
        every = set().union(*numbers.values())
        for path, have in numbers.items():
            if have != every:
                lacking = min(every - have)
                raise InputError(
                    f"{where}: there is no {path.replace(STAR, f'[{lacking}]')}; name one record at a time"
                )
        return [self._numbered(f"[{k}]") for k in sorted(every)]

    def _numbered(self, number: str) -> Request:
        columns = None if self.columns is None else [name.replace(STAR, number) for name in listed(self.columns)]
        channels = {name: path.replace(STAR, number) for name, path in self.channels.items()}
        time, group = (path and path.replace(STAR, number) for path in (self.time, self.group))
        return Request(columns, channels, time, group, self.fs)


#: Names under which files hold the time step [s] or the sampling rate [Hz] as a single number.
STEP_NAMES = ("dt", "Dt", "DT", "Ts", "dT", "delta_t", "time_step", "sampling_time", "sample_time", "wf_increment")
RATE_NAMES = (
    "fs", "Fs", "FS", "fsamp", "sample_rate", "sampling_rate", "SampleRate", "samplerate", "sampling_frequency",
)  # fmt: skip


def assemble(
    data: Columns, request: Request, units: Mapping[str, str] | None = None, name: str | None = None
) -> list[dict[str, Any]]:
    """Arguments of `Record` for each run of equal values of the group; `units` take precedence over stated ones."""
    where, time, fs, group = data.headers.where, request.time, request.fs, request.group
    for doubt in data.doubts:
        warnings.warn(doubt, DataWarning, stacklevel=3)  # the caller of `read` or `Record.from_dataframe`
    if time is not None and fs is not None:
        raise RecordError(f"{where}: time and fs are both given; give one of them")
    known_units: dict[int, str | None] = dict(enumerate(data.headers.units))
    gains: dict[int, float] = {}
    for key, unit in (units or {}).items():
        place = data.headers.find(key)
        gains[place], known_units[place] = gain_and_unit(unit, known_units[place])
    time_column = find_time(data, known_units, time, fs)
    group_column = None if group is None else data.headers.find(group)
    wanted = None
    if request.names is not None:
        wanted = {data.headers.find(c) for c in (*listed(request.columns or []), *request.channels)}

    n = len(data.values[0]) if data.values else 0
    starts = [0] if group_column is None else trial_starts(data.values[group_column], n, _place(data, group_column))
    values = [x * gains[i] if gains.get(i, 1.0) != 1.0 else x for i, x in enumerate(data.values)]
    data = replace(data, values=values)
    seconds, kept_units, begins = _time(data, time_column, known_units)
    if seconds is not None:
        assert time_column is not None
        where_time = _place(data, time_column)
        kept = np.arange(n)
        if group is None and _ends_in_a_summary(seconds):
            message = f"{where_time}: time goes back in row {n}, the last: it is left out; check the clock"
            warnings.warn(message, DataWarning, stacklevel=3)
            kept = kept[:-1]
        again = check_time(seconds[: len(kept)], where_time, np.asarray(starts, dtype=np.intp), repeated=True)
        if again.size:
            rows = ", ".join(str(row + 1) for row in again[:2]) + (", ..." if len(again) > 2 else "")
            counted = f"{len(again)} rows repeat times" if len(again) > 1 else "1 row repeats the time"
            message = f"{where_time}: {counted} of the row before ({rows}): the first is kept; check the logger"
            warnings.warn(message, DataWarning, stacklevel=3)
            kept = np.delete(kept, again)
        if len(kept) < n:
            seconds, data = seconds[kept], replace(data, values=[one[kept] for one in values])
            starts, n = np.searchsorted(kept, starts).tolist(), len(kept)

    step, step_column = (None, None) if seconds is not None else _stated_step(data, fs)
    channels: dict[str, Floats] = {}
    for i, (column, samples) in enumerate(zip(data.names, data.values, strict=True)):
        if i not in (time_column, group_column) and (i != step_column if wanted is None else i in wanted):
            channels[column] = samples
            if own := known_units[i]:
                kept_units[column] = own
    if not channels:
        raise RecordError(f"{where}: no channels besides time; the columns are {', '.join(data.names)}")

    label = where if name is None else name
    trials: list[dict[str, Any]] = []
    for trial, (start, stop) in enumerate(pairwise([*starts, n])):
        parts = {column: samples[start:stop] for column, samples in channels.items()}
        t = None if seconds is None else seconds[start:stop]
        if t is None and fs is None and step is not None:
            t = data.start + step * np.arange(stop - start, dtype=np.float64)
        title = label if group is None else f"{label} [trial {trial}]"
        about = {"units": kept_units, "name": title, "begins": begins}
        trials.append({"channels": parts, "time": time_from(parts, t, fs, where), **about})
    return trials


def find_time(data: Columns, units: Mapping[int, str | None], time: str | None, fs: float | None) -> int | None:
    """Index of the time column: `time`, else as marked or by name, else the first rising one in a unit of time."""
    if fs is not None:
        return None
    if time is not None:
        return data.headers.find(time)
    if data.time is not None:
        return data.time
    if data.headers.time is not None or data.step is not None or len(data.values) < 2:
        return data.headers.time
    rising = (i for i, x in enumerate(data.values) if units.get(i) in SECONDS and (_rises(x) or _ends_in_a_summary(x)))
    return next(rising, None)


def _ends_in_a_summary(time: Floats) -> bool:
    """Whether the last row alone goes back in time."""
    return len(time) > LEAST_ABOVE and bool(time[-1] < time[-2]) and bool((np.diff(time[:-1]) >= 0.0).all())


def _rises(values: Floats) -> bool:
    with np.errstate(invalid="ignore"):
        return len(values) > 1 and bool(np.all(np.isfinite(values))) and bool(np.all(np.diff(values) > 0))


def _stated_step(data: Columns, fs: float | None) -> tuple[float | None, int | None]:
    """The time step [s] from the file's header or a constant column such as Ts, and the index of that column."""
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


def _time(
    data: Columns, column: int | None, units: Mapping[int, str | None]
) -> tuple[Floats | None, dict[str, str], float | None]:
    """Time, in seconds if its unit can be converted, its unit as ``{"t": unit}``, empty if unknown, and `begins`."""
    if column is None:
        return None, {}, data.begins
    name = data.names[column]
    seconds, unit, begins = in_seconds(data.values[column], units[column] or time_unit(name), name)
    units_of_time = {"t": unit} if unit and (name == "t" or "t" not in data.names) else {}
    return seconds, units_of_time, begins if data.begins is None else data.begins


def _place(data: Columns, column: int) -> str:
    return f"{data.headers.where}, column {data.headers.texts[column] or data.names[column]!r}"
