"""How a delimited text file is laid out: encoding, delimiter, preamble, header, units, where the data begin."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from bayeq.errors import FileFormatError
from bayeq.records.formats.cells import (
    MISSING,
    bracketed_words,
    delimiter_of,
    fitted,
    is_blank,
    is_comment,
    is_number,
    is_words,
    number_of,
    parse_stamp,
    split,
    unit_cell,
    unquoted,
    words,
)
from bayeq.records.formats.protocol import MOST_COLUMNS

T = TypeVar("T")

_SAMPLE_LINES = 200
_SAMPLE_BYTES = 65536
_LONGEST_LINE = 2**21
# This number of rows of numbers in a sequence are the beginning of a table.
_ROWS = 3
# Rows above a table that may belong to its head.
_HEAD = 8
# Campbell's row of how a value was made of samples.
_PROCESSING = frozenset({"smp", "avg", "min", "max", "tot", "std", "med", "win", ""})

_NUMBER = r"(?P<number>[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)"
_RATE = (
    r"sampl(?:e|ing)[ _-]?(?:rate|frequency|freq\.?)|samplerate|abtast(?:rate|frequenz)|scan rate|fs|"
    r"samples/sec(?:ond)?"
)
_STEP = (
    r"sampl(?:e|ing)[ _-]?(?:interval|period|time|distance)|time[ _-]?(?:step|increment|interval)|delta[ _-]?[xt]|dt|"
    r"x ?increment|abtastintervall"
)
_STATED = re.compile(
    rf"\W*(?:(?P<rate>{_RATE})|(?P<step>{_STEP}))\s*(?:[\[(](?P<unit>[^\])]*)[\])])?\W*[:=;,|\t ]\W*?{_NUMBER}"
    r"\s*[\"';,|\t ]*(?P<after>[A-Za-zµμ/]*)",
    re.IGNORECASE,
)
_UNITS = {
    "hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "ks/s": 1e3, "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6,
    "µs": 1e-6, "μs": 1e-6, "ns": 1e-9,
}  # fmt: skip


class Layout(NamedTuple):
    """Where the columns of a text file are."""

    encoding: str
    delimiter: str | None  # between cells; None for white space
    header: list[str] | None  # its cells; may be one longer or shorter than `width` where lines end in a delimiter
    comment: str  # the comment line directly before the data, without its mark; it may name the columns
    skip: int  # lines before the first row of data
    width: int  # cells in the first row of data
    comma: bool  # whether a comma may be a decimal mark
    stamps: tuple[int, ...] = ()  # columns of time stamps
    step: float | None = None  # time step [s] that a preamble or a comment states


def encodings(path: Path) -> tuple[str, ...]:
    """The encodings to try, in order; none if the file is not text."""
    with path.open("rb") as file:
        raw = file.read(_SAMPLE_BYTES)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return ("utf-16",)
    if any(byte < 32 and byte not in b"\t\n\v\f\r\x1a" for byte in raw):
        return ()
    return ("utf-8-sig", "latin-1")


def decoded(path: Path, where: str, read: Callable[[str], T]) -> T:
    """What is read in the first encoding that fits; a FileFormatError if the file is not text."""
    for encoding in encodings(path):
        try:
            return read(encoding)
        except UnicodeError:  # also a UTF-16 file that ends within a character
            continue
    raise FileFormatError(f"{where}: not a text file")


def looks_like_text(path: Path) -> bool:
    """Whether the beginning of a file is free of bytes that text does not have."""
    return bool(encodings(path))


def _sample(path: Path, encoding: str, where: str, skip: int) -> tuple[list[tuple[int, str]], list[str]]:
    """The first lines that are neither blank nor comments, numbered, and the comments before the data."""
    lines: list[tuple[int, str]] = []
    comments: list[str] = []
    number = 0
    with path.open(encoding=encoding) as file:
        while len(lines) < _SAMPLE_LINES and (line := file.readline(_LONGEST_LINE)):
            number += 1
            if len(line) == _LONGEST_LINE:
                raise FileFormatError(
                    f"{where}, line {number}: longer than {_LONGEST_LINE} characters; this is no table"
                )
            if number <= skip or is_blank(line):
                continue
            if not is_comment(line):
                lines.append((number, line))
            elif not lines:
                comments.append(line.strip().lstrip("#% "))
    return lines, comments


def sniff(path: Path, encoding: str, where: str = "", skip: int = 0) -> Layout:
    """Find the layout from the first lines below `skip`.

    A FileFormatError says that the file is empty, has no rows, or a header that does not fit its rows.
    """
    where = where or str(path)
    lines, comments = _sample(path, encoding, where, skip)
    if not lines and skip:
        raise FileFormatError(f"{where}: the file has no data after the {skip} skipped line{'s' * (skip != 1)}")
    if not lines:
        raise FileFormatError(f"{where}: the file is empty{' but for comments' if comments else ''}")
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
    step = table.step if table is not None and table.step is not None else stated_step(comments)
    comment = comments[-1] if comments else ""
    return Layout(encoding, delimiter, header, comment, lines[first][0] - 1, width, comma, stamps, step)


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
    units = _unit_row(cells) if is_words(cells) else None
    first = 1 if units is None else 2
    header = words(rows[0], delimiter, len(split(rows[first], delimiter)) if first < len(rows) else 0)
    if units is not None and len(header) == len(units):
        header = with_units(header, units)
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
        hint = "; if the comma is the decimal mark, write points" if len(row) == 2 * len(header) else ""
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


# --- above the table -------------------------------------------------------------------------------------------------


class Table(NamedTuple):
    """Where a table begins among the lines of a file, and what stands above it."""

    start: int
    delimiter: str | None
    header: list[str] | None
    step: float | None


def find_table(rows: Sequence[str]) -> Table | None:
    """The table below a preamble; None where there is none, or where lines above look like damaged data.

    `rows` are the first lines of the file, without blank lines and comments.
    """
    if len(rows) < _ROWS:
        return None
    delimiter = delimiter_of(rows[-max(1, len(rows) // 2) :])
    width = len(split(rows[-1], delimiter))
    like = [_is_data(row, delimiter, width) for row in rows]
    start = next((i for i in range(len(rows) - _ROWS + 1) if all(like[i : i + _ROWS])), 0)
    if start < 2 or any(_is_numbers(row, delimiter) for row in rows[:start]):
        return None
    if all(is_number(split(row, delimiter)[0]) for row in rows[:start]):  # faulty rows: nothing there names anything
        return None
    rigol = _rigol(rows, start, delimiter)
    if rigol is not None:
        return rigol
    above = [fitted(words(row, delimiter, width), width) for row in rows[:start]]
    # below a header are units, or faulty rows
    faulty = start == 2 or any(cells is not None and is_number(cells[0]) for cells in above[1:])
    if faulty and above[0] is not None and is_words(above[0]):
        return None
    if above[-1] is not None and not is_words(above[-1]):
        return None
    head: list[list[str]] = []
    for cells in reversed(above[-_HEAD:]):
        # above a row of units stand names, even if some are numbers of channels
        named = len(head) == 1 and _unit_row(head[0]) is not None
        if cells is None or (any(map(is_number, cells)) and (not named or all(map(is_number, cells)))):
            break
        head.insert(0, cells)
    names = _names(head)
    if names is not None:
        names = _with_stated_units(names, above)
    return Table(start, delimiter, names, stated_step(rows[:start]))


def _is_data(row: str, delimiter: str | None, width: int) -> bool:
    """Whether a line is a row of numbers, missing numbers and time stamps, at least one of them there."""
    cells = fitted(split(row, delimiter), width)
    if cells is None:
        return False
    known = [is_number(cell) or parse_stamp(cell) is not None for cell in cells]
    return any(known) and all(k or cell.lower() in MISSING for k, cell in zip(known, cells, strict=True))


def _is_numbers(row: str, delimiter: str | None) -> bool:
    """Whether a line is a row of several numbers, as of a table, of whatever width."""
    cells = [cell for cell in split(row, delimiter) if cell]
    return len(cells) > 1 and all(map(is_number, cells))


def _names(head: list[list[str]]) -> list[str] | None:
    """Names of the columns, with units, from the rows above them."""
    if head and all(cell.lower() in _PROCESSING for cell in head[-1]):
        head = head[:-1]
    units: list[str] | None = None
    if len(head) > 1 and (units := _unit_row(head[-1])) is not None:
        head = head[:-1]
    if not head:
        return None
    names = list(head[-1])
    for upper in reversed(head[:-1]):
        if len({*names}) == len(names):
            break
        names = [f"{a} {b}" if a and b and a != b else a or b for a, b in zip(upper, names, strict=True)]
    return with_units(names, units) if units is not None else names


def _unit_row(cells: Sequence[str]) -> list[str] | None:
    """The units of a row in which every cell is one (or Campbell's marks of time and number); None if it is not."""
    units = ["" if cell in ("TS", "RN") else unit_cell(cell) for cell in cells]
    return [unit or "" for unit in units] if any(units) and None not in units else None


def _with_stated_units(names: list[str], above: Sequence[list[str] | None]) -> list[str]:
    """Names with the units of a line such as ``Vertical Units,V,A``, which has one for every channel but the first."""
    for cells in above:
        if cells is not None and cells[0].casefold() in ("vertical units", "units", "unit", "einheit", "einheiten"):
            units = [unit_cell(cell) for cell in cells[1:]]
            if all(units) and not any("[" in name or "(" in name for name in names[1:]):
                return [names[0], *with_units(names[1:], [unit or "" for unit in units])]
    return names


def with_units(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Headers with units in brackets."""
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]


def _rigol(rows: Sequence[str], start: int, delimiter: str | None) -> Table | None:
    """Rigol's oscilloscopes write start and step of time beside the names of the channels."""
    names, below = split(rows[start - 2], delimiter), split(rows[start - 1], delimiter)
    lower = [name.casefold() for name in names]
    if "increment" not in lower or len(below) < len(names) or not is_number(below[lower.index("increment")]):
        return None
    step = number_of(below[lower.index("increment")])
    units = ["" if is_number(cell) else unit_cell(cell) or "" for cell in below[: len(names)]]
    width = len(split(rows[start], delimiter))
    header = with_units(names, units)[:width]
    return Table(start, delimiter, [*header, *[""] * (width - len(header))], step)


def stated_step(lines: Sequence[str]) -> float | None:
    """The time step [s] that lines above a table state, as a step or as a rate.

    Examples
    --------
    >>> stated_step(["Sample Interval,4.0E-3"]), stated_step(["Sampling rate: 2 kHz"]), stated_step(["x,v"])
    (0.004, 0.0005, None)
    """
    for line in lines:
        match = _STATED.match(line.strip())
        if match is None:
            continue
        number = float(match["number"].replace(",", "."))
        factor = _UNITS.get((match["unit"] or match["after"] or "").casefold(), 1.0)
        if number > 0:
            return number * factor if match["step"] else 1.0 / (number * factor)
    return None
