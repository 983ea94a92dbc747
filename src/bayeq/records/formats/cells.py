"""Cells of a line of text: how lines are split, which cells are numbers, names, units or time stamps."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from datetime import datetime, timedelta

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
    """Whether a line is white space of any script, or the mark of the end that old systems write."""
    return not line.strip().strip("\x1a")


def split(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line, stripped; quotes are removed.

    Examples
    --------
    >>> split('"a, b", 2,', ","), split("t [s]  x", None)
    (['a, b', '2', ''], ['t', '[s]', 'x'])
    """
    if '"' in line and delimiter is not None:
        try:
            return [
                cell.strip()
                for cell in next(csv.reader([line.strip(" \r\n")], delimiter=delimiter, skipinitialspace=True))
            ]
        except (csv.Error, StopIteration):  # a cell beyond the csv module's limit
            return [cell.strip() for cell in line.split(delimiter)]
    if delimiter is None:
        return [cell.strip('"') for cell in line.split()]
    return [cell.strip() for cell in line.strip(" \r\n").split(delimiter)]


def fitted(cells: list[str], width: int) -> list[str] | None:
    """The cells without the empty one that a delimiter at the end of a line leaves; None of another number of cells."""
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
    """The words of a line; a unit in brackets belongs to the word before it."""
    return [word.strip("\"'") for word in _WORD.findall(line)]


def unquoted(line: str) -> str:
    """The line without the quotes of a file of one column, where no delimiter tells that it is a cell.

    Examples
    --------
    >>> unquoted('"x [in""]"'), unquoted('"x" "v"')
    ('x [in"]', '"x" "v"')
    """
    match = _QUOTED_LINE.fullmatch(line)
    return match[1].replace('""', '"') if match else line


def is_number(cell: str) -> bool:
    """Whether a cell is a finite number, perhaps with a decimal comma or an exponent of Fortran's."""
    try:
        float(_with_e(cell))
    except ValueError:
        return bool(_COMMA_NUMBER.fullmatch(cell))
    return cell.strip("+-").lower() not in ("nan", "inf", "infinity")


def number_of(cell: str) -> float:
    """The number in a cell that `is_number`.

    Examples
    --------
    >>> number_of("1,5"), number_of("2.0d-3")
    (1.5, 0.002)
    """
    return float(_with_e(cell).replace(",", "."))


def _with_e(cell: str) -> str:
    return cell.replace("D", "E").replace("d", "e")


def is_words(cells: list[str]) -> bool:
    """Whether cells are names: no number among them, and something other than missing numbers."""
    return not any(map(is_number, cells)) and any(
        cell.lower() not in MISSING and cell.strip("+-").lower() not in ("inf", "infinity") for cell in cells
    )


def delimiter_of(lines: Sequence[str]) -> str | None:
    """The character that most lines have, asked in the order ; tab | , and white space if none."""
    for mark in (";", "\t", "|", ","):
        if 2 * sum(mark in line for line in lines) < len(lines):
            continue
        parts = [line.split() for line in lines]
        if mark == "\t" and all(is_number(word) for row in parts for word in row):
            # Tabs and blanks mixed, as by editors: every run of white space separates.
            mixed = any(len(row) > line.strip().count(mark) + 1 for row, line in zip(parts, lines, strict=True))
            return None if mixed else mark
        if mark == "," and all(len(row) > 1 and all(map(_COMMA_CELL.fullmatch, row)) for row in parts):
            return None  # decimal commas, which the reader refuses by name
        return mark
    return None


def unit_cell(cell: str) -> str | None:
    """The unit that a cell of a row of units holds, empty where there is none; None if it is no unit.

    Examples
    --------
    >>> unit_cell("[m/s]"), unit_cell("Volts"), unit_cell(""), unit_cell("Alice")
    ('m/s', 'V', '', None)
    """
    text = cell.strip()
    bare = text[1:-1].strip() if text[:1] in ("[", "(") and text[-1:] in ("]", ")") else text
    if bare.casefold() in UNIT_WORDS:
        return UNIT_WORDS[bare.casefold()]
    return bare if not text or _UNIT_CELL.match(text) else None


#: Whole seconds (since year 1 or midnight) and the rest: their difference keeps every digit.
Stamp = tuple[int, float]

_DAY = (
    r"(?:(?P<year>\d{4})[-/](?P<month>\d\d?)[-/](?P<day>\d\d?)|(?P<day2>\d\d?)\.(?P<month2>\d\d?)\.(?P<year2>\d{4})"
    r"|(?P<month3>\d\d?)/(?P<day3>\d\d?)/(?P<year3>\d{4}))"
)
_CLOCK = (
    r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<rest>\d+))?)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE = r"(?:Z|(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)?)?"
_STAMP = re.compile(rf"(?:{_DAY}(?:[T ]\s*{_CLOCK}\s*{_ZONE})?)|(?:{_CLOCK.replace('?P<', '?P<c_')})")
_FIRST = datetime(1, 1, 1)


def parse_stamp(text: str, day_first: bool = False) -> Stamp | None:
    """A date, a date with a clock, or a clock; None of other text.

    Of dates with slashes and the year at the end the month is first, unless it is no month or `day_first`.

    Examples
    --------
    >>> parse_stamp("2024-03-01 12:00:01.5"), parse_stamp("0:00:01,25"), parse_stamp("01.03.2024 12:00:00,25")[1]
    ((63844891201, 0.5), (1, 0.25), 0.25)
    >>> parse_stamp("3/1/2024 1:00:00 PM") == parse_stamp("1/3/2024 13:00", day_first=True)
    True
    """
    match = _STAMP.fullmatch(text.strip().strip("\"'"))
    if match is None:
        return None
    found = match.groupdict()
    kind = next((kind for kind in ("", "2", "3") if found[f"year{kind}"]), None)
    clock = "" if found["hour"] else "c_"
    seconds = 0
    try:
        if kind is not None:
            year, month, day = (int(found[f"{part}{kind}"]) for part in ("year", "month", "day"))
            if kind == "3" and (day_first or month > 12):
                month, day = day, month
            seconds = (datetime(year, month, day) - _FIRST) // timedelta(seconds=1)
    except ValueError:  # the 31st of February
        return None
    hour, minute, second = (int(found[f"{clock}{part}"] or 0) for part in ("hour", "minute", "second"))
    if minute > 59 or second > 60:
        return None
    if half := found[f"{clock}half"]:
        hour = hour % 12 + 12 * (half in "Pp")
    seconds += 3600 * hour + 60 * minute + second
    if found["sign"]:
        zone = 3600 * int(found["zh"]) + 60 * int(found["zm"] or 0)
        seconds -= zone if found["sign"] == "+" else -zone
    rest = found[f"{clock}rest"]
    return seconds, float(f"0.{rest}") if rest else 0.0
