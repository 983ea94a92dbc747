"""Spectra of even records by Welch's method. Numbers only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError

__all__ = ["cross_spectrum", "even_rate", "filled"]

Floats = NDArray[np.float64]

# Segments of a spectrum: about this many, which overlap by half.
SEGMENTS = 8
LEAST_ROWS = 32


def even_rate(time: Floats, where: str) -> float:
    """Sampling rate [Hz] of times that are even to a thousandth.

    Raises
    ------
    InputError
        Too few rows, or times that are not even.
    """
    if len(time) < LEAST_ROWS:
        raise InputError(f"{where}: a spectrum needs {LEAST_ROWS} rows or more, there are {len(time)}")
    steps = np.diff(time)
    step = float(np.median(steps))
    if float(np.abs(steps - step).max()) > 1e-3 * step:
        raise InputError(f"{where}: a spectrum needs even sampling; resample the record first")
    return 1.0 / step


def filled(values: Floats) -> Floats:
    """Missing samples bridged by straight lines."""
    there = np.isfinite(values)
    if there.all():
        return values
    at = np.arange(len(values))
    return np.interp(at, at[there], values[there])


def cross_spectrum(x: Floats, y: Floats, fs: float) -> tuple[Floats, NDArray[np.complex128]]:
    """Frequencies [Hz] above zero and the cross spectral density of two channels, by Welch's method (1967).

    Hann windows over segments that overlap by half, each less its mean; densities are one-sided.
    """
    from scipy.signal import csd

    length = max(LEAST_ROWS, 2 ** int(np.log2(max(2.0 * len(x) / (SEGMENTS + 1), LEAST_ROWS))))
    f, density = csd(x, y, fs=fs, nperseg=min(length, len(x)))
    return np.asarray(f[1:]), np.asarray(density[1:], dtype=np.complex128)
