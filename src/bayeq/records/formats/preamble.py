"""What instruments write above a table: where the table begins, its names and units, and the sampling rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from bayeq.records.formats.cells import MISSING, delimiter_of, is_number, is_words, number_of, split, unit_cell, words
from bayeq.records.formats.stamps import parse_stamp

__all__ = ["Table", "find_table", "stated_step", "with_units"]

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


class Table(NamedTuple):
    """Where a table begins among the lines of a file, and what stands above it."""

    start: int
    delimiter: str | None
    header: list[str] | None
    step: float | None


def find_table(rows: Sequence[str]) -> Table | None:
    """The table below a preamble; None where there is no preamble, or where lines above look like damaged data.

    Parameters
    ----------
    rows : sequence of str
        The first lines of the file, without blank lines and comments.
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
    above = [_cells(row, delimiter, width) for row in rows[:start]]
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
    cells = split(row, delimiter)
    if len(cells) == width + 1 and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != width:
        return False
    known = [is_number(cell) or parse_stamp(cell) is not None for cell in cells]
    return any(known) and all(k or cell.lower() in MISSING for k, cell in zip(known, cells, strict=True))


def _is_numbers(row: str, delimiter: str | None) -> bool:
    """Whether a line is a row of several numbers, as of a table, of whatever width."""
    cells = [cell for cell in split(row, delimiter) if cell]
    return len(cells) > 1 and all(map(is_number, cells))


def _cells(row: str, delimiter: str | None, width: int) -> list[str] | None:
    """The cells of a line above the table, if there are as many as the table has columns."""
    cells = words(row, delimiter, width)
    if len(cells) == width + 1 and not cells[-1]:
        cells = cells[:-1]
    return cells if len(cells) == width else None


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
