"""The tags of a MATLAB file of version 5, checked before SciPy relies on them: a wrong type ends the process there.

Every variable is a tree of elements, each with a type and a length; see "MAT-File Format" (The MathWorks).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from math import prod
from typing import IO, Protocol

from bayeq.records.formats.limits import check_claim

__all__ = ["FileBytes", "PackedBytes", "check_matrix"]

MATRIX = 14
NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})
TEXT = NUMBERS | {16, 17, 18}
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMERIC = range(6, 16)
COMPLEX = 0x08

# Cells and structs within each other.
DEEPEST = 64
AT_ONCE = 2**20


class Bytes(Protocol):
    """Bytes in order."""

    place: int

    def read(self, count: int) -> bytes: ...

    def skip(self, count: int) -> None: ...


class FileBytes:
    """Those of a file from where it stands."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file, self.place = file, 0

    def read(self, count: int) -> bytes:
        self.place += count
        return self.file.read(count)

    def skip(self, count: int) -> None:
        self.place += count
        self.file.seek(count, 1)


class PackedBytes:
    """Those of a compressed variable, unpacked as far as the limits allow."""

    def __init__(self, packed: bytes, where: str, size: int, before: int) -> None:
        self.stream, self.packed, self.place = zlib.decompressobj(), packed, 0
        self.claim: Callable[[int], None] = lambda total: check_claim(where, "the file", before + total, size)

    def read(self, count: int) -> bytes:
        out = b""
        while len(out) < count and not self.stream.eof and self.packed:
            out += self.stream.decompress(self.packed, count - len(out))
            self.packed = self.stream.unconsumed_tail
        self.place += len(out)
        self.claim(self.place)
        return out

    def skip(self, count: int) -> None:
        while count > 0 and (got := len(self.read(min(count, AT_ONCE)))):
            count -= got

    def rest(self) -> int:
        """Unpack what is left; how many bytes there were in all."""
        while self.read(AT_ONCE):
            pass
        return self.place


def _tag(data: Bytes, order: str, end: int) -> tuple[int, int, bytes | None]:
    """Type and length of an element, and its content where that lies in the tag."""
    raw = data.read(8)
    if len(raw) < 8 or data.place > end:
        raise ValueError("an element is cut off")
    first, length = struct.unpack(f"{order}II", raw)
    if first >> 16:
        return first & 0xFFFF, first >> 16, raw[4:]
    return first, length, None


def _element(data: Bytes, order: str, end: int, kinds: frozenset[int], what: str, wanted: int = 0) -> bytes:
    """Pass over an element of one of some types; its first `wanted` bytes."""
    kind, length, content = _tag(data, order, end)
    if kind not in kinds:
        raise ValueError(f"{what} have the type {kind}")
    if content is not None:
        if length > 4:
            raise ValueError(f"{what} of {length} bytes in a tag")
        return content[: min(length, wanted)]
    if data.place + length > end:
        raise ValueError(f"{what} are cut off")
    read = data.read(min(length, wanted))
    data.skip(min(-(-length // 8) * 8, end - data.place + len(read)) - len(read))
    return read


def _matrices(data: Bytes, order: str, end: int, count: int, depth: int) -> None:
    if depth > DEEPEST:
        raise ValueError(f"nested deeper than {DEEPEST} levels")
    for _ in range(count):
        kind, length, content = _tag(data, order, end)
        if kind != MATRIX or content is not None:
            raise ValueError(f"a cell or a field has the type {kind}")
        if length:
            check_matrix(data, order, data.place + length, depth, end)


def check_matrix(data: Bytes, order: str, end: int, depth: int = 0, outer: int | None = None) -> None:
    """Raise a ValueError unless an array, and all in it, has elements of the types that its class has.

    Parameters
    ----------
    data : Bytes
        Behind the array's tag.
    order : str
        Of bytes, ``"<"`` or ``">"``.
    end : int
        The place where the array ends.
    depth : int
        Arrays that it is in.
    outer : int, optional
        The place where the array ends that it is in.
    """
    if outer is not None and end > outer:
        raise ValueError("an array is longer than the one that it is in")
    flags = _element(data, order, end, frozenset({6}), "flags", 8)
    if len(flags) < 8:
        raise ValueError("flags are cut off")
    (word,) = struct.unpack(f"{order}I", flags[:4])
    kind, parts = word & 0xFF, 2 if (word >> 8) & COMPLEX else 1
    if kind == OPAQUE:  # passed over by its length: no array
        data.skip(end - data.place)
        return
    sizes = _element(data, order, end, frozenset({5, 6}), "dimensions", 4 * 32)
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes[: len(sizes) // 4 * 4])
    if not shape or min(shape) < 0:
        raise ValueError(f"an array of shape {shape}")
    _element(data, order, end, frozenset({1, 2, 16}), "names")
    if kind in NUMERIC:
        for _ in range(parts):
            _element(data, order, end, NUMBERS, "numbers")
    elif kind == CHAR:
        _element(data, order, end, TEXT, "characters")
    elif kind == SPARSE:
        for _ in range(2 + parts):
            _element(data, order, end, NUMBERS, "numbers")
    elif kind in (CELL, STRUCT, OBJECT):
        _matrices(data, order, end, _fields(data, order, end, kind) * prod(shape), depth + 1)
    elif kind == FUNCTION:
        _matrices(data, order, end, 1, depth + 1)
    else:
        raise ValueError(f"an array of class {kind}")
    if data.place < end:
        data.skip(end - data.place)


def _fields(data: Bytes, order: str, end: int, kind: int) -> int:
    """Arrays that each entry of a cell, a struct or an object consists of."""
    if kind == CELL:
        return 1
    if kind == OBJECT:
        _element(data, order, end, frozenset({1, 2, 16}), "names of a class")
    width = _element(data, order, end, frozenset({5}), "lengths of names", 4)
    if len(width) < 4 or (each := struct.unpack(f"{order}i", width)[0]) <= 0:
        raise ValueError("names of fields without a length")
    before = data.place
    kind, length, content = _tag(data, order, end)
    if kind not in (1, 2, 16):
        raise ValueError(f"names of fields have the type {kind}")
    if content is None:
        if data.place + length > end:
            raise ValueError("names of fields are cut off")
        data.skip(-(-length // 8) * 8)
    assert data.place > before
    return int(length // each)
