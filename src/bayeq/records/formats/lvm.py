"""LabVIEW measurement files (``.lvm``): text with a header, and a header for each segment of samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import FileFormatError
from bayeq.records.formats.layout import decoded, unit_cell
from bayeq.records.formats.nested import Channel

_END = "***End_of_Header***"
_X = "X_Value"
_SEPARATORS = {"tab": "\t", "comma": ","}


def channels(path: Path) -> list[Channel]:
    """List the channels of a file; of several segments as ``[0].name``, ``[1].name`` ...."""
    where = str(path)
    lines = decoded(path, where, lambda encoding: path.read_text(encoding=encoding)).splitlines()
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        raise FileFormatError(f"{where}: not a LabVIEW measurement file: its first line is another")
    header, place = _header(lines, 1, where, "\t")
    mark = _SEPARATORS.get(header.get("Separator", ["Tab"])[0].casefold(), "\t")
    # otherwise one header applies to all segments, whose rows follow each other
    several = header.get("Multi_Headings", ["Yes"])[0].casefold() == "yes"
    segments: list[list[Channel]] = []
    while (place := _next(lines, place)) < len(lines):
        about, place = _header(lines, place, where, mark)
        stop = len(lines)
        if several:
            stop = next((i for i in range(place + 1, len(lines)) if not lines[i].strip()), len(lines))
        segments.append([*_segment(lines[:stop], place, {**header, **about}, mark, several, where)])
        place = stop
    if not segments:
        raise FileFormatError(f"{where}: a header but no samples")
    if len(segments) == 1:
        return segments[0]
    return [
        replace(channel, path=f"[{k}].{channel.path}", main=False)
        for k, segment in enumerate(segments)
        for channel in segment
    ]


def _next(lines: Sequence[str], place: int) -> int:
    """The next line that is not blank."""
    return next((i for i in range(place, len(lines)) if lines[i].strip()), len(lines))


def _header(lines: Sequence[str], place: int, where: str, mark: str) -> tuple[dict[str, list[str]], int]:
    """Keys and values up to the end of a header, and the line after it."""
    found: dict[str, list[str]] = {}
    for i in range(place, len(lines)):
        if lines[i].startswith(_END):
            return found, i + 1
        key, *values = lines[i].split(mark)
        found[key.strip()] = [value.strip() for value in values] or [""]
    raise FileFormatError(f"{where}, line {place + 1}: a header without {_END}; the file is cut off")


def _segment(
    lines: Sequence[str], place: int, about: dict[str, list[str]], mark: str, several: bool, where: str
) -> Iterator[Channel]:
    """The channels of a segment: the line of names and all rows below it."""
    if place >= len(lines):
        raise FileFormatError(f"{where}: a header but no samples")
    names = [name.strip() for name in lines[place].split(mark)]
    rows = [line.split(mark) for line in lines[place + 1 :] if several or line.strip()]
    ys = [i for i, name in enumerate(names) if name and name not in (_X, "Comment")]
    comma = about.get("Decimal_Separator", ["."])[0] == ","
    if names[0] == _X and about.get("X_Columns", ["One"])[0].casefold() == "one":
        times = _column(rows, 0, len(rows), place + 2, _X, comma, where)
        if np.isfinite(times).all() and len(times):
            yield Channel("t", len(times), times.__getitem__, unit="s")
    for k, column in enumerate(ys):
        size = int(_number(about.get("Samples"), k, len(rows), where))
        if size > len(rows):
            raise FileFormatError(f"{where}: {len(rows)} rows where the header states {size}; the file is cut off")
        if not several:
            size = max((i + 1 for i, row in enumerate(rows) if row[column : column + 1] not in ([], [""])), default=0)
        values = _column(rows, column, size, place + 2, names[column], comma, where)
        label = (about.get("Y_Unit_Label", [])[k : k + 1] or [""])[0]
        step = _number(about.get("Delta_X"), k, np.nan, where)
        yield Channel(
            names[column],
            size,
            values.__getitem__,
            unit=unit_cell(label) or label or None,
            step=step if np.isfinite(step) and step > 0 else None,
            start=_number(about.get("X0"), k, 0.0, where),
        )


def _number(values: Sequence[str] | None, k: int, otherwise: float, where: str) -> float:
    """The k-th number of a header entry; `otherwise` if it is missing, negative or not finite."""
    text = (values or [])[k : k + 1]
    if not text or not text[0]:
        return otherwise
    try:
        number = float(text[0].replace(",", "."))
    except ValueError:
        raise FileFormatError(f"{where}: {text[0][:40]!r} in the header is not a number") from None
    return number if np.isfinite(number) and number >= 0 else otherwise


def _column(
    rows: Sequence[Sequence[str]], column: int, size: int, line: int, name: str, comma: bool, where: str
) -> Floats:
    values = np.full(size, np.nan)
    for i, row in enumerate(rows[:size]):
        cell = row[column].strip() if column < len(row) else ""
        try:
            values[i] = float(cell.replace(",", ".") if comma else cell) if cell else np.nan
        except ValueError:
            raise FileFormatError(f"{where}, line {line + i}, column {name!r}: {cell[:40]!r} is not a number") from None
    return values
