"""Many models at once: best-first search and exhaustive enumeration on the collapsed tableau.

The posterior over models is known up to a constant, eq. (34). Best-first search (after Occam's window, Madigan and
Raftery 1994) keeps every model seen, takes the likeliest whose neighbours have not been evaluated, and adds these:
each flip and each swap is O(1) on the tableau. It stops when the mass left to find is negligible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models, scores_of
from bayeq.inference.collapsed.tableau import flip_gains, move_to, score, swap_gains, swept
from bayeq.kernels import kernel

# Up to this many free terms all models are enumerated.
ENUMERATE = 14

Words = NDArray[np.uint64]

# Models less likely than the best by more nats are counted as mass left out and not kept.
KEEP = 18.0

# The estimate of the mass left out is multiplied by CAUTION, so as to err upwards. It uses the mass found per mass
# expanded, in which former expansions count less by the factor MEMORY for each later one.
CAUTION = 3.0
MEMORY = 0.95

# Models that a search has room for: at first FIRST_ROOM, later MOST_MODELS or as many as fit into MOST_BYTES.
FIRST_ROOM = 8192
MOST_MODELS = 200_000
MOST_BYTES = 100_000_000

# Moves that a search evaluates, at 20 to 100 ns each. A posterior that needs more is spread over too many models to
# list; the inclusion probabilities given the other terms, averaged over the expanded models, are exact to 0.0005 after
# half as many (200 and 2,000 correlated terms, against chains of 2,000 to 40,000 samples).
MOST_MOVES = 2_000_000
# As many swaps that a bound rules out take the time of one that is evaluated.
CHEAPER = 10

# Models less likely than the best by more nats count as having no mass.
FORGET = 40.0


@dataclass(frozen=True, eq=False, slots=True)
class ModelSet:
    """Models with their log posteriors."""

    models: Bools  # (K, P), best first
    log_posterior: Floats  # (K,), up to the constant of `search.log_constant`
    # share of the posterior mass outside the set: 0 if all models were enumerated, otherwise an estimate that errs
    # upwards
    left_out: float
    expanded: int  # number of models all of whose neighbours were evaluated
    contradicted: tuple[int, ...] = ()  # terms whose known signs or bounds the data contradict
    # (P,), by a search: the probability of each term given the others, averaged over the expanded models (Rao and
    # Blackwell's estimate). Where terms are nearly independent, it needs few models, and a listing all of their
    # combinations.
    inclusion: Floats | None = None

    def pip(self, tolerance: float) -> tuple[Floats, Bools]:
        """Inclusion probabilities, (P,), and whether each is known to be right to `tolerance`, (P,).

        If the set leaves out more than that, they are `inclusion`, and known where the listed models agree with it.
        """
        # weights may sum to less than 1 by rounding
        listed = np.where(self.models.all(axis=0), 1.0, np.minimum(shares(self.models, self.weights), 1.0))
        if self.left_out <= tolerance * (1.0 + 1e-9) or self.inclusion is None:
            return listed, np.full(len(listed), self.left_out <= tolerance * (1.0 + 1e-9))
        return self.inclusion, np.abs(self.inclusion - listed) <= tolerance

    @property
    def weights(self) -> Floats:
        """Posterior probabilities within the set, (K,)."""
        w = np.exp(self.log_posterior - self.log_posterior[0])
        return w / w.sum()


def distinct(models: Bools) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First places of the different models among M, (M, P), sorted as numbers of their bits; the number of each, (M,).

    Like `numpy.unique` by `axis`, which takes ten times as long.
    """
    packed = np.packbits(models, axis=1)
    keys = np.ascontiguousarray(packed).view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, first, same = np.unique(keys, return_index=True, return_inverse=True)
    return first, same


def summed(models: Bools, probability: Floats) -> tuple[Bools, Floats]:
    """The different models among M, (M, P), the most probable first, and their probabilities summed over equals."""
    first, same = distinct(models)
    total: Floats = np.bincount(same, weights=probability).astype(np.float64)
    order = np.argsort(-total, kind="stable")
    return models[first[order]], total[order]


@kernel
def shares(models: Bools, weights: Floats) -> Floats:
    """Sum of the weights of the models that hold each term, (P,): ``weights @ models`` without converting `models`."""
    out = np.zeros(models.shape[1])
    for k in range(len(models)):
        for j in range(models.shape[1]):
            if models[k, j]:
                out[j] += weights[k]
    return out


@kernel
def model_scores(p: Problem, free: Ints, base: Bools) -> Floats:
    """Scores of all models over the `free` terms; bit k of entry g tells whether `free[k]` is in."""
    levels = np.empty(1 << len(free))
    current = base.copy()
    for g in range(len(levels)):
        for k in range(len(free)):
            current[free[k]] = (g >> k) & 1 == 1
        levels[g] = score(p, current, p.slab_variance)
    return levels


