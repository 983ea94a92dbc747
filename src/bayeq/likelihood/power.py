"""The power that a likelihood is raised to where its innovations are not independent.

Noise that is not white, or motion that the equations do not hold, leaves scores s_t of the coefficients that are
correlated in time. Their sum then has the covariance J = sum over l of E[s_t s_(t-l)'], not the information H that the
likelihood states. Raised to the power r/tr(H^-1 J), at most 1, the likelihood of r coefficients is as wide as its
errors are on average (Pauli, Racugno and Ventura 2011, of composite likelihoods).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.filter import Filtered
from bayeq.likelihood.model import Fitted, Task
from bayeq.likelihood.settings import LIKELIHOOD


def power_of(task: Task, fitted: Fitted) -> float:
    """The power, 1 where innovations look independent."""
    if not len(fitted.state.theta):
        return 1.0
    found = task.marginal(fitted.state)
    root = np.linalg.cholesky(found.covariance)
    excess, error = excess_of([_scores(one, found.delta) @ root for one in found.filtered])
    return 1.0 / excess if excess > 1.0 + LIKELIHOOD.correlated_by * error else 1.0


def _scores(filtered: Filtered, delta: Floats) -> Floats:
    """Derivatives of the log likelihood of every sample by the coefficients, (n, r)."""
    known = filtered.variance > 0.0
    sd = np.sqrt(np.where(known, filtered.variance, 1.0))[..., None]
    standard = np.where(known[..., None], filtered.innovation / sd, 0.0)
    left = standard[..., 0] - standard[..., 1:] @ delta
    return np.asarray(np.einsum("tk,tki->ti", left, standard[..., 1:]))


def excess_of(scores: Sequence[Floats]) -> tuple[float, float]:
    """tr(J)/r of scores whose stated covariance is the identity, and its standard error were they independent.

    Parameters
    ----------
    scores : sequence of (n, r) arrays
        Of uninterrupted pieces.
    """
    r, longest = scores[0].shape[1], max(map(len, scores))
    excess, square, lag = sum(float(np.sum(one**2)) for one in scores) / r, 0.0, 0
    while lag < min(LIKELIHOOD.correlated_lags * excess, longest - 1):
        lag += 1
        products = [np.einsum("ti,ti->t", one[lag:], one[:-lag]) for one in scores if len(one) > lag]
        excess += 2.0 / r * sum(float(p.sum()) for p in products)
        square += (2.0 / r) ** 2 * sum(float(p @ p) for p in products)
    return excess, float(np.sqrt(square))
