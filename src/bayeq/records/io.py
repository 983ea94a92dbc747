"""``read`` and ``write`` files of records, whole or not at all; ``as_records``: records from other sources too."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, overload

import numpy as np

from bayeq.errors import (
    FileFormatError,
    InputError,
    as_path,
    require_kind,
    require_mapping,
    require_text,
    require_texts,
)
from bayeq.records.columns import STAR, Columns, Headers, Names, Request, assemble
from bayeq.records.formats import excel, format_of, gz, parquet, text, writers
from bayeq.records.formats.excel import without_sheet
from bayeq.records.formats.nested import read_pieces
from bayeq.records.record import Record
from bayeq.records.validate import without_mask, without_rounding

#: Size [bytes] and modification time [ns] of a file.
FileState = tuple[int, int]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; that file replaces `path` at the end, unless an error occurs.

    Anything but a regular file (a pipe, a device) is written directly. An OSError names `path`.

    >>> import tempfile
    >>> target = Path(tempfile.mkdtemp()) / "a.txt"
    >>> with replacing(target) as part:
    ...     _ = part.write_text("all of it")
    >>> target.read_text()
    'all of it'
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve() if path.is_symlink() else path
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):  # where nothing can be written, nothing can be removed: that is reported already
            part.unlink()


def state_of(path: Path) -> FileState | None:
    """Size and modification time, which change when a file is written; None if it is missing, a pipe or a device."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return (stat.st_size, stat.st_mtime_ns) if path.is_file() else None


def require_unchanged(path: Path, before: FileState | None) -> None:
    """Raise a FileFormatError if the state of a file is no longer `before`."""
    now = state_of(path)
    if now is not None and now != before:  # a missing file raises another error
        raise FileFormatError(
            f"{path}: has changed while it was read; start once more, with a copy if it is still being written"
        )


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """Raise a FileFormatError if a file changes within the block, also in place of an error within it."""
    before = state_of(path)
    try:
        yield
    except (FileFormatError, OSError):
        require_unchanged(path, before)
        raise
    require_unchanged(path, before)


@overload
def read(
    path: str | os.PathLike[str], *, time: str | None = None, fs: float | None = None, names: Names = None,
    units: Mapping[str, str] | None = None, group: None = None, columns: Names = None, channels: None = None,
    skip: int = 0, sheet: str | None = None, rows: slice | None = None,
) -> Record: ...  # fmt: skip
@overload
def read(
    path: str | os.PathLike[str], *, time: str | None = None, fs: float | None = None, names: Names = None,
    units: Mapping[str, str] | None = None, group: str, columns: Names = None,
    channels: Mapping[str, str] | None = None, skip: int = 0, sheet: str | None = None, rows: slice | None = None,
) -> list[Record]: ...  # fmt: skip
@overload
def read(
    path: str | os.PathLike[str], *, time: str | None = None, fs: float | None = None, names: Names = None,
    units: Mapping[str, str] | None = None, group: str | None = None, columns: Names = None,
    channels: Mapping[str, str] | None = None, skip: int = 0, sheet: str | None = None, rows: slice | None = None,
) -> Record | list[Record]: ...  # fmt: skip
def read(
    path: str | os.PathLike[str],
    *,
    time: str | None = None,
    fs: float | None = None,
    names: Names = None,
    units: Mapping[str, str] | None = None,
    group: str | None = None,
    columns: Names = None,
    channels: Mapping[str, str] | None = None,
    skip: int = 0,
    sheet: str | None = None,
    rows: slice | None = None,
) -> Record | list[Record]:
    """Read measured channels from a file.

    The format is recognised by content, or else suffix: delimited text, MATLAB, HDF5, universal files, TDMS, LabVIEW,
    Excel, WAV, Parquet, NumPy; a file with another suffix is read as text if it looks like text. Columns are found
    by their cleaned name (``Time``) or by their header as written (``Time [s]``), arrays of files that hold many of
    them by their path: ``rec.acc.data``, ``Y_id[0]`` (a cell, counted from 0), ``Y_id[0].0`` (a row of a matrix).

    Parameters
    ----------
    path : str or path
        The file.
    time : str, optional
        The column that holds time [s]; a header such as ``t [ms]`` is converted, and time since 1970 counts from
        the first row. Without it, and without `fs`, a column named t or time in any usual language is time, or else
        the first rising one whose unit is a time, or else the rate that the file states; if there is none, the record
        has no time.
    fs : float, optional
        Sampling rate [Hz], for a file without time; a column named time stays a channel then.
    names : list of str, or str, optional
        Names of the columns, in order, instead of the file's header; a string is split at commas and
        white space.
    units : mapping of str to str, optional
        Unit of each column, instead of those in the header; a number in front is a gain by which samples are
        multiplied: ``{"c1": "10 g"}`` for a channel written in units of 10 g, ``"10"`` to keep its unit.
    group : str, optional
        A column that is constant within a trial, of numbers or words: one record for each run of equal values.
    columns : list of str, or str, optional
        Keep these channels only; other columns need not even be numbers.
    channels : mapping of str to str, optional
        Like `columns`, with new names: ``{"th": "Y_id[0].0"}`` calls a row of an array th. ``Y_id[*].0`` makes one
        record for each cell.
    skip : int, optional
        Lines at the top of a text file that are passed over, for a preamble that is not recognised.
    sheet : str, optional
        The sheet of an Excel file, by default the one with most rows of numbers; ``"book.xlsx[Run 1]"`` as the path
        names it too.
    rows : slice, optional
        Rows of each record to keep, by default all. In text without `group`, faulty lines below them are ignored.

    Returns
    -------
    Record or list of Record
        A list if `group` is given, or where a path has ``[*]``.

    Raises
    ------
    FileFormatError
        The file is missing, cannot be read, changes meanwhile, or does not hold what its format promises.
    RecordError
        Time does not increase strictly, or no channel is left.
    UnknownNameError
        No such column.
    MissingExtraError
        The format needs a package that is not installed.

    Warns
    -----
    DataWarning
        Columns of the same name: the second is read as ``x_2``. Rows that repeat a time: the first of each is kept.
        Several sheets with numbers.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
    >>> _ = path.write_text("Time [s],x [m]\\n0.0,1\\n0.5,2\\n")
    >>> read(path)
    Record('run.csv': 2 rows at 2 Hz; x [m])
    """
    path = as_path(path)
    for value, what in ((columns, "columns"), (names, "names")):
        if value is not None:
            require_texts(value, what)
    for value, what in ((time, "time"), (group, "group"), (sheet, "sheet")):
        require_text(value, what, optional=True)
    for mapping, what in ((units, "units"), (channels, "channels")):
        if mapping is not None:
            require_mapping(mapping, what)
    require_kind(skip, int, "skip", "a whole number")
    path, inside = without_sheet(path)
    sheet = sheet if inside is None else inside
    request = Request(columns, dict(channels or {}), time, group, fs)
    try:
        with unchanged(path):
            pieces = _pieces(path, request, names, skip, sheet, None if group is not None else rows)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise FileFormatError(f"{path}: cannot be read ({reason})") from None
    records: list[Record] = []
    starred = any(STAR in name for name in (*(request.names or ()), time or ""))
    for k, (part, data) in enumerate(pieces):
        label = f"{path.name} [{k}]" if starred else path.name if sheet is None else f"{path.name}[{sheet}]"
        records.extend(Record(**trial) for trial in assemble(part.renamed(data), part, units, label))
    if rows is not None:
        records = [rows_of(record, rows) for record in records]
    return records if starred or group is not None else records[0]


