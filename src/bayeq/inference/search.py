"""Search over models by their exact log posterior (34), on the collapsed tableau."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import GramLike, dense
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm_ascent
from bayeq.inference.tableau import build, climb, flip, flip_gain, score, swap_gain
from bayeq.kernels import kernel

__all__ = ["Move", "SearchProblem", "best_models", "candidate_models", "log_evidence", "neighbours"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Up to this many terms a climb also starts from the full model (its cost grows as P^3).
FULL_START_TERMS = 128


@dataclass(frozen=True, slots=True)
class SearchProblem:
    """A Gram and a prior as the arrays that the kernels take."""

    DtD: Floats
    Dty: Floats
    yty: float
    dof: float
    log_odds: Floats
    slab_variance: float
    noise_shape: float
    noise_rate: float

    @classmethod
    def of(cls, gram: GramLike, prior: Prior) -> SearchProblem:
        terms = len(gram.names)
        prior.validate(terms)
        return cls(
            DtD=np.ascontiguousarray(dense(gram)),
            Dty=np.ascontiguousarray(gram.Dty),
            yty=float(gram.yty),
            dof=float(gram.dof),
            log_odds=prior.log_odds(terms),
            slab_variance=float(prior.slab_variance),
            noise_shape=float(prior.noise_shape),
            noise_rate=float(prior.noise_rate),
        )

    @property
    def h(self) -> float:
        """a_sigma + N/2."""
        return self.noise_shape + 0.5 * self.dof

    @property
    def floor(self) -> float:
        """Least value of s = 2 b + RSS that rounding of y'y lets us tell from zero."""
        return max(2.0 * self.noise_rate, 1e-15 * self.yty)


@kernel
def _best_models(  # type: ignore[no-untyped-def]
    DtD, Dty, yty, log_odds, slab_variance, noise_rate, h, floor, starts
):
    """Climb from each row of `starts` (in place); returns their final scores and the swept base."""
    p = len(Dty)
    half_log_slab = 0.5 * math.log(slab_variance)
    base = build(DtD, Dty, yty, 1.0 / slab_variance, noise_rate)
    scores = np.empty(len(starts))
    for k in range(len(starts)):
        M = base.copy()
        for j in range(p):
            if log_odds[j] == math.inf:
                starts[k, j] = True
            elif log_odds[j] == -math.inf:
                starts[k, j] = False
            if starts[k, j]:
                flip(M, j)
        climb(M, starts[k], log_odds, half_log_slab, h, floor)
        scores[k] = score(DtD, Dty, yty, starts[k], log_odds, slab_variance, noise_rate, h, floor)
    return scores


@kernel
def _neighbours(  # type: ignore[no-untyped-def]
    DtD, Dty, yty, log_odds, slab_variance, noise_rate, h, floor, active, window
):
    """All flips and swaps from `active` within `window` of its score: rows (out, in, gain); -1 for none."""
    p = len(Dty)
    half_log_slab = 0.5 * math.log(slab_variance)
    M = build(DtD, Dty, yty, 1.0 / slab_variance, noise_rate)
    r = 0
    for j in range(p):
        if active[j]:
            flip(M, j)
            r += 1
    out = np.empty(p + r * (p - r), dtype=np.int64)
    into = np.empty_like(out)
    gains = np.empty(len(out))
    count = 0
    for j in range(p):
        if math.isinf(log_odds[j]):
            continue
        gain = flip_gain(M, active, j, log_odds, half_log_slab, h, floor)
        if gain > -window:
            out[count], into[count] = (j, -1) if active[j] else (-1, j)
            gains[count] = gain
            count += 1
    for i in range(p):
        if active[i] and not math.isinf(log_odds[i]):
            for j in range(p):
                if not active[j] and not math.isinf(log_odds[j]):
                    gain = swap_gain(M, i, j, log_odds, h, floor)
                    if gain > -window:
                        out[count], into[count], gains[count] = i, j, gain
                        count += 1
    return out[:count], into[:count], gains[:count]


