"""Records that are read in chunks of rows, because they are larger than memory or spread over files."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from bayeq.errors import FileFormatError, InputError, RecordError
from bayeq.records.columns import STAR, Request, assemble
from bayeq.records.formats import FORMATS, format_of
from bayeq.records.formats.protocol import FileRows, grid
from bayeq.records.io import FileState, require_unchanged, state_of
from bayeq.records.record import Record, with_only

#: Files of more bytes in total are streamed by default.
LARGE = 256 * 2**20


class Stream(Protocol):
    """A record that is read in chunks of rows."""

    @property
    def name(self) -> str: ...

    @property
    def bounds(self) -> Sequence[int]:
        """Bounds of the chunks of rows, as `FileRows.bounds`."""
        ...

    def of(self, channels: Sequence[str]) -> Stream:
        """The stream with only these channels and time."""
        ...

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` as a record."""
        ...


def units_between(bounds: Sequence[int], start: int, stop: int) -> list[tuple[int, int]]:
    """Row ranges of the chunks that overlap `start` to `stop`, clipped to them.

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
        return RecordStream(with_only(self.record, channels))

    def read(self, start: int, stop: int) -> Record:
        return self.record.take(slice(start, stop))


@dataclass(frozen=True)
class FileStream:
    """The record in a file as a stream."""

    rows: FileRows
    request: Request  # the columns to read; all if it names none
    name: str  # name of the record
    units: Mapping[str, str]  # units by column, instead of those in the file
    state: FileState | None  # size and modification time when opened; a change is an error

    @property
    def bounds(self) -> Sequence[int]:
        return self.rows.bounds

    def of(self, channels: Sequence[str]) -> FileStream:
        paths = self.request.channels
        kept = {name: paths[name] for name in channels if name in paths}
        others = tuple(name for name in channels if name not in paths)
        return replace(self, request=replace(self.request, columns=others, channels=kept))

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` as a record; errors are those of `bayeq.read`, with the range of rows."""
        request = self.request
        try:
            data = self.rows.read(start, stop, request)
        finally:
            require_unchanged(self.rows.path, self.state)
        for values in data.values:
            values.setflags(write=False)  # records then need no copy
        data = request.renamed(data)
        if data.step is not None:
            data = replace(data, start=data.start + start * data.step)
        known = {*data.names, *data.headers.texts}
        units = {name: unit for name, unit in self.units.items() if name in known}
        try:
            (trial,) = assemble(data, request, units, self.name)
        except RecordError as error:
            raise RecordError(f"{error} (of rows {start + 1:,} to {stop:,})") from None
        time = trial["time"]
        if time is not None and len(time) < stop - start:
            raise RecordError(
                f"{self.name}: times are repeated in rows {start + 1:,} to {stop:,}; leave these rows out"
            )
        if request.fs is not None and time is not None and start:
            trial["time"] = time + start / request.fs
        return Record(**trial)


def files_in(paths: Sequence[str | os.PathLike[str]], known: Collection[str], what: str) -> list[Path]:
    """The files, and those in folders with a `known` suffix, in numeric order; FileFormatError if a folder has none."""
    out: list[Path] = []
    for one in map(Path, paths):
        if not one.is_dir():
            out.append(one)
            continue
        found = [path for path in one.iterdir() if path.is_file() and path.suffix.lower() in known]
        if not found:
            raise FileFormatError(f"{one}: the folder has no file {what} ({', '.join(known)})")
        out.extend(sorted(found, key=in_order))
    return out


def in_order(path: Path) -> list[tuple[int, int | str]]:
    """Sort key that compares the numbers in a file's name as numbers: part-2 before part-10."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", path.name) if part]


def streamed_unasked(paths: Sequence[str | os.PathLike[str]]) -> bool:
    """Whether paths are streamed by default: folders, and files of more than 256 MiB in total."""
    files = [Path(path) for path in paths]
    try:
        return any(path.is_dir() for path in files) or sum(p.stat().st_size for p in files if p.is_file()) > LARGE
    except OSError:  # a name that is too long, say: `bayeq.read` says what is wrong with it
        return False


def open_streams(
    paths: Sequence[str | os.PathLike[str]],
    *,
    time: str | None = None,
    fs: float | None = None,
    units: Mapping[str, str] | None = None,
    channels: Mapping[str, str] | None = None,
) -> list[FileStream]:
    """Open files, and the files in folders, as streams of chunks of rows; options are those of `bayeq.read`."""
    if any(STAR in path for path in (channels or {}).values()):
        raise InputError(f"a path with {STAR} is several records; name one of them, files are streamed one by one")
    request = Request(None, dict(channels or {}), time, None, fs)
    streams = []
    known = tuple(suffix for row in FORMATS if row.rows is not None for suffix in row.suffixes)
    for path in files_in(paths, known, "that can be streamed"):
        try:
            state = state_of(path)
            row = format_of(path)
            if row.rows is None:
                raise FileFormatError(
                    f"{path}: {row.title} is not read some rows at a time; write it as Parquet, HDF5, NPY or text"
                )
            stream = FileStream(row.rows(path, request), request, path.name, dict(units or {}), state)
            if not stream.bounds[-1]:
                raise FileFormatError(f"{path}: no rows")
        except OSError as error:
            raise FileFormatError(f"{path}: cannot be read ({error.strerror or type(error).__name__})") from None
        streams.append(stream)
    return streams
