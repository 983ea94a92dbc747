"""Turn files into records by the options: read (units, time), join files, take rows, remove offsets."""

from __future__ import annotations

import math
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from bayeq.cli import options as opt
from bayeq.errors import FileFormatError, InputError, UnknownNameError

if TYPE_CHECKING:
    from bayeq.discovery.streaming.work import Extent
    from bayeq.records import Record

#: The argument that means standard input, and what messages call it.
STANDARD_INPUT = Path("-")
_CALLED = "standard input"

_ROWS = re.compile(r"\s*(-?\d{1,18})?\s*:\s*(-?\d{1,18})?\s*")

_OF_FILES = (
    opt.measured("--time", help="Time column [s], or the path of an array."),
    opt.measured("--fs", type=float, help="Sampling frequency [Hz], where there is no time column."),
    opt.measured(
        "--units",
        multiple=True,
        help="Units of channels, x=mm,a=g, instead of those in the file; also that of the time column (t=ms). A number"
        " in front is a gain: a=10g where 1 stands for 10 g.",
    ),
    opt.measured("--scale", "scales", multiple=True, help="Gain of a channel, c1=10, by which it is multiplied."),
    opt.measured("--sheet", help="Sheet of an Excel file; by default that with most rows of numbers. FILE[SHEET] too."),
    opt.measured("--names", help="Column names, separated by commas, for a file without header."),
    opt.measured("--skip", type=int, default=0, help="Lines at the top of a text file that are passed over."),
    opt.measured("--group", help="Column that numbers or names the trials within a file."),
    opt.altered("--rows", help="Rows that are used, A:B as in Python, of each record: 0:2000, 500:, :-100."),
)
_OTHERS = (
    opt.measured(
        "--join", is_flag=True, help="FILE... are channels of one motion: join them on the time of the first."
    ),
    opt.measured(
        "--stream/--no-stream",
        "stream",
        default=None,
        help="Read some rows at a time, for files larger than memory: Parquet, HDF5, NPY, text. By default folders, and"
        " files of more than 256 MB together.",
    ),
    opt.altered(
        "--remove-offset",
        "offsets",
        multiple=True,
        help="Subtract a value from a channel, x=0.2, another channel, a1=base, or its mean over the rows that are"
        " used, x. Once per channel.",
    ),
)


# Options of `Reading.of`: those for reading a single file, and all.
file_options = opt.together(*_OF_FILES)
reading_options = opt.together(*_OF_FILES, *_OTHERS)