def enumerate_models(problem: Problem, window: float = FORGET) -> ModelSet:
    """All models of up to some 20 free terms, except those more than `window` nats less likely than the best."""
    free = np.flatnonzero(np.isfinite(problem.log_odds))
    base = problem.log_odds == math.inf
    levels = model_scores(problem, free, base)
    order = np.argsort(-levels, kind="stable")
    order = order[levels[order] > levels[order[0]] - window]
    models = np.repeat(base[None, :], len(order), axis=0)
    for bit, j in enumerate(free):
        models[:, j] = (order >> bit) & 1
    return ModelSet(models, levels[order], 0.0, len(levels))


@kernel(borrowing=True)
def _find(table: Ints, keys: Words, key: np.uint64) -> int:
    """Slot of `key` in the open-addressing hash table, or the empty slot where it is to be put."""
    mask = np.uint64(len(table) - 1)
    slot = key & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + np.uint64(1)) & mask
    return int(slot)


@kernel(borrowing=True)
def _push(heap: Ints, size: int | np.int64, scores: Floats, item: int | np.int64) -> None:
    heap[size] = item
    k = size
    while k > 0:
        parent = (k - 1) // 2
        if scores[heap[parent]] >= scores[heap[k]]:
            break
        heap[parent], heap[k] = heap[k], heap[parent]
        k = parent


@kernel
def _pop(heap: Ints, size: int | np.int64, scores: Floats) -> int:
    top = heap[0]
    heap[0] = heap[size - 1]
    k = 0
    while True:
        child = 2 * k + 1
        if child >= size - 1:
            break
        if child + 1 < size - 1 and scores[heap[child + 1]] > scores[heap[child]]:
            child += 1
        if scores[heap[k]] >= scores[heap[child]]:
            break
        heap[child], heap[k] = heap[k], heap[child]
        k = child
    return top


class _Listing(NamedTuple):
    """Models found (room, P), their scores and keys, a hash table, a heap of models to expand; counts of both."""

    models: Bools
    scores: Floats
    keys: Words
    table: Ints
    heap: Ints
    counts: Ints


def _listing(room: int, terms: int) -> _Listing:
    models, scores, keys = np.empty((room, terms), np.bool_), np.empty(room), np.empty(room, np.uint64)
    slots = 1 << (2 * room - 1).bit_length()
    table, heap = np.full(slots, -1, np.int64), np.empty(room, np.int64)
    return _Listing(models, scores, keys, table, heap, np.zeros(2, np.int64))


@kernel(borrowing=True)
def _add(listing: _Listing, model: Bools, i: int, j: int, key: np.uint64, score: float) -> bool:
    """List a model with term j flipped and term i taken out (-1: neither); False if it was listed before."""
    models, scores, keys, table, heap, counts = listing
    slot, count = _find(table, keys, key), counts[0]
    if table[slot] >= 0:
        return False
    if count < len(models):
        table[slot] = count
        for k in range(len(model)):
            models[count, k] = model[k]
        if j >= 0:
            models[count, j] = not model[j]
        if i >= 0:
            models[count, i] = False
        scores[count] = score
        keys[count] = key
        _push(heap, counts[1], scores, count)
        counts[0] += 1
        counts[1] += 1
    return True


@kernel(borrowing=True)
def _include(gains: Floats, current: Bools, weight: float, inclusion: Floats) -> None:
    """Add `weight` times each term's probability given the other terms of a model, which the gains of flips give."""
    for j in range(len(current)):
        odds = -gains[j] if current[j] else gains[j]
        if odds > -FORGET:
            inclusion[j] += weight / (1.0 + math.exp(-odds))
        elif gains[j] == -math.inf and current[j]:
            inclusion[j] += weight


