"""NumPy arrays (``.npy``): one vector, the rows or columns of a matrix, or the fields of a structured array."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Headers, Names, Request, Select
from bayeq.records.formats.protocol import MOST_COLUMNS, FileRows, check_claim, grid, reading

AnyArray = np.ndarray[Any, np.dtype[Any]]
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_columns(path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
    """Read an array; the shorter side of a matrix counts its channels, c1, c2 and so on."""
    where = str(path)
    with reading(where, ".npy file"), path.open("rb") as file:
        array = read_array(file, path.stat().st_size, where, "the array")
    texts, columns = columns_of(array, where)
    headers = Headers.parse(texts, where)
    return Columns.build(headers.renamed(names), columns.__getitem__, chosen)


def columns_of(array: AnyArray, where: str) -> tuple[list[str], list[AnyArray]]:
    """Headers and columns of an array; FileFormatError for other than one or two dimensions, and without rows."""
    if array.dtype.names:
        texts, columns = list(array.dtype.names), [np.ravel(array[name]) for name in array.dtype.names]
    else:
        if array.ndim not in (1, 2) or min(array.shape) > MOST_COLUMNS:
            raise FileFormatError(f"{where}: the array has shape {array.shape}; one or two dimensions are read")
        matrix = np.atleast_2d(array)
        columns = list(matrix.T if matrix.shape[0] > matrix.shape[1] else matrix)
        texts = [""] * len(columns)
    if not columns or not len(columns[0]):
        raise FileFormatError(f"{where}: no rows")
    return texts, columns


def read_array(file: IO[bytes], size: int, where: str, what: str) -> AnyArray:
    """Read an array in NumPy's format, of `size` bytes; pickled objects and false claims are refused."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise FileFormatError(f"{where}: {what} has version {version} of NumPy's format; 1.0 and 2.0 are read")
    shape, fortran, dtype = _HEADERS[version](file)
    if dtype.hasobject:
        raise FileFormatError(f"{where}: {what} holds pickled objects, which are refused; save plain arrays")
    count = math.prod(shape)
    if count < 0 or count * dtype.itemsize > size:
        raise FileFormatError(f"{where}: {what} claims {shape} numbers, more than the file holds; it is damaged")
    check_claim(where, what, count * max(dtype.itemsize, 8 * len(dtype.names or "1")), size)
    raw = file.read(count * dtype.itemsize)
    return np.frombuffer(raw, dtype, count).reshape(shape, order="F" if fortran else "C")


class NpyRows(FileRows):
    """Rows of an array on disk, mapped into memory."""

    def _columns(self) -> tuple[list[str], list[AnyArray]]:
        """Headers and memory-mapped columns."""
        with reading(str(self.path), ".npy file"):
            array = np.lib.format.open_memmap(self.path, mode="r")
        return columns_of(array, str(self.path))

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        return grid(len(self._columns()[1][0]))

    def read(self, start: int, stop: int, request: Request) -> Columns:
        texts, columns = self._columns()
        return Columns.build(
            Headers.parse(texts, str(self.path)), lambda i: np.array(columns[i][start:stop]), request.rows
        )
