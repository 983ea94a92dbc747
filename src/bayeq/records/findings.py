"""Checks of a record for errors of measurement before inference.

Channels that should be a motion and its derivatives are compared with each other (`records.consistency`); clipped,
dropped and repeated samples are looked for in each. Nothing is changed: `records.repair` does that on request.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import in_digits
from bayeq.numerics.distributions import t_quantile
from bayeq.numerics.settings import RECORDS
from bayeq.records.consistency import Frames, Relation, derivative_name, goes_with, relate, shift_of, uniform_frames
from bayeq.records.names import in_si, parse_unit, stated_gain
from bayeq.records.record import Record
from bayeq.records.repair import counts_rows
from bayeq.records.validate import even_times

# Gains that mistaken units cause, and the tolerance of a measured gain [ln].
UNIT_GAINS = (
    (9.80665, "the factor between g and m/s^2"),
    (1000.0, "the factor between milli-units and units"),
    (2.0 * math.pi, "2 pi, the factor between cycles and radians"),
    (180.0 / math.pi, "180/pi, the factor between radians and degrees"),
)
NEAR = 0.02

# Channels may be exchanged if their gain is off the units by EXCHANGED [ln], and by at most AS_STATED when swapped.
EXCHANGED, AS_STATED = math.log(2.0), math.log(1.1)

# Clipping: LEAST_RUN equal samples in a row at an extreme, and either no other level repeats, or the extreme has at
# least LEAST_CLIPPED samples and TIMES_NEXT times those of each of the NEXT_LEVELS next levels. Or it comes to an
# extreme LEAST_RUN times or more, with TIMES_NEXT times the samples of any of these levels: the greatest level of a
# sine has 2.4 times those of the next. Levels that differ by less than SAME_LEVEL of the greatest are one. A channel of
# fewer than LEAST_LEVELS levels, or at its extreme for a share MOST_AT_REST of the rows, counts as switched.
LEAST_RUN = 3
LEAST_CLIPPED = 10
TIMES_NEXT = 5
NEXT_LEVELS = 5
LEAST_LEVELS = 20
MOST_AT_REST = 0.5
SAME_LEVEL = 1e-9  # far below a level of 24 bits, far above float rounding

# Dropped samples: time steps within NEAR_MULTIPLE median steps of a multiple. Repeated samples: at least LEAST_REPEATS
# places, if half the median change is LEVELS_PER_STEP levels; beyond a share MOST_REPEATED values are held on purpose.
NEAR_MULTIPLE = 0.1
LEAST_REPEATS = 3
LEVELS_PER_STEP = 8.0
MOST_REPEATED = 0.3

# Interpolation: second differences up to STRAIGHT of the largest, or ROUNDED levels, count as straight. Needed are at
# least LEAST_BENDS evenly spaced bends, of unequal size and BENT times that limit, in less than MOST_BENT of the rows.
STRAIGHT, ROUNDED, LEAST_BENDS, MOST_BENT, BENT = 1e-3, 2.01, 20, 0.6, 10.0

# Time without a unit may be in ms if its step is at least this [s], and a period of motion has fewer rows than this.
LEAST_STEP = 0.5
MOST_ROWS_A_PERIOD = 200.0

# Minimum number of consecutive rows for a repeated stretch.
LEAST_AGAIN = 20

# Minimum number of rows for the checks of samples.
LEAST_ROWS_TO_CHECK = 20

# A mean acceleration is an offset if its change of velocity exceeds this many ranges of the velocity without trend; in
# a bounded motion that change is at most the range of the velocity, twice that without trend.
MOVED_OFF = 3.0


@dataclass(frozen=True, slots=True)
class Finding:
    """An error of measurement in a record that would disturb inference.

    Attributes
    ----------
    kind : str
        ``"offset"``, ``"drift"``, ``"delay"``, ``"sign"``, ``"gain"``, ``"exchanged"``, ``"inconsistent"``,
        ``"clipping"``, ``"dropped"``, ``"repeated"``, ``"interpolated"``, ``"again"`` or ``"clock"``.
    channels : tuple of str
        The channel that is at fault, then those that it was compared with.
    message : str
        A sentence that names channel and number.
    value : float
        The offset [unit of the channel], drift [unit per s], delay [s], sign (-1), gain, fit (0 to 1), level of
        clipping, number of samples, or for ``"clock"`` the rate [Hz] or the time step [s].
    """

    kind: str
    channels: tuple[str, ...]
    message: str
    value: float


def check_record(
    record: Record, chains: Sequence[str | Sequence[str | None]], inputs: Sequence[str] = ()
) -> list[Finding]:
    """Check the channels of a record against each other and for lost samples.

    Parameters
    ----------
    record : Record
        The record to check. Channels with NaN are skipped; where time is missing or uneven, channels are not compared
        with each other.
    chains : sequence of str or of sequences
        A coordinate and its derivatives each: ``"x:v:a"``, or the channels' names with None where a derivative is not
        measured.
    inputs : sequence of str
        Further channels, to be checked for lost samples.

    Returns
    -------
    list of Finding
        Empty if nothing was found.

    Raises
    ------
    UnknownNameError
        A channel that the record does not have.

    Examples
    --------
    >>> t = np.arange(2000) / 500
    >>> x, v = np.sin(9 * t) + np.sin(23 * t), 9 * np.cos(9 * t) + 23 * np.cos(23 * t)
    >>> noise = np.random.default_rng(0).normal(size=(2, 2000))
    >>> record = Record({"x": x + 0.01 * noise[0], "v": 0.2 - v + 0.1 * noise[1]}, time=t)
    >>> [(f.kind, f.channels[0], round(f.value, 1)) for f in check_record(record, ["x:v:"])]
    [('sign', 'v', -1.0), ('offset', 'v', 0.2)]
    """
    split = [[part or None for part in c.split(":")] if isinstance(c, str) else list(c) for c in chains]
    names = [name for chain in split for name in chain if name is not None]
    found = [*_dropped(record, names[0]), *(_clock(record, names[0]) if len(split[0]) > 2 else ())] if names else []
    whole = {name: bool(np.isfinite(record[name]).all()) for name in (*names, *inputs)}
    for chain in split:
        if len(chain) == 3 and chain[:2] == [None, None] and chain[2] is not None and whole[chain[2]]:
            found += _moved_off(record, chain[2])
        usable = [name if name and whole[name] else None for name in chain]
        found += _kinematics(record, usable, [name for name in inputs if whole[name]])
    complete = [name for name, one in whole.items() if one]
    for name in complete if record.n >= LEAST_ROWS_TO_CHECK else ():
        clipped = list(_clipped(name, record[name], shut=name in inputs))
        found += clipped or _repeated(name, record[name], shut=name in inputs)
        found += _interpolated(record, name, drives=name in inputs)
    return [*found, *_again(record, complete)]


def check_messages(
    records: Sequence[Record],
    chains: Sequence[Sequence[str | None]],
    inputs: Sequence[str] = (),
    stepping: Sequence[str] = (),
    drifting: bool = False,
    read: Sequence[Record] = (),
) -> list[str]:
    """One sentence for each kind of finding and channel, even if several records show it.

    Lost samples are those of the records as `read`, if given, before rows with samples that are not used were left out.
    A lead of half a sample is not reported for `stepping` channels, such as an acceleration under an input held between
    samples. With `drifting`, offsets and drifts are estimated later and not reported. Neither is an input at an
    extreme: an actuator may end there, and where it is clipped instead its samples are left out, and this is said.
    """
    found: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    several = len(records) > 1
    checked = [(record, one) for record in records for one in check_record(record, chains, inputs)]
    if read:
        first = next(name for chain in chains for name in chain if name is not None)
        lost = [(record, one) for record in read for one in _dropped(record, first)]
        checked = [*lost, *(pair for pair in checked if pair[1].kind != "dropped")]
    for record, finding in checked:
        where = f"{record.name or 'a record'}: " if several else ""
        late = finding.value / (record.dt or 1.0) if finding.kind == "delay" else 0.0
        if finding.channels[0] in stepping and abs(late + 0.5) < RECORDS.least_delay:
            continue
        shifted, message = finding.kind in ("offset", "drift"), finding.message
        if (shifted and drifting) or (finding.kind == "clipping" and finding.channels[0] in inputs):
            continue
        if shifted and several and record.fs is not None:  # offsets may differ between records
            band = f"{record.fs / record.n:.1g}:{in_digits(0.5 * record.fs, 3)}"
            message = f"{message.split(': use')[0]}: --band {band} learns what each record has"
        found.setdefault((finding.kind, finding.channels), []).append(where + message)
    return [
        first + (f" (and {len(others)} more records alike)" if others and several else "")
        for first, *others in found.values()
    ]


def without_copies(records: Sequence[Record], names: Sequence[str]) -> tuple[list[Record], list[str]]:
    """The records without copies (samples of `names` equal to those of an earlier record), and a message per copy."""
    first: dict[tuple[bytes, ...], str] = {}
    kept, messages = list[Record](), list[str]()
    for k, record in enumerate(records, start=1):
        name = record.name or f"record {k}"
        other = first.setdefault(tuple(np.asarray(record[one]).tobytes() for one in names), name)
        if len(first) > len(kept):
            kept.append(record)
        else:
            messages.append(f"{name} has the same samples as {other}: left out")
    return kept, messages


# --- channels against each other -------------------------------------------------------------------------------------


def _kinematics(record: Record, chain: Sequence[str | None], inputs: Sequence[str]) -> list[Finding]:
    """Findings on exchanged channels, signs, gains, delays, offsets and drifts of a chain."""
    measured = [(order, name) for order, name in enumerate(chain) if name is not None]
    frames = uniform_frames(record.time) if len(measured) > 1 else None
    if frames is None:
        return []
    links: list[Relation] = []
    for (low, p), (high, q) in pairwise(measured):
        moves = np.ptp(record[p]) > 0.0 and np.ptp(record[q]) > 0.0
        link = relate(record[p], record[q], high - low, frames) if moves else None
        if link is None:
            return []
        exchanged = list(_exchanged(record, p, q, high - low, link, frames))
        if exchanged:
            return exchanged
        if link.fit < RECORDS.least_fit:
            message = (
                f"{q} moves with {derivative_name(p, high - low)} but does not equal it, {100 * link.fit:.0f} % fit;"
                " check which channel is which"
            )
            return [Finding("inconsistent", (q, p), message, link.fit)]
        links.append(link)
    found = [*_signs(record, measured, links, frames.dt, inputs), *_gains(record, measured, links)]
    found += _delays(measured, links, frames.dt)
    for ((low, p), (high, q)), link in zip(pairwise(measured), links, strict=True):
        found += _shifts(record, p, q, high - low, link, frames)
    return found


def _exchanged(record: Record, p: str, q: str, order: int, link: Relation, frames: Frames) -> Iterator[Finding]:
    """A finding if p fits as the derivative of q, with their units exchanged, and q does not fit as that of p."""
    stated = stated_gain(record.units, p, q, order) or 1.0
    as_said = link.fit >= RECORDS.least_fit and abs(math.log(link.gain / stated)) < EXCHANGED
    if as_said or counts_rows(record):
        return
    back = relate(record[q], record[p], order, frames)
    if back is None or back.fit < RECORDS.least_fit or back.sign < 0 or abs(math.log(back.gain / stated)) > AS_STATED:
        return
    if back.least_gain * link.most_gain < link.least_gain * back.most_gain:  # the swapped gain is less certain
        return
    what = f"the {'second ' * (order == 2)}derivative of {q}"
    message = f"{p} is {in_digits(back.gain, 3)} times {what}: are the columns exchanged?"
    yield Finding("exchanged", (p, q), message, back.gain)


class _Odd(NamedTuple):
    """A channel that disagrees with the majority of its chain, a reference channel of the majority, the difference."""

    k: int
    other: int
    channels: tuple[str, str]
    against: str  # what the channel should be, in terms of the reference
    difference: float


def _odd_ones(
    measured: Sequence[tuple[int, str]],
    steps: Sequence[float],
    errors: Sequence[float],
    least: float,
    highest: bool = False,
) -> list[_Odd]:
    """Channels that disagree with the majority of their chain.

    `steps` are the differences of level (sign, log gain or delay) from each channel to the next, `errors` their
    uncertainties; differences up to `least` are ignored. Without a majority the lowest derivative is the reference,
    with `highest` the highest.
    """
    level = np.concatenate([[0.0], np.cumsum(steps)])
    doubt = np.concatenate([[0.0], np.cumsum(errors)])
    tolerance = np.maximum(least, np.abs(doubt[:, None] - doubt))
    agree = np.abs(level[:, None] - level) <= tolerance
    other = int(np.argmax(agree.sum(axis=1) + 0.1 * highest * np.arange(len(level))))
    reference, name = measured[other]
    found = []
    for k in np.flatnonzero(~agree[other]).tolist():
        order = measured[k][0] - reference
        times = {-1: "", -2: "double ", -3: "triple "}.get(order, f"{-order}-fold ")
        against = derivative_name(name, order) if order > 0 else f"the {times}integral of {name}"
        found.append(_Odd(k, other, (measured[k][1], name), against, float(level[k] - level[other])))
    return found


def _signs(
    record: Record, measured: Sequence[tuple[int, str]], links: Sequence[Relation], dt: float, inputs: Sequence[str]
) -> Iterator[Finding]:
    signs = np.cumprod([1, *(link.sign for link in links)])
    si = [in_si(parse_unit(record.units.get(name, ""))) for name in inputs]
    by_force = len(inputs) == 1 and not (si[0] and {"m", "s"} <= set(si[0][1]))  # base motion is no force
    highest = len(links) == 1 and links[0].sign < 0 and by_force
    if highest:
        (low, p), (high, q) = measured
        highest = goes_with(dt, (low, high), record[p], record[q], record[inputs[0]])
    for odd in _odd_ones(measured, np.diff(signs).tolist(), [0.0] * len(links), 0.0, highest):
        name = odd.channels[0]
        message = f"{name} has the opposite sign of {odd.against}: reverse it (--scale {name}=-1)"
        yield Finding("sign", odd.channels, message, -1.0)


def _gains(record: Record, measured: Sequence[tuple[int, str]], links: Sequence[Relation]) -> Iterator[Finding]:
    # gains implied by the units: with x in mm, v in m/s is a thousandth of dx/dt
    (lowest, first), known = measured[0], [1.0]
    for (low, p), (high, q) in pairwise(measured):
        # a channel between them may have no unit
        beside = stated_gain(record.units, p, q, high - low) or 1.0
        known.append(stated_gain(record.units, first, q, high - lowest) or known[-1] * beside)
    stated = [after / before for before, after in pairwise(known)]
    if counts_rows(record):
        (low, p), (high, q) = measured[:2]
        rate = (links[0].gain / stated[0]) ** (1.0 / (high - low))
        message = f"{p} and {q} go together at {rate:.4g} samples per second, if their units are right: give the rate"
        yield Finding("gain", (q, p), message, links[0].gain)
        return
    steps = [math.log(link.gain / expected) for link, expected in zip(links, stated, strict=True)]
    errors = [_undecided(link) for link in links]
    # a wrong sampling rate scales the first derivative by a factor, the second by its square
    per_order = [step / (high - low) for step, ((low, _), (high, _)) in zip(steps, pairwise(measured), strict=True)]
    off, least = float(np.mean(per_order)), max(math.log(RECORDS.least_gain), 2.0 * max(errors))
    if len(steps) > 1 and abs(off) > least and np.ptp(per_order) < NEAR:
        names = " and ".join(name for _, name in measured[1:])
        rate = (record.fs or 1.0) * math.exp(off)
        message = f"{names} are derivatives of {measured[0][1]} at {rate:.4g} rows per second: check the rate"
        yield Finding("clock", tuple(name for _, name in measured), message, rate)
        return
    for odd in _odd_ones(measured, steps, errors, math.log(RECORDS.least_gain)):
        expected = math.prod(stated[: odd.k]) / math.prod(stated[: odd.other])
        gain = math.exp(odd.difference) * expected
        by_unit = "" if expected == 1.0 else f", by units {expected:.4g}"
        of_units = (meaning for factor, meaning in UNIT_GAINS if abs(abs(odd.difference) - math.log(factor)) < NEAR)
        mistake = next(of_units, None)
        hint = f"that is about {mistake}; check its unit" if mistake else "check calibration, unit and filter"
        message = f"{odd.channels[0]} is {gain:.4g} times {odd.against}{by_unit}: {hint}"
        yield Finding("gain", odd.channels, message, gain)


def _undecided(link: Relation) -> float:
    """Uncertainty of ln gain: its sampling error, plus half the range between regressions on p and on q."""
    return RECORDS.significant * link.gain_error + 0.5 * math.log(link.most_gain / link.least_gain)


def _delays(measured: Sequence[tuple[int, str]], links: Sequence[Relation], dt: float) -> Iterator[Finding]:
    steps, errors = [link.delay for link in links], [RECORDS.significant * link.delay_error for link in links]
    for odd in _odd_ones(measured, steps, errors, RECORDS.least_delay * dt):
        name, delay = odd.channels[0], odd.difference
        rows = f"{in_digits(abs(delay) / dt)} rows"
        message = (
            f"{name} {'lags behind' if delay > 0 else 'is ahead of'} {odd.against} by {rows}:"
            f" use --lag-sd, or bayeq.correct_delay(record, {name!r}, {delay:.3g})"
        )
        yield Finding("delay", odd.channels, message, delay)


def _shifts(record: Record, p: str, q: str, order: int, link: Relation, frames: Frames) -> Iterator[Finding]:
    """Offset and drift of q against the derivative of p, with the stated gain if the measured one agrees with it."""
    stated = stated_gain(record.units, p, q, order) or 1.0
    if abs(math.log(link.gain / stated)) <= max(math.log(RECORDS.least_gain), _undecided(link)):
        gain, gain_error = stated, 0.0
    else:
        gain, gain_error = link.gain, link.gain * _undecided(link) / RECORDS.significant
    shift = shift_of(record[p], record[q], order, frames, link.sign * gain, gain_error)
    spread, span = float(np.std(record[q])), float(frames.time[-1] - frames.time[0])
    unit = f" {record.units[q]}" if q in record.units else ""
    what = derivative_name(p, order)
    significant = t_quantile(shift.freedom, RECORDS.significant)
    if abs(shift.offset_t) > significant and abs(shift.offset) > RECORDS.least_offset * spread:
        much = f"{in_digits(shift.offset, 3)}{unit} ({in_digits(100.0 * abs(shift.offset) / spread)} %)"
        message = f"{q} is off {what} by {much}: use --remove-offset {q}={shift.offset:.4g}"
        yield Finding("offset", (q, p), message, shift.offset)
    if abs(shift.drift_t) > significant and abs(shift.drift) * span > 2.0 * RECORDS.least_offset * spread:
        message = (
            f"{q} drifts by {in_digits(shift.drift * span, 3)}{unit}:"
            f" use bayeq.remove_offset(record, {q!r}, {shift.offset:.3g}, drift={shift.drift:.3g})"
        )
        yield Finding("drift", (q, p), message, shift.drift)


def _moved_off(record: Record, name: str) -> Iterator[Finding]:
    """A finding if the mean of an acceleration changes the velocity by far more than the rest of the signal does."""
    values, step, mean = record[name], record.dt, float(record[name].mean())
    if step is None or record.n < LEAST_ROWS_TO_CHECK:
        return
    swing = float(np.ptp(np.cumsum(values - mean))) * step
    if not abs(mean) * record.n * step > MOVED_OFF * swing:
        return
    off = f"{name} has a mean of {in_digits(mean, 3)}"
    message = f"{off}: unless it moves away with it, take it out (--remove-offset {name})"
    yield Finding("offset", (name,), message, mean)


# --- samples ---------------------------------------------------------------------------------------------------------


def _dropped(record: Record, name: str) -> Iterator[Finding]:
    """Steps of time that are whole multiples of the usual one."""
    if record.time is None or record.n < LEAST_ROWS_TO_CHECK:
        return
    steps = np.diff(even_times(record.time))
    ratio = steps / np.median(steps)
    whole = np.round(ratio)
    gaps = whole >= 2
    even = bool((np.abs(ratio - whole) <= NEAR_MULTIPLE).all())
    if not (even and gaps.any() and np.count_nonzero(whole == 1) >= 0.5 * len(steps)):
        return
    missing = int(whole[gaps].sum() - gaps.sum())
    first = int(np.flatnonzero(gaps)[0])
    message = (
        f"{missing} sample{'s are' if missing > 1 else ' is'} missing: {int(gaps.sum())} of {len(steps)} steps are"
        f" multiples of {np.median(steps):.4g} s, first after row {first + 1}; check the logger"
    )
    yield Finding("dropped", (name,), message, float(missing))


def _clock(record: Record, name: str) -> Iterator[Finding]:
    """A finding if time without a unit may be in ms: long steps, but few rows per period of the motion."""
    step, values = record.dt, record[name]
    if step is None or step < LEAST_STEP or "t" in record.units or not np.isfinite(values).all():
        return
    values = values / (float(np.abs(values).max()) or 1.0)  # squares of huge numbers are infinite
    spread, steps = float(np.std(values)), float(np.std(np.diff(values)))
    rows = 2.0 * math.pi * spread / steps if steps > 0.0 else math.inf
    if not rows < MOST_ROWS_A_PERIOD:
        return
    period = f"{in_digits(rows * step)} s"
    message = f"{name} has about {period} a period: if time is in ms, write it into its header, or --units COLUMN=ms"
    yield Finding("clock", (name,), message, step)


def _again(record: Record, names: Sequence[str]) -> Iterator[Finding]:
    """A finding on the longest stretch of rows that repeats earlier rows of the record."""
    if not names or record.n < 2 * LEAST_AGAIN:
        return
    _, first, of_row = np.unique(record[names[0]], return_index=True, return_inverse=True)
    earlier = first[of_row]
    same = np.all([record[name] == record[name][earlier] for name in names], axis=0)
    # in a constant stretch the lag grows from row to row, so that it is no run
    lag = np.where(same, np.arange(record.n) - earlier, 0)
    starts, lengths = equal_runs(lag.astype(np.float64))
    lengths = np.where(lag[starts] > 0, lengths, 0)
    longest = int(np.argmax(lengths))
    if lengths[longest] < LEAST_AGAIN:
        return
    a, b = int(starts[longest]), int(starts[longest] + lengths[longest])
    shift = int(lag[a])
    message = (
        f"rows {a + 1} to {b} have the same samples as rows {a - shift + 1} to {b - shift}: leave them out (--rows)"
    )
    yield Finding("again", tuple(names), message, float(b - a))


def equal_runs(values: Floats | Bools) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First rows and lengths of runs of equal consecutive samples."""
    starts = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
    return starts, np.diff(np.append(starts, len(values)))


