"""States by the kinematic smoother: every measured channel of a chain fused, all derivatives from one motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError, RecordError
from bayeq.numerics.settings import STATES
from bayeq.records import Record
from bayeq.records.validate import even_step
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.smoother import ChainSeries, KinematicModel, smooth_kinematic
from bayeq.states.roles import Chain
from bayeq.states.sensors import LEAST_SHARE, Sensors, bridged, unit_gains

# Records are padded by this many times fs / f samples at both ends, f the upper end of the smoother's band.
REACH = 4.0

# Spectral densities are averaged over LOW_SMOOTHING bins on either side, at most a share SHARE_OF_BINS of all bins.
LOW_SMOOTHING = 8
SHARE_OF_BINS = 1 / 16

# Share of the bins that a Hann window leaves independent.
INDEPENDENT = 0.6


@dataclass(frozen=True, eq=False, slots=True)
class ChainSmoothing:
    """How a chain was smoothed."""

    model: KinematicModel  # noise levels and roughness, shared by all records
    fs: float | None  # sampling rate [Hz], if all records are sampled uniformly at one rate
    unit_gains: Floats  # (K+1,), from `bayeq.states.sensors`
    # sd of the samples of zero that bound a coordinate that is not measured; None if it is measured
    coordinate_sd: float | None = None
    # of each derivative given the samples, in its unit, (K+1,): the median over rows; empty if nothing was estimated
    variances: tuple[float, ...] = ()
    freedom: float = 1.0  # degrees of freedom per row: posterior over noise variance of the lowest measured derivative

    def gain(self, frequency: Floats) -> Floats:
        """Gain of the smoother at frequencies [Hz], the same for all derivatives: signal over signal and noise.

        The Wiener gain J/(J + 1/S + 1/b^2) of uniform sampling, where S = Q/(dt omega^(2m)) is the density of the
        coordinate under the model, J = sum of omega^(2k)/R_k the information of the channels on it and b the
        `coordinate_sd`.
        """
        fs = 1.0 if self.fs is None else self.fs
        omega = np.maximum(2.0 * np.pi * np.asarray(frequency), 1e-6 * fs)
        density = self.model.spectral_density * fs / omega ** (2 * self.model.order)
        information = np.zeros_like(omega)
        for k, sd in enumerate(self.model.noise_sd):
            if sd is not None and (k > 0 or self.coordinate_sd is None):
                information += omega ** (2 * k) / sd**2
        bound = 0.0 if self.coordinate_sd is None else 1.0 / self.coordinate_sd**2
        return np.asarray(density * information / (1.0 + density * (information + bound)))

    def follow(self, values: Floats) -> Floats:
        """Columns (n, k) filtered by the smoother's gain, reflected at the ends; unchanged if sampled unevenly."""
        n = len(values)
        if self.fs is None or n < 3 or not values.shape[1]:
            return values
        reach = min(n - 1, int(np.ceil(REACH * self.fs / max(self.band[1], self.fs / n))))
        padded = np.pad(values, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
        size = len(padded)
        gain = self.gain(np.asarray(np.fft.rfftfreq(size, 1.0 / self.fs), dtype=np.float64))
        # the smoother passes the mean, also where the coordinate was integrated
        gain[0] = 1.0
        filtered = np.fft.irfft(gain[:, None] * np.fft.rfft(padded, axis=0), size, axis=0)
        return np.asarray(filtered[reach : reach + n])

    def inner(self, n: int) -> slice:
        """The rows, of n, without those within the smoother's memory of either end, where it is least certain; at most
        a tenth of the rows is left out at each end."""
        memory = 0 if self.fs is None else int(np.ceil(self.fs / max(self.band[1], self.fs / max(n, 1))))
        reach = min(memory, n // 10)
        return slice(reach, n - reach)

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies [Hz] between which the smoother follows the motion: gain above 0.9."""
        assert self.fs is not None
        grid = np.linspace(0.0, 0.5 * self.fs, 4000)[1:]
        gain = self.gain(grid)
        above = np.flatnonzero(gain >= STATES.least_gain)
        if not len(above):
            return 0.0, 0.0
        first = int(above[0]) if self.coordinate_sd is not None else 0
        below = np.flatnonzero(gain[first:] < STATES.least_gain)
        low = float(grid[first]) if first else 0.0
        return low, (float(grid[first + below[0]]) if len(below) else 0.5 * self.fs)


def series_of(record: Record, names: Sequence[str | None]) -> ChainSeries:
    """Samples of channels in a record with time."""
    assert record.time is not None
    return ChainSeries(record.time, tuple(None if name is None else record[name] for name in names))


def _rate(series: Sequence[ChainSeries]) -> float | None:
    """The one sampling rate of uniformly sampled records."""
    step = even_step(*(s.times for s in series))
    return None if step is None else 1.0 / step


def smooth_chain(
    records: Sequence[Record],
    chain: Chain,
    rows: Sequence[int] | None = None,
    sensors: Sensors | None = None,
) -> tuple[list[Floats], ChainSmoothing]:
    """Smoothed derivatives of order 0 to K of a chain in each of some records, (n, K+1), in the units of its channels.

    Noise levels are learned from the first `rows` of each record, by default from all; the others are smoothed apart.
    NaN is a missing sample. A RecordError says why noise cannot be told from motion, or a coordinate not be integrated.
    """
    sensors = sensors or Sensors()
    cuts = [record.n for record in records] if rows is None else list(rows)
    where = records[0].label
    least = STATES.rows_per_order * (chain.order + 1)
    if sum(cuts) < least or min(cuts) < 2:
        raise RecordError(
            f"{where}: {sum(cuts)} training rows are too few to smooth chain {str(chain)!r} (at least {least}, and 2 in"
            " each record)"
        )
    whole = [series_of(record, chain.measured) for record in records]
    series = [s.take(slice(0, cut)) for s, cut in zip(whole, cuts, strict=True)]
    gains = unit_gains(records, chain, cuts, sensors.gain_sd)
    try:
        known = _known_noise(series, chain, gains, sensors.noise)
        model = fit_kinematic([s.over(gains) for s in series], noise_sd=known)
    except InputError as error:  # a channel with too few samples, or one that never changes
        reason = str(error).split(";")[0]
        raise RecordError(f"{where}: training rows of chain {str(chain)!r} cannot be smoothed: {reason}") from None
    bound = None
    if chain.lowest > 0:
        try:
            bound = _coordinate_sd(series, chain.lowest, model)
        except RecordError as error:
            raise RecordError(f"{where}: {chain.measured[chain.lowest]!r} cannot be integrated: {error}") from None
        whole, model = [_bounded(s) for s in whole], replace(model, noise_sd=(bound, *model.noise_sd[1:]))
    means, sds = [], []
    for s, cut in zip(whole, cuts, strict=True):
        parts = [s.take(slice(0, cut)), *([s.take(slice(cut, s.n))] if s.n - cut > 1 else [])]
        given_all = [smooth_kinematic(part.over(gains), model) for part in parts]
        sds += [one.sd[:, : chain.order + 1] for one in given_all]
        smoothed = [one.mean[:, : chain.order + 1] for one in given_all]
        if s.n - cut == 1:
            smoothed.append(smoothed[0][-1:])
        means.append(np.concatenate(smoothed) * gains)
    sd, noise_sd = np.concatenate(sds), model.noise_sd[chain.lowest]
    variances = tuple(((np.median(sd, axis=0) * gains) ** 2).tolist())
    freedom = min(float(np.mean(sd[:, chain.lowest] ** 2)) / noise_sd**2, 1.0) if noise_sd else 1.0
    return means, ChainSmoothing(model, _rate(series), gains, bound, variances, freedom)


def smooth_further(record: Record, chain: Chain, smoothing: ChainSmoothing) -> Floats:
    """States of a chain in a further record, smoothed like other records of the same system, (n, K + 1)."""
    series = series_of(record, chain.measured)
    if smoothing.coordinate_sd is not None:
        series = _bounded(series)
    mean = smooth_kinematic(series.over(smoothing.unit_gains), smoothing.model).mean
    return np.asarray(mean[:, : chain.order + 1] * smoothing.unit_gains)


def _known_noise(
    series: Sequence[ChainSeries], chain: Chain, gains: Floats, noise: Mapping[str, float]
) -> list[float | None]:
    """Standard deviation of each derivative's noise in units of the model; None where it is not known."""
    out: list[float | None] = [None] * len(chain.measured)
    for k, name in enumerate(chain.measured):
        if name is not None and name in noise:
            spread = float(np.nanstd(np.concatenate([np.asarray(s.channels[k]) for s in series])))
            out[k] = max(noise[name], LEAST_SHARE * spread) / abs(float(gains[k]))
    return out


def _bounded(series: ChainSeries) -> ChainSeries:
    """The series with a channel of zeros for the coordinate."""
    return ChainSeries(series.times, (np.zeros(series.n), *series.channels[1:]))


def _coordinate_sd(series: Sequence[ChainSeries], lowest: int, model: KinematicModel) -> float:
    """Standard deviation of the samples of zero that bound a coordinate that is not measured.

    Below the frequency f_low at which the signal of the lowest measured channel emerges from its noise, nothing is
    known of the coordinate but that it is bounded: zeros of standard deviation sigma/omega_low^lowest weigh there as
    much as the channel does at f_low. A RecordError refuses uneven steps, records at different rates, and a signal that
    never emerges.
    """
    from scipy.special import chdtri  # which takes a while to import

    fs, noise = _rate(series), model.noise_sd[lowest]
    if fs is None:
        if any(_rate([s]) is None for s in series):
            raise RecordError("its steps of time are uneven; resample evenly")
        raise RecordError("records are sampled at different rates; resample them at one rate")
    assert noise is not None
    longest = max(series, key=lambda s: s.n)
    samples = longest.channels[lowest]
    assert samples is not None
    level, freedom = _density(bridged(samples))
    by_chance = float(chdtri(freedom, STATES.emerged_chance / len(level))) / freedom
    emerged = max(STATES.emerged, by_chance)
    if not (level[1:] > emerged * noise**2).any():
        raise RecordError(
            "it does not stand out of its noise at any frequency; measure with less noise, or leave rows at rest out"
        )
    peak = 1 + int(np.argmax(level[1:]))
    # first with the noise at the low end, if it is above the smoother's, then with the smoother's
    for least in (max(noise**2, float(level[: peak + 1].min())), noise**2):
        # down from the peak: signal that emerges again further below is chance, or drift
        below = np.flatnonzero(level[1 : peak + 1] <= emerged * least)
        first = int(below[-1]) + 2 if len(below) else 1
        if first <= peak:
            break
    else:
        raise RecordError(
            f"{longest.n / fs:.3g} s of training rows are too short to show below which frequency it is noise; measure"
            " longer records"
        )
    noise = math.sqrt(least)
    low = float(np.fft.rfftfreq(longest.n, 1.0 / fs)[first])
    return float(noise / (2.0 * np.pi * low) ** lowest)


def _density(samples: Floats) -> tuple[Floats, float]:
    """Density of a channel, averaged over neighbouring bins (white noise has its variance), and degrees of freedom."""
    window = np.hanning(len(samples))
    power = np.abs(np.fft.rfft(window * (samples - samples.mean()))) ** 2 / float(window @ window)
    half = min(LOW_SMOOTHING, int(SHARE_OF_BINS * len(power)))
    average = np.full(2 * half + 1, 1.0 / (2 * half + 1))
    density = np.convolve(np.pad(power, half, mode="reflect"), average, "valid")
    return np.asarray(density), max(2.0, INDEPENDENT * 2.0 * (2 * half + 1))
