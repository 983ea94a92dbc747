"""Inputs as low-passed noise: their spectrum is flat up to a corner and falls beyond, as that of a shaker's force.

An input with p states, itself and p - 1 derivatives, is a Butterworth process of order p: white noise through a filter
whose p poles lie evenly on a half circle with the corner as its radius (Butterworth 1930). Between samples the highest
derivative is constant; at each it becomes a combination of the states there, such that the poles are those of the
filter (Ackermann 1972), plus a random step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.numerics.minimise import minimise

#: Rows of a segment of which a periodogram is taken.
SEGMENT = 2000

# Bounds of a spectrum: corner as a share of half the sampling rate, level and noise as shares of the variance.
CORNERS = (1e-3, 0.9)
LEVELS, NOISES = (1e-8, 1e8), (1e-8, 1.0)

# First corner: the one with this share of the power below it; first noise: the mean of this share of the highest bins.
POWER, HIGHEST = 0.9, 0.1


def feedback(order: int, corner: float, intervals: Floats) -> Floats:
    """Feedback gains (n, `order`): their product with the states at the end of a step is the mean of the highest
    derivative after it. The corner is in rad/s, intervals, (n,), are in seconds."""
    return _feedback(order, corner, intervals.tobytes())


@lru_cache(maxsize=4)
def _feedback(order: int, corner: float, buffer: bytes) -> Floats:
    different, which = np.unique(np.frombuffer(buffer), return_inverse=True)
    rows = np.linalg.solve(_free(order).T, _rows(order, corner * different).T).T
    return np.asarray(rows * different[:, None] ** np.arange(1.0 - order, 1.0))[which]


def _free(order: int) -> Floats:
    """Transition matrix (p, p) of the states over a step of length 1, without the feedback at its end."""
    return np.array([[1.0 / math.factorial(j - i) if j >= i else 0.0 for j in range(order)] for i in range(order)])


def _rows(order: int, corners: Floats) -> Floats:
    """Last row of the transition matrix from one sample to the next, (n, p), for each corner, in steps of length 1."""
    angles = np.exp(1j * math.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order))
    coefficients = np.zeros((len(corners), order + 1), dtype=np.complex128)
    coefficients[:, 0] = 1.0
    for pole in np.exp(corners * angles[:, None]):  # coefficients of the polynomial with these roots
        coefficients[:, 1:] -= pole[:, None] * coefficients[:, :-1]
    held = _free(order)
    held[-1] = 0.0
    powers = np.array([np.linalg.matrix_power(held, k) for k in range(order + 1)])
    reached, last = powers[:order, :, -1], np.eye(order)[-1]
    return -np.real(coefficients) @ (np.linalg.solve(reached, last) @ powers[::-1])


def step_variance(order: int, corner: float, interval: float, level: float) -> float:
    """Variance of the random steps of the highest derivative, given the level of the spectrum at zero frequency, scaled
    so that the mean of the spectrum over all frequencies is the variance."""
    transition = _free(order)
    transition[-1] = _rows(order, np.array([corner * interval]))[0]
    gain = float(np.linalg.solve(np.eye(order) - transition, np.eye(order)[-1])[0])
    return level / gain**2 / interval ** (2 * (order - 1))


class Spectrum(NamedTuple):
    """Averaged periodograms of segments with Hann's window (Welch 1967)."""

    omega: Floats  # (B,), frequencies [rad/sample]
    power: Floats  # (B,), mean over the segments; the mean over all frequencies is the variance
    segments: Floats  # (B,), number of segments


def mean_spectrum(pieces: Sequence[Floats]) -> Spectrum:
    """The spectrum of samples of mean zero: averaged over segments of each piece; a shorter piece is one segment."""
    sums: dict[int, tuple[Floats, int]] = {}
    for values in pieces:
        length = min(SEGMENT, len(values))
        power, count = periodograms(values, length)
        before = sums.get(length, (0.0, 0))
        sums[length] = before[0] + power, before[1] + count
    parts = [of_segments(power, count, length) for length, (power, count) in sums.items()]
    return Spectrum(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def of_segments(power: Floats, count: int, length: int) -> Spectrum:
    """The spectrum from the sum of the periodograms of `count` segments."""
    bins = len(power)
    omega = 2.0 * math.pi * np.arange(1, bins + 1) / length
    return Spectrum(omega, power / max(count, 1), np.full(bins, float(count)))


def periodograms(values: Floats, length: int) -> tuple[Floats, int]:
    """Sum of the periodograms of segments that overlap by half, and their number."""
    bins = (length + 1) // 2 - 1
    total, count, window = np.zeros(max(bins, 0)), 0, np.hanning(length)
    if bins > 0:
        for first in range(0, len(values) - length + 1, (length + 1) // 2):
            segment = values[first : first + length] * window
            total += np.abs(np.fft.rfft(segment))[1 : bins + 1] ** 2
            count += 1
    return total / (0.375 * length), count


def spectrum_of(found: Spectrum, order: int, interval: float, variance: float) -> tuple[float, float, float]:
    """Corner [rad/s], level at zero frequency, and noise of a process of this order and variance, with samples
    `interval` [s] apart, at the maximum of Whittle's likelihood (Whittle 1953)."""
    w, P, count = found
    if not float(count @ P) > 0.0:
        return math.pi / interval, variance, NOISES[0] * variance
    share = count / count.sum()
    P = P / float(share @ P)
    by_frequency = np.argsort(w, kind="stable")
    below = np.cumsum((share * P)[by_frequency]) <= POWER
    first = w[by_frequency][min(int(below.sum()), len(w) - 1)]
    noise = P[by_frequency][-max(1, int(HIGHEST * len(P))) :].mean()
    start = np.log([first, math.pi / first, noise])
    low = np.log([CORNERS[0] * math.pi, LEVELS[0], NOISES[0]])
    high = np.log([CORNERS[1] * math.pi, LEVELS[1], NOISES[1]])

    unit = 1.0 / math.sqrt(float(count.sum()))

    def negative(moved: Floats) -> tuple[float, Floats]:
        x = moved * unit
        beyond = np.exp(2.0 * order * (np.log(w) - x[0]))
        signal = np.exp(x[1]) / (1.0 + beyond)
        total = signal + np.exp(x[2])
        by_total = count * (1.0 / total - P / total**2)
        by_corner = 2.0 * order * signal * beyond / (1.0 + beyond)
        slopes = [float(by_total @ by_corner), float(by_total @ signal), float(by_total.sum() * np.exp(x[2]))]
        return float(count @ (np.log(total) + P / total)), np.array(slopes) * unit

    least = minimise(negative, np.clip(start, low, high) / unit, low / unit, high / unit)
    corner, level, noise = np.exp(least.x * unit).tolist()
    return corner / interval, level * variance, noise * variance
