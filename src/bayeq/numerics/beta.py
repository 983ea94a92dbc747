"""The regularised incomplete beta function, without ``scipy.special``, whose import takes 40 ms of a run of 2.7 s."""

from __future__ import annotations

import math

# Lentz's method ends where a factor changes the fraction by less.
CLOSE = 1e-14
MOST_STEPS = 10_000


def incomplete_beta(a: float, b: float, x: float) -> float:
    """I_x(a, b): the probability that a beta variable with parameters `a` and `b` is below `x`.

    By the continued fraction of DLMF 8.17.22, evaluated by Lentz's method.

    Examples
    --------
    >>> round(incomplete_beta(2.0, 3.0, 0.4), 6)
    0.5248
    """
    if x <= 0.0 or x >= 1.0:
        return 0.0 if x <= 0.0 else 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - incomplete_beta(b, a, 1.0 - x)
    log_front = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0))
    fraction = d
    for m in range(1, MOST_STEPS):
        even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        for factor in (even, odd):
            d = 1.0 / (1.0 + factor * d)
            c = 1.0 + factor / c
            fraction *= c * d
        if abs(c * d - 1.0) < CLOSE:
            break
    return math.exp(log_front) * fraction / a
