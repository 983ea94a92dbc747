"""The posterior of the coefficients given a model, exact."""

from __future__ import annotations

import numpy as np

from bayeq.inference.collapsed.problem import Bools, Floats, Ints, Problem
from bayeq.inference.collapsed.tableau import active_block, swept

__all__ = ["exact_posterior", "given_model"]


def given_model(problem: Problem, active: Bools) -> tuple[Floats, Floats]:
    """Mean (P,) of theta, 0 for a term that is out, and covariance (r, r) of the others, sigma^2 integrated out.

    theta | sigma^2 is Gaussian with mean a_r and covariance sigma^2 A_r, eq. (33), and sigma^2 inverse-Gamma(h, s/2),
    whose mean is s/2/(h - 1).
    """
    T = swept(problem, active)
    variance = 0.5 * max(float(T.diagonal[-1]), problem.floor) / max(problem.h - 1.0, 0.5)
    return np.where(active, T.partial, 0.0), variance * active_block(T, np.flatnonzero(active))


def exact_posterior(problem: Problem, active: Bools, signs: Ints | None = None) -> tuple[Floats, Floats]:
    """`given_model`, and given the signs where they are known."""
    if signs is not None:
        # brings scipy.special, which takes a while to import
        from bayeq.inference.signs.truncation import truncated_models

        for _, coef, covariance, _ in truncated_models(problem, signs, active[None, :]):
            return coef, covariance
    return given_model(problem, active)
