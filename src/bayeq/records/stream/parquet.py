"""Rows of a Parquet file: the units are its row groups, small ones together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns
from bayeq.records.formats.limits import reading
from bayeq.records.formats.parquet import headers_of, library, values_of
from bayeq.records.request import Request
from bayeq.records.stream.rows import UNIT_ROWS

__all__ = ["ParquetRows"]


@dataclass(frozen=True)
class ParquetRows:
    """A Parquet file; its metadata alone are kept."""

    path: Path

    @cached_property
    def groups(self) -> tuple[int, ...]:
        """First rows of the row groups, and the number of rows."""
        _, pq = library()
        with reading(str(self.path), "Parquet file"), pq.ParquetFile(self.path) as file:
            about = file.metadata
            out = [0]
            for k in range(about.num_row_groups):
                out.append(out[-1] + about.row_group(k).num_rows)
        return tuple(out)

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        """Units of whole row groups, of `UNIT_ROWS` rows or more."""
        out = [0]
        for bound in self.groups[1:]:
            if bound - out[-1] >= UNIT_ROWS:
                out.append(bound)
        if out[-1] != self.groups[-1]:
            out.append(self.groups[-1])
        return tuple(out)

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop`."""
        pa, pq = library()
        where = str(self.path)
        wanted = [
            k
            for k, (first, last) in enumerate(zip(self.groups[:-1], self.groups[1:], strict=True))
            if first < stop and last > start
        ]
        with reading(where, "Parquet file"), pq.ParquetFile(self.path) as file:
            if file.metadata.num_rows != self.groups[-1]:
                raise FileFormatError(f"{where}: has changed while it was read; start once more")
            headers = headers_of(file.schema_arrow, where)
            columns = sorted({*request.rows(headers)})
            names = [file.schema_arrow.names[i] for i in columns]
            table = file.read_row_groups(wanted, columns=names, use_threads=False)
            place = {i: k for k, i in enumerate(columns)}
            data = Columns.build(headers, lambda i: values_of(pa, table.column(place[i])), lambda _: columns)
            first = self.groups[wanted[0]]
            if stop - start < table.num_rows:  # copies, so that the rest is let go
                data = replace(data, values=[values[start - first : stop - first].copy() for values in data.values])
            return data
