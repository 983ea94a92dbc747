"""Numbers of each channel: range, mean, standard deviation, missing samples, resolution, spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.inspection.spectrum import Spectrum, spectrum
from bayeq.records import Record
from bayeq.records.findings import equal_runs

__all__ = ["ChannelInfo", "describe_channels"]

Floats = NDArray[np.float64]

# Rows by which a channel's levels and repeated samples are judged: enough to see how it was sampled.
JUDGED = 20_000

# A channel is said to be coarse if its standard deviation is fewer levels than this.
COARSE = 20.0

# Samples that repeat on average this many times are held: sampled slower than the record.
HELD = 1.9

# Steps of time that differ from the usual one by a larger factor end a piece.
GAP = 2.5


@dataclass(frozen=True, slots=True)
class ChannelInfo:
    """What the samples of one channel are like.

    Attributes
    ----------
    name : str
    unit : str
        Empty where it is not known.
    missing : int
        Samples that are NaN or infinite.
    least, greatest, mean, sd : float
        Of the others; NaN where there are none.
    resolution : float or None
        Distance of levels, of a channel that has few.
    held : float or None
        Rows for which a sample stays on average, of a channel that is sampled slower than the record.
    spectrum : Spectrum or None
        None without time, or of a channel that does not move.
    """

    name: str
    unit: str
    missing: int
    least: float
    greatest: float
    mean: float
    sd: float
    resolution: float | None
    held: float | None
    spectrum: Spectrum | None

    @property
    def constant(self) -> bool:
        """Whether all samples are the same, or missing."""
        return not self.greatest > self.least


def describe_channels(records: Sequence[Record]) -> dict[str, ChannelInfo]:
    """Numbers of every channel over all records, which are parts of one file."""
    clocks = [_Clock(record.time, record.dt, record.is_uniform()) for record in records]
    return {name: _described(records, clocks, name) for name in records[0].names}


class _Clock(NamedTuple):
    """Time of a record, its step, and whether that is even."""

    time: Floats | None
    step: float | None
    even: bool


def _described(records: Sequence[Record], clocks: Sequence[_Clock], name: str) -> ChannelInfo:
    samples = np.concatenate([record[name] for record in records])
    known = np.isfinite(samples)
    missing = int(len(samples) - np.count_nonzero(known))
    values = samples if missing == 0 else samples[known]
    if not len(values):
        nan = float("nan")
        return ChannelInfo(name, records[0].units.get(name, ""), missing, nan, nan, nan, nan, None, None, None)
    least, greatest = float(values.min()), float(values.max())
    size = max(abs(least), abs(greatest)) or 1.0  # so that no square overflows
    scaled = values / size
    resolution, held = _sampling(values[:JUDGED])
    step = clocks[0].step
    pieces = [piece for r, clock in zip(records, clocks, strict=True) for piece in _even_pieces(r[name], clock)]
    return ChannelInfo(
        name=name,
        unit=records[0].units.get(name, ""),
        missing=missing,
        least=least,
        greatest=greatest,
        mean=float(scaled.mean()) * size,
        sd=float(scaled.std()) * size if greatest > least else 0.0,
        resolution=resolution,
        held=held,
        spectrum=spectrum(pieces, step) if step else None,
    )


def _sampling(values: Floats) -> tuple[float | None, float | None]:
    """Distance of levels if it is coarse, and how many rows a sample is held if more than one."""
    levels = np.unique(values)
    if len(levels) < 2:
        return None, None
    distance = float(np.diff(levels).min())
    coarse = len(levels) < 0.1 * len(values) and float(values.std()) < COARSE * distance
    # samples at rest, or at an extreme, are repeated without being held: the usual run counts
    lengths = equal_runs(values)[1]
    usual = float(np.median(lengths))
    held = float(lengths.mean()) if usual >= HELD and not coarse else None
    return (distance if coarse else None), held


def _even_pieces(values: Floats, clock: _Clock) -> list[Floats]:
    """Samples of a channel at even steps of time, interpolated where time is uneven or samples are missing.

    The record is divided at gaps of more than 2.5 steps, which nothing is interpolated over.
    """
    time, step = clock.time, clock.step
    known = np.isfinite(values)
    if time is None or step is None or not known.any():
        return []
    if not known.all():
        values = np.interp(time, time[known], values[known])
    if clock.even:
        return [values]
    out = []
    cuts = np.flatnonzero(np.diff(time) > GAP * step) + 1
    for t, piece in zip(np.split(time, cuts), np.split(values, cuts), strict=True):
        count = int((t[-1] - t[0]) / step) + 1
        out.append(np.interp(t[0] + step * np.arange(count), t, piece))
    return out
