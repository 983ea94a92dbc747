"""Excel's sheets, .xlsx by openpyxl and .xls by xlrd (the extra ``files``); formulas are never evaluated."""

from __future__ import annotations

import io
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from bayeq.errors import FileFormatError, UnknownNameError, needing, some_of
from bayeq.records.columns import Columns, Names, Select
from bayeq.records.formats import text
from bayeq.records.formats.protocol import MOST_COLUMNS, check_claim, reading

#: First bytes of .xls files (an OLE container).
OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
MOST_ROWS = 1_048_576
# A path with the name of a sheet in brackets; such names contain no brackets.
_WITH_SHEET = re.compile(r"(.+\.xls[xm]?)\[([^\[\]]+)\]", re.IGNORECASE)
Sheet = tuple[str, Iterable[Iterable[Any]]]


def read_columns(
    path: Path,
    *,
    names: Names = None,
    chosen: Select | None = None,
    sheet: str | None = None,
    group: str | None = None,
) -> Columns:
    """Read a sheet, by default the one with most rows of numbers, like delimited text; formulas give saved values."""
    where = str(path)
    titles: dict[str, int] = {}  # number of rows of numbers by sheet
    with tempfile.TemporaryDirectory() as folder, reading(where, "Excel file"):
        plain, other, best = Path(folder) / "sheet", Path(folder) / "other", ""
        with path.open("rb") as file:
            sheets = _xls if file.read(8) == OLE else _xlsx
        for title, rows in sheets(path):
            titles[title] = _write_text(rows, other) if sheet in (None, title) else 0
            if titles[title] > titles.get(best, 0):
                best = title
                other.replace(plain)
        if sheet is not None and sheet not in titles:
            raise UnknownNameError("sheet", sheet, titles, where)
        if not best:
            raise FileFormatError(
                f"{where}: {'no sheet holds' if sheet is None else f'sheet {sheet!r} does not hold'} numbers"
            )
        found = text.read_columns(plain, names=names, chosen=chosen, where=f"{where}, sheet {best!r}", group=group)
    others = [repr(title) for title, count in titles.items() if count and title != best]
    if not others:
        return found
    doubt = (
        f"{where}: sheet {best!r} is read, of {titles[best]} rows, not {some_of(others, 20)}; give another:"
        " --sheet NAME (sheet=)"
    )
    return replace(found, doubts=(*found.doubts, doubt))


def without_sheet(path: Path) -> tuple[Path, str | None]:
    """Split a path from the name of a sheet in brackets at its end; None without one.

    >>> without_sheet(Path("book.xlsx[Run 1]"))
    (PosixPath('book.xlsx'), 'Run 1')
    """
    named = _WITH_SHEET.fullmatch(str(path))
    return (path, None) if named is None or path.exists() else (Path(named[1]), named[2])


def _xlsx(path: Path) -> Iterator[Sheet]:
    with needing("openpyxl", "files", "reading Excel files"):
        import openpyxl
    with zipfile.ZipFile(path) as archive:
        check_claim(str(path), "the workbook", sum(m.file_size for m in archive.infolist()), path.stat().st_size)
    with path.open("rb") as file:  # given the path, openpyxl would check the suffix
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
        try:
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # claimed by the file; every row would be padded to them
                yield sheet.title, sheet.iter_rows(values_only=True)
        finally:
            book.close()


def _xls(path: Path) -> Iterator[Sheet]:
    with needing("xlrd", "files", "reading .xls files"):
        import xlrd
    with xlrd.open_workbook(path, on_demand=True, logfile=io.StringIO()) as book:
        for k in range(book.nsheets):
            sheet = book.sheet_by_index(k)
            yield sheet.name, (_xls_row(xlrd, book, sheet.row(i)) for i in range(sheet.nrows))


def _xls_row(xlrd: Any, book: Any, cells: Iterable[Any]) -> list[Any]:
    row: list[Any] = []
    for cell in cells:
        if cell.ctype == xlrd.XL_CELL_DATE:
            row.append(xlrd.xldate_as_datetime(cell.value, book.datemode))
        else:
            empty = cell.ctype in (xlrd.XL_CELL_ERROR, xlrd.XL_CELL_EMPTY, xlrd.XL_CELL_BLANK)
            row.append(None if empty else cell.value)
    return row


def _write_text(rows: Iterable[Iterable[Any]], path: Path) -> int:
    """Write a sheet as text separated by tabs; returns the number of rows that hold a number."""
    numbers = width = 0
    with path.open("w", encoding="utf-8") as file:
        for number, row in enumerate(rows):
            if number == MOST_ROWS:  # for a damaged row number openpyxl would make up all rows above it
                raise FileFormatError(f"a row beyond {MOST_ROWS}, the last that Excel has; the file is damaged")
            cells = list(row)
            while cells and cells[-1] is None:
                cells.pop()
            if len(cells) > MOST_COLUMNS:
                raise FileFormatError(f"{len(cells)} columns; at most {MOST_COLUMNS} are read")
            width = max(width, len(cells))
            if cells:  # an empty cell at the end of a row is a missing sample
                cells += [None] * (width - len(cells))
            numbers += any(isinstance(cell, (int, float)) for cell in cells)
            file.write("\t".join(map(_cell, cells)) + "\n")
    return numbers


def _cell(value: Any) -> str:
    """A cell as text that reads back as the same number or time."""
    if value is None:
        return ""
    if isinstance(value, (bool, int, float)):
        return repr(float(value))
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return " ".join(str(value).replace('"', "").split())
