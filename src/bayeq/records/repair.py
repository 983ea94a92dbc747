"""Repair of records: splits at gaps, row numbers as time, correction of delays and offsets, joining of recorders."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError, RecordError, in_digits, require_kind
from bayeq.numerics.settings import RECORDS
from bayeq.records.record import Record, with_samples

# The lowest mean power of this many bands of a spectrum is taken as white noise and subtracted. With more, narrower
# bands that minimum is biased low: noise of 20 % of the signal would count as motion.
BANDS = 4

# A gap is a time step longer than this many median steps; a single missing sample is always bridged.
GAP = 2.5

# Spectra are taken between gaps longer than this many median steps; shorter gaps are interpolated linearly.
LONG_GAP = 20.0

# Minimum number of rows of a piece: in shorter ones noise and motion cannot be separated.
SHORTEST_PIECE = 40

#: The unit of time of a record whose time is the number of the row.
SAMPLES = "samples"

UNKNOWN_TIME = (
    "time is not known: row numbers are used as time; give --fs or --time (in Python fs= or time= of the record)"
)

# Rows count as in order of time if the lag-1 autocorrelation of some channel exceeds this.
IN_ORDER = 0.5

# Samples on either side of the interpolation kernel, and beta of its Kaiser window: exact to 1e-5 up to 0.45 of the
# sampling rate (Kaiser 1974).
HALF_WIDTH = 32
KAISER = 10.0


# --- gaps ------------------------------------------------------------------------------------------------------------


def split_at_gaps(records: Sequence[Record], channels: Sequence[str]) -> tuple[list[Record], list[str]]:
    """Records divided at gaps longer than half the shortest period of a channel, and a message for each such record.

    A record stays whole if the pieces too short to use, of less than 40 rows, hold more rows than the gaps are
    missing.
    """
    out, messages = [], []
    for record in records:
        ends, limit = _ends(record, channels)
        pieces = [record.slice(a, b) for a, b in zip([0, *ends], [*ends, record.n], strict=True)]
        used = [piece for piece in pieces if piece.n >= SHORTEST_PIECE]
        if not ends or not used:
            out.append(record)
            continue
        where = f"{record.label}: " if len(records) > 1 else ""
        gaps = f"{where}gaps longer than {limit}, first after row {ends[0]}:"
        left_out = record.n - sum(piece.n for piece in used)
        assert record.time is not None
        steps = np.diff(record.time)
        missing = float(np.sum(steps[np.array(ends) - 1]) / np.median(steps)) - len(ends)
        if left_out > missing:
            messages.append(f"{gaps} bridged; measure without gaps")
            out.append(record)
            continue
        rest = f"; {left_out} rows unused" if left_out else ""
        pieces_used = "1 piece" if len(used) == 1 else f"{len(used)} pieces"
        messages.append(f"{gaps} taken as {pieces_used}{rest}")
        out += used
    return out, messages


def _ends(record: Record, channels: Sequence[str]) -> tuple[list[int], str]:
    """End rows of all pieces but the last, and the limit that the gaps exceed, as text."""
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
    return ends.tolist(), f"half a period of {name} ({in_digits(half, 3)} s)"


def _shortest_period(times: Sequence[Floats], stretches: Sequence[Floats], step: float) -> float:
    """Period [s] of the frequency below which 99 % of a channel's power lies, less noise; 0 for short stretches."""
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

    >>> [counts_rows(one) for one in with_row_numbers([Record({"x": [1.0, 2.0, 3.0, 5.0, 6.0, 7.0]})])]
    [True]
    """
    return record.units.get("t") == SAMPLES and "t" not in record.channels


def with_row_numbers(records: Sequence[Record]) -> list[Record]:
    """The records with row numbers as time, if none has time, all seem to be in order of time, and none has a t."""
    if any(record.time is not None or "t" in record.channels or not _in_order(record) for record in records):
        return list(records)
    return [
        replace(record, time=np.arange(record.n, dtype=np.float64), units={**record.units, "t": SAMPLES})
        for record in records
    ]


def _in_order(record: Record) -> bool:
    """Whether the lag-1 autocorrelation of a channel exceeds IN_ORDER, as in a sampled motion."""
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
        Its delay [s], negative if it is ahead: the value of a ``"delay"`` finding of `check_record`.

    Returns
    -------
    Record
        The record without the rows at one end for which the shifted channel has no samples.

    Raises
    ------
    RecordError
        No time, uneven time, samples that are not finite, or a delay as long as the record.

    Notes
    -----
    Interpolation by a windowed sinc of 64 samples; the channel is extended by odd reflection at both ends.

    Examples
    --------
    >>> t = np.arange(1000) / 100
    >>> late = Record({"x": np.sin(7 * t), "v": 7 * np.cos(7 * (t - 0.0123))}, time=t)
    >>> right = correct_delay(late, "v", 0.0123)
    >>> right.n, bool(np.abs(right["v"] - 7 * np.cos(7 * right.time))[40:-40].max() < 1e-3)
    (998, True)
    """
    seconds = _number("a delay", seconds)
    where = record.label
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
    """Values interpolated at `rows` + `steps`, where `steps` may be fractional."""
    whole = math.floor(steps)
    part = steps - whole
    if part == 0.0:
        return values[rows + whole]
    offsets = np.arange(1 - HALF_WIDTH, HALF_WIDTH + 1)
    distance = part - offsets
    window = np.i0(KAISER * np.sqrt(np.maximum(1.0 - (distance / HALF_WIDTH) ** 2, 0.0))) / np.i0(KAISER)
    weights = np.sinc(distance) * window
    weights /= weights.sum()  # constants are reproduced
    margin = HALF_WIDTH + abs(whole) + 1
    extended = np.pad(values, margin, mode="reflect", reflect_type="odd")
    out = np.zeros(len(rows))
    for offset, weight in zip(offsets, weights, strict=True):
        out += weight * extended[rows + (whole + margin + int(offset))]
    return out


