"""Coefficients whose signs or bounds are known: the multivariate Student t posterior on an orthant, or in a box.

    theta | sigma^2 ~ N(m, sigma^2 V),  sigma^2 ~ inverse-Gamma(h, s/2)   =>   theta ~ t with 2h degrees of freedom

P(0 < theta < width), and the moments of theta given this, are integrated by quasi-Monte Carlo over the separated
variables of Genz (1992) and Genz and Bretz (2002), with 1/sigma^2 as one of the variables. The points are fixed, so the
results are reproducible. Logarithms are used throughout, so that orthants far out in the tails do not underflow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, log_ndtr, logsumexp, ndtri_exp, stdtr

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.listing import KEEP, ModelSet, list_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models, neighbours
from bayeq.inference.collapsed.tableau import active_block, move_to, score, swept
from bayeq.inference.prior import limited, signs_of
from bayeq.kernels import kernel
from bayeq.numerics.settings import INFERENCE

# Points of the quadrature: PIPs are off by less than 1e-4, standard deviations by a share of some 1e-4.
POINTS = 256

# Sweeps of the projection onto the orthant. It need not be exact: it only says where sigma^2 is to be sampled.
SWEEPS = 10

# Least conditional variance of a coefficient given those before it, as a share of its variance: less is rounding.
LEAST_SHARE = 1e-12

# Between limits nearer to each other than this a standard normal variable is taken as uniform.
NARROW = 1e-3

# A limit is left out of the orthant if the probability of its violation is less than this share of the probability that
# all limits hold: far below what the quadrature resolves.
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
    """Approximate squared Mahalanobis distance of m (B, k) from the orthant, by projected Gauss-Seidel on the dual."""
    dual, theta = np.zeros_like(m), m.copy()
    for _ in range(SWEEPS if bool((m < 0.0).any()) else 0):
        for j in range(m.shape[1]):
            step = np.maximum(-theta[:, j] / V[:, j, j], -dual[:, j])
            dual[:, j] += step
            theta += V[:, :, j] * step[:, None]
    return np.asarray(np.maximum(np.sum(dual * (theta - m), axis=1), 0.0))


def _between(low: Floats, high: Floats, log_uniform: Floats) -> tuple[Floats, Floats]:
    """ln P(low < e < high) of a standard normal e, and samples of e between the limits, by `log_uniform` = ln u."""
    if np.isposinf(high).all():  # the general case below takes twice as long
        inside = log_ndtr(-low)
        return inside, -ndtri_exp(log_uniform + inside)
    turned = -low > high
    a, b = np.where(turned, -high, low), np.where(turned, -low, high)
    whole, beyond = log_ndtr(-a), log_ndtr(-b)
    inside = whole + np.log(np.maximum(-np.expm1(beyond - whole), 1e-300))
    drawn = np.clip(-ndtri_exp(np.logaddexp(beyond, log_uniform + inside)), a, b)
    return inside, np.where(turned, -drawn, drawn)


def _moments_between(low: Floats, high: Floats, inside: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of a standard normal variable between two limits; `inside` is ln of their probability."""
    with np.errstate(invalid="ignore"):  # inf times 0 where there is no upper limit
        a, b = (np.exp(-0.5 * end**2 - 0.5 * math.log(2.0 * math.pi) - inside) for end in (low, high))
        variance = 1.0 + low * a - np.where(np.isfinite(high), high * b, 0.0) - (a - b) ** 2
        narrow, middle = high - low < NARROW, 0.5 * (low + high)
    mean = np.clip(np.where(narrow, middle, a - b), low, high)
    return mean, np.where(narrow, (high - low) ** 2 / 12.0, np.maximum(variance, 0.0))


def faced(mean: Floats, limits: Floats) -> tuple[Floats, Floats, Floats]:
    """Limits (..., 2) as turn, end and width of 0 <= turn (theta - end) <= width; `end` is the one nearer to `mean`."""
    low, high = limits[..., 0], limits[..., 1]
    turn = np.where(mean > 0.5 * low + 0.5 * high, -1.0, 1.0)
    return turn, np.where(turn < 0.0, high, low), high - low


