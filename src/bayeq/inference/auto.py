"""The default: the optimum of variational Bayes, with probabilities and spreads from model averaging."""

from __future__ import annotations

from dataclasses import replace

from bayeq.gram import GramLike
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.posterior import Posterior

__all__ = ["spike_slab_auto"]


def spike_slab_auto(gram: GramLike, prior: Prior | None = None, *, tolerance: float = 5e-3) -> Posterior:
    """SS-VB and model averaging together.

    Parameters
    ----------
    gram : GramLike
        Sufficient statistics, standardised.
    prior : Prior, optional
        By default the paper's.
    tolerance : float
        Posterior mass that the averaging may leave out.

    Returns
    -------
    Posterior
        From model averaging: `pip`, `support` (the median probability model), `coef` and `covariance` (exact given
        that model), `averaged_coef`, `averaged_sd`, `noise_variance`, `average`. From variational Bayes: `elbo`,
        `elbo_trace`, and `optimum`, the terms at its optimum.
    """
    vb = spike_slab_vb(gram, prior)
    bma = spike_slab_bma(gram, prior, tolerance=tolerance)
    return replace(
        bma,
        method="auto",
        elbo=vb.elbo,
        elbo_trace=vb.elbo_trace,
        n_iter=vb.n_iter,
        converged=vb.converged and bma.converged,
        optimum=vb.support,
    )
