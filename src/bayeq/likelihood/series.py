"""`Series`: the samples of one record, as the likelihood takes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Series"]

Floats = NDArray[np.float64]


class Series(NamedTuple):
    """The samples of one record.

    Attributes
    ----------
    intervals : (n - 1,) array
        Between samples [s].
    samples : (n, M) array
        Of `Layout.channels`; NaN where there is none.
    inputs : (n, m, 4) array
        What `Layout.given` names, from `bayeq.ode.rk4.interpolant`.
    spread : (n, M) array
        Variance of the noise of each sample as a multiple of its channel's.
    bends : (n, L, 2) array
        What the course of each input has beside a straight line: a fraction f after a sample, f (1 - f) times the first
        and f times the second.
    """

    intervals: Floats
    samples: Floats
    inputs: Floats
    spread: Floats
    bends: Floats
