"""``clean_name``: column headers as people write them, to channel names that terms can use.

A channel name appears in terms (``x**2*v``), so that it must be a Python identifier and must not hide a
function or a constant of the term language. The original header still finds its column.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Iterable

#: Names that a channel cannot have: functions and constants of terms.
RESERVED: frozenset[str] = frozenset(
    {
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log", "log2", "log10", "sqrt", "cbrt"),
        *("abs", "sign", "min", "max", "floor", "ceil", "pi"),
    }
)
# A header made of these alone would read as a row of missing numbers.
_NUMBER_WORDS = frozenset({"nan", "inf", "infinity", "na", "null", "none"})
# Time in the usual languages: English, German, French, Spanish, Portuguese and Italian, Danish, Norwegian and Swedish,
# Dutch, Czech, Polish, Finnish, Hungarian, Turkish, Russian, Chinese, Japanese, Korean.
_TIME_WORDS = (
    *("t", "time", "timestamp", "datetime", "zeit", "zeitstempel", "temps", "tiempo", "tempo", "tid", "tijd", "čas"),
    *("cas", "czas", "aika", "idő", "zaman", "время", "时间", "時間", "시간"),
)
_TIME_NAME = re.compile(
    rf"(?:(?:elapsed|relative|rel|absolute|abs|total|test|run|running|sample|date)_)?(?:{'|'.join(_TIME_WORDS)})"
    r"(?:_?stamp)?(?:_(?P<unit>s|sec|ms|msec|us|µs|μs|ns|min|h))?"
)
_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()\[\]]*)\))$", re.DOTALL)


def clean_name(header: str, position: int = 1) -> tuple[str, str | None]:
    """Turn a column header into a channel name and the unit that stood in brackets at its end, or None.

    The name is a valid identifier, neither a keyword nor a function of the term language. The column's place, counted
    from 1, names one without a header.

    Examples
    --------
    >>> clean_name("x [m]"), clean_name("acc-1"), clean_name("Time (s)")
    (('x', 'm'), ('acc_1', None), ('Time', 's'))
    >>> clean_name("sin"), clean_name("2nd mass"), clean_name("", position=3)
    (('sin_', None), ('_2nd_mass', None), ('c3', None))
    """
    text = header.strip().removeprefix("\ufeff")
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1].strip()
    unit: str | None = None
    if match := _UNIT.match(text):
        text = match["name"]
        unit = " ".join((match["square"] or match["round"] or "").split())
        unit = "".join(c for c in unit if c.isprintable()) or None
        if unit == "t" and match["round"]:  # "x(t)" says that x depends on time, not that its unit is t
            unit = None
    return _identifier(text, position), unit


def channel_name(text: str) -> str:
    """A channel by its name or by its header in the file, such as ``Displ. (m)``.

    Examples
    --------
    >>> channel_name("x"), channel_name("Displ. (m)"), channel_name("")
    ('x', 'Displ', '')
    """
    return text if not text or text.isidentifier() else clean_name(text)[0]


def _identifier(text: str, position: int) -> str:
    name = unicodedata.normalize("NFKC", text.strip())
    if not name.isidentifier():
        name = "".join(c if f"a{c}".isidentifier() else " " for c in name)
        name = unicodedata.normalize("NFKC", "_".join(name.split()))
        if not name:
            return f"c{position}"
        if not name.isidentifier():
            name = "_" + name
    if keyword.iskeyword(name) or name in RESERVED or name.casefold() in _NUMBER_WORDS:
        name += "_"
    return name


def clean_names(headers: Iterable[str]) -> tuple[list[str], list[str | None]]:
    """Clean several headers; the second of two equal names gets ``_2``, the third ``_3``.

    Examples
    --------
    >>> clean_names(["t [s]", "w1", "w1", ""])
    (['t', 'w1', 'w1_2', 'c4'], ['s', None, None, None])
    """
    names: list[str] = []
    units: list[str | None] = []
    used: set[str] = set()
    for position, header in enumerate(headers, 1):
        name, unit = clean_name(header, position)
        candidate, count = name, 1
        while candidate in used:
            count += 1
            candidate = f"{name}_{count}"
        used.add(candidate)
        names.append(candidate)
        units.append(unit)
    return names, units


def is_time_name(name: str) -> bool:
    """Whether a channel name says that the column is time: ``t`` or ``time`` in the usual languages, in any case.

    Examples
    --------
    >>> [is_time_name(name) for name in ("Zeit", "time_ms", "Elapsed_Time", "Timer", "index")]
    [True, True, True, False, False]
    """
    return _TIME_NAME.fullmatch(name.casefold()) is not None


def time_unit(name: str) -> str | None:
    """The unit that a time's name ends in.

    Examples
    --------
    >>> time_unit("time_ms"), time_unit("Zeit"), time_unit("x_ms")
    ('ms', None, None)
    """
    match = _TIME_NAME.fullmatch(name.casefold())
    return match["unit"] if match else None
