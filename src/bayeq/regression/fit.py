"""From a regression to its posterior: which prior, which engine, and the way back to original units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import (
    exact_posterior,
    given_model,
    learn_slab_variance,
    noise_given_model,
    residual_scale,
)
from bayeq.inference.engines import Engine
from bayeq.inference.gram import Gram, Standardised
from bayeq.inference.posterior import Mixture, Posterior
from bayeq.inference.prior import Prior, limited
from bayeq.likelihood.spike import softened_rows
from bayeq.numerics.distributions import Z95, t_quantile
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.by_likelihood import calibrated
from bayeq.regression.constraints import Constraints
from bayeq.regression.regression import Regression


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """A regression and what an engine found."""

    regression: Regression  # rows, in original units
    constraints: Constraints  # what is known of the coefficients
    # the Gram that the engine was given: equalities between coefficients taken out, standardised
    standard: Standardised
    prior: Prior  # on standardised columns, with the v_s that was used
    posterior: Posterior  # the engine's, in units of `standard`

    @cached_property
    def problem(self) -> Problem:
        """What models are compared on."""
        return Problem.of(self.standard.gram, self.prior)

    @cached_property
    def rows(self) -> Gram:
        """Statistics of the training rows, equalities taken out: what shares of variance refer to."""
        return self.constraints.equalities.reduce(self.regression.rows)

    def given(self, model: Bools) -> Posterior:
        """The posterior given a model of other terms, (F,) bool, in units of `standard`; probabilities stay."""
        return self.posterior if bool((model == self.posterior.support).all()) else self.conditional(model)

    def conditional(self, model: Bools) -> Posterior:
        """As `given`, of the included terms too by `standard`."""
        coef, covariance = exact_posterior(self.problem, model, self.prior.limits)
        noise = noise_given_model(self.problem, model)
        return replace(self.posterior, support=model, coef=coef, covariance=covariance, noise_variance=noise)

    def expanded(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` in original units and of all P terms."""
        return self.constraints.equalities.expand(posterior.rescaled(self.standard), self.regression.gram)

    def reported(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` as it is reported: the uncertainty of the sensors' calibration is added to it."""
        found, equalities = self.expanded(posterior), self.constraints.equalities
        basis, limits = equalities.basis(found.support), None
        if self.prior.limits is not None:
            limits = np.tile([-np.inf, np.inf], (len(found.support), 1))
            limits[equalities.kept] = self.prior.limits * (self.standard.target_scale / self.standard.scale)[:, None]
            limits = np.where(np.isfinite(self.constraints.limits), self.constraints.limits, limits)
        found = self.regression.reported(found, basis, limits, not self._truncated(posterior.support))
        found = calibrated(self.regression, found, basis)
        return replace(found, details=replace(found.details, bounds=self.constraints.bounds))

    def beyond_bounds(self, most: float) -> dict[str, tuple[float, float, float]]:
        """Terms whose coefficients would be further beyond their bounds than `most` standard deviations without these.

        Each with its bound, the coefficient beside the included terms, and by how many; or beside those of the
        likeliest model without bounds, where the evidence is against the bound.
        """
        bounds, kept, names = self.constraints.bounds, self.constraints.equalities.kept, self.standard.gram.names
        found: dict[str, tuple[float, float, float]] = {}
        if bounds is None:
            return found
        for k in np.flatnonzero(limited(bounds[kept]) & (self.problem.log_odds > -np.inf)):
            refused = names[k] in self.posterior.details.contradicted
            for beside in (self.posterior.support, *([best_models(self.problem)[0][1]] if refused else [])):
                model = beside | (np.arange(len(names)) == k)
                mean, covariance = given_model(self.problem, model)
                place, unit = int(model[:k].sum()), self.standard.target_scale / self.standard.scale[k]
                coef, sd, (low, high) = unit * mean[k], unit * np.sqrt(covariance[place, place]), bounds[kept[k]]
                sds = float(max(low - coef, coef - high) / sd)
                if sds > max(most, found.get(names[k], (0.0, 0.0, 0.0))[2]):
                    found[names[k]] = (float(high if coef > high else low), float(coef), sds)
        return found

    def _truncated(self, model: Bools) -> bool:
        """Whether limits change the posterior given a model: they do unless the data leave no doubt of them."""
        limits = self.prior.limits
        if limits is None:
            return False
        # brings scipy.special, which takes a while to import
        from bayeq.inference.signs import Truncation

        return bool(Truncation(self.problem, limits, model[None, :]).needed.any())


def fit_regression(
    regression: Regression,
    constraints: Constraints,
    engine: Engine,
    prior: Prior | None = None,
    coarsen: float = 1.0,
    tolerance: float | None = None,
    seed: tuple[int, ...] = (0,),
) -> RegressionFit:
    """Posterior of one equation by a row of `bayeq.inference.engines.ENGINES`.

    Equalities are taken out before inference; signs and bounds go into the prior. That is on standardised columns, the
    target in units of the least-squares residual; by default p_0 = 0.1 and a slab variance v_s that maximises the
    evidence, at least 10. The likelihood is raised to the power `coarsen`, above 0 and at most 1. Beside that of rows
    the terms may lack something of size `tolerance` (`bayeq.likelihood.spike`). `seed` is that of engines that draw
    random numbers.
    """
    regression = regression.raised(coarsen)
    reduced = constraints.equalities.reduce(regression.gram)
    standard = reduced.standardise(residual_scale(reduced))
    if tolerance and isinstance(standard.gram, Gram) and regression.counts_rows:
        standard = replace(standard, gram=softened_rows(standard.gram, tolerance))
    used = constraints.prior(prior or Prior(), standard.scale / standard.target_scale)
    if prior is None:
        used = replace(used, slab_variance=learn_slab_variance(standard.gram, used))
    options = {"seed": seed} if engine.random else {}
    return RegressionFit(regression, constraints, standard, used, engine.run(standard.gram, used, **options))


# The likeliest models, at most: one takes some 0.05 ms.
MOST_MODELS = 300


def mixture_of(fit: RegressionFit, reported: Posterior, struck: Bools | None = None) -> Mixture | None:
    """The P coefficients over models, in original units, and after them the intercept, which is in all models.

    `reported` is the posterior of one model, as it is reported: by the likelihood of the record by projection. Its
    terms differ in other models by the same factor and change. Terms `struck`, (F,), are taken out of every model, the
    others estimated again. None where no models are averaged, or none are listed that terms could be taken out of.
    """
    posterior, average, draws = fit.posterior, fit.posterior.average, fit.posterior.draws
    again = struck is not None and bool(struck.any())
    if posterior.averaged is None or (again and average is None):
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
        mean = np.vstack([theta.T, whole.constant.mean - theta @ whole.constant.center])
        share = np.full(len(z), 1.0 / len(z))
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
    few = replace(fit.posterior, averaged=None, average=None)
    shape = len(reported.names) + 1, len(models)
    inside, mean, sd = np.ones(shape, dtype=np.bool_), np.zeros(shape), np.zeros(shape)
    for k, model in enumerate(models):
        coef, covariance = exact_posterior(fit.problem, model, fit.prior.limits)
        one = fit.expanded(replace(few, support=model, coef=coef, covariance=covariance))
        kept, wide = one.support, factor[one.support]
        inside[:-1, k], mean[:-1, k], mean[-1, k] = kept, one.coef + kept * change, one.intercept
        sd[:-1, k] = one.sd * factor
        center = one.constant.center[kept] * wide
        sd[-1, k] = np.sqrt(own + center @ one.covariance @ center)
    return inside, mean, sd


def _mean_variance(reported: Posterior) -> float:
    """Variance of the intercept were the coefficients known: that of the target's mean."""
    center = reported.constant.center[reported.support]
    return max(reported.intercept_sd**2 - float(center @ reported.covariance @ center), 0.0)


def _moved(fit: RegressionFit, reported: Posterior) -> tuple[Floats, Floats]:
    """What a model as it is reported differs by from its posterior: factors of deviations, changes of means."""
    factor, change = np.ones(len(reported.names)), np.zeros(len(reported.names))
    if reported.projected is not None and reported.support.any():
        exact = fit.expanded(fit.conditional(reported.support[fit.constraints.equalities.kept]))
        known = exact.sd > 0.0
        factor[known] = t_quantile(reported.projected.freedom[known]) / Z95 * reported.sd[known] / exact.sd[known]
        change[known] = (reported.coef - exact.coef)[known]
    return factor, change


def _moments_given_in(whole: Posterior) -> tuple[Floats, Floats]:
    """Mean and standard deviation of each coefficient given that its term is in, from those over all models."""
    assert whole.averaged is not None
    pip = np.maximum(whole.pip, np.finfo(np.float64).tiny)
    mean = whole.averaged.coef / pip
    square = (whole.averaged.sd**2 + whole.averaged.coef**2) / pip
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))