def rows_of(record: Record, rows: slice) -> Record:
    """The given rows of a record; an InputError if none are left."""
    if not len(range(record.n)[rows]):
        first, last = ("" if end is None else end for end in (rows.start, rows.stop))
        raise InputError(f"{record.name}: --rows {first}:{last} leaves none of {record.n} rows")
    return record.take(rows)


def _pieces(
    path: Path, request: Request, names: Names, skip: int, sheet: str | None, rows: slice | None
) -> list[tuple[Request, Columns]]:
    """Pairs of request and columns: one pair, or one for each array that a path with ``[*]`` matches."""
    if path.is_dir():
        raise FileFormatError(f"{path}: is a directory; name a file in it")
    if not path.exists():
        raise FileFormatError(f"no such file: {path}{near_files(path)}")
    row = format_of(path)
    if skip and row.flat not in (text, gz):
        raise InputError(f"{path}: is {row.title}: only lines of delimited text can be passed over; leave out skip")
    if sheet is not None and row.flat is not excel:
        raise InputError(f"{path}: is {row.title}: only Excel files have sheets; leave out the sheet {sheet!r}")
    if row.nested is not None:
        return read_pieces(row.nested.channels(path), str(path), request, names)
    starred = [name for name in (*(request.names or ()), request.time or "") if STAR in name]
    if starred:
        raise InputError(f"{path}: {starred[0]!r}: the file is one table, without arrays to count; leave out {STAR}")
    if row.flat is None:
        raise InputError(f"{path}: {row.title} cannot be read")
    options: dict[str, Any] = ({"skip": skip} if skip else {}) | ({"sheet": sheet} if sheet is not None else {})
    if request.group is not None and row.flat in (text, gz, excel, parquet):  # whose columns may hold words
        options["group"] = request.group
    if row.flat in (text, gz) and rows is not None and rows.stop is not None and rows.stop >= 0:
        options["enough"] = rows.stop
    return [(request, row.flat.read_columns(path, names=names, chosen=request.rows, **options))]


