"""Column headers: ``clean_name`` makes names that terms can use; parsing and conversion of units.

A channel name appears in terms (``x**2*v``), so that it must be a Python identifier and must not hide a
function or a constant of the term language. The original header still finds its column.
"""

from __future__ import annotations

import difflib
import keyword
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping
from fractions import Fraction

from bayeq.errors import InputError

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
    r"(?:_?stamp)?(?:_(?:in_)?(?P<unit>s|sec|ms|msec|us|µs|μs|ns|min|h))?"
)
# Words for units of time, as names of time columns or as stated units.
_UNIT_NAMES: dict[str, str] = {
    **dict.fromkeys(("year", "years", "yr", "yrs", "jahr", "jahre", "annee", "année", "années"), "year"),
    **dict.fromkeys(("anno", "anni", "año", "años"), "year"),
    **dict.fromkeys(("day", "days", "tag", "tage", "jour", "jours", "dag", "giorno", "giorni", "día", "días"), "d"),
    **dict.fromkeys(("hour", "hours", "stunde", "stunden", "heure", "heures"), "h"),
    **dict.fromkeys(("minute", "minutes", "minuten"), "min"),
}
_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()\[\]]*)\))$", re.DOTALL)


def clean_name(header: str, position: int = 1) -> tuple[str, str | None]:
    """A name for terms from a column header (c1, c2 ... by `position` if empty), and the unit in brackets at its end.

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
    """The name of a channel, given its name or its header in the file, such as ``Displ. (m)``.

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

    >>> [is_time_name(name) for name in ("Zeit", "time_ms", "Elapsed_Time", "Timer", "index")]
    [True, True, True, False, False]
    """
    return _TIME_NAME.fullmatch(name.casefold()) is not None


def time_unit(name: str) -> str | None:
    """The unit at the end of a name of time, or of a name that is a unit of time itself; None without one.

    >>> time_unit("time_ms"), time_unit("Zeit"), time_unit("x_ms"), time_unit("Year"), time_unit("Tag")
    ('ms', None, None, 'year', 'd')
    >>> time_unit("Zeit_in_ms")
    'ms'
    """
    match = _TIME_NAME.fullmatch(name.casefold())
    return match["unit"] if match else _UNIT_NAMES.get(name.casefold())


def rate_and_length(rate: str, length: str, clock: str) -> tuple[str, str]:
    """Sampling rate and duration as text with units, given the unit of time `clock`.

    >>> rate_and_length("200", "4", "s"), rate_and_length("1", "81", "year")
    (('200 Hz', '4 s'), ('1 per year', '81 years'))
    >>> rate_and_length("1e-05", "864000", "s")
    ('1e-05 Hz', '864000 s (10 days)')
    """
    if clock == "s":
        days = float(length) / 86400.0
        return f"{rate} Hz", f"{length} s{f' ({days:.3g} days)' if days > 1.0 else ''}"
    return f"{rate} per {clock}", f"{length} {'years' if clock == 'year' else clock}"


def unit_of_clock(unit: str) -> str:
    """The usual spelling of a unit of time (year, d, h, min); other text is unchanged.

    >>> unit_of_clock("Jahre"), unit_of_clock("month")
    ('year', 'month')
    """
    return _UNIT_NAMES.get(unit.casefold(), unit)


# A unit: the exponent of each symbol, in the order in which they occur.
Unit = dict[str, Fraction]

SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
FACTOR = re.compile(r"\s*([*/·⋅ ]?)\s*(1(?![0-9])|[^\W\d_]+|[%°]+[^\W\d_]*)(?:(?:\^|\*\*)?(-?\d+))?")
# A number, and a unit that begins with a letter, if any: "10 g", not "1/s".
_GAIN = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*((?:[^\W\d_]|[%°]).*)?", re.DOTALL)
DIMENSIONLESS = ("", "1", "-")

#: Size of a symbol in metres, seconds and radians, and its dimension as powers of length and time.
SIZES: Mapping[str, tuple[float, int, int]] = {
    "m": (1.0, 1, 0), "mm": (1e-3, 1, 0), "cm": (1e-2, 1, 0), "um": (1e-6, 1, 0), "µm": (1e-6, 1, 0),
    "μm": (1e-6, 1, 0), "nm": (1e-9, 1, 0), "km": (1e3, 1, 0), "in": (0.0254, 1, 0), "ft": (0.3048, 1, 0),
    "rad": (1.0, 0, 0), "mrad": (1e-3, 0, 0), "deg": (math.pi / 180, 0, 0), "°": (math.pi / 180, 0, 0),
    "rev": (2 * math.pi, 0, 0), "rpm": (2 * math.pi / 60, 0, -1), "s": (1.0, 0, 1), "sec": (1.0, 0, 1),
    "ms": (1e-3, 0, 1), "min": (60.0, 0, 1), "h": (3600.0, 0, 1), "g": (9.80665, 1, -2), "G": (9.80665, 1, -2),
}  # fmt: skip

#: Ways to write revolutions per minute.
REVOLUTIONS = frozenset({"rpm", "1/min", "/min", "min-1", "min^-1", "min⁻¹", "U/min", "tr/min", "r/min"})

#: Units of force in newtons.
FORCES: Mapping[str, float] = {
    "N": 1.0, "kN": 1e3, "MN": 1e6, "mN": 1e-3, "uN": 1e-6, "daN": 10.0, "kgf": 9.80665, "kp": 9.80665,
    "lbf": 4.4482216152605, "lbs": 4.4482216152605,
}  # fmt: skip

# Known symbols of units: _WITH_PREFIXES with each of _PREFIXES, _OTHERS, `SIZES` and `FORCES`.
_WITH_PREFIXES = "m s N Nm Pa V A W J C T F Hz ohm Ohm Ω rad strain bar"
_PREFIXES = " n u µ μ m c d k M G"
_OTHERS = """
    kg mg t lb lbf lbs oz kip slug psi ksi mi yd mil mph kph kn gn g0 K degC degF °C °F L l ml gal S mol cd lx lm dB
    dBA % ppm ppb eps ue με µε count counts cts LSB bit bits FS px pixel pixels turn gon grad arcsec arcmin msec usec
    d day days year years
