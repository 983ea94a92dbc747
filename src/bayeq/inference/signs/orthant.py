"""Coefficients whose signs are known: the multivariate Student t posterior on an orthant.

    theta | sigma^2 ~ N(m, sigma^2 V),  sigma^2 ~ inverse-Gamma(h, s/2)   =>   theta ~ t with 2h degrees of freedom

P(theta > 0) and the moments given theta > 0 are integrated by quasi-Monte Carlo over the separated variables of Genz
(1992) and Genz and Bretz (2002), with 1/sigma^2 as one of the variables. The points are fixed: the same numbers in, the
same numbers out. Logarithms throughout, so that orthants far out in the tails do not underflow.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, log_ndtr, ndtri_exp, stdtr

from bayeq.arrays import Floats, Ints

# Points of the quadrature: PIPs are off by less than 1e-4, standard deviations by some 1e-4 of themselves.
POINTS = 256

# Sweeps of the projection onto the orthant. It need not be exact: it only says where sigma^2 is to be sampled.
SWEEPS = 10

# Least share of its variance that a coefficient keeps given the others: below it is rounding.
LEAST_SHARE = 1e-12

# A sign that is wrong with less than this share of the probability of all signs right takes no part in the orthant:
# far below what the quadrature resolves.
NEGLIGIBLE = 1e-9


@lru_cache(maxsize=64)
def _uniforms(count: int) -> Floats:
    """ln u of `count` variables at the quadrature points, (count, POINTS): Richtmyer's lattice, folded."""
    primes = [k for k in range(2, 20 * count + 20) if all(k % d for d in range(2, math.isqrt(k) + 1))][:count]
    turns = np.outer(np.sqrt(np.array(primes, dtype=np.float64)), np.arange(POINTS) + 0.5) % 1.0
    # the tent map makes the integrand periodic, for which a lattice converges faster
    folded: Floats = np.log(np.maximum(1.0 - np.abs(2.0 * turns - 1.0), 1e-300))
    return folded


@lru_cache(maxsize=64)
def _gammas(h: float) -> Floats:
    """Equally probable values of a Gamma(h, 1) variable, (POINTS,)."""
    return np.maximum(gammaincinv(h, (np.arange(POINTS) + 0.5) / POINTS), 1e-300)


def _cholesky(V: Floats) -> Floats:
    """Lower Cholesky factors of (B, k, k) matrices; rounding may have made them singular or indefinite."""
    L = np.zeros_like(V)
    for j in range(V.shape[1]):
        rest = V[:, j, j] - np.sum(L[:, j, :j] ** 2, axis=1)
        L[:, j, j] = np.sqrt(np.maximum(rest, LEAST_SHARE * V[:, j, j]))
        below = V[:, j + 1 :, j] - np.einsum("bil,bl->bi", L[:, j + 1 :, :j], L[:, j, :j])
        L[:, j + 1 :, j] = below / L[:, j, j, None]
    return L


def _distance(m: Floats, V: Floats) -> Floats:
    """Squared Mahalanobis distance of m (B, k) from the orthant, about: projected Gauss-Seidel on its dual."""
    dual, theta = np.zeros_like(m), m.copy()
    for _ in range(SWEEPS if bool((m < 0.0).any()) else 0):
        for j in range(m.shape[1]):
            step = np.maximum(-theta[:, j] / V[:, j, j], -dual[:, j])
            dual[:, j] += step
            theta += V[:, :, j] * step[:, None]
    return np.asarray(np.maximum(np.sum(dual * (theta - m), axis=1), 0.0))


