"""MATLAB's .mat files of versions 4 and 5 (also called v6 and v7), by SciPy; v7.3 is HDF5.

Every variable is a tree of elements, each with a type and a length; see "MAT-File Format" (The MathWorks). These are
checked before SciPy relies on them: a wrong type crashes the process (SciPy 1.17; `tests/fuzz/corpus/matlab`).
"""

from __future__ import annotations

import struct
import zlib
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.formats.nested import DEEPEST, Channel, channels_of
from bayeq.records.formats.protocol import MOST_BYTES, MOST_RATIO, SMALL_BYTES, check_claim, reading

_KIND = "MATLAB file"
# Types of elements, and classes of arrays.
MATRIX, COMPRESSED = 14, 15
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
TEXT = NUMBERS | {16, 17, 18}
LETTERS = frozenset({1, 2, 16})
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMERIC = range(6, 16)
COMPLEX = 0x08
# Bytes of the numbers of version 4.
_WIDTHS = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}


def channels(path: Path) -> list[Channel]:
    """List the arrays of a file: variables, fields of structs, cells, rows of matrices."""
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    where = str(path)
    with reading(where, _KIND):
        _check_version_4(path) if matfile_version(path)[0] == 0 else _check_variables(path)
        content = loadmat(path)
        tree = {name: _tree(value) for name, value in content.items() if not name.startswith("__")}
    return channels_of(tree, where)


def _check_version_4(path: Path) -> None:
    """Walk over the matrices of version 4: a head of five integers, a name, and numbers that end in the file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        while len(head := file.read(20)) == 20:
            order = "<" if 0 <= struct.unpack("<i", head[:4])[0] <= 5000 else ">"
            kind, rows, columns, imaginary, letters = struct.unpack(f"{order}5i", head)
            width = _WIDTHS.get(kind // 10 % 10)
            if not 0 <= kind <= 5000 or kind % 10 > 2 or width is None or min(rows, columns, letters) < 0:
                raise ValueError(f"a matrix of type {kind} and shape {(rows, columns)}")
            length = letters + rows * columns * width * (2 if imaginary and kind % 10 == 0 else 1)
            if length > size - file.tell():
                raise FileFormatError(f"{path}: the matrix at byte {file.tell()} is cut off; the file is damaged")
            file.seek(length, 1)


def _check_variables(path: Path) -> None:
    """Check that each variable ends within the file, has valid types, and unpacks to an allowed size."""
    where, size = str(path), path.stat().st_size
    unpacked = 0
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            place = file.tell()
            if length > size - place:
                raise FileFormatError(f"{where}: the variable at byte {place} is cut off; the file is damaged")
            if kind == COMPRESSED:
                allowed = min(MOST_BYTES, max(SMALL_BYTES, MOST_RATIO * size)) - unpacked
                content = zlib.decompressobj().decompress(file.read(length), allowed + 1)
                unpacked += len(content)
                check_claim(where, "the file", unpacked, size)
                if len(content) >= 8:
                    kind, length = struct.unpack_from(f"{order}II", content)
                    if kind != MATRIX:
                        raise ValueError(f"a compressed variable has the type {kind}")
                    _Elements(content, order, 8).check_array(8 + length)
            elif kind == MATRIX:
                _Elements(file.read(length), order).check_array(length)
            else:
                file.seek(length, 1)


class _Elements:
    """Passes over the elements of a variable one by one; raises a ValueError for an invalid one."""

    def __init__(self, content: bytes, order: str, place: int = 0) -> None:
        self.content, self.order, self.place = content, order, place

    def number(self, place: int) -> int:
        """The signed integer of 4 bytes at a place."""
        return int(struct.unpack_from(f"{self.order}i", self.content, place)[0])

    def tag(self, end: int) -> tuple[int, int, bool]:
        """Type and length of an element, and whether its content lies in the tag."""
        if self.place + 8 > min(end, len(self.content)):
            raise ValueError("an element is cut off")
        first, length = struct.unpack_from(f"{self.order}II", self.content, self.place)
        self.place += 8
        return (first & 0xFFFF, first >> 16, True) if first >> 16 else (first, length, False)

    def element(self, end: int, kinds: frozenset[int], what: str) -> tuple[int, int]:
        """Pass over an element that must have one of the types `kinds`; returns start and length of its content."""
        kind, length, in_tag = self.tag(end)
        if kind not in kinds:
            raise ValueError(f"{what} have the type {kind}")
        if in_tag:
            if length > 4:
                raise ValueError(f"{what} of {length} bytes in a tag")
            return self.place - 4, length
        start = self.place
        if start + length > min(end, len(self.content)):
            raise ValueError(f"{what} are cut off")
        self.place = min(start + -(-length // 8) * 8, end)
        return start, length

    def check_array(self, end: int, depth: int = 0) -> None:
        """Pass over an array up to `end`, nested in `depth` others; its parts must have the types of its class."""
        start, length = self.element(end, frozenset({6}), "flags")
        if length < 8:
            raise ValueError("flags are cut off")
        flags = self.number(start)
        kind, parts = flags & 0xFF, 2 if (flags >> 8) & COMPLEX else 1
        if kind != OPAQUE:  # opaque objects are no arrays: passed over by length
            start, length = self.element(end, frozenset({5, 6}), "dimensions")
            shape = [self.number(start + 4 * k) for k in range(min(length // 4, 32))]
            if not shape or min(shape) < 0:
                raise ValueError(f"an array of shape {tuple(shape)}")
            self.element(end, LETTERS, "names")
            if kind in NUMERIC or kind == SPARSE:
                for _ in range(parts + 2 * (kind == SPARSE)):
                    self.element(end, NUMBERS, "numbers")
            elif kind == CHAR:
                self.element(end, TEXT, "characters")
            elif kind in (CELL, STRUCT, OBJECT, FUNCTION):
                fields = self._fields(end, kind) if kind in (STRUCT, OBJECT) else 1
                self._check_arrays(end, fields * (1 if kind == FUNCTION else prod(shape)), depth + 1)
            else:
                raise ValueError(f"an array of class {kind}")
        self.place = max(self.place, end)

    def _check_arrays(self, end: int, count: int, depth: int) -> None:
        """Pass over the arrays in a cell, a struct, an object or a function."""
        if depth > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST} levels")
        for _ in range(count):
            kind, length, in_tag = self.tag(end)
            if kind != MATRIX or in_tag:
                raise ValueError(f"a cell or a field has the type {kind}")
            if self.place + length > end:
                raise ValueError("an array is longer than the one that it is in")
            if length:
                self.check_array(self.place + length, depth)

    def _fields(self, end: int, kind: int) -> int:
        """Number of the fields of a struct or an object."""
        if kind == OBJECT:
            self.element(end, LETTERS, "names of a class")
        start, length = self.element(end, frozenset({5}), "lengths of names")
        if length < 4 or (each := self.number(start)) <= 0:
            raise ValueError("names of fields without a length")
        return self.element(end, LETTERS, "names of fields")[1] // each


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
    """The converted cells of an array, as a list or by index; a single struct without an index."""
    if single and array.size == 1:
        return convert(array.ravel()[0])
    if max(array.shape, default=0) == array.size:
        return [convert(item) for item in array.ravel()]
    return {f"[{','.join(map(str, index))}]": convert(array[index]) for index in np.ndindex(array.shape)}
