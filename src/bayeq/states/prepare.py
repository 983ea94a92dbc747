"""Records prepared for all stages: without bad samples, on a uniform grid, missing samples bridged or left as gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError, RecordError, in_digits
from bayeq.expressions.parse import EARLIER
from bayeq.numerics.settings import RECORDS, STATES
from bayeq.records import Record, correct_delay
from bayeq.records.findings import equal_runs
from bayeq.records.record import with_only, with_samples, without_samples
from bayeq.records.repair import SAMPLES, split_at_gaps
from bayeq.records.validate import ROUNDED_BY, even_step, is_step
from bayeq.states.bad_samples import Learned, listed, without_bad_samples
from bayeq.states.derive import LARGEST, Smooth, require_usable
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.smoother import ChainSeries, smooth_kinematic
from bayeq.states.roles import Roles
from bayeq.states.sensors import Sensors, bridged

# Least number of rows with a sample of every channel.
LEAST_USABLE = 10

# Stretches of more than this many rows without an input, or without any sample of the chains, become gaps of time: the
# record is divided at those that are too long to be bridged.
SHORT = 2

# A record is put on a grid if at most this share of the grid's samples is missing.
MOST_MISSING = 0.4

# Times may have been rounded to one of these numbers of decimals, which moves them by at most half a unit of the last.
DECIMALS = range(1, 10)

# Times count as rounded to a number of decimals if they are off by at most this share of a unit of the last.
SAME_DECIMALS = 1e-6

# Steps between these multiples of the median count as single steps of the grid.
SINGLE = (0.5, 1.5)


def cleaned(
    records: Sequence[Record], roles: Roles, smooth: Smooth, learned: Learned | None = None
) -> tuple[list[Record], list[str]]:
    """The records of one system with NaN in place of bad samples (unchanged with "none"), and messages.

    There is a message for each channel of which samples are missing or left out. Samples are judged by the models
    `learned` from other records, if given. An UnknownNameError or RecordError names channels that are missing, or
    mostly infinite or too large to square.
    """
    if smooth == "none":
        return list(records), []
    missing = missing_messages(records, roles)
    records, impossible = without_impossible(records, roles.channels)
    for record in records:
        require_usable(bridged_record(record, roles), roles.channels)
    if roles.discrete:  # samples of a map may jump
        return records, [*missing, *impossible]
    found, bad = without_bad_samples(records, roles, learned)
    return found, [*missing, *impossible, *bad]


def without_impossible(records: Sequence[Record], names: Sequence[str]) -> tuple[list[Record], list[str]]:
    """Records with NaN in place of infinite samples and those too large to square, unless most are; and messages."""
    out, messages = [], []
    for record in records:
        where = f"{record.label}: " if len(records) > 1 else ""
        impossible = {}
        for name in names:
            values = record[name]
            bad = np.abs(values) > LARGEST  # false for NaN
            if 0 < bad.sum() < 0.5 * np.isfinite(values).sum():
                impossible[name] = bad
                what = f"infinite or beyond {LARGEST:g} ({listed(bad)}): taken as missing"
                messages.append(f"{where}{name}: {_samples_are(bad)} {what}; check the acquisition")
        out.append(without_samples(record, impossible))
    return out, messages


def divided_at_gaps(records: Sequence[Record], roles: Roles, smooth: Smooth) -> tuple[list[Record], list[str]]:
    """Cleaned records divided at long gaps, whole with "none", and a message for each record with such gaps."""
    if smooth == "none":
        return list(records), []
    return split_at_gaps(without_empty_rows(records, roles), roles.channels)


def missing_messages(records: Sequence[Record], roles: Roles) -> list[str]:
    """A sentence for each channel of which samples are missing."""
    out = []
    for record in records:
        where = f"{record.label}: " if len(records) > 1 else ""
        for name in roles.channels:
            rows = np.isnan(record[name])
            if rows.any():
                what = f"missing ({listed(rows)}: {in_digits(100 * rows.sum() / record.n)} %)"
                out.append(f"{where}{name}: {_samples_are(rows)} {what}; check the acquisition")
    return out


def _samples_are(rows: Bools) -> str:
    count = int(rows.sum())
    return "1 sample is" if count == 1 else f"{count} samples are"


def has_all(record: Record, roles: Roles) -> Bools:
    """Rows with a sample of every channel that is used, (n,)."""
    return np.all([np.isfinite(record[name]) for name in roles.channels], axis=0)


def require_enough(records: Sequence[Record], roles: Roles) -> None:
    """Raise a RecordError unless 10 rows have a sample of every channel."""
    usable = sum(int(has_all(record, roles).sum()) for record in records)
    if usable < LEAST_USABLE:
        where, total = ", ".join(record.label for record in records[:3]), sum(r.n for r in records)
        rows = f"{usable} row{'s' * (usable != 1)}"
        usable_of = rows if usable == total else f"{rows} of {total} with a sample of every channel"
        raise RecordError(f"{where}: {usable_of}: too few for a regression (at least {LEAST_USABLE}); measure more")


def complete_rows(record: Record, roles: Roles) -> Record:
    """The record without rows in which a sample is missing."""
    kept = has_all(record, roles)
    return record if kept.all() else record.take(kept)


def without_empty_rows(records: Sequence[Record], roles: Roles) -> list[Record]:
    """The records without stretches of more than two rows that lack all chains or an input, which leaves a gap in time.

    A record without time loses all rows that lack a channel, because missing samples cannot be bridged.
    """
    out = []
    for record in records:
        if record.time is None:
            out.append(complete_rows(record, roles))
            continue
        kept = ~_long(np.all([np.isnan(record[name]) for name in roles.measured], axis=0))
        for name in roles.inputs:
            kept &= ~_long(np.isnan(record[name]))
        out.append(record if kept.all() else record.take(kept))
    return out


def _long(missing: Bools) -> Bools:
    """The rows in stretches of more than `SHORT` missing samples, (n,)."""
    starts, lengths = equal_runs(missing)
    return np.repeat(missing[starts] & (lengths > SHORT), lengths)


def bridged_record(record: Record, roles: Roles, most: float = 1.0) -> Record:
    """The record with straight lines over missing samples, in channels that lack at most a share `most` of theirs."""
    changed = {
        name: bridged(values)
        for name in roles.channels
        if 0.0 < float(np.isnan(values := record[name]).mean()) <= most and not np.isinf(values).any()
    }
    return with_samples(record, changed)


def inputs_filled(record: Record, inputs: Sequence[str]) -> Record:
    """The record with missing samples of inputs filled in, because a free run needs every sample of an input.

    A RecordError refuses a gap longer than half the shortest period, at which `discover` would divide the record, or at
    an end.
    """
    lacking = [name for name in inputs if np.isnan(record[name]).any()]
    if not lacking or record.time is None:
        return record
    gaps = np.any([_long(np.isnan(record[name])) for name in lacking], axis=0)
    if gaps.any() and (gaps[0] or gaps[-1] or len(split_at_gaps([record.take(~gaps)], inputs)[0]) > 1):
        raise RecordError(
            f"{record.label}: {', '.join(lacking)}: samples are missing for too long to fill in"
            f" ({listed(gaps)} of those that are run over); run over rows before or after (start, rows)"
        )
    time = np.asarray(record.time)
    return with_samples(record, {name: filled_in(time, np.asarray(record[name])) for name in lacking})


def on_grid(record: Record, names: Sequence[str]) -> Record:
    """The record with a row for every sample of its grid: the same record, if none is missing or there is no grid.

    The channels named are NaN in rows that are filled in, for a smoother to bridge. Times that are off their grid by
    little (0.033, 0.067, 0.100 at 30 Hz, written with three decimals) become even.
    """
    if record.time is None or record.n < 3:
        return record
    time = np.asarray(record.time)
    index, start, step, off = fitted_grid(time)
    n = int(index[-1]) + 1
    if record.n < (1.0 - MOST_MISSING) * n or (off > RECORDS.jitter * step and not _is_rounding(time, off, step)):
        return record
    if record.n == n and is_step(time, float(time[-1] - time[0]) / (n - 1), 0.0).all():
        return record
    grid = start + step * np.arange(n, dtype=np.float64)
    channels = {}
    for name in names:
        channels[name] = np.full(n, np.nan)
        channels[name][index] = record[name]
    return replace(with_only(record, names), channels=channels, time=grid)


def corrected(record: Record, sensors: Sensors, whole: bool = False) -> Record:
    """The record corrected for the learned factors and lags of its channels, the lags by band-limited interpolation.

    Samples that a channel then lacks at an end are NaN; with `whole` they repeat the nearest sample. A RecordError
    refuses uneven time, apart from missing rows, and a lag as long as the record.
    """
    known = [name for name in sensors.gains if name in record.channels]
    record = with_samples(record, {name: record[name] / sensors.gains[name].value for name in known})
    lags = {name: lag for name, lag in sensors.lags.items() if name in record.channels and lag.value != 0.0}
    if not lags:
        return record
    record = on_grid(record, list(record.channels))
    changed = {}
    for name, lag in lags.items():
        samples = record[name]
        moved = correct_delay(record.with_channels({name: bridged(samples)}), name, lag.value)
        assert record.time is not None
        assert moved.time is not None
        first = int(np.searchsorted(record.time, moved.time[0]))
        values = np.full(record.n, np.nan)
        values[first : first + moved.n] = moved[name]
        lacking = np.interp(record.time + lag.value, record.time, np.isnan(samples)) > 0.0
        changed[name] = bridged(values) if whole else np.where(lacking, np.nan, values)
    return with_samples(record, changed)


def filled_in(time: Floats, samples: Floats) -> Floats:
    """Samples with missing ones by the kinematic smoother; a spline through noisy samples would overshoot in a gap."""
    if np.isfinite(samples).all():
        return samples
    series = ChainSeries(time, (samples,))
    try:
        values = smooth_kinematic(series, fit_kinematic([series])).mean[:, 0]
    except InputError:  # a few samples, or one value throughout
        known = np.isfinite(samples)
        values = np.interp(time, time[known], samples[known])
    return np.where(np.isnan(samples), values, samples)


def fitted_grid(time: Floats) -> tuple[Ints, float, float, float]:
    """Number of each sample on an even grid that begins with the first; start and step of the grid, and what the times
    are off it by at most; infinite where samples share a number."""
    steps = np.diff(time)
    median = float(np.median(steps))
    single = steps[(steps > SINGLE[0] * median) & (steps < SINGLE[1] * median)]
    index = np.append(0, np.cumsum(np.round(steps / single.mean()).astype(np.int64)))
    # once more with the grid fitted to all samples, for the numbers beyond a long gap
    start, step = _fitted(time, index)
    again = np.round((time - start) / step).astype(np.int64)
    index = again - again[0]
    start, step = _fitted(time, index)
    off = float(np.abs(time - start - step * index).max()) if (np.diff(index) > 0).all() else np.inf
    return index, start, step, off


def _fitted(time: Floats, index: Ints) -> tuple[float, float]:
    """Start and step of the grid, by least squares."""
    centre = index - index.mean()
    step = float(centre @ time / (centre @ centre))
    return float(time.mean() - step * index.mean()), step


def _is_rounding(time: Floats, off: float, step: float) -> bool:
    """Whether times are multiples of a power of ten, and off a grid by no more than rounding to it."""
    for decimals in DECIMALS:
        unit = 10.0**-decimals
        if np.abs(time - np.round(time, decimals)).max() <= SAME_DECIMALS * unit:
            return off <= ROUNDED_BY * unit and unit < step
    return False


# --- maps ------------------------------------------------------------------------------------------------------------

# Times are on a grid if they are off by no more than this share of its step.
OFF_GRID = 0.1


def numbered(records: Sequence[Record], names: Sequence[str]) -> list[Record]:
    """The records with inputs run2, run3 that number them, unless they have these; an InputError refuses a number of
    records that differs from that of the equations."""
    if all(name in record.channels for record in records for name in names):
        return list(records)
    if len(records) != len(names) + 1:
        raise InputError(
            f"coefficients differ between the {len(names) + 1} records of the equations: give as many, in that order,"
            f" or channels {', '.join(names)} that are 1 in the record of this number, else 0"
        )
    units = dict.fromkeys(names, "1")
    return [
        record.with_channels({name: np.full(record.n, float(name == f"run{k}")) for name in names}, units)
        for k, record in enumerate(records, 1)
    ]


def in_samples(record: Record, roles: Roles) -> Record:
    """The record with the number of the sample as time, and with earlier samples of inputs as channels of their own.

    Samples before the record repeat the first one of the input. A RecordError refuses uneven steps of time.
    """
    time = np.arange(record.n, dtype=np.float64)
    if record.time is not None and record.n > 2:
        index, _, step, off = fitted_grid(np.asarray(record.time))
        if off > OFF_GRID * step:
            raise RecordError(
                f"{record.label}: steps of time are uneven, and a map goes from sample to sample: resample"
                " evenly, or leave time out"
            )
        time = index.astype(np.float64)
    channels, units = dict(record.channels), {**record.units, "t": SAMPLES}
    for name in roles.inputs:
        found = EARLIER.fullmatch(name)
        if found is None:
            continue
        base, back = found["name"], int(found["back"])
        places = np.searchsorted(time, time - back)
        there = time[places] == time - back
        channels[name] = np.where(there | (time - back < time[0]), record[base][places], np.nan)
        if base in record.units:
            units[name] = record.units[base]
    return Record(channels, time, units, record.name, record.truth)


# --- hum -------------------------------------------------------------------------------------------------------------

# A line has at least this share of the channel's power: less, in channels without noise, is rounding.
LEAST = 1e-6

# Bins on either side that a line is compared with, beyond the LOBE nearest, over which Hann's window spreads the line.
BESIDE, LOBE = 50, 3

# Largest number of lines in a record (one of varying amplitude takes several); in short records one in ROWS_EACH rows.
MOST_LINES, ROWS_EACH = 20, 100

# Lines that a message lists.
SHOWN = 6

# Iterations of the refinement of a frequency between bins.
TURNS = 40


def without_hum(
    records: Sequence[Record], names: Sequence[str], low: float, high: float
) -> tuple[list[Record], list[str]]:
    """Channels of records without the lines that stand out of their spectra above the band, and a message.

    The band is from `low` to `high` [Hz]. A RecordError refuses records that are not sampled evenly, or too slowly.
    """
    found, heard = [], set[float]()
    for record in records:
        where, even = record.label, on_grid(record, names)
        step = None if even.time is None else even_step(np.asarray(even.time))
        if step is None:
            raise RecordError(
                f"{where}: a band of frequencies needs records that are sampled evenly; leave the band out, or resample"
            )
        fs = 1.0 / step
        if low >= 0.5 * fs:
            raise RecordError(
                f"{where}: the band {low:g} to {high:g} Hz is above half of the sampling rate, {0.5 * fs:g} Hz"
            )
        values = np.column_stack([np.asarray(even[name], dtype=np.float64) for name in names])
        values, lines = _without_lines(values, high / fs)
        heard.update(round(fs * line, 2) for line in lines)
        found.append(with_samples(with_only(even, names), dict(zip(names, values.T, strict=True))))
    some = sorted(heard)[:SHOWN]
    listed = ", ".join(f"{line:g}" for line in some) + (f" and {len(heard) - SHOWN} more" if len(heard) > SHOWN else "")
    return found, [f"hum above the band was taken out of all channels, at {listed} Hz"] if heard else []


def _without_lines(values: Floats, above: float) -> tuple[Floats, list[float]]:
    """Channels (n, M) without their components at the frequencies of lines; these frequencies [cycles per sample]."""
    known, rows = np.isfinite(values), np.arange(len(values), dtype=np.float64)
    window, rest, lines = np.hanning(len(values) + 2)[1:-1], values, list[float]()
    while len(lines) < min(MOST_LINES, len(values) // ROWS_EACH):
        whole = np.column_stack([bridged(own) for own in rest.T])
        windowed = window[:, None] * (whole - whole.mean(axis=0))
        power = np.abs(np.fft.rfft(windowed, axis=0)) ** 2
        ratios = np.column_stack([_above_both_sides(own) for own in power.T])
        ratios[: int(np.ceil(above * len(values)))] = 0.0
        best, channel = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
        if not ratios[best, channel] > STATES.hum_line:
            break
        lines.append(_refined(windowed[:, channel], float(best) / len(values)))
        waves = 2.0 * np.pi * rows[:, None] * np.array(lines)
        both = np.hstack([np.cos(waves), np.sin(waves)])
        # amplitudes and phases may vary in proportion to time: so do those of a frequency that is a little off
        basis = np.hstack([both, np.linspace(-1.0, 1.0, len(rows))[:, None] * both, np.ones((len(rows), 1))])
        rest = np.empty_like(values)
        for i, seen in enumerate(known.T):
            # weighted by the window, so that slow, strong motion does not leak into the lines
            weight = window[seen, None]
            fitted = np.linalg.lstsq(weight * basis[seen], weight[:, 0] * values[seen, i])[0]
            rest[:, i] = values[:, i] - basis[:, :-1] @ fitted[:-1]
    return rest, lines


def _above_both_sides(power: Floats) -> Floats:
    """Power of each bin over the larger median of the bins on either side."""
    padded = np.pad(power, BESIDE + LOBE, mode="reflect")
    sides = np.median(np.lib.stride_tricks.sliding_window_view(padded, BESIDE), axis=1)
    level = np.maximum(sides[: len(power)], sides[BESIDE + 2 * LOBE + 1 :][: len(power)])
    seen = (level > 0.0) & (power > LEAST * power.sum())
    return np.where(seen, power / np.where(seen, level, 1.0), 0.0)


def _refined(windowed: Floats, near: float) -> float:
    """The frequency within a bin at which the transform is greatest, by golden sections."""
    rows, golden = np.arange(len(windowed)), 0.5 * (np.sqrt(5.0) - 1.0)

    def power(frequency: float) -> float:
        return float(abs(np.exp(-2j * np.pi * frequency * rows) @ windowed))

    low, high = near - 1.0 / len(rows), near + 1.0 / len(rows)
    for _ in range(TURNS):
        left, right = high - golden * (high - low), low + golden * (high - low)
        low, high = (low, right) if power(left) > power(right) else (left, high)
    return 0.5 * (low + high)