def log_constant(problem: SearchProblem) -> float:
    """What `tableau.score` leaves out of ln p(y, z): eq. (34) and the Bernoulli prior."""
    p = problem
    free = p.log_odds[np.isfinite(p.log_odds)]
    return float(
        math.lgamma(p.h)
        - math.lgamma(p.noise_shape)
        + p.noise_shape * math.log(p.noise_rate)
        - 0.5 * p.dof * math.log(2.0 * math.pi)
        - np.sum(np.logaddexp(0.0, free))
    )


def log_evidence(problem: SearchProblem, active: Bools) -> float:
    """ln p(y, z) of one model: eq. (34) plus the log prior of z."""
    p = problem
    value = score(
        p.DtD, p.Dty, p.yty, active, p.log_odds, p.slab_variance, p.noise_rate, p.h, p.floor
    )
    return float(value) + log_constant(p)


def best_models(problem: SearchProblem, starts: list[Bools] | None = None) -> list[tuple[float, Bools]]:
    """Distinct local optima of ln p(y, z) under flips and swaps, best first.

    Parameters
    ----------
    problem : SearchProblem
        What to search.
    starts : list of (P,) bool arrays, optional
        Where to climb from; by default the empty model, the support of the RVM and, for small dictionaries,
        the full model.

    Returns
    -------
    list of (score, (P,) bool array)
        The score is ln p(y, z) up to `log_constant`.
    """
    p = problem
    terms = len(p.Dty)
    if starts is None:
        gamma = rvm_ascent(p.DtD, p.Dty, p.yty, p.dof, 50 * terms + 100)[0]
        starts = [np.zeros(terms, dtype=np.bool_), gamma > 0]
        if terms <= FULL_START_TERMS:
            starts.append(np.ones(terms, dtype=np.bool_))
    models = np.array(starts, dtype=np.bool_)
    scores = _best_models(
        p.DtD, p.Dty, p.yty, p.log_odds, p.slab_variance, p.noise_rate, p.h, p.floor, models
    )
    found: dict[bytes, tuple[float, Bools]] = {}
    for k in np.argsort(-scores, kind="stable"):
        found.setdefault(models[k].tobytes(), (float(scores[k]), models[k]))
    return list(found.values())


@dataclass(frozen=True, slots=True)
class Move:
    """One step away from a model: the terms that leave and enter (None where there is none)."""

    gain: float
    leaves: int | None
    enters: int | None

    def apply(self, active: Bools) -> Bools:
        """The model on the other side of the move."""
        out = active.copy()
        if self.leaves is not None:
            out[self.leaves] = False
        if self.enters is not None:
            out[self.enters] = True
        return out


def neighbours(problem: SearchProblem, active: Bools, window: float = math.inf) -> list[Move]:
    """Flips and swaps from a model whose log posterior lies within `window` nats of it, best first."""
    p = problem
    out, into, gains = _neighbours(
        p.DtD, p.Dty, p.yty, p.log_odds, p.slab_variance, p.noise_rate, p.h, p.floor, active, window
    )
    order = np.argsort(-gains, kind="stable")
    return [
        Move(float(gains[k]), int(out[k]) if out[k] >= 0 else None, int(into[k]) if into[k] >= 0 else None)
        for k in order
    ]


def candidate_models(problem: SearchProblem, window: float = 2.0, limit: int = 6) -> list[Bools]:
    """The best models found and those one move away, within `window` nats of the best and at most `limit`.

    Mean-field indicators let VB gain a fraction of a nat on a model with undecided terms, so that its optimum
    may belong to a model slightly below the best one.
    """
    found = best_models(problem)
    top, best = found[0]
    pool = [(value - top, model) for value, model in found[1:] if value > top - window]
    pool += [(move.gain, move.apply(best)) for move in neighbours(problem, best, window)]
    pool.sort(key=lambda entry: -entry[0])
    models = {best.tobytes(): best}
    for _, model in pool:
        models.setdefault(model.tobytes(), model)
    return list(models.values())[:limit]
