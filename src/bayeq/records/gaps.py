"""Records divided at gaps that no interpolation can bridge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.records.record import Record

__all__ = ["split_at_gaps"]

Floats = NDArray[np.float64]

# A gap is bridged up to this share of a channel's shortest period, 1/f for the frequency f that 99 % of its power lies
# below: samples that near on either side still fix the wave between them (the sampling theorem). Measured on forced,
# chaotic and decaying motion, what is filled in is wrong by up to 3 % (states) and 7 % (derivatives) of the standard
# deviation at half a period, by 20 % and 50 % at a whole one.
LONGEST_GAP = 0.5
POWER = 0.99

# The least level of this many bands of a spectrum is taken for white noise, which is no power of the signal. In more of
# them, shorter ones, chance makes the least too low: noise of 20 % of the signal would count as motion.
BANDS = 4

# A gap of more than one sample is a step of time longer than this many usual ones; single samples are always bridged.
GAP = 2.5

# Spectra are those of the stretches between gaps longer than this many usual steps: across them it would be the
# spectrum of a straight line.
LONG_GAP = 20.0

# Shorter pieces are left out: nothing tells noise from motion in them.
SHORTEST_PIECE = 40


def split_at_gaps(records: Sequence[Record], channels: Sequence[str]) -> tuple[list[Record], list[str]]:
    """Records with time divided at gaps longer than half the shortest period of a channel.

    Where the pieces too short to use, of less than 40 rows, would hold more rows than are missing in the gaps, the
    record stays whole.

    Parameters
    ----------
    records : sequence of Record
        Measured channels.
    channels : sequence of str
        Those that are used, inputs too.

    Returns
    -------
    list of Record, list of str
        The pieces, and a message for each record with such gaps.
    """
    out, messages = [], []
    for record in records:
        ends, limit = _ends(record, channels)
        pieces = [record.slice(a, b) for a, b in zip([0, *ends], [*ends, record.n], strict=True)]
        used = [piece for piece in pieces if piece.n >= SHORTEST_PIECE]
        if not ends or not used:
            out.append(record)
            continue
        gaps = f"{record.name or 'record'}: gaps longer than {limit}, the first after row {ends[0]}:"
        left_out = record.n - sum(piece.n for piece in used)
        if left_out > _missing(record, ends):
            messages.append(
                f"{gaps} interpolated all the same, since the pieces between them are too short to use; measure"
                " without gaps"
            )
            out.append(record)
            continue
        rest = f"; {left_out} rows in pieces of less than {SHORTEST_PIECE} are not used" if left_out else ""
        pieces_used = "1 piece" if len(used) == 1 else f"{len(used)} pieces"
        messages.append(f"{gaps} taken as {pieces_used}{rest}; check the acquisition")
        out += used
    return out, messages


def _ends(record: Record, channels: Sequence[str]) -> tuple[list[int], str]:
    """Ends of the pieces but the last, and the limit that the gaps exceed, in words."""
    if record.time is None or record.n < 2 * SHORTEST_PIECE:
        return [], ""
    steps = np.diff(record.time)
    step = float(np.median(steps))
    if not (steps > GAP * step).any():
        return [], ""
    cuts = np.flatnonzero(steps > LONG_GAP * step) + 1
    half_periods = {
        name: LONGEST_GAP * _shortest_period(np.split(record.time, cuts), np.split(record[name], cuts), step)
        for name in channels
        if name in record.channels and len(np.unique(record[name][np.isfinite(record[name])])) > 1
    }
    if not half_periods:
        return [], ""
    name, half = min(half_periods.items(), key=lambda item: item[1])
    ends = np.flatnonzero(steps > max(half, GAP * step)) + 1
    return ends.tolist(), f"half a period of {name} ({half:.3g} s)"


def _missing(record: Record, ends: list[int]) -> float:
    """Number of rows missing in gaps."""
    assert record.time is not None
    steps = np.diff(record.time)
    return float(np.sum(steps[np.array(ends) - 1]) / np.median(steps)) - len(ends)


def _shortest_period(times: Sequence[Floats], stretches: Sequence[Floats], step: float) -> float:
    """Period [s] of the frequency that 99 % of a channel's power lies below, without noise; 0 of short stretches."""
    known = [np.isfinite(samples) for samples in stretches]
    times = [time[one] for time, one in zip(times, known, strict=True) if one.any()]
    stretches = [samples[one] for samples, one in zip(stretches, known, strict=True) if one.any()]
    counts = [round(float(time[-1] - time[0]) / step) + 1 for time in times]
    if max(counts) < SHORTEST_PIECE:
        return 0.0
    size = max(np.abs(samples).max() for samples in stretches)
    power = np.zeros(max(counts) // 2)
    for time, samples, count in zip(times, stretches, counts, strict=True):
        values = np.interp(time[0] + step * np.arange(count), time, samples / size)
        power += np.abs(np.fft.rfft(np.hanning(count) * (values - values.mean()), max(counts))[1:]) ** 2
    noise = min(float(band.mean()) for band in np.array_split(power, BANDS))
    below = np.cumsum(power - noise)
    return max(counts) * step / (1 + int(np.argmax(below >= POWER * below[-1])))
