"""How a delimited text file is laid out: encoding, delimiter, header, where the data begin."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from bayeq.errors import FileFormatError
from bayeq.records.formats.cells import (
    bracketed_words,
    delimiter_of,
    is_blank,
    is_comment,
    is_number,
    is_words,
    split,
    unit_cell,
    unquoted,
    words,
)
from bayeq.records.formats.limits import MOST_COLUMNS
from bayeq.records.formats.preamble import find_table, stated_step, with_units
from bayeq.records.formats.stamps import parse_stamp

__all__ = ["Layout", "comment_header", "encodings", "looks_like_text", "sniff"]

_SAMPLE_LINES = 200
_SAMPLE_BYTES = 65536
_LONGEST_LINE = 2**21


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the columns of a text file are.

    Parameters
    ----------
    encoding : str
        Of the file.
    delimiter : str or None
        Between cells; None for white space.
    header : list of str or None
        The header's cells; may be one longer or shorter than `width` where lines end in a delimiter.
    header_line : int
        Its line, counted from 1.
    comment : str
        The comment line directly before the data, without its mark; it may name the columns.
    skip : int
        Lines before the first row of data.
    width : int
        Cells in the first row of data.
    comma : bool
        Whether a comma may be a decimal mark.
    stamps : tuple of int
        Columns of time stamps.
    step : float, optional
        Time step [s] that a preamble or a comment states.
    """

    encoding: str
    delimiter: str | None
    header: list[str] | None
    header_line: int
    comment: str
    skip: int
    width: int
    comma: bool
    stamps: tuple[int, ...] = ()
    step: float | None = None


def encodings(path: Path) -> tuple[str, ...]:
    """The encodings to try, in order; none if the file is not text."""
    with path.open("rb") as file:
        raw = file.read(_SAMPLE_BYTES)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return ("utf-16",)
    if any(byte < 32 and byte not in b"\t\n\v\f\r\x1a" for byte in raw):
        return ()
    return ("utf-8-sig", "latin-1")


def looks_like_text(path: Path) -> bool:
    """Whether the beginning of a file is free of bytes that text does not have."""
    return bool(encodings(path))


class _Sample(list[tuple[int, str]]):
    """The first lines that are neither blank nor comments, numbered, and the comments before the data."""

    def __init__(self, file: TextIO, where: str, skip: int = 0) -> None:
        super().__init__()
        self.comments: list[str] = []
        for number, line in enumerate(_lines(file, where), 1):
            if number <= skip:
                continue
            if is_comment(line):
                if not self:
                    self.comments.append(line.strip().lstrip("#% "))
            elif not is_blank(line):
                self.append((number, line))
                if len(self) == _SAMPLE_LINES:
                    break


def _lines(file: TextIO, where: str) -> Iterator[str]:
    number = 1
    while line := file.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise FileFormatError(f"{where}, line {number}: longer than {_LONGEST_LINE} characters; this is no table")
        yield line
        number += 1


def sniff(path: Path, encoding: str, where: str = "", skip: int = 0) -> Layout:
    """Find the layout from the first lines, or from the first after `skip` lines.

    Raises
    ------
    FileFormatError
        The file is empty, has no rows, or its header does not fit its rows.
    """
    where = where or str(path)
    with path.open(encoding=encoding) as file:
        sample = _Sample(file, where, skip)
    lines = list(sample)
    if not lines and skip:
        raise FileFormatError(f"{where}: nothing is left below the {skip} lines that are passed over")
    if not lines:
        raise FileFormatError(f"{where}: the file is empty{' but for comments' if sample.comments else ''}")
    asked = re.fullmatch(r"\s*\"?sep=(.)\"?\s*", lines[0][1])  # a line that Excel reads and writes
    if asked:
        lines = lines[1:]
        if not lines:
            raise FileFormatError(f"{where}: no rows")
    rows = [line for _, line in lines]
    table = None if asked else find_table(rows)
    if table is not None:
        delimiter, header, first, line = table.delimiter, table.header, table.start, lines[table.start - 1][0]
    else:
        delimiter = asked[1] if asked else delimiter_of(rows[1:] or rows)
        header, first = _header(rows, delimiter, where)
        line = lines[0][0]
    data = rows[first:]
    cells = split(data[0], delimiter)
    width = len(cells)
    if width > MOST_COLUMNS:
        raise FileFormatError(
            f"{where}, line {lines[first][0]}: {width} columns; at most {MOST_COLUMNS} are read: if its rows are the"
            " channels, transpose the table"
        )
    if header is not None:
        header = _fit_header(where, header, cells, line, lines[first][0])
    stamps = tuple(i for i, cell in enumerate(cells) if not is_number(cell) and parse_stamp(cell) is not None)
    comma = delimiter in (";", "\t", "|") and not any(_has_point(row, delimiter, stamps) for row in data)
    step = table.step if table is not None and table.step is not None else stated_step(sample.comments)
    comment = sample.comments[-1] if sample.comments else ""
    return Layout(encoding, delimiter, header, line, comment, lines[first][0] - 1, width, comma, stamps, step)


def _has_point(row: str, delimiter: str | None, stamps: tuple[int, ...]) -> bool:
    """Whether a row has a point in a cell that is no time stamp."""
    if not stamps:
        return "." in row
    return any("." in cell for i, cell in enumerate(split(row, delimiter)) if i not in stamps)


def _header(rows: list[str], delimiter: str | None, where: str) -> tuple[list[str] | None, int]:
    """The header of a table that begins at the first line, if it has one, and its first row of data."""
    head = split(rows[0], delimiter) if delimiter is not None else bracketed_words(unquoted(rows[0]))
    if not is_words(head):
        return None, 0
    if len(rows) == 1:
        raise FileFormatError(f"{where}: a header but no rows")
    cells = split(rows[1], delimiter)
    units = [unit_cell(cell) for cell in cells]
    has_units = any(units) and None not in units and is_words(cells)
    first = 2 if has_units else 1
    header = words(rows[0], delimiter, len(split(rows[first], delimiter)) if first < len(rows) else 0)
    if has_units and len(header) == len(units):
        header = with_units(header, [unit or "" for unit in units])
    if first == len(rows):
        raise FileFormatError(f"{where}: a header but no rows")
    return header, first


def _fit_header(where: str, header: list[str], row: list[str], line: int, row_line: int) -> list[str]:
    """Bring the header to the width of the rows where one of them ends in a delimiter."""
    if len(header) == len(row) + 1 and not header[-1]:
        return header[:-1]
    if len(header) == len(row) - 1 and not row[-1]:
        return [*header, ""]
    if len(header) != len(row):
        hint = ""
        if len(row) == 2 * len(header):
            hint = "; if the comma is the decimal mark, write points"
        raise FileFormatError(
            f"{where}, line {row_line}: {len(row)} values, but the header in line {line} names {len(header)} "
            f"column{'s' * (len(header) != 1)}{hint}"
        )
    return header


def comment_header(layout: Layout) -> list[list[str]]:
    """Readings of the comment before the data as column names: all of them, or all but trial and time."""
    if layout.header is not None or not layout.comment:
        return []
    found = []
    for width in (layout.width, layout.width - 2):
        names = words(layout.comment, layout.delimiter, width) if width > 0 else []
        if len(names) != width:
            names = words(layout.comment, None, width) if width > 0 else []
        if width > 0 and len(names) == width and is_words(names):
            found.append(names)
    return found
