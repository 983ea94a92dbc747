"""Bayesian model averaging on the collapsed marginal likelihood (34): exact weights, no sampling.

With few terms the average is over all models, with more over the models that a best-first search finds to hold nearly
all of the mass (`inference.collapsed.listing`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError
from bayeq.inference.collapsed.listing import ENUMERATE, ModelSet, list_models, shares
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.collapsed.tableau import active_block, move_to, swept
from bayeq.inference.gram import GramLike
from bayeq.inference.posterior import Averaged, Details, ModelAverage, Posterior, of_standardised
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

# Moments are averaged over the likeliest models, all but a share MOMENT_MASS of the mass. With known signs or bounds a
# truncated model takes some 0.1 ms: of more than TRUNCATED_MODELS all but a share TRUNCATED_MASS, which is still less
# than a listing leaves out.
MOMENT_MASS = 1e-6
TRUNCATED_MODELS = 1000
TRUNCATED_MASS = 1e-3

# Moments of an incomplete listing use at most MOMENT_MODELS models, or MOMENT_WORK / P if that is more. They are scaled
# by each term's PIP over its share in these models, for moments given inclusion hardly depend on the other terms.
MOMENT_MODELS = 100
MOMENT_WORK = 200_000

# Largest number of models kept in the answer, likeliest first: the tens of thousands of models of a spread posterior
# add nothing to its inclusion probabilities, and fill files of megabytes.
MOST_KEPT = 5000

# The covariance over all models is kept for at most this many terms, the likeliest.
MOST_COVARIANCES = 1000

# A covariance whose correlations have eigenvalues below minus this, times its size, is lost to rounding; eigenvalues
# are looked at for up to MOST_DECOMPOSED terms, whose decomposition takes no time.
ROUNDING, MOST_DECOMPOSED = 1e-9, 200

# Rejection sampling draws blocks of at least REJECTED, at most MOST_REJECTIONS of them: enough for signs that are right
# in one of 10^5 draws.
REJECTED = 1000
MOST_REJECTIONS = 1000


@kernel
def _mixture_moments(
    p: Problem, models: Bools, weights: Floats, place: Ints, count: int
) -> tuple[Floats, Floats, Floats, float]:
    """Averages over weighted models: mean and mean square (P,) of theta, its second moments (Q, Q), mean of sigma^2.
    `place` (P,) is each term's index in the matrix of Q = `count` terms, -1 for a term outside it."""
    terms = len(p.Dty)
    mean, square, second, noise = np.zeros(terms), np.zeros(terms), np.zeros((count, count)), 0.0
    current = np.zeros(terms, np.bool_)
    T = swept(p, current)
    for k in range(len(models)):
        move_to(p, T, current, models[k])
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