class Orthants:
    """Quadrature points and weights for theta in an orthant, or box, in each of B problems of k coefficients.

    theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2), with m (B, k), V (B, k, k), s (B,);
    `log_probability` (B,) is ln P(0 < theta < width).
    """

    def __init__(self, m: Floats, V: Floats, s: Floats, h: float, width: Floats | float = math.inf) -> None:
        k = m.shape[1]
        # the coefficient least likely to have its sign comes first: the others then vary less
        spread = np.sqrt(np.diagonal(V, axis1=1, axis2=2))
        self.order = np.argsort(m / spread, axis=1, kind="stable")
        self.m = np.take_along_axis(m, self.order, axis=1)
        V = np.take_along_axis(V, self.order[:, :, None], axis=1)
        V = np.take_along_axis(V, self.order[:, None, :], axis=2)
        self.L = L = _cholesky(V)
        # 1/sigma^2 is sampled from about its density in the orthant; the ratio of densities goes into the weights
        q, gammas, uniforms = _distance(self.m, V), _gammas(h), _uniforms(k)
        root = np.sqrt(2.0 * gammas / (s + q)[:, None])
        self.sigma = 1.0 / root
        log_weight = h * np.log(s / (s + q))[:, None] + gammas * (q / (s + q))[:, None]
        self.e = np.empty((k, *root.shape))
        width = np.take_along_axis(np.broadcast_to(width, m.shape), self.order, axis=1)
        for j in range(k):
            bound = -self.m[:, j, None] * root
            for a in range(j):
                bound -= L[:, j, a, None] * self.e[a]
            bound /= L[:, j, j, None]
            end = bound + width[:, j, None] * root / L[:, j, j, None]
            inside, self.e[j] = _between(bound, end, uniforms[j])
            log_weight = log_weight + inside
        top = log_weight.max(axis=1, keepdims=True)
        weight = np.exp(log_weight - top)
        total = weight.sum(axis=1, keepdims=True)
        self.log_probability = np.minimum((top + np.log(total))[:, 0] - math.log(POINTS), 0.0)
        self.weight, self.last = weight / total, (bound, end, inside)

    def moments(self) -> tuple[Floats, Floats, Floats]:
        """Mean (B, k) and covariance (B, k, k) of theta, and mean of sigma^2 (B,), in the orthant."""
        w = self.weight
        # the last variable is a truncated normal one, whose moments are known
        self.e[-1], spread = _moments_between(*self.last)
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
    """Mean (r,) and covariance (r, r) of coefficients truncated at limits (r, 2), infinite where there are none.

    Before truncation theta | sigma^2 ~ N(m, sigma^2 V), sigma^2 ~ inverse-Gamma(h, s/2).

    Examples
    --------
    A coefficient of mean 0 and variance 1, limited to negative values, is half normal: -sqrt(2/pi) and 1 - 2/pi.

    >>> mean, covariance = truncated(np.zeros(1), np.eye(1), np.array([[-np.inf, 0.0]]), 2e9, 1e9)
    >>> mean.round(3), covariance.round(3)
    (array([-0.798]), array([[0.363]]))
    """
    unit = np.sqrt(np.diagonal(V))
    outside = stdtr(2.0 * h, -np.abs(limits - m[:, None]) / unit[:, None] * np.sqrt(2.0 * h / s)).sum(axis=1)
    doubtful = np.flatnonzero((m < limits[:, 0]) | (m > limits[:, 1]) | (outside > NEGLIGIBLE))
    if not len(doubtful):
        return m, s / (2.0 * h) * V
    m, V, limits = m / unit, V / np.outer(unit, unit), limits / unit[:, None]
    turn, end, width = faced(m[doubtful], limits[doubtful])
    turned = np.outer(turn, turn)
    among, at = V[np.ix_(doubtful, doubtful)] * turned, turn * (m[doubtful] - end)
    found = Orthants(at[None], among[None], np.array([s]), h, width[None])
    first, second, variance = found.moments()
    mean, total = carried(m, V, doubtful, end + turn * first[0], turned * second[0], float(variance[0]))
    return unit * mean, total * np.outer(unit, unit)


