"""``join``: channels of two recorders on the time of one."""

from __future__ import annotations

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import RecordError, require_kind
from bayeq.records.record import Record

#: Sampling rates that differ by less than this share are the same.
SAME_RATE = 0.01
#: A channel with more than this share of its variance above half the first record's rate would alias.
ALIASED = 0.01
#: Steps of time that are longer than this number of the usual ones are gaps.
GAP = 1.5


def join(first: Record, *others: Record) -> Record:
    """Join the channels of several records on the time of the first.

    The rows are those of `first` within the span that all records have in common. Channels of the others are read off
    cubic splines through their samples, which pass through every sample that has the same time; where a sample beside
    a row is missing, the row is NaN. The clocks are taken to agree: a delay between them stays.

    Parameters
    ----------
    first : Record
        The record whose time is kept: the one that is sampled most slowly.
    *others : Record
        Records with other channels.

    Returns
    -------
    Record
        Channels of all records.

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
    times = [_time(record) for record in (first, *others)]
    start, stop = max(t[0] for t in times), min(t[-1] for t in times)
    rows = (times[0] >= start) & (times[0] <= stop)
    if rows.sum() < 2:
        spans = "; ".join(f"{_label(r)} {t[0]:g} to {t[-1]:g} s" for r, t in zip((first, *others), times, strict=True))
        raise RecordError(f"records without time in common: {spans}")
    joined = first.take(rows)
    for other in others:
        twice = [name for name in other.names if name in joined]
        if twice:
            raise RecordError(
                f"{_label(other)}: a channel {twice[0]!r} is in another record too; rename or leave out one"
            )
        _check_rates(first, other)
        channels = {name: _at(times[0][rows], other, name) for name in other.names}
        joined = joined.with_channels(
            channels, {name: other.units[name] for name in other.names if name in other.units}
        )
    return joined.renamed(" + ".join(record.name for record in (first, *others) if record.name))


def _label(record: Record) -> str:
    return record.name or "record"


def _time(record: Record) -> Floats:
    require_kind(record, Record, "each of what is joined", "a Record")
    if record.time is None or record.n < 4:
        what = "has no time" if record.time is None else f"has {record.n} rows, too few for a spline"
        raise RecordError(f"{_label(record)} {what}; it cannot be joined")
    return record.time


def _check_rates(first: Record, other: Record) -> None:
    """Refuse a record that is slower, and channels of a faster one that would alias."""
    slow, fast = first.dt or 1.0, other.dt or 1.0
    if fast > (1 + SAME_RATE) * slow:
        raise RecordError(
            f"{_label(other)} is sampled at {1 / fast:g} Hz, more slowly than {_label(first)} at {1 / slow:g} Hz; put"
            " the slowest first, whose time is kept"
        )
    if fast > (1 - SAME_RATE) * slow:
        return
    for name in other.names:
        share = _share_above(other, name, 0.5 / slow)
        if share > ALIASED:
            raise RecordError(
                f"{_label(other)}: {100 * share:.2g} % of the variance of {name!r} is above {0.5 / slow:g} Hz, half the"
                f" rate of {_label(first)}, and would alias; low-pass it first"
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
    """A channel at the times that are wanted; NaN where the samples beside a row are missing."""
    from scipy.interpolate import CubicSpline

    time, values = _finite(other, name)
    if len(time) < 4:
        return np.full(len(wanted), np.nan)
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    apart = time[after] - time[after - 1] > GAP * (other.dt or np.inf)
    outside = (wanted < time[0]) | (wanted > time[-1])
    between = apart & (wanted != time[after]) & (wanted != time[after - 1])
    return np.where(between | outside, np.nan, CubicSpline(time, values)(wanted))
