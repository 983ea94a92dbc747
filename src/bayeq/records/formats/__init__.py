"""The table of file formats: their titles, how files are recognised, and the modules that read and write them.

A new format is one new file in this folder and a row in `FORMATS`, or an entry point ``bayeq.formats`` of another
package. A format is recognised by the content of a file, or else by its suffix.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bayeq.errors import FileFormatError
from bayeq.plugins import Table
from bayeq.records.formats import excel, gz, hdf5, lvm, matlab, npy, npz, parquet, tdms, text, uff, wav
from bayeq.records.formats.layout import encodings
from bayeq.records.formats.protocol import FileRows, Flat, Nested, Writer

__all__ = ["FORMATS", "Format", "format_of", "suffixes", "writers"]

HEAD = 4096


@dataclass(frozen=True, slots=True)
class Format:
    """A file format."""

    title: str
    suffixes: tuple[str, ...]  # in lower case
    holds: Callable[[Path, bytes], bool]  # by path and first bytes; False for delimited text
    flat: Flat | None = None  # the module that reads it as one table
    nested: Nested | None = None  # the module that lists its arrays
    writer: Writer | None = None
    rows: type[FileRows] | None = None  # the reader of chunks of rows
    extra: str = ""  # the extra of bayeq that it needs
    keeps: str = ""  # units and rate that its files can hold, for the documentation


def _begins(*marks: bytes) -> Callable[[Path, bytes], bool]:
    return lambda path, head: head.startswith(marks)


def _is_hdf5(path: Path, head: bytes) -> bool:
    """Whether HDF5's signature is at the beginning, or after a user block, as in MATLAB's files."""
    with path.open("rb") as file:
        for place in (0, 512, 1024, 2048, 4096, 8192):
            file.seek(place)
            if file.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
    return False


def _is_zip_of(member: str, *marks: bytes) -> Callable[[Path, bytes], bool]:
    """A test for ZIP archives that have a `member` of this ending, and for other files that begin with a mark."""

    def holds(path: Path, head: bytes) -> bool:
        if not head.startswith(b"PK\x03\x04"):
            return head.startswith(marks)
        try:
            with zipfile.ZipFile(path) as archive:
                return any(name.endswith(member) for name in archive.namelist())
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
            return False  # damaged: the suffix decides

    return holds


#: The formats, in the order in which a file's content is compared with them.
FORMATS: tuple[Format, ...] = (
    Format(
        "delimited text", (".csv", ".tsv", ".txt", ".dat", ".asc"), lambda *_: False, flat=text, writer=text,
        rows=text.TextRows, keeps="units in the header, in brackets or in a row below; rate from the preamble",
    ),
    Format("NumPy archive", (".npz",), _is_zip_of(".npy"), flat=npz, writer=npz, keeps="units, if bayeq wrote it"),
    Format(
        "Parquet", (".parquet", ".pq"), _begins(b"PAR1"), flat=parquet, writer=parquet,
        rows=parquet.ParquetRows, extra="parquet", keeps="units, if bayeq wrote it",
    ),
    Format(
        "HDF5 and MATLAB v7.3", (".h5", ".hdf5", ".hdf"), _is_hdf5, nested=hdf5, writer=hdf5,
        rows=hdf5.Hdf5Rows, extra="files",
        keeps="attributes `unit`, `units`; attributes or numbers `dt`, `Ts`, `fs` ...",
    ),
    Format(
        "MATLAB v4 and v5", (".mat",), _begins(b"MATLAB 5.0 MAT-file"), nested=matlab,
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
        "Excel", (".xlsx", ".xlsm", ".xls"), _is_zip_of("xl/workbook.xml", excel.OLE), flat=excel, extra="files",
        keeps="units in the header, in brackets or in a row below",
    ),
    Format("WAV", (".wav",), wav.is_wav, flat=wav, keeps="rate; whole numbers as shares of full scale"),
    Format("NumPy array", (".npy",), _begins(b"\x93NUMPY"), flat=npy, rows=npy.NpyRows, keeps="nothing"),
    Format("compressed text", (".gz",), _begins(b"\x1f\x8b"), flat=gz, writer=gz, keeps="as the text in it"),
)  # fmt: skip

# Formats of other packages, for files that no format above recognises.
ADDED = Table("formats", Format, {})

TEXT = FORMATS[0]
# Text formats that the suffix distinguishes from delimited text.
_OF_TEXT = (uff, lvm)


def suffixes() -> Mapping[str, Format]:
    """The format of each suffix."""
    return {suffix: row for row in (*ADDED.load().values(), *FORMATS) for suffix in row.suffixes}


def writers() -> Mapping[str, Writer]:
    """The module that writes each suffix that can be written."""
    return {suffix: row.writer for suffix, row in suffixes().items() if row.writer is not None}


def format_of(path: Path) -> Format:
    """The format of a file by its first bytes, else text if it looks so, else by its suffix; else a FileFormatError."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    for row in FORMATS:
        if row.holds(path, head):
            return row
    known = {suffix: row for row in FORMATS for suffix in row.suffixes}.get(path.suffix.lower())
    is_text = bool(encodings(path))
    if known is not None and is_text and (known.nested in _OF_TEXT or known is TEXT):
        return known
    for row in ADDED.load().values():
        if row.holds(path, head):
            return row
    known = known or suffixes().get(path.suffix.lower())
    if is_text:  # also what instruments call .xls, and MATLAB's save -ascii
        return TEXT
    if known is not None:
        return known
    raise FileFormatError(
        f"{path}: no format for the suffix {path.suffix!r}, and not text; known: {', '.join(suffixes())}"
    )
