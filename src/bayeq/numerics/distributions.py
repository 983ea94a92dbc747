"""The normal distribution, Student's t, the regularised incomplete beta function, correlation and shape of samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats
from bayeq.numerics.settings import LIKELIHOOD

#: Half-width of a 95 % interval, in standard deviations.
Z95 = 1.959963984540054


class Shape(NamedTuple):
    """Skewness, kurtosis less 3, and the p value of both under a normal distribution."""

    skewness: float
    kurtosis: float
    normality: float


def shape_of(e: Floats, third: float = 1.0, fourth: float = 1.0) -> Shape:
    """Skewness, kurtosis and test of normality of numbers (n,) of mean 0, not all 0.

    `third` and `fourth` are the sums of the third and fourth powers of their autocorrelations over all lags (Lobato and
    Velasco 2004), 1 for independent numbers (Jarque and Bera 1980).
    """
    second = float(np.mean(e**2))
    skewness = float(np.mean(e**3)) / second**1.5
    kurtosis = float(np.mean(e**4)) / second**2 - 3.0
    statistic = len(e) * (skewness**2 / (6.0 * third) + kurtosis**2 / (24.0 * fourth))
    return Shape(skewness, kurtosis, math.exp(-0.5 * statistic))


def t_quantile(freedom: ArrayLike, z: float = Z95) -> Floats:
    """Quantile of Student's t at the probability of the normal quantile z, by Abramowitz and Stegun 26.7.5.

    Accurate within 1 % for 3 degrees of freedom or more; infinitely many give the normal quantile.

    Examples
    --------
    >>> t_quantile(np.array([3.0, 15.0, np.inf])).round(2)
    array([3.16, 2.13, 1.96])
    """
    share = 1.0 / np.asarray(freedom)
    first, second = (z**3 + z) / 4.0, (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0
    return np.asarray(z + share * (first + share * (second + share * third)))


# Lentz's method ends where a factor changes the fraction by a smaller share.
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


def correlation(first: Sequence[Floats], second: Sequence[Floats]) -> Floats:
    """Sum over pieces and rows of first(t + k) second(t), at k = 0, 1, ... below the length of the longest piece."""
    longest = max(len(piece) for piece in first)
    size = 1 << (2 * longest - 1).bit_length()
    out = np.zeros(longest)
    for a, b in zip(first, second, strict=True):
        out[: len(a)] += np.fft.irfft(np.fft.rfft(a, size) * np.fft.rfft(b, size).conj(), size)[: len(a)]
    return out


def memory_of(covariance: Floats, n: int) -> tuple[float, float]:
    """Autocorrelation at lag 1 and effective sample size of n residuals, from sums of products at lags 0, 1, ..."""
    rho = covariance / covariance[0] if covariance[0] > 0 else np.zeros(1)
    negative = np.flatnonzero(rho <= 0)
    last = int(negative[0]) if len(negative) else len(rho)
    return float(rho[1]) if len(rho) > 1 else 0.0, n / (1.0 + 2.0 * float(rho[1:last].sum()))


def excess_of(scores: Sequence[Floats]) -> tuple[float, float]:
    """tr(J)/r and its standard error: J is the covariance of the sum of scores, (n, r) each, stated as the identity."""
    r, longest = scores[0].shape[1], max(map(len, scores))
    excess, square, lag = sum(float(np.sum(one**2)) for one in scores) / r, 0.0, 0
    while lag < min(LIKELIHOOD.correlated_lags * excess, longest - 1):
        lag += 1
        products = [np.einsum("ti,ti->t", one[lag:], one[:-lag]) for one in scores if len(one) > lag]
        excess += 2.0 / r * sum(float(p.sum()) for p in products)
        square += (2.0 / r) ** 2 * sum(float(p @ p) for p in products)
    return excess, float(np.sqrt(square))