def remove_offset(record: Record, channel: str, offset: float | str | None = None, drift: float = 0.0) -> Record:
    """Subtract an offset, and a drift, from a channel, or another channel, as a base's motion from an absolute one.

    Parameters
    ----------
    record : Record
        The record; it needs time if there is a drift.
    channel : str
        The channel.
    offset : float or str, optional
        Offset at the middle of the record, in the unit of the channel: the value of an ``"offset"`` finding of
        `check_record`. By default the mean of the channel, for example a laser's stand-off. A name is that of a channel
        of the same unit, which is subtracted sample by sample.
    drift : float
        Change per second: the value of a ``"drift"`` finding of `check_record`.

    Raises
    ------
    RecordError
        A drift in a record without time; two channels with different units.

    Examples
    --------
    >>> record = Record({"v": [1.0, 2.0, 3.0], "base": [0.5, 0.5, 1.5]}, time=[0.0, 1.0, 2.0])
    >>> remove_offset(record, "v", 0.5, drift=1.0)["v"]
    array([1.5, 1.5, 1.5])
    >>> remove_offset(record, "v", "base")["v"]
    array([0.5, 1.5, 1.5])
    """
    if isinstance(offset, str):
        return _against(record, channel, offset)
    if offset is None:
        known = record[channel][np.isfinite(record[channel])]
        offset = float(known.mean()) if len(known) else 0.0
    offset, drift = _number("an offset", offset), _number("a drift", drift)
    values = record[channel] - offset
    if drift:
        if record.time is None:
            raise RecordError(f"{record.label}: a drift is per second, and the record has no time")
        values = values - drift * (record.time - 0.5 * (record.time[0] + record.time[-1]))
    return with_samples(record, {channel: values})


def _against(record: Record, channel: str, other: str) -> Record:
    """The record with a channel less another one."""
    units = [record.units.get(name) for name in (channel, other)]
    if units[0] != units[1] and None not in units:
        raise RecordError(f"{record.label}: {channel} is in {units[0]}, {other} in {units[1]}: no difference of these")
    if channel == other:
        raise RecordError(f"{record.label}: {channel} less itself is nothing: name another channel")
    return with_samples(record, {channel: record[channel] - record[other]})


# --- two recorders ----------------------------------------------------------------------------------------------------

#: Sampling rates that differ by less than this share are the same.
SAME_RATE = 0.01
#: A channel with more than this share of its variance above half the first record's rate would alias.
ALIASED = 0.01
#: A time step longer than this many median steps is a gap.
APART = 1.5