@dataclass(frozen=True, slots=True)
class Reading:
    """Values of the reading options; an offset of None is the mean, a text the name of a channel; `stream=None` decides
    by the size of the files."""

    time: str | None = None
    fs: float | None = None
    names: list[str] | None = None
    group: str | None = None
    join: bool = False
    units: Mapping[str, str] = field(default_factory=dict)
    skip: int = 0
    rows: slice | None = None
    offsets: Mapping[str, float | str | None] = field(default_factory=dict)
    stream: bool | None = None
    sheet: str | None = None

    @classmethod
    def of(cls, options: dict[str, Any]) -> Self:
        """Remove the reading options from the options of a command and parse them; InputError for a malformed one."""
        given = {one.name: options.pop(one.name) for one in fields(cls) if one.name in options}
        if given["skip"] < 0:
            raise InputError(f"--skip {given['skip']}: give a number of lines, 0 or more")
        if given["names"] is not None:
            given["names"] = [name.strip() for name in given["names"].split(",")]
        for name in ("time", "group"):
            given[name] = opt.path_of(given[name])
        given["units"] = units_of(given["units"], options.pop("scales"))
        given["rows"] = _rows(given["rows"])
        given["offsets"] = _offsets(given.get("offsets", ()))
        return cls(**given)

    @property
    def of_file(self) -> dict[str, Any]:
        """Arguments of `bayeq.records.read`."""
        return {name: getattr(self, name) for name in ("time", "fs", "names", "group", "units", "skip", "sheet")}

    def streamed(self, files: Sequence[Path]) -> bool:
        """Whether files are read some rows at a time: folders, large files, or as `stream` says."""
        if self.stream is not None:
            return self.stream
        from bayeq.records.stream import streamed_unasked

        return STANDARD_INPUT not in files and streamed_unasked(files)

    def clustered(self) -> Reading:
        """The same options for a Dask cluster, where every file is read some rows at a time."""
        if self.stream is False:
            raise InputError("--dask reads files some rows at a time: leave out --no-stream")
        return replace(self, stream=True)

    def extents(self, files: Sequence[Path], paths: Mapping[str, str]) -> list[Extent]:
        """The rows of files that are read some at a time; InputError for an option that takes whole records."""
        from bayeq.discovery.streaming.work import Extent
        from bayeq.records.stream import open_streams

        given: dict[str, object] = {
            "--group": self.group, "--join": self.join, "--names": self.names, "--skip": self.skip,
            "--remove-offset": self.offsets, "--sheet": self.sheet, "standard input": STANDARD_INPUT in files,
        }  # fmt: skip
        whole = [option for option, value in given.items() if value]
        if whole:
            raise InputError(
                f"{whole[0]}: not for files that are read some rows at a time; write what it changes to a file, or take"
                " the file whole (--no-stream)"
            )
        _require_different(files)
        out = []
        for one in open_streams(files, time=self.time, fs=self.fs, units=self.units, channels=paths):
            rows = range(one.bounds[-1])[self.rows or slice(None)]
            if not len(rows):
                raise InputError(f"{one.name}: --rows leaves none of {one.bounds[-1]} rows")
            out.append(Extent(one, rows.start, rows.stop))
        return out

    def records(
        self,
        files: Sequence[Path],
        used: Sequence[str],
        paths: Mapping[str, str],
        progress: Callable[[str, int, int], None],
    ) -> list[Record]:
        """The records of the files; ``-`` is standard input, and channels that are not used need not be numbers."""
        from bayeq.records import remove_offset, with_row_numbers
        from bayeq.records.io import rows_of

        _require_different(files)
        bases = [value for value in self.offsets.values() if isinstance(value, str)]
        wanted = list(dict.fromkeys([*used, *self.offsets, *bases]))
        parts: list[list[Record]] = []
        for k, file in enumerate(files):
            progress("reading", k, len(files))
            with _opened(file) as path:
                parts.append(self._read(path, wanted, paths))
        records = [record for part in parts for record in part]
        if self.join:
            known = sorted({name for record in records for name in record.names})
            for name in self.units:  # unit of a channel that no file has
                if opt.channel_name(name) not in known and name not in ("t", self.time):
                    raise UnknownNameError("channel", name, known, "--units")
            records = [record if self.rows is None else rows_of(record, self.rows) for record in _join(parts)]
        for name, value in self.offsets.items():
            records = [remove_offset(record, name, value) for record in records]
        return with_row_numbers(records)

    def _read(self, file: Path, used: Sequence[str], paths: Mapping[str, str]) -> list[Record]:
        from bayeq.records import read
        from bayeq.records.names import is_time_name

        options = {**self.of_file, "rows": None if self.join else self.rows}
        found: Record | list[Record]
        if self.join:
            found = _read_those_there(file, dict(paths) or {name: name for name in used}, options)
        elif paths:
            found = read(file, channels=paths, **options)
            if self.fs is not None:
                _require_rate_of_file(file, paths, options)
        else:
            try:
                found = read(file, **options)
            except FileFormatError:
                # The fault may be words in an unused column: read the used columns only.
                found = read(file, columns=[*used, *self.units] if used else None, **options)
        records = found if isinstance(found, list) else [found]
        if self.fs is not None:
            for record in records:
                for name in filter(is_time_name, record.names):
                    _require_rate(record, name)
        return records


def units_of(texts: Sequence[str], scales: Sequence[str] = ()) -> dict[str, str]:
    """Units by channel, from ``x=mm,a=g``, and gains in front of them, from ``a=10``."""
    from bayeq.records.names import gain_and_unit, require_unit

    parts = (part for text in texts for part in text.split(","))
    out = opt.by_name("--units", parts, "write a channel and its unit, such as x=mm")
    for name, text in out.items():
        _, unit = gain_and_unit(text)
        require_unit(unit or "", f"--units {name}={text}")
    for name, text in opt.by_name("--scale", scales, "write a channel and its gain, such as c1=10").items():
        gain, unit = gain_and_unit(out.get(name, ""))
        gain *= opt.number(f"--scale {name}", text)
        if not (gain and math.isfinite(gain)):
            raise InputError(f"--scale {name}={text}: a gain is a number other than 0, such as 10 or -1")
        out[name] = f"{gain!r} {unit or ''}".strip()
    return out


def _rows(text: str | None) -> slice | None:
    if text is None:
        return None
    match = _ROWS.fullmatch(text)
    if match is None:
        raise InputError(
            f"--rows {text[:60]!r}: write A:B as in Python, counted from 0: 0:2000 are the first 2000 rows, 500: all"
            " but the first 500, :-100 all but the last 100"
        )
    first, last = (None if end is None else int(end) for end in match.groups())
    return slice(first, last)