def _possible(covariance: Floats) -> Floats:
    """The covariance, or the nearest positive semidefinite one in units of its standard deviations: a difference of
    moments loses small eigenvalues to rounding."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    unit = np.divide(1.0, sd, out=np.zeros(len(sd)), where=sd > 0.0)
    correlation = covariance * unit[:, None] * unit
    if len(sd) > MOST_DECOMPOSED or not np.isfinite(correlation).all():
        return covariance
    values, vectors = np.linalg.eigh(correlation)
    if values.min(initial=0.0) > -ROUNDING * len(sd) and (sd > 0.0).all():
        return covariance
    found = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray(0.5 * (found + found.T) * sd[:, None] * sd)


def average_models(
    problem: Problem, limits: Floats | None = None, *, tolerance: float = 5e-3, enumerate_up_to: int = ENUMERATE
) -> ModelSet:
    """The models to average over: all of them, or those that hold all but `tolerance` of the mass."""
    if limits is None:
        return list_models(problem, tolerance, enumerate_up_to)
    # imports scipy.special, which takes a while
    from bayeq.inference.signs import list_signed

    return list_signed(problem, limits, tolerance, enumerate_up_to)


def _moments(
    problem: Problem, limits: Floats | None, models: Bools, weights: Floats, place: Ints, count: int
) -> tuple[Floats, Floats, Floats, float]:
    """Like `_mixture_moments`, with the coefficients truncated at `limits` where these are known and in doubt."""
    # models sorted by their bits: half as many flips from one to the next as sorted by weight
    order = np.lexsort(np.packbits(models, axis=1).T)
    models, weights = models[order], weights[order]
    if limits is None:
        return _mixture_moments(problem, models, weights, place, count)
    from bayeq.inference.signs import truncated_models

    truncated = list(truncated_models(problem, limits, models))
    others = np.ones(len(models), dtype=np.bool_)
    others[[k for k, *_ in truncated]] = False
    mean, square, second, noise = _mixture_moments(problem, models[others], weights[others], place, count)
    for k, coef, covariance, variance in truncated:
        kept = np.flatnonzero(models[k])
        raw = weights[k] * (covariance + np.outer(coef[kept], coef[kept]))
        mean += weights[k] * coef
        square[kept] += np.diagonal(raw)
        noise += weights[k] * variance
        among = np.flatnonzero(place[kept] >= 0)
        second[np.ix_(place[kept[among]], place[kept[among]])] += raw[np.ix_(among, among)]
    return mean, square, second, noise


def spike_slab_bma(
    gram: GramLike,
    prior: Prior | None = None,
    *,
    tolerance: float = 5e-3,
    enumerate_up_to: int = ENUMERATE,
    revise: Callable[[ModelSet], ModelSet] | None = None,
) -> Posterior:
    """Posterior under spike-and-slab priors, by default the paper's, by averaging over models with their exact weights.

    The Gram is standardised. Up to `enumerate_up_to` free terms all models are enumerated; with more, a search may
    leave out a share `tolerance` of the posterior mass. `revise` takes the models found and returns them with other log
    posteriors. `coef` and `covariance` are those of the median probability model (Barbieri and Berger 2004), exact
    given the model; `average` lists the models. If these leave out more than the tolerance (and are not revised), `pip`
    averages each term's probability given the other terms over the models searched; `unsettled` names terms for which
    this differs from the PIP over the listed models by more than the tolerance (compared before `revise`);
    `contradicted` names terms whose known signs or bounds the data contradict.
    """
    prior = prior or Prior()
    problem, limits = Problem.of(gram, prior), prior.limits
    found = average_models(problem, limits, tolerance=tolerance, enumerate_up_to=enumerate_up_to)
    settled = found.pip(tolerance)[1]
    if revise is not None:
        found = replace(revise(found), inclusion=None)  # it belongs to the former log posteriors
    weights, (pip, known) = found.weights, found.pip(tolerance)
    complete = found.left_out <= tolerance * (1.0 + 1e-9)
    enough, most = np.searchsorted(np.cumsum(weights), (1.0 - MOMENT_MASS, 1.0 - TRUNCATED_MASS)).tolist()
    enough = min(enough, max(most, TRUNCATED_MODELS)) + 1 if limits is not None else enough + 1
    if not complete:
        enough = min(enough, max(MOMENT_MODELS, MOMENT_WORK // len(pip)))
    share = weights[:enough] / weights[:enough].sum()
    terms = np.flatnonzero(found.models.any(axis=0))
    if len(terms) > MOST_COVARIANCES:
        terms = np.sort(np.argsort(-pip, kind="stable")[:MOST_COVARIANCES])
    place = np.full(len(pip), -1)
    place[terms] = np.arange(len(terms))
    mean, square, second, noise = _moments(problem, limits, found.models[:enough], share, place, len(terms))
    if not complete:
        inside = shares(found.models[:enough], share)
        lacking = np.where(inside > 0.0, pip / np.where(inside > 0.0, inside, 1.0), 0.0)
        mean, square = mean * lacking, square * lacking
    support, kept = pip > 0.5, min(float(weights[:MOST_KEPT].sum()), 1.0) if len(weights) > MOST_KEPT else 1.0
    coef, conditional = exact_posterior(problem, support, limits)
    listed = ModelAverage(
        models=found.models[:MOST_KEPT],
        probability=weights[:MOST_KEPT] / kept,
        left_out=found.left_out if kept == 1.0 else 1.0 - kept * (1.0 - found.left_out),
        terms=terms,
        covariance=_possible(second - np.outer(mean[terms], mean[terms])),
    )
    contradicted = tuple(gram.names[j] for j in found.contradicted)
    unsettled = tuple(gram.names[j] for j in np.flatnonzero(~(settled | known)))
    details = Details(
        "bma", found.expanded, not unsettled, problem.slab_variance, contradicted=contradicted, unsettled=unsettled
    )
    averaged = Averaged(mean, np.sqrt(np.maximum(square - mean * mean, 0.0)))
    return of_standardised(gram, pip, support, coef, conditional, noise, details, averaged, listed)


def _draw_given_model(p: Problem, active: Bools, n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """theta (n, P) and sigma^2 (n,) given a model, without limits."""
    theta = np.zeros((n, len(active)))
    T = swept(p, active)
    kept = np.flatnonzero(active)
    noise = 0.5 * max(float(T.diagonal[-1]), p.floor) / rng.standard_gamma(p.h, size=n)
    if len(kept):
        root = np.linalg.cholesky(active_block(T, kept))
        normal = rng.standard_normal((n, len(kept))) @ root.T
        theta[:, kept] = T.partial[kept] + np.sqrt(noise)[:, None] * normal
    return theta, noise


def _draw_given_signs(
    p: Problem, limits: Floats, active: Bools, n: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Like `_draw_given_model`, rejecting draws outside the limits (P, 2)."""
    theta, noise = np.empty((0, len(active))), np.empty(0)
    for _ in range(MOST_REJECTIONS):
        drawn, variance = _draw_given_model(p, active, max(n, REJECTED), rng)
        right = ((drawn >= limits[:, 0]) & (drawn <= limits[:, 1]) | ~active).all(axis=1)
        theta, noise = np.concatenate([theta, drawn[right]]), np.concatenate([noise, variance[right]])
        if len(noise) >= n:
            return theta[:n], noise[:n]
    raise InputError(
        f"the known signs and bounds are too improbable to draw from the posterior: {len(noise)} of"
        f" {MOST_REJECTIONS * max(n, REJECTED)} draws of one model have them; leave out one that the data contradict"
    )


def sample_average(
    problem: Problem, average: ModelAverage, n: int, rng: np.random.Generator, limits: Floats | None = None
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Independent draws from the mixture: theta (n, P), sigma^2 (n,), and the model (n,) each came from, eq. (33).

    InputError: known signs or bounds that hardly any draw of a model satisfies.
    """
    which = rng.choice(len(average.probability), size=n, p=average.probability)
    theta, noise = np.zeros((n, len(problem.Dty))), np.empty(n)
    for k in np.unique(which):
        rows = np.flatnonzero(which == k)
        one = average.models[k]
        if limits is None:
            theta[rows], noise[rows] = _draw_given_model(problem, one, len(rows), rng)
        else:
            theta[rows], noise[rows] = _draw_given_signs(problem, limits, one, len(rows), rng)
    return theta, noise, which.astype(np.intp)
