"""Units as text: products of powers of symbols, and the size of those that motion is measured in."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from fractions import Fraction

__all__ = ["Unit", "derivative_ratio", "multiply_units", "parse_unit"]

# Exponents of symbols, in the order in which they occur.
Unit = dict[str, Fraction]

SUPERSCRIPTS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
FACTOR = re.compile(r"\s*([*/·⋅ ]?)\s*(1(?![0-9])|[^\W\d_]+|[%°]+[^\W\d_]*)(?:(?:\^|\*\*)?(-?\d+))?")
DIMENSIONLESS = ("", "1", "-")

#: Size of a symbol in metres, seconds and radians, and its dimension as powers of length and time.
SIZES: Mapping[str, tuple[float, int, int]] = {
    "m": (1.0, 1, 0), "mm": (1e-3, 1, 0), "cm": (1e-2, 1, 0), "um": (1e-6, 1, 0), "µm": (1e-6, 1, 0),
    "μm": (1e-6, 1, 0), "nm": (1e-9, 1, 0), "km": (1e3, 1, 0), "in": (0.0254, 1, 0), "ft": (0.3048, 1, 0),
    "rad": (1.0, 0, 0), "mrad": (1e-3, 0, 0), "deg": (math.pi / 180, 0, 0), "°": (math.pi / 180, 0, 0),
    "rev": (2 * math.pi, 0, 0), "rpm": (2 * math.pi / 60, 0, -1), "s": (1.0, 0, 1), "sec": (1.0, 0, 1),
    "ms": (1e-3, 0, 1), "min": (60.0, 0, 1), "h": (3600.0, 0, 1), "g": (9.80665, 1, -2),
}  # fmt: skip


def parse_unit(text: str) -> Unit:
    """Exponents of a unit's symbols; text that is no product of powers is a symbol itself.

    Examples
    --------
    >>> {symbol: int(power) for symbol, power in parse_unit("m/s²").items()}
    {'m': 1, 's': -2}
    """
    text = text.strip()
    if text in DIMENSIONLESS:
        return {}
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
    """How large a channel is against the derivative by seconds of another, for their units alone.

    Parameters
    ----------
    below, above : str
        Units of the other channel and of the one that is its derivative.
    order : int
        Of the derivative.

    Returns
    -------
    float or None
        None where the units are not known, or not those of a motion and its derivative.

    Examples
    --------
    >>> derivative_ratio("mm", "m/s", 1), derivative_ratio("m", "m/s^2", 2), derivative_ratio("m", "N", 2)
    (0.001, 1.0, None)
    """
    ratio = multiply_units(multiply_units(parse_unit(below), {"s": Fraction(-order)}), parse_unit(above), -1)
    size, length, time = 1.0, Fraction(0), Fraction(0)
    for symbol, power in ratio.items():
        if symbol not in SIZES:
            return None
        factor, of_length, of_time = SIZES[symbol]
        size *= factor ** float(power)
        length += of_length * power
        time += of_time * power
    return size if length == 0 and time == 0 else None