def carried(
    m: Floats, V: Floats, among: NDArray[np.intp], mean: Floats, covariance: Floats, variance: float
) -> tuple[Floats, Floats]:
    """Mean (r,) and covariance (r, r) of all coefficients from those of the k truncated ones and the mean of sigma^2.

    Given the truncated ones, at the indices `among`, the others are Gaussian with means linear in them, as
    theta | sigma^2 ~ N(m, sigma^2 V) says.
    """
    slope = V[:, among] @ np.linalg.pinv(V[np.ix_(among, among)], hermitian=True)
    slope[among] = np.eye(len(among))
    rest = V - slope @ V[among]
    rest[among], rest[:, among] = 0.0, 0.0
    total = variance * rest + slope @ covariance @ slope.T
    return m + slope @ (mean - m[among]), 0.5 * (total + total.T)


# Covariances held at a time (models times the square of constrained terms), and models per computation of orthants.
CHUNK = 1 << 21
BATCH = 256

# Largest number of models in the search (some two seconds), and number of listed models that it starts from.
MOST_MODELS = 20_000
STARTS = 100


@kernel
def _blocks(p: Problem, known: Bools, models: Bools, most: int) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Per model: its constrained terms (K, `most`), followed by -1 where there are fewer; their means, and their
    covariances over sigma^2; s and the score, (K,) each."""
    count = len(models)
    terms = np.full((count, most), -1)
    mean, spread = np.zeros((count, most)), np.zeros((count, most, most))
    rate, scores = np.empty(count), np.empty(count)
    current = np.zeros(models.shape[1], dtype=np.bool_)
    T = swept(p, current)
    for k in range(count):
        move_to(p, T, current, models[k])
        rate[k] = max(T.diagonal[-1], p.floor)
        scores[k] = score(p, current, p.slab_variance)
        size = 0
        for j in range(len(current)):
            if current[j] and known[j]:
                terms[k, size] = j
                size += 1
        for a in range(size):
            i = terms[k, a]
            mean[k, a] = T.partial[i]
            for b in range(size):
                j = terms[k, b]
                spread[k, a, b] = -T.rows[T.row[i], j]
    return terms, mean, spread, rate, scores


class Truncation:
    """The probability that known limits hold in each of K models, and which limits are in doubt."""

    terms: Ints  # (K, Q), the constrained terms of each model, followed by -1 where there are fewer
    turn: Floats  # (K, Q), from `faced`, as is `end`
    end: Floats  # (K, Q)
    scores: Floats  # (K,), log posteriors up to `search.log_constant`, with `_gains`, without P(limits hold)
    wrong: Floats  # (K, Q), probability of violating each limit if limits were not known; 0 where `terms` is -1
    needed: Bools  # (K, Q), whether a limit is in doubt; a model with none in doubt is not changed by truncation
    log_right: Floats  # (K,), ln P(limits hold), or an upper bound of it
    exact: Bools  # (K,), whether `log_right` is exact and no bound

    def __init__(self, p: Problem, limits: Floats, models: Bools) -> None:
        self._h = p.h
        most = _most(limits, models)
        self.terms, mean, V, self._s, self.scores = _blocks(p, limited(limits), models, most)
        active = self.terms >= 0
        self.turn, self.end, self._width = faced(mean, np.where(active[:, :, None], limits[self.terms], [0.0, np.inf]))
        self._mean, self._V = self.turn * (mean - self.end), self.turn[:, :, None] * self.turn[:, None, :] * V
        self.scores += models @ _gains(p, limits)
        sd = np.sqrt(np.diagonal(self._V, axis1=1, axis2=2) * (self._s / (2.0 * p.h))[:, None])
        t = np.where(active, self._mean / np.where(active, sd, 1.0), math.inf)
        self.wrong, right = np.asarray(stdtr(2.0 * p.h, -t)), stdtr(2.0 * p.h, t)
        boxed = np.isfinite(self._width)
        if boxed.any():
            beyond = stdtr(2.0 * p.h, t[boxed] - self._width[boxed] / sd[boxed])
            self.wrong[boxed] += beyond
            right[boxed] -= beyond
        self.needed = active & (self.wrong > NEGLIGIBLE * right.prod(axis=1, keepdims=True))
        with np.errstate(divide="ignore"):
            # far out in a tail the probability underflows to 0
            least = np.log(np.maximum(right, 0.0).min(axis=1, where=self.needed, initial=1.0))
        self.exact = (self.needed.sum(axis=1) <= 1) & np.isfinite(least)
        self.log_right = np.where(np.isfinite(least), least, 0.0)

    def orthants(self, rows: Ints) -> Iterator[tuple[Ints, Ints, Orthants]]:
        """Yields models of `rows` with equally many limits in doubt, the limits' places in `terms`, their orthants."""
        count = self.needed[rows].sum(axis=1)
        for size in np.unique(count):
            k = rows[count == size]
            places = np.argsort(~self.needed[k], axis=1, kind="stable")[:, :size]
            V = self._V[k[:, None, None], places[:, :, None], places[:, None, :]]
            mean, width = self._mean[k[:, None], places], self._width[k[:, None], places]
            yield k, places, Orthants(mean, V, self._s[k], self._h, width)


