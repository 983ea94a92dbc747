"""Spike-and-slab priors with known signs: the slab of a constrained coefficient is a half normal, of twice the density.

With k constrained terms in a model its evidence (34) is multiplied by 2^k P(all of them have their signs | model, y),
the probability of an orthant under the Student t posterior of the model's coefficients (`signs.orthant`). Bounds are
the same, with 1/P(within them) of the slab for 2, and a box for an orthant. Both are limits (P, 2), infinite where
there are none.

Where the data agree with the signs, the models are those that are likely without them. Where the data contradict a
sign the mass lies elsewhere, at models that may be unlikely without it: a best-first search finds them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import log_ndtr, logsumexp, stdtr

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.listing import KEEP, ModelSet, list_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models, neighbours
from bayeq.inference.collapsed.tableau import active_block, drifted, flip, renew, score, swept
from bayeq.inference.prior import limited, signs_of
from bayeq.inference.settings import INFERENCE
from bayeq.inference.signs.orthant import NEGLIGIBLE, Orthants, carried, faced
from bayeq.kernels import kernel

# Numbers (models times squares of constrained terms) held at a time, and models whose orthants are computed at a time.
CHUNK = 1 << 21
BATCH = 256

# Room for models of the search, some two seconds; and models that it starts from.
MOST_MODELS = 20_000
STARTS = 100


@kernel
def _blocks(p: Problem, known: Bools, models: Bools, most: int) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Of each model: its constrained terms (K, Q), -1 where there are fewer, with the mean (K, Q) and covariance over
    sigma^2 (K, Q, Q) of their coefficients; s; and the score. Q = `most`."""
    count = len(models)
    terms = np.full((count, most), -1)
    mean, spread = np.zeros((count, most)), np.zeros((count, most, most))
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
    """What limits do to each of K models.

    Attributes
    ----------
    terms : (K, Q) int array
        The constrained terms of each model, followed by -1 where there are fewer.
    turn, end : (K, Q) arrays
        As from `orthant.faced`.
    scores : (K,) array
        Log posteriors up to `search.log_constant`, with 2^k but without the probability of right signs.
    wrong : (K, Q) array
        Probability that each coefficient is beyond its limits if they are not known; 0 at the end of `terms`.
    needed : (K, Q) bool array
        Limits in doubt. If there is none the truncation changes nothing.
    log_right : (K,) array
        ln P(all within their limits), or a bound of it from above.
    exact : (K,) bool array
        Where it is no bound.
    """

    def __init__(self, p: Problem, limits: Floats, models: Bools) -> None:
        self._h = p.h
        most = _most(limits, models)
        self.terms, mean, V, self._s, self.scores = _blocks(p, limited(limits), models, most)
        active = self.terms >= 0
        self.turn, self.end, self._width = faced(mean, np.where(active[:, :, None], limits[self.terms], [0.0, np.inf]))
        self._mean, self._V = self.turn * (mean - self.end), self.turn[:, :, None] * self.turn[:, None, :] * V
        self.scores += _gain(p, limits, models)
        sd = np.sqrt(np.diagonal(self._V, axis1=1, axis2=2) * (self._s / (2.0 * p.h))[:, None])
        t = np.where(active, self._mean / np.where(active, sd, 1.0), math.inf)
        self.wrong, right = stdtr(2.0 * p.h, -t), stdtr(2.0 * p.h, t)
        boxed = np.isfinite(self._width)
        if boxed.any():
            beyond = stdtr(2.0 * p.h, t[boxed] - self._width[boxed] / sd[boxed])
            self.wrong[boxed] += beyond
            right[boxed] -= beyond
        self.needed = active & (self.wrong > NEGLIGIBLE * right.prod(axis=1, keepdims=True))
        with np.errstate(divide="ignore"):
            # far out in a tail the probability is too small to be a number
            least = np.log(np.maximum(right, 0.0).min(axis=1, where=self.needed, initial=1.0))
        self.exact = (self.needed.sum(axis=1) <= 1) & np.isfinite(least)
        self.log_right = np.where(np.isfinite(least), least, 0.0)

    def orthants(self, rows: Ints) -> Iterator[tuple[Ints, Ints, Orthants]]:
        """Orthants of some models, by their number of doubtful signs: the models, places in `terms` of the signs."""
        count = self.needed[rows].sum(axis=1)
        for size in np.unique(count):
            k = rows[count == size]
            places = np.argsort(~self.needed[k], axis=1, kind="stable")[:, :size]
            V = self._V[k[:, None, None], places[:, :, None], places[:, None, :]]
            width = self._width[k[:, None], places]
            boxes = width if np.isfinite(width).any() else None
            yield k, places, Orthants(self._mean[k[:, None], places], V, self._s[k], self._h, boxes)