"""
_KNOWN = frozenset(
    {
        *(prefix + base for base in _WITH_PREFIXES.split() for prefix in _PREFIXES.split(" ")),
        *_OTHERS.split(),
        *SIZES,
        *FORCES,
    }
)

# Units at the end of a name without brackets: "disp_mm", "vel_mm_s", "acc_mps2", "force_N". A single letter may be a
# label ("motor_A"), so that N and g count only after a word for a force or an acceleration.
_ENDING = re.compile(
    r".*[^\W_].*?[_ ](?:(?P<above>[mcuµμ]?m|m?rad|deg|rev)(?:_?per_?|p|_)s(?:ec)?(?P<squared>_?2|\^2|²|s)?"
    r"|(?P<whole>[mcuµμ]m|k?Nm|kN|[kMh]Pa|m?bar|psi|[mk]V|mA|k?Hz|m?rad|deg|rpm|degC|kg|lbf))"
    r"|(?:f|force|kraft|load|last|thrust)[\w ,]*?[_ ](?P<force>(?-i:N))"
    r"|(?:a|acc\w*|beschl\w*)[\w ]*?[_ ](?P<gravity>(?-i:g))",
    re.IGNORECASE,
)
# "Weg/mm", "T/K". Symbols in _CHANNELS ("F/A" may be a ratio) are units only after a word of three letters or more.
# Headers that begin with a symbol in _NO_NAMES ("m/s", "N/A") name no channel.
_DIVIDED = re.compile(r"[^/]*[^\W\d_][^/]*/\s*(\S.*)")
_CHANNELS, _NO_NAMES = frozenset("AdhlLtTWC"), frozenset({"m", "mm", "cm", "um", "km", "rad", "deg", "n", "N"})


def unit_in_name(header: str) -> str | None:
    """The unit at the end of a header without brackets, as in DIN 1313 or by habit; None where it is ambiguous.

    >>> unit_in_name("disp_mm"), unit_in_name("vel_mm_s"), unit_in_name("Kraft/kN"), unit_in_name("acc_g")
    ('mm', 'mm/s', 'kN', 'g')
    >>> unit_in_name("Weg s1 / mm"), unit_in_name("Acc m/s^2"), unit_in_name("Force, N")
    ('mm', 'm/s^2', 'N')
    >>> unit_in_name("motor_A"), unit_in_name("F/A"), unit_in_name("u_in"), unit_in_name("m/s"), unit_in_name("x_m")
    (None, None, None, None, None)
    """
    text = header.strip()
    # "Acc m/s^2", but of "Weg s1/mm" and "Weg s1 / mm" the unit is what stands behind the slash
    if match := re.fullmatch(r".+ ((?!\w+1/)\S+/\S+)", text) or _DIVIDED.fullmatch(text):
        symbols = parse_unit(match[1])
        known = bool(symbols) and _KNOWN.issuperset(symbols) and text.split("/")[0] not in _NO_NAMES
        return match[1] if known and (match[1] not in _CHANNELS or text.index("/") > 2) else None
    match = _ENDING.fullmatch(text)
    if match is None or match["above"] is None:
        return match and (match["whole"] or match["force"] or match["gravity"])
    return f"{match['above']}/s" + ("^2" if match["squared"] else "")


def require_unit(text: str, where: str) -> None:
    """Check that a unit is made of known symbols; the InputError begins with `where`, and offers the nearest ones.

    >>> require_unit("m/s^2", "--units a=m/s^2")
    """
    for symbol in parse_unit(text):
        if symbol in _KNOWN:
            continue
        near = difflib.get_close_matches(symbol, sorted(_KNOWN), n=3, cutoff=0.5)
        offered = f"; did you mean {' or '.join(near)}?" if near else "; write it as mm, m/s^2, g, kN or deg/s, say"
        raise InputError(f"{where}: {symbol[:40]!r} is no unit that is known{offered}")


def gain_and_unit(text: str, own: str | None = None) -> tuple[float, str | None]:
    """Split ``10 g`` into gain (not 0) and unit; a number alone keeps the `own` unit, a unit alone has the gain 1.

    >>> gain_and_unit("10 g"), gain_and_unit("-2.5", "mm"), gain_and_unit("m/s^2"), gain_and_unit("1")
    ((10.0, 'g'), (-2.5, 'mm'), (1.0, 'm/s^2'), (1.0, '1'))
    """
    match = _GAIN.fullmatch(text) if isinstance(text, str) and text.strip() != "1" else None
    if match is None:
        return 1.0, text
    gain = float(match[1])
    if not (gain and math.isfinite(gain)):
        raise InputError(f"unit {text[:60]!r}: a gain is a number other than 0, in front of the unit: 10g")
    return gain, (match[2] or own)


def conversion(stated: str, wanted: str) -> float | None:
    """The factor that converts numbers in the unit `stated` to `wanted`; None if it is unknown.

    >>> conversion("mm", "m"), conversion("g", "m/s^2"), conversion("kN", "N"), conversion("m", "N")
    (0.001, 9.80665, 1000.0, None)
    """
    found = in_si(multiply_units(parse_unit(stated), parse_unit(wanted), -1))
    return None if found is None or found[1] else found[0]


def parse_unit(text: str) -> Unit:
    """Exponents of a unit's symbols; text that is not a product of powers counts as one symbol.

    >>> {symbol: int(power) for symbol, power in parse_unit("m/s²").items()}
    {'m': 1, 's': -2}
    """
    text = text.strip()
    if text[:1] == "(" and text.find(")") == len(text) - 1:  # as in "x [(1)]"
        text = text[1:-1].strip()
    if text in DIMENSIONLESS:
        return {}
    if text in REVOLUTIONS:
        return {"rpm": Fraction(1)}
    out: Unit = {}
    rest = re.sub(r"[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", lambda found: found.group().translate(SUPERSCRIPTS), text)
    while rest:
        found = FACTOR.match(rest)
        if found is None:
            return {f"({text})": Fraction(1)}
        operator, symbol, power = found.groups()
        if symbol != "1":
            multiply_units(out, {symbol: Fraction(int(power or 1)) * (-1 if operator == "/" else 1)})
        rest = rest[found.end() :].rstrip()
    return out


def multiply_units(unit: Unit, other: Unit, power: Fraction | int = 1) -> Unit:
    """`unit` times a power of the other, in place."""
    for symbol, exponent in other.items():
        total = unit.get(symbol, Fraction(0)) + power * exponent
        if total:
            unit[symbol] = total
        else:
            unit.pop(symbol, None)
    return unit


def derivative_ratio(below: str, above: str, order: int) -> float | None:
    """Gain of a channel in `above` over the `order`-th derivative of one in `below`; None if the units do not match.

    >>> derivative_ratio("mm", "m/s", 1), derivative_ratio("m", "m/s^2", 2), derivative_ratio("m", "N", 2)
    (0.001, 1.0, None)
    """
    ratio = multiply_units(multiply_units(parse_unit(below), {"s": Fraction(-order)}), parse_unit(above), -1)
    found = None if FORCES.keys() & ratio.keys() else in_si(ratio)
    return None if found is None or found[1] else found[0]


def stated_gain(units: Mapping[str, str], below: str, above: str, order: int) -> float | None:
    """The `derivative_ratio` of two channels; None if a unit is unknown."""
    return derivative_ratio(units[below], units[above], order) if below in units and above in units else None


def in_si(unit: Unit) -> tuple[float, Unit] | None:
    """Factor to SI units, and the unit in N, m and s (angles are dimensionless); None with an unknown symbol."""
    size, out = 1.0, Unit()
    for symbol, power in unit.items():
        if symbol in FORCES:
            size *= FORCES[symbol] ** float(power)
            multiply_units(out, {"N": power})
        elif symbol in SIZES:
            factor, length, time = SIZES[symbol]
            size *= factor ** float(power)
            multiply_units(out, {"m": length * power, "s": time * power})
        else:
            return None
    return size, out


def written_unit(unit: Unit) -> str:
    """A unit as text, ``m/s^2``; the numerator is ``1`` if it has no symbols."""
    above = "*".join(symbol + _power(e) for symbol, e in unit.items() if e > 0)
    return (above or "1") + "".join(f"/{symbol}{_power(-e)}" for symbol, e in unit.items() if e < 0)


def _power(exponent: Fraction) -> str:
    if exponent == 1:
        return ""
    return f"^{exponent}" if exponent.denominator == 1 else f"^({exponent})"
