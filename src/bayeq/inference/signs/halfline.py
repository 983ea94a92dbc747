"""The standard normal distribution on a half line, stable however far out in a tail, for kernels."""

from __future__ import annotations

import math

import numpy as np

from bayeq.kernels import kernel

__all__ = ["draw_beyond", "log_ndtr"]

# Below this argument erfc comes near to underflow; the asymptotic series is then exact to rounding.
FAR = -30.0

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)


@kernel
def log_ndtr(x: float) -> float:
    """Logarithm of the normal distribution function."""
    if x > 0.0:
        return math.log1p(-0.5 * math.erfc(x / math.sqrt(2.0)))
    if x > FAR:
        return math.log(0.5 * math.erfc(-x / math.sqrt(2.0)))
    u = 1.0 / (x * x)
    series = u * (-1.0 + u * (3.0 + u * (-15.0 + u * 105.0)))
    return -0.5 * x * x - math.log(-x) - HALF_LOG_2PI + math.log1p(series)


@kernel
def draw_beyond(a: float, rng: np.random.Generator) -> float:
    """x - a of a standard normal x given x > a.

    By rejection: of normals where at least half of them are beyond a, of shifted exponentials of the best rate
    otherwise (Robert 1995), of which at least three in four are kept. The excess x - a is what is drawn there, so that
    it loses no digits.
    """
    if a <= 0.0:
        while True:
            x = rng.standard_normal()
            if x > a:
                return x - a
    rate = 0.5 * (a + math.sqrt(a * a + 4.0))
    while True:
        excess = rng.standard_exponential() / rate
        distance = a + excess - rate
        if rng.standard_exponential() > 0.5 * distance * distance:
            return excess
