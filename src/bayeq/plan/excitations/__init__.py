"""Kinds of excitation that plans compare.

A new kind is one file with a function `samples(n, fs, band, rng)` and a row in the table here; the conformance tests do
the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.plan.excitations import multisine, noise, sweep

__all__ = ["EXCITATIONS", "Excitation"]


@dataclass(frozen=True, slots=True)
class Excitation:
    """A row of the table.

    Attributes
    ----------
    title : str
        What it is, with its article.
    samples : callable
        ``samples(n, fs, band, rng)``: n samples at fs [Hz] with their power within ``(lo, hi)`` [Hz], the largest
        magnitude 1. What is random in it comes from the generator.
    """

    title: str
    samples: Callable[[int, float, tuple[float, float], np.random.Generator], NDArray[np.float64]]


EXCITATIONS: dict[str, Excitation] = {
    "noise": Excitation("band-limited Gaussian noise", noise.samples),
    "sweep": Excitation("a linear sweep", sweep.samples),
    "multisine": Excitation("an odd random-phase multisine", multisine.samples),
}
