"""``read`` and ``write``: files to records and back; the table of formats.

A new format is one new file with the two functions of `Format`, and a row in `FORMATS`.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, overload

from bayeq.errors import FileFormatError
from bayeq.records import npz, parquet, text
from bayeq.records.assemble import assemble
from bayeq.records.atomic import replacing
from bayeq.records.columns import Columns, Select, select
from bayeq.records.record import Record

__all__ = ["FORMATS", "Format", "read", "write"]


class Format(Protocol):
    """What the module of a file format provides."""

    def read_columns(
        self, path: Path, *, names: list[str] | str | None = None, chosen: Select | None = None
    ) -> Columns:
        """Read the chosen columns; FileFormatError if the file is not what it should be."""

    def write(self, record: Record, path: Path) -> None:
        """Write a record so that reading gives the same arrays bit by bit."""


#: Suffix -> the module that reads and writes it.
FORMATS: Mapping[str, Format] = {
    ".csv": text,
    ".tsv": text,
    ".txt": text,
    ".dat": text,
    ".npz": npz,
    ".parquet": parquet,
    ".pq": parquet,
}

Names = Sequence[str] | str | None


@overload
def read(
    path: str | os.PathLike[str], *, time: str | None = None, fs: float | None = None, names: Names = None,
    units: Mapping[str, str] | None = None, group: None = None, columns: Names = None,
) -> Record: ...  # fmt: skip
@overload
def read(
    path: str | os.PathLike[str], *, time: str | None = None, fs: float | None = None, names: Names = None,
    units: Mapping[str, str] | None = None, group: str, columns: Names = None,
) -> list[Record]: ...  # fmt: skip
def read(
    path: str | os.PathLike[str],
    *,
    time: str | None = None,
    fs: float | None = None,
    names: Names = None,
    units: Mapping[str, str] | None = None,
    group: str | None = None,
    columns: Names = None,
) -> Record | list[Record]:
    """Read measured channels from a file.

    The suffix tells the format: delimited text, NumPy archives and Parquet; a file with another suffix is
    read as text if it looks like text. Columns are found by their cleaned name (``Time``) or by their
    header as written (``Time [s]``).

    Parameters
    ----------
    path : str or path
        The file.
    time : str, optional
        The column that holds time [s]; a header such as ``t [ms]`` is converted. Without it, and without
        `fs`, a column named t, time, time_s or timestamp (in any case) is time; if there is none, the
        record has no time.
    fs : float, optional
        Sampling rate [Hz], for a file without time; a column named time stays a channel then.
    names : list of str, or str, optional
        Names of the columns, in order, instead of the file's header; a string is split at commas and
        white space.
    units : mapping of str to str, optional
        Unit of each column, instead of those in the header.
    group : str, optional
        A column that is constant within a trial: one record for each run of equal values.
    columns : list of str, or str, optional
        Keep these channels only; other columns need not even be numbers.

    Returns
    -------
    Record or list of Record
        A list if `group` is given.

    Raises
    ------
    FileFormatError
        The file is missing, cannot be read, or does not hold what its format promises.
    RecordError
        Time does not increase strictly, or no channel is left.
    UnknownNameError
        No such column.
    MissingExtraError
        The format needs a package that is not installed.

    Warns
    -----
    DataWarning
        Columns of the same name: the second is read as ``x_2``.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "run.csv"
    >>> _ = path.write_text("Time [s],x [m]\\n0.0,1\\n0.5,2\\n")
    >>> read(path)
    Record('run.csv': 2 rows at 2 Hz; x [m])
    """
    path = Path(path)
    try:
        module = _format_of(path)
        data = module.read_columns(
            path,
            names=names if names is None or isinstance(names, str) else list(names),
            chosen=select(columns, time, fs, group),
        )
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise FileFormatError(f"{path}: cannot be read ({reason})") from None
    trials = assemble(data, time=time, fs=fs, units=units, group=group, columns=columns, name=path.name)
    records = [Record(*trial) for trial in trials]
    return records[0] if group is None else records


def write(record: Record, path: str | os.PathLike[str]) -> None:
    """Write a record; the suffix tells the format.

    Parameters
    ----------
    record : Record
        What to write. Time becomes the first column, ``t``.
    path : str or path
        The file, replaced if it is there.

    Raises
    ------
    FileFormatError
        An unknown suffix, or a place that cannot be written.
    """
    path = Path(path)
    module = FORMATS.get(path.suffix.lower())
    if module is None:
        raise FileFormatError(f"{path}: no format for the suffix {path.suffix!r}; known: {', '.join(FORMATS)}")
    try:
        with replacing(path) as part:
            module.write(record, part)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written ({error.strerror or type(error).__name__})") from None


def _format_of(path: Path) -> Format:
    """The format of a file that exists, or an error that says what is wrong with the path."""
    if path.is_dir():
        raise FileFormatError(f"{path}: is a directory; name a file in it")
    if not path.exists():
        raise FileFormatError(f"no such file: {path}{near_files(path)}")
    known = FORMATS.get(path.suffix.lower())
    if known is not None:
        return known
    if text.looks_like_text(path):
        return text
    raise FileFormatError(
        f"{path}: no format for the suffix {path.suffix!r}, and not text; known: {', '.join(FORMATS)}"
    )


def near_files(path: Path) -> str:
    """The end of a message: names in the same directory that the missing one may have meant, if any."""
    try:
        if not path.parent.is_dir():
            return f" (there is no directory {path.parent})"
        folded = {entry.name.casefold(): entry.name for entry in path.parent.iterdir()}
    except OSError:
        return ""
    near = difflib.get_close_matches(path.name.casefold(), list(folded), n=3, cutoff=0.6)
    return f"; did you mean {' or '.join(repr(folded[m]) for m in near)}?" if near else ""
