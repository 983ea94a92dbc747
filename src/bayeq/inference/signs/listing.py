"""Listing models whose coefficients have known signs.

As in `inference.models`, but with the factor of `inference.signs` in every weight: the models that are likely with the
signs may be far from those that are likely without.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from bayeq.inference.collapsed.listing import CAUTION, KEEP, MEMORY, MOST_BYTES, MOST_MOVES, ModelSet
from bayeq.inference.collapsed.problem import Bools, Ints, Problem
from bayeq.inference.collapsed.search import Move, best_models, neighbours
from bayeq.inference.collapsed.tableau import flip_gains, swap_gains, swept
from bayeq.inference.signs.truncation import signed_scores
from bayeq.kernels import kernel

__all__ = ["list_signed", "signed_neighbours"]

# Enumerated models less likely than the best by more nats are dropped.
WINDOW = 40.0

# With several signs known each model takes an integral, and at most so many free terms are enumerated.
ENUMERATE_SEVERAL = 9

# Room for models of a search: a second or so is enough where more would be needed.
MOST_MODELS = 8192

# When the best model is beaten by more nats, what the search has yielded so far was the way up.
CLIMB = 2.0


def list_signed(p: Problem, tolerance: float, enumerate_up_to: int) -> ModelSet:
    """All models of few free terms, or those that hold all but `tolerance` of the posterior mass."""
    most = enumerate_up_to if np.count_nonzero(p.signs) == 1 else min(enumerate_up_to, ENUMERATE_SEVERAL)
    if int(np.isfinite(p.log_odds).sum()) <= most:
        return _enumerate(p)
    return _Search(p).run(tolerance)


def _enumerate(p: Problem) -> ModelSet:
    free = np.flatnonzero(np.isfinite(p.log_odds))
    codes = np.arange(1 << len(free))
    codes ^= codes >> 1  # Gray code: from one to the next a single term changes
    models = np.repeat((p.log_odds == math.inf)[None, :], len(codes), axis=0)
    models[:, free] = (codes[:, None] >> np.arange(len(free))) & 1
    value = signed_scores(p, models, WINDOW)[1]
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > value[order[0]] - WINDOW]
    return ModelSet(models[order], value[order], 0.0, len(models))


@kernel
def _moves(p: Problem, active: Bools, least: float) -> tuple[Ints, Ints, float]:
    """Flips and swaps that gain at least `least`, as pairs of terms to flip (the second -1 for none).

    Of the other moves the sum of exp(gain - least).
    """
    terms = len(active)
    r = int(active.sum())
    one = np.empty(terms + r * (terms - r), dtype=np.int64)
    two = np.empty_like(one)
    T = swept(p, active)
    gain = np.empty(terms)
    count, rest = 0, 0.0
    for i in range(-1, terms):
        # i < 0: flips of single terms; otherwise swaps of the active term i
        if i < 0:
            flip_gains(p, T, gain)
        elif active[i]:
            swap_gains(p, T, i, gain)
        else:
            continue
        for j in range(terms):
            if gain[j] >= least:
                one[count], two[count] = j, i
                count += 1
            elif gain[j] > -math.inf:
                rest += math.exp(gain[j] - least)
    return one[:count], two[:count], rest


def _starts(p: Problem) -> Bools:
    """Local optima of the posterior without the signs, and of those that are left when terms of the wrong sign go."""
    found: list[Bools] = []
    while True:
        optima = [model for _, model in best_models(p)]
        found += optima
        T = swept(p, optima[0])
        wrong = optima[0] & (p.signs * T.partial < 0.0) & np.isfinite(p.log_odds)
        if not wrong.any():
            return np.unique(np.array(found), axis=0)
        p = p._replace(log_odds=np.where(wrong, -math.inf, p.log_odds))


class _Search:
    """Best-first search as in `models.search_models`. Masses are relative to the best model found so far."""

    def __init__(self, p: Problem) -> None:
        self.p = p
        self.room = int(min(MOST_MODELS, max(1000, MOST_BYTES // len(p.Dty))))
        self.seen: set[bytes] = set()
        self.models: list[Bools] = []
        self.without: list[float] = []
        self.value: list[float] = []
        self.heap: list[tuple[float, int]] = []
        self.top = -math.inf
        # of the models listed, of those not expanded, and of those too unlikely to list
        self.total = self.frontier = self.dropped = 0.0
        self._add(_starts(p))
        self._start_to_count()

    def run(self, tolerance: float) -> ModelSet:
        expanded = moves = 0
        while self.heap and len(self.models) < self.room and moves < MOST_MOVES:
            if self._to_come() + self.dropped < tolerance * self.total:
                break
            item = heapq.heappop(self.heap)[1]
            spent = math.exp(self.value[item] - self.top)
            self.frontier -= spent
            top, before = self.top, self.total
            moves += self._expand(item)
            expanded += 1
            if self.top > top + CLIMB:
                self._start_to_count()
            else:
                self._count(self.total - before * math.exp(top - self.top), spent * math.exp(top - self.top))
        full = bool(self.heap) or len(self.models) == self.room
        left = self.dropped + (self._to_come() if full else 0.0)
        value = np.array(self.value)
        order = np.argsort(-value, kind="stable")
        models = np.array(self.models, dtype=np.bool_)
        return ModelSet(models[order], value[order], left / (self.total + left), expanded)

    def _start_to_count(self) -> None:
        """Forget what expansions have yielded: it was the way up."""
        self.recent_found = self.recent_spent = self.all_found = self.all_spent = 0.0
        self.ratio = 1.0

    def _count(self, found: float, spent: float) -> None:
        """Update the mass that an expansion finds per mass that it spends."""
        self.recent_found = MEMORY * self.recent_found + found
        self.recent_spent = MEMORY * self.recent_spent + spent
        self.all_found += found
        self.all_spent += spent
        if self.recent_spent > 0.0:
            self.ratio = max(self.recent_found / self.recent_spent, 0.5 * self.all_found / self.all_spent, 1e-3)

    def _to_come(self) -> float:
        """What expanding the frontier is likely to bring in all."""
        return CAUTION * max(self.frontier, 0.0) * self.ratio / (1.0 - min(self.ratio, 0.9))

    def _expand(self, item: int) -> int:
        """Look at all neighbours of a model; returns how many."""
        active = self.models[item]
        # the factor of a neighbour is 2 to the number of its constrained terms at most
        most = math.log(2.0) * (1 + int(np.count_nonzero(active & (self.p.signs != 0))))
        least = self.top - KEEP - self.without[item] - most
        one, two, rest = _moves(self.p, active, least)
        self.dropped += rest * math.exp(-KEEP)
        models = np.repeat(active[None, :], len(one), axis=0)
        row = np.arange(len(one))
        models[row, one] ^= True
        swap = two >= 0
        models[row[swap], two[swap]] ^= True
        self._add(models)
        return len(active) * (1 + int(active.sum()))

    def _add(self, models: Bools) -> None:
        """List those models that are new and not too unlikely."""
        new = []
        for model in models:
            key = model.tobytes()
            if key not in self.seen:
                self.seen.add(key)
                new.append(model)
        if not new:
            return
        without, value = signed_scores(self.p, np.array(new), KEEP, self.top)
        if value.max() > self.top:
            fall = math.exp(self.top - float(value.max()))
            self.total, self.frontier, self.dropped = self.total * fall, self.frontier * fall, self.dropped * fall
            self.top = float(value.max())
        for k in np.argsort(-value, kind="stable"):
            mass = math.exp(value[k] - self.top)
            if value[k] < self.top - KEEP:
                self.dropped += mass
                continue
            self.frontier += mass
            if len(self.models) < self.room:
                heapq.heappush(self.heap, (-float(value[k]), len(self.models)))
                self.models.append(new[k])
                self.without.append(float(without[k]))
                self.value.append(float(value[k]))
                self.total += mass


def signed_neighbours(p: Problem, active: Bools, window: float) -> list[Move]:
    """`search.neighbours` with the posterior odds that the signs leave."""
    constrained = p.signs != 0
    own_without, own = signed_scores(p, active[None, :], math.inf)
    most = math.log(2.0) * (1 + int(np.count_nonzero(active & constrained)))
    # a model gains ln of its factor less ln of the factor of `active`
    moves = neighbours(p, active, window + most + float(own_without[0] - own[0]))
    if not moves:
        return []
    value = signed_scores(p, np.array([move.apply(active) for move in moves]), window, float(own[0]))[1]
    gains = value - own[0]
    order = [k for k in np.argsort(-gains, kind="stable") if gains[k] > -window]
    return [Move(float(gains[k]), moves[k].leaves, moves[k].enters) for k in order]
