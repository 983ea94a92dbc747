"""Cells of a line of text: how lines are split, which cells are numbers, names or units."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence

__all__ = [
    "MISSING",
    "delimiter_of",
    "is_blank",
    "is_comment",
    "is_number",
    "is_words",
    "number_of",
    "split",
    "unit_cell",
    "words",
]

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


def is_number(cell: str, comma: bool = True) -> bool:
    """Whether a cell is a finite number, perhaps with a decimal comma or an exponent of Fortran's."""
    try:
        float(_with_e(cell))
    except ValueError:
        return comma and bool(_COMMA_NUMBER.fullmatch(cell))
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
