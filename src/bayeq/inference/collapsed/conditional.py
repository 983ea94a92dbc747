"""The posterior of the coefficients given a model, exact."""

from __future__ import annotations

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.inference.collapsed.problem import Problem, gram_block


def _parameters(problem: Problem, active: Bools) -> tuple[Floats, Floats, float]:
    """Mean (r,) of the active theta, their covariance in units of sigma^2 (r, r), and the mean of sigma^2.

    theta | sigma^2 is Gaussian with mean a_r and covariance sigma^2 A_r, eq. (33), and sigma^2 inverse-Gamma(h, s/2),
    whose mean is s/2/(h - 1).
    """
    p, index = problem, np.flatnonzero(active)
    A = gram_block(p.columns, index)
    A[np.diag_indices_from(A)] += 1.0 / p.slab_variance
    inverse = np.linalg.inv(A)
    inverse = 0.5 * (inverse + inverse.T)
    mean = inverse @ p.Dty[index]
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
    """`given_model`, and within limits (P, 2) where they are known."""
    if limits is not None:
        # brings scipy.special, which takes a while to import
        from bayeq.inference.signs.truncation import truncated_models

        for _, coef, covariance, _ in truncated_models(problem, limits, active[None, :]):
            return coef, covariance
    return given_model(problem, active)
