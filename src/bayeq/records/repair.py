"""What may be done about findings of `records.checks`, explicitly: each makes a new record."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError, RecordError
from bayeq.records.record import Record

__all__ = ["correct_delay", "remove_offset"]

Floats = NDArray[np.float64]

# Samples on either side that interpolation takes in, and its Kaiser window: up to 0.45 of the sampling rate it is exact
# to 1e-5 (Kaiser 1974).
HALF_WIDTH = 32
KAISER = 10.0


def _number(what: str, value: float) -> float:
    if not (isinstance(value, (int, float, np.number)) and math.isfinite(value)):
        raise InputError(f"{what} must be a finite number, got {value!r}")
    return float(value)


def correct_delay(record: Record, channel: str, seconds: float) -> Record:
    """Shift a channel back by its delay, by band-limited interpolation.

    Parameters
    ----------
    record : Record
        Sampled at even steps of time.
    channel : str
        The channel that lags behind the others.
    seconds : float
        Its delay [s], negative if it is ahead; what a ``"delay"`` of `check_record` gives.

    Returns
    -------
    Record
        Without the rows at one end for which the channel was not measured.

    Raises
    ------
    RecordError
        No time, uneven time, samples that are not finite, or a delay as long as the record.

    Notes
    -----
    A windowed sinc of 65 samples, continued oddly about the ends of the record.

    Examples
    --------
    >>> t = np.arange(1000) / 100
    >>> late = Record({"x": np.sin(7 * t), "v": 7 * np.cos(7 * (t - 0.0123))}, time=t)
    >>> right = correct_delay(late, "v", 0.0123)
    >>> right.n, bool(np.abs(right["v"] - 7 * np.cos(7 * right.time))[40:-40].max() < 1e-3)
    (998, True)
    """
    seconds = _number("a delay", seconds)
    where = record.name or "record"
    values = record[channel]
    record.require_finite(channel)
    if record.time is None or record.n < 2 or not record.is_uniform():
        raise RecordError(f"{where}: a channel is shifted by interpolation, which needs even steps of time")
    dt = float(record.time[-1] - record.time[0]) / (record.n - 1)
    steps = seconds / dt
    if abs(steps) > record.n - 2:
        raise RecordError(f"{where}: a delay of {seconds:g} s is longer than the record")
    rows = np.arange(max(0, math.ceil(-steps)), record.n - max(0, math.ceil(steps)))
    shifted = np.zeros(record.n)
    shifted[rows] = _interpolate(values, rows, steps)
    return record.with_channels({channel: shifted}, _kept_unit(record, channel)).take(
        slice(int(rows[0]), int(rows[-1]) + 1)
    )


def _interpolate(values: Floats, rows: NDArray[np.int64], steps: float) -> Floats:
    """Values at `rows` + `steps`."""
    whole = math.floor(steps)
    part = steps - whole
    if part == 0.0:
        return values[rows + whole]
    offsets = np.arange(1 - HALF_WIDTH, HALF_WIDTH + 1)
    distance = part - offsets
    window = np.i0(KAISER * np.sqrt(np.maximum(1.0 - (distance / HALF_WIDTH) ** 2, 0.0))) / np.i0(KAISER)
    weights = np.sinc(distance) * window
    weights /= weights.sum()  # constants stay
    margin = HALF_WIDTH + abs(whole) + 1
    extended = np.pad(values, margin, mode="reflect", reflect_type="odd")
    out = np.zeros(len(rows))
    for offset, weight in zip(offsets, weights, strict=True):
        out += weight * extended[rows + (whole + margin + int(offset))]
    return out


def remove_offset(record: Record, channel: str, offset: float | None = None, drift: float = 0.0) -> Record:
    """Subtract an offset, and a drift, from a channel.

    Parameters
    ----------
    record : Record
        With time, where there is a drift.
    channel : str
        The channel.
    offset : float, optional
        At the middle of the record, in the unit of the channel; what an ``"offset"`` of `check_record` gives. By
        default the mean of the channel, as of a laser's stand-off.
    drift : float
        Change per second; what a ``"drift"`` of `check_record` gives.

    Raises
    ------
    RecordError
        A drift in a record without time.

    Examples
    --------
    >>> record = Record({"v": [1.0, 2.0, 3.0]}, time=[0.0, 1.0, 2.0])
    >>> remove_offset(record, "v", 0.5, drift=1.0)["v"]
    array([1.5, 1.5, 1.5])
    """
    if offset is None:
        known = record[channel][np.isfinite(record[channel])]
        offset = float(known.mean()) if len(known) else 0.0
    offset, drift = _number("an offset", offset), _number("a drift", drift)
    values = record[channel] - offset
    if drift:
        if record.time is None:
            raise RecordError(f"{record.name or 'record'}: a drift is per second, and the record has no time")
        values = values - drift * (record.time - 0.5 * (record.time[0] + record.time[-1]))
    return record.with_channels({channel: values}, _kept_unit(record, channel))


def _kept_unit(record: Record, channel: str) -> dict[str, str]:
    return {channel: record.units[channel]} if channel in record.units else {}