class Clipping(NamedTuple):
    """An extreme at which a channel is clipped."""

    which: str  # greatest or least
    level: float
    samples: int  # number of samples at that level
    longest: int  # most of them in a row


def clipped_levels(values: Floats, shut: bool = False) -> list[Clipping]:
    """Extremes at which a channel is clipped; with `shut`, for an input such as a valve, not at 0."""
    values = values[np.isfinite(values)]
    if not len(values):
        return []
    starts, lengths = equal_runs(values)
    at_extremes = np.isin(values[starts], (values.min(), values.max()))
    # true of most channels, and saves sorting them
    if np.count_nonzero(at_extremes) < LEAST_RUN and not (lengths[at_extremes] >= LEAST_RUN).any():
        return []
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) < LEAST_LEVELS:
        return []
    unlike = bool((counts[1:-1] == 1).all())
    symmetric = levels[0] == -levels[-1] and _often(np.abs(values))
    found = []
    for which, beyond, near in (
        ("greatest", values >= levels[-1 - NEXT_LEVELS], counts[-1 - NEXT_LEVELS : -1]),
        ("least", values <= levels[NEXT_LEVELS], counts[1 : 1 + NEXT_LEVELS]),
    ):
        # rest at an extreme at the start or the end of a record is not clipping
        moving = np.flatnonzero(~beyond)
        inner = values[moving[0] : moving[-1] + 1]
        level, beside = (levels[-1], levels[-2]) if which == "greatest" else (levels[0], levels[1])
        # a level as far from all others as -999 is a code for samples that are missing
        if (shut and level == 0.0) or abs(level - beside) > levels[-2] - levels[1]:
            continue
        starts, lengths = equal_runs(inner)
        lengths = lengths[inner[starts] == level]
        count, longest = int(lengths.sum()), int(lengths.max(initial=0))
        beyond_chance = unlike or count >= max(LEAST_CLIPPED, TIMES_NEXT * int(near.max()))
        long = longest >= LEAST_RUN and beyond_chance
        often = symmetric or _often(values if which == "greatest" else -values)
        if (long or often) and 0 < count < MOST_AT_REST * len(inner):
            found.append(Clipping(which, float(level), count, longest))
    return found


