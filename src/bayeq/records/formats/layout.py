"""How a delimited text file is laid out: encoding, delimiter, preamble, header, units, where the data begin; cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple, TypeVar

from bayeq.errors import FileFormatError
from bayeq.records.formats.protocol import MOST_COLUMNS

T = TypeVar("T")

_SAMPLE_LINES = 200
_SAMPLE_BYTES = 65536
_LONGEST_LINE = 2**21
# A table begins at this many consecutive rows of numbers.
_ROWS = 3
# Maximum number of header rows above a table.
_HEAD = 8
# Words in Campbell's header row of how samples were combined into a value.
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
    """The layout of a delimited text file."""

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
    """The encodings to try, in order; none if the file begins with bytes that text does not have."""
    with path.open("rb") as file:
        raw = file.read(_SAMPLE_BYTES)
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return ("utf-16",)
    if any(byte < 32 and byte not in b"\t\n\v\f\r\x1a" for byte in raw):
        return ()
    return ("utf-8-sig", "latin-1")


def decoded(path: Path, where: str, read: Callable[[str], T]) -> T:
    """The result of `read` with the first encoding that fits; a FileFormatError if the file is not text."""
    for encoding in encodings(path):
        try:
            return read(encoding)
        except UnicodeError:  # also a UTF-16 file that ends within a character
            continue
    raise FileFormatError(f"{where}: not a text file")


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
    """Find the layout from the first lines below `skip`; FileFormatError for no rows, or a header that does not fit."""
    where = where or str(path)
    lines, comments = _sample(path, encoding, where, skip)
    if not lines and skip:
        raise FileFormatError(f"{where}: the file has no data after the {skip} skipped line{'s' * (skip != 1)}")
    if not lines:
        raise FileFormatError(f"{where}: the file is empty{' but for comments' if comments else ''}")
    asked = re.fullmatch(r"\s*\"?sep=(.)\"?\s*", lines[0][1])  # Excel's line that states the delimiter
    if asked:
        lines = lines[1:]
        if not lines:
            raise FileFormatError(f"{where}: no rows")
    rows = [line for _, line in lines]
    table = None if asked else find_table(rows)
    step = None
    if table is not None:
        first, delimiter, header, step = table
        line = lines[first - 1][0]
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
    quoted = delimiter == "," and any(map(_QUOTED_COMMA.search, data))
    comma = (quoted or delimiter in (";", "\t", "|")) and not any(
        "." in cell for row in data for i, cell in enumerate(split(row, delimiter)) if i not in stamps
    )
    step = stated_step(comments) if step is None else step
    comment = comments[-1] if comments else ""
    return Layout(encoding, delimiter, header, comment, lines[first][0] - 1, width, comma, stamps, step)


def _header(rows: list[str], delimiter: str | None, where: str) -> tuple[list[str] | None, int]:
    """The header of a table that begins at the first line, if it has one, and its first row of data."""
    head = split(rows[0], delimiter) if delimiter is not None else bracketed_words(unquoted(rows[0]))
    if not is_words(head):
        return None, 0
    cells = split(rows[1], delimiter) if len(rows) > 1 else []
    units = _unit_row(cells) if is_words(cells) else None
    first = 1 if units is None else 2
    if first == len(rows):
        raise FileFormatError(f"{where}: a header but no rows")
    header = words(rows[0], delimiter, len(split(rows[first], delimiter)))
    if units is not None and len(header) == len(units):
        header = with_units(header, units)
    return header, first


def _fit_header(where: str, header: list[str], row: list[str], line: int, row_line: int) -> list[str]:
    """Bring the header to the width of the rows where one of them ends in a delimiter."""
    if len(header) == len(row) - 1 and not row[-1]:
        return [*header, ""]
    names = fitted(header, len(row))
    if names is None:
        hint = "; if the comma is the decimal mark, write points" if len(row) == 2 * len(header) else ""
        raise FileFormatError(
            f"{where}, line {row_line}: {len(row)} values, but the header in line {line} names {len(header)} "
            f"column{'s' * (len(header) != 1)}{hint}"
        )
    return names


def comment_header(layout: Layout) -> list[list[str]]:
    """Possible column names from the comment before the data: of all columns, or of all but trial and time."""
    if layout.header is not None or not layout.comment:
        return []
    found = []
    for width in range(layout.width, 0, -2)[:2]:
        names = words(layout.comment, layout.delimiter, width)
        if len(names) != width:
            names = words(layout.comment, None, width)
        if len(names) == width and is_words(names):
            found.append(names)
    return found


# --- above the table -------------------------------------------------------------------------------------------------


# First line of a table, its delimiter, and the header and time step [s] from the lines above it.
Table = tuple[int, str | None, list[str] | None, float | None]


def find_table(rows: Sequence[str]) -> Table | None:
    """Find the table below a preamble, in the first lines but comments; None without one, or below damaged data."""
    if len(rows) < _ROWS:
        return None
    delimiter = delimiter_of(rows[-max(1, len(rows) // 2) :])
    width = len(split(rows[-1], delimiter))
    like = [_is_data(row, delimiter, width) for row in rows]
    start = next((i for i in range(len(rows) - _ROWS + 1) if all(like[i : i + _ROWS])), 0)
    if start < 2 or any(_is_numbers(row, delimiter) for row in rows[:start]):
        return None
    if all(is_number(split(row, delimiter)[0]) for row in rows[:start]):  # faulty rows of data, not a preamble
        return None
    rigol = _rigol(rows, start, delimiter)
    if rigol is not None:
        return rigol
    above = [fitted(words(row, delimiter, width), width) for row in rows[:start]]
    # rows between a header and the table are units, or faulty; whole numbers in rows of another width number channels
    first = [split(row, delimiter)[0] for row in rows[1:start]]
    faulty = start == 2 or any(
        is_number(cell) and (cells is not None or not cell.lstrip("+-").isdigit())
        for cell, cells in zip(first, above[1:], strict=True)
    )
    if faulty and above[0] is not None and is_words(above[0]) and not _UNIT_LINE.match(rows[0]):
        return None
    if above[-1] is not None and not is_words(above[-1]):
        return None
    head: list[list[str]] = []
    for cells in reversed(above[-_HEAD:]):
        # the row above a row of units holds names, even if some are channel numbers
        named = len(head) == 1 and _unit_row(head[0]) is not None
        if cells is None or (any(map(is_number, cells)) and (not named or all(map(is_number, cells)))):
            break
        head.insert(0, cells)
    names = _names(head)
    if names is not None:
        names = _with_stated_units(names, above, rows[:start])
    return start, delimiter, names, stated_step(rows[:start])


def _is_data(row: str, delimiter: str | None, width: int) -> bool:
    """Whether a line is a row of numbers, time stamps and missing cells, not all of them missing."""
    cells = fitted(split(row, delimiter), width)
    if cells is None:
        return False
    known = [is_number(cell) or parse_stamp(cell) is not None for cell in cells]
    return any(known) and all(k or cell.lower() in MISSING for k, cell in zip(known, cells, strict=True))


def _is_numbers(row: str, delimiter: str | None) -> bool:
    """Whether a line is a row of two or more numbers, whatever its width."""
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
    """The units of a row whose cells are all units, empty, or Campbell's marks of time and number; None if not."""
    units = ["" if cell in ("TS", "RN") else unit_cell(cell) for cell in cells]
    return [unit or "" for unit in units] if any(units) and None not in units else None


