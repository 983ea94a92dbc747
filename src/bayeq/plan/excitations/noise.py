"""Gaussian noise of flat spectrum within a band."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.plan.excitations.lines import lines_within, synthesised

__all__ = ["samples"]


def samples(n: int, fs: float, band: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float64]:
    """One period of noise: all lines of the band, with independent complex normal amplitudes."""
    lines = lines_within(n, fs, band)
    return synthesised(n, lines, rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines)))
