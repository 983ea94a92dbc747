"""Coefficients and 95 % intervals of one model; intervals and draws over models, which include doubt about terms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.equation.selection.select import LeftOut
from bayeq.errors import whole_number
from bayeq.forecast.dynamics import normal_draws
from bayeq.inference.posterior import Draws, Posterior
from bayeq.numerics.distributions import Z95, t_quantile
from bayeq.numerics.settings import EQUATION
from bayeq.regression.fit import RegressionFit, mixture_of

# Rules that leave out terms to have a simpler equation, not because they are in doubt.
SIMPLER = ("max_terms", "tolerance")


@dataclass(frozen=True, eq=False, slots=True)
class OverModels:
    """95 % intervals averaged over models, which include the uncertainty about the terms."""

    averaged: Floats | None  # (P, 2), over all models, 0 in models without the term; None without model averaging
    # (P, 2), over the models that hold the term, for the printed equation: terms left out for simplicity are taken out
    # of every model. None without model averaging
    given_in: Floats | None
    intercept: Floats | None  # (2,), interval of the intercept over the same models


@dataclass(frozen=True, eq=False)
class Model:
    """An equation's coefficients given one model of its terms, or averaged over models, in original units."""

    terms: tuple[str, ...]  # the P candidates
    inside: Bools  # (P,), whether each is in the model
    coef: Floats  # (P,), posterior means, 0 for a term that is out
    sd: Floats  # (P,), posterior standard deviations
    ci95: Floats  # (P, 2), 95 % intervals
    intercept: float  # estimate of the intercept, even if it is probably zero and not in the model
    intercept_sd: float
    covariance: Floats | None = None  # (r, r), of the r coefficients in the model; None if averaged or not projected

    @classmethod
    def of(cls, posterior: Posterior, terms: tuple[str, ...]) -> Model:
        """The model of the terms in a posterior's support."""
        half = (Z95 if posterior.projected is None else t_quantile(posterior.projected.freedom)) * posterior.sd
        return cls(
            terms,
            posterior.support,
            posterior.coef,
            posterior.sd,
            cut(posterior, np.column_stack([posterior.coef - half, posterior.coef + half])),
            *(posterior.constant.left_out or (posterior.intercept, posterior.intercept_sd)),
            posterior.covariance,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms in the model."""
        return tuple(term for term, kept in zip(self.terms, self.inside, strict=True) if kept)

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients of the terms in the model, by name."""
        return dict(zip(self.names, self.coef[self.inside].tolist(), strict=True))

    def columns(self, prefix: str = "") -> dict[str, Floats]:
        """Table columns ``coef``, ``sd``, ``ci_low`` and ``ci_high``, their names after the prefix."""
        names = (f"{prefix}{name}" for name in ("coef", "sd", "ci_low", "ci_high"))
        return dict(zip(names, (self.coef, self.sd, *self.ci95.T), strict=True))

    @property
    def intercept_ci95(self) -> tuple[float, float]:
        """95 % interval of the intercept."""
        return self.intercept - Z95 * self.intercept_sd, self.intercept + Z95 * self.intercept_sd


def over_models(
    fit: RegressionFit, included: Posterior, shown_fit: RegressionFit, shown: Posterior, left_out: Sequence[LeftOut]
) -> OverModels:
    """Intervals over models: from `fit` about the posterior `included`, from `shown_fit` about the posterior `shown`.

    Terms `left_out` for a simpler equation are taken out of every model of `shown_fit`.
    """
    overall = mixture_of(fit, included)
    struck = np.isin(shown_fit.posterior.names, [left.name for left in left_out if left.reason in SIMPLER])
    same = shown_fit is fit and not struck.any() and bool((included.support == shown.support).all())
    given = overall if same else mixture_of(shown_fit, shown, struck)
    both = None if given is None else given.given_in()
    return OverModels(
        averaged=None if overall is None else cut(included, overall.overall()[:-1]),
        given_in=None if both is None else cut(shown, both[:-1]),
        intercept=None if both is None else both[-1],
    )


def cut(posterior: Posterior, ends: Floats) -> Floats:
    """Intervals (P, 2) clipped to the known bounds of coefficients, except those of terms that are in no model."""
    bounds = posterior.details.bounds
    if bounds is None:
        return ends
    inside = (posterior.pip > 0.0)[:, None] & (ends != 0.0).any(axis=1, keepdims=True)
    return np.where(inside, np.clip(ends, bounds[:, :1], bounds[:, 1:]), ends)


def unlike(one: Floats, other: Floats) -> Bools:
    """Where intervals (P, 2) differ in width or at an end by more than 20 % of the width of the other, (P,)."""
    width = other[:, 1] - other[:, 0]
    ends = np.abs(one - other).max(axis=1)
    return np.maximum(ends, np.abs(one[:, 1] - one[:, 0] - width)) > EQUATION.different * width


def draws_of(fit: RegressionFit, posterior: Posterior, draws: int, seed: int) -> Any:
    """The result of `bayeq.equation.equations.Equations.to_arviz` for one equation's regression and posterior."""
    from bayeq.adapters.arviz import to_arviz

    draws = whole_number("draws", draws, 1)
    rng, average = np.random.default_rng(seed), fit.posterior.average
    if average is None:
        models, probability = fit.posterior.support[None], np.ones(1)
    else:
        models, probability = average.models, average.probability
    which = rng.choice(len(models), size=draws, p=probability)
    z = np.zeros((draws, len(posterior.names)), dtype=np.bool_)
    theta, noise = np.zeros(z.shape), np.zeros(draws)
    for k in np.unique(which):
        rows = np.flatnonzero(which == k)
        one = fit.reported(fit.given(models[k]))
        z[rows], noise[rows] = one.support, one.noise_variance
        theta[np.ix_(rows, np.flatnonzero(one.support))] = normal_draws(
            one.coef[one.support], one.covariance, len(rows), rng
        )
    chain = Draws(z[None], theta[None], noise[None], np.log(probability[which])[None], posterior.pip[None])
    return to_arviz(posterior, chain, rng=rng, statistics={"model": which[None]})
