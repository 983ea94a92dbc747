"""A record as HTML, for notebooks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayeq.markup import join, paragraph, table
from bayeq.records.truth import FloatArray

__all__ = ["as_html"]

HEADER = ("channel", "unit", "min", "max", "mean", "sd", "missing")
MOST_CHANNELS = 50


def as_html(title: str, channels: Mapping[str, FloatArray], units: Mapping[str, str]) -> str:
    """Title, and a row of numbers for each channel."""
    listed = list(channels.items())[:MOST_CHANNELS]
    rows = [(name, units.get(name, ""), *_numbers(values)) for name, values in listed]
    rest = len(channels) - len(listed)
    more = paragraph(f"and {rest} more channels") if rest else ""
    return join(paragraph(title, strong=True), table(HEADER, rows, left=(0, 1)), more)


def _numbers(values: FloatArray) -> tuple[str, ...]:
    known = values[np.isfinite(values)]
    missing = str(len(values) - len(known) or "")
    if not len(known):
        return "", "", "", "", missing
    with np.errstate(over="ignore"):  # of squares of huge numbers
        numbers = known.min(), known.max(), known.mean(), known.std()
    return (*(f"{value:.4g}" for value in numbers), missing)
