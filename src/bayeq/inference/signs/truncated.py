"""A Student t posterior of coefficients of which some have known signs: its moments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from bayeq.inference.signs.orthant import Orthants

__all__ = ["NEGLIGIBLE", "carried", "truncated"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# A sign that is wrong with less than this share of the probability of all signs right takes no part in the orthant:
# far below what the quadrature resolves.
NEGLIGIBLE = 1e-9


def truncated(m: Floats, V: Floats, signs: Ints, s: float, h: float) -> tuple[Floats, Floats]:
    """Mean (r,) and covariance (r, r) of coefficients with known signs.

    Parameters
    ----------
    m, V : (r,), (r, r) arrays
        theta | sigma^2 ~ N(m, sigma^2 V) if no sign is known.
    signs : (r,) int array
        0 for unknown.
    s, h : float
        sigma^2 ~ inverse-Gamma(h, s/2).

    Examples
    --------
    A coefficient that may be nothing, of known variance: a half normal distribution, sqrt(2/pi) and 1 - 2/pi.

    >>> mean, covariance = truncated(np.zeros(1), np.eye(1), np.array([-1]), 2e9, 1e9)
    >>> mean.round(3), covariance.round(3)
    (array([-0.798]), array([[0.363]]))
    """
    unit = np.sqrt(np.diagonal(V))
    m, V = m / unit, V / np.outer(unit, unit)
    doubtful = np.flatnonzero((signs != 0) & (stdtr(2.0 * h, -signs * m * np.sqrt(2.0 * h / s)) > NEGLIGIBLE))
    mean, total = m, s / (2.0 * h) * V
    if len(doubtful):
        sign = signs[doubtful].astype(np.float64)
        turned = np.outer(sign, sign)
        among = V[np.ix_(doubtful, doubtful)] * turned
        first, second, variance = Orthants((sign * m[doubtful])[None], among[None], np.array([s]), h).moments()
        mean, total = carried(m, V, doubtful, sign * first[0], turned * second[0], float(variance[0]))
    return unit * mean, total * np.outer(unit, unit)


def carried(
    m: Floats, V: Floats, among: NDArray[np.intp], mean: Floats, covariance: Floats, variance: float
) -> tuple[Floats, Floats]:
    """Moments of all r coefficients from those of the truncated ones.

    Given these and sigma^2 the others are Gaussian as ever, with means linear in these.

    Parameters
    ----------
    m, V : (r,), (r, r) arrays
        theta | sigma^2 ~ N(m, sigma^2 V) without truncation.
    among : (k,) int array
        The truncated ones.
    mean, covariance : (k,), (k, k) arrays
        Of these.
    variance : float
        Mean of sigma^2.
    """
    slope = V[:, among] @ np.linalg.pinv(V[np.ix_(among, among)], hermitian=True)
    slope[among] = np.eye(len(among))
    rest = V - slope @ V[among]
    rest[among], rest[:, among] = 0.0, 0.0
    total = variance * rest + slope @ covariance @ slope.T
    return m + slope @ (mean - m[among]), 0.5 * (total + total.T)
