"""The conditions of a next measurement: amplitudes, band, length, rate, noise and limits, given or as measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError
from bayeq.plan.settings import PLAN
from bayeq.records import Record

Amplitude = float | tuple[float, float]

# A plan is made for this many samples by default: longer ones take longer to simulate and rank the same.
SAMPLES = 4000

# Fewer samples than this are no spectrum.
LEAST_SAMPLES = 16


@dataclass(frozen=True, slots=True)
class Measured:
    """Records as a plan needs them: rate [Hz], None without time, and length [s] of the longest one.

    Also the least and largest sample of every channel, and the band where the power of every input is [Hz].
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
    # the first line from which on more than a share has passed, and the one that completes all but one
    low, high = np.searchsorted(share, (PLAN.power_below, 1.0 - PLAN.power_above))
    return float(low * fs / len(samples)), float(high * fs / len(samples))


@dataclass(frozen=True)
class Conditions:
    """What may be done, and what is known.

    Middle and half width of the range of each of the m inputs, band and rate [Hz], samples, standard deviation of the
    noise of every target, largest magnitude of states, and ranges of the channels of the record.
    """

    offset: Floats
    reach: Floats
    band: tuple[float, float]
    n: int
    fs: float
    noise: tuple[float, ...]
    limits: Mapping[str, float]
    ranges: Mapping[str, tuple[float, float]]

    @property
    def seconds(self) -> float:
        """Length of the measurement."""
        return self.n / self.fs


def conditions_of(
    measured: Measured,
    states: Sequence[str],
    inputs: Sequence[str],
    noise: Mapping[str, float],
    *,
    amplitude: Amplitude | Mapping[str, Amplitude] | None,
    band: tuple[float, float] | None,
    seconds: float | None,
    fs: float | None,
    given_noise: Mapping[str, float],
    limits: Mapping[str, float],
) -> Conditions:
    """What was asked for, as for `bayeq.Equations.plan`, and the rest from the record; `noise` is that of every target.

    InputError for names that are not there, numbers out of range, or something that neither was given nor is known.
    """
    rate = _positive("fs", fs if fs is not None else _known(measured.fs, "the sampling rate", "fs"))
    length = seconds
    if length is None:
        length = min(_known(measured.seconds, "the length of the record", "seconds"), SAMPLES / rate)
    n = round(_positive("seconds", length) * rate)
    if n < LEAST_SAMPLES:
        raise InputError(f"{length:g} s at {rate:g} Hz are {n} samples: at least {LEAST_SAMPLES} are needed")
    spans = [_span(name, amplitude, measured, inputs) for name in inputs]
    for name in given_noise:
        if name not in noise:
            raise UnknownNameError("target", name, noise, "noise")
    for name in limits:
        if name not in states:
            raise UnknownNameError("state", name, states, "limit")
    sds = {name: _positive(f"noise of {name}", given_noise.get(name, sd)) for name, sd in noise.items()}
    return Conditions(
        offset=np.array([0.5 * (low + high) for low, high in spans]),
        reach=np.array([0.5 * (high - low) for low, high in spans]),
        band=_band(band, measured, inputs, rate),
        n=n,
        fs=rate,
        noise=tuple(sds.values()),
        limits={name: _positive(f"limit of {name}", limit) for name, limit in limits.items()},
        ranges=measured.ranges,
    )


def _positive(what: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{what} must be a positive number, not {value!r}")
    return float(value)


def _known(value: float | None, what: str, argument: str) -> float:
    if value is None:
        raise InputError(f"{what} is not known from the record: give {argument}")
    return value


def _span(
    name: str, amplitude: Amplitude | Mapping[str, Amplitude] | None, measured: Measured, inputs: Sequence[str]
) -> tuple[float, float]:
    """The range of an input: that given, else that of the record."""
    if isinstance(amplitude, Mapping):
        for key in amplitude:
            if key not in inputs:
                raise UnknownNameError("input", key, inputs, "amplitude")
        amplitude = amplitude.get(name)
    if amplitude is None:
        if name not in measured.ranges:
            raise InputError(f"the range of {name} is not known from the record: give amplitude")
        low, high = measured.ranges[name]
        least, most = sorted((-low, high))
        if least > PLAN.signed * most:  # of both signs: as far as both go
            low, high = -least, least
    elif isinstance(amplitude, (int, float)):
        high = _positive(f"amplitude of {name}", amplitude)
        low = -high
    else:
        low, high = amplitude
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(
            f"amplitude of {name}: {low:g} to {high:g} is no range; give a positive number, or low and high"
        )
    return low, high


def _band(
    band: tuple[float, float] | None, measured: Measured, inputs: Sequence[str], fs: float
) -> tuple[float, float]:
    if band is None:
        found = [measured.bands[name] for name in inputs if name in measured.bands]
        if not found:
            raise InputError("the band of the input is not known from the record: give band")
        return min(low for low, _ in found), min(max(high for _, high in found), 0.5 * fs)
    low, high = band
    if not (math.isfinite(low) and math.isfinite(high) and 0 <= low < high):
        raise InputError(f"band {low:g} to {high:g} Hz: give two frequencies, the lower one first")
    if high > 0.5 * fs:
        raise InputError(f"band {low:g} to {high:g} Hz: beyond half the sampling rate ({0.5 * fs:g} Hz)")
    return float(low), float(high)