# A line that states a unit for every column.
_UNIT_LINE = re.compile(r"\W*(?:units?|einheit(?:en)?)\s*[:=](.*)", re.IGNORECASE | re.DOTALL)


def _with_stated_units(names: list[str], above: Sequence[list[str] | None], rows: Sequence[str]) -> list[str]:
    """Names with units from a line such as ``Units: s, mm, N``, which states one for every column, or such as
    ``Vertical Units,V,A``, which does for every column but the first."""
    for found in filter(None, map(_UNIT_LINE.match, rows)):
        every = _unit_row([cell.strip(' "\r\n') for cell in re.split(r"[,;\t]", found[1])])
        if every is not None and len(every) == len(names) and not any("[" in name or "(" in name for name in names):
            return with_units(names, every)
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
    """The table of a Rigol oscilloscope, which states start and step of time next to the names; None for others."""
    names, below = split(rows[start - 2], delimiter), split(rows[start - 1], delimiter)
    lower = [name.casefold() for name in names]
    if "increment" not in lower or len(below) < len(names) or not is_number(below[lower.index("increment")]):
        return None
    step = float(below[lower.index("increment")].lower().replace("d", "e").replace(",", "."))
    units = ["" if is_number(cell) else unit_cell(cell) or "" for cell in below[: len(names)]]
    width = len(split(rows[start], delimiter))
    header = with_units(names, units)[:width]
    return start, delimiter, [*header, *[""] * (width - len(header))], step


