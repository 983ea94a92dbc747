"""Designs that a plan compares, each a kind of excitation and a band, and the conditions of their simulation."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import mean_run, state_range
from bayeq.numerics.rk4 import Drive, interpolant, slope_at
from bayeq.numerics.settings import PLAN
from bayeq.records import Record

Band = tuple[float, float]

# A spectral line within this relative distance of the end of a band belongs to the band.
ROUNDING = 1e-9

# The spectrum of a sweep of B Hz in T s falls off over about sqrt(B/T) beyond its ends. The sweep stays this multiple
# of sqrt(B/T) inside the band: in 6000 bands at least 96 % of the power was inside for B T above 20, 93 % above 10.
INSET = 0.5


@dataclass(frozen=True, eq=False, slots=True)
class Excitation:
    """A kind of excitation, a row of `EXCITATIONS`."""

    title: str  # its name in a sentence, with the article
    # ``samples(n, fs, band, rng)``: n samples at fs [Hz] with their power within ``(lo, hi)`` [Hz], the largest
    # magnitude 1; `rng` makes the random choices.
    samples: Callable[[int, float, Band, np.random.Generator], Floats]


def lines_within(n: int, fs: float, band: Band, odd: bool = False) -> NDArray[np.intp]:
    """Numbers k of the lines k fs/n in a band, above 0 and below fs/2, or only odd k; InputError if there are none."""
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
    samples = np.fft.irfft(spectrum, n)
    return samples / np.abs(samples).max()


def noise(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One period of noise: all lines of the band, with independent complex normal amplitudes."""
    lines = lines_within(n, fs, band)
    return _synthesised(n, lines, rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines)))


