"""``FORMATS``: the formats, and how the format of a file is found: by its content, else by its suffix."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Select
from bayeq.records.formats import excel, gz, hdf5, lvm, matlab, npy, npz, parquet, tdms, text, uff, wav
from bayeq.records.formats.nested import Channel
from bayeq.records.record import Record

__all__ = ["FORMATS", "Flat", "Format", "Nested", "Writer", "format_of", "suffixes", "writers"]

HEAD = 4096


class Flat(Protocol):
    """The module of a format whose files are one table."""

    def read_columns(
        self, path: Path, *, names: list[str] | str | None = None, chosen: Select | None = None
    ) -> Columns:
        """Read the chosen columns; FileFormatError if the file is not what it should be."""


class Nested(Protocol):
    """The module of a format whose files hold many arrays, named by their paths."""

    def channels(self, path: Path) -> list[Channel]:
        """List the arrays of a file; FileFormatError if the file is not what it should be."""


class Writer(Protocol):
    """The module of a format that can be written."""

    def write(self, record: Record, path: Path) -> None:
        """Write a record so that reading gives the same arrays bit by bit."""


@dataclass(frozen=True, slots=True)
class Format:
    """A file format.

    Parameters
    ----------
    title : str
        What it is called.
    suffixes : tuple of str
        Of its files, in lower case.
    holds : callable
        Whether a file is of this format, by its path and its first bytes; text, which anything may be, is never.
    flat : Flat, optional
        The module that reads it as one table.
    nested : Nested, optional
        The module that lists its arrays.
    writer : Writer, optional
        The module that writes it.
    extra : str
        The extra of bayeq that it needs.
    keeps : str
        What of units and rate its files hold, for the documentation.
    """

    title: str
    suffixes: tuple[str, ...]
    holds: Callable[[Path, bytes], bool]
    flat: Flat | None = None
    nested: Nested | None = None
    writer: Writer | None = None
    extra: str = ""
    keeps: str = ""


def _begins(*marks: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: head.startswith(marks)


def _is_hdf5(path: Path, head: bytes) -> bool:
    """Whether HDF5's mark is at the beginning or after a block of the user's, as in MATLAB's files."""
    with path.open("rb") as file:
        for place in (0, 512, 1024, 2048, 4096, 8192):
            file.seek(place)
            if file.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
    return False


def _is_zip_of(member: str) -> Callable[[Path, bytes], bool]:
    def holds(path: Path, head: bytes) -> bool:
        if not head.startswith(b"PK\x03\x04"):
            return False
        try:
            with zipfile.ZipFile(path) as archive:
                return any(name.endswith(member) for name in archive.namelist())
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
            return False  # damaged: the suffix tells whose it was

    return holds


def _is_wav(path: Path, head: bytes) -> bool:
    return head[:4] == b"RIFF" and head[8:12] == b"WAVE"


def _never(path: Path, head: bytes) -> bool:
    return False


#: The formats, in the order in which a file's content is compared with them.
FORMATS: tuple[Format, ...] = (
    Format(
        "delimited text", (".csv", ".tsv", ".txt", ".dat", ".asc"), _never, flat=text, writer=text,
        keeps="units in the header, in brackets or in a row below; rate from the preamble",
    ),
    Format("NumPy archive", (".npz",), _is_zip_of(".npy"), flat=npz, writer=npz, keeps="units, if bayeq wrote it"),
    Format(
        "Parquet", (".parquet", ".pq"), _begins(b"PAR1"), flat=parquet, writer=parquet, extra="parquet",
        keeps="units, if bayeq wrote it",
    ),
    Format(
        "HDF5 and MATLAB v7.3", (".h5", ".hdf5", ".hdf"), _is_hdf5, nested=hdf5, writer=hdf5, extra="files",
        keeps="attributes `unit`, `units`; attributes or numbers `dt`, `Ts`, `fs` ...",
    ),
    Format(
        "MATLAB v5", (".mat",), _begins(b"MATLAB 5.0 MAT-file"), nested=matlab,
        keeps="fields `unit`, `units`; numbers `dt`, `Ts`, `fs` ... beside the arrays",
    ),
    Format(
        "universal file, dataset 58", (".uff", ".unv", ".uf", ".bunv"), uff.is_uff, nested=uff, extra="files",
        keeps="units and rate",
    ),
    Format("TDMS", (".tdms",), _begins(b"TDSm"), nested=tdms, extra="files", keeps="`unit_string`, `wf_increment`"),
    Format(
        "LabVIEW measurement", (".lvm",), _begins(b"LabVIEW Measurement"), nested=lvm,
        keeps="`Y_Unit_Label`, `Delta_X` and `X0`",
    ),
    Format(
        "Excel", (".xlsx", ".xlsm", ".xls"), excel.is_excel, flat=excel, extra="files",
        keeps="units in the header, in brackets or in a row below",
    ),
    Format("WAV", (".wav",), _is_wav, flat=wav, keeps="rate; whole numbers as shares of full scale"),
    Format("NumPy array", (".npy",), _begins(b"\x93NUMPY"), flat=npy, keeps="nothing"),
    Format("compressed text", (".gz",), _begins(b"\x1f\x8b"), flat=gz, writer=gz, keeps="as the text in it"),
)  # fmt: skip

TEXT = FORMATS[0]
# Formats of text that their suffix tells apart from tables.
_OF_TEXT = (uff, lvm)


def suffixes() -> Mapping[str, Format]:
    """The format of each suffix."""
    return {suffix: row for row in FORMATS for suffix in row.suffixes}


def writers() -> Mapping[str, Writer]:
    """The module that writes each suffix that can be written."""
    return {suffix: row.writer for suffix, row in suffixes().items() if row.writer is not None}


def format_of(path: Path) -> Format:
    """The format of a file: by its first bytes, else text if it looks like text, else by its suffix.

    Raises
    ------
    FileFormatError
        None of these tells.
    """
    with path.open("rb") as file:
        head = file.read(HEAD)
    for row in FORMATS:
        if row.holds(path, head):
            return row
    known = suffixes().get(path.suffix.lower())
    if known is not None and (known.nested in _OF_TEXT or known is TEXT):
        return known
    if text.looks_like_text(path):  # also what instruments call .xls, and MATLAB's save -ascii
        return TEXT
    if known is not None:
        return known
    raise FileFormatError(
        f"{path}: no format for the suffix {path.suffix!r}, and not text; known: {', '.join(suffixes())}"
    )
