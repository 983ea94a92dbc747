"""Kinds of excitation that plans compare. A new kind is a function and a row of `EXCITATIONS`.

The conformance tests do the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError

Band = tuple[float, float]

# A line at the end of a band belongs to it, in spite of rounding.
ROUNDING = 1e-9

# The spectrum of a sweep of B Hz in T s falls off over some sqrt(B/T) beyond its ends. The sweep stays this multiple of
# that off the ends of the band: of 6000 bands at least 96 % of the power was inside for B T above 20, 93 % above 10.
INSET = 0.5


@dataclass(frozen=True, slots=True)
class Excitation:
    """A row of the table."""

    title: str  # what it is, with its article
    # ``samples(n, fs, band, rng)``: n samples at fs [Hz] with their power within ``(lo, hi)`` [Hz], the largest
    # magnitude 1. What is random in it comes from the generator.
    samples: Callable[[int, float, Band, np.random.Generator], Floats]


def lines_within(n: int, fs: float, band: Band, odd: bool = False) -> NDArray[np.intp]:
    """Multiples of fs/n within a band, above 0 and below fs/2, or the odd ones alone; InputError if there are none."""
    line = np.arange(1, (n + 1) // 2)
    frequency = line * fs / n
    inside = (frequency >= band[0] * (1.0 - ROUNDING)) & (frequency <= band[1] * (1.0 + ROUNDING))
    if odd:
        inside &= line % 2 == 1
    if not inside.any():
        raise InputError(
            f"no spectral line of {n / fs:g} s lies between {band[0]:g} and {band[1]:g} Hz: widen the band, or excite"
            " for longer"
        )
    return np.asarray(line[inside], dtype=np.intp)


def _synthesised(n: int, lines: NDArray[np.intp], amplitudes: NDArray[np.complex128]) -> Floats:
    """One period of a sum of lines with these complex amplitudes, the largest magnitude 1."""
    spectrum = np.zeros(n // 2 + 1, dtype=np.complex128)
    spectrum[lines] = amplitudes
    return _normalised(np.fft.irfft(spectrum, n))


def _normalised(samples: Floats) -> Floats:
    """Samples with the largest magnitude 1."""
    return samples / np.abs(samples).max()


def noise(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One period of noise: all lines of the band, with independent complex normal amplitudes."""
    lines = lines_within(n, fs, band)
    return _synthesised(n, lines, rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines)))


def multisine(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One period of the odd lines of the band, of equal amplitude and random phase.

    Pintelon and Schoukens 2012, section 5.2.
    """
    lines = lines_within(n, fs, band, odd=True)
    return _synthesised(n, lines, np.exp(2j * np.pi * rng.random(len(lines))))


def sweep(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One linear sweep (chirp) from end to end of the band; its direction and its first phase are drawn."""
    seconds = n / fs
    lines_within(n, fs, band)
    low, high = band[0], min(band[1], 0.5 * fs)
    inset = min(INSET * math.sqrt((high - low) / seconds), 0.25 * (high - low))
    # below frequency 0 there is nothing to fall off to
    start, end = low + inset if low > 0.0 else low, high - inset
    if rng.random() < 0.5:
        start, end = end, start
    time = np.arange(n) / fs
    phase = start * time + 0.5 * (end - start) / seconds * time**2
    return _normalised(np.sin(2.0 * np.pi * (phase + rng.random())))


EXCITATIONS: dict[str, Excitation] = {
    "noise": Excitation("band-limited Gaussian noise", noise),
    "sweep": Excitation("a linear sweep", sweep),
    "multisine": Excitation("an odd random-phase multisine", multisine),
}
