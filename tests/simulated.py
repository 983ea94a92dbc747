"""Simulated records that several test files use."""

from __future__ import annotations

import math
from dataclasses import replace

import bayeq as bq

__all__ = ["FINE", "FS", "coarse"]

# 13 samples per natural period, where whole sampling intervals would be coarse steps.
FS, FINE = 65.0, 15


def coarse(system, n, seed, noise, fs=FS):
    """A record decimated from a simulation at a finer rate."""
    known = bq.SYSTEMS[system]
    force = replace(known.force, band=(0.0, fs / 4), std=known.force.std * math.sqrt(fs / 400))
    return bq.simulate(replace(known, force=force), n=n * FINE, fs=fs * FINE, seed=seed, noise=noise).slice(
        0, None, FINE
    )
