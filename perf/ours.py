"""Our own contestants, with their defaults: dictionary matrix in, coefficients and selected terms out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bayeq as bq
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.gram import grams_of
from bayeq.inference.stlsq import sweep_stlsq
from perf.problems import Fitted

__all__ = ["BURN_IN", "SAMPLES", "auto", "bma", "gibbs", "rvm", "stlsq", "swept_stlsq", "vb"]

Floats = NDArray[np.float64]

# Sweeps, or transitions, of all samplers after burn-in.
SAMPLES = 2000
BURN_IN = 200


def vb(D: Floats, y: Floats, p0: float) -> Fitted:
    fit = bq.SpikeSlabVB(prior_inclusion=p0).fit(D, y)
    return Fitted(fit.coef_, fit.support_)


def bma(D: Floats, y: Floats, p0: float) -> Fitted:
    fit = bq.SpikeSlabBMA(prior_inclusion=p0).fit(D, y)
    return Fitted(fit.coef_, fit.support_)


def auto(D: Floats, y: Floats, p0: float) -> Fitted:
    standard = grams_of(D, y[:, None])[0].standardise()
    posterior = spike_slab_auto(standard.gram, bq.Prior(prior_inclusion=p0)).rescaled(standard)
    return Fitted(posterior.coef, posterior.support)


def gibbs(D: Floats, y: Floats, p0: float) -> Fitted:
    samples = SAMPLES + BURN_IN
    fit = bq.SpikeSlabGibbs(prior_inclusion=p0, chains=1, samples=samples, burn_in=BURN_IN).fit(D, y)
    return Fitted(fit.coef_, fit.support_)


def rvm(D: Floats, y: Floats, p0: float) -> Fitted:
    del p0
    fit = bq.RVM().fit(D, y)
    return Fitted(fit.coef_, fit.support_)


def stlsq(D: Floats, y: Floats, p0: float) -> Fitted:
    """At one threshold: 0.1 on columns and target of unit variance, as PySINDy's."""
    del p0
    fit = bq.STLSQ(threshold=0.1 * float(y.std()), standardise=True).fit(D, y)
    return Fitted(fit.coef_, fit.support_)


def swept_stlsq(D: Floats, y: Floats, p0: float) -> Fitted:
    """Of 60 thresholds that with the least BIC."""
    del p0
    posterior = sweep_stlsq(bq.Gram.from_data(D, y))
    return Fitted(posterior.coef, posterior.support)
