"""Band-limited Gaussian noise, the force that drives the oscillators."""

from __future__ import annotations

import math

import numpy as np

from bayeq.errors import InputError
from bayeq.expressions import FloatArray
from bayeq.systems.system import BandLimitedForce

__all__ = ["band_limited_noise"]

# With fewer spectral lines than this inside its band, a force would be a sine, or nothing.
_LINES = 20


def band_limited_noise(force: BandLimitedForce, n: int, fs: float, rng: np.random.Generator) -> FloatArray:
    """(n,) samples of Gaussian noise with a flat spectrum inside a band, made in the frequency domain; fs in Hz.

    Zero mean and the given standard deviation in expectation. Periodic, unless n is so short that fewer than 20
    spectral lines lie in the band: then a piece of a longer sequence.

    Raises
    ------
    InputError
        If no frequency below ``fs/2`` lies in the band.
    """
    lo, hi = force.band
    if not 0.0 <= lo < min(hi, fs / 2):
        raise InputError(f"the force's band {lo:g} to {hi:g} Hz is not below half the sampling rate ({fs:g} Hz)")
    line = np.arange(n // 2 + 1)
    inside = (line * fs > lo * n) & (line * fs <= hi * n)
    if np.count_nonzero(inside) < _LINES:
        return _few_periods(force.std, lo / fs, min(hi, fs / 2) / fs, n, rng)
    # Lines stand for two frequencies, +f and -f, except the one at fs/2, which is real.
    paired = np.where(2 * line == n, 1.0, 2.0)
    spectrum = rng.standard_normal(len(line)) + 1j * rng.standard_normal(len(line))
    spectrum *= math.sqrt(0.5)
    if n % 2 == 0:
        spectrum[-1] = math.sqrt(2.0) * spectrum[-1].real
    spectrum *= np.where(inside, force.std * n / math.sqrt(np.sum(paired, where=inside)), 0.0)
    return np.fft.irfft(spectrum, n)


def _few_periods(std: float, lo: float, hi: float, n: int, rng: np.random.Generator) -> FloatArray:
    """A piece of band-limited noise so short that its own spectral lines are few; band in cycles per sample.

    The lines of a longer record, summed where needed.
    """
    frequency = lo + (hi - lo) * np.arange(1, _LINES + 1) / _LINES
    phase = 2 * np.pi * np.outer(np.arange(n), frequency)
    amplitudes = std / math.sqrt(_LINES) * rng.standard_normal((2, _LINES))
    return np.cos(phase) @ amplitudes[0] + np.sin(phase) @ amplitudes[1]