def _often(values: Floats) -> bool:
    """Whether the greatest level has far more samples than the next ones, in several places."""
    greatest = float(values.max())
    size = max(abs(greatest), abs(float(values.min()))) * SAME_LEVEL or 1.0
    _, counts = np.unique(np.round(values / size), return_counts=True)
    visits = np.count_nonzero(values[equal_runs(values)[0]] == greatest)
    many = np.count_nonzero(values == greatest) >= TIMES_NEXT * counts[-1 - NEXT_LEVELS : -1].max(initial=1)
    return bool(many and visits >= LEAST_RUN)


def _clipped(name: str, values: Floats, shut: bool) -> Iterator[Finding]:
    for one in clipped_levels(values, shut):
        at = f"{one.samples:d} samples at its {one.which} value {one.level:.4g}, {one.longest:d} in a row"
        message = f"{name} is {'limited or ' * shut}clipped: {at}; use a wider range"
        yield Finding("clipping", (name,), message, one.level)


def _repeated(name: str, values: Floats, shut: bool) -> Iterator[Finding]:
    """A finding if samples repeat the previous one in motion; with `shut`, for an input such as a valve, not zeros."""
    steps = np.abs(np.diff(values))
    if np.count_nonzero(steps == 0.0) > MOST_REPEATED * len(steps) or not steps.any():
        return
    # a coarsely quantised channel repeats values at turning points: its usual steps must be many levels
    level = float(steps[steps > 0.0].min())
    moving = 0.5 * float(np.median(steps))
    if moving < LEVELS_PER_STEP * level:
        return
    starts, lengths = equal_runs(values)
    inner = (lengths > 1) & (starts > 0) & (starts + lengths < len(values)) & ~(shut & (values[starts] == 0.0))
    starts, lengths = starts[inner], lengths[inner]
    sudden = (steps[starts - 1] > moving) & (steps[starts + lengths - 1] > moving)
    # zero steps expected by quantisation alone: the mean count of steps of +k or -k levels, k up to NEXT_LEVELS
    small = (steps > 0.0) & (steps <= (NEXT_LEVELS + 0.5) * level)
    chance = np.count_nonzero(small[1:-1] & (steps[:-2] > moving) & (steps[2:] > moving)) / (2 * NEXT_LEVELS)
    if np.count_nonzero(sudden) < LEAST_REPEATS + chance + 5.0 * math.sqrt(chance):
        return
    count = int(np.sum(lengths[sudden] - 1))
    message = (
        f"{name} repeats its last value {count} times in motion, first in row {int(starts[sudden][0]) + 2}:"
        " samples were lost; leave them out"
    )
    yield Finding("repeated", (name,), message, float(count))


