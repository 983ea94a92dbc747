"""The table of engines: from a Gram matrix to a posterior.

An engine is a function ``engine(gram, prior, **options) -> Posterior``; a new one is a file and a row here, or an entry
point ``bayeq.engines``. The table loads no engine: the command line reads names from it; one is imported where it runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from bayeq.plugins import Table

if TYPE_CHECKING:
    from bayeq.inference.posterior import Posterior

# Least inclusion probability of a candidate outside the equation for it to be listed and drawn.
NOTEWORTHY_PIP = 0.01


@dataclass(frozen=True, slots=True)
class Engine:
    """A row of the table."""

    function: str | Callable[..., Posterior]  # the function, or "module:name" of one in this folder
    title: str  # description of the method, printed with its answer
    score: str = "PIP"  # header of the column of `pip` in printed tables
    spike_slab: bool = False  # whether its prior is the spike-and-slab prior, under which models can be compared
    random: bool = False  # whether it draws random numbers: it then takes ``seed``
    options: Mapping[str, Any] = field(default_factory=dict)  # arguments that differ from the function's defaults

    @property
    def run(self) -> Callable[..., Posterior]:
        """``run(gram, prior, **options) -> Posterior``."""
        if not isinstance(self.function, str):
            return partial(self.function, **self.options)
        module, name = self.function.split(":")
        return partial(getattr(import_module(f"bayeq.inference.{module}"), name), **self.options)


# Every engine selects the terms whose `pip` exceeds 0.5.
_OWN = {
    "auto": Engine(
        "auto:spike_slab_auto",
        "auto: PIPs by model averaging, coefficients exact given the included terms, ELBO by variational Bayes;"
        " spike-and-slab prior",
        spike_slab=True,
    ),
    "vb": Engine("vb:spike_slab_vb", "variational Bayes, spike-and-slab prior", spike_slab=True),
    "bma": Engine("bma:spike_slab_bma", "model averaging with exact weights, spike-and-slab prior", spike_slab=True),
    "gibbs": Engine(
        "gibbs:spike_slab_gibbs", "Gibbs sampling (MCMC), spike-and-slab prior", spike_slab=True, random=True
    ),
    "rvm": Engine(
        "rvm:rvm",
        "relevance vector machine; gamma is a relevance, not a probability",
        score="gamma",
        options={"least_gamma": 0.5},
    ),
    "stlsq": Engine(
        "stlsq:sweep_stlsq",
        "sequentially thresholded least squares (SINDy), threshold by the Bayesian information criterion;"
        " no probabilities",
        score="in",
        options={"columns": "raw"},
    ),
}
ENGINES = Table("engines", Engine, _OWN)


def spike_slab_methods() -> list[str]:
    """Names of the engines with the spike-and-slab prior, those of plug-ins among them."""
    return [name for name, engine in ENGINES.items() if engine.spike_slab]
