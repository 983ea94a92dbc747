"""MATLAB's .mat files of version 5 (also called v6 and v7), by SciPy; v7.3 is HDF5."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.formats.limits import reading
from bayeq.records.formats.matlab_tags import MATRIX, FileBytes, PackedBytes, check_matrix
from bayeq.records.formats.nested import Channel, channels_of

__all__ = ["channels"]

_COMPRESSED = 15
_KIND = "MATLAB file"


def channels(path: Path) -> list[Channel]:
    """List the arrays of a file: variables, fields of structs, cells, rows of matrices.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    list of Channel

    Raises
    ------
    FileFormatError
        A damaged file, one that unpacks to far more than its size, or one of version 4.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    where = str(path)
    with reading(where, _KIND):
        major = matfile_version(path)[0]
        if major != 1:
            raise FileFormatError(f"{where}: MATLAB's version 4 is not read; save it again in MATLAB with -v7")
        _check_claims(path)
        content = loadmat(path)
        tree = {name: _tree(value) for name, value in content.items() if not name.startswith("__")}
    return channels_of(tree, where)


def _check_claims(path: Path) -> None:
    """Walk over the elements of the file: each ends in it, has the types it should, and unpacks to what is allowed."""
    where, size = str(path), path.stat().st_size
    unpacked = 0
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:128] == b"IM" else ">"
        place = 128
        while place + 8 <= size:
            file.seek(place)
            kind, length = struct.unpack(f"{order}II", file.read(8))
            place += 8
            if length > size - place:
                raise FileFormatError(f"{where}: the variable at byte {place} is cut off; the file is damaged")
            if kind == _COMPRESSED:
                unpacked += _check_packed(PackedBytes(file.read(length), where, size, unpacked), order)
            elif kind == MATRIX:
                check_matrix(FileBytes(file), order, length)
            place += length


def _check_packed(data: PackedBytes, order: str) -> int:
    """Check a compressed variable; its size unpacked."""
    tag = data.read(8)
    if len(tag) == 8:
        kind, length = struct.unpack(f"{order}II", tag)
        if kind != MATRIX:
            raise ValueError(f"a compressed variable has the type {kind}")
        check_matrix(data, order, data.place + length)
    return data.rest()


def _tree(value: Any) -> Any:
    """Structs as mappings, cells as lists or mappings of their indices, text as text, numbers as they are."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if not isinstance(value, np.ndarray) or isinstance(value, (MatlabFunction, MatlabOpaque)):
        return None  # sparse matrices, functions, classes: no channels
    if value.dtype.names:
        return _boxes(value, lambda item: {name: _tree(item[name]) for name in value.dtype.names or ()}, single=True)
    if value.dtype.hasobject:
        return _boxes(value, _tree)
    if value.dtype.kind == "U":
        return str(value.ravel()[0]) if value.size == 1 else None
    return value


def _boxes(array: np.ndarray[Any, Any], convert: Any, single: bool = False) -> Any:
    """The cells of an array by their index; the one struct of an array of one by itself."""
    if single and array.size == 1:
        return convert(array.ravel()[0])
    if max(array.shape, default=0) == array.size:
        return [convert(item) for item in array.ravel()]
    return {f"[{','.join(map(str, index))}]": convert(array[index]) for index in np.ndindex(array.shape)}
