"""Listing models whose coefficients have known signs, their weights multiplied by the probability of right signs.

Where the data agree with the signs, the models are those that are likely without them. Where the data contradict a
sign the mass lies elsewhere, at models that may be unlikely without it: a best-first search finds them.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from bayeq.inference.collapsed.listing import KEEP, ModelSet, list_models
from bayeq.inference.collapsed.problem import Bools, Ints, Problem
from bayeq.inference.collapsed.search import best_models, neighbours
from bayeq.inference.collapsed.tableau import swept
from bayeq.inference.signs.truncation import Truncation, signed_scores

__all__ = ["list_signed"]

# Room for models of the search, some two seconds; and models that it starts from.
MOST_MODELS = 20_000
STARTS = 100

# The data contradict the signs if the Bayes factor against these is more than a hundred.
CONTRADICTED = math.log(100.0)


def list_signed(p: Problem, signs: Ints, tolerance: float, enumerate_up_to: int) -> ModelSet:
    """Models that hold all but `tolerance` of the posterior mass, and whether the data contradict the signs.

    First the models that are likely whatever the signs are listed, a constrained term with the odds of a half normal
    slab on either side. The weight of a model with the signs is at most this one, which bounds what is left out. They
    are the answer if the signs are right in at least half of their mass, otherwise a start of the search.
    """
    either = p._replace(log_odds=p.log_odds + math.log(2.0) * np.abs(signs))
    # half of the mass at least is kept, so that what is left out may have twice its share
    found = list_models(either, 0.5 * tolerance, enumerate_up_to)
    without, value = signed_scores(p, signs, found.models, KEEP)
    order = np.argsort(-value, kind="stable")
    right = float(np.exp(value - without[0]).sum() / np.exp(without - without[0]).sum())
    if right >= 0.5:
        left = found.left_out / (found.left_out + (1.0 - found.left_out) * right)
        return ModelSet(found.models[order], value[order], left, found.expanded)
    listed = _search(p, signs, either, [*found.models[order[:STARTS]], *_starts(either, signs)], tolerance)
    # where its sign is not known a constrained term has the odds of any other
    free = without - math.log(2.0) * np.count_nonzero(found.models & (signs != 0), axis=1)
    if logsumexp(free) - logsumexp(listed.log_posterior) < CONTRADICTED:
        return listed
    truncation, wrong = Truncation(p, signs, found.models[:STARTS]), np.zeros(len(signs))
    np.add.at(wrong, truncation.terms, found.weights[:STARTS, None] * truncation.wrong)
    return replace(listed, contradicted=tuple(np.flatnonzero(wrong > 0.5 * wrong.max()).tolist()))


def _starts(p: Problem, signs: Ints) -> list[Bools]:
    """Local optima without the signs, terms of the wrong sign taken out until there is none."""
    found: list[Bools] = []
    while True:
        optima = [model for _, model in best_models(p)]
        found += optima
        wrong = optima[0] & (signs * swept(p, optima[0]).partial < 0.0) & np.isfinite(p.log_odds)
        if not wrong.any():
            return found
        p = p._replace(log_odds=np.where(wrong, -math.inf, p.log_odds))


def _search(p: Problem, signs: Ints, either: Problem, new: list[Bools], tolerance: float) -> ModelSet:
    """Best-first search by the weights with the signs: half of the mass not expanded yet is expanded at a time."""
    seen: set[bytes] = set()
    models, waiting = np.empty((0, len(signs)), dtype=np.bool_), np.empty(0, dtype=np.bool_)
    without, value, expanded = np.empty(0), np.empty(0), 0
    while True:
        unseen = {model.tobytes(): model for model in new if model.tobytes() not in seen}
        if unseen:
            seen.update(unseen)
            fresh = np.array(list(unseen.values()))
            scores = signed_scores(p, signs, fresh, KEEP, value.max(initial=-math.inf))
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
