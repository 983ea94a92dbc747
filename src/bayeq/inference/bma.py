"""Bayesian model averaging on the collapsed marginal likelihood (34): exact weights, no sampling.

A few terms are averaged over all models by Gray-code enumeration, more over the models that a best-first search finds
to hold nearly all of the mass (`inference.models`).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import GramLike
from bayeq.inference.collapsed.conditional import exact_posterior
from bayeq.inference.collapsed.listing import ModelSet, enumerate_models, search_models
from bayeq.inference.collapsed.problem import Bools, Floats, Ints, Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.tableau import active_block, drifted, flip, renew, swept
from bayeq.inference.posterior import ModelAverage, Posterior
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

__all__ = ["average_models", "mean_noise_variance", "sample_average", "spike_slab_bma"]

# Up to this many free terms all models are enumerated.
ENUMERATE = 14

# Models beyond this share of the mass add nothing to moments that a user could see.
MOMENT_MASS = 1e-6

# Models in the moments of a listing that is not complete: so many, or as many as keep models times terms below this.
MOMENT_MODELS = 100
MOMENT_WORK = 2_000_000

# The covariance over all models is kept for this many terms, the likeliest.
MOST_COVARIANCES = 1000


@kernel
def _mixture_moments(
    p: Problem, models: Bools, weights: Floats, place: Ints, count: int
) -> tuple[Floats, Floats, Floats, float]:
    """Mean and second moment (P,) of theta, its second moments (Q, Q), and the mean of sigma^2 over weighted models.

    `place` (P,) gives the place of each term among the Q = `count`, -1 where it has none. Each model's moments are
    entries of the tableau swept on it; the flips lead from one model to the next.
    """
    terms = len(p.Dty)
    mean, square, second, noise = np.zeros(terms), np.zeros(terms), np.zeros((count, count)), 0.0
    current = np.zeros(terms, dtype=np.bool_)
    T = swept(p, current)
    for k in range(len(models)):
        for j in range(terms):
            if models[k, j] != current[j]:
                flip(p, T, j)
                current[j] = not current[j]
        if drifted(p, T):
            renew(p, T, current)
        variance = 0.5 * max(T.diagonal[terms], p.floor) / max(p.h - 1.0, 0.5)
        noise += weights[k] * variance
        for m in range(T.size[0]):
            a = T.term[m]
            mean[a] += weights[k] * T.partial[a]
            square[a] += weights[k] * (T.partial[a] * T.partial[a] - variance * T.diagonal[a])
            if place[a] < 0:
                continue
            for n in range(T.size[0]):
                b = T.term[n]
                if place[b] >= 0:
                    value = T.partial[a] * T.partial[b] - variance * T.rows[m, b]
                    second[place[a], place[b]] += weights[k] * value
    return mean, square, second, noise


def average_models(problem: Problem, *, tolerance: float = 5e-3, enumerate_up_to: int = ENUMERATE) -> ModelSet:
    """The models to average over: all of them, or those that hold all but `tolerance` of the mass."""
    if len(problem.signs):
        # brings scipy.special, which takes a while to import
        from bayeq.inference.signs.listing import list_signed

        return list_signed(problem, tolerance, enumerate_up_to)
    if int(np.isfinite(problem.log_odds).sum()) <= enumerate_up_to:
        return enumerate_models(problem)
    return search_models(problem, best_models(problem), tolerance)


def _moments(
    problem: Problem, models: Bools, weights: Floats, place: Ints, count: int
) -> tuple[Floats, Floats, Floats, float]:
    """`_mixture_moments` of models some of which the signs may truncate."""
    # in the order of their bits, so that half as many flips lead from one to the next as in that of their weights
    order = np.lexsort(np.packbits(models, axis=1).T)
    models, weights = models[order], weights[order]
    if not len(problem.signs):
        return _mixture_moments(problem, models, weights, place, count)
    from bayeq.inference.signs.truncation import add_truncated, certain_signs

    certain = certain_signs(problem, models)
    rest = _mixture_moments(problem, models[certain], weights[certain], place, count)
    return add_truncated(problem, models[~certain], weights[~certain], place, rest)


def mean_noise_variance(problem: Problem, active: Bools) -> float:
    """Mean of sigma^2 given a model, and the signs where they are known."""
    nowhere = np.full(len(active), -1)
    return float(_moments(problem, active[None, :], np.ones(1), nowhere, 0)[3])


def spike_slab_bma(
    gram: GramLike,
    prior: Prior | None = None,
    *,
    tolerance: float = 5e-3,
    enumerate_up_to: int = ENUMERATE,
) -> Posterior:
    """Posterior under spike-and-slab priors by averaging over models with their exact weights.

    Parameters
    ----------
    gram : GramLike
        Sufficient statistics, standardised.
    prior : Prior, optional
        By default the paper's.
    tolerance : float
        Posterior mass that a search may leave out.
    enumerate_up_to : int
        Number of free terms up to which all models are enumerated instead of searched (at most 9 where the signs of
        several coefficients are known).

    Returns
    -------
    Posterior
        `pip`, `averaged_coef` and `averaged_sd` are over all models; `coef` and `covariance` those of the median
        probability model (Barbieri and Berger 2004), exact given the model. `average` lists the models with their
        probabilities. `converged` is False if the room for models was used up before the tolerance was reached.
    """
    problem = Problem.of(gram, prior or Prior())
    found = average_models(problem, tolerance=tolerance, enumerate_up_to=enumerate_up_to)
    weights = found.weights
    pip = np.minimum(weights @ found.models, 1.0)
    converged = found.left_out <= tolerance * (1.0 + 1e-9)
    enough = int(np.searchsorted(np.cumsum(weights), 1.0 - MOMENT_MASS)) + 1
    if not converged:
        enough = min(enough, max(MOMENT_MODELS, MOMENT_WORK // len(pip)))
    share = weights[:enough] / weights[:enough].sum()
    terms = np.flatnonzero(found.models.any(axis=0))
    if len(terms) > MOST_COVARIANCES:
        terms = np.sort(np.argsort(-pip, kind="stable")[:MOST_COVARIANCES])
    place = np.full(len(pip), -1)
    place[terms] = np.arange(len(terms))
    mean, square, second, noise = _moments(problem, found.models[:enough], share, place, len(terms))
    support = pip > 0.5
    coef, conditional = exact_posterior(problem, support)
    return Posterior(
        method="bma",
        names=gram.names,
        pip=pip,
        support=support,
        coef=coef,
        covariance=conditional,
        center=np.zeros(len(pip)),
        target_mean=0.0,
        noise_variance=float(noise),
        n=round(gram.dof) + 1,
        n_iter=found.expanded,
        converged=converged,
        slab_variance=problem.slab_variance,
        averaged_coef=mean,
        averaged_sd=np.sqrt(np.maximum(square - mean * mean, 0.0)),
        average=ModelAverage(
            models=found.models,
            probability=weights,
            left_out=found.left_out,
            terms=terms,
            covariance=second - np.outer(mean[terms], mean[terms]),
        ),
    )


def _draw_given_model(p: Problem, active: Bools, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """theta (n, P) and sigma^2 (n,) given a model, without the signs."""
    theta = np.zeros((n, len(active)))
    T = swept(p, active)
    kept = np.flatnonzero(active)
    noise = 0.5 * max(float(T.diagonal[-1]), p.floor) / rng.standard_gamma(p.h, size=n)
    if len(kept):
        root = np.linalg.cholesky(active_block(T, kept))
        normal = rng.standard_normal((n, len(kept))) @ root.T
        theta[:, kept] = T.partial[kept] + np.sqrt(noise)[:, None] * normal
    return theta, noise


def sample_average(
    problem: Problem, average: ModelAverage, n: int, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Independent draws from the mixture: theta (n, P), sigma^2 (n,), and the model (n,) each came from.

    sigma^2 | z, y is inverse-Gamma(h, s/2), theta | sigma^2, z, y Gaussian, eq. (33), on the columns of `problem`.
    Where signs are known draws are repeated until these are right; those that 50 attempts have not given are samples
    of a chain within the model, twenty apart.
    """
    which = rng.choice(len(average.probability), size=n, p=average.probability)
    theta, noise = np.zeros((n, len(problem.Dty))), np.empty(n)
    for k in np.unique(which):
        rows = np.flatnonzero(which == k)
        active = average.models[k]
        draw = partial(_draw_given_model, problem, active, rng=rng)
        if len(problem.signs):
            from bayeq.inference.signs.gibbs import right_signs

            theta[rows], noise[rows] = right_signs(problem, active, len(rows), draw, rng)
        else:
            theta[rows], noise[rows] = draw(len(rows))
    return theta, noise, which.astype(np.intp)
