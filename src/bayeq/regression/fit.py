"""From a design to the posterior of one equation: which Gram, which prior, which engine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Design
from bayeq.gram import Gram, Standardised
from bayeq.inference import ENGINES, Prior
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.posterior import Posterior
from bayeq.regression.constraints import Constraints
from bayeq.regression.covariance import propagated_covariance
from bayeq.regression.filtered_terms import evaluate_seen
from bayeq.regression.residuals import Residuals, inspect_residuals
from bayeq.regression.weights import InBand, regress_in_band, thinned_gram
from bayeq.selection.limits import Choice, LeftOut
from bayeq.selection.plausible import plausible
from bayeq.states import Chain, ChainSmoothing

__all__ = ["Inferred", "Setting", "fit_of", "infer_equation", "inspected", "posterior_of"]

Floats = NDArray[np.float64]

# Residuals smaller than this share of the target are rounding of the Gram, and correlated.
ROUNDING = 1e-6

# With more candidates than this, correlation of the residuals is told of but not counted.
MOST_TERMS_TO_THIN = 500


@dataclass(frozen=True, eq=False)
class Setting:
    """What all equations of a system have in common.

    Attributes
    ----------
    chains : tuple of Chain
        One per equation.
    inputs : tuple of str
        Measured inputs.
    design : Design
        Terms, and the Grams of all targets.
    train : sequence of mapping of str to (n,) array
        Columns of the training rows of each record.
    observed : tuple of str
        The column of each target that equations are judged by: measured, where there is one.
    smoothings : tuple of ChainSmoothing
        How each chain was smoothed; empty if none was.
    estimated : tuple of (ChainSmoothing or None)
        The same of each target that was estimated, None of those measured.
    method : str
        Of `ENGINES`.
    prior : Prior or None
        A given one.
    coarsen : float
        Power that the likelihood is raised to.
    seed : int
        For methods that draw random numbers.
    """

    chains: tuple[Chain, ...]
    inputs: tuple[str, ...]
    design: Design
    train: Sequence[Mapping[str, Floats]]
    observed: tuple[str, ...]
    smoothings: tuple[ChainSmoothing, ...]
    estimated: tuple[ChainSmoothing | None, ...]
    method: str
    prior: Prior | None
    coarsen: float
    seed: int


@dataclass(frozen=True, eq=False)
class Inferred:
    """The regression of one equation and its answer.

    Attributes
    ----------
    which : int
        Number of the equation.
    in_band : InBand or None
        The band regression, where states were smoothed.
    gram : Gram
        What counts as data: of the band, or of as many rows as the residuals are worth.
    standard : Standardised
        The same standardised, equalities between coefficients taken out.
    prior : Prior
        On standardised columns.
    fitted : Gram
        Of all training rows, equalities taken out: what shares of variance are of.
    constraints : Constraints
        What is known of the coefficients.
    found : Posterior
        Of the engine, on standardised columns.
    shown : Posterior
        The same given the terms that the equation is to have.
    left_out : tuple of LeftOut
        Terms that are in the one and not in the other.
    undecided : mapping of str to tuple of str
        Terms that are shown, each with terms left out that could as well stand in its place.
    """

    which: int
    in_band: InBand | None
    gram: Gram
    standard: Standardised
    prior: Prior
    fitted: Gram
    constraints: Constraints
    found: Posterior
    shown: Posterior
    left_out: tuple[LeftOut, ...] = ()
    undecided: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def infer_equation(setting: Setting, which: int, constraints: Constraints, choice: Choice) -> Inferred:
    """The posterior of one equation."""
    rows = setting.design.train[which]
    method = ENGINES[setting.method]
    in_band = regress_in_band(
        setting.design.terms, setting.train, setting.chains, setting.smoothings, which, setting.inputs
    )
    if in_band is not None:
        gram = in_band.gram
    elif method.spike_slab and len(rows.names) <= MOST_TERMS_TO_THIN:
        gram = thinned_gram(rows, lambda posterior: inspected(setting, which, posterior))
    else:
        gram = rows
    gram = gram.raised(setting.coarsen)
    reduced, fitted = constraints.reduce(gram), constraints.reduce(rows)
    standard = reduced.standardise(residual_scale(reduced))
    prior = constraints.prior(setting.prior or Prior())
    if setting.prior is None:
        prior = replace(prior, slab_variance=learn_slab_variance(standard.gram, prior))
    options: dict[str, Any] = {"seed": (setting.seed, which)} if method.random else {}
    found = method.run(standard.gram, prior, **options)
    if setting.method == "auto":
        found = plausible(standard.gram, prior, found, setting.design.terms)
    shown, left_out = choice.apply(standard.gram, prior, fitted, found) if choice.given else (found, ())
    return Inferred(which, in_band, gram, standard, prior, fitted, constraints, found, shown, left_out)


def posterior_of(setting: Setting, inferred: Inferred) -> tuple[Posterior, float | None]:
    """The posterior of what is shown, in original units and of all terms; and the `Residuals.excess` of a band."""
    posterior = inferred.constraints.expand(inferred.shown.rescaled(inferred.standard), inferred.gram)
    in_band, excess = inferred.in_band, None
    if in_band is None:
        return posterior, excess
    if posterior.support.any() and not inferred.constraints.signs.any():
        basis = inferred.constraints.equalities.basis(posterior.support)
        posterior, excess = _propagated(setting, in_band, inferred.which, posterior, basis)
        named = {setting.design.terms[j].text for j in in_band.noise}
        if not named.issuperset(setting.inputs):
            # noise of inputs that nobody knows is in the residual too
            excess = None
    return replace(posterior, noise_variance=_noise_variance(setting.design.train[inferred.which], posterior)), excess


def _propagated(
    setting: Setting, in_band: InBand, which: int, posterior: Posterior, basis: Floats
) -> tuple[Posterior, float]:
    """The posterior with the covariance that the noise of the channels makes; and how far the residual exceeds it."""
    covariance, excess = propagated_covariance(
        in_band,
        posterior,
        setting.design.terms,
        setting.train,
        setting.chains,
        setting.smoothings,
        which,
        setting.inputs,
        basis,
    )
    covariance = covariance / setting.coarsen
    averaged = posterior.averaged_sd
    if averaged is not None:
        # within the model shown; between models it stays
        kept = posterior.support
        within = posterior.pip[kept] * np.diagonal(covariance)
        change = within - posterior.pip[kept] * np.diagonal(posterior.covariance)
        averaged = averaged.copy()
        averaged[kept] = np.sqrt(np.maximum(averaged[kept] ** 2 + change, within))
    return replace(posterior, covariance=covariance, averaged_sd=averaged), excess


def _residual(setting: Setting, which: int, posterior: Posterior, piece: Mapping[str, Floats]) -> Floats:
    kept = np.flatnonzero(posterior.support)
    out: Floats = piece[setting.observed[which]] - posterior.intercept
    if len(kept):
        terms = [setting.design.terms[j] for j in kept]
        out = out - evaluate_seen(terms, piece, setting.chains, setting.estimated[which]) @ posterior.coef[kept]
    return out[_judged(setting, which, len(out))]


def _judged(setting: Setting, which: int, n: int) -> slice:
    """The rows of a piece that an equation is judged by."""
    smoothing = setting.estimated[which]
    return slice(0, n) if smoothing is None else smoothing.inner(n)


def inspected(setting: Setting, which: int, posterior: Posterior, channels: Sequence[str] = ()) -> Residuals:
    """Training residuals, against some channels; those that are rounding of the Gram count as white."""
    found = inspect_residuals(
        [_residual(setting, which, posterior, piece) for piece in setting.train],
        {
            name: [piece[name][_judged(setting, which, len(piece[name]))] for piece in setting.train]
            for name in channels
        },
    )
    share = fit_of(setting.design.train[which], posterior)
    return found if math.sqrt(share) > ROUNDING else Residuals(found.n, 0.0, float(found.n))


def _noise_variance(rows: Gram, posterior: Posterior) -> float:
    """Variance of the residual over the rows: what the spectrum of the band does not tell."""
    spare = max(rows.n - 1.0 - float(posterior.support.sum()), 1.0)
    return rows.squared_error(posterior.coef, posterior.intercept) / spare


def fit_of(gram: Gram, posterior: Posterior) -> float:
    """Share of the target's variance that is left."""
    return gram.squared_error(posterior.coef, posterior.intercept) / gram.yty if gram.yty > 0 else 1.0
