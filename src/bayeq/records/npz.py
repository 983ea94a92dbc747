"""NumPy archives (``.npz``): one array per channel, units as JSON under ``__units__``."""

from __future__ import annotations

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Headers, Select
from bayeq.records.record import Record

__all__ = ["read_columns", "write"]

AnyArray = np.ndarray[Any, np.dtype[Any]]
_UNITS = "__units__"
#: What NumPy and zipfile raise on damaged or hostile archives.
_FAULTS = (
    OSError, ValueError, EOFError, KeyError, TypeError, SyntaxError, OverflowError, MemoryError, RuntimeError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_columns(path: Path, *, names: list[str] | str | None = None, chosen: Select | None = None) -> Columns:
    """Read the arrays of an archive; pickled objects are refused, single numbers are passed over.

    Parameters
    ----------
    path : Path
        The file.
    names : list of str, optional
        Names instead of the archive's keys.
    chosen : callable, optional
        Which columns to read.

    Returns
    -------
    Columns
    """
    where = str(path)
    try:
        arrays, units = _load(path)
    except _FAULTS as error:
        if "allow_pickle" in str(error) and zipfile.is_zipfile(path):
            raise FileFormatError(f"{where}: holds pickled objects, which are refused; save plain arrays") from None
        raise FileFormatError(f"{where}: not a readable .npz archive ({type(error).__name__})") from None
    if not arrays:
        raise FileFormatError(f"{where}: the archive holds no arrays")
    headers = Headers.parse(arrays, where)
    headers = headers.with_units([units.get(key) or unit for key, unit in zip(arrays, headers.units, strict=True)])
    values = list(arrays.values())
    lengths = {len(v) for v in values}
    if len(lengths) > 1:
        shapes = ", ".join(f"{key} {v.shape}" for key, v in list(arrays.items())[:8])
        raise FileFormatError(f"{where}: arrays of unequal lengths: {shapes}")
    if lengths == {0}:
        raise FileFormatError(f"{where}: no rows")
    return Columns.build(headers.renamed(names), values.__getitem__, chosen)


def _load(path: Path) -> tuple[dict[str, AnyArray], dict[str, str]]:
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}
    # Opened here, for NumPy leaves a damaged file open.
    with path.open("rb") as file:
        archive = np.load(file, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise TypeError("a single array")
        for key in archive.files:
            array = archive[key]
            if not isinstance(array, np.ndarray):  # a member that is no .npy file comes as bytes
                raise TypeError(key)
            if key == _UNITS:
                found = json.loads(str(array))
                units = {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}
            elif array.ndim > 0:
                # A row or a column vector, as MATLAB's users save, is one channel.
                arrays[key] = array.ravel() if array.ndim == 2 and 1 in array.shape else array
    return arrays, units


def write(record: Record, path: Path) -> None:
    """Write a record as an archive; the same record gives the same bytes.

    Parameters
    ----------
    record : Record
        What to write.
    path : Path
        The file, replaced if it is there.
    """
    columns = record.to_columns()
    units = {n: u for n, u in zip(columns.names, columns.headers.units, strict=True) if u}
    members: dict[str, AnyArray] = dict(zip(columns.names, columns.values, strict=True))
    if units:
        members[_UNITS] = np.array(json.dumps(units))
    # numpy.savez stamps the time of day on every member, and has no room for a channel named "file".
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in members.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
