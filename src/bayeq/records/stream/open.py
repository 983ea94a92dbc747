"""``open_streams``: files and folders as streams."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bayeq.errors import FileFormatError, InputError
from bayeq.records.formats import hdf5, npy, parquet, text
from bayeq.records.formats.table import FORMATS, format_of
from bayeq.records.request import STAR, Request
from bayeq.records.stream.hdf5 import Hdf5Rows
from bayeq.records.stream.npy import NpyRows
from bayeq.records.stream.parquet import ParquetRows
from bayeq.records.stream.rows import FileStream, Rows
from bayeq.records.stream.text import TextRows
from bayeq.records.unchanged import state_of

__all__ = ["LARGE", "in_order", "open_streams", "streamed_unasked"]

#: Files of more bytes together are streamed unasked.
LARGE = 256 * 2**20

#: What reads some rows of a file, by the module that reads whole ones.
STREAMED: dict[object, Callable[[Path, Request], Rows]] = {
    parquet: lambda path, request: ParquetRows(path),
    npy: lambda path, request: NpyRows(path),
    hdf5: Hdf5Rows,
    text: lambda path, request: TextRows(path),
}


def files_of(paths: Sequence[str | os.PathLike[str]]) -> list[Path]:
    """Files, and those of each folder in the order of the numbers in their names.

    Raises
    ------
    FileFormatError
        A folder without files that can be streamed.
    """
    known = tuple(suffix for row in FORMATS if {row.flat, row.nested} & STREAMED.keys() for suffix in row.suffixes)
    out: list[Path] = []
    for one in map(Path, paths):
        if not one.is_dir():
            out.append(one)
            continue
        found = [path for path in one.iterdir() if path.is_file() and path.suffix.lower() in known]
        if not found:
            raise FileFormatError(f"{one}: the folder has no file that can be streamed ({', '.join(known)})")
        out.extend(sorted(found, key=in_order))
    return out


def in_order(path: Path) -> list[tuple[int, int | str]]:
    """Numbers in a name as numbers: part-2 before part-10."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"(\d+)", path.name) if part]


def streamed_unasked(paths: Sequence[str | os.PathLike[str]]) -> bool:
    """Whether paths are streamed without being asked to: folders, and files of more than 256 MB together."""
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
    """Files, and those of folders, as records that are read some rows at a time.

    Parameters
    ----------
    paths : sequence of path
        Parquet, HDF5, NPY and delimited text; of a folder all of its files.
    time, fs, units, channels
        As for `bayeq.read`.

    Raises
    ------
    FileFormatError
        A file that is missing, or of a format of which rows cannot be read by themselves.
    """
    if any(STAR in path for path in (channels or {}).values()):
        raise InputError(f"a path with {STAR} is several records; name one of them, files are streamed one by one")
    request = Request(None, dict(channels or {}), time, None, fs)
    streams = []
    for path in files_of(paths):
        try:
            state = state_of(path)
            row = format_of(path)
            opened = STREAMED.get(row.flat) or STREAMED.get(row.nested)
            if opened is None:
                raise FileFormatError(
                    f"{path}: {row.title} is not read some rows at a time; write it as Parquet, HDF5, NPY or text"
                )
            stream = FileStream(opened(path, request), request, path.name, dict(units or {}), path, state)
            if not stream.bounds[-1]:
                raise FileFormatError(f"{path}: no rows")
        except OSError as error:
            raise FileFormatError(f"{path}: cannot be read ({error.strerror or type(error).__name__})") from None
        streams.append(stream)
    return streams