def _gains(p: Problem, limits: Floats) -> Floats:
    """-ln of the share of each slab within its limits, (P,), for a noise of variance 1."""
    low, high = limits.T / math.sqrt(p.slab_variance)
    turned = -low > high
    low, high = np.where(turned, -high, low), np.where(turned, -low, high)
    whole, beyond = log_ndtr(-low), log_ndtr(-high)
    shares = whole + np.log(np.maximum(-np.expm1(beyond - whole), 1e-300))
    return np.where(signs_of(limits) != 0, math.log(2.0), np.where(limited(limits), -shares, 0.0))


def _gain(p: Problem, limits: Floats, models: Bools) -> Floats:
    """What the slabs of all constrained terms of each of K models gain, (K,)."""
    half = signs_of(limits) != 0
    gain = math.log(2.0) * np.count_nonzero(models[:, half], axis=1)
    return gain if (half == limited(limits)).all() else gain + models @ np.where(half, 0.0, _gains(p, limits))


def _most(limits: Floats, models: Bools) -> int:
    """Number of constrained terms in the model that has most of them."""
    return int(np.count_nonzero(models[:, limited(limits)], axis=1).max(initial=0))


def _parts(limits: Floats, models: Bools) -> Iterator[slice]:
    """Parts of many models whose covariances find room."""
    size = max(1, CHUNK // max(1, _most(limits, models)) ** 2)
    return (slice(start, start + size) for start in range(0, len(models), size))


def signed_scores(
    p: Problem, limits: Floats, models: Bools, window: float = math.inf, top: float = -math.inf
) -> tuple[Floats, Floats]:
    """Log posteriors of K models, up to `search.log_constant`, without the probability of right signs and with it.

    Of a model that does not come within `window` nats of the best of them, or of `top`, the second is a bound from
    above.
    """
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
    """Those of K models whose signs are in doubt: number, mean (P,) and covariance (r, r) of theta, mean of sigma^2."""
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
    """Moments of all P coefficients of a model, and the mean of sigma^2, from those of the truncated ones."""
    T, kept = swept(p, active), np.flatnonzero(active)
    V = active_block(T, kept)
    among = np.searchsorted(kept, truncated)
    coef = np.zeros(len(active))
    coef[kept], total = carried(T.partial[kept], 0.5 * (V + V.T), among, mean, covariance, variance)
    return coef, total, variance


def list_signed(p: Problem, limits: Floats, tolerance: float, enumerate_up_to: int) -> ModelSet:
    """Models that hold all but `tolerance` of the posterior mass, and whether the data contradict the signs.

    First the models that are likely whatever the signs are listed, a constrained term with the odds of a half normal
    slab on either side, one with bounds with those of the truncated slab. The weight of a model with the signs is at
    most this one, which bounds what is left out. They are the answer if the signs are right in at least half of their
    mass, otherwise a start of the search.
    """
    either = p._replace(log_odds=p.log_odds + _gains(p, limits))
    # half of the mass at least is kept, so that what is left out may have twice its share
    found = list_models(either, 0.5 * tolerance, enumerate_up_to)
    without, value = signed_scores(p, limits, found.models, KEEP)
    order = np.argsort(-value, kind="stable")
    right = float(np.exp(value - without[0]).sum() / np.exp(without - without[0]).sum())
    if right >= 0.5:
        left = found.left_out / (found.left_out + (1.0 - found.left_out) * right)
        return ModelSet(found.models[order], value[order], left, found.expanded)
    listed = _search(p, limits, either, [*found.models[order[:STARTS]], *_starts(either, limits)], tolerance)
    # where its sign is not known a constrained term has the odds of any other
    free = without - _gain(p, limits, found.models)
    if logsumexp(free) - logsumexp(listed.log_posterior) < INFERENCE.signs_contradicted:
        return listed
    truncation, wrong = Truncation(p, limits, found.models[:STARTS]), np.zeros(len(limits))
    np.add.at(wrong, truncation.terms, found.weights[:STARTS, None] * truncation.wrong)
    return replace(listed, contradicted=tuple(np.flatnonzero(wrong > 0.5 * wrong.max()).tolist()))


def _starts(p: Problem, limits: Floats) -> list[Bools]:
    """Local optima without the signs, terms of the wrong sign taken out until there is none."""
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
    """Best-first search by the weights with the signs: half of the mass not expanded yet is expanded at a time."""
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
        # a neighbour has no more weight with the signs than without
        least = value[0] - KEEP
        new = [move.apply(models[k]) for k in chosen for move in neighbours(either, models[k], without[k] - least)]
