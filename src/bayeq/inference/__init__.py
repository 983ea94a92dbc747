"""Engines: from a Gram matrix to a posterior.

An engine is a function ``engine(gram, prior, **options) -> Posterior``; a new one is a file and a row here.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.vb import spike_slab_vb
from bayeq.posterior import Posterior

__all__ = ["AUTO", "ENGINES", "Prior", "rvm", "spike_slab_vb"]

# Engines that `discover` offers, selecting by PIP > 0.5 (the RVM by its gamma, which stands in for a PIP).
ENGINES: dict[str, Callable[..., Posterior]] = {
    "vb": spike_slab_vb,
    "rvm": partial(rvm, least_gamma=0.5),
}

# What method="auto" means.
AUTO = "vb"
