"""From a regression to its posterior: which prior, which engine, and the way back to original units."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import Gram, Standardised
from bayeq.inference.collapsed.conditional import exact_posterior, noise_given_model
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.engines import Engine
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.likelihood.projection import projected
from bayeq.likelihood.record_fit import RecordFit
from bayeq.likelihood.spike import softened_rows
from bayeq.regression.channel_errors import calibrated
from bayeq.regression.constraints import Constraints
from bayeq.regression.regression import Regression

__all__ = ["RegressionFit", "fit_regression"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Degrees of freedom of an interval, at least.
LEAST_FREEDOM = 3.0


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
    coarsen : float
        Power that the likelihood was raised to.
    """

    regression: Regression
    constraints: Constraints
    standard: Standardised
    prior: Prior
    posterior: Posterior
    coarsen: float = 1.0

    @property
    def exact(self) -> float:
        """Probability that the law lacks nothing, or nothing beyond the tolerance; NaN where that is not known."""
        record = self.regression.record
        return math.nan if record is None else record.nearly.exact[self.regression.k]

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
        coef, covariance = exact_posterior(self.problem, model, self.prior.known_signs)
        noise = noise_given_model(self.problem, model)
        return replace(self.posterior, support=model, coef=coef, covariance=covariance, noise_variance=noise)

    def about(self, record: RecordFit) -> RegressionFit:
        """The same posterior with the likelihood of the record about another model."""
        k = self.regression.k
        standard = record.standards[k]
        return replace(
            self,
            regression=replace(self.regression, gram=standard.source, record=record),
            standard=standard,
            posterior=replace(self.posterior, left_out_intercept=record.left_out_intercept(k)),
        )

    def expanded(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` in original units and of all P terms."""
        return self.constraints.expand(posterior.rescaled(self.standard), self.regression.gram)

    def reported(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` as it is reported: the uncertainty of the sensors' calibration is added to it."""
        found = self._reported(posterior)
        return calibrated(self.regression, found, self.constraints.equalities.basis(found.support))

    def _reported(self, posterior: Posterior) -> Posterior:
        found = self.expanded(posterior)
        record, k = self.regression.record, self.regression.k
        if record is None:
            return found
        found = replace(found, target_mean_variance=found.noise_variance / found.n)
        if self.coarsen == 1.0 and record.projectable(k, found.support):
            found = self._projected(record, found, free=not self._truncated(posterior.support))
        return replace(found, noise_variance=self.regression.noise_variance(found))

    def _projected(self, record: RecordFit, found: Posterior, free: bool) -> Posterior:
        """The posterior of the terms that the record was fitted with, by projection (`bayeq.likelihood.projection`).

        What is not `free`, coefficients of known sign, stays as it is but for the discrepancy, as far as signs allow.
        """
        k, basis, kept = self.regression.k, self.constraints.equalities.basis(found.support), found.support
        left, (theta, covariance), r = record.leftover(k), record.own_coefficients(k), int(found.support.sum())
        with_constant = len(theta) > r
        whole = np.zeros((len(theta), basis.shape[1] + with_constant))
        whole[:r, : basis.shape[1]] = basis
        whole[r:, basis.shape[1] :] = 1.0
        if not free or basis.shape[1] < r:
            carried = found.covariance @ found.center[kept]
            whole_covariance = np.block(
                [[found.covariance, -carried[:, None]], [-carried[None], np.array([[found.intercept_sd**2]])]]
            )
            theta = np.append(found.coef[kept], found.intercept)[: len(theta)]
            covariance = whole_covariance[: len(theta), : len(theta)]
        moved = projected(left, whole)
        change = moved.change
        if self.prior.known_signs is not None:
            signs = np.zeros(len(kept))
            signs[self.constraints.equalities.kept] = self.prior.known_signs
            known = np.append(signs[kept], np.zeros(int(with_constant)))
            change = np.where(known * (theta + change) < 0.0, -theta, change)
        both = covariance + moved.covariance
        added, total = np.diagonal(moved.covariance), np.diagonal(both)
        # Satterthwaite, of a part that is known and one that is estimated
        freedom = moved.freedom * (total / np.maximum(added, 1e-9 * total + np.finfo(float).tiny)) ** 2
        coef, own, sd = np.zeros((3, len(kept)))
        coef[kept], own[kept], sd[kept] = (theta + change)[:r], theta[:r], np.sqrt(np.diagonal(covariance))[:r]
        every = np.full(len(kept), np.inf)
        every[kept] = np.maximum(freedom[:r], LEAST_FREEDOM)
        found = replace(
            found,
            coef=coef,
            covariance=both[:r, :r],
            freedom=every,
            likelihood_coef=own,
            likelihood_sd=sd,
            error_share=moved.share,
            error_sd=moved.share * math.sqrt(left.target),
            error_lines=left.lines,
        )
        if not with_constant:
            return found
        # about the centre the constant and the other coefficients are independent
        center = np.zeros(len(kept))
        if r:
            unit = np.sqrt(np.where(total[:r] > 0.0, total[:r], 1.0))  # coefficients that are given have no variance
            center[kept] = -np.linalg.lstsq(both[:r, :r] / np.outer(unit, unit), both[:r, r] / unit)[0] / unit
        mean = float((theta + change)[r] + center @ found.coef)
        variance = max(float(both[r, r] - center[kept] @ both[:r, :r] @ center[kept]), 0.0)
        return replace(found, center=center, target_mean=mean, target_mean_variance=variance)

    def _truncated(self, model: Bools) -> bool:
        """Whether known signs change the posterior given a model: they do unless the data leave no doubt of them."""
        signs = self.prior.known_signs
        if signs is None:
            return False
        # brings scipy.special, which takes a while to import
        from bayeq.inference.signs.truncation import Truncation

        return bool(Truncation(self.problem, signs, model[None, :]).needed.any())


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
        Equalities are taken out before inference; signs go into the prior.
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
    if tolerance and isinstance(standard.gram, Gram) and regression.record is None:
        standard = replace(standard, gram=softened_rows(standard.gram, tolerance))
    used = constraints.prior(prior or Prior())
    if prior is None:
        used = replace(used, slab_variance=learn_slab_variance(standard.gram, used))
    options = {"seed": seed} if engine.random else {}
    return RegressionFit(regression, constraints, standard, used, engine.run(standard.gram, used, **options), coarsen)
