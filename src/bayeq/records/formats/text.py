"""Delimited text: CSV, TSV, semicolons, white space; by the standard library and NumPy only.

NumPy's C reader takes clean files. Only what it refuses goes line by line: that path knows missing cells,
quotes, trailing delimiters and decimal commas, and otherwise names the line and the column at fault.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import FileFormatError, WordsError
from bayeq.records.columns import Columns, Headers, Select
from bayeq.records.formats.cells import MISSING, is_blank, is_comment, split
from bayeq.records.formats.layout import Layout, comment_header, encodings, looks_like_text, sniff
from bayeq.records.formats.stamps import Stamp, parse_stamp
from bayeq.records.record import Record
from bayeq.records.truth import FloatArray

__all__ = ["looks_like_text", "read_columns", "write", "write_text"]

_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d+)")
_ROWS_AT_ONCE = 20_000


def read_columns(
    path: Path,
    *,
    names: list[str] | str | None = None,
    chosen: Select | None = None,
    where: str = "",
    skip: int = 0,
) -> Columns:
    """Read the columns of a text file.

    Comment lines begin with ``#`` or ``%``; the one directly before the data names the columns if there is
    no other header and the number of its words fits. Empty cells, NA and nan become NaN.

    Parameters
    ----------
    path : Path
        The file.
    names : list of str, or str, optional
        Names instead of the header; a string is split at commas and white space.
    chosen : callable, optional
        Which columns to read; the others need not be numbers.
    where : str, optional
        What messages call the file.
    skip : int
        Lines at the top that are passed over.

    Returns
    -------
    Columns

    Raises
    ------
    FileFormatError
        With the line and the column of the first fault.
    """
    for encoding in encodings(path):
        try:
            return _read(path, where or str(path), encoding, names, chosen, skip)
        except UnicodeError:  # also a UTF-16 file that ends within a character
            continue
    raise FileFormatError(f"{where or path}: not a text file")


def _read(
    path: Path, where: str, encoding: str, names: list[str] | str | None, chosen: Select | None, skip: int
) -> Columns:
    layout = sniff(path, encoding, where, skip)
    readings = comment_header(layout)
    texts = layout.header or (readings[0] if readings and len(readings[0]) == layout.width else None)
    headers = Headers.parse(texts or [""] * layout.width, where)
    given = None if names is None else names.replace(",", " ").split() if isinstance(names, str) else names
    try:
        data = np.loadtxt(
            str(path), delimiter=layout.delimiter, comments=None, skiprows=layout.skip, encoding=encoding, ndmin=2
        )
    except UnicodeError:
        raise
    except ValueError:
        # The names say which columns may be passed over, unless it takes the data to know the names.
        skipped: set[int] = set()
        if chosen is not None and (given is not None or texts is not None or not readings):
            named = headers if given is None else headers.renamed([*given, *[""] * (layout.width - len(given))])
            skipped = set(range(layout.width)) - set(chosen(named))
        lines = _Lines(path, layout, headers, skipped, where)
        data = lines.read()
        if lines.trailing and not headers.texts[-1] and layout.width > 1 and len(given or ()) != layout.width:
            data = data[:, :-1]
            headers = Headers.parse(headers.texts[:-1], where)
    trials = bool(readings) and len(readings[0]) + 2 == data.shape[1]
    if texts is None and trials and given is None and _is_trial_and_time(data):
        headers = Headers.parse(["trial", "t", *readings[0]], where)
    if layout.stamps:
        kept = range(len(headers))
        headers = headers.with_units(["s" if i in layout.stamps else headers.units[i] for i in kept])
    columns = np.ascontiguousarray(data.T)
    found = Columns.build(headers.renamed(given), columns.__getitem__, chosen)
    return Columns(found.headers, found.values, found.doubts, step=layout.step)


def _is_trial_and_time(data: NDArray[np.float64]) -> bool:
    """Whether the leading two columns count trials and, within each, increase as time does."""
    trial, time = data[:, 0], data[:, 1]
    same = trial[1:] == trial[:-1]
    return bool(np.all(trial == np.round(trial)) and np.all(np.diff(time)[same] > 0))


class _Lines:
    """The thorough reader: every cell is looked at, the first fault is reported."""

    def __init__(self, path: Path, layout: Layout, headers: Headers, skipped: Collection[int], where: str = "") -> None:
        self.path, self.layout, self.headers, self.skipped = path, layout, headers, skipped
        self.where = where or str(path)
        self.trailing = True  # whether the last cell of every row is empty
        self.start = 0  # line of the first row
        self.first: dict[int, Stamp] = {}  # the first time stamp of each column that has them

    def read(self) -> FloatArray:
        layout, mark = self.layout, self.layout.delimiter
        values = array("d")
        rows = last = 0
        with self.path.open(encoding=layout.encoding) as file:
            for number, line in enumerate(file, 1):
                if number <= layout.skip or is_blank(line) or is_comment(line):
                    continue
                plain = mark is not None and '"' not in line
                cells = line.rstrip("\n").split(mark) if plain else split(line, mark)  # float() strips
                if len(cells) != layout.width:
                    cells = self._fit(cells, number)
                rows += 1
                self.start = self.start or number
                for column in layout.stamps:
                    cells[column] = self._seconds(cells[column], number, column)
                try:
                    if "_" in line:  # float() allows 1_000
                        raise ValueError
                    row = [*map(float, cells)]
                except ValueError:
                    row = [self._cell(cell.strip(), number, column) for column, cell in enumerate(cells)]
                values.extend(row)
                if cells[-1].strip():
                    self.trailing = False
                    last = rows
                elif any(map(str.strip, cells)):
                    last = rows
        data = np.frombuffer(values, dtype=np.float64).reshape(-1, layout.width)
        # Rows of empty cells at the end are what spreadsheets leave behind; within the data they are gaps.
        return data[:last] if last else data

    def _seconds(self, cell: str, number: int, column: int) -> str:
        """A time stamp as seconds since the first of its column."""
        if cell.strip().strip("\"'").lower() in MISSING or column in self.skipped:
            return ""
        stamp = parse_stamp(cell)
        if stamp is None:
            raise FileFormatError(
                f"{self.where}, line {number}, column {self.headers.texts[column] or self.headers.names[column]!r}:"
                f" {cell.strip()[:40]!r} is not a time stamp, as those above are"
            )
        first = self.first.setdefault(column, stamp)
        return repr((stamp[0] - first[0]) + (stamp[1] - first[1]))

    def _fit(self, cells: list[str], number: int) -> list[str]:
        width, found = self.layout.width, len(cells)
        if found == width + 1 and not cells[-1].strip():
            return cells[:-1]
        if found == width - 1 and not self.headers.texts[-1] and self.layout.header is not None:
            return [*cells, ""]
        hint = "; if the comma is the decimal mark, write points" if found == 2 * width else ""
        values = f"{found} value{'s' * (found != 1)}"
        raise FileFormatError(f"{self.where}, line {number}: {values} where {width} are expected{hint}")

    def _cell(self, cell: str, number: int, column: int) -> float:
        text = cell.strip("\"'").strip()
        if column in self.skipped or text.lower() in MISSING:
            return np.nan
        if self.layout.comma and "," in text and "." not in text and text.count(",") == 1:
            text = text.replace(",", ".")
        if match := _FORTRAN.fullmatch(text):
            text = f"{match[1]}e{match[2]}"
        try:
            if "_" in text:
                raise ValueError
            return float(text)
        except ValueError:
            raise self._fault(cell, number, column) from None

    def _fault(self, cell: str, number: int, column: int) -> FileFormatError:
        shown = repr(cell if len(cell) <= 40 else cell[:37] + "...")
        name = self.headers.texts[column] or self.headers.names[column]
        hint = ""
        if re.fullmatch(r"[+-]?[\d.]*,[\d.,]+(?:[eE][+-]?\d+)?", cell):
            hint = "; write the decimal mark as a point, without marks for thousands"
        elif number == self.layout.skip + 1 and self.layout.header is None:
            hint = "; if the line is a header, no name in it may be a number"
        elif self.skipped:
            hint = "; correct it, or leave out the row"
        elif self.layout.header is not None:
            hint = "; if the column is not needed, name the columns to read"
        message = f"{self.where}, line {number}, column {name!r}: {shown} is not a number{hint}"
        if self.layout.header is None or number > self.start or any(map(str.isdigit, cell)):
            return FileFormatError(message)
        names = self.headers.names
        return WordsError(message, name, [n for k, n in enumerate(names) if k not in {column, *self.skipped}])


def write_text(record: Record, path: Path) -> None:
    """Write a record as text: a header ``t,x,v``, and numbers that read back bit by bit.

    Parameters
    ----------
    record : Record
        What to write; a unit goes into the header as ``x [m]``.
    path : Path
        The file, replaced if it is there; tabs separate the cells of a ``.tsv``, commas those of others.
    """
    columns = record.to_columns()
    mark = "\t" if path.suffix.lower() == ".tsv" else ","
    headers = [f"{n} [{u}]" if u else n for n, u in zip(columns.names, columns.headers.units, strict=True)]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, delimiter=mark, lineterminator="\n").writerow(headers)
        for start in range(0, record.n, _ROWS_AT_ONCE):
            block = np.column_stack([values[start : start + _ROWS_AT_ONCE] for values in columns.values])
            # repr is the shortest text that reads back as the same number.
            file.writelines(mark.join(map(repr, row)) + "\n" for row in block.tolist())


write = write_text
