"""Coefficients whose signs or bounds are known: the multivariate Student t posterior on an orthant, or in a box.

    theta | sigma^2 ~ N(m, sigma^2 V),  sigma^2 ~ inverse-Gamma(h, s/2)   =>   theta ~ t with 2h degrees of freedom

P(0 < theta < width) and the moments given that are integrated by quasi-Monte Carlo over the separated variables of Genz
(1992) and Genz and Bretz (2002), with 1/sigma^2 as one of the variables. The points are fixed: the same numbers in, the
same numbers out. Logarithms throughout, so that orthants far out in the tails do not underflow.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, log_ndtr, ndtri_exp, stdtr

from bayeq.arrays import Floats

# Points of the quadrature: PIPs are off by less than 1e-4, standard deviations by some 1e-4 of themselves.
POINTS = 256

# Sweeps of the projection onto the orthant. It need not be exact: it only says where sigma^2 is to be sampled.
SWEEPS = 10

# Least share of its variance that a coefficient keeps given the others: below it is rounding.
LEAST_SHARE = 1e-12

# Between numbers that are nearer to each other a normal variable is as good as uniform.
NARROW = 1e-3

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


def _between(low: Floats, high: Floats, log_uniform: Floats) -> tuple[Floats, Floats]:
    """ln P(low < e < high) of a standard normal variable, and values of it between them."""
    turned = -low > high
    a, b = np.where(turned, -high, low), np.where(turned, -low, high)
    whole, beyond = log_ndtr(-a), log_ndtr(-b)
    inside = whole + np.log(np.maximum(-np.expm1(beyond - whole), 1e-300))
    drawn = np.clip(-ndtri_exp(np.logaddexp(beyond, log_uniform + inside)), a, b)
    return inside, np.where(turned, -drawn, drawn)


def _moments_between(low: Floats, high: Floats, inside: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of a standard normal variable between two numbers, ln of whose probability is `inside`."""
    with np.errstate(invalid="ignore"):  # of no end
        a, b = (np.exp(-0.5 * end**2 - 0.5 * math.log(2.0 * math.pi) - inside) for end in (low, high))
        variance = 1.0 + low * a - np.where(np.isfinite(high), high * b, 0.0) - (a - b) ** 2
        narrow, middle = high - low < NARROW, 0.5 * (low + high)
    mean = np.clip(np.where(narrow, middle, a - b), low, high)
    return mean, np.where(narrow, (high - low) ** 2 / 12.0, np.maximum(variance, 0.0))


def faced(mean: Floats, limits: Floats) -> tuple[Floats, Floats, Floats]:
    """Turns, ends and widths by which limits (..., 2) are 0 <= turn (theta - end) <= width, from the nearer end on."""
    low, high = limits[..., 0], limits[..., 1]
    turn = np.where(mean > 0.5 * low + 0.5 * high, -1.0, 1.0)
    return turn, np.where(turn < 0.0, high, low), high - low


class Orthants:
    """The orthants theta > 0 of B problems of k coefficients each, or boxes: points with their weights.

    theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2), with m (B, k), V (B, k, k), s (B,), and the same
    h for all. `log_probability` (B,) is ln P(0 < theta < width), with `width` (B, k) infinite where it is None.
    """

    def __init__(self, m: Floats, V: Floats, s: Floats, h: float, width: Floats | None = None) -> None:
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
            if width is not None:
                far = np.take_along_axis(width, self.order, axis=1)[:, j, None] * root / L[:, j, j, None]
                self.end = bound + far
                inside, self.e[j] = _between(bound, self.end, uniforms[j])
                log_weight = log_weight + inside
                continue
            inside = log_ndtr(-bound)
            log_weight = log_weight + inside
            if j < k - 1:
                self.e[j] = -ndtri_exp(uniforms[j] + inside)
        top = log_weight.max(axis=1, keepdims=True)
        weight = np.exp(log_weight - top)
        total = weight.sum(axis=1, keepdims=True)
        self.log_probability = np.minimum((top + np.log(total))[:, 0] - math.log(POINTS), 0.0)
        self.weight, self.bound, self.inside, self.boxes = weight / total, bound, inside, width is not None

    def moments(self) -> tuple[Floats, Floats, Floats]:
        """Mean (B, k) and covariance (B, k, k) of theta, and mean of sigma^2 (B,), in the orthant."""
        w = self.weight
        # the last variable is a normal beyond its bound, whose moments are known
        if self.boxes:
            self.e[-1], spread = _moments_between(self.bound, self.end, self.inside)
        else:
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


def truncated(m: Floats, V: Floats, limits: Floats, s: float, h: float) -> tuple[Floats, Floats]:
    """Mean (r,) and covariance (r, r) of coefficients within limits (r, 2), infinite where there are none.

    If there are none theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2).

    Examples
    --------
    A coefficient that may be nothing, of known variance: a half normal distribution, sqrt(2/pi) and 1 - 2/pi.

    >>> mean, covariance = truncated(np.zeros(1), np.eye(1), np.array([[-np.inf, 0.0]]), 2e9, 1e9)
    >>> mean.round(3), covariance.round(3)
    (array([-0.798]), array([[0.363]]))
    """
    unit = np.sqrt(np.diagonal(V))
    m, V, limits = m / unit, V / np.outer(unit, unit), limits / unit[:, None]
    outside = stdtr(2.0 * h, -np.abs(limits - m[:, None]) * np.sqrt(2.0 * h / s)).sum(axis=1)
    beyond = (m < limits[:, 0]) | (m > limits[:, 1])
    doubtful = np.flatnonzero(beyond | (outside > NEGLIGIBLE))
    mean, total = m, s / (2.0 * h) * V
    if len(doubtful):
        turn, end, width = faced(m[doubtful], limits[doubtful])
        turned = np.outer(turn, turn)
        among, at = V[np.ix_(doubtful, doubtful)] * turned, turn * (m[doubtful] - end)
        found = Orthants(at[None], among[None], np.array([s]), h, width[None] if np.isfinite(width).any() else None)
        first, second, variance = found.moments()
        mean, total = carried(m, V, doubtful, end + turn * first[0], turned * second[0], float(variance[0]))
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
