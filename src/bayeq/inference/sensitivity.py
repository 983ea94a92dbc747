"""PIPs under other priors: the same data, averaged over models with other v_s and p_0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from bayeq.errors import InputError
from bayeq.gram import GramLike
from bayeq.inference.bma import average_models
from bayeq.inference.collapsed.problem import Bools, Floats, Problem
from bayeq.inference.prior import Prior

__all__ = ["common_inclusion", "inclusion_axis", "pip_grid", "slab_axis", "with_inclusion"]

# By default v_s is varied by these factors, but not below the least value, and p_0 over these values.
FACTORS = 10.0 ** np.linspace(-2.0, 2.0, 9)
LEAST_SLAB_VARIANCE = 0.1
INCLUSIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


def common_inclusion(prior: Prior, terms: int) -> float:
    """The one number that p_0 is, or that stands for it.

    Where terms have p_0 of their own, the probability of their mean log-odds (of the terms neither forced nor
    forbidden); where p_0 ~ Beta(a, b), its mean a/(a + b).

    Raises
    ------
    InputError
        No term is free: all are forced or forbidden, and no PIP depends on the prior.
    """
    prior.validate(terms)
    log_odds = prior.log_odds(terms)
    free = np.isfinite(log_odds)
    if not free.any():
        raise InputError("every term is forced in or kept out: their PIPs are 1 and 0 under any v_s and p_0")
    if prior.inclusion_beta is not None:
        a, b = prior.inclusion_beta
        return float(a / (a + b))
    p0 = np.asarray(prior.prior_inclusion, dtype=np.float64)
    if p0.ndim == 0:
        return float(p0)
    return float(1.0 / (1.0 + np.exp(-log_odds[free].mean())))


def with_inclusion(prior: Prior, terms: int, inclusion: float) -> Prior:
    """The prior with another `common_inclusion`.

    Forced and forbidden terms stay as they are. The log-odds of all others are shifted by the same amount, so that a
    term that had twice the odds of another keeps them; of p_0 ~ Beta(a, b) the mean moves and a + b stays.
    """
    common = common_inclusion(prior, terms)
    if inclusion == common:
        return prior
    if prior.inclusion_beta is not None:
        weight = sum(prior.inclusion_beta)
        return replace(prior, inclusion_beta=(weight * inclusion, weight * (1.0 - inclusion)))
    if np.ndim(prior.prior_inclusion) == 0:
        return replace(prior, prior_inclusion=inclusion)
    shift = np.log(inclusion / (1.0 - inclusion)) - np.log(common / (1.0 - common))
    # infinite log-odds, of forced and forbidden terms, stay infinite
    with np.errstate(over="ignore"):
        return replace(prior, prior_inclusion=1.0 / (1.0 + np.exp(-(prior.log_odds(terms) + shift))))


def slab_axis(prior: Prior, values: ArrayLike | None = None) -> tuple[Floats, int]:
    """Values of v_s in ascending order, the prior's own among them, and where that stands.

    Raises
    ------
    InputError
        Values that are not positive numbers.
    """
    own = float(prior.slab_variance)
    if values is None:
        values = own * FACTORS
        values = values[values >= LEAST_SLAB_VARIANCE]
    return _axis("slab_variances", values, own, np.inf)


def inclusion_axis(prior: Prior, terms: int, values: ArrayLike | None = None) -> tuple[Floats, int]:
    """Values of p_0 in ascending order, the prior's own (`common_inclusion`) among them, and where that stands.

    Raises
    ------
    InputError
        Values that are not between 0 and 1, or a prior without free terms.
    """
    return _axis("prior_inclusions", INCLUSIONS if values is None else values, common_inclusion(prior, terms), 1.0)


def _axis(name: str, values: ArrayLike, own: float, upper: float) -> tuple[Floats, int]:
    given = np.atleast_1d(np.asarray(values, dtype=np.float64))
    if given.ndim > 1:
        raise InputError(f"{name} must be a list of numbers, got an array of shape {given.shape}")
    wrong = given[~((given > 0.0) & (given < upper))]
    if len(wrong):
        allowed = "positive numbers" if upper == np.inf else f"greater than 0 and less than {upper:g}"
        raise InputError(f"{name} must be {allowed}, got {wrong[0]:g}")
    # a value that differs from the prior's own by rounding is the prior's own
    others = given[~np.isclose(given, own, rtol=1e-9, atol=0.0)]
    axis = np.unique(np.append(others, own))
    return axis, int(np.searchsorted(axis, own))


def pip_grid(
    gram: GramLike,
    prior: Prior,
    slab_variances: Floats,
    prior_inclusions: Floats,
    wanted: Bools,
    *,
    tolerance: float = 5e-3,
) -> tuple[Floats, Floats]:
    """PIPs by model averaging at pairs of v_s and p_0; the rest of the prior stays.

    Parameters
    ----------
    gram : GramLike
        Sufficient statistics, standardised.
    prior : Prior
        What else is assumed.
    slab_variances : (V,) array
        v_s.
    prior_inclusions : (Q,) array
        p_0 as `with_inclusion` takes it.
    wanted : (V, Q) bool array
        Pairs to compute.
    tolerance : float
        Posterior mass that the averaging may leave out.

    Returns
    -------
    pip : (V, Q, P) array
        Over the models listed, as `spike_slab_bma` has them; NaN where not wanted.
    left_out : (V, Q) array
        Estimate, erring upwards, of the posterior mass of all other models: a PIP is off by no more. NaN where not
        wanted.
    """
    terms = len(gram.names)
    pip = np.full((len(slab_variances), len(prior_inclusions), terms), np.nan)
    left_out = np.full(pip.shape[:2], np.nan)
    columns = Problem.of(gram, prior).columns
    for q, inclusion in enumerate(prior_inclusions):
        shifted = with_inclusion(prior, terms, float(inclusion))
        for v in np.flatnonzero(wanted[:, q]):
            at = replace(shifted, slab_variance=float(slab_variances[v]))
            # rows of D'D that one problem has asked for serve all of them
            found = average_models(Problem.of(gram, at)._replace(columns=columns), tolerance=tolerance)
            pip[v, q] = np.minimum(found.weights @ found.models, 1.0)
            left_out[v, q] = found.left_out
    return pip, left_out