def stated_step(lines: Sequence[str]) -> float | None:
    """The time step [s] that lines above a table state, as a step or as a rate.

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


# --- cells -----------------------------------------------------------------------------------------------------------

#: Cells that stand for a missing sample, in lower case.
MISSING = frozenset({"", "na", "n/a", "#n/a", "nan", "+nan", "-nan", "null", "none"})
_WORD = re.compile(r"\"[^\"]*\"|'[^']*'|[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?|\S+")
_UNIT_ATOM = r"(?:[numkMGµμ]?(?:m|s|g|N|Nm|V|A|K|Pa|Hz|rad|Ohm|W|J)|mm|deg|°C?|degC|%|rpm|bar|min|h|in|ft|lbf|-|1)"
_UNIT_CELL = re.compile(rf"^(?:\[.*\]|\(.*\)|{_UNIT_ATOM}(?:\^?-?[0-9²³])?(?:[/*·. ]{_UNIT_ATOM}(?:\^?-?[0-9²³])?)*)$")
# A line that is one cell in quotes, as the csv module writes it: a quote within is doubled.
_QUOTED_LINE = re.compile(r"\s*\"((?:[^\"]|\"\")*)\"\s*")
_COMMA_CELL = re.compile(r"[+-]?\d+(?:,\d+)?(?:[eE][+-]?\d+)?")
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
#: Units that instruments write in words.
UNIT_WORDS = {
    "second": "s", "seconds": "s", "sec": "s", "sek": "s", "sekunde": "s", "sekunden": "s", "msec": "ms",
    "volt": "V", "volts": "V", "ampere": "A", "amp": "A", "amps": "A", "newton": "N", "newtons": "N", "meter": "m",
    "metre": "m", "meters": "m", "metres": "m", "deg c": "°C", "degree": "deg", "degrees": "deg", "radians": "rad",
    "inch": "in", "inches": "in", "lbs": "lbf", "gs": "g", "hertz": "Hz",
}  # fmt: skip


def is_comment(line: str) -> bool:
    """Whether a line is a comment (``#`` or ``%`` in front); ``#N/A`` is a missing number."""
    line = line.lstrip()
    return line[:1] in ("#", "%") and line[:4].upper() != "#N/A"


def is_blank(line: str) -> bool:
    """Whether a line is white space of any script, or the end-of-file mark (Ctrl-Z) of old systems."""
    return not line.strip().strip("\x1a")


def split(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line, stripped; quotes are removed.

    >>> split('"a, b", 2,', ","), split("t [s]  x", None)
    (['a, b', '2', ''], ['t', '[s]', 'x'])
    """
    if delimiter is None:
        return [cell.strip('"') for cell in line.split()]
    cells = line.strip(" \r\n").split(delimiter)
    if '"' in line:
        with suppress(csv.Error, StopIteration):  # a cell beyond the csv module's limit
            cells = next(csv.reader([line.strip(" \r\n")], delimiter=delimiter, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def fitted(cells: list[str], width: int) -> list[str] | None:
    """The cells, without an empty last one from a trailing delimiter; None unless their number is `width`."""
    if len(cells) == width + 1 and not cells[-1].strip():
        cells = cells[:-1]
    return cells if len(cells) == width else None


def words(line: str, delimiter: str | None, width: int) -> list[str]:
    """The cells of a header line; a unit in brackets belongs to the word before it."""
    if delimiter is not None:
        return split(line, delimiter)
    if width == 1:
        return [unquoted(line).strip()]
    found = bracketed_words(line)
    return found if len(found) == width else split(line, None)


def bracketed_words(line: str) -> list[str]:
    """The words of a line, with units in brackets behind them."""
    return [word.strip("\"'") for word in _WORD.findall(line)]


# A quoted number with a decimal comma; before three digits it may be a separator of thousands instead.
_QUOTED_COMMA = re.compile(r'"[+-]?\d+,(?!\d{3}")\d+(?:[eE][+-]?\d+)?"')


def unquoted(line: str) -> str:
    """A line that is one quoted cell (of a file of one column) without its quotes; other lines are unchanged.

    >>> unquoted('"x [in""]"'), unquoted('"x" "v"')
    ('x [in"]', '"x" "v"')
    """
    match = _QUOTED_LINE.fullmatch(line)
    return match[1].replace('""', '"') if match else line


def is_number(cell: str) -> bool:
    """Whether a cell is a finite number, possibly with a decimal comma or a Fortran exponent (1d3)."""
    try:
        float(cell.lower().replace("d", "e"))
    except ValueError:
        return bool(_COMMA_NUMBER.fullmatch(cell))
    return cell.strip("+-").lower() not in ("nan", "inf", "infinity")


def is_words(cells: list[str]) -> bool:
    """Whether cells are names: none is a number, and not all are missing or infinite."""
    return not any(map(is_number, cells)) and any(
        cell.lower() not in MISSING and cell.strip("+-").lower() not in ("inf", "infinity") for cell in cells
    )


def delimiter_of(lines: Sequence[str]) -> str | None:
    """The first of ; tab | , that at least half of the lines contain; None, for white space, if there is none."""
    for mark in (";", "\t", "|", ","):
        if 2 * sum(mark in line for line in lines) < len(lines):
            continue
        parts = [line.split() for line in lines]
        if mark == "\t" and all(is_number(word) for row in parts for word in row):
            # Tabs and blanks mixed, as by editors: every run of white space separates.
            mixed = any(len(row) > line.strip().count(mark) + 1 for row, line in zip(parts, lines, strict=True))
            return None if mixed else mark
        if mark == "," and all(len(row) > 1 and all(map(_COMMA_CELL.fullmatch, row)) for row in parts):
            return None  # decimal commas, which the reader reports
        return mark
    return None


def unit_cell(cell: str) -> str | None:
    """The unit in a cell of a row of units, empty if the cell is; None if the text is not a unit.

    >>> unit_cell("[m/s]"), unit_cell("Volts"), unit_cell(""), unit_cell("Alice")
    ('m/s', 'V', '', None)
    """
    text = cell.strip()
    bare = text[1:-1].strip() if text[:1] in ("[", "(") and text[-1:] in ("]", ")") else text
    if bare.casefold() in UNIT_WORDS:
        return UNIT_WORDS[bare.casefold()]
    return bare if not text or _UNIT_CELL.match(text) else None


#: Whole seconds (since 1970 or midnight) and the fraction: differences keep every digit.
Stamp = tuple[int, float]

_DAYS = (
    r"(?P<year>\d{4})[-/](?P<month>\d\d?)[-/](?P<day>\d\d?)",
    r"(?P<day>\d\d?)\.(?P<month>\d\d?)\.(?P<year>\d{4})",
    r"(?P<month>\d\d?)/(?P<day>\d\d?)/(?P<year>\d{4})",
)
_CLOCK = (
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<rest>\d+))?)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE = r"(?:Z|(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)?)?"
_STAMPS = (*(re.compile(rf"{day}(?:[T ]\s*{_CLOCK}\s*{_ZONE})?") for day in _DAYS), re.compile(_CLOCK))
_FIRST = datetime(1970, 1, 1)


def parse_stamp(text: str, day_first: bool = False) -> Stamp | None:
    """Parse a date, a date with a time of day, or a time of day; None for other text.

    In dates such as 3/1/2024 the month is first, unless that number exceeds 12 or with `day_first`.

    >>> parse_stamp("2024-03-01 12:00:01.5"), parse_stamp("0:00:01,25"), parse_stamp("01.03.2024 12:00:00,25")[1]
    ((1709294401, 0.5), (1, 0.25), 0.25)
    >>> parse_stamp("3/1/2024 1:00:00 PM") == parse_stamp("1/3/2024 13:00", day_first=True)
    True
    """
    text = text.strip().strip("\"'")
    match = next((match for pattern in _STAMPS if (match := pattern.fullmatch(text))), None)
    if match is None:
        return None
    found, seconds = match.groupdict(), 0
    if "year" in found:
        year, month, day = (int(found[part]) for part in ("year", "month", "day"))
        if match.re is _STAMPS[2] and (day_first or month > 12):
            month, day = day, month
        try:
            seconds = (datetime(year, month, day) - _FIRST) // timedelta(seconds=1)
        except ValueError:  # the 31st of February
            return None
    hour, minute, second = (int(found[part] or 0) for part in ("hour", "minute", "second"))
    if minute > 59 or second > 60:
        return None
    if half := found["half"]:
        hour = hour % 12 + 12 * (half in "Pp")
    seconds += 3600 * hour + 60 * minute + second
    if found.get("sign"):
        zone = 3600 * int(found["zh"]) + 60 * int(found["zm"] or 0)
        seconds -= zone if found["sign"] == "+" else -zone
    rest = found["rest"]
    return seconds, float(f"0.{rest}") if rest else 0.0
