"""Rows of a delimited text file: one pass finds where units of rows begin, then they are parsed by pyarrow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bayeq.errors import FileFormatError, MissingExtraError
from bayeq.records.columns import Columns, Headers
from bayeq.records.formats.cells import MISSING
from bayeq.records.formats.layout import Layout, comment_header, encodings, sniff
from bayeq.records.formats.limits import reading
from bayeq.records.request import Request
from bayeq.records.stream.rows import UNIT_ROWS

__all__ = ["TextRows"]

# Bytes that are looked through at a time for the ends of lines.
CHUNK = 2**24

NEWLINE, RETURN = 10, 13

# Text that stands for a missing sample, in the cases that pyarrow would not know.
ABSENT = sorted({text for word in MISSING for text in (word, word.upper(), word.capitalize())} | {"NaN"})


class _Index(NamedTuple):
    """Where units begin.

    Attributes
    ----------
    bounds : tuple of int
        First rows, and the number of rows.
    places : tuple of int
        The byte at which each begins, and that at the end.
    """

    bounds: tuple[int, ...]
    places: tuple[int, ...]


@dataclass(frozen=True)
class TextRows:
    """A text file of plain numbers; times as dates are not read so."""

    path: Path

    @cached_property
    def layout(self) -> Layout:
        """How the file is laid out."""
        for encoding in encodings(self.path):
            if encoding == "utf-16":
                break
            try:
                layout = sniff(self.path, encoding)
            except UnicodeError:
                continue
            if layout.stamps:
                raise FileFormatError(
                    f"{self.path}: has dates or times of day, which are not read from long text files; write the time"
                    " in seconds, or a Parquet file"
                )
            return layout
        raise FileFormatError(f"{self.path}: not a text file of single-byte characters; write UTF-8, or a Parquet file")

    @cached_property
    def headers(self) -> Headers:
        """Names of the columns."""
        readings = comment_header(self.layout)
        texts = self.layout.header or (readings[0] if readings and len(readings[0]) == self.layout.width else None)
        return Headers.parse(texts or [""] * self.layout.width, str(self.path))

    @cached_property
    def index(self) -> _Index:
        """Where units of rows begin; lines that are empty count for nothing."""
        bounds, places, row = [0], [], 0
        with self.path.open("rb") as file:
            for _ in range(self.layout.skip):
                file.readline()
            place = file.tell()
            places.append(place)
            begun = False  # whether the line has a character
            while chunk := file.read(CHUNK):
                bytes_ = np.frombuffer(chunk, dtype=np.uint8)
                ends = np.flatnonzero(bytes_ == NEWLINE)
                ink = _with_ink(bytes_, ends, begun)
                rows = row + np.cumsum(ink[: len(ends)])
                while len(ends) and rows[-1] >= bounds[-1] + UNIT_ROWS:
                    bound = bounds[-1] + UNIT_ROWS
                    bounds.append(bound)
                    places.append(place + int(ends[np.searchsorted(rows, bound)]) + 1)
                row = int(rows[-1]) if len(ends) else row
                begun = bool(ink[-1])
                place += len(chunk)
            row += begun
        if bounds[-1] != row or len(bounds) == 1:
            bounds.append(row)
            places.append(place)
        else:
            places[-1] = place
        return _Index(tuple(bounds), tuple(places))

    @property
    def bounds(self) -> tuple[int, ...]:
        """Units of equal length."""
        return self.index.bounds

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop`."""
        bounds, places = self.index
        first = int(np.searchsorted(bounds, start, side="right")) - 1
        last = int(np.searchsorted(bounds, stop, side="left"))
        with self.path.open("rb") as file:
            file.seek(places[first])
            text = file.read(places[last] - places[first])
        columns = request.rows(self.headers)
        values = self._parsed(text, columns, bounds[first], bounds[last])
        taken = slice(start - bounds[first], stop - bounds[first])
        found = Columns.build(self.headers, lambda i: values[i][taken], lambda _: columns)
        return Columns(found.headers, found.values, found.doubts, step=self.layout.step)

    def _parsed(
        self, text: bytes, columns: list[int], start: int, stop: int
    ) -> dict[int, np.ndarray[tuple[int], np.dtype[np.float64]]]:
        where = f"{self.path}, rows {start + 1:,} to {stop:,}"
        with reading(where, "table of numbers"):
            if self.layout.delimiter is None:
                data = np.loadtxt(text.decode().splitlines(), ndmin=2, usecols=columns)
                values = dict(zip(columns, data.T, strict=True))
            else:
                values = self._by_arrow(text, columns)
        if len(next(iter(values.values()))) != stop - start:
            raise FileFormatError(f"{where}: the file has changed while it was read, or a cell has a line end in it")
        return values

    def _by_arrow(self, text: bytes, columns: list[int]) -> dict[int, np.ndarray[tuple[int], np.dtype[np.float64]]]:
        try:
            import pyarrow as pa
            import pyarrow.csv as pc
        except ImportError:
            raise MissingExtraError("pyarrow", "parquet", "reading text files of this size") from None
        names = [f"c{i}" for i in range(self.layout.width)]
        table = pc.read_csv(
            pa.BufferReader(text),
            read_options=pc.ReadOptions(column_names=names, use_threads=False, block_size=max(len(text), 1)),
            parse_options=pc.ParseOptions(delimiter=self.layout.delimiter),
            convert_options=pc.ConvertOptions(
                column_types={names[i]: pa.float64() for i in columns},
                include_columns=[names[i] for i in columns],
                null_values=ABSENT,
                decimal_point="," if self.layout.comma else ".",
            ),
        )
        return {i: table.column(names[i]).to_numpy() for i in columns}


def _with_ink(
    chunk: np.ndarray[tuple[int], np.dtype[np.uint8]], ends: np.ndarray[tuple[int], np.dtype[np.intp]], begun: bool
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether each line of a chunk, and what follows the last, has a character that is no blank."""
    starts = np.concatenate([[0], ends + 1])
    stops = np.concatenate([ends, [len(chunk)]])
    long = stops - starts
    out = long > 1  # of one character it may be the return before the line's end
    for k in np.flatnonzero(long == 1):
        out[k] = chunk[starts[k]] != RETURN
    out[0] |= begun
    return np.asarray(out)
