"""``Rows``: a long file of which some rows are read at a time, and ``Stream``: a record that is read so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from bayeq.errors import RecordError
from bayeq.records.assemble import assemble
from bayeq.records.columns import Columns
from bayeq.records.record import Record
from bayeq.records.request import Request
from bayeq.records.unchanged import FileState, require_unchanged

__all__ = ["UNIT_ROWS", "FileStream", "RecordStream", "Rows", "Stream", "grid", "units_between"]

#: Rows that are read at a time, where the file does not divide them itself.
UNIT_ROWS = 2**18


class Rows(Protocol):
    """The rows of a file. Objects are small and can be sent to other processes."""

    @property
    def bounds(self) -> Sequence[int]:
        """First rows of the units that are best read together, from 0, and the number of rows at the end."""
        ...

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Some rows of the columns that are asked for.

        Raises
        ------
        FileFormatError
            The file is not what it should be, or has changed.
        """
        ...


class Stream(Protocol):
    """A record that is read some rows at a time."""

    @property
    def name(self) -> str: ...

    @property
    def bounds(self) -> Sequence[int]:
        """As of `Rows`."""
        ...

    def of(self, channels: Sequence[str]) -> Stream:
        """The stream of these channels, and of time."""
        ...

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` as a record."""
        ...


def grid(rows: int, unit: int = UNIT_ROWS) -> tuple[int, ...]:
    """Bounds of units of equal length.

    Examples
    --------
    >>> grid(10, 4)
    (0, 4, 8, 10)
    """
    return (*range(0, rows, unit), rows)


def units_between(bounds: Sequence[int], start: int, stop: int) -> list[tuple[int, int]]:
    """The units of rows `start` to `stop`, the first and the last cut short.

    Examples
    --------
    >>> units_between((0, 4, 8, 10), 2, 9)
    [(2, 4), (4, 8), (8, 9)]
    """
    return list(pairwise([start, *(b for b in bounds if start < b < stop), stop])) if start < stop else []


@dataclass(frozen=True)
class RecordStream:
    """A record in memory as a stream."""

    record: Record

    @property
    def name(self) -> str:
        return self.record.name

    @property
    def bounds(self) -> Sequence[int]:
        return grid(self.record.n)

    def of(self, channels: Sequence[str]) -> RecordStream:
        """The stream of these channels, and of time; without what is known of a simulated record."""
        record = self.record
        units = {name: unit for name, unit in record.units.items() if name in {*channels, "t"}}
        return RecordStream(Record({name: record[name] for name in channels}, record.time, units, record.name))

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop`."""
        return self.record.take(slice(start, stop))


@dataclass(frozen=True)
class FileStream:
    """The record of a file.

    Attributes
    ----------
    rows : Rows
        The file.
    request : Request
        The columns that are read: all, where none is named.
    name : str
        Of the record.
    units : mapping of str to str
        Of columns, instead of those in the file.
    path, state : Path, FileState, optional
        Of the file, when it was opened: it has to stay so.
    """

    rows: Rows
    request: Request = field(default_factory=Request)
    name: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    path: Path | None = None
    state: FileState | None = None

    @property
    def bounds(self) -> Sequence[int]:
        return self.rows.bounds

    def of(self, channels: Sequence[str]) -> FileStream:
        """The stream of these channels, and of time."""
        paths = self.request.channels
        kept = {name: paths[name] for name in channels if name in paths}
        others = tuple(name for name in channels if name not in paths)
        return replace(self, request=replace(self.request, columns=others, channels=kept))

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` as a record.

        Raises
        ------
        FileFormatError, RecordError, UnknownNameError
            As `bayeq.read`; the message says between which rows.
        """
        request = self.request
        data = request.renamed(self._columns(start, stop))
        if data.step is not None:
            data = replace(data, start=data.start + start * data.step)
        known = {*data.names, *data.headers.texts}
        units = {name: unit for name, unit in self.units.items() if name in known}
        try:
            (trial,) = assemble(
                data, time=request.time, fs=request.fs, units=units, columns=request.kept(data), name=self.name
            )
        except RecordError as error:
            raise RecordError(f"{error} (of rows {start + 1:,} to {stop:,})") from None
        time = trial.time
        if request.fs is not None and time is not None and start:
            time = time + start / request.fs
        return Record(trial.channels, time, trial.units, trial.name)

    def _columns(self, start: int, stop: int) -> Columns:
        """The columns of some rows, of the file as it was opened, read-only: records then need no copy."""
        try:
            columns = self.rows.read(start, stop, self.request)
        finally:
            if self.path is not None:
                require_unchanged(self.path, self.state)
        for values in columns.values:
            values.setflags(write=False)
        return columns
