"""Engines: from a Gram matrix to a posterior.

An engine is a function ``engine(gram, prior, **options) -> Posterior``; a new one is a file and a row here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.stlsq import stlsq, sweep_stlsq
from bayeq.inference.vb import spike_slab_vb

__all__ = [
    "ENGINES",
    "Engine",
    "Posterior",
    "Prior",
    "rvm",
    "spike_slab_auto",
    "spike_slab_bma",
    "spike_slab_gibbs",
    "spike_slab_vb",
    "stlsq",
    "sweep_stlsq",
]


@dataclass(frozen=True, slots=True)
class Engine:
    """A row of the table.

    Attributes
    ----------
    run : callable
        ``run(gram, prior, **options) -> Posterior``.
    title : str
        What it is, for the reader of its answer.
    score : str
        What stands in the column of its `pip`.
    spike_slab : bool
        Whether its prior is the spike-and-slab prior, under which models can be compared.
    random : bool
        Whether it draws random numbers: it then takes ``seed``.
    """

    run: Callable[..., Posterior]
    title: str
    score: str = "PIP"
    spike_slab: bool = False
    random: bool = False


# Engines that `discover` offers; all of them select the terms whose `pip` exceeds 0.5.
ENGINES: dict[str, Engine] = {
    "auto": Engine(
        spike_slab_auto,
        "auto: PIPs by model averaging, coefficients exact given the included terms, ELBO by variational Bayes;"
        " spike-and-slab prior",
        spike_slab=True,
    ),
    "bma": Engine(spike_slab_bma, "model averaging with exact weights, spike-and-slab prior", spike_slab=True),
    "vb": Engine(spike_slab_vb, "variational Bayes, spike-and-slab prior", spike_slab=True),
    "gibbs": Engine(spike_slab_gibbs, "Gibbs sampling (MCMC), spike-and-slab prior", spike_slab=True, random=True),
    "rvm": Engine(
        partial(rvm, least_gamma=0.5),
        "relevance vector machine; gamma is a relevance, not a probability",
        score="gamma",
    ),
    "stlsq": Engine(
        partial(sweep_stlsq, columns="raw"),
        "sequentially thresholded least squares (SINDy), threshold by the Bayesian information criterion;"
        " no probabilities",
        score="in",
    ),
}