@kernel
def _search(
    p: Problem,
    starts: Bools,
    start_scores: Floats,
    zobrist: Words,
    listing: _Listing,
    tolerance: float,
    keep: float,
    inclusion: Floats,
) -> tuple[float, int]:
    """Best-first search; returns the estimate of the mass left out and the number expanded, and fills `inclusion`."""
    models, scores, keys, _, heap, counts = listing
    terms = len(p.Dty)
    for k in range(len(starts)):
        key = np.uint64(0)
        for j in range(terms):
            if starts[k, j]:
                key ^= zobrist[j]
        _add(listing, starts[k], -1, -1, key, start_scores[k])
    # masses relative to exp(top of the starts): of all models kept, of the frontier, and too small to keep
    reference = top = start_scores.max()
    total = frontier = np.exp(scores[: counts[0]] - reference).sum()
    recent_found = recent_spent = all_found = all_spent = looked_at = dropped = 0.0
    current, gains, ratio = starts[0].copy(), np.empty(terms), 1.0
    T = swept(p, current)
    expanded = moves = 0
    while counts[1] > 0 and counts[0] < len(models) and moves < MOST_MOVES:
        # the mass that expanding the frontier is likely to add in total, by the yield of recent expansions
        if CAUTION * frontier * ratio / (1.0 - min(ratio, 0.9)) + dropped < tolerance * total:
            break
        item = _pop(heap, counts[1], scores)
        counts[1] -= 1
        spent, found = math.exp(scores[item] - reference), 0.0
        frontier -= spent
        expanded += 1
        if not move_to(p, T, current, models[item]):  # columns are nearly dependent: gains of its moves are rounding
            dropped += CAUTION * spent
            continue
        looked_at += spent
        for i in range(-1, terms):
            # i < 0: flips of single terms; otherwise swaps of the active term i
            if i < 0:
                flip_gains(p, T, gains)
                _include(gains, current, spent, inclusion)
                moves += terms
            elif current[i]:
                moves += swap_gains(p, T, i, top - FORGET - scores[item], gains) + terms // CHEAPER
            else:
                continue
            for j in range(terms):
                value = scores[item] + gains[j]
                if value < top - keep:
                    # counted each time that it is met: the estimate of the mass left out errs upwards
                    if value > top - FORGET:
                        dropped += math.exp(value - reference)
                    continue
                key = keys[item] ^ zobrist[j] ^ (zobrist[i] if i >= 0 else np.uint64(0))
                full = counts[0] == len(models)
                if _add(listing, current, i, j, key, value):
                    mass = math.exp(value - reference)
                    if full:
                        frontier += mass
                    else:
                        found += mass
                        top = max(top, value)
        total += found
        frontier += found
        recent_found = MEMORY * recent_found + found
        recent_spent = MEMORY * recent_spent + spent
        # mass found per mass expanded, at least half of that of the whole search, for a lull may be chance
        all_found += found
        all_spent += spent
        ratio = max(recent_found / recent_spent, 0.5 * all_found / all_spent, 1e-3)
    inclusion /= max(looked_at, 1e-300)
    left = dropped
    if counts[1] > 0 or counts[0] == len(models):
        left += CAUTION * frontier * ratio / (1.0 - min(ratio, 0.9))
    return left / (total + left), expanded


def search_models(problem: Problem, tolerance: float = 5e-3, known: Sequence[Bools] = ()) -> ModelSet:
    """Models that hold all but a share `tolerance` of the mass, or less (see `left_out`) if room or moves run out.
    The search starts from the local optima of `best_models`, to which `known` models climb too."""
    found, terms = best_models(problem, known), len(problem.Dty)
    most = int(min(MOST_MODELS, max(1000, MOST_BYTES // max(terms, 1))))
    zobrist = np.random.default_rng(0x5EED).integers(1, 2**63, size=terms, dtype=np.uint64)
    starting = np.array([model for _, model in found], dtype=np.bool_)
    values = np.array([value for value, _ in found])
    room = min(FIRST_ROOM, most)
    while True:
        listing, inclusion = _listing(room, terms), np.zeros(terms)
        left, expanded = _search(problem, starting, values, zobrist, listing, tolerance, KEEP, inclusion)
        count = int(listing.counts[0])
        best = int(np.argmax(listing.scores[:count]))
        if not math.isfinite(left):  # masses relative to the starts overflow
            again = listing.models[best : best + 1].copy()
            likelier = scores_of(problem, again)
            if likelier[0] > values.max():
                starting, values = again, likelier
                continue
        if left <= tolerance or room == most or count < room:
            break
        # a second search is rarely needed, and cheaper than clearing a large table every time
        room = min(16 * room, most)
    order = np.argsort(-listing.scores[:count], kind="stable")
    left = left if math.isfinite(left) else 1.0
    # `inclusion` is 0 if rounding spoils all models with mass
    given = inclusion if inclusion.any() else None
    return ModelSet(listing.models[order], listing.scores[order], left, expanded, inclusion=given)


def list_models(
    problem: Problem, tolerance: float = 5e-3, enumerate_up_to: int = ENUMERATE, known: Sequence[Bools] = ()
) -> ModelSet:
    """All models of up to `enumerate_up_to` free terms; of more, models that hold all but `tolerance` of the mass.

    The search for the latter starts from `known` models too.
    """
    if int(np.isfinite(problem.log_odds).sum()) <= enumerate_up_to:
        return enumerate_models(problem)
    return search_models(problem, tolerance, known)
