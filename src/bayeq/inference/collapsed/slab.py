"""The slab variance and the scale of the target, learned from the data; coefficients given a model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.inference.collapsed.problem import Problem, gram_block
from bayeq.inference.collapsed.search import best_models, greedy_start, neighbours
from bayeq.inference.collapsed.tableau import residual_sum, swept
from bayeq.inference.gram import Gram, GramLike, Standardised
from bayeq.inference.prior import Prior
from bayeq.numerics.settings import INFERENCE

# Range of ln v_s above the floor, and the grids on which its maximum is found: GRIDS of GRID points, each between the
# neighbours of the best point of the one before, the last with steps of 3e-7.
LOG_RANGE = math.log(1e15)
GRID = 41
GRIDS = 6

# Largest number of iterations, each of which maximises over the model, then over v_s.
MAX_TURNS = 10

# Slab variance that hardly shrinks coefficients.
UNSHRUNK = 1e12

# Below this share of the target's standard deviation a residual is rounding of the Gram matrix.
LEAST_RESIDUAL = 1e-6


def _best_slab(p: Problem, active: Bools, lowest: float) -> tuple[float, float]:
    """ln v_s >= `lowest` that maximises the log posterior (34) of a model, by eigenvalues of D_r'D_r; the maximum."""
    index = np.flatnonzero(active)
    values, vectors = np.linalg.eigh(gram_block(p.columns, index))
    values = np.maximum(values, np.finfo(float).eps * values.max(initial=0.0))[:, None]
    pull = (vectors.T @ p.Dty[index])[:, None] ** 2
    prior = p.size_prior[len(index)] + p.log_odds[active & (p.log_odds < math.inf)].sum()
    low, high = lowest, lowest + LOG_RANGE
    for _ in range(GRIDS):
        grid = np.linspace(low, high, GRID)
        ridged = values + np.exp(-grid)
        s = np.maximum(p.yty + 2.0 * p.noise_rate - (pull / ridged).sum(axis=0), p.floor)
        level = prior - 0.5 * len(index) * grid - 0.5 * np.log(ridged).sum(axis=0) - p.h * np.log(0.5 * s)
        k = int(np.argmax(level))
        low, high = grid[max(k - 1, 0)], grid[min(k + 1, GRID - 1)]
    return float(grid[k]), float(level[k])


def learn_slab_variance(gram: GramLike, prior: Prior, floor: float = 10.0) -> float:
    """v_s that maximises the evidence of the best model of a standardised Gram, not below `floor`, the paper's 10.

    With little noise v_s = 10 lets coefficients be shrunk and split among correlated terms. Model and v_s are maximised
    in turn, from the floor and from the signal-to-noise ratio y'y/RSS of all terms together.
    """
    problem = Problem.of(gram, prior)
    lowest = math.log(floor)
    ratio = gram.yty / max(residual_sum(problem), LEAST_RESIDUAL**2 * gram.yty, 1e-300)
    best_value, best_log = -math.inf, lowest
    for start in {lowest, max(lowest, math.log(max(ratio, 1e-300)))}:
        log_v = start
        for _ in range(MAX_TURNS):
            active = best_models(problem.with_slab_variance(math.exp(log_v)))[0][1]
            new, value = _best_slab(problem, active, lowest)
            if value > best_value:
                best_value, best_log = value, new
            if abs(new - log_v) < 1e-3:
                break
            log_v = new
    return math.exp(best_log)


def residual_scale(gram: Gram) -> float:
    """Standard deviation of the residual of y on all terms together: the unit in which the noise prior applies.

    In units of y the prior IG(1e-4, 1e-4) would affect noise of about 0.1 % of the signal or less. With hardly more
    rows than terms, the residual is that on terms chosen by forward selection, a quarter as many as rows at most.
    """
    sd = math.sqrt(gram.yty / gram.n)
    spare = gram.n - 1 - len(gram.names)
    if sd == 0.0:
        return 1.0
    problem = Problem.of(gram.standardise(sd).gram, Prior(slab_variance=UNSHRUNK))
    if spare < max(10, 0.1 * gram.n):
        active = greedy_start(problem, min(int(gram.n) // 4, INFERENCE.most_selected))
        rss = float(swept(problem, active).diagonal[-1]) - 2.0 * problem.noise_rate
        spare = gram.n - 1 - int(active.sum())
    else:
        rss = residual_sum(problem)
    return sd * max(math.sqrt(max(rss, 0.0) / spare), LEAST_RESIDUAL)


def learned(gram: Gram, prior: Prior, floor: float = 10.0) -> tuple[Standardised, Prior]:
    """The standardised Gram, the target in units of its residual, and the prior with the slab variance learned."""
    standard = gram.standardise(residual_scale(gram))
    return standard, replace(prior, slab_variance=learn_slab_variance(standard.gram, prior, floor))


def _parameters(problem: Problem, active: Bools) -> tuple[Floats, Floats, float]:
    """Mean (r,) of the active theta, their covariance in units of sigma^2 (r, r), eq. (33), and the mean of sigma^2."""
    p, index = problem, np.flatnonzero(active)
    A = gram_block(p.columns, index)
    A[np.diag_indices_from(A)] += 1.0 / p.slab_variance
    try:
        inverse = np.linalg.inv(A)
        inverse = 0.5 * (inverse + inverse.T)
        mean = inverse @ p.Dty[index]
    except np.linalg.LinAlgError:  # copies of a column: the ridge of the prior is lost in rounding
        values, axes = np.linalg.eigh(A)
        inverse = axes / np.maximum(values, 1.0 / p.slab_variance) @ axes.T
        mean = np.asarray(np.linalg.lstsq(A, p.Dty[index], rcond=None)[0], dtype=np.float64)
    s = p.yty + 2.0 * p.noise_rate - float(mean @ p.Dty[index])
    return mean, inverse, 0.5 * max(s, p.floor) / max(p.h - 1.0, 0.5)


def given_model(problem: Problem, active: Bools) -> tuple[Floats, Floats]:
    """Mean (P,) of theta, 0 for a term that is out, and covariance (r, r) of the others, sigma^2 integrated out."""
    coef = np.zeros(len(active))
    coef[active], inverse, variance = _parameters(problem, active)
    return coef, variance * inverse


def noise_given_model(problem: Problem, active: Bools) -> float:
    """Mean of sigma^2 given a model."""
    return _parameters(problem, active)[2]


def exact_posterior(problem: Problem, active: Bools, limits: Floats | None = None) -> tuple[Floats, Floats]:
    """Like `given_model`, truncated at limits (P, 2) where these are known."""
    if limits is not None:
        # imports scipy.special, which takes a while
        from bayeq.inference.signs import truncated_models

        for _, coef, covariance, _ in truncated_models(problem, limits, active[None, :]):
            return coef, covariance
    return given_model(problem, active)


def likeliest_by_rows(gram: Gram, allowed: Bools | None = None, most: float = math.inf) -> tuple[Bools, Floats]:
    """The likeliest model of a regression with at most `most` terms, all `allowed`; its coefficients, (P,) each."""
    first = Prior() if allowed is None else Prior(prior_inclusion=np.where(allowed, 0.1, 0.0))
    standard, prior = learned(gram, first)
    problem = Problem.of(standard.gram, prior)
    model = best_models(problem)[0][1]
    while model.sum() > most:
        model = next(move for move in neighbours(problem, model, math.inf) if move.enters is None).apply(model)
    return model, exact_posterior(problem, model)[0] / standard.scale * standard.target_scale
