"""Time stamps as text: ISO 8601, days first with points, and clocks."""

from __future__ import annotations

import re
from datetime import datetime, timedelta

__all__ = ["Stamp", "parse_stamp"]

#: Whole seconds (since year 1 or midnight) and the rest: their difference keeps every digit.
Stamp = tuple[int, float]

_DAY = r"(?:(?P<year>\d{4})[-/](?P<month>\d\d?)[-/](?P<day>\d\d?)|(?P<day2>\d\d?)\.(?P<month2>\d\d?)\.(?P<year2>\d{4}))"
_CLOCK = r"(?P<hour>\d\d?):(?P<minute>\d\d)(?::(?P<second>\d\d)(?:[.,](?P<rest>\d+))?)?"
_ZONE = r"(?:Z|(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)?)?"
_STAMP = re.compile(rf"(?:{_DAY}(?:[T ]\s*{_CLOCK}\s*{_ZONE})?)|(?:{_CLOCK.replace('?P<', '?P<c_')})")
_FIRST = datetime(1, 1, 1)


def parse_stamp(text: str) -> Stamp | None:
    """A date, a date with a clock, or a clock; None of other text.

    Parameters
    ----------
    text : str
        ``2024-03-01T12:00:00.25Z``, ``01.03.2024 12:00:00,25``, ``12:00:00.25``.

    Examples
    --------
    >>> parse_stamp("2024-03-01 12:00:01.5"), parse_stamp("0:00:01,25"), parse_stamp("1.5")
    ((63844891201, 0.5), (1, 0.25), None)
    """
    match = _STAMP.fullmatch(text.strip().strip("\"'"))
    if match is None:
        return None
    found = match.groupdict()
    day = "2" if found["day2"] else ""
    clock = "" if found["hour"] else "c_"
    seconds = 0
    try:
        if found[f"year{day}"]:
            date = datetime(int(found[f"year{day}"]), int(found[f"month{day}"]), int(found[f"day{day}"]))
            seconds = (date - _FIRST) // timedelta(seconds=1)
    except ValueError:  # the 31st of February
        return None
    hour, minute, second = (int(found[f"{clock}{part}"] or 0) for part in ("hour", "minute", "second"))
    if minute > 59 or second > 60:
        return None
    seconds += 3600 * hour + 60 * minute + second
    if found["sign"]:
        zone = 3600 * int(found["zh"]) + 60 * int(found["zm"] or 0)
        seconds -= zone if found["sign"] == "+" else -zone
    rest = found[f"{clock}rest"]
    return seconds, float(f"0.{rest}") if rest else 0.0
