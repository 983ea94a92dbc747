"""Draws from the posterior of an equation over its models, as ArviZ keeps them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.adapters.arviz import to_arviz
from bayeq.errors import whole_number
from bayeq.forecast.dynamics import normal_draws
from bayeq.inference.posterior import Draws

if TYPE_CHECKING:
    from bayeq.equation.equation import Equation


def draws_of(equation: Equation, draws: int, seed: int) -> Any:
    """As `bayeq.equation.equations.Equations.to_arviz`, of one equation."""
    draws = whole_number("draws", draws, 1)
    fit = equation.solved()
    rng, average = np.random.default_rng(seed), fit.posterior.average
    if average is None:
        models, probability = fit.posterior.support[None], np.ones(1)
    else:
        models, probability = average.models, average.probability
    which = rng.choice(len(models), size=draws, p=probability)
    z = np.zeros((draws, len(equation.terms)), dtype=np.bool_)
    theta, noise = np.zeros(z.shape), np.zeros(draws)
    for k in np.unique(which):
        rows = np.flatnonzero(which == k)
        one = fit.reported(fit.given(models[k]))
        z[rows], noise[rows] = one.support, one.noise_variance
        theta[np.ix_(rows, np.flatnonzero(one.support))] = normal_draws(
            one.coef[one.support], one.covariance, len(rows), rng
        )
    chain = Draws(z[None], theta[None], noise[None], np.log(probability[which])[None], equation.posterior.pip[None])
    return to_arviz(equation.posterior, chain, rng=rng, statistics={"model": which[None]})