class Orthants:
    """The orthants theta > 0 of B problems of k coefficients each: points with their weights.

    theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2), with m (B, k), V (B, k, k), s (B,), and the same
    h for all. `log_probability` (B,) is ln P(theta > 0).
    """

    def __init__(self, m: Floats, V: Floats, s: Floats, h: float) -> None:
        k = m.shape[1]
        # the coefficient least likely to have its sign comes first: the others then vary less
        spread = np.sqrt(np.diagonal(V, axis1=1, axis2=2))
        self.order = np.argsort(m / spread, axis=1, kind="stable")
        self.m = np.take_along_axis(m, self.order, axis=1)
        V = np.take_along_axis(V, self.order[:, :, None], axis=1)
        V = np.take_along_axis(V, self.order[:, None, :], axis=2)
        self.L = L = _cholesky(V)
        # 1/sigma^2 is sampled where the orthant puts it; the ratio of the densities goes into the weights
        q, gammas, uniforms = _distance(self.m, V), _gammas(h), _uniforms(k)
        root = np.sqrt(2.0 * gammas / (s + q)[:, None])
        self.sigma = 1.0 / root
        log_weight = h * np.log(s / (s + q))[:, None] + gammas * (q / (s + q))[:, None]
        self.e = np.empty((k, *root.shape))
        for j in range(k):
            bound = -self.m[:, j, None] * root
            for a in range(j):
                bound -= L[:, j, a, None] * self.e[a]
            bound /= L[:, j, j, None]
            inside = log_ndtr(-bound)
            log_weight = log_weight + inside
            if j < k - 1:
                self.e[j] = -ndtri_exp(uniforms[j] + inside)
        top = log_weight.max(axis=1, keepdims=True)
        weight = np.exp(log_weight - top)
        total = weight.sum(axis=1, keepdims=True)
        self.log_probability = np.minimum((top + np.log(total))[:, 0] - math.log(POINTS), 0.0)
        self.weight, self.bound, self.inside = weight / total, bound, inside

    def moments(self) -> tuple[Floats, Floats, Floats]:
        """Mean (B, k) and covariance (B, k, k) of theta, and mean of sigma^2 (B,), in the orthant."""
        w = self.weight
        # the last variable is a normal beyond its bound, whose moments are known
        hazard = np.exp(-0.5 * self.bound**2 - 0.5 * math.log(2.0 * math.pi) - self.inside)
        self.e[-1] = hazard
        spread = np.maximum(1.0 + self.bound * hazard - hazard**2, 0.0)
        d = self.sigma * self.e
        first = np.einsum("bn,kbn->bk", w, d)
        second = np.einsum("bn,kbn,lbn->bkl", w, d, d, optimize=True)
        variance = np.sum(w * self.sigma**2, axis=1)
        second[:, -1, -1] += np.sum(w * self.sigma**2 * spread, axis=1)
        mean = self.m + np.einsum("bij,bj->bi", self.L, first)
        centred = second - first[:, :, None] * first[:, None, :]
        covariance = self.L @ centred @ self.L.transpose(0, 2, 1)
        back = np.argsort(self.order, axis=1)
        mean = np.take_along_axis(mean, back, axis=1)
        covariance = np.take_along_axis(covariance, back[:, :, None], axis=1)
        return mean, np.take_along_axis(covariance, back[:, None, :], axis=2), variance


def truncated(m: Floats, V: Floats, signs: Ints, s: float, h: float) -> tuple[Floats, Floats]:
    """Mean (r,) and covariance (r, r) of coefficients with known signs (r,), 0 for unknown.

    If no sign is known theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2).

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
    """Moments of all r coefficients from those of the k truncated ones, at the places `among`.

    Without truncation theta | sigma^2 ~ N(m, sigma^2 V). Given the truncated ones, of mean (k,) and covariance (k, k),
    and sigma^2, of mean `variance`, the others are Gaussian as ever, with means linear in these.
    """
    slope = V[:, among] @ np.linalg.pinv(V[np.ix_(among, among)], hermitian=True)
    slope[among] = np.eye(len(among))
    rest = V - slope @ V[among]
    rest[among], rest[:, among] = 0.0, 0.0
    total = variance * rest + slope @ covariance @ slope.T
    return m + slope @ (mean - m[among]), 0.5 * (total + total.T)