def _interpolated(record: Record, name: str, drives: bool) -> Iterator[Finding]:
    """A finding if a channel was interpolated: straight lines between evenly spaced bends of unequal size. One that
    `drives` the motion may have had that course."""
    values = record[name]
    bends = np.diff(values, 2)
    largest = float(np.abs(bends).max())
    if np.count_nonzero(np.abs(bends) > largest / BENT) >= MOST_BENT * len(bends) or not largest > 0.0:
        return  # most channels
    if not record.is_uniform():
        return
    straight = max(STRAIGHT * largest, ROUNDED * float(np.diff(np.unique(values)).min()))
    rows = np.flatnonzero(np.abs(bends) > straight)
    if not len(rows) < MOST_BENT * len(bends):
        return
    # a bend between two rows shows in the second differences of both
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    if len(groups) < LEAST_BENDS or max(map(len, groups)) > 2:
        return
    sizes, places = np.abs([bends[g].sum() for g in groups]), np.array([g.mean() for g in groups])
    if float(np.median(sizes)) < BENT * straight or float(np.std(sizes)) < 0.1 * float(sizes.mean()):
        return
    numbers = np.append(0.0, np.cumsum(np.round(np.diff(places) / np.median(np.diff(places)))))
    every, first = np.polyfit(numbers, places, 1)
    if float(np.abs(places - first - every * numbers).max()) > 1.0:
        return
    rate = "" if record.fs is None else f" from {record.fs / every:.4g} Hz"
    what = f"{name} is straight over every {in_digits(every, 3)} samples"
    said = f"if it was interpolated{rate}, give" if drives else f"it was interpolated{rate}; give"
    message = f"{what}: {said} the samples as measured"
    yield Finding("interpolated", (name,), message, float(every))