def write(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record in the format of the suffix.

    Parameters
    ----------
    record : Record
        The record to write. Time becomes the first column, ``t``.
    path : str or path
        The file, replaced if it is there.

    Raises
    ------
    FileFormatError
        An unknown suffix, or a place that cannot be written.
    """
    require_kind(record, Record, "the record", "a Record")
    path = as_path(path)
    known = writers()
    module = known.get(path.suffix.lower())
    if module is None:
        raise FileFormatError(
            f"{path}: no format for the suffix {path.suffix!r} is written; written are: {', '.join(known)}"
        )
    try:
        with replacing(path) as part:
            module.write(record, part)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written ({error.strerror or type(error).__name__})") from None


def near_files(path: Path) -> str:
    """The end of an error message: similar names of files in the same directory, if any."""
    try:
        if not path.parent.is_dir():
            return f" (there is no directory {path.parent})"
        folded = {entry.name.casefold(): entry.name for entry in path.parent.iterdir()}
    except OSError:
        return ""
    asked = path.name.casefold()
    near = [name for name in folded if Path(name).stem == Path(asked).stem]  # x.csv for x, or for x.mat
    near += [name for name in difflib.get_close_matches(asked, list(folded), n=3, cutoff=0.6) if name not in near]
    return f"; did you mean {' or '.join(repr(folded[m]) for m in near[:3])}?" if near else ""


# --- other sources ---------------------------------------------------------------------------------------------------


def as_records(source: Any, t: Any = None) -> list[Record]:
    """A list of records from a source of `as_record` or a sequence of such sources; `t` applies to all."""
    several = isinstance(source, Sequence) and not isinstance(source, (str, bytes)) and not _is_data(source)
    records = [as_record(one, t) for one in (source if several else [source])]
    if not records:
        raise InputError("no Record is given")
    return records


def as_record(source: Any, t: Any = None) -> Record:
    """A record from a path, a data frame, a mapping of arrays, or an object with `u`, `y` and `sampling_time`.

    Headers of data frames and mappings are read as those of files: ``"x [mm]"`` is the channel x in mm. The channels of
    an object with attributes `u` and `y` (several inputs or outputs as columns) are u and y, or u1, u2 and so on;
    `sampling_time` [s] is its time step. `t` names the time column, or holds the sampling times [s], (n,), of arrays.
    Raises an InputError for other sources, and for a `t` that does not fit the source.

    >>> as_record({"t": [0.0, 0.5, 1.0], "x [mm]": [1.0, 2.0, 4.0]})
    Record(3 rows at 2 Hz; x [mm])
    >>> as_record({"x": [1.0, 2.0, 4.0]}, t=[0.0, 0.1, 0.2])
    Record(3 rows at 10 Hz; x)
    """
    column = t if isinstance(t, str) else None
    if isinstance(source, Record):
        if t is not None:
            raise InputError("t is for arrays and files; a Record has its own time")
        even = None if source.time is None else without_rounding(source.time, source.label)
        return source if even is source.time else replace(source, time=even)
    if t is not None and column is None and (isinstance(source, (str, os.PathLike)) or _is_data_frame(source)):
        raise InputError("t names the column that is time, of a file or a data frame")
    if isinstance(source, (str, os.PathLike)):
        return read(source, time=column)
    if _is_data_frame(source):
        return Record.from_dataframe(source, time=column)
    if isinstance(source, Mapping):
        return _from_mapping(source, t)
    if _is_data(source):
        return _from_data(source, t)
    raise InputError(
        f"no record can be made of {type(source).__name__}: give a Record, the path of a file, a data frame, a mapping"
        " of arrays, or a list of these"
    )


def _is_data_frame(source: Any) -> bool:
    return hasattr(source, "iloc") and hasattr(source, "columns")


def _is_data(source: Any) -> bool:
    """Whether an object holds inputs and outputs, as the nonlinear benchmarks' ``Input_output_data`` does."""
    return all(hasattr(source, name) for name in ("u", "y", "sampling_time"))


def _from_mapping(source: Mapping[Any, Any], t: Any) -> Record:
    keys = list(source)
    if not all(isinstance(key, str) for key in keys):
        raise InputError("a mapping of arrays needs text as keys, the names of the channels")
    headers = Headers.parse(keys, "arrays")
    data = Columns.build(headers, lambda i: without_mask(source[keys[i]]))
    if t is None or isinstance(t, str):
        return Record(**assemble(data, Request(time=t), name="")[0])
    channels = dict(zip(data.names, data.values, strict=True))
    units = {name: unit or "" for name, unit in zip(data.names, data.headers.units, strict=True)}
    return Record.from_arrays(channels, time=np.asarray(t), units=units)


def _from_data(source: Any, t: Any) -> Record:
    if isinstance(t, str):
        raise InputError("with an object that has u and y, t must be an array of sampling times, not a name")
    channels: dict[str, Any] = {}
    for name in ("u", "y"):
        values = getattr(source, name)
        if values is None:
            continue
        array = np.asarray(values)
        columns = array.T if array.ndim == 2 else [array]
        for k, column in enumerate(columns, 1):
            channels[name if len(columns) == 1 else f"{name}{k}"] = column
    step = source.sampling_time
    if t is None and step is not None and not (isinstance(step, (int, float, np.number)) and 0 < step < np.inf):
        raise InputError(f"sampling_time is the time step [s], a positive number, not {step!r}")
    fs = None if t is not None or step is None else 1.0 / float(step)
    return Record.from_arrays(channels, time=t, fs=fs, name=str(getattr(source, "name", None) or ""))
