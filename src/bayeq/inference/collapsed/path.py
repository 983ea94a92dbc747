"""The size path: the best model of each size, and the share of variance that each term of a model explains.

Where the model is only nearly true, more rows make more and more terms certain. The path shows what each further term
gains, and where the gain stops.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError, whole_number
from bayeq.inference.collapsed.listing import ENUMERATE, enumerate_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import STAY, best_models, explore, log_constant, scores_of
from bayeq.inference.collapsed.tableau import MOST_ACTIVE
from bayeq.inference.gram import Gram

# Number of terms up to which a path goes by default, three times as many as equations of motion usually have.
DEFAULT_MOST = 12

# Models of each size whose neighbours are evaluated: with 20 none of the best models of 5,500 sizes of hard problems
# was missed, with 6 three were.
WIDTH = 20

# Gains below this are rounding.
TOLERANCE = 1e-9

# Added to the diagonal of a correlation matrix: its least eigenvalue is less where columns depend on each other.
DEPENDENT = 1e-12

# Where limits are known, neighbours more than this many nats below the best get only an upper bound of their score.
WINDOW = 40.0


def path_sizes(problem: Problem, most: int | None = None) -> range:
    """Sizes that a path goes through: from the number of forced terms to `most`, or an InputError if that is less."""
    forced = int(np.sum(problem.log_odds == math.inf))
    allowed = min(int(np.sum(problem.log_odds > -math.inf)), MOST_ACTIVE)
    if most is None:
        most = max(DEFAULT_MOST, forced)
    most = whole_number("the largest number of terms", most, 0)
    if most < forced:
        raise InputError(f"at most {most} terms are asked for, but {forced} are forced in by a prior inclusion of 1")
    return range(forced, min(most, allowed) + 1)


def best_of_each_size(
    problem: Problem, most: int | None = None, starts: Iterable[Bools] = (), limits: Floats | None = None
) -> list[tuple[Bools, float]]:
    """The model of each size with the highest log posterior (34), the smallest first, each with its ln p(y, z).

    With at most 14 free terms and no limits (P, 2) all models are evaluated. Otherwise the best few of each size are
    kept, and the models that have a term more, a term less or a term swapped are evaluated, until none is better (a
    forward and backward selection with exchanges, Pudil, Novovicova and Kittler 1994, on the exact posterior);
    `starts`, (P,) bool each, are further models to start from. Sizes are those of `path_sizes`.
    """
    sizes = path_sizes(problem, most)
    if limits is None and int(np.isfinite(problem.log_odds).sum()) <= ENUMERATE:
        found = _by_enumeration(problem, sizes)
    else:
        found = _by_search(problem, sizes, starts, limits)
    return [(model, model_log_posterior(problem, model, limits)) for model in found]


def best_without_one(problem: Problem, active: Bools, limits: Floats | None = None) -> Bools:
    """The model with the highest log posterior (34) among those of one term fewer; forced terms stay."""
    free = np.flatnonzero(active & (problem.log_odds < math.inf))
    models = np.repeat(active[None, :], len(free), axis=0)
    models[np.arange(len(free)), free] = False
    return np.asarray(models[np.argmax(_scores(problem, models, limits))])


def model_log_posterior(problem: Problem, active: Bools, limits: Floats | None = None) -> float:
    """ln p(y, z) of one model, eq. (34) and the prior of z, truncated at limits (P, 2) where these are known."""
    return float(_scores(problem, active[None, :], limits)[0]) + log_constant(problem)


def _scores(problem: Problem, models: Bools, limits: Floats | None) -> Floats:
    """Log posteriors (K,) of models up to `search.log_constant`, truncated at limits (P, 2) where these are known."""
    if limits is None:
        return scores_of(problem, models)
    from bayeq.inference.signs import signed_scores

    return signed_scores(problem, limits, models, WINDOW)[1]


def _by_enumeration(problem: Problem, sizes: range) -> list[Bools]:
    models = enumerate_models(problem, math.inf).models
    count = models.sum(axis=1)
    return [models[np.argmax(count == size)] for size in sizes]


def _offer(pool: dict[bytes, float], model: Bools, value: float) -> None:
    """Keep a model with its score in the pool of its size, if it is one of the best few."""
    key = model.tobytes()
    if key in pool or (len(pool) == WIDTH and not value > min(pool.values()) + TOLERANCE):
        return
    pool[key] = value
    if len(pool) > WIDTH:
        del pool[min(pool, key=pool.__getitem__)]


def _by_search(problem: Problem, sizes: range, starts: Iterable[Bools], limits: Floats | None = None) -> list[Bools]:
    pools: dict[int, dict[bytes, float]] = {size: {} for size in range(sizes.start, sizes.stop + 1)}
    expanded: set[bytes] = set()
    forced, forbidden = problem.log_odds == math.inf, problem.log_odds == -math.inf
    optima = [model for _, model in best_models(problem)]
    for start in [forced, *optima, *((model | forced) & ~forbidden for model in starts)]:
        # remove terms, each time the one whose removal costs least, so that every smaller size has a start too
        active = start.copy()
        for size in range(int(active.sum()), sizes.start - 1, -1):
            if size in pools:
                _offer(pools[size], active, float(_scores(problem, active[None, :], limits)[0]))
            if size > sizes.start:
                out, into, gains = explore(problem, active[None].copy(), STAY, math.inf)[1]
                active[out[np.argmax(np.where(into < 0, gains, -math.inf))]] = False
    while True:
        waiting = [(size, key) for size, pool in pools.items() for key in pool if key not in expanded]
        if not waiting:
            found = (max(pools[size], key=pools[size].__getitem__) for size in sizes)
            return [np.frombuffer(key, dtype=np.bool_).copy() for key in found]
        # the smallest first: they are the cheapest, and their neighbours improve the larger ones
        size, key = min(waiting, key=lambda one: (one[0], -pools[one[0]][one[1]]))
        expanded.add(key)
        active, here = np.frombuffer(key, dtype=np.bool_), pools[size][key]
        out, into, gains = explore(problem, active[None].copy(), STAY, math.inf)[1]
        for other in (size + 1, size - 1, size):
            if other not in pools:
                continue
            moves = np.flatnonzero((into >= 0) * 1 - (out >= 0) * 1 == other - size)
            if limits is None and len(moves) > WIDTH:
                moves = moves[np.argpartition(-gains[moves], WIDTH)[:WIDTH]]
            models = np.repeat(active[None, :], len(moves), axis=0)
            for terms, inside in ((out[moves], False), (into[moves], True)):
                rows = np.flatnonzero(terms >= 0)
                models[rows, terms[rows]] = inside
            values = here + gains[moves] if limits is None else _scores(problem, models, limits)
            for model, value in zip(models, values, strict=True):
                _offer(pools[other], model, float(value))


def partial_shares(gram: Gram, active: Bools) -> Floats:
    """Loss of R2 when a term is left out and the others are refitted by least squares, (P,); NaN for a term not in.

    With C the correlation matrix of the terms, c their correlations with y and b = C^-1 c, leaving out term i loses
    b_i^2/(C^-1)_ii. Terms that depend on each other lose nothing.

    Examples
    --------
    >>> D = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    >>> partial_shares(Gram.from_data(D, D @ [2.0, 1.0]), np.array([True, True])).round(6).tolist()
    [0.8, 0.2]
    """
    out = np.full(len(active), np.nan)
    index = np.flatnonzero(active)
    sd = np.sqrt(gram.diagonal[index])
    if not (gram.yty > 0.0 and (sd > 0.0).all()):
        out[index] = 0.0
        return out
    C = gram.DtD[np.ix_(index, index)] / np.outer(sd, sd)
    inverse = np.linalg.inv(C + DEPENDENT * np.eye(len(index)))
    b = inverse @ (gram.Dty[index] / sd / math.sqrt(gram.yty))
    out[index] = b**2 / np.diagonal(inverse)
    return out
