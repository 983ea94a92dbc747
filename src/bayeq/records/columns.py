"""``Columns``: what a file holds before it is a record; every reader returns one.

`Headers` are the names of the columns in the three spellings by which they may be asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import FileFormatError, RecordError, UnknownNameError, WordsError
from bayeq.records.names import clean_name, clean_names, is_time_name
from bayeq.records.truth import FloatArray
from bayeq.records.validate import as_column, as_time

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Columns", "Headers", "Select", "listed"]


def listed(names: Sequence[str] | str) -> list[str]:
    """Names as a list; a single string is split at its commas.

    Examples
    --------
    >>> listed("x, acc [g]")
    ['x', 'acc [g]']
    """
    return [part.strip() for part in names.split(",")] if isinstance(names, str) else list(names)


@dataclass(frozen=True, slots=True)
class Headers:
    """Names of columns: as written, as cleaned, and their units.

    Examples
    --------
    >>> headers = Headers.parse(["Time [s]", "x (mm)"], "run.csv")
    >>> headers.find("Time [s]"), headers.find("Time"), headers.time
    (0, 0, 0)
    """

    texts: list[str]
    names: list[str]
    units: list[str | None]
    where: str = ""

    @classmethod
    def parse(cls, texts: Iterable[str], where: str = "") -> Headers:
        """Clean the headers' texts."""
        texts = [str(text).strip() for text in texts]
        return cls(texts, *clean_names(texts), where)

    def __len__(self) -> int:
        return len(self.names)

    def find(self, key: str) -> int:
        """The column that `key` names: a cleaned name, the original header, or that without its unit."""
        for keys, asked in ((self.names, key), (self.texts, key.strip()), (self.names, clean_name(key)[0])):
            if asked in keys:
                return keys.index(asked)
        as_path = key.strip().strip("/").replace("/", ".")  # as HDF5 writes paths
        if as_path in self.texts:
            return self.texts.index(as_path)
        raise UnknownNameError("column", key, self.names, self.where)

    def clashes(self, rows: Sequence[int]) -> list[str]:
        """What to say of `rows` whose header, cleaned, is that of other columns too."""
        alike: dict[str, list[int]] = {}
        for i, text in enumerate(self.texts):
            alike.setdefault(clean_name(text, i + 1)[0], []).append(i)
        return [
            f"{self.where}: columns {' and '.join(f'{i + 1} ({self.texts[i]!r})' for i in columns)} have the same name:"
            f" they are read as {' and '.join(self.names[i] for i in columns)}; rename them, or check which one is"
            " meant"
            for columns in alike.values()
            if len(columns) > 1 and not set(columns).isdisjoint(rows)
        ]

    @property
    def time(self) -> int | None:
        """The first column whose name says that it is time; a capital T (temperature?) only in front."""
        found = [i for i, name in enumerate(self.names) if is_time_name(name) and (name != "T" or i == 0)]
        return next((i for i in found if self.names[i] != "T"), found[0] if found else None)

    def renamed(self, names: Sequence[str] | str | None) -> Headers:
        """The same columns under the names that the caller gives, in order."""
        if names is None:
            return self
        if isinstance(names, str):
            names = names.replace(",", " ").split()
        if len(names) != len(self):
            raise FileFormatError(f"{self.where}: names gives {len(names)} names for {len(self)} columns")
        new = Headers.parse(names, self.where)
        return new.with_units([unit or old for unit, old in zip(new.units, self.units, strict=True)])

    def with_units(self, units: list[str | None]) -> Headers:
        """The same columns with these units."""
        return Headers(self.texts, self.names, units, self.where)


#: Which columns to read, given their names.
Select = Callable[[Headers], Sequence[int]]


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of a file, in order.

    Parameters
    ----------
    headers : Headers
        Names and units.
    values : list of ndarray, shape (n,)
        Samples; missing cells are NaN.
    doubts : tuple of str
        What to warn of.
    time : int, optional
        The column that is time, where something other than its name says so.
    step : float, optional
        Time step [s] that the file states.
    start : float
        Time of the first row [s], where `step` is given.
    """

    headers: Headers
    values: list[FloatArray]
    doubts: tuple[str, ...] = ()
    time: int | None = None
    step: float | None = None
    start: float = 0.0

    @property
    def names(self) -> list[str]:
        """The cleaned names."""
        return self.headers.names

    @classmethod
    def build(cls, headers: Headers, values: Callable[[int], Any], chosen: Select | None = None) -> Columns:
        """Take the chosen columns; `values(i)` gives the samples of column i, of any numeric type."""
        rows = list(chosen(headers)) if chosen else list(range(len(headers)))
        arrays = []
        units = list(headers.units)
        for i in rows:
            raw = np.asanyarray(values(i))
            what = f"column {headers.texts[i] or headers.names[i]!r}"
            try:
                if raw.dtype.kind in "mM":
                    arrays.append(as_time(raw))
                    units[i] = "s"
                else:
                    arrays.append(as_column(raw, what))
            except RecordError as error:
                message = f"{headers.where}: {error}"
                if raw.dtype.kind in "biufc":
                    raise FileFormatError(message) from None
                others = [headers.names[j] for j in rows if j != i]
                hint = "; name the columns to read if this one is not needed"
                raise WordsError(message + hint, headers.names[i], others) from None
        parts = [[column[i] for i in rows] for column in (headers.texts, headers.names)]
        kept = Headers(parts[0], parts[1], [units[i] for i in rows], headers.where)
        return cls(kept, arrays, tuple(headers.clashes(rows)))

    @classmethod
    def of(
        cls, channels: Mapping[str, FloatArray], time: FloatArray | None, units: Mapping[str, str], where: str
    ) -> Columns:
        """The columns by which a record is written: time first, then the channels."""
        names, values = list(channels), list(channels.values())
        kept = [units.get(name) for name in names]
        if time is not None:
            spellings = ("t", "time", "Time", "timestamp")
            name = next((name for name in spellings if name not in channels), None)
            if name is None:
                raise RecordError(f"{where or 'record'}: no name is left for time; rename the channel 't'")
            names, values = [name, *names], [time, *values]
            kept = [units.get("t") if name == "t" else None, *kept]
        return cls(Headers(names, names, kept, where), values)

    @classmethod
    def from_dataframe(cls, df: pd.DataFrame, time: str | None = None, chosen: Select | None = None) -> Columns:
        """The columns of a data frame; an index named like time comes first."""
        index = [] if df.index.name is None else [str(df.index.name)]
        if index and not (is_time_name(clean_name(index[0])[0]) or time == index[0]):
            index = []
        headers = Headers.parse([*index, *map(str, df.columns)], "data frame")

        def values(i: int) -> Any:
            series: Any = df.index if i < len(index) else df.iloc[:, i - len(index)]
            if getattr(series.dtype, "kind", "O") in "biuf":  # nullable columns hold NA, which is not a float
                return series.to_numpy(dtype=float, na_value=np.nan)
            if getattr(series.dtype, "tz", None) is not None:
                series = series.tz_convert(None) if i < len(index) else series.dt.tz_convert(None)
            return series.to_numpy()

        return cls.build(headers, values, chosen)
