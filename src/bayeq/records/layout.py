"""How a delimited text file is laid out: encoding, delimiter, header, where the data begin."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bayeq.errors import FileFormatError

__all__ = [
    "MISSING",
    "Layout",
    "comment_header",
    "encodings",
    "is_blank",
    "is_comment",
    "looks_like_text",
    "split",
    "sniff",
]

#: Cells that stand for a missing sample, in lower case.
MISSING = frozenset({"", "na", "n/a", "#n/a", "nan", "+nan", "-nan", "null", "none"})
_SAMPLE_LINES = 50
_SAMPLE_BYTES = 65536
_WORD = re.compile(r"\"[^\"]*\"|'[^']*'|[^\s\[(]+(?:\s*(?:\[[^\]]*\]|\([^)]*\)))?|\S+")
_UNIT_ATOM = r"(?:[numkMGµμ]?(?:m|s|g|N|Nm|V|A|K|Pa|Hz|rad|Ohm|W|J)|mm|deg|°C?|degC|%|rpm|bar|min|h|in|ft|lbf|-|1)"
_UNIT_CELL = re.compile(rf"^(?:\[.*\]|\(.*\)|{_UNIT_ATOM}(?:\^?-?[0-9²³])?(?:[/*·. ]{_UNIT_ATOM}(?:\^?-?[0-9²³])?)*)$")
# A line that is one cell in quotes, as the csv module writes it: a quote within is doubled.
_QUOTED_LINE = re.compile(r"\s*\"((?:[^\"]|\"\")*)\"\s*")
_COMMA_CELL = re.compile(r"[+-]?\d+(?:,\d+)?(?:[eE][+-]?\d+)?")
_COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")


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
    """

    encoding: str
    delimiter: str | None
    header: list[str] | None
    header_line: int
    comment: str
    skip: int
    width: int
    comma: bool


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


def _words(line: str, delimiter: str | None, width: int) -> list[str]:
    """The cells of a header line; a unit in brackets belongs to the word before it."""
    if delimiter is not None:
        return split(line, delimiter)
    if width == 1:
        return [_unquoted(line).strip()]
    words = _bracketed_words(line)
    return words if len(words) == width else split(line, None)


def _bracketed_words(line: str) -> list[str]:
    return [word.strip("\"'") for word in _WORD.findall(line)]


def _unquoted(line: str) -> str:
    """The line without the quotes of a file of one column, where no delimiter tells that it is a cell.

    Examples
    --------
    >>> _unquoted('"x [in""]"'), _unquoted('"x" "v"')
    ('x [in"]', '"x" "v"')
    """
    match = _QUOTED_LINE.fullmatch(line)
    return match[1].replace('""', '"') if match else line


def _is_number(cell: str, comma: bool = True) -> bool:
    try:
        float(cell.replace("D", "E").replace("d", "e"))
    except ValueError:
        return comma and bool(_COMMA_NUMBER.fullmatch(cell))
    return cell.strip("+-").lower() not in ("nan", "inf", "infinity")


def _is_words(cells: list[str]) -> bool:
    """Whether cells are names: no number among them, and something other than missing numbers."""
    return not any(map(_is_number, cells)) and any(
        cell.lower() not in MISSING and cell.strip("+-").lower() not in ("inf", "infinity") for cell in cells
    )


def _delimiter(lines: list[str]) -> str | None:
    """The character that most lines have, asked in the order ; tab , and white space if none."""
    for mark in (";", "\t", ","):
        if 2 * sum(mark in line for line in lines) < len(lines):
            continue
        words = [line.split() for line in lines]
        if mark == "\t" and all(_is_number(word) for row in words for word in row):
            # Tabs and blanks mixed, as by editors: every run of white space separates.
            mixed = any(len(row) > line.strip().count(mark) + 1 for row, line in zip(words, lines, strict=True))
            return None if mixed else mark
        if mark == "," and all(len(row) > 1 and all(map(_COMMA_CELL.fullmatch, row)) for row in words):
            return None  # decimal commas, which the reader refuses by name
        return mark
    return None


def _content(file: Iterator[str]) -> tuple[list[tuple[int, str]], str]:
    """The first lines that are neither blank nor comments, numbered, and the comment before the data."""
    lines: list[tuple[int, str]] = []
    comment = ""
    for number, line in enumerate(file, 1):
        if is_comment(line):
            comment = line.strip().lstrip("#% ") if not lines else comment
        elif not is_blank(line):
            lines.append((number, line))
            if len(lines) == _SAMPLE_LINES:
                break
    return lines, comment


def sniff(path: Path, encoding: str) -> Layout:
    """Find the layout from the first lines.

    Raises
    ------
    FileFormatError
        The file is empty, has no rows, or its header does not fit its rows.
    """
    with path.open(encoding=encoding) as file:
        lines, comment = _content(file)
    if not lines:
        raise FileFormatError(f"{path}: the file is empty{' but for comments' if comment else ''}")
    asked = re.fullmatch(r"\s*\"?sep=(.)\"?\s*", lines[0][1])  # a line that Excel reads and writes
    if asked:
        lines = lines[1:]
        if not lines:
            raise FileFormatError(f"{path}: no rows")
    rows = [line for _, line in lines]
    delimiter = asked[1] if asked else _delimiter(rows[1:] or rows)
    header: list[str] | None = None
    first = 0
    head = split(rows[0], delimiter) if delimiter is not None else _bracketed_words(_unquoted(rows[0]))
    if _is_words(head):
        if len(rows) == 1:
            raise FileFormatError(f"{path}: a header but no rows")
        first = 1
        units = split(rows[1], delimiter)
        if any(units) and all(not cell or _UNIT_CELL.match(cell) for cell in units) and _is_words(units):
            first = 2
        header = _words(rows[0], delimiter, len(split(rows[first], delimiter)) if first < len(rows) else 0)
        if first == 2 and len(header) == len(units):
            bare = [unit[1:-1] if unit[:1] in ("[", "(") else unit for unit in units]
            header = [f"{name} [{unit}]" if unit else name for name, unit in zip(header, bare, strict=True)]
        if first == len(rows):
            raise FileFormatError(f"{path}: a header but no rows")
    data = rows[first:]
    width = len(split(data[0], delimiter))
    if header is not None:
        header = _fit_header(path, header, split(data[0], delimiter), lines[0][0], lines[first][0])
    comma = delimiter in (";", "\t") and not any("." in line for line in data)
    skip = lines[first][0] - 1
    return Layout(encoding, delimiter, header, lines[0][0], comment, skip, width, comma)


def _fit_header(path: Path, header: list[str], row: list[str], line: int, row_line: int) -> list[str]:
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
            f"{path}, line {row_line}: {len(row)} values, but the header in line {line} names {len(header)} "
            f"column{'s' * (len(header) != 1)}{hint}"
        )
    return header


def comment_header(layout: Layout) -> list[list[str]]:
    """Readings of the comment before the data as column names: all of them, or all but trial and time."""
    if layout.header is not None or not layout.comment:
        return []
    found = []
    for width in (layout.width, layout.width - 2):
        words = _words(layout.comment, layout.delimiter, width) if width > 0 else []
        if len(words) != width:
            words = _words(layout.comment, None, width) if width > 0 else []
        if width > 0 and len(words) == width and _is_words(words):
            found.append(words)
    return found
