"""Search over models by their exact log posterior (34), on the collapsed tableau."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.tableau import climb, flip, flip_gains, score, swap_gains, swept
from bayeq.inference.rvm import rvm_gamma
from bayeq.kernels import kernel

# Up to FULL_START_TERMS terms a climb also starts from the full model (its cost grows as P^3); with more, up to
# RVM_START_TERMS, from the support of the RVM.
FULL_START_TERMS = 128
RVM_START_TERMS = 500

# What `explore` does with each model first: nothing, a climb by flips, or one by flips and swaps.
STAY, FLIP, SWAP = 0, 1, 2


@kernel
def _moves(p: Problem, active: Bools, window: float) -> tuple[Ints, Ints, Floats]:
    """Flips and swaps from `active` that lose less than `window` nats: terms out, terms in (-1: none), gains."""
    terms = len(active)
    T = swept(p, active)
    most = terms + T.size[0] * (terms - T.size[0])
    out, into, gains = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    count = 0
    gain = np.empty(terms)
    flip_gains(p, T, gain)
    for j in range(terms):
        if gain[j] > -window:
            out[count], into[count] = (j, -1) if active[j] else (-1, j)
            gains[count] = gain[j]
            count += 1
    for i in range(terms):
        if active[i]:
            swap_gains(p, T, i, -window, gain)
            for j in range(terms):
                if gain[j] > -window:
                    out[count], into[count], gains[count] = i, j, gain[j]
                    count += 1
    return out[:count], into[:count], gains[:count]


@kernel
def explore(p: Problem, models: Bools, way: int, window: float) -> tuple[Floats, tuple[Ints, Ints, Floats]]:
    """Scores of models, and `_moves` from the best one, in one kernel, because each kernel takes time to load.

    Each model first climbs, in place, by flips (`way` is FLIP), by flips and swaps (SWAP), or not at all (STAY).
    """
    scores, best = np.empty(len(models)), 0
    for k in range(len(models)):
        active = models[k]
        if way != STAY:
            for j in range(len(active)):
                if math.isinf(p.log_odds[j]):
                    active[j] = p.log_odds[j] > 0.0
            climb(p, swept(p, active), active, way == SWAP)
        scores[k] = score(p, active, p.slab_variance)
        if scores[k] > scores[best]:
            best = k
    return scores, _moves(p, models[best], window)


def scores_of(problem: Problem, models: Bools) -> Floats:
    """Log posteriors (K,) of models (K, P) up to `log_constant`, each from scratch."""
    return explore(problem, np.array(models), STAY, -math.inf)[0]


def log_constant(problem: Problem) -> float:
    """Constant terms of ln p(y, z), eq. (34) with the Bernoulli prior, that `tableau.score` leaves out."""
    p = problem
    free = p.log_odds[np.isfinite(p.log_odds)]
    return float(
        math.lgamma(p.h)
        - math.lgamma(p.noise_shape)
        + p.noise_shape * math.log(p.noise_rate)
        - 0.5 * p.dof * math.log(2.0 * math.pi)
        - np.sum(np.logaddexp(0.0, free))
    )


def best_models(problem: Problem, known: Sequence[Bools] = ()) -> list[tuple[float, Bools]]:
    """Distinct local optima of ln p(y, z) under flips and swaps from `default_starts` and `known` models, best first,
    with scores."""
    models = np.array([*default_starts(problem), *known], dtype=np.bool_)
    return _ranked(explore(problem, models, SWAP, -math.inf)[0], models)


def _ranked(scores: Floats, models: Bools) -> list[tuple[float, Bools]]:
    """Distinct models with their scores, best first."""
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
        """The model after the move."""
        out = active.copy()
        if self.leaves is not None:
            out[self.leaves] = False
        if self.enters is not None:
            out[self.enters] = True
        return out


def neighbours(problem: Problem, active: Bools, window: float = math.inf) -> list[Move]:
    """Flips and swaps from a model that lose less than `window` nats of log posterior, best first."""
    return _listed(*explore(problem, active[None, :].copy(), STAY, window)[1])


def _listed(out: Ints, into: Ints, gains: Floats) -> list[Move]:
    """The results of `_moves` as a list of moves, best first."""
    order = np.argsort(-gains, kind="stable")
    return [
        Move(float(gains[k]), int(out[k]) if out[k] >= 0 else None, int(into[k]) if into[k] >= 0 else None)
        for k in order
    ]


@kernel
def greedy_start(p: Problem, size: int) -> Bools:
    """Forward selection: terms activated one by one, each time the one that lowers the squared error most."""
    terms = len(p.Dty)
    active = p.log_odds == math.inf
    T = swept(p, active)
    for _ in range(size):
        best, best_j = 0.0, -1
        for j in range(terms):
            if not active[j] and not math.isinf(p.log_odds[j]):
                drop = T.partial[j] * T.partial[j] / T.diagonal[j]
                if drop > best:
                    best, best_j = drop, j
        if best_j < 0:
            break
        flip(p, T, best_j)
        active[best_j] = True
    return active


def greedy_model(problem: Problem) -> Bools:
    """The local optimum that adding and dropping single terms reaches from the empty model: no swaps."""
    models = np.zeros((1, len(problem.Dty)), dtype=np.bool_)
    explore(problem, models, FLIP, -math.inf)
    return models[0]


def default_starts(problem: Problem) -> list[Bools]:
    """Models that a search climbs from: the empty one, and the full one or, with many terms, the RVM's support."""
    terms = len(problem.Dty)
    starts = [np.zeros(terms, dtype=np.bool_)]
    if terms <= FULL_START_TERMS:
        starts.append(np.ones(terms, dtype=np.bool_))
    elif terms <= RVM_START_TERMS:
        starts.append(rvm_gamma(problem) > 0.0)
    return starts


def candidate_models(problem: Problem, starts: list[Bools], window: float = 2.0, limit: int = 6) -> list[Bools]:
    """At most `limit` models within `window` nats of the best: optima reached from `starts`, neighbours of the best."""
    climbed = np.array(starts, dtype=np.bool_)
    scores, moves = explore(problem, climbed, SWAP, window)
    found = _ranked(scores, climbed)
    top, best = found[0]
    pool = [(value - top, model) for value, model in found[1:] if value > top - window]
    pool += [(move.gain, move.apply(best)) for move in _listed(*moves)]
    pool.sort(key=lambda entry: -entry[0])
    models = {best.tobytes(): best}
    for _, model in pool:
        models.setdefault(model.tobytes(), model)
    return list(models.values())[:limit]
