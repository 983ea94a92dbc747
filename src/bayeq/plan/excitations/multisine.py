"""Odd random-phase multisine (Pintelon and Schoukens 2012, section 5.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.plan.excitations.lines import lines_within, synthesised

__all__ = ["samples"]


def samples(n: int, fs: float, band: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float64]:
    """One period of a sum of the odd lines of the band, of equal amplitude and random phase."""
    lines = lines_within(n, fs, band, odd=True)
    return synthesised(n, lines, np.exp(2j * np.pi * rng.random(len(lines))))
