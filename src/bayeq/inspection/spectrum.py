"""Power of a channel by octave, where most of it is, and the bandwidth of nearly all of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Spectrum", "bars", "spectrum"]

Floats = NDArray[np.float64]

# Share of the power that the bandwidth holds.
SHARE = 0.99

# A record of up to SHORT rows is one segment, longer ones are segments of a quarter, up to LONGEST rows, half over each
# other. Of more than MOST_SEGMENTS some are taken, evenly over the record: the rest would hardly change the picture.
SHORT, LONGEST, MOST_SEGMENTS = 8192, 65536, 16

# Octaves that are shown, from half the sampling rate down; the lowest one takes what is below.
MOST_OCTAVES = 12
LEAST_ROWS = 16

# Height of the bars: a full one is the strongest octave, an empty one is this much below [dB].
RANGE_DB = 42.0
BLOCKS, DIGITS = "▁▂▃▄▅▆▇█", "12345678"


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Power spectrum of a channel without its mean.

    Attributes
    ----------
    octaves : tuple of float
        Upper edges of the bands [Hz], rising; each is twice the one before, the last half the sampling rate.
    shares : tuple of float
        Share of the power in each band.
    peak : float
        Frequency that holds most power [Hz].
    bandwidth : float
        99 % of the power is below [Hz].
    """

    octaves: tuple[float, ...]
    shares: tuple[float, ...]
    peak: float
    bandwidth: float


def spectrum(pieces: Sequence[Floats], step: float) -> Spectrum | None:
    """Spectrum of stretches at even steps of time; None of short or constant ones.

    Parameters
    ----------
    pieces : sequence of (n,) arrays
        Stretches of one channel without NaN.
    step : float
        Between samples [s].
    """
    longest = max((len(piece) for piece in pieces), default=0)
    length = longest if longest <= SHORT else min(LONGEST, longest // 4)
    if length < LEAST_ROWS:
        return None
    places = [(k, a) for k, piece in enumerate(pieces) for a in range(0, len(piece) - length + 1, max(1, length // 2))]
    if len(places) > MOST_SEGMENTS:
        places = [places[i] for i in np.linspace(0, len(places) - 1, MOST_SEGMENTS).astype(int)]
    size = max(float(np.abs(piece).max()) for piece in pieces)
    if not (size > 0.0 and math.isfinite(size)):
        return None
    power, window = np.zeros(length // 2 + 1), np.hanning(length)
    for k, a in places:
        samples = pieces[k][a : a + length] / size
        power += np.abs(np.fft.rfft(window * (samples - samples.mean()))) ** 2
    power[0] = 0.0
    total = float(power.sum())
    if not total > 1e-20 * length:  # rounding of a constant
        return None
    frequency = np.arange(len(power)) / (length * step)
    within = np.cumsum(power) / total
    count = min(MOST_OCTAVES, int(math.log2(length)) - 1)
    edges = [0.5 / step * 2.0 ** (k + 1 - count) for k in range(count)]
    below = [float(within[np.searchsorted(frequency, edge * (1.0 + 1e-9), side="right") - 1]) for edge in edges]
    shares = np.diff([0.0, *below[:-1], 1.0])
    return Spectrum(
        octaves=tuple(edges),
        shares=tuple(np.maximum(shares, 0.0).tolist()),
        peak=float(frequency[int(np.argmax(power))]),
        bandwidth=float(frequency[min(int(np.searchsorted(within, SHARE)), len(frequency) - 1)]),
    )


def bars(found: Spectrum, plain: bool = False) -> str:
    """The octaves as bars, the lowest first; digits 1 to 8 where blocks cannot be written.

    Examples
    --------
    >>> wave = np.sin(2 * np.pi * 5 * np.arange(1000) / 100)
    >>> bars(spectrum([wave], 0.01)), bars(spectrum([wave], 0.01), plain=True)
    ('▁▁▁▁█▁▁▁', '11118111')
    """
    marks = DIGITS if plain else BLOCKS
    top = max(found.shares)
    levels = [10.0 * math.log10(max(share / top, 1e-30)) for share in found.shares]
    return "".join(marks[max(0, round((1.0 + level / RANGE_DB) * (len(marks) - 1)))] for level in levels)
