"""ArviZ: convergence of chains, and draws as its data structure."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError, needing
from bayeq.inference.posterior import Draws, Posterior

if TYPE_CHECKING:
    import pandas as pd


def _arviz(purpose: str) -> Any:
    with needing("ArviZ", "arviz", purpose), warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # it announces its refactoring on import
        import arviz
    return arviz


def convergence(posterior: Posterior) -> pd.DataFrame:
    """Rank-normalised R-hat and effective sample sizes of the draws (Vehtari et al. 2021).

    Parameters
    ----------
    posterior : Posterior
        With draws, from `spike_slab_gibbs` or `SpikeSlabGibbs.posterior_`.

    Returns
    -------
    DataFrame
        A row per term and one for ``noise_variance``; columns ``rhat``, ``ess_bulk``, ``ess_tail``, and
        ``multivariate_rhat`` (Brooks and Gelman 1998), the same in every row. NaN for a term that never varies.

    Raises
    ------
    InputError
        A posterior without draws.
    MissingExtraError
        ArviZ is not installed.
    """
    import pandas as pd

    draws = _draws(posterior)
    az = _arviz("rank-normalised R-hat and effective sample sizes")
    columns = dict(zip(posterior.names, np.moveaxis(draws.theta, 2, 0), strict=True))
    columns["noise_variance"] = draws.noise_variance
    rows = {}
    for name, values in columns.items():
        if values.min() == values.max():
            rows[name] = dict.fromkeys(("rhat", "ess_bulk", "ess_tail"), math.nan)
        else:
            with np.errstate(all="ignore"):
                rows[name] = {
                    "rhat": float(az.rhat(values)),
                    "ess_bulk": float(az.ess(values)),
                    # the quantiles that ArviZ took by itself before 1.0
                    "ess_tail": float(az.ess(values, method="tail", prob=(0.05, 0.95))),
                }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table["multivariate_rhat"] = posterior.details.rhat
    return table


def to_arviz(
    posterior: Posterior,
    draws: Draws | None = None,
    *,
    D: ArrayLike | None = None,
    y: ArrayLike | None = None,
    rng: np.random.Generator,
    statistics: Mapping[str, NDArray[Any]] | None = None,
) -> Any:
    """Draws as ArviZ keeps them, for its summaries, plots and files.

    Parameters
    ----------
    posterior : Posterior
        In the units of D and y.
    draws : Draws, optional
        By default those of the posterior.
    D : (n*, P) array, optional
        Rows at which y is drawn from the posterior predictive distribution, once per draw.
    y : (n*,) array, optional
        Values observed at these rows.
    rng : Generator
        For the intercept, which is Gaussian about mean(y) - mean(D) theta given theta and sigma^2, and for the
        predictions.
    statistics : mapping of (chains, samples) arrays, optional
        More statistics of each draw, by name.

    Returns
    -------
    InferenceData, or DataTree from ArviZ 1.0 on
        Groups ``posterior`` (``coef`` and ``inclusion`` by ``term``, ``intercept``, ``noise_variance``),
        ``sample_stats`` (``lp``, the log posterior of the draw's model, up to a constant), and where asked for
        ``posterior_predictive`` and ``observed_data`` (``y`` by ``row``).

    Raises
    ------
    InputError
        A posterior without draws, or shapes that do not match.
    MissingExtraError
        ArviZ is not installed.
    """
    if draws is None:
        draws = _draws(posterior)
    rows, observed = _checked(posterior, D, y)
    az = _arviz("to_arviz")
    spread = np.sqrt(draws.noise_variance)
    centre = posterior.constant.mean - draws.theta @ posterior.constant.center
    known = posterior.constant.variance  # set by the likelihood of a record, instead of the number of rows
    sd = spread / math.sqrt(posterior.n) if known is None else math.sqrt(known)
    if posterior.constant.left_out is not None:  # posterior of an intercept that is not in the model
        centre, sd = np.broadcast_to(np.asarray(posterior.constant.left_out)[:, None, None], (2, *spread.shape))
    intercept = centre + sd * rng.standard_normal(spread.shape)
    groups: dict[str, dict[str, NDArray[Any]]] = {
        "posterior": {
            "coef": draws.theta,
            # as numbers: ArviZ 1.0 does not summarise booleans
            "inclusion": draws.z.astype(np.int8),
            "intercept": intercept,
            "noise_variance": draws.noise_variance,
        },
        "sample_stats": {"lp": draws.log_posterior, **(statistics or {})},
    }
    if rows is not None:
        predicted = rng.standard_normal((*spread.shape, len(rows)))
        predicted *= spread[..., None]
        predicted += intercept[..., None]
        predicted += draws.theta @ rows.T
        groups["posterior_predictive"] = {"y": predicted}
    if observed is not None:
        groups["observed_data"] = {"y": observed}
    layout = {
        "coords": {"term": list(posterior.names)},
        "dims": {"coef": ["term"], "inclusion": ["term"], "y": ["row"]},
    }
    # from 1.0 on the groups are one argument
    return az.from_dict(**groups, **layout) if az.__version__.startswith("0.") else az.from_dict(groups, **layout)


def _draws(posterior: Posterior) -> Draws:
    if posterior.draws is None:
        raise InputError("this posterior has no draws: sample it with keep_draws=True")
    return posterior.draws


def _checked(posterior: Posterior, D: ArrayLike | None, y: ArrayLike | None) -> tuple[Floats | None, Floats | None]:
    """Rows to predict at and values observed there, of shapes that match."""
    rows = None if D is None else np.asarray(D, dtype=np.float64)
    observed = None if y is None else np.asarray(y, dtype=np.float64)
    terms = len(posterior.names)
    if rows is not None and (rows.ndim != 2 or rows.shape[1] != terms):
        raise InputError(f"D must have shape (n, {terms}), a column per term, got {rows.shape}")
    if observed is not None and observed.ndim != 1:
        raise InputError(f"y must be one target, of shape (n,), got {observed.shape}")
    if rows is not None and observed is not None and len(rows) != len(observed):
        raise InputError(f"D and y must have as many rows, got {len(rows)} and {len(observed)}")
    return rows, observed
