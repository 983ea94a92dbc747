"""HDF5 files and MATLAB's v7.3, which is HDF5, by h5py (the extra ``files``); links to other files are refused."""

from __future__ import annotations

import math
import mmap
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, needing
from bayeq.records.columns import RATE_NAMES, STEP_NAMES, Columns, Request
from bayeq.records.formats.nested import DEEPEST, MOST_ARRAYS, Channel, about_of, channels_of, read_pieces
from bayeq.records.formats.protocol import FileRows, check_array, grid, reading
from bayeq.records.record import Record

_MARK = "bayeq"  # an attribute of files that bayeq wrote: arrays of one number are channels there
_KIND = "HDF5 file"
_NUMBERS = frozenset({"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))})
# First bytes of a heap of strings, with its version, and the head of its objects; HDF5 ignores three bytes in between.
_HEAP, _OBJECT = b"GCOL\x01", struct.Struct("<HHIQ")
# Larger files are not searched for heaps.
LARGEST = 2**30


def _h5py() -> Any:
    with needing("h5py", "files", "reading HDF5 and MATLAB v7.3 files"):
        import h5py
    return h5py


@dataclass(frozen=True, slots=True)
class _Dataset:
    """A dataset, or a field of one, that is read when it is indexed."""

    path: Path
    place: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    transposed: bool = False  # MATLAB stores arrays by columns
    column: str | None = None
    about: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: Any) -> Any:
        where = str(self.path)
        check_array(where, self.place, _selected(self.shape, key), self.dtype.itemsize, self.path.stat().st_size)
        if self.transposed and isinstance(key, tuple):
            key = key[::-1]
        with reading(where, _KIND), _h5py().File(self.path, "r") as file:
            found = file[self.place]
            values = found[self.column][key] if self.column else found[key]
        return values.T if self.transposed else values


def _selected(shape: tuple[int, ...], key: Any) -> tuple[int, ...]:
    keys = key if isinstance(key, tuple) else (key,)
    lengths = [len(range(*k.indices(n))) if isinstance(k, slice) else n for k, n in zip(keys, shape, strict=False)]
    return (*lengths, *shape[len(lengths) :])


def channels(path: Path) -> list[Channel]:
    """List the arrays of a file: datasets, rows of matrices, MATLAB's structs and cells; nothing of other files."""
    h5py = _h5py()
    with reading(str(path), _KIND):
        _require_sound_heaps(path)
        with h5py.File(path, "r") as file:
            tree = _Tree(h5py, file, path).group(file["/"], 0)
    return channels_of(tree, str(path))


class _Tree:
    """Groups as mappings, cells as lists, datasets as arrays."""

    def __init__(self, h5py: Any, file: Any, path: Path) -> None:
        self.h5py, self.file, self.path = h5py, file, path
        self.visited = 0
        self.own = _MARK in file.attrs

    def group(self, group: Any, depth: int) -> dict[str, Any]:
        found = _entries(group)
        for name in group:
            if not name.startswith("#"):  # groups in which MATLAB keeps referenced arrays
                link = group.get(name, getlink=True)
                place = f"{group.name.rstrip('/')}/{name}"
                if isinstance(link, self.h5py.ExternalLink):
                    self._refuse(place, "a link to another file")
                if isinstance(link, self.h5py.HardLink):
                    found[name.replace(".", "_")] = self.node(group[name], place, depth + 1)
        return found

    def node(self, node: Any, place: str, depth: int) -> Any:
        self.visited += 1
        if depth > DEEPEST or self.visited > 2 * MOST_ARRAYS:
            raise FileFormatError(f"{self.path}: {place[:60]!r} is nested too deeply, or refers to itself")
        if isinstance(node, self.h5py.Group):
            if "MATLAB_sparse" in node.attrs:
                return None
            fields = self.group(node, depth)
            return _by_index(fields) if self.is_struct_array(node) else fields
        if isinstance(node, self.h5py.Dataset):
            return self.dataset(node, place, depth)
        return None

    def is_struct_array(self, group: Any) -> bool:
        """Whether a group is MATLAB's array of structs: every field refers to its value in each of them."""
        fields = [group[name] for name in group if isinstance(group.get(name, getlink=True), self.h5py.HardLink)]
        return bool(fields) and all(
            isinstance(field, self.h5py.Dataset)
            and self.h5py.check_ref_dtype(field.dtype) is self.h5py.Reference
            and _attribute(field, "MATLAB_class") is None
            for field in fields
        )

    def dataset(self, node: Any, place: str, depth: int) -> Any:
        if node.is_virtual or node.external:
            self._refuse(place, "put together from other files")
        if node.shape is None or "MATLAB_empty" in node.attrs:
            return None
        kind = _text(_attribute(node, "MATLAB_class"))
        if self.h5py.check_ref_dtype(node.dtype) is self.h5py.Reference:
            return self.cells(node, place, depth)
        if self.h5py.check_string_dtype(node.dtype) is not None:
            return _text(node[()]) if node.size == 1 else None
        if kind == "char":
            return "".join(map(chr, np.ravel(node[...]).tolist())) if node.size < 200 else None
        if kind and kind not in _NUMBERS:
            return None  # MATLAB's strings, tables, functions
        about = about_of(_entries(node))
        if self.own and node.ndim == 1:
            about["single"] = True
        shape = tuple(node.shape)
        if node.dtype.names:
            return {
                name: _Dataset(self.path, node.name, shape, node.dtype[name], column=name, about=about)
                for name in node.dtype.names
            }
        return _Dataset(
            self.path, node.name, shape[::-1] if kind else shape, node.dtype, transposed=bool(kind), about=about
        )

    def cells(self, node: Any, place: str, depth: int) -> Any:
        """The arrays that a dataset of references (MATLAB's cells) points to, by index; all in the same file."""
        self.visited += math.prod(node.shape)
        if self.visited > 2 * MOST_ARRAYS:
            raise FileFormatError(f"{self.path}: {place[:60]!r} has too many cells")
        cells = np.asarray(node[...]).T  # MATLAB stores arrays by columns
        if cells.size == 0:
            return None
        flat = max(cells.shape, default=1) == cells.size
        found = {}
        for index in np.ndindex(cells.shape):
            k = max(index, default=0) if flat else ",".join(map(str, index))
            target = self.file[cells[index]] if cells[index] else None
            found[f"[{k}]"] = None if target is None else self.node(target, f"{place}[{k}]", depth + 1)
        return found

    def _refuse(self, place: str, what: str) -> None:
        raise FileFormatError(
            f"{self.path}: {place!r} is {what}, which is not followed; copy the samples into the file"
        )


def _by_index(fields: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Convert the fields of an array of structs to one struct for each index."""
    indices = {index: None for cells in fields.values() if isinstance(cells, Mapping) for index in cells}
    return {
        index: {name: cells.get(index) for name, cells in fields.items() if isinstance(cells, Mapping)}
        for index in indices
    }


def _entries(node: Any) -> dict[str, Any]:
    """Attributes that state the unit and the time step, as the entries of a struct do."""
    out: dict[str, Any] = {}
    for name in node.attrs:
        if name.casefold() in ("unit", "units"):
            value = _attribute(node, name)
            if (unit := _text(value)) or isinstance(value, str):  # an empty unit overrides one in the name
                out[name] = unit
        elif name in (*STEP_NAMES, *RATE_NAMES):
            out[name] = np.asarray(_attribute(node, name))
    return out


def _attribute(node: Any, name: str) -> Any:
    """The value of an attribute that is a single text or number; None for any other, or if it is missing.

    Damaged attributes of other types, sequences of varying length among them, crash the HDF5 library itself.
    """
    if name not in node.attrs:
        return None
    h5t, attribute = _h5py().h5t, node.attrs.get_id(name)
    plain = attribute.get_type().get_class() in (h5t.STRING, h5t.INTEGER, h5t.FLOAT)
    return node.attrs[name] if plain and attribute.get_space().get_simple_extent_npoints() == 1 else None


def _text(value: Any) -> str:
    """Text of an attribute or of a dataset of one string; empty if it holds something else."""
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else ""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""


def _require_sound_heaps(path: Path) -> None:
    """Raise a FileFormatError if a heap of strings does not end, as an interrupted run may leave it.

    HDF5 2.0 loops forever at a free object of size 0, and Ctrl-C does not stop its compiled loop. The layout is that of
    section III.E, "Disk Format: Level 1E - Global Heap", of the HDF5 file format specification.
    """
    if not 0 < path.stat().st_size <= LARGEST:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        start = content.find(_HEAP)
        while start >= 0:
            if not _ends(content, start):
                raise FileFormatError(f"{path}: damaged: the strings at byte {start} have no end; write the file again")
            start = content.find(_HEAP, start + len(_HEAP))


def _ends(content: mmap.mmap, start: int) -> bool:
    """Whether stepping from object to object of a heap reaches its end."""
    if start + 16 > len(content):
        return True  # HDF5 itself reports that it is cut off
    stop = min(start + struct.unpack_from("<Q", content, start + 8)[0], len(content))
    at = start + 16
    while at + _OBJECT.size <= stop:
        index, _, _, size = _OBJECT.unpack_from(content, at)
        needed = _OBJECT.size + -(-size // 8) * 8 if index else size
        if needed % 2**64 == 0:
            return False
        at += needed
    return True


def write(record: Record, path: Path) -> None:
    """Write a record as HDF5: one dataset for each channel, its unit as the attribute ``unit``."""
    columns, units = record.to_columns()
    with _h5py().File(path, "w", track_order=True) as file:
        file.attrs[_MARK] = 1
        for name, values in columns.items():
            dataset = file.create_dataset(name, data=values)
            if name in units:
                dataset.attrs["unit"] = units[name]


class Hdf5Rows(FileRows):
    """Rows of an HDF5 file, of the arrays that `bayeq.read` takes for the same request."""

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        lengths = [replace(one, values=np.array([one.size]).__getitem__) for one in channels(self.path)]
        pieces = read_pieces(lengths, str(self.path), self.request)
        if len(pieces) > 1:
            raise FileFormatError(f"{self.path}: [*] stands for several records; name one of them to stream it")
        return grid(int(pieces[0][1].values[0][0]))

    def read(self, start: int, stop: int, request: Request) -> Columns:
        ((_, data),) = read_pieces(channels(self.path), str(self.path), request, rows=slice(start, stop))
        return data
