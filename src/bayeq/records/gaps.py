"""Records divided at gaps that no smoother can bridge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.records.record import Record

__all__ = ["split_at_gaps"]

Floats = NDArray[np.float64]

# A gap longer than this share of a period is not bridged.
LONGEST_GAP = 0.5

# A step of time longer than so many usual ones is a gap; pieces of fewer rows are left out.
GAP = 1.5
LEAST_ROWS = 40


def split_at_gaps(records: Sequence[Record], channels: Sequence[str]) -> tuple[list[Record], list[str]]:
    """Records with time divided where more than half a period of the motion is missing.

    Parameters
    ----------
    records : sequence of Record
        Measured channels.
    channels : sequence of str
        Those that show the motion, one of each coordinate; the shortest period of their strongest lines counts.

    Returns
    -------
    list of Record, list of str
        Pieces of 40 rows or more, and a message for each record that was divided.
    """
    out, messages = [], []
    for record in records:
        bounds = _bounds(record, channels)
        pieces = [record.slice(a, b) for a, b in bounds if b - a >= LEAST_ROWS]
        if len(bounds) < 2 or not pieces:
            out.append(record)
            continue
        short = sum(b - a for a, b in bounds if b - a < LEAST_ROWS)
        left = f"; {short} rows in pieces of less than {LEAST_ROWS} are not used" if short else ""
        messages.append(
            f"{record.name or 'record'}: gaps longer than half a period, the first after row {bounds[0][1]}: taken as"
            f" {len(pieces)} pieces{left}"
        )
        out += pieces
    return out, messages


def _bounds(record: Record, channels: Sequence[str]) -> list[tuple[int, int]]:
    """First row and end of each piece."""
    whole = [(0, record.n)]
    if record.time is None or record.n < 2 * LEAST_ROWS:
        return whole
    steps = np.diff(record.time)
    step = float(np.median(steps))
    if not step > 0 or not (steps > GAP * step).any():
        return whole
    periods = [_period(np.asarray(record.time), record[name], step) for name in channels if name in record.channels]
    if not periods:
        return whole
    ends = np.flatnonzero(steps > max(LONGEST_GAP * min(periods), GAP * step)) + 1
    return list(zip([0, *ends.tolist()], [*ends.tolist(), record.n], strict=True))


def _period(time: Floats, samples: Floats, step: float) -> float:
    """Period of the strongest line of a channel [s], gaps interpolated; infinite where there is none."""
    if not np.isfinite(samples).all() or np.ptp(samples) == 0:
        return float("inf")
    even = np.arange(time[0], time[-1], step)
    values = np.interp(even, time, samples / np.abs(samples).max())
    power = np.abs(np.fft.rfft(np.hanning(len(even)) * (values - values.mean()))) ** 2
    strongest = 1 + int(np.argmax(power[1:]))
    return float(len(even) * step / strongest)
