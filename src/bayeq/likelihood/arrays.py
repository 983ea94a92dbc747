"""Large arrays without the price of fresh memory."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["arrays"]

Floats = NDArray[np.float64]

# From these many numbers on, 4 MB, numpy asks for large pages of memory; from a fourth on it is worth to have them.
LARGE = 2**19
SMALL = LARGE // 4


def arrays(*shapes: tuple[int, ...]) -> list[Floats]:
    """Arrays in one block of memory, not initialised.

    The first touch of a small page takes about as long as a filter needs for what stands in it.
    """
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    total = int(ends[-1])
    block = np.empty(max(total, LARGE) if total > SMALL else total)
    parts = np.split(block[:total], ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
