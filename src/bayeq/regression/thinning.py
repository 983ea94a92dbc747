"""The Gram of rows: without the known noise of inputs, and of as many rows as their residuals are worth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bayeq.gram import Gram
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.regression.residuals import Residuals
from bayeq.regression.settings import REGRESSION

# Fits that find what residuals are worth, and the coefficients of the inputs.
PILOTS = 3

# No more than this share of a column's sum of squares is subtracted as noise.
MOST_NOISE = 0.5


def _pilot(gram: Gram) -> Posterior:
    standard = gram.standardise(residual_scale(gram))
    prior = Prior()
    prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    best = [model for _, model in best_models(Problem.of(standard.gram, prior))]
    return spike_slab_vb(standard.gram, prior, models=best).rescaled(standard)


def without_noise(gram: Gram, noise: Mapping[int, float]) -> Gram:
    """The Gram of rows without the known noise variances of columns that are inputs themselves.

    It is in the residual all the same, times the square of the coefficient.
    """
    removed = np.zeros(len(gram.names))
    for j, variance in noise.items():
        removed[j] = min(gram.n * variance, MOST_NOISE * gram.DtD[j, j])
    if not removed.any():
        return gram
    less = replace(gram, DtD=gram.DtD - np.diag(removed))
    found = less
    for _ in range(PILOTS):
        coef = _pilot(found).coef
        found = replace(less, yty=gram.yty + float(coef**2 @ removed))
    return found


def thinned_gram(gram: Gram, residuals: Callable[[Posterior], Residuals]) -> Gram:
    """The Gram of as many rows as the residuals are worth: where they are correlated, N_eff rows instead of N.

    The likelihood is raised to the power N_eff/N, which widens intervals and asks more evidence of a term. Found in
    turn, since a model of fewer terms leaves residuals that are more correlated. What a rejected model leaves, one that
    explains less than half of the target, is the motion itself: no row is discounted by that.

    Parameters
    ----------
    gram : Gram
        Of all rows.
    residuals : callable
        Inspection of the residuals that a posterior leaves, in order of time.
    """
    share = 1.0
    for _ in range(PILOTS):
        model = _pilot(gram.raised(_least(gram, share)))
        if gram.squared_error(model.coef) > REGRESSION.rejected * gram.yty:
            return gram
        found = residuals(model)
        share = found.n_eff / found.n if found.correlated else 1.0
        if share == 1.0:
            break
    return gram.raised(_least(gram, share))


def _least(gram: Gram, share: float) -> float:
    """The share, but at least as many rows as leave a regression."""
    return min(max(share, 3.0 / gram.n), 1.0)
