"""Checks of a record: names that terms can use, numbers in one dimension, increasing time, and even steps."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.errors import DataWarning, RecordError, UnknownNameError, require_mapping
from bayeq.expressions.parse import EARLIER
from bayeq.numerics.settings import RECORDS
from bayeq.records.names import clean_name


def as_column(values: Any, what: str, where: str) -> Floats:
    """A float64 array of one dimension, or a RecordError that says what is wrong with it."""
    try:
        array = without_mask(values)
    except ValueError as error:  # nested lists of unequal lengths
        raise RecordError(f"{where}: {what} is not an array of numbers: {error}") from None
    if array.dtype.kind == "c":
        raise RecordError(f"{where}: {what} is complex; give its real and imaginary parts as two channels")
    if array.dtype.kind not in "biuf":
        raise RecordError(f"{where}: {what} does not hold numbers (dtype {array.dtype})")
    if array.ndim != 1:
        raise RecordError(f"{where}: {what} has shape {array.shape}; give one array of one dimension per channel")
    return array.astype(np.float64, copy=False)


def without_mask(values: Any) -> NDArray[Any]:
    """An array, NaN where masked; numpy.ma, which is slow to import, is only used for subclasses of ndarray."""
    masked = type(values) is not np.ndarray and isinstance(values, np.ndarray) and np.ma.isMaskedArray(values)
    return np.ma.filled(values.astype(float), np.nan) if masked else np.asarray(values)


def as_time(values: Any, where: str) -> Floats:
    """Time as float64; dates and durations become seconds since the first."""
    array = np.asarray(values)
    if array.dtype.kind in "mM" and array.ndim == 1 and array.size:
        missing = np.isnat(array)
        seconds: Floats = (array - array[0]) / np.timedelta64(1, "s")
        return np.where(missing, np.nan, seconds)
    return as_column(array, "time", where)


#: At most one in this many rows may repeat a time.
MOST_REPEATED = 10


def check_time(
    time: Floats, where: str, starts: NDArray[np.intp] | None = None, repeated: bool = False
) -> NDArray[np.intp]:
    """Raise a RecordError, with the row counted from 1, unless time [s] is finite and strictly increasing.

    Time may start over at `starts`, the first rows of trials; `where` is put in front of the message. With `repeated`
    up to a tenth of the rows may repeat the time of the previous row; returns these rows, counted from 0.
    """
    bad = np.flatnonzero(~np.isfinite(time))
    if bad.size:
        value = "missing (NaN)" if np.isnan(time[bad[0]]) else "infinite"
        raise RecordError(
            f"{where}: time is {value} in row {bad[0] + 1} "
            f"({bad.size} such row{'s' * (bad.size > 1)}); leave these rows out"
        )
    falls = time[1:] <= time[:-1]
    if starts is not None:
        falls[starts[starts > 0] - 1] = False
    again = np.flatnonzero(falls & (time[1:] == time[:-1])) + 1
    if repeated and again.size <= len(time) // MOST_REPEATED:
        falls[again - 1] = False
    rows = np.flatnonzero(falls)
    if not rows.size:
        return again
    if again.size > max(1, len(time) // MOST_REPEATED):
        every = again.size == len(time) - 1
        what = f"all {len(time)} times are {float(time[0])!r}" if every else f"{again.size} rows repeat the time before"
        raise RecordError(
            f"{where}: {what}: the clock is too coarse; give the sampling rate instead (--fs, fs=), or name"
            " another column as time (--time, time=)"
        )
    row = int(rows[0])
    before, after = float(time[row]), float(time[row + 1])
    message = f"{where}: time must increase strictly, but goes from {before!r} to {after!r} in row {row + 2}"
    if after < before and row > 0 and after - time[0] <= 0.1 * (before - time[0]):
        message += "; it restarts there: if the rows are several trials, name the column that counts them (--group)"
    elif after == before:
        message += "; leave out the repeated row"
    else:
        message += "; sort the rows by time, or name another column as time"
    raise RecordError(message)


# Time steps within this share of the mean are even: at 6 samples per period the error is 0.1 % of the amplitude.
EVEN = 1e-3


def is_step(time: Floats, step: float, tolerance: float = EVEN) -> Bools:
    """Mask (n - 1,) of the time steps equal to `step` within a share `tolerance` plus the rounding of the times."""
    rounding = 4.0 * float(np.finfo(np.float64).eps) * float(np.abs(time).max(initial=0.0))
    return np.asarray(np.abs(np.diff(time) - step) <= tolerance * step + rounding)


def even_step(*times: Floats) -> float | None:
    """The mean step if all records are evenly sampled with the same step; None if not, or if there is no step.

    >>> even_step(np.array([0.0, 0.1, 0.2])), even_step(np.array([0.0, 0.1, 0.3]))
    (0.1, None)
    """
    count = sum(len(time) - 1 for time in times)
    if not count:
        return None
    # rounding of the times affects the mean step less than a single one
    step = sum(float(time[-1] - time[0]) for time in times) / count
    return step if all(is_step(time, step).all() for time in times) else None


# A step is regular if it is within ALIKE of the median. Times count as rounded if most steps are regular and the first
# LOOKED_AT regular steps take 2 to LEVELS values.
ALIKE, LOOKED_AT, LEVELS = 0.2, 1000, 3


# Times of an even grid may have been rounded by a clock to a unit that is a large part of a step. They are then off the
# grid by at most half a unit, ROUNDED_BY units with the error of the fitted grid, and their steps are in turn too short
# and too long, LEAST_TURNS times each: as many rows that miss at random would lie as evenly with a probability of
# 20!/20**20 = 2e-8. Steps that differ by less than a share SAME_STEP of a step are the same but for float rounding.
ROUNDED_BY, LEAST_TURNS, SAME_STEP = 0.6, 20, 1e-6


def even_times(time: Floats) -> Floats:
    """Times of an even grid, with or without gaps, that a coarse clock rounded, without the rounding; others unchanged.

    >>> np.diff(even_times(np.round(np.arange(200) / 800, 3)))[:3].round(6)
    array([0.00125, 0.00125, 0.00125])
    """
    steps = np.diff(time)
    if len(steps) < 2 * LEAST_TURNS or not ((steps > 0.0) & (steps < np.inf)).all():
        return time
    usual = float(np.median(steps))
    apart = np.diff(np.unique(np.append(0.0, steps[:LOOKED_AT])))
    unit = float(apart[apart > SAME_STEP * usual].min())
    if not 2.0 * RECORDS.jitter * usual < min(unit, float(np.ptp(steps))):
        return time  # a jitter that is allowed everywhere
    for index in (np.arange(len(time), dtype=np.float64), _numbered(time)):
        step, start = np.polyfit(index, time, 1)
        grid = start + step * index
        single = steps[np.diff(index) == 1.0] / step - 1.0
        turns = min(np.count_nonzero(single < -SAME_STEP), np.count_nonzero(single > SAME_STEP))
        near = np.abs(time - grid).max() <= ROUNDED_BY * unit and (np.diff(index) > 0.0).all()
        if near and turns >= LEAST_TURNS:
            return np.asarray(grid)
    return time


def _numbered(time: Floats) -> Floats:
    """Numbers of the samples on the even grid of the most even rows, extended by a quarter until the ends."""
    width = min(4 * LEAST_TURNS, len(time))
    rows, index = time[: len(time) // width * width].reshape(-1, width), np.arange(width, dtype=np.float64)
    off = rows.T - np.vander(index, 2) @ np.polyfit(index, rows.T, 1)
    first = width * int(np.argmin(np.abs(off).max(axis=0)))
    last = first + width
    while True:
        step, start = np.polyfit(index, time[first:last], 1)
        if last - first == len(time):
            return index
        more = (last - first) // 4
        first, last = max(first - more, 0), min(last + more, len(time))
        index = np.round((time[first:last] - start) / step)


def without_rounding(time: Floats, where: str) -> Floats:
    """Times without the rounding of a coarse clock (`even_times`); a DataWarning, if rows may be missing instead."""
    even = even_times(time)
    if even is not time:
        steps, step = np.diff(time), float(np.median(np.diff(even)))
        if round(float(steps[np.diff(even) < 1.5 * step].max() / steps.min()), 3) == 2.0:
            message = f"times are rounded; taken as even, {1.0 / step:.4g} Hz: give more digits if rows are missing"
            warnings.warn(f"{where}: {message}", DataWarning, stacklevel=5)
    return even


def usual_step(time: Floats) -> float:
    """The median time step; for rounded times the slope of a line fitted to times over step counts.

    >>> round(1 / usual_step(np.round(np.delete(np.arange(300), range(90, 99)) / 30, 3)), 4)
    30.0
    """
    steps = np.diff(even_times(time))
    median = float(np.median(steps))
    alike = steps[np.abs(steps - median) < ALIKE * median]
    levels = np.unique(np.round(alike[:LOOKED_AT] / (median or 1.0), 6))
    rounded = 1 < len(levels) <= LEVELS and len(alike) > len(steps) // 2
    if not rounded:
        return median
    counts = np.append(0.0, np.cumsum(np.round(steps / alike.mean())))
    return float(np.polyfit(counts, time, 1)[0])


#: Seconds per unit of time.
SECONDS: Mapping[str, float] = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "Sec": 1.0, "SEC": 1.0, "Second": 1.0, "Seconds": 1.0, "Sekunde": 1.0, "Sekunden": 1.0,
    "ms": 1e-3, "msec": 1e-3, "milliseconds": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9,
    "min": 60.0, "mins": 60.0, "minute": 60.0, "minutes": 60.0,
    "h": 3600.0, "hr": 3600.0, "hour": 3600.0, "hours": 3600.0,
    "d": 86400.0, "day": 86400.0, "days": 86400.0, "Tag": 86400.0, "Tage": 86400.0, "week": 604800.0, "weeks": 604800.0,
}  # fmt: skip


def other_step(values: Floats, unit: str, fs: float) -> float | None:
    """The median step [s] of a possible time column; None if it is not positive, agrees with `fs` to 1 %, or comes from
    a coarse clock, which repeats times.

    >>> ms = np.arange(5.0)
    >>> other_step(ms, "ms", 500.0), other_step(ms, "ms", 1000.0)
    (0.001, None)
    """
    with np.errstate(invalid="ignore"):  # of infinite times
        steps = np.diff(even_times(values))
        step = float(np.median(steps)) * SECONDS.get(unit, 1.0) if len(steps) else 0.0
    coarse = np.count_nonzero(steps == 0.0) > len(values) // MOST_REPEATED
    return step if step > 0.0 and not coarse and not 0.99 < fs * step < 1.01 else None


# Maximum step over midnight, in median steps.
_MOST_AT_MIDNIGHT = 10.0

# Excel's day numbers of 1970-01-01 and of the years 2000 to 2099, and words in the names of columns with dates.
EXCEL_1970 = 25_569.0
_DAYS = (36526.0, 73051.0)
_DATE_WORDS = ("date", "datum", "stamp", "stempel")


def in_seconds(time: Floats, unit: str | None, name: str) -> tuple[Floats, str | None, float | None]:
    """Time, in seconds if the unit is known, and its unit; dates count from the first one, the third result [s].

    Seconds since 1970 (or ms, us, ns) within the years 2001 to 2096 are dates, and so are Excel's day numbers in a
    column named like a date, unless the steps have few decimals, as those of seconds since midnight have.
    """
    begins = None
    if len(time) > 1:
        for own, factor in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
            if unit in (None, own) and np.all((time > 1e9 * factor) & (time < 4e9 * factor)):
                begins = float(time[0] * SECONDS[own])
                time, unit = time - time[0], own
                break
        dated = unit is None and any(word in name.casefold() for word in _DATE_WORDS)
        if dated and np.all((time > _DAYS[0]) & (time < _DAYS[1])):
            step = float(np.median(np.diff(time)))
            if abs(step - round(step, 5)) > 1e-3 * step:
                begins = float((time[0] - EXCEL_1970) * SECONDS["d"])
                time, unit = time - time[0], "d"
    if unit in (None, "s"):
        time = _beyond_midnight(time)
    if unit is None or unit not in SECONDS:
        return time, unit, begins
    factor = SECONDS[unit]
    # Dividing by 1000 rounds once; multiplying by 0.001, itself rounded, would round twice.
    return time * factor if factor >= 1 else time / round(1 / factor), "s", begins


def _beyond_midnight(time: Floats) -> Floats:
    """Seconds of the day, continued past midnight; other times are unchanged."""
    steps, day = np.diff(time), SECONDS["d"]
    back = steps < 0.0
    if not back.any() or not np.ptp(time) < day:
        return time
    onward = steps[back] + day
    if not np.all((onward > 0.0) & (onward <= _MOST_AT_MIDNIGHT * np.median(steps))):
        return time
    return time + np.append(0.0, np.cumsum(np.where(back, day, 0.0)))


def check_name(name: object, where: str) -> None:
    """Raise a RecordError for a channel name that terms cannot use, suggesting one that they can."""
    if not isinstance(name, str):
        raise RecordError(f"{where}: a channel's name must be text, not {name!r}")
    cleaned = clean_name(name)[0]
    if cleaned != name and not EARLIER.fullmatch(name):
        raise RecordError(f"{where}: {name!r} cannot name a channel in a term; call it {cleaned!r}, say")


def checked_units(units: Mapping[str, str], names: Iterable[str], has_time: bool, where: str) -> dict[str, str]:
    """Units, checked to belong to existing channels and to be text that fits in a header."""
    require_mapping(units, f"{where}: units")
    names = list(names)
    known = [*names, "t"] if has_time and "t" not in names else names
    checked = {}
    for name, unit in units.items():
        if name not in known:
            raise UnknownNameError("channel", str(name), known, f"{where}: units")
        if not isinstance(unit, str):
            raise RecordError(f"{where}: the unit of {name!r} must be text, not {unit!r}")
        bad = next((c for c in unit if c in "[]" or not c.isprintable()), None)
        if bad is not None:
            what = "square brackets" if bad in "[]" else f"the character {bad!r}"
            raise RecordError(
                f"{where}: the unit of {name!r}, {unit!r}, cannot be written in a header: leave out {what}"
            )
        if text := " ".join(unit.split()):
            checked[name] = text
    if "t" in checked and "t" not in names and checked["t"] in SECONDS:
        factor = SECONDS[checked["t"]]
        if factor != 1.0:
            raise RecordError(f"{where}: time is kept in seconds, not {checked['t']}; multiply it by {factor:g}")
        checked["t"] = "s"
    return checked


def trial_starts(labels: Any, n: int, where: str) -> list[int]:
    """The first row of each run of equal labels."""
    labels = np.asarray(labels)
    if labels.shape != (n,):
        raise RecordError(f"{where}: the group has shape {labels.shape}; it needs one label for each of {n} rows")
    if labels.dtype.kind == "f" and np.isnan(labels).any():
        row = int(np.flatnonzero(np.isnan(labels))[0])
        raise RecordError(
            f"{where}: the group is missing (NaN) in row {row + 1}; give every row the number of its trial, or"
            " leave such rows out"
        )
    return [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1).tolist()]


def time_from(channels: Mapping[str, Any], time: Any, fs: float | None, where: str) -> Any:
    """Sampling times: `time` as it is, or ``arange(n) / fs``, or None."""
    if fs is None:
        return time if time is None else without_rounding(as_time(time, where), where)
    if time is not None:
        raise RecordError(f"{where}: time and fs are both given; give one of them")
    if not (isinstance(fs, (int, float, np.number)) and 0 < fs <= sys.float_info.max):
        raise RecordError(f"{where}: the sampling rate fs must be positive and finite, not {str(fs)[:40]}")
    n = max((len(np.atleast_1d(values)) for values in channels.values()), default=0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        seconds = np.arange(n) / float(fs)
    if n > 1 and not (np.isfinite(seconds[-1]) and seconds[1] > 0):
        raise RecordError(f"{where}: a sampling rate of {fs!r} Hz is out of range for {n} rows")
    return seconds
