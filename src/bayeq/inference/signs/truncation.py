"""Spike-and-slab priors with known signs: the slab of a constrained coefficient is a half normal, of twice the density.

With k constrained terms in a model its evidence (34) is multiplied by 2^k P(all of them have their signs | model, y),
the probability of an orthant under the Student t posterior of the model's coefficients (`inference.orthant`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.special import stdtr

from bayeq.inference.collapsed.problem import Bools, Floats, Ints, Problem
from bayeq.inference.collapsed.tableau import active_block, drifted, flip, renew, score, swept
from bayeq.inference.signs.orthant import POINTS, log_orthant, orthant_moments
from bayeq.kernels import kernel

__all__ = ["Truncation", "add_truncated", "certain_signs", "coarse_scores", "given_signs", "signed_scores"]

Moments = tuple[Floats, Floats, Floats, float]

# Where the signs are wrong with less than this probability the truncation changes nothing that a user could see.
CERTAIN = 1e-9

# Of several constrained terms one is left out of the orthant if its sign is wrong with a probability below this,
# relative to the square of the least probability of a right one.
NEGLIGIBLE = 1e-12

# Numbers (models times squares of constrained terms) held at a time.
CHUNK = 1 << 21

# Models whose orthants are computed at a time, from the likeliest on.
BATCH = 64

# Models that cannot come within so many nats of the best, or of less weight, are worth fewer points.
FINE = 5.0
FINE_WEIGHT = 5e-3
COARSE_POINTS = 128


@kernel
def _blocks(p: Problem, models: Bools, terms: Ints) -> tuple[Floats, Floats, Floats, Floats]:
    """Of each model: mean (K, Q) and covariance over sigma^2 (K, Q, Q) of the `terms` that are in, s, and the score."""
    count, chosen = len(models), len(terms)
    mean, spread = np.zeros((count, chosen)), np.zeros((count, chosen, chosen))
    rate, scores = np.empty(count), np.empty(count)
    current = np.zeros(models.shape[1], dtype=np.bool_)
    T = swept(p, current)
    for k in range(count):
        for j in range(len(current)):
            if models[k, j] != current[j]:
                flip(p, T, j)
                current[j] = not current[j]
        if drifted(p, T):
            renew(p, T, current)
        rate[k] = max(T.diagonal[-1], p.floor)
        scores[k] = score(p, current, p.slab_variance)
        for a in range(chosen):
            row = T.row[terms[a]]
            if row < 0:
                continue
            mean[k, a] = T.partial[terms[a]]
            for b in range(chosen):
                if T.row[terms[b]] >= 0:
                    spread[k, a, b] = -T.rows[row, terms[b]]
    return mean, spread, rate, scores


class Truncation:
    """What the signs do to each of K models.

    Attributes
    ----------
    scores : (K,) array
        Log posteriors without the signs, up to `search.log_constant`.
    certain : (K,) bool array
        The signs are right without being asked for: the factor is 2^k and the moments are as ever.
    bound : (K,) array
        ln of the factor, or a bound of it from above.
    exact : (K,) bool array
        Where `bound` is the factor itself.
    """

    def __init__(self, p: Problem, models: Bools) -> None:
        self._models, self._h = models, p.h
        self._terms = np.flatnonzero(p.signs)
        self._sign = p.signs[self._terms].astype(np.float64)
        mean, spread, self._rate, self.scores = _blocks(p, models, self._terms)
        # as if all signs were +
        self._mean, self._spread = mean * self._sign, spread * np.outer(self._sign, self._sign)
        active = models[:, self._terms]
        scale = np.sqrt(np.diagonal(spread, axis1=1, axis2=2) * (self._rate / (2.0 * p.h))[:, None])
        t = np.where(active, self._mean / np.where(active, scale, 1.0), math.inf)
        wrong, right = stdtr(2.0 * p.h, -t), stdtr(2.0 * p.h, t)
        worst = right.min(axis=1)
        self.certain = wrong.sum(axis=1) < CERTAIN
        self._needed = active & (wrong > NEGLIGIBLE * worst[:, None] ** 2)
        self._doubled = math.log(2.0) * active.sum(axis=1)
        with np.errstate(divide="ignore"):
            least = np.where(self.certain, 0.0, np.log(worst))
        # P(all right) <= P(one right); far out in a tail the latter is too small to be a number
        beyond = np.isinf(least)
        self.bound = self._doubled + np.where(beyond, 0.0, least)
        self.exact = self.certain | ((self._needed.sum(axis=1) == 1) & ~beyond)

    def _groups(self, rows: Ints) -> Iterator[tuple[Ints, Ints, tuple[Floats, Floats, Floats, float]]]:
        """Models with equally many terms to truncate: places in `rows`, these terms, what `inference.orthant` takes."""
        sizes = self._needed[rows].sum(axis=1)
        for size in np.unique(sizes[sizes > 0]):
            same = np.flatnonzero(sizes == size)
            chosen = np.argsort(~self._needed[rows[same]], axis=1, kind="stable")[:, :size]
            k = rows[same, None]
            V = self._spread[k[:, :, None], chosen[:, :, None], chosen[:, None, :]]
            yield same, chosen, (self._mean[k, chosen], V, self._rate[rows[same]], self._h)

    def log_factors(self, rows: Ints, points: int) -> Floats:
        """ln of the factors of some of the models, by so many points."""
        out = self._doubled[rows]
        for same, _, arguments in self._groups(rows):
            out[same] += log_orthant(*arguments, points)
        return np.asarray(out)

    def moments(self, p: Problem, rows: Ints, points: int) -> Iterator[tuple[int, Floats, Floats, float]]:
        """Models that are not `certain`, each with mean (P,) and covariance (r, r) of theta and mean of sigma^2."""
        for same, chosen, arguments in self._groups(rows):
            mean, covariance, variance = orthant_moments(*arguments, points)
            for a, k in enumerate(rows[same]):
                sign = self._sign[chosen[a]]
                shift = sign * (mean[a] - self._mean[k, chosen[a]])
                moved = covariance[a] * np.outer(sign, sign)
                yield int(k), *_carried(p, self._models[k], self._terms[chosen[a]], shift, moved, float(variance[a]))


def _carried(
    p: Problem, active: Bools, truncated: Ints, shift: Floats, covariance: Floats, variance: float
) -> tuple[Floats, Floats, float]:
    """Moments of all coefficients of a model from those of the truncated ones.

    Given these and sigma^2 the others are Gaussian as ever, with means linear in these.
    """
    T, kept = swept(p, active), np.flatnonzero(active)
    V = active_block(T, kept)
    V = 0.5 * (V + V.T)
    among = np.searchsorted(kept, truncated)
    slope = V[:, among] @ np.linalg.pinv(V[np.ix_(among, among)], hermitian=True)
    slope[among] = np.eye(len(among))
    rest = V - slope @ V[among]
    rest[among], rest[:, among] = 0.0, 0.0
    coef = np.zeros(len(active))
    coef[kept] = T.partial[kept] + slope @ shift
    total = variance * rest + slope @ covariance @ slope.T
    return coef, 0.5 * (total + total.T), variance


def _chunks(p: Problem, count: int) -> list[slice]:
    """Parts of so many models that their covariances find room."""
    size = max(1, CHUNK // max(1, int(np.count_nonzero(p.signs))) ** 2)
    return [slice(start, start + size) for start in range(0, count, size)]


def signed_scores(p: Problem, models: Bools, window: float, top: float = -math.inf) -> tuple[Floats, Floats]:
    """Log posteriors of K models without and with the signs, up to `search.log_constant`.

    Of a model that cannot come within `window` nats of the best of them, or of `top`, the second is a bound from above.
    """
    without, value = np.empty(len(models)), np.empty(len(models))
    for part in _chunks(p, len(models)):
        truncation = Truncation(p, models[part])
        values = truncation.scores + truncation.bound
        top = max(top, float(values[truncation.exact].max(initial=-math.inf)))
        left = np.flatnonzero(~truncation.exact)
        left = left[np.argsort(-values[left], kind="stable")]
        for first in range(0, len(left), BATCH):
            rows = left[first : first + BATCH]
            rows = rows[values[rows] > top - window]
            if not len(rows):
                break
            points = POINTS if values[rows[0]] > top - FINE else COARSE_POINTS
            values[rows] = truncation.scores[rows] + truncation.log_factors(rows, points)
            top = max(top, float(values[rows].max()))
        without[part], value[part] = truncation.scores, values
    return without, value


def coarse_scores(p: Problem, models: Bools) -> Floats:
    """Log posteriors of K models with the signs, up to `search.log_constant`, none of them a bound, by few points."""
    out = np.empty(len(models))
    for part in _chunks(p, len(models)):
        truncation = Truncation(p, models[part])
        values, left = truncation.scores + truncation.bound, np.flatnonzero(~truncation.exact)
        values[left] = truncation.scores[left] + truncation.log_factors(left, COARSE_POINTS)
        out[part] = values
    return out


def given_signs(p: Problem, active: Bools) -> tuple[Floats, Floats] | None:
    """Mean (P,) and covariance (r, r) of theta given a model and the signs.

    None where the signs are certain: `conditional.given_model` then says it all.
    """
    truncation = Truncation(p, active[None, :])
    for _, coef, covariance, _ in truncation.moments(p, np.flatnonzero(~truncation.certain), POINTS):
        return coef, covariance
    return None


def certain_signs(p: Problem, models: Bools) -> Bools:
    """Whether the signs of each of K models are certain, so that its moments are as ever."""
    return np.concatenate([Truncation(p, models[part]).certain for part in _chunks(p, len(models))])


def add_truncated(p: Problem, models: Bools, weights: Floats, place: Ints, moments: Moments) -> Moments:
    """Moments of a mixture (see `bma`) with those of weighted models added whose signs are not certain."""
    mean, square, second, noise = moments
    for part in _chunks(p, len(models)):
        truncation, weight = Truncation(p, models[part]), weights[part]
        for rows, points in (
            (np.flatnonzero(weight >= FINE_WEIGHT), POINTS),
            (np.flatnonzero(weight < FINE_WEIGHT), COARSE_POINTS),
        ):
            for k, coef, covariance, variance in truncation.moments(p, rows, points):
                kept = np.flatnonzero(models[part][k])
                raw = weight[k] * (covariance + np.outer(coef[kept], coef[kept]))
                mean[kept] += weight[k] * coef[kept]
                square[kept] += np.diagonal(raw)
                noise += weight[k] * variance
                among = np.flatnonzero(place[kept] >= 0)
                at = place[kept[among]]
                second[np.ix_(at, at)] += raw[np.ix_(among, among)]
    return mean, square, second, noise
