"""A channel smoothed, and its derivative: local polynomials on a uniform grid, a spline elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.records.validate import even_step

__all__ = ["smooth_derivative"]

Floats = NDArray[np.float64]

# Polynomial degrees and the window lengths that are tried for each, shortest to longest.
DEGREES = (4, 6)
WINDOWS = 40
LONGEST_WINDOW = 1001


def smooth_derivative(time: Floats, values: Floats, order: int) -> tuple[Floats, Floats]:
    """Smoothed channel and its `order`-th derivative.

    On a uniform grid a Savitzky-Golay filter, degree and window chosen by generalised cross-validation; on any
    other a cubic smoothing spline, its weight chosen so too.

    Parameters
    ----------
    time : (n,) array
        Increasing [s].
    values : (n,) array
        Samples.
    order : int
        1 or more.

    Returns
    -------
    smoothed, derivative : (n,) arrays
        In the units of `values`, and of `values` per s^order.
    """
    offset, scale = values.mean(), values.std() or 1.0
    step = (time[-1] - time[0]) / (len(time) - 1)
    standard = (values - offset) / scale
    if even_step(time) is not None and len(values) > 2 * (DEGREES[0] + 3):
        smoothed, derivative = _savitzky_golay(standard, order)
    else:
        smoothed, derivative = _spline((time - time[0]) / step, standard, order)
    return offset + scale * smoothed, scale / step**order * derivative


def _savitzky_golay(values: Floats, order: int) -> tuple[Floats, Floats]:
    from scipy.signal import savgol_coeffs, savgol_filter

    best, degree, window = np.inf, 0, 0
    longest = min(LONGEST_WINDOW, len(values) // 2)
    for d in DEGREES:
        lengths = np.geomspace(d + 3, max(longest, d + 3), WINDOWS).astype(int) // 2 * 2 + 1
        for length in np.unique(lengths[lengths <= len(values)]):
            residual = values - savgol_filter(values, int(length), d)
            own_weight = savgol_coeffs(int(length), d)[length // 2]
            score = float(residual @ residual) / (1.0 - own_weight) ** 2
            if score < best:
                best, degree, window = score, d, int(length)
    smoothed: Floats = savgol_filter(values, window, degree)
    derivative: Floats = savgol_filter(values, window, degree, deriv=order)
    return smoothed, derivative


def _spline(time: Floats, values: Floats, order: int) -> tuple[Floats, Floats]:
    from scipy.interpolate import make_smoothing_spline

    spline = make_smoothing_spline(time, values)
    return spline(time), spline(time, order)
