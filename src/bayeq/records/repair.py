"""Records made fit for inference: gaps, rows without time, and what may be done about findings, each explicitly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.errors import InputError, RecordError
from bayeq.numerics.settings import RECORDS
from bayeq.records.record import Record, with_samples

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

#: The unit of time of a record whose time is the number of the row.
SAMPLES = "samples"

UNKNOWN_TIME = (
    "time is not known: row numbers are used as time, and coefficients are per sample; give --fs or --time (fs=, time=)"
)

# Rows are in order of time if a sample of some channel says this much of the next one.
IN_ORDER = 0.5

# Samples on either side that interpolation takes in, and its Kaiser window: up to 0.45 of the sampling rate it is exact
# to 1e-5 (Kaiser 1974).
HALF_WIDTH = 32
KAISER = 10.0


# --- gaps ------------------------------------------------------------------------------------------------------------


def split_at_gaps(records: Sequence[Record], channels: Sequence[str]) -> tuple[list[Record], list[str]]:
    """Records divided at gaps longer than half the shortest period of a channel, and a message for each such record.

    Where the pieces too short to use, of less than 40 rows, would hold more rows than are missing in the gaps, the
    record stays whole.
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
        assert record.time is not None
        steps = np.diff(record.time)
        missing = float(np.sum(steps[np.array(ends) - 1]) / np.median(steps)) - len(ends)
        if left_out > missing:
            messages.append(f"{gaps} bridged, the pieces between are too short; measure without gaps")
            out.append(record)
            continue
        rest = f"; {left_out} rows unused" if left_out else ""
        pieces_used = "1 piece" if len(used) == 1 else f"{len(used)} pieces"
        messages.append(f"{gaps} taken as {pieces_used}{rest}")
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
        name: RECORDS.longest_gap * _shortest_period(np.split(record.time, cuts), np.split(record[name], cuts), step)
        for name in channels
        if name in record.channels and len(np.unique(record[name][np.isfinite(record[name])])) > 1
    }
    if not half_periods:
        return [], ""
    name, half = min(half_periods.items(), key=lambda item: item[1])
    ends = np.flatnonzero(steps > max(half, GAP * step)) + 1
    return ends.tolist(), f"half a period of {name} ({half:.3g} s)"


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
    return max(counts) * step / (1 + int(np.argmax(below >= RECORDS.gap_power * below[-1])))


# --- rows without time -----------------------------------------------------------------------------------------------


def counts_rows(record: Record) -> bool:
    """Whether the time of a record is the number of the row.

    Examples
    --------
    >>> [counts_rows(one) for one in with_row_numbers([Record({"x": [1.0, 2.0, 3.0, 5.0, 6.0, 7.0]})])]
    [True]
    """
    return record.units.get("t") == SAMPLES and "t" not in record.channels


def with_row_numbers(records: Sequence[Record]) -> list[Record]:
    """The records with row numbers as time, if none of them has a time; else as they are.

    So are records whose rows follow no order, such as a table of single tests, and those with a channel called t.
    """
    if any(record.time is not None or "t" in record.channels or not _in_order(record) for record in records):
        return list(records)
    return [
        replace(record, time=np.arange(record.n, dtype=np.float64), units={**record.units, "t": SAMPLES})
        for record in records
    ]


def _in_order(record: Record) -> bool:
    """Whether neighbouring samples of a channel are alike, as those of a motion are."""
    for values in record.channels.values():
        known = values[np.isfinite(values)]
        if len(known) < 3:
            continue
        scale = float(np.abs(known).max()) or 1.0
        centred = known / scale - float(np.mean(known / scale))
        if float(centred[1:] @ centred[:-1]) > IN_ORDER * float(centred @ centred) > 0.0:
            return True
    return False


# --- delays and offsets ----------------------------------------------------------------------------------------------


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
    return with_samples(record, {channel: shifted}).take(slice(int(rows[0]), int(rows[-1]) + 1))


def _interpolate(values: Floats, rows: Ints, steps: float) -> Floats:
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
    return with_samples(record, {channel: values})
