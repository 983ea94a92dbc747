"""What is kept of the records for plans: rates, ranges, and the bands of the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bayeq.records import Record

__all__ = ["Measured"]

# The band of an input holds its power but for these shares below and above. Noise of the channel is spread up to half
# of the sampling rate, so that more is left out there: 5 % is the power of 20 % noise.
BELOW, ABOVE = 0.005, 0.05


@dataclass(frozen=True, slots=True)
class Measured:
    """Records as a plan needs them.

    Attributes
    ----------
    fs : float or None
        Sampling rate [Hz]; None without time.
    seconds : float or None
        Length of the longest record.
    ranges : mapping of str to (float, float)
        Least and largest sample of every channel.
    bands : mapping of str to (float, float)
        Where the power of every input is [Hz].
    """

    fs: float | None = None
    seconds: float | None = None
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    bands: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Sequence[Record], channels: Sequence[str], inputs: Sequence[str]) -> Self:
        """Of records that have these channels."""
        longest = max(records, key=lambda record: record.n)
        fs = longest.fs
        ranges = {}
        for name in (*channels, *inputs):
            samples = np.concatenate([record[name] for record in records])
            if np.isfinite(samples).any():
                ranges[name] = float(np.nanmin(samples)), float(np.nanmax(samples))
        bands = {} if fs is None else {name: found for name in inputs if (found := band_of(longest[name], fs))}
        return cls(fs, None if fs is None else longest.n / fs, ranges, bands)


def band_of(samples: NDArray[np.float64], fs: float) -> tuple[float, float] | None:
    """Frequencies [Hz] between which the power of a signal is; None of a constant.

    Examples
    --------
    >>> time = np.arange(1000) / 100
    >>> low, high = band_of(np.sin(2 * np.pi * 3 * time) + np.sin(2 * np.pi * 7 * time), fs=100)
    >>> round(low, 6), round(high, 6)
    (3.0, 7.0)
    """
    known = np.isfinite(samples)
    if not known.any():
        return None
    centred = np.where(known, samples - samples[known].mean(), 0.0)
    power = np.abs(np.fft.rfft(centred)) ** 2
    power[0] = 0.0
    if power.sum() <= 0.0:
        return None
    share = np.cumsum(power) / power.sum()
    # the first line from which on more than BELOW has passed, and the one that completes all but ABOVE
    low, high = np.searchsorted(share, (BELOW, 1.0 - ABOVE))
    return float(low * fs / len(samples)), float(high * fs / len(samples))
