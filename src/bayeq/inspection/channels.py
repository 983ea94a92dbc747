"""Statistics of each channel: range, mean, standard deviation, missing samples, resolution, spectrum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayeq.arrays import Floats
from bayeq.records import Record
from bayeq.records.findings import equal_runs
from bayeq.records.repair import GAP

# Number of samples from which levels and repeated samples of a channel are judged.
JUDGED = 20_000

# A channel counts as coarse if its standard deviation is fewer levels than this.
COARSE = 20.0

# A channel is held, sampled more slowly than the record, if its median run of equal samples is at least HELD rows. If
# the mean square of its changes from run to run exceeds its variance, as of a motion with fewer than 6 samples per
# period, it may also be steps of a programme. It surely is, and is not held, if more than the share UNEVEN of the runs
# differ from the median by more than a row and a tenth of it: steps last as long as they like.
HELD, UNEVEN = 1.9, 0.1

# Share of the power that the bandwidth holds.
SHARE = 0.99

# Segments of a spectrum: the whole record up to SHORT rows, else a quarter of it, up to LONGEST rows, overlapping by
# half; at most MOST_SEGMENTS of them, spread evenly over the record.
SHORT, LONGEST, MOST_SEGMENTS = 8192, 65536, 16

# Maximum number of octaves, from half the sampling rate down; the lowest one includes all lower frequencies.
MOST_OCTAVES = 12
LEAST_ROWS = 16

# Height of the bars: a full one is the strongest octave, an empty one is this much below [dB].
RANGE_DB = 42.0
BLOCKS, DIGITS = "▁▂▃▄▅▆▇█", "12345678"


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Power spectrum of a channel without its mean."""

    octaves: tuple[float, ...]  # upper edges of the bands [Hz], rising, each twice the one before, to half the rate
    shares: tuple[float, ...]  # share of the power in each band
    peak: float  # frequency that holds most power [Hz]
    bandwidth: float  # 99 % of the power is below [Hz]


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """Statistics of the samples of one channel."""

    name: str
    unit: str  # empty where it is not known
    missing: int  # samples that are NaN or infinite
    least: float  # this and the next three: of the finite samples; NaN if there are none
    greatest: float
    mean: float
    sd: float
    resolution: float | None  # distance of levels, if the channel is coarse
    held: float | None  # mean number of rows per sample, if the channel is sampled more slowly than the record
    stepped: bool  # whether a held channel may also be the steps of a programme
    spectrum: Spectrum | None  # None without time, or for a constant channel

    @property
    def constant(self) -> bool:
        """Whether all samples are the same, or missing."""
        return not self.greatest > self.least


def describe_channels(records: Sequence[Record]) -> dict[str, ChannelInfo]:
    """Statistics of every channel over all records, which are parts of one file."""
    clocks = [(record.time, record.dt, record.is_uniform()) for record in records]
    return {name: _described(records, clocks, name) for name in records[0].names}


# Time of a record, its step, and whether that is even.
_Clock = tuple[Floats | None, float | None, bool]


def _described(records: Sequence[Record], clocks: Sequence[_Clock], name: str) -> ChannelInfo:
    samples = np.concatenate([record[name] for record in records])
    known = np.isfinite(samples)
    values = samples[known] if known.any() else np.array([np.nan])
    least, greatest = float(values.min()), float(values.max())
    size = max(abs(least), abs(greatest)) or 1.0  # so that no square overflows
    scaled = values / size
    resolution, held, stepped = _sampling(values[:JUDGED])
    step = clocks[0][1]
    pieces = [piece for r, clock in zip(records, clocks, strict=True) for piece in _even_pieces(r[name], *clock)]
    return ChannelInfo(
        name=name,
        unit=records[0].units.get(name, ""),
        missing=int(len(samples) - np.count_nonzero(known)),
        least=least,
        greatest=greatest,
        mean=float(scaled.mean()) * size,
        sd=0.0 if greatest == least else float(scaled.std()) * size,
        resolution=resolution,
        held=held,
        stepped=stepped,
        spectrum=spectrum(pieces, step) if step else None,
    )


def _sampling(values: Floats) -> tuple[float | None, float | None, bool]:
    """Distance of levels if the channel is coarse, mean number of rows per sample if it is held, whether in steps."""
    levels = np.unique(values)
    if len(levels) < 2:
        return None, None, False
    distance = float(np.diff(levels).min())
    coarse = len(levels) < 0.1 * len(values) and float(values.std()) < COARSE * distance
    # samples at rest, or at an extreme, are repeated without being held: the median run decides
    starts, lengths = equal_runs(values)
    usual = float(np.median(lengths))
    jumps = float(np.mean(np.diff(values[starts]) ** 2)) > float(np.var(values[starts]))
    uneven = float(np.mean(np.abs(lengths[1:-1] - usual) > max(1.0, 0.1 * usual))) if len(lengths) > 2 else 0.0
    if coarse or usual < HELD or (jumps and uneven > UNEVEN):
        return (distance if coarse else None), None, False
    return None, float(lengths.mean()), jumps


def _even_pieces(values: Floats, time: Floats | None, step: float | None, even: bool) -> list[Floats]:
    """Samples at even steps of time between gaps, interpolated where time is uneven or samples are missing."""
    known = np.isfinite(values)
    if time is None or step is None or not known.any():
        return []
    if not known.all():
        values = np.interp(time, time[known], values[known])
    if even:
        return [values]
    out = []
    cuts = np.flatnonzero(np.diff(time) > GAP * step) + 1
    for t, piece in zip(np.split(time, cuts), np.split(values, cuts), strict=True):
        count = int((t[-1] - t[0]) / step) + 1
        out.append(np.interp(t[0] + step * np.arange(count), t, piece))
    return out


def spectrum(pieces: Sequence[Floats], step: float) -> Spectrum | None:
    """Spectrum of stretches of one channel at even steps of time [s], without NaN; None for short or constant ones."""
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

    >>> wave = np.sin(2 * np.pi * 5 * np.arange(1000) / 100)
    >>> bars(spectrum([wave], 0.01)), bars(spectrum([wave], 0.01), plain=True)
    ('▁▁▁▁█▁▁▁', '11118111')
    """
    marks = DIGITS if plain else BLOCKS
    top = max(found.shares)
    levels = [10.0 * math.log10(max(share / top, 1e-30)) for share in found.shares]
    return "".join(marks[max(0, round((1.0 + level / RANGE_DB) * (len(marks) - 1)))] for level in levels)
