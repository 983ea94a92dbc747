"""From a regression to its posterior: which prior, which engine, and the way back to original units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayeq.arrays import Bools
from bayeq.gram import Gram, Standardised
from bayeq.inference.collapsed.conditional import exact_posterior, given_model, noise_given_model
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.engines import Engine
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior, limited
from bayeq.likelihood.spike import softened_rows
from bayeq.regression.channel_errors import calibrated
from bayeq.regression.constraints import Constraints
from bayeq.regression.regression import Regression


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """A regression and what an engine found.

    Attributes
    ----------
    regression : Regression
        Rows, in original units.
    constraints : Constraints
        What is known of the coefficients.
    standard : Standardised
        The Gram that the engine was given: equalities between coefficients taken out, standardised.
    prior : Prior
        On standardised columns, with the v_s that was used.
    posterior : Posterior
        The engine's, in units of `standard`.
    """

    regression: Regression
    constraints: Constraints
    standard: Standardised
    prior: Prior
    posterior: Posterior

    @cached_property
    def problem(self) -> Problem:
        """What models are compared on."""
        return Problem.of(self.standard.gram, self.prior)

    @cached_property
    def rows(self) -> Gram:
        """Statistics of the training rows, equalities taken out: what shares of variance refer to."""
        return self.constraints.reduce(self.regression.rows)

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
        return self.constraints.expand(posterior.rescaled(self.standard), self.regression.gram)

    def reported(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` as it is reported: the uncertainty of the sensors' calibration is added to it."""
        found, equalities = self.expanded(posterior), self.constraints.equalities
        basis, limits = equalities.basis(found.support), None
        if self.prior.limits is not None:
            limits = np.tile([-np.inf, np.inf], (len(found.support), 1))
            limits[equalities.kept] = self.prior.limits * (self.standard.target_scale / self.standard.scale)[:, None]
            limits = np.where(np.isfinite(self.constraints.limits), self.constraints.limits, limits)
        found = self.regression.reported(found, basis, limits, not self._truncated(posterior.support))
        return replace(calibrated(self.regression, found, basis), bounds=self.constraints.bounds)

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
            refused = names[k] in self.posterior.contradicted
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
        from bayeq.inference.signs.truncation import Truncation

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
    """Posterior of one equation.

    Parameters
    ----------
    regression : Regression
        What counts as data.
    constraints : Constraints
        Equalities are taken out before inference; signs and bounds go into the prior.
    engine : Engine
        A row of `bayeq.inference.engines.ENGINES`.
    prior : Prior, optional
        On standardised columns, the target in units of the least-squares residual. By default p_0 = 0.1 and a slab
        variance v_s that maximises the evidence, at least 10.
    coarsen : float
        Power, above 0 and at most 1, that the likelihood is raised to.
    tolerance : float, optional
        Size of what the terms may lack beside the likelihood of rows (`bayeq.likelihood.spike`).
    seed : tuple of int
        Of engines that draw random numbers.
    """
    regression = regression.raised(coarsen)
    reduced = constraints.reduce(regression.gram)
    standard = reduced.standardise(residual_scale(reduced))
    if tolerance and isinstance(standard.gram, Gram) and regression.counts_rows:
        standard = replace(standard, gram=softened_rows(standard.gram, tolerance))
    used = constraints.prior(prior or Prior(), standard.scale / standard.target_scale)
    if prior is None:
        used = replace(used, slab_variance=learn_slab_variance(standard.gram, used))
    options = {"seed": seed} if engine.random else {}
    return RegressionFit(regression, constraints, standard, used, engine.run(standard.gram, used, **options))
