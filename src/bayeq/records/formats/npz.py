"""NumPy archives (``.npz``): one array per channel, units as JSON under ``__units__``."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Headers, Names, Select
from bayeq.records.formats.npy import AnyArray, read_array
from bayeq.records.formats.protocol import check_claim, reading, stored_units
from bayeq.records.record import Record

_UNITS = "__units__"


def read_columns(path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
    """Read the arrays of an archive; pickled objects are refused, single numbers are passed over."""
    where, arrays, units = str(path), dict[str, AnyArray](), dict[str, str]()
    with reading(where, ".npz archive"), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        check_claim(where, "the archive", sum(member.file_size for member in members), path.stat().st_size)
        for member in members:
            key = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                array = read_array(file, member.file_size, where, f"array {key!r}")
            if key == _UNITS:
                units = stored_units(str(array))
            elif array.ndim > 0:
                # A row or a column vector, as MATLAB's users save, is one channel.
                arrays[key] = array.ravel() if array.ndim == 2 and 1 in array.shape else array
    if not arrays:
        raise FileFormatError(f"{where}: the archive holds no arrays")
    headers = Headers.parse(arrays, where, units)
    values = list(arrays.values())
    lengths = {len(v) for v in values}
    if len(lengths) > 1:
        shapes = ", ".join(f"{key} {v.shape}" for key, v in list(arrays.items())[:8])
        raise FileFormatError(f"{where}: arrays of unequal lengths: {shapes}")
    if lengths == {0}:
        raise FileFormatError(f"{where}: no rows")
    return Columns.build(headers.renamed(names), values.__getitem__, chosen)


def write(record: Record, path: Path) -> None:
    """Write a record as an archive; the same record gives the same bytes."""
    columns, units = record.to_columns()
    members: dict[str, AnyArray] = {**columns}
    if units:
        members[_UNITS] = np.array(json.dumps(units))
    # numpy.savez stamps the time of day on every member, and has no room for a channel named "file".
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in members.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
