"""A plausible equation where no term of several that could stand in for each other has half of the probability.

The terms with a PIP above 0.5, the median probability model (Barbieri and Berger 2004), predict best where columns are
nearly orthogonal. Where six forms of damping fit alike each has a PIP of about 1/6, and the equation of the terms above
0.5 has no damping at all, however sure it is that there is some. Such an equation is far less likely than others, which
tells; then the simplest of the equations that are hardly less likely than the best takes its place. The PIPs stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayeq.expressions import Expression
from bayeq.gram import GramLike
from bayeq.inference import Prior
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.posterior import Posterior
from bayeq.selection.limits import given_terms

__all__ = ["plausible"]

# An equation is not plausible if the likeliest model has more than these posterior odds against it.
LEAST_PLAUSIBLE = 100.0

# Models that are hardly less likely than the best: with odds of so many to one at most.
HARDLY = 10.0


def plausible(gram: GramLike, prior: Prior, posterior: Posterior, terms: Sequence[Expression]) -> Posterior:
    """The posterior given a plausible model: its own, unless the models listed have a far likelier one.

    Parameters
    ----------
    gram, prior
        What the posterior comes from.
    posterior : Posterior
        With the models that were averaged over.
    terms : sequence of Expression
        The P candidates; a model is the simpler, the fewer nodes its terms have in all.
    """
    average = posterior.average
    if average is None or not len(average.models):
        return posterior
    problem = Problem.of(gram, prior)
    behind = model_log_posterior(problem, average.models[0]) - model_log_posterior(problem, posterior.support)
    if behind <= math.log(LEAST_PLAUSIBLE):
        return posterior
    near = average.models[average.probability >= average.probability[0] / HARDLY]
    holding = near[~(posterior.support & ~near).any(axis=1)]
    candidates = holding if len(holding) else near
    # the first of the simplest is the likeliest of them
    simplest = int(np.argmin(candidates @ np.array([term.size for term in terms])))
    return given_terms(gram, prior, posterior, candidates[simplest])