def _offsets(texts: Sequence[str]) -> dict[str, float | str | None]:
    out: dict[str, float | str | None] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not name or (equals and not value):
            raise InputError(
                f"--remove-offset {text[:60]!r}: write a channel, x, or a channel and what is subtracted, x=0.2 or"
                " a1=base"
            )
        channel, where = opt.channel_name(name), f"--remove-offset {name}"
        if channel in out:
            raise InputError(f"--remove-offset: {channel!r} is named twice")
        of_channel = value[:1].isalpha() and value.lower() not in ("nan", "inf", "infinity")
        out[channel] = None if not equals else opt.channel_name(value) if of_channel else opt.number(where, value)
    return out


def plain_files(files: Sequence[Path]) -> list[Path]:
    """The files, without the sheet that is named after a path as in ``book.xlsx[Run 1]``."""
    if not any(file.name.endswith("]") for file in files):
        return list(files)
    from bayeq.records.formats.excel import without_sheet

    return [without_sheet(file)[0] for file in files]


def _require_different(files: Sequence[Path]) -> None:
    for k, file in enumerate(files):
        if file == STANDARD_INPUT:
            again = STANDARD_INPUT in files[:k]
        else:
            again = file.exists() and any(other.exists() and file.samefile(other) for other in files[:k])
        if again:
            raise InputError(f"{file}: named twice; the same rows twice are not twice the evidence")


@contextmanager
def _opened(file: Path) -> Iterator[Path]:
    """The file itself, or for standard input a temporary copy, which can be read several times."""
    if file != STANDARD_INPUT:
        yield file
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / _CALLED
        source = getattr(sys.stdin, "buffer", None)
        if source is None:
            copy.write_text(sys.stdin.read(), encoding="utf-8")
        else:
            with copy.open("wb") as out:
                shutil.copyfileobj(source, out)
        try:
            yield copy
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None


def _read_those_there(file: Path, paths: dict[str, str], options: Mapping[str, Any]) -> Record | list[Record]:
    """Read the channels of `paths` that this file has; those of other files, and their units, are left out."""
    from bayeq.records import read

    units = dict(options["units"])
    while paths:
        try:
            return read(file, channels=paths, **{**options, "units": units})
        except UnknownNameError as error:
            lacking = [name for name, path in paths.items() if path == error.name]
            if not lacking and error.name not in units:
                raise
            units.pop(error.name, None)
            for name in lacking:
                del paths[name]
    raise InputError(f"{file}: none of the channels named is in it")


def _join(parts: Sequence[Sequence[Record]]) -> list[Record]:
    """Join the records of several files: the first records of all files, then the second ones, and so on."""
    from bayeq.records import join

    if len(parts) < 2:
        raise InputError("--join needs at least two files")
    if len({len(part) for part in parts}) > 1:
        counts = ", ".join(str(len(part)) for part in parts)
        raise InputError(f"--join: the files hold different numbers of records: {counts}")
    return [join(*together) for together in zip(*parts, strict=True)]


def _require_rate_of_file(file: Path, paths: Mapping[str, str], options: Mapping[str, Any]) -> None:
    """Refuse an --fs that contradicts the time in a file from which only the named channels are read."""
    from bayeq.records import read

    try:
        found = read(file, channels=paths, **{**options, "fs": None})
    except InputError:
        return  # the file has no usable time: only the given rate is known
    for record in found if isinstance(found, list) else [found]:
        if record.fs is not None and not 0.99 < record.fs / options["fs"] < 1.01:
            raise InputError(
                f"{record.name}: --fs {options['fs']:g} contradicts the time in the file, sampled at {record.fs:g} Hz;"
                " leave --fs out to use it"
            )


def _require_rate(record: Record, name: str) -> None:
    """Refuse an --fs that contradicts a column that looks like time (with --fs it is read as a channel)."""
    import numpy as np

    from bayeq.records.validate import other_step

    if record.n > 2 and bool((np.diff(record[name]) < 0.0).all()):
        raise InputError(f"{record.name}: time runs backwards in column {name!r}; sort the rows by it")
    # the column is a channel here, and its unit (such as ms) is that of time
    step = None if record.fs is None else other_step(record[name], record.units.get(name, "s"), record.fs)
    if step is not None:
        raise InputError(
            f"{record.name}: --fs {record.fs:g} contradicts column {name!r}, whose median step is {step:g}; leave --fs"
            f" out to use the column, or rename it if it is not time"
        )
