"""The algorithms of a study, a table: a new one is a function and a row.

Each sees one realisation: the training Gram in original units, the held-out Gram (only SINDy looks at it, to choose its
threshold as the paper does) and the regression that they come from; the study's numbers; and a seed of its own. It
answers in original units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import Gram, Standardised
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.slab import learn_slab_variance, residual_scale
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import sweep_stlsq
from bayeq.inference.vb import spike_slab_vb
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.joint import fit_equations
from bayeq.regression.regression import Regression
from bayeq.selection.select import Rules, select
from bayeq.study.config import StudyConfig

__all__ = ["ALGORITHMS", "Algorithm", "Estimate", "Realisation", "estimate"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an algorithm answers.

    Attributes
    ----------
    support : (P,) bool array
        The selected terms.
    coef : (P,) array
        Coefficients in original units, 0 for a term that is not selected.
    converged : bool
        Whether it says it has converged.
    extras : mapping of str to plain data
        What else is worth keeping.
    """

    support: NDArray[np.bool_]
    coef: NDArray[np.float64]
    converged: bool = True
    extras: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Realisation:
    """The data of one realisation.

    Attributes
    ----------
    regression : Regression
        Of the first rows.
    train, test : Gram
        What counts as data of the first rows, and the last rows, in original units.
    truth : (P,) array
        True coefficients of the candidate terms.
    """

    regression: Regression
    train: Gram
    test: Gram
    truth: Floats


Algorithm = Callable[[Realisation, StudyConfig, tuple[int, ...]], Estimate]


def estimate(posterior: Posterior) -> Estimate:
    """The estimate in a posterior that is in original units already."""
    extras: dict[str, Any] = {"n_iter": int(posterior.n_iter)}
    for name in ("elbo", "rhat"):
        value = getattr(posterior, name)
        if value is not None and math.isfinite(value):
            extras[name] = float(value)
    return Estimate(posterior.support, posterior.coef, bool(posterior.converged), extras)


def _posed(train: Gram, config: StudyConfig) -> tuple[Standardised, Prior]:
    """The standardised problem and its prior: the paper's, or on smoothed records the defaults of `bayeq.discover`.

    Smoothing raises the signal-to-noise ratio, for which the paper's slab is too narrow: its variance is then learned,
    and the noise prior applies in units of the residual.
    """
    prior = Prior(config.slab_variance, config.prior_inclusion, config.noise_shape, config.noise_rate)
    if config.smooth == "none":
        return train.standardise(), prior
    standard = train.standardise(residual_scale(train))
    return standard, replace(prior, slab_variance=learn_slab_variance(standard.gram, prior, config.slab_variance))


def _sindy(
    columns: Literal["raw", "standardised"], data: Realisation, config: StudyConfig, seed: tuple[int, ...]
) -> Estimate:
    """Sequential threshold least squares, its threshold on raw or standardised columns swept on the held-out error."""
    return estimate(sweep_stlsq(data.train, held_out=data.test, columns=columns))


def _rvm(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Estimate:
    """Relevance vector machine; selected is what is left in the machine."""
    standard = data.train.standardise()
    return estimate(rvm(standard.gram).rescaled(standard))


def _gibbs(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Estimate:
    """SS-MCMC: the collapsed Gibbs sampler, eqs. (33)-(34), as in the paper without exchange steps."""
    standard, prior = _posed(data.train, config)
    chains = {"chains": config.chains, "samples": config.samples, "burn_in": config.burn_in}
    posterior = spike_slab_gibbs(standard.gram, prior, **chains, exchange=False, seed=seed, keep_draws=False)
    return estimate(posterior.rescaled(standard))


def _auto(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Estimate:
    """What `bayeq.discover` shows by default: its prior, its noise model and its selection."""
    regression = data.regression
    free = parse_constraints((), regression.design.terms, [regression.chain.target])
    (fit,) = fit_equations([regression], free, "auto", seed=seed)
    (selection,) = select([fit], Rules(), regression.motion)
    return estimate(fit.expanded(selection.shown))


def _bma(data: Realisation, config: StudyConfig, seed: tuple[int, ...]) -> Estimate:
    """Model averaging with exact weights; selected is the median probability model."""
    standard, prior = _posed(data.train, config)
    return estimate(spike_slab_bma(standard.gram, prior).rescaled(standard))


def _vb(
    init: Literal["search", "greedy", "rvm"], data: Realisation, config: StudyConfig, seed: tuple[int, ...]
) -> Estimate:
    """SS-VB, from one start or several."""
    standard, prior = _posed(data.train, config)
    return estimate(spike_slab_vb(standard.gram, prior, init=init).rescaled(standard))


ALGORITHMS: dict[str, Algorithm] = {
    "sindy": partial(_sindy, "raw"),
    "sindy-std": partial(_sindy, "standardised"),
    "rvm": _rvm,
    "gibbs": _gibbs,
    "auto": _auto,
    "bma": _bma,
    "vb": partial(_vb, "search"),
    "vb-rvm": partial(_vb, "rvm"),  # as the paper's section 3.2 says
    "vb-greedy": partial(_vb, "greedy"),  # a search that adds and drops terms but never swaps them
}
