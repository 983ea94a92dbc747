"""The likeliest models of an equation with their coefficients: what a plan is to tell apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.inference.collapsed.search import neighbours
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Posterior
from bayeq.plan.settings import PLAN
from bayeq.regression.fit import RegressionFit

# Models that are kept with an equation.
KEPT = 10


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A model of one equation: the places of its terms among the candidates, and their coefficients.

    Coefficients and intercept are posterior means given the model, in original units. The probability is that of the
    model; of an engine that does not average, relative to its neighbours.
    """

    probability: float
    members: tuple[int, ...]
    coef: tuple[float, ...]
    intercept: float

    def posterior(self, like: Posterior) -> Posterior:
        """The model as a posterior: coefficients without a covariance, the rest that of another model."""
        index, size = np.array(self.members, dtype=np.intp), len(self.members)
        support, coef = np.zeros(len(like.names), dtype=np.bool_), np.zeros(len(like.names))
        support[index], coef[index] = True, self.coef
        return replace(
            like,
            support=support,
            coef=coef,
            covariance=np.zeros((size, size)),
            center=np.zeros(len(coef)),
            target_mean=self.intercept,
        )


def likeliest_models(fit: RegressionFit) -> tuple[CandidateModel, ...]:
    """The likeliest models of a fitted regression, the likeliest first.

    Those of the average; without one, the model found and those one move away, by their odds against it. An engine
    without a spike-and-slab prior has its own model alone.
    """
    models, probability = _listed(fit)
    out = []
    for model, share in zip(models[:KEPT], probability[:KEPT], strict=True):
        found = fit.expanded(fit.given(model))
        members = np.flatnonzero(found.support)
        coef = tuple(found.coef[members].tolist())
        out.append(CandidateModel(float(share), tuple(members.tolist()), coef, found.intercept))
    return tuple(out)


def _listed(fit: RegressionFit) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    posterior = fit.posterior
    if posterior.average is not None:
        return posterior.average.models, posterior.average.probability
    moves = (
        neighbours(fit.problem, posterior.support, PLAN.models_within) if ENGINES[posterior.method].spike_slab else []
    )
    models = np.array([posterior.support, *(move.apply(posterior.support) for move in moves)])
    log_odds = np.array([0.0, *(move.gain for move in moves)])
    order = np.argsort(-log_odds, kind="stable")
    weight = np.exp(log_odds[order] - log_odds.max())
    return models[order], weight / weight.sum()
