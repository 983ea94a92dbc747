"""Numbers, terms and the constants inside them as they are written in answers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from bayeq.dictionary.ranges import ConstantEstimate

# A value is at the end of its range within this share of it.
AT_END = 0.01


def plain_sd(one: ConstantEstimate) -> float:
    """Standard deviation of a constant itself, not of its logarithm; 0 where it is in no term."""
    return (one.sd or 0.0) * (abs(one.value) if one.logarithmic else 1.0)


def at_end(one: ConstantEstimate, unit: str = "") -> Iterator[str]:
    """What to say of a constant whose value, or interval, ends with its range; nothing of others."""
    low, value, high = (math.log(end) if one.logarithmic else end for end in (one.low, one.value, one.high))
    place = (value - low) / (high - low)
    shown = f"({one.low:.3g} .. {one.high:.3g}{f' {unit}' if unit not in ('', '1') else ''})"
    cure = f"give a wider one, {{{one.name}: low..high}}, or the term without it"
    if min(place, 1.0 - place) < AT_END:
        yield f"{one.name} is at the {'lower' if place < 0.5 else 'upper'} end of its range {shown}: {cure}"
        return
    ends = [end for end, reached in (("lower", one.ci95[0] <= one.low), ("upper", one.ci95[1] >= one.high)) if reached]
    if ends:
        yield f"the interval of {one.name} reaches the {' and the '.join(ends)} end of its range {shown}: {cure}"


def row_of(one: ConstantEstimate, unit: str | None) -> dict[str, Any]:
    """The row of a constant in an equation's table."""
    row: dict[str, Any] = {"term": f"{{{one.name}}}", "included": True, "shown": True, "why": "", "effective": False}
    for prefix in ("", "shown_"):
        row |= {f"{prefix}coef": one.value, f"{prefix}sd": plain_sd(one)}
        row |= {f"{prefix}ci_low": one.ci95[0], f"{prefix}ci_high": one.ci95[1]}
    return {**row, "unit": unit}


def factor_of(term: str) -> str:
    """A term as the factor of a product: in parentheses if it is a sum or a quotient."""
    depth = 0
    for k, character in enumerate(term):
        depth += (character in "([") - (character in ")]")
        exponent = k > 0 and term[k - 1] in "eE" and k > 1 and term[k - 2].isdigit()
        if depth == 0 and character in "+-/" and not exponent:
            return f"({term})"
    return term


def round_to(value: float, sd: float) -> str:
    """A number with digits down to a tenth of its standard deviation, between 3 and 12 significant ones."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = 12 if sd <= 0 else math.floor(math.log10(abs(value))) - math.floor(math.log10(sd)) + 2
    return f"{value:.{min(max(digits, 3), 12)}g}"


def with_interval(value: float, sd: float, interval: Sequence[float]) -> tuple[str, str, str]:
    """A number, its standard deviation and its interval."""
    low, high = (round_to(end, sd) for end in interval)
    return round_to(value, sd), f"{sd:.2g}", f"{low} .. {high}"


def odds_text(log_odds: float) -> str:
    """Odds from their logarithm: against, or for.

    Examples
    --------
    >>> odds_text(-2.0), odds_text(3.0), odds_text(-280.0)
    ('1:7.4', '20:1', '1:4e+121')
    """
    ratio = math.exp(min(abs(log_odds), 700.0))
    number = f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}" if ratio < 1e6 else f"{ratio:.0e}"
    return f"1:{number}" if log_odds <= 0 else f"{number}:1"


def moment(time: float, discrete: bool) -> str:
    """A time of a record, in samples where the equations are a map."""
    return f"sample {time:.6g}" if discrete else f"{time:.6g} s"


def finite(value: Any) -> Any:
    """A value as JSON can hold it: None for a number that is infinite or not known."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