def _gains(p: Problem, limits: Floats) -> Floats:
    """Log density that truncation adds to each term's slab, (P,): -ln of its mass within limits, for unit noise."""
    low, high = limits.T / math.sqrt(p.slab_variance)
    shares, _ = _between(low, high, np.zeros(len(limits)))
    return np.where(signs_of(limits) != 0, math.log(2.0), np.where(limited(limits), -shares, 0.0))


def _most(limits: Floats, models: Bools) -> int:
    """Number of constrained terms in the model that has most of them."""
    return int(np.count_nonzero(models[:, limited(limits)], axis=1).max(initial=0))


def _parts(limits: Floats, models: Bools) -> Iterator[slice]:
    """Slices of the models, each with at most `CHUNK` numbers in the covariances of its constrained terms."""
    size = max(1, CHUNK // max(1, _most(limits, models)) ** 2)
    return (slice(start, start + size) for start in range(0, len(models), size))


def signed_scores(
    p: Problem, limits: Floats, models: Bools, window: float = math.inf, top: float = -math.inf
) -> tuple[Floats, Floats]:
    """Log posteriors (K,) of models up to `search.log_constant`: without the probability that the limits hold, and with
    it. Models more than `window` nats below the best (or `top`) get an upper bound of the second."""
    without, value = np.empty(len(models)), np.empty(len(models))
    for part in _parts(limits, models):
        found = Truncation(p, limits, models[part])
        values = found.scores + found.log_right
        top = max(top, float(values[found.exact].max(initial=-math.inf)))
        left = np.flatnonzero(~found.exact)
        left = left[np.argsort(-values[left], kind="stable")]
        while len(left) and values[left[0]] >= top - window:
            rows, left = np.split(left, [BATCH])
            for k, _, orthants in found.orthants(rows):
                values[k] = found.scores[k] + orthants.log_probability
            top = max(top, float(values[rows].max()))
        without[part], value[part] = found.scores, values
    return without, value


def truncated_models(p: Problem, limits: Floats, models: Bools) -> Iterator[tuple[int, Floats, Floats, float]]:
    """Yields, for each model with limits in doubt: index, mean (P,) and covariance (r, r) of theta, mean of sigma^2."""
    for part in _parts(limits, models):
        found = Truncation(p, limits, models[part])
        doubtful = np.flatnonzero(found.needed.any(axis=1))
        for start in range(0, len(doubtful), BATCH):
            for rows, places, orthants in found.orthants(doubtful[start : start + BATCH]):
                mean, covariance, variance = orthants.moments()
                for a, k in enumerate(rows):
                    terms, turn = found.terms[k, places[a]], found.turn[k, places[a]]
                    moments = found.end[k, places[a]] + turn * mean[a], np.outer(turn, turn) * covariance[a]
                    yield part.start + int(k), *_carried(p, models[part][k], terms, *moments, float(variance[a]))


def _carried(
    p: Problem, active: Bools, truncated: Ints, mean: Floats, covariance: Floats, variance: float
) -> tuple[Floats, Floats, float]:
    """Mean (P,) and covariance (r, r) of a model's coefficients from those of the truncated ones; mean of sigma^2."""
    T, kept = swept(p, active), np.flatnonzero(active)
    V = active_block(T, kept)
    among = np.searchsorted(kept, truncated)
    coef = np.zeros(len(active))
    coef[kept], total = carried(T.partial[kept], 0.5 * (V + V.T), among, mean, covariance, variance)
    return coef, total, variance


def list_signed(p: Problem, limits: Floats, tolerance: float, enumerate_up_to: int) -> ModelSet:
    """Models that hold all but `tolerance` of the posterior mass, and whether the data contradict the signs.

    Models are first listed with the gain of their truncated slabs, but without the probability that the limits hold:
    an upper bound of their mass, and so of the mass left out. This list is the answer if the limits hold in at least
    half of its mass; otherwise the search starts from it.
    """
    either = p._replace(log_odds=p.log_odds + _gains(p, limits))
    # if the limits hold in half of the mass, the share left out may double
    found = list_models(either, 0.5 * tolerance, enumerate_up_to)
    without, value = signed_scores(p, limits, found.models, KEEP)
    order = np.argsort(-value, kind="stable")
    right = float(np.exp(value - without[0]).sum() / np.exp(without - without[0]).sum())
    if right >= 0.5:
        left = found.left_out / (found.left_out + (1.0 - found.left_out) * right)
        return ModelSet(found.models[order], value[order], left, found.expanded)
    listed = _search(p, limits, either, [*found.models[order[:STARTS]], *_starts(either, limits)], tolerance)
    # scores without limits: a constrained term then has the odds of any other
    free = without - found.models @ _gains(p, limits)
    if logsumexp(free) - logsumexp(listed.log_posterior) < INFERENCE.signs_contradicted:
        return listed
    truncation, wrong = Truncation(p, limits, found.models[:STARTS]), np.zeros(len(limits))
    np.add.at(wrong, truncation.terms, found.weights[:STARTS, None] * truncation.wrong)
    return replace(listed, contradicted=tuple(np.flatnonzero(wrong > 0.5 * wrong.max()).tolist()))


def _starts(p: Problem, limits: Floats) -> list[Bools]:
    """Local optima ignoring limits; repeated without those terms of the best one that violate limits, until none do."""
    found: list[Bools] = []
    while True:
        optima = [model for _, model in best_models(p)]
        found += optima
        mean = swept(p, optima[0]).partial
        wrong = optima[0] & ((mean < limits[:, 0]) | (mean > limits[:, 1])) & np.isfinite(p.log_odds)
        if not wrong.any():
            return found
        p = p._replace(log_odds=np.where(wrong, -math.inf, p.log_odds))


def _search(p: Problem, limits: Floats, either: Problem, new: list[Bools], tolerance: float) -> ModelSet:
    """Best-first search by the posterior within the limits; each pass expands half of the mass not yet expanded."""
    seen: set[bytes] = set()
    models, waiting = np.empty((0, len(limits)), dtype=np.bool_), np.empty(0, dtype=np.bool_)
    without, value, expanded = np.empty(0), np.empty(0), 0
    while True:
        unseen = {model.tobytes(): model for model in new if model.tobytes() not in seen}
        if unseen:
            seen.update(unseen)
            fresh = np.array(list(unseen.values()))
            scores = signed_scores(p, limits, fresh, KEEP, value.max(initial=-math.inf))
            models, waiting = np.concatenate([models, fresh]), np.append(waiting, np.ones(len(fresh), dtype=np.bool_))
            without, value = np.append(without, scores[0]), np.append(value, scores[1])
            likely = np.flatnonzero(value > value.max() - KEEP)
            likely = likely[np.argsort(-value[likely], kind="stable")]
            models, waiting, without, value = models[likely], waiting[likely], without[likely], value[likely]
        weight = np.exp(value - value[0])
        frontier = np.flatnonzero(waiting)
        mass = np.cumsum(weight[frontier])
        left = float(weight[frontier].sum() / weight.sum())
        if left <= tolerance or len(models) >= MOST_MODELS:
            return ModelSet(models, value, left, expanded)
        chosen = frontier[: 1 + np.searchsorted(mass, 0.5 * mass[-1])]
        waiting[chosen] = False
        expanded += len(chosen)
        # a neighbour's score without the probability of its limits is an upper bound of its score with it
        least = value[0] - KEEP
        new = [move.apply(models[k]) for k in chosen for move in neighbours(either, models[k], without[k] - least)]
