"""Parquet files, by pyarrow (the extra ``parquet``); units as JSON in the schema's metadata."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError, needing
from bayeq.records.columns import Columns, Headers, Names, Request, Select
from bayeq.records.formats.protocol import UNIT_ROWS, FileRows, check_array, parts_between, reading, stored_units
from bayeq.records.record import Record

_UNITS = b"bayeq.units"


def library() -> tuple[Any, Any]:
    """pyarrow and its reader of Parquet files; MissingExtraError if it is not installed."""
    with needing("pyarrow", "parquet", "reading and writing Parquet files"):
        import pyarrow
        import pyarrow.parquet
    return pyarrow, pyarrow.parquet


def read_columns(path: Path, *, names: Names = None, chosen: Select | None = None, group: str | None = None) -> Columns:
    """Read the columns of a Parquet file; nulls become NaN, dates seconds since the first."""
    pa, pq = library()
    where = str(path)
    with reading(where, "Parquet file"), pq.ParquetFile(path) as file:
        shape = (file.metadata.num_rows, file.metadata.num_columns)
        check_array(where, "the table", shape, 8, path.stat().st_size)
        headers = headers_of(file.schema_arrow, where)
        table = file.read()
    if table.num_columns == 0 or table.num_rows == 0:
        raise FileFormatError(f"{where}: no {'rows' if table.num_columns else 'columns'}")
    return Columns.build(headers.renamed(names), lambda i: values_of(pa, table.column(i)), chosen, group)


def headers_of(schema: Any, where: str) -> Headers:
    """Names and units of the columns of a schema."""
    return Headers.parse(schema.names, where, stored_units((schema.metadata or {}).get(_UNITS, b"{}")))


def values_of(pa: Any, column: Any) -> Any:
    """The samples of a column; if they are no numbers, the name of their type, for the error message."""
    kind = column.type
    if pa.types.is_decimal(kind) or (column.null_count and not pa.types.is_temporal(kind)):
        if not (pa.types.is_decimal(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            return np.array([str(kind)])
        column = column.cast(pa.float64(), safe=False)
    return column.to_numpy()


def write(record: Record, path: Path) -> None:
    pa, pq = library()
    columns, units = record.to_columns()
    table = pa.table(columns)
    if units:
        table = table.replace_schema_metadata({_UNITS: json.dumps(units).encode()})
    pq.write_table(table, path)


class ParquetRows(FileRows):
    """Rows of a Parquet file: chunks are its row groups, small ones merged; only its metadata are kept."""

    @cached_property
    def groups(self) -> tuple[int, ...]:
        """First rows of the row groups, and the number of rows."""
        _, pq = library()
        with reading(str(self.path), "Parquet file"), pq.ParquetFile(self.path) as file:
            about = file.metadata
            return (0, *accumulate(about.row_group(k).num_rows for k in range(about.num_row_groups)))

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        """Bounds of chunks of whole row groups, of `UNIT_ROWS` rows or more but for the last."""
        out = [0]
        for bound in self.groups[1:]:
            if bound - out[-1] >= UNIT_ROWS:
                out.append(bound)
        if out[-1] != self.groups[-1]:
            out.append(self.groups[-1])
        return tuple(out)

    def read(self, start: int, stop: int, request: Request) -> Columns:
        pa, pq = library()
        where = str(self.path)
        wanted = parts_between(self.groups, start, stop)
        with reading(where, "Parquet file"), pq.ParquetFile(self.path) as file:
            headers = headers_of(file.schema_arrow, where)
            columns = request.rows(headers)
            names = [file.schema_arrow.names[i] for i in columns]
            table = file.read_row_groups(wanted, columns=names, use_threads=False)
            place = {i: k for k, i in enumerate(columns)}
            data = Columns.build(headers, lambda i: values_of(pa, table.column(place[i])), lambda _: columns)
            first = self.groups[wanted[0]]
            if stop - start < table.num_rows:  # copies, so that the other rows are freed
                data = replace(data, values=[values[start - first : stop - first].copy() for values in data.values])
            return data
