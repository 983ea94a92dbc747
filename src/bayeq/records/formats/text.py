"""Delimited text: CSV, TSV, semicolons, white space; by the standard library and NumPy only.

NumPy's C reader reads clean files. Files that it refuses are read line by line: that path handles missing cells,
quotes, trailing delimiters and decimal commas, and otherwise names the line and the column at fault. For long files one
pass finds where chunks of rows begin, which pyarrow then parses.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice
from pathlib import Path

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import FileFormatError, WordsError, needing
from bayeq.records.columns import Columns, Headers, Names, Request, Select
from bayeq.records.formats.layout import (
    MISSING,
    Layout,
    Stamp,
    comment_header,
    decoded,
    encodings,
    fitted,
    is_blank,
    is_comment,
    parse_stamp,
    sniff,
    split,
)
from bayeq.records.formats.protocol import UNIT_ROWS, FileRows, reading
from bayeq.records.record import Record

_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d+)")
_ROWS_AT_ONCE = 20_000

# A footer (a summary, or a row that was cut off) is left out below at least this many rows, and up to this many lines.
_ROWS_ABOVE, _FOOT = 20, 16

# Texts for a missing sample, in upper and lower case, which pyarrow distinguishes.
ABSENT = sorted({text for word in MISSING for text in (word, word.upper(), word.capitalize())} | {"NaN"})


def read_columns(
    path: Path,
    *,
    names: Names = None,
    chosen: Select | None = None,
    where: str = "",
    skip: int = 0,
    enough: float = math.inf,
    group: str | None = None,
) -> Columns:
    """Read the columns of a text file, which messages call `where`, below `skip` lines; words of `group` as numbers.

    Comment lines begin with ``#`` or ``%``; the one directly before the data names the columns if there is
    no other header and the number of its words fits. Empty cells, NA and nan become NaN. If a line cannot be read, the
    rows above it are returned if there are at least `enough`, or if only a footer follows.
    """
    where = where or str(path)
    return decoded(path, where, lambda encoding: _read(path, where, encoding, names, chosen, skip, enough, group))


def _named(layout: Layout, where: str) -> tuple[Headers, Sequence[Sequence[str]]]:
    """Headers from the header line or else the comment above the data, and possible readings of that comment."""
    readings = comment_header(layout)
    texts = layout.header or (readings[0] if readings and len(readings[0]) == layout.width else None)
    return Headers.parse(texts or [""] * layout.width, where), readings


def _read(
    path: Path,
    where: str,
    encoding: str,
    names: Names,
    chosen: Select | None,
    skip: int,
    enough: float,
    group: str | None,
) -> Columns:
    layout = sniff(path, encoding, where, skip)
    headers, readings = _named(layout, where)
    unnamed = not any(headers.texts)
    given = None if names is None else names.replace(",", " ").split() if isinstance(names, str) else names
    doubts: tuple[str, ...] = ()
    begins: float | None = None
    try:
        data = np.loadtxt(
            str(path), delimiter=layout.delimiter, comments=None, skiprows=layout.skip, encoding=encoding, ndmin=2
        )
    except UnicodeError:
        raise
    except ValueError:
        # Columns that are not requested may hold anything; which these are is unknown if names depend on the data.
        skipped: set[int] = set()
        labels = None
        if chosen is not None and (given is not None or not unnamed or not readings):
            named = headers if given is None else headers.renamed([*given, *[""] * (layout.width - len(given))])
            skipped = set(range(layout.width)) - set(chosen(named))
            labels = None if group is None else named.find(group)
        lines = _Lines(path, layout, headers, skipped, labels)
        data = lines.read(enough)
        doubts, begins = lines.doubts, max((day + rest for day, rest in lines.first.values()), default=None)
        if lines.trailing and not headers.texts[-1] and layout.width > 1 and len(given or ()) != layout.width:
            data = data[:, :-1]
            headers = Headers.parse(headers.texts[:-1], where)
    trials = bool(readings) and len(readings[0]) + 2 == data.shape[1]
    if unnamed and trials and given is None and _is_trial_and_time(data):
        headers = Headers.parse(["trial", "t", *readings[0]], where)
    if layout.stamps:
        units = ["s" if i in layout.stamps else unit for i, unit in enumerate(headers.units)]
        headers = replace(headers, units=units)
    columns = np.ascontiguousarray(data.T)
    found = Columns.build(headers.renamed(given), columns.__getitem__, chosen)
    return replace(found, step=layout.step, begins=begins, doubts=(*found.doubts, *doubts))


def _is_trial_and_time(data: Floats) -> bool:
    """Whether the first column numbers the trials and the second, within each trial, increases like time."""
    trial, time = data[:, 0], data[:, 1]
    same = trial[1:] == trial[:-1]
    return bool(np.all(trial == np.round(trial)) and np.all(np.diff(time)[same] > 0))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


class _Lines:
    """The line-by-line reader: parses every cell and reports the first fault."""

    def __init__(
        self, path: Path, layout: Layout, headers: Headers, skipped: Collection[int], labels: int | None = None
    ) -> None:
        self.path, self.layout, self.headers, self.skipped = path, layout, headers, skipped
        self.labels = labels  # the column of the group, if it begins with a word
        self.numbers: dict[str, str] = {}  # of its words, in their order
        self.where = headers.where
        self.trailing = True  # whether the last cell of every row is empty
        self.start = 0  # line of the first row
        self.doubts: tuple[str, ...] = ()  # warnings to issue
        self.first: dict[int, Stamp] = {}  # the first time stamp of each column that has them
        self.day_first = {column: self._day_first(column) for column in layout.stamps if column not in skipped}

    def read(self, enough: float = math.inf) -> Floats:
        """All rows; those above the first fault if there are `enough`, or if only a footer follows."""
        layout = self.layout
        values = array("d")
        rows = last = 0
        with self.path.open(encoding=layout.encoding) as file:
            for number, line in enumerate(file, 1):
                if number <= layout.skip or is_blank(line) or is_comment(line):
                    continue
                self.start = self.start or number
                try:
                    cells, row = self._row(line, number)
                except FileFormatError:
                    if rows >= enough or (rows >= _ROWS_ABOVE and self._is_foot([line, *islice(file, _FOOT)], number)):
                        break
                    raise
                rows += 1
                values.extend(row)
                self.trailing = self.trailing and not cells[-1].strip()
                if any(map(str.strip, cells)):
                    last = rows
        data = np.frombuffer(values, dtype=np.float64).reshape(-1, layout.width)
        # Rows of empty cells at the end, which spreadsheets write, are dropped; within the data they are gaps.
        return data[:last] if last else data

    def _row(self, line: str, number: int) -> tuple[list[str], list[float]]:
        layout, mark = self.layout, self.layout.delimiter
        plain = mark is not None and '"' not in line
        cells = line.rstrip("\n").split(mark) if plain else split(line, mark)  # float() strips
        if len(cells) != layout.width:
            cells = fitted(cells, layout.width) or self._fit(cells, number)
        for column in layout.stamps:
            cells[column] = self._seconds(cells[column], number, column)
        if self.labels is not None and (label := cells[self.labels].strip().strip("\"'")).lower() not in MISSING:
            if not self.numbers and _is_number(label):
                self.labels = None
            else:
                cells[self.labels] = self.numbers.setdefault(label, str(len(self.numbers)))
        try:
            if "_" in line:  # float() allows 1_000
                raise ValueError
            return cells, [*map(float, cells)]
        except ValueError:
            return cells, [self._cell(cell.strip(), number, column) for column, cell in enumerate(cells)]

    def _is_foot(self, lines: Sequence[str], number: int) -> bool:
        """Whether the rest of a file is a summary, lines that begin with a word, or a last line that is cut short."""
        width, mark = self.layout.width, self.layout.delimiter
        rest = [split(line, mark) for line in lines if not is_blank(line)]
        is_word = [bool(re.match(r"[^\W\d_]", cells[0])) and cells[0].lower() not in MISSING for cells in rest]
        cut = not is_word[-1] and len(rest[-1]) < width
        if len(lines) > _FOOT or not all(is_word[:-1]) or not (is_word[-1] or cut):
            return False
        if is_word[0]:
            begin = "the line begins" if len(rest) == 1 else f"{len(rest)} lines begin"
            what, remedy = f"{begin} with words ({rest[0][0][:20]!r})", "take the summary out of the file"
        else:
            what, remedy = f"{len(rest[0])} of {width} values, as where a file was cut off", "check its end"
        self.doubts = (f"{self.where}, line {number}: {what}: left out; {remedy}",)
        return True

    def _day_first(self, column: int) -> bool:
        """Whether dates such as 03/04/2024 begin with the day: they then rise, over a shorter span than month first."""
        days: dict[str, None] = {}
        with self.path.open(encoding=self.layout.encoding) as file:
            for line in islice(file, self.layout.skip, None):
                cells = split(line, self.layout.delimiter)
                words = cells[column].split() if column < len(cells) else []
                if words and words[0].count("/") == 2:
                    days[words[0]] = None
                elif not days and words:  # other time stamps
                    return False

        def span(day_first: bool) -> float:
            found = [stamp[0] if (stamp := parse_stamp(day, day_first)) else math.inf for day in days]
            return found[-1] - found[0] if found and found == sorted(found) else math.inf

        return span(True) < span(False)

    def _name(self, column: int) -> str:
        return self.headers.texts[column] or self.headers.names[column]

    def _seconds(self, cell: str, number: int, column: int) -> str:
        """A time stamp as seconds since the first of its column."""
        if cell.strip().strip("\"'").lower() in MISSING or column in self.skipped:
            return ""
        stamp = parse_stamp(cell, self.day_first[column])
        if stamp is None:
            raise FileFormatError(
                f"{self.where}, line {number}, column {self._name(column)!r}: {cell.strip()[:40]!r} is not a time"
                " stamp, as those above are"
            )
        first = self.first.setdefault(column, stamp)
        return repr((stamp[0] - first[0]) + (stamp[1] - first[1]))

    def _fit(self, cells: list[str], number: int) -> list[str]:
        width, found = self.layout.width, len(cells)
        if found == width - 1 and not self.headers.texts[-1] and self.layout.header is not None:
            return [*cells, ""]
        hint = "; complete the line or take it out, or read the rows above it (--rows)"
        if found > width:
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
        name = self._name(column)
        hint = ""
        if re.fullmatch(r"[+-]?[\d.]*,[\d.,]+(?:[eE][+-]?\d+)?", cell):
            hint = "; write the decimal mark as a point, without marks for thousands"
        elif number == self.layout.skip + 1 and self.layout.header is None:
            hint = "; if the line is a header, no name in it may be a number"
        elif self.skipped or number > self.start + _ROWS_ABOVE:
            hint = "; correct it, or leave out the row"
        elif self.layout.header is not None:
            hint = "; if the column is not needed, name the columns to read"
        message = f"{self.where}, line {number}, column {name!r}: {shown} is not a number{hint}"
        is_word = cell[:1].isalpha() or not any(map(str.isdigit, cell))
        if self.layout.header is None or number > self.start or not is_word:
            return FileFormatError(message)
        names = self.headers.names
        return WordsError(message, name, [n for k, n in enumerate(names) if k not in {column, *self.skipped}])


def write(record: Record, path: Path) -> None:
    """Write a record as text: a header such as ``t,x [m],v``, and numbers that read back bit by bit."""
    columns, units = record.to_columns()
    mark = "\t" if path.suffix.lower() == ".tsv" else ","
    headers = [f"{name} [{units[name]}]" if name in units else name for name in columns]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, delimiter=mark, lineterminator="\n").writerow(headers)
        for start in range(0, record.n, _ROWS_AT_ONCE):
            block = np.column_stack([values[start : start + _ROWS_AT_ONCE] for values in columns.values()])
            # repr is the shortest text that reads back as the same number.
            file.writelines(mark.join(map(repr, row)) + "\n" for row in block.tolist())


class TextRows(FileRows):
    """Rows of a text file of plain numbers; dates and times of day are refused."""

    @cached_property
    def layout(self) -> Layout:
        if encodings(self.path) in ((), ("utf-16",)):
            raise FileFormatError(
                f"{self.path}: not a text file of single-byte characters; write UTF-8, or a Parquet file"
            )
        layout = decoded(self.path, str(self.path), partial(sniff, self.path))
        if layout.stamps:
            raise FileFormatError(
                f"{self.path}: has dates or times of day, which are not read from long text files; write the time"
                " in seconds, or a Parquet file"
            )
        return layout

    @cached_property
    def index(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Bounds of the chunks of rows, without empty lines, and the byte offset of each bound."""
        bounds, places, row = [0], [], 0
        with self.path.open("rb") as file:
            for _ in range(self.layout.skip):
                file.readline()
            place = file.tell()
            places.append(place)
            for line in file:
                place += len(line)
                row += line not in (b"\n", b"\r\n", b"\r")
                if row == bounds[-1] + UNIT_ROWS:
                    bounds.append(row)
                    places.append(place)
        if bounds[-1] != row or len(bounds) == 1:
            bounds.append(row)
            places.append(place)
        else:
            places[-1] = place
        return tuple(bounds), tuple(places)

    @property
    def bounds(self) -> tuple[int, ...]:
        return self.index[0]

    def read(self, start: int, stop: int, request: Request) -> Columns:
        bounds, places = self.index
        first = int(np.searchsorted(bounds, start, side="right")) - 1
        last = int(np.searchsorted(bounds, stop, side="left"))
        with self.path.open("rb") as file:
            file.seek(places[first])
            text = file.read(places[last] - places[first])
        headers, _ = _named(self.layout, str(self.path))
        columns = request.rows(headers)
        values = self._parsed(text, columns, bounds[first], bounds[last])
        taken = slice(start - bounds[first], stop - bounds[first])
        found = Columns.build(headers, lambda i: values[i][taken], lambda _: columns)
        return replace(found, step=self.layout.step)

    def _parsed(self, text: bytes, columns: list[int], start: int, stop: int) -> dict[int, Floats]:
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

    def _by_arrow(self, text: bytes, columns: list[int]) -> dict[int, Floats]:
        with needing("pyarrow", "parquet", "reading text files of this size"):
            import pyarrow as pa
            import pyarrow.csv as pc
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
