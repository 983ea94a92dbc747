"""Parquet files, by pyarrow (the extra ``parquet``); units as JSON in the schema's metadata."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, MissingExtraError
from bayeq.records.columns import Columns, Headers, Select
from bayeq.records.formats.limits import check_array, reading
from bayeq.records.record import Record

__all__ = ["headers_of", "library", "read_columns", "values_of", "write"]

_UNITS = b"bayeq.units"


def library() -> tuple[Any, Any]:
    """pyarrow and its reader of Parquet files.

    Raises
    ------
    MissingExtraError
        It is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MissingExtraError("pyarrow", "parquet", "reading and writing Parquet files") from None
    return pyarrow, pyarrow.parquet


def read_columns(path: Path, *, names: list[str] | str | None = None, chosen: Select | None = None) -> Columns:
    """Read the columns of a Parquet file; nulls become NaN, dates seconds since the first.

    Parameters
    ----------
    path : Path
        The file.
    names : list of str, optional
        Names instead of the file's own.
    chosen : callable, optional
        Which columns to read.

    Returns
    -------
    Columns
    """
    pa, pq = library()
    where = str(path)
    with reading(where, "Parquet file"), pq.ParquetFile(path) as file:
        shape = (file.metadata.num_rows, file.metadata.num_columns)
        check_array(where, "the table", shape, 8, path.stat().st_size)
        headers = headers_of(file.schema_arrow, where)
        table = file.read()
    if table.num_columns == 0 or table.num_rows == 0:
        raise FileFormatError(f"{where}: no {'rows' if table.num_columns else 'columns'}")
    return Columns.build(headers.renamed(names), lambda i: values_of(pa, table.column(i)), chosen)


def headers_of(schema: Any, where: str) -> Headers:
    """Names and units of the columns of a schema."""
    units = _units((schema.metadata or {}).get(_UNITS))
    headers = Headers.parse(schema.names, where)
    return headers.with_units([units.get(t) or u for t, u in zip(schema.names, headers.units, strict=True)])


def values_of(pa: Any, column: Any) -> Any:
    """The samples of a column; what is no number, by the name of its type, for the message."""
    kind = column.type
    if pa.types.is_decimal(kind) or (column.null_count and not pa.types.is_temporal(kind)):
        if not (pa.types.is_decimal(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            return np.array([str(kind)])
        column = column.cast(pa.float64(), safe=False)
    return column.to_numpy()


def _units(metadata: bytes | None) -> dict[str, str]:
    found = json.loads(metadata.decode()) if metadata else {}
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}


def write(record: Record, path: Path) -> None:
    """Write a record as a Parquet file.

    Parameters
    ----------
    record : Record
        What to write.
    path : Path
        The file, replaced if it is there.
    """
    pa, pq = library()
    columns = record.to_columns()
    units = {n: u for n, u in zip(columns.names, columns.headers.units, strict=True) if u}
    table = pa.table(dict(zip(columns.names, columns.values, strict=True)))
    if units:
        table = table.replace_schema_metadata({_UNITS: json.dumps(units).encode()})
    pq.write_table(table, path)
