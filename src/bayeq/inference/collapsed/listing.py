"""Many models at once: best-first search and exhaustive enumeration on the collapsed tableau.

The posterior over models is known up to a constant, eq. (34). Best-first search (after Occam's window, Madigan and
Raftery 1994) keeps every model seen, takes the likeliest whose neighbours have not been looked at, and adds those:
each flip and each swap is O(1) on the tableau. It stops when what is left to find is negligible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.tableau import drifted, flip, flip_gains, renew, score, swap_gains, swept
from bayeq.kernels import kernel

# Up to this many free terms all models are enumerated.
ENUMERATE = 14

Words = NDArray[np.uint64]

# Models less likely than the best by more nats are counted as mass left out and not kept.
KEEP = 18.0

# The estimate of the mass left out is multiplied by this, so as to err upwards; the yield of the latest expansions
# in it fades by this factor per expansion.
CAUTION = 3.0
MEMORY = 0.95

# Room for models: this many, or as many as fit into this many bytes.
FIRST_ROOM = 8192
MOST_MODELS = 200_000
MOST_BYTES = 100_000_000

# Moves that a search looks at, at 20 to 100 ns each. A posterior that needs more is spread over too many models to
# list; the inclusion probabilities given the other terms, averaged over those looked at, are exact to 0.0005 after half
# as many (200 and 2,000 correlated terms, against chains of 2,000 to 40,000 samples).
MOST_MOVES = 2_000_000

# Models less likely than the best by more nats have no mass.
FORGET = 40.0


@dataclass(frozen=True, slots=True)
class ModelSet:
    """Models with their log posteriors."""

    models: Bools  # (K, P), best first
    log_posterior: Floats  # (K,), up to the constant of `search.log_constant`
    # share of the posterior mass outside the set: 0 if all models were enumerated, otherwise an estimate that errs
    # upwards
    left_out: float
    expanded: int  # models all of whose neighbours were looked at
    contradicted: tuple[int, ...] = ()  # terms whose known signs or bounds the data contradict
    # (P,), of a search: the probability of each term given the others, averaged over the models whose neighbours were
    # looked at (Rao and Blackwell's estimate). Of terms that hardly depend on each other it needs few models where
    # the listing needs all of their combinations.
    inclusion: Floats | None = None

    @property
    def listed(self) -> Floats:
        """Inclusion probabilities within the set, (P,)."""
        return np.minimum(shares(self.models, self.weights), 1.0)

    def pip(self, tolerance: float) -> tuple[Floats, bool]:
        """Inclusion probabilities, (P,), and whether they are known to a tolerance.

        Where the set leaves out more than the tolerance they are the average of those given the other terms, and known
        if the set itself says the same: two estimates of one number, of which this is the better one.
        """
        listed = self.listed
        if self.left_out <= tolerance * (1.0 + 1e-9) or self.inclusion is None:
            return listed, self.left_out <= tolerance * (1.0 + 1e-9)
        return self.inclusion, bool(np.abs(self.inclusion - listed).max() <= tolerance)

    @property
    def weights(self) -> Floats:
        """Posterior probabilities within the set, (K,)."""
        w = np.exp(self.log_posterior - self.log_posterior[0])
        return w / w.sum()


@kernel
def shares(models: Bools, weights: Floats) -> Floats:
    """The weight of the models that each term is in, (P,): ``weights @ models``, which would convert all of these."""
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


def enumerate_models(problem: Problem) -> ModelSet:
    """All models, each by a Cholesky factor of its own. Meant for up to about 20 terms that are neither forced nor
    forbidden."""
    free = np.flatnonzero(np.isfinite(problem.log_odds))
    base = problem.log_odds == math.inf
    levels = model_scores(problem, free, base)
    order = np.argsort(-levels, kind="stable")
    # models too unlikely to matter in double precision are dropped
    order = order[levels[order] > levels[order[0]] - 40.0]
    models = np.repeat(base[None, :], len(order), axis=0)
    for bit, j in enumerate(free):
        models[:, j] = (order >> bit) & 1
    return ModelSet(models, levels[order], 0.0, len(levels))


@kernel
def _find(table: Ints, keys: Words, key: np.uint64) -> int:
    """Slot of `key` in the open-addressing table: where it is, or the empty slot where it belongs."""
    mask = np.uint64(len(table) - 1)
    slot = key & mask
    while table[slot] >= 0 and keys[table[slot]] != key:
        slot = (slot + np.uint64(1)) & mask
    return int(slot)


@kernel
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


# One loop whose state (heap, table of models, tableau) would have to be passed on by every part of it.
@kernel
def _search(
    p: Problem, starts: Bools, start_scores: Floats, zobrist: Words, room: int, tolerance: float, keep: float
) -> tuple[Bools, Floats, float, int, Floats]:
    """Best-first search; returns models, scores, the estimate of the mass left out, the number expanded, and the
    inclusion probabilities given the other terms, averaged over these."""
    terms = len(p.Dty)
    models = np.empty((room, terms), np.bool_)
    scores = np.empty(room)
    keys = np.empty(room, np.uint64)
    slots = 1
    while slots < 2 * room:
        slots *= 2
    table, heap = np.empty(slots, np.int64), np.empty(room, np.int64)
    for slot in range(slots):
        table[slot] = -1
    count = size = np.int64(0)  # as literal zeros they would make numba compile the heap for literals too
    top = start_scores[0]
    for k in range(len(starts)):
        key = np.uint64(0)
        for j in range(terms):
            if starts[k, j]:
                key ^= zobrist[j]
        slot = _find(table, keys, key)
        if table[slot] < 0:
            table[slot] = count
            for j in range(terms):
                models[count, j] = starts[k, j]
            scores[count] = start_scores[k]
            keys[count] = key
            _push(heap, size, scores, count)
            size += 1
            count += 1
            top = max(top, start_scores[k])
    # masses relative to exp(top of the starts): of all models kept, of the frontier, and too small to keep
    reference = top
    total = frontier = dropped = 0.0
    for k in range(count):
        total += math.exp(scores[k] - reference)
    frontier = total
    recent_found = recent_spent = all_found = all_spent = 0.0
    current = np.empty(terms, np.bool_)
    for j in range(terms):
        current[j] = starts[0, j]
    T = swept(p, current)
    expanded = moves = 0
    inclusion, looked_at = np.zeros(terms), 0.0
    gains = np.empty(terms)
    ratio = 1.0
    while size > 0 and count < room and moves < MOST_MOVES:
        # what an expansion of the frontier is likely to bring in all, by the yield of recent expansions
        if CAUTION * frontier * ratio / (1.0 - min(ratio, 0.9)) + dropped < tolerance * total:
            break
        item = _pop(heap, size, scores)
        size -= 1
        for j in range(terms):
            if models[item, j] != current[j]:
                flip(p, T, j)
                current[j] = not current[j]
        if drifted(p, T):
            renew(p, T, current)
        spent = math.exp(scores[item] - reference)
        found = 0.0
        frontier -= spent
        expanded += 1
        for i in range(-1, terms):
            # i < 0: flips of single terms; otherwise swaps of the active term i
            if i < 0:
                flip_gains(p, T, gains)
                looked_at += spent
                for j in range(terms):
                    odds = -gains[j] if current[j] else gains[j]
                    if odds > -FORGET:
                        inclusion[j] += spent / (1.0 + math.exp(-odds))
                    elif gains[j] == -math.inf and current[j]:
                        inclusion[j] += spent
            elif current[i]:
                swap_gains(p, T, i, gains)
            else:
                continue
            moves += terms
            for j in range(terms):
                if gains[j] == -math.inf:
                    continue
                key = keys[item] ^ zobrist[j]
                if i >= 0:
                    key ^= zobrist[i]
                value = scores[item] + gains[j]
                if value < top - keep:
                    # met more than once, and so counted: the estimate of what is left out errs upwards
                    if value > top - FORGET:
                        dropped += math.exp(value - reference)
                    continue
                slot = _find(table, keys, key)
                if table[slot] >= 0:
                    continue
                mass = math.exp(value - reference)
                if count == room:
                    frontier += mass
                    continue
                table[slot] = count
                for k in range(terms):
                    models[count, k] = current[k]
                models[count, j] = not current[j]
                if i >= 0:
                    models[count, i] = False
                scores[count] = value
                keys[count] = key
                _push(heap, size, scores, count)
                size += 1
                count += 1
                top = max(top, value)
                found += mass
        total += found
        frontier += found
        recent_found = MEMORY * recent_found + found
        recent_spent = MEMORY * recent_spent + spent
        # at least half of what the whole search has yielded per mass spent, for a lull may be chance
        all_found += found
        all_spent += spent
        ratio = max(recent_found / recent_spent, 0.5 * all_found / all_spent, 1e-3)
    left = dropped
    if size > 0 or count == room:
        left += CAUTION * frontier * ratio / (1.0 - min(ratio, 0.9))
    return models[:count], scores[:count], left / (total + left), expanded, inclusion / max(looked_at, 1e-300)


def search_models(problem: Problem, tolerance: float = 5e-3) -> ModelSet:
    """Models that hold all but a share `tolerance` of the posterior mass, from the local optima of `best_models` on.

    The search also ends when the room for models or the number of moves is used up: `left_out` then tells.
    """
    found, terms = best_models(problem), len(problem.Dty)
    most = int(min(MOST_MODELS, max(1000, MOST_BYTES // max(terms, 1))))
    zobrist = np.random.default_rng(0x5EED).integers(1, 2**63, size=terms, dtype=np.uint64)
    starting = np.array([model for _, model in found], dtype=np.bool_)
    values = np.array([value for value, _ in found])
    room = min(FIRST_ROOM, most)
    while True:
        models, scores, left, expanded, inclusion = _search(problem, starting, values, zobrist, room, tolerance, KEEP)
        if left <= tolerance or room == most or len(models) < room:
            break
        # rarely needed, and cheaper than to clear a large table every time
        room = min(16 * room, most)
    order = np.argsort(-scores, kind="stable")
    return ModelSet(models[order], scores[order], float(left), int(expanded), inclusion=inclusion)


def list_models(problem: Problem, tolerance: float, enumerate_up_to: int = ENUMERATE) -> ModelSet:
    """All models of few free terms, or those that hold all but `tolerance` of the posterior mass."""
    if int(np.isfinite(problem.log_odds).sum()) <= enumerate_up_to:
        return enumerate_models(problem)
    return search_models(problem, tolerance=tolerance)
