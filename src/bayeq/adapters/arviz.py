"""Convergence of chains by ArviZ: rank-normalised R-hat and effective sample sizes."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import InputError, MissingExtraError
from bayeq.posterior import Posterior

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["convergence"]


def _arviz() -> Any:
    try:
        with warnings.catch_warnings():
            # ArviZ announces its refactoring on import
            warnings.simplefilter("ignore", FutureWarning)
            import arviz
    except ImportError as error:
        raise MissingExtraError("ArviZ", "arviz", "rank-normalised R-hat and effective sample sizes") from error
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

    if posterior.draws is None:
        raise InputError("this posterior has no draws: sample it with keep_draws=True")
    az = _arviz()
    columns = dict(zip(posterior.names, np.moveaxis(posterior.draws.theta, 2, 0), strict=True))
    columns["noise_variance"] = posterior.draws.noise_variance
    rows = {}
    for name, values in columns.items():
        if values.min() == values.max():
            rows[name] = dict.fromkeys(("rhat", "ess_bulk", "ess_tail"), math.nan)
        else:
            with np.errstate(all="ignore"):
                rows[name] = {
                    "rhat": float(az.rhat(values)),
                    "ess_bulk": float(az.ess(values)),
                    "ess_tail": float(az.ess(values, method="tail")),
                }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table["multivariate_rhat"] = posterior.rhat
    return table
