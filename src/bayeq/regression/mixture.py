"""The posterior of an equation's coefficients over all models, from which come intervals that know of other models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.inference.collapsed.conditional import exact_posterior
from bayeq.inference.mixture import Mixture
from bayeq.inference.posterior import Posterior
from bayeq.numerics.normal import Z95, t95
from bayeq.regression.fit import RegressionFit
from bayeq.regression.settings import REGRESSION

# The likeliest models, at most: one takes some 0.05 ms.
MOST_MODELS = 300


def mixture_of(fit: RegressionFit, reported: Posterior, struck: Bools | None = None) -> Mixture | None:
    """The P coefficients over models, in original units, and after them the intercept, which is in all models.

    Parameters
    ----------
    fit : RegressionFit
        With the models that were averaged over, or draws.
    reported : Posterior
        Of one model, as it is reported: by the likelihood of the record by projection. Its terms differ in other models
        by the same factor and change.
    struck : (F,) bool array, optional
        Terms that are taken out of every model, the others estimated again.

    Returns
    -------
    Mixture or None
        None where no models are averaged, or none are listed that terms could be taken out of.
    """
    posterior, average, draws = fit.posterior, fit.posterior.average, fit.posterior.draws
    again = struck is not None and bool(struck.any())
    if posterior.averaged_coef is None or posterior.averaged_sd is None or (again and average is None):
        return None
    whole = fit.expanded(posterior)
    if average is not None:
        count = min(int(np.searchsorted(np.cumsum(average.probability), REGRESSION.mixture_mass)) + 1, MOST_MODELS)
        models = average.models[:count]
        inside, mean, sd = _given_models(fit, models & ~struck if struck is not None else models, reported)
        share = average.probability[: len(models)]
    elif draws is not None:
        assert whole.draws is not None
        z, theta = (values.reshape(-1, len(whole.names)) for values in (whole.draws.z, whole.draws.theta))
        inside = np.vstack([z.T > 0, np.ones(len(z), dtype=np.bool_)])
        mean, share = np.vstack([theta.T, whole.target_mean - theta @ whole.center]), np.full(len(z), 1.0 / len(z))
        sd = np.zeros(mean.shape)
        sd[-1] = np.sqrt(_mean_variance(reported))
    else:
        inside, share = np.zeros((len(whole.names) + 1, 1), dtype=np.bool_), np.ones(1)
        mean, sd = np.zeros(inside.shape), np.zeros(inside.shape)
    weight = inside * share
    total = weight.sum(axis=1)
    lost = total == 0.0
    if lost.any():
        first, spread = (reported.coef, reported.sd) if again else _moments_given_in(whole)
        weight[lost, 0], total[lost] = 1.0, 1.0
        mean[lost, 0] = np.append(first, reported.intercept)[lost]
        sd[lost, 0] = np.append(spread, reported.intercept_sd)[lost]
    weight, mean, sd = (np.ascontiguousarray(part) for part in (weight / total[:, None], mean, sd))
    return Mixture(weight, mean, sd, np.append(whole.pip, 1.0))


def _given_models(fit: RegressionFit, models: Bools, reported: Posterior) -> tuple[Bools, Floats, Floats]:
    """Of each term, then the intercept, in each model: whether it is in, mean and standard deviation, (P + 1, K)."""
    (factor, change), own = _moved(fit, reported), _mean_variance(reported)
    few = replace(fit.posterior, average=None, draws=None, averaged_coef=None, averaged_sd=None)
    shape = len(reported.names) + 1, len(models)
    inside, mean, sd = np.ones(shape, dtype=np.bool_), np.zeros(shape), np.zeros(shape)
    for k, model in enumerate(models):
        coef, covariance = exact_posterior(fit.problem, model, fit.prior.limits)
        one = fit.expanded(replace(few, support=model, coef=coef, covariance=covariance))
        kept, wide = one.support, factor[one.support]
        inside[:-1, k], mean[:-1, k], mean[-1, k] = kept, one.coef + kept * change, one.intercept
        sd[:-1, k] = one.sd * factor
        center = one.center[kept] * wide
        sd[-1, k] = np.sqrt(own + center @ one.covariance @ center)
    return inside, mean, sd


def _mean_variance(reported: Posterior) -> float:
    """Variance of the intercept were the coefficients known: that of the target's mean."""
    center = reported.center[reported.support]
    return max(reported.intercept_sd**2 - float(center @ reported.covariance @ center), 0.0)


def _moved(fit: RegressionFit, reported: Posterior) -> tuple[Floats, Floats]:
    """What a model as it is reported differs by from its posterior: factors of deviations, changes of means."""
    factor, change = np.ones(len(reported.names)), np.zeros(len(reported.names))
    if reported.freedom is not None and reported.support.any():
        exact = fit.expanded(fit.conditional(reported.support[fit.constraints.equalities.kept]))
        known = exact.sd > 0.0
        factor[known] = t95(reported.freedom[known]) / Z95 * reported.sd[known] / exact.sd[known]
        change[known] = (reported.coef - exact.coef)[known]
    return factor, change


def _moments_given_in(whole: Posterior) -> tuple[Floats, Floats]:
    """Mean and standard deviation of each coefficient given that its term is in, from those over all models."""
    assert whole.averaged_coef is not None
    assert whole.averaged_sd is not None
    pip = np.maximum(whole.pip, np.finfo(np.float64).tiny)
    mean = whole.averaged_coef / pip
    square = (whole.averaged_sd**2 + whole.averaged_coef**2) / pip
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))