def join(first: Record, *others: Record) -> Record:
    """Join the channels of several records on the time of the first.

    The rows are those of `first` within the span that all records have in common. Channels of the others are
    interpolated by cubic splines, which reproduce samples at equal times; where a sample next to a row is missing, the
    row is NaN. Clocks are assumed to agree: a delay between them is not corrected. Records that both have dates are
    aligned by them.

    Parameters
    ----------
    first : Record
        The record whose time is kept: the one that is sampled most slowly.
    *others : Record
        Records with other channels.

    Raises
    ------
    RecordError
        A record without time; no time in common; a channel of the same name in two records; a record that is sampled
        more slowly than the first; a channel of a faster one with more than 1 % of its variance above half the first
        one's rate, which would alias.

    Examples
    --------
    >>> x = Record.from_arrays(x=[0.0, 1.0, 4.0, 9.0], time=[0.0, 1.0, 2.0, 3.0])
    >>> u = Record.from_arrays(u=[1.0, 2.0, 3.0, 4.0], time=[0.5, 1.5, 2.5, 3.5])
    >>> joined = join(x, u)
    >>> joined.time, joined["u"]
    (array([1., 2., 3.]), array([1.5, 2.5, 3.5]))
    """
    own = _time(first)
    others = tuple(_by_clock_of(first, other) for other in others)
    times = [own, *map(_time, others)]
    start, stop = max(t[0] for t in times), min(t[-1] for t in times)
    rows = (times[0] >= start) & (times[0] <= stop)
    if rows.sum() < 2:
        spans = "; ".join(f"{r.label} {t[0]:g} to {t[-1]:g} s" for r, t in zip((first, *others), times, strict=True))
        raise RecordError(f"records without time in common: {spans}")
    joined = first.take(rows)
    for other in others:
        twice = [name for name in other.names if name in joined]
        if twice:
            raise RecordError(
                f"{other.label}: a channel {twice[0]!r} is in another record too; rename or leave out one"
            )
        _check_rates(first, other)
        channels = {name: _at(times[0][rows], other, name) for name in other.names}
        units = {name: other.units[name] for name in other.names if name in other.units}
        joined = joined.with_channels(channels, units)
    return joined.renamed(" + ".join(record.name for record in (first, *others) if record.name))


def _by_clock_of(first: Record, other: Record) -> Record:
    """`other` with its time counted from time 0 of `first` if both have dates; unchanged otherwise."""
    time = _time(other)
    if other.begins is None or first.begins is None:
        return other
    return replace(other, time=time + (other.begins - first.begins))


def _time(record: Record) -> Floats:
    require_kind(record, Record, "each of what is joined", "a Record")
    if record.time is None or record.n < 4:
        what = "has no time" if record.time is None else f"has {record.n} rows, too few for a spline"
        raise RecordError(f"{record.label} {what}; it cannot be joined")
    return record.time


def _check_rates(first: Record, other: Record) -> None:
    """Raise a RecordError if `other` is sampled more slowly than `first`, or faster with channels that would alias."""
    slow, fast = first.dt or 1.0, other.dt or 1.0
    if fast > (1 + SAME_RATE) * slow:
        raise RecordError(
            f"{other.label} is sampled at {1 / fast:g} Hz, more slowly than {first.label} at {1 / slow:g} Hz; put"
            " the slowest first, whose time is kept"
        )
    if fast > (1 - SAME_RATE) * slow:
        return
    for name in other.names:
        share = _share_above(other, name, 0.5 / slow)
        if share > ALIASED:
            raise RecordError(
                f"{other.label}: {in_digits(100 * share)} % of the variance of {name!r} is above {0.5 / slow:g} Hz,"
                f" half the rate of {first.label}, and would alias; low-pass it first"
            )


def _share_above(record: Record, name: str, frequency: float) -> float:
    """The share of a channel's variance above a frequency [Hz], by its periodogram."""
    time, values = _finite(record, name)
    if len(time) < 8:
        return 0.0
    even = np.linspace(time[0], time[-1], len(time))
    samples = np.interp(even, time, values)
    samples = (samples - np.polynomial.Polynomial.fit(even, samples, 1)(even)) * np.hanning(len(even))
    power = np.abs(np.fft.rfft(samples)) ** 2
    total = float(power.sum())
    above = np.fft.rfftfreq(len(even), float(even[1] - even[0])) > frequency
    return float(power[above].sum()) / total if total > 0 else 0.0


def _finite(record: Record, name: str) -> tuple[Floats, Floats]:
    time, values = _time(record), record[name]
    finite: Bools = np.isfinite(values)
    return time[finite], values[finite]


def _at(wanted: Floats, other: Record, name: str) -> Floats:
    """A channel interpolated at the times `wanted`; NaN in gaps and outside its span."""
    from scipy.interpolate import CubicSpline

    time, values = _finite(other, name)
    if len(time) < 4:
        return np.full(len(wanted), np.nan)
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    apart = time[after] - time[after - 1] > APART * (other.dt or np.inf)
    outside = (wanted < time[0]) | (wanted > time[-1])
    between = apart & (wanted != time[after]) & (wanted != time[after - 1])
    return np.where(between | outside, np.nan, CubicSpline(time, values)(wanted))
