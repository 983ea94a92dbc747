r"""Numbers and sums in LaTeX with standard deviations: ``-992.6(2.6)\,x``, ``\left(-992.6 \pm 2.6\right) x``."""

from __future__ import annotations

from collections.abc import Sequence
from math import floor, isfinite, log10
from typing import Literal

Uncertainty = Literal["none", "brackets", "plus-minus"]

# Numbers of other powers of ten are written with one.
PLAIN_POWERS = range(-3, 5)
MOST_PLACES = 12


def sum_in_latex(parts: Sequence[tuple[float, float, str]], uncertainty: Uncertainty) -> str:
    r"""A sum of numbers, with standard deviations, times terms in LaTeX.

    Examples
    --------
    >>> sum_in_latex([(-992.61, 2.64, "x"), (-2.0e-7, 3.1e-9, "v"), (1.5, 0.012, "")], "brackets")
    '-992.6(2.6)\\,x - 2.000(31) \\times 10^{-7}\\,v + 1.500(12)'
    >>> sum_in_latex([(-992.61, 2.64, "x")], "plus-minus")
    '\\left(-992.6 \\pm 2.6\\right)\\,x'
    """
    out = ""
    for value, sd, term in parts:
        if uncertainty == "plus-minus":
            sign, number = "+", f"{_with_sd(value, sd, uncertainty)}"
        else:
            sign, number = "-" if value < 0 else "+", _with_sd(abs(value), sd, uncertainty)
        body = f"{number}\\,{term}" if term else number
        out += f" {sign} {body}" if out else f"-{body}" if sign == "-" else body
    return out or "0"


def _with_sd(value: float, sd: float, uncertainty: Uncertainty) -> str:
    """Two digits of the standard deviation, and the number to the same place."""
    if not (sd > 0 and isfinite(sd)):
        return f"{value:.12g}"
    power = floor(log10(max(abs(value), sd)))
    places = 1 - floor(log10(sd))
    shift = 0 if power in PLAIN_POWERS and places >= 0 else power
    places = min(max(places + shift, 0), MOST_PLACES)
    number, error = f"{value / 10.0**shift:.{places}f}", f"{sd / 10.0**shift:.{places}f}"
    factor = f" \\times 10^{{{shift}}}" if shift else ""
    if uncertainty == "plus-minus":
        return f"\\left({number} \\pm {error}\\right){factor}"
    # digits of the last places, or with their point where it stands among them
    digits = error if float(error) >= 1 else error.replace(".", "").lstrip("0")
    return f"{number}({digits or 0}){factor}"