def multisine(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One period of the band's odd lines, equal amplitudes and random phases (Pintelon and Schoukens 2012, 5.2)."""
    lines = lines_within(n, fs, band, odd=True)
    return _synthesised(n, lines, np.exp(2j * np.pi * rng.random(len(lines))))


def sweep(n: int, fs: float, band: Band, rng: np.random.Generator) -> Floats:
    """One linear sweep (chirp) from end to end of the band; its direction and its initial phase are random."""
    seconds = n / fs
    lines_within(n, fs, band)
    low, high = band[0], min(band[1], 0.5 * fs)
    inset = min(INSET * math.sqrt((high - low) / seconds), 0.25 * (high - low))
    # no inset at frequency 0: there is no spectrum below
    start, end = low + inset if low > 0.0 else low, high - inset
    if rng.random() < 0.5:
        start, end = end, start
    time = np.arange(n) / fs
    phase = start * time + 0.5 * (end - start) / seconds * time**2
    samples = np.sin(2.0 * np.pi * (phase + rng.random()))
    return samples / np.abs(samples).max()


EXCITATIONS: dict[str, Excitation] = {
    "noise": Excitation("band-limited Gaussian noise", noise),
    "sweep": Excitation("a linear sweep", sweep),
    "multisine": Excitation("an odd random-phase multisine", multisine),
}

Amplitude = float | tuple[float, float]

# A plan is made for this many samples by default: longer ones take longer to simulate and rank the same.
SAMPLES = 4000

# Least number of samples, for a spectrum with some lines.
LEAST_SAMPLES = 16


@dataclass(frozen=True, slots=True)
class Measured:
    """Summary of records for a plan: sampling, ranges of channels, bands of inputs."""

    fs: float | None = None  # rate [Hz] of the longest one; None without time
    seconds: float | None = None  # length of the longest one [s]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # least and largest sample
    bands: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # band of each input's power [Hz]

    @classmethod
    def of(cls, records: Sequence[Record], channels: Sequence[str], inputs: Sequence[str]) -> Self:
        """The summary of records that have these channels and inputs."""
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
    """Band [Hz] that holds the power of a signal, except small shares at both ends; None for a constant.

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
    # lines at which the cumulative power reaches the share cut off below, and all but the share cut off above
    low, high = np.searchsorted(share, (PLAN.power_below, 1.0 - PLAN.power_above))
    return float(low * fs / len(samples)), float(high * fs / len(samples))


@dataclass(frozen=True, eq=False)
class Conditions:
    """Ranges, band, sampling, noise and limits of the measurement that is planned."""

    offset: Floats  # (m,), middle of the range of each input
    reach: Floats  # (m,), half its width
    band: tuple[float, float]  # [Hz]
    n: int  # samples
    fs: float  # sampling rate [Hz]
    noise: tuple[float, ...]  # standard deviation of the noise of every target
    limits: Mapping[str, float]  # largest magnitude of states
    ranges: Mapping[str, tuple[float, float]]  # of the channels of the record, least and largest

    @property
    def seconds(self) -> float:
        """Length of the measurement [s]."""
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
    """The conditions given to `bayeq.Equations.plan`; defaults are from the record, of noise from the equations."""
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
    """The range of an input: as given, else that of the record."""
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
        if least > PLAN.signed * most:  # the input has both signs: make its range symmetric
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


# Amplitudes, as shares of the range allowed: half of it shows how much the full range gains.
SHARES = (1.0, 0.5)

# Besides the whole band, this many parts of it are tried, equally wide in octaves.
PARTS = 3

# The largest amplitude within limits is found to 0.1 % of the range.
STEPS = 1024


@dataclass(frozen=True, slots=True)
class Design:
    """A kind of excitation, a key of `EXCITATIONS`, and its band [Hz]."""

    kind: str
    band: tuple[float, float]


def designs_for(conditions: Conditions, parameters: int) -> list[Design]:
    """All designs within the conditions, for models of at most `parameters` coefficients.

    A part of the band is left out if its odd lines are too few to identify the parameters: k sines are persistently
    exciting of order 2 k (Ljung 1999, section 13.2).
    """
    lines_within(conditions.n, conditions.fs, conditions.band, odd=True)  # raises if the band has no lines
    low, high = max(conditions.band[0], 1.0 / conditions.seconds), conditions.band[1]
    parts = pairwise(np.geomspace(low, high, PARTS + 1).tolist()) if low < high else ()
    bands = [conditions.band, *(part for part in parts if _lines(conditions, part) * 2 >= parameters)]
    return [Design(kind, band) for kind in EXCITATIONS for band in bands]


def _lines(conditions: Conditions, band: tuple[float, float]) -> int:
    try:
        return len(lines_within(conditions.n, conditions.fs, band, odd=True))
    except InputError:
        return 0


def shapes(design: Design, conditions: Conditions, seed: tuple[int, ...]) -> Floats:
    """One realisation, (n, m): independent signals for the m inputs, each of largest magnitude 1."""
    rng, samples = np.random.default_rng(seed), EXCITATIONS[design.kind].samples
    return np.column_stack([samples(conditions.n, conditions.fs, design.band, rng) for _ in conditions.reach])


class Motions:
    """Free runs of a system from rest: from the equilibrium under the offsets of the inputs, if one is within the range
    of the record; else from the middle of the range of each coordinate (0 where it is not known), without velocity."""

    def __init__(self, dynamics: Dynamics, conditions: Conditions) -> None:
        self.dynamics = dynamics
        self.conditions = conditions
        ends = np.array([conditions.ranges.get(name, (0.0, 0.0)) for name in dynamics.states])
        self.low, self.high = state_range(ends.T)
        self.first = self._rest(ends)

    def _rest(self, ends: Floats) -> Floats:
        from scipy.optimize import root

        lowest = [k == 0 for chain in self.dynamics.roles.chains for k in range(len(chain.states))]
        middle = np.where(lowest, ends.mean(axis=1), 0.0)
        program = self.dynamics.program(self.dynamics.mean)
        still = interpolant(np.array([0.0, 1.0]), np.tile(self.conditions.offset, (2, 1)), "hold")

        def slope(state: Floats) -> Floats:
            out = np.empty(len(state))
            slope_at(program, still, np.ascontiguousarray(state), 0, 0.0, None, out)
            return out

        with np.errstate(all="ignore"):
            found = root(slope, middle)
        unknown = [name not in self.conditions.ranges for name in self.dynamics.states]
        inside = unknown | ((ends[:, 0] <= found.x) & (found.x <= ends[:, 1]))
        return np.asarray(found.x) if found.success and (inside & np.isfinite(found.x)).all() else middle

    def run(self, shape: Floats, share: float) -> Mapping[str, Floats] | None:
        """States and inputs, (n,) each, under the inputs ``offset + share reach shape``; None if the run diverges."""
        c = self.conditions
        inputs = c.offset + share * c.reach * shape
        time = np.arange(c.n) / c.fs
        drive = Drive.over(time, interpolant(time, inputs, "band-limited"), self.low, self.high)
        states, stopped, _ = mean_run(self.dynamics, self.dynamics.mean, self.first, drive)
        if stopped is not None:
            return None
        return dict(zip((*self.dynamics.states, *self.dynamics.roles.inputs), (*states.T, *inputs.T), strict=True))

    def largest_share(self, realisations: Sequence[Floats]) -> float:
        """The largest share of the amplitude with which all realisations keep the limits, 0 if 1/1024 does not."""
        limits = self.conditions.limits.items()

        def kept(share: float) -> bool:
            runs = (self.run(shape, share) for shape in realisations)
            return all(
                run is not None and all(np.abs(run[name]).max() <= most for name, most in limits) for run in runs
            )

        return 1.0 if kept(1.0) else bisect_left(range(1, STEPS), True, key=lambda k: not kept(k / STEPS)) / STEPS
