"""What the residuals say about an equation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Residuals", "inspect_residuals"]

Floats = NDArray[np.float64]

# Residuals count as correlated if less than this share of the rows is left as effective sample size ...
LEAST_EFFECTIVE_SHARE = 0.67
# ... and the first autocorrelation exceeds this many of its standard errors.
SIGNIFICANT = 3.0


@dataclass(frozen=True, slots=True)
class Residuals:
    """Whiteness of residuals.

    Attributes
    ----------
    n : int
        Rows.
    lag1 : float
        Autocorrelation at lag 1.
    n_eff : float
        Effective sample size n / (1 + 2 sum rho_k), the sum over the lags up to the first rho_k <= 0.
    """

    n: int
    lag1: float
    n_eff: float

    @property
    def correlated(self) -> bool:
        """Whether standard deviations that assume white residuals are too small to be trusted."""
        return bool(self.n_eff < LEAST_EFFECTIVE_SHARE * self.n and self.lag1 > SIGNIFICANT / math.sqrt(self.n))


def inspect_residuals(pieces: Sequence[Floats]) -> Residuals:
    """Autocorrelation of residuals that come in one or more uninterrupted pieces.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> inspect_residuals([rng.normal(size=1000)]).correlated
    False
    >>> inspect_residuals([np.cumsum(rng.normal(size=1000))]).correlated
    True
    """
    n = sum(len(piece) for piece in pieces)
    mean = sum(float(piece.sum()) for piece in pieces) / n
    longest = max(len(piece) for piece in pieces)
    size = 1 << (2 * longest - 1).bit_length()
    covariance = np.zeros(longest)
    for piece in pieces:
        spectrum = np.fft.rfft(piece - mean, size)
        covariance[: len(piece)] += np.fft.irfft(spectrum * spectrum.conj(), size)[: len(piece)]
    if not covariance[0] > 0:
        return Residuals(n, 0.0, float(n))
    rho = covariance / covariance[0]
    negative = np.flatnonzero(rho <= 0)
    last = int(negative[0]) if len(negative) else longest
    return Residuals(n, float(rho[1]) if longest > 1 else 0.0, float(n / (1.0 + 2.0 * rho[1:last].sum())))
