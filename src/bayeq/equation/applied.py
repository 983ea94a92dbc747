"""Equations applied to records that they were not found from: scores, bands, and whether they hold there.

`test_errors` is for benchmarks that prescribe the first rows for the initial state and score the others.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import chain
from typing import Any

import numpy as np

from bayeq.equation import along
from bayeq.equation.equation import Equation
from bayeq.equation.equations import Equations
from bayeq.equation.verdict import state_noise, window_errors
from bayeq.equation.written import finite, moment
from bayeq.errors import DataWarning, InputError, in_digits
from bayeq.forecast.free_run import Forecast
from bayeq.forecast.score import percent, percentages
from bayeq.numerics.distributions import Z95
from bayeq.numerics.settings import EQUATION
from bayeq.records import Record, counts_rows
from bayeq.records.names import rate_and_length
from bayeq.states import estimate_motion
from bayeq.states.prepare import in_samples, numbered

# Runs that err by more than this share of the spread follow a record only roughly.
ROUGHLY = 0.3

# A record is out of range if it exceeds the range of the equations' records by more than this share of it.
BEYOND = 0.1

# Least rows of a free run, and least rows from which an initial state is estimated.
LEAST_ROWS, LEAST_SKIPPED = 2, 10


@dataclass(frozen=True, slots=True)
class Error:
    """Errors of a prediction against the measurement."""

    nrmse: float  # root mean squared error over the standard deviation of the channel; infinite for a run that blew up
    rms: float  # root mean squared error in the unit of the channel
    unit: str | None  # that unit, where it is known
    inside: float | None  # share of the measured samples within the 95 % band


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predictions of equations for records, compared with the measurement."""

    kind: str  # "follows", "follows roughly", "follows for a period" or "does not hold"
    reason: str  # the same in a sentence
    text: str  # the equations
    files: tuple[str, ...]  # names of the records
    rows: int  # number of rows compared
    fs: float | None  # rate of the first record [Hz]; None where rows count as time
    seconds: float | None  # length of all records; None where rows count as time
    # by target: error of the right-hand side at the measured states and inputs of each row; the band includes noise
    one_step: Mapping[str, Error]
    # by measured state: error of free runs from the first row of each record. The band includes the uncertainty of the
    # coefficients, the discrepancy and the noise of the samples, as far as they are known
    free_run: Mapping[str, Error]
    # by target: normalised error of free runs over one period; empty if records are too short
    windows: Mapping[str, float]
    blew_up_at: float | None  # time [s] at which a free run left any reasonable range
    notes: tuple[str, ...]  # units converted or assumed, ranges exceeded
    runs: tuple[tuple[str, Forecast], ...]  # the free run of each record, by its name
    clock: str = "s"  # unit of time

    def to_dict(self) -> dict[str, Any]:
        """The data that ``bayeq predict --json`` prints; None for the infinite error of a run that blew up."""
        return {
            "version": version("bayeq"),
            "verdict": {"kind": self.kind, "reason": self.reason},
            "data": {
                "file": self.files[0] if len(self.files) == 1 else list(self.files),
                "n": self.rows,
                "fs": self.fs,
                "seconds": self.seconds,
            },
            "equations": self.text.splitlines(),
            "one_step": finite({name: asdict(one) for name, one in self.one_step.items()}),
            "free_run": finite({name: asdict(one) for name, one in self.free_run.items()}),
            "windows": finite(self.windows),
            "blew_up_at": self.blew_up_at,
            "warnings": list(self.notes),
        }

    def __str__(self) -> str:
        """The sentence, the equations and a table of errors."""
        lines = [f"verdict: {self.reason}", "", self.text, "", *self._table(), ""]
        if self.blew_up_at is not None:
            lines.append(f"the free run blew up at {moment(self.blew_up_at, self.runs[0][1].clock == 'samples')}")
        if self.windows:
            lines.append(f"free runs over one period: normalised RMS error {percentages(self.windows)}")
        lines.append(
            "inside: share of the measured samples in the 95 % band, of coefficients, what terms leave out and noise"
        )
        rate = ""
        if self.fs is not None and self.seconds is not None:
            texts = rate_and_length(f"{self.fs:.6g}", f"{self.seconds:.4g}", self.clock)
            rate = " at {}, {},".format(*texts)
        source = f" of {self.files[0]}" if len(self.files) == 1 else f" of {len(self.files)} records"
        lines.append(f"{self.rows} rows{rate}{source}")
        return "\n".join(lines)

    def _table(self) -> list[str]:
        rows = [("prediction", "normalised RMS", "RMS", "unit", "inside")]
        for what, errors in (("single step", self.one_step), ("free run", self.free_run)):
            for name, error in errors.items():
                inside = "" if error.inside is None else f"{100 * error.inside:.3g} %"
                rms = "blew up" if math.isinf(error.rms) else "" if math.isnan(error.rms) else f"{error.rms:.3g}"
                share = percent(error.nrmse) if math.isfinite(error.nrmse) else ""
                rows.append((f"{name}, {what}", share, rms, error.unit or "", inside))
        widths = [max(len(row[k]) for row in rows) for k in range(5)]
        ruler = "|".join("-" * (width + 2) for width in widths)
        written = [" | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
        return [f"| {written[0]} |", f"|{ruler}|", *(f"| {line} |" for line in written[1:])]


def as_equations_have_them(equations: Equations, record: Record) -> tuple[Record, list[str]]:
    """The record in the equations' units and time, and notes on units converted or assumed; else InputError."""
    where = record.label
    moving = bool(equations.states) and not equations.roles.discrete
    if moving and counts_rows(record) and not equations.data.rows_as_time:
        raise InputError(
            f"{where}: time is not known, and the equations are per second; give --fs or --time (fs=, time=)"
        )
    if moving and record.time is not None and not counts_rows(record) and equations.data.rows_as_time:
        raise InputError(
            f"{where}: the equations are per sample, for their record had no time; find them again with the sampling"
            " rate (--fs, fs=)"
        )
    wanted, known = equations.units, record.units
    bare = [n for n in equations.roles.channels if n in record.channels and n in wanted and n not in known]
    record, notes = along.in_units_of(equations, record)
    if bare:
        taken = ", ".join(dict.fromkeys(wanted[name] for name in bare))
        has_none = f"{where} has no unit of {', '.join(bare)}"
        notes = [f"{has_none}: taken to be in {taken}, as the equations have it (else --units)", *notes]
    return record, notes


def apply_to(equations: Equations, records: Sequence[Record], draws: int = 200, seed: int = 0) -> Prediction:
    """Predictions for records with time and all channels of the equations, and the verdict whether these hold there.

    `draws` runs with coefficients from the posterior give the bands. InputError: channels that are missing, units that
    cannot be converted, no time, no motion. DataWarning: samples that are missing or left out.
    """
    records = numbered(records, equations.numbers)
    if equations.roles.discrete:
        records = [in_samples(record, equations.roles) for record in records]
    for name in equations.roles.channels:
        for record in records:
            _ = record[name]
    fitting, converted = zip(*(as_equations_have_them(equations, record) for record in records), strict=True)
    pieces = [piece for piece in along.prepared(equations, fitting, divide=True) if piece.n >= LEAST_ROWS]
    if not pieces:
        raise InputError(f"{records[0].label}: too few rows to predict; give two or more")
    _require_moving(pieces, equations.roles.measured)
    notes = [*chain.from_iterable(converted), *_out_of_range(equations, pieces)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # samples left out have been reported
        scores = along.scores(equations, pieces, start=0)
        driven = pieces if equations.states else []
        runs = tuple((piece.name, along.free_run(equations, piece, draws=draws, seed=seed)) for piece in driven)
        one_step = {
            one.target: _single_step(equations, one, pieces, scores.one_step[one.target])
            for one in equations
            if not one.chain.hidden  # a hidden state has no samples to compare with
        }
        motion = estimate_motion(pieces, equations.roles, equations.smooth, sensors=equations.data.sensors)
        windows = window_errors(equations.dynamics(), replace(motion, courses=equations.data.interpolation))
    noise = {**state_noise(motion), **equations.data.noise_sd}
    forecasts = [run for _, run in runs]
    unknown = None if equations.roles.discrete else 0.0  # no smoother estimates the noise of maps
    free_run = {name: _free_run(name, forecasts, noise.get(name, unknown), e) for name, e in scores.free_run.items()}
    by_target = {one.target: found.error for one, found in zip(equations, windows, strict=True) if found is not None}
    kind, reason = _verdict(one_step, free_run, by_target)
    timed = not equations.data.rows_as_time
    return Prediction(
        kind=kind,
        reason=reason,
        text="\n".join(equation.text for equation in equations),
        files=tuple(dict.fromkeys(record.name for record in records)),
        rows=scores.rows,
        fs=pieces[0].fs if timed else None,
        seconds=sum(piece.duration for piece in pieces) if timed else None,
        one_step=one_step,
        free_run=free_run,
        windows=by_target,
        blew_up_at=scores.blew_up_at,
        notes=tuple(dict.fromkeys(notes)),
        runs=runs,
        clock=records[0].clock,
    )


def _require_moving(records: Sequence[Record], names: Sequence[str]) -> None:
    """Raise an InputError unless one of the channels changes: errors are shares of what changes."""
    for name in names:
        samples = np.concatenate([record[name] for record in records])
        if len(np.unique(samples[np.isfinite(samples)])) > 1:
            return
    raise InputError(
        f"{records[0].label}: no change of {', '.join(names)} in {sum(record.n for record in records)} rows: errors are"
        " shares of it; give a record that moves"
    )


def _out_of_range(equations: Equations, records: Sequence[Record]) -> list[str]:
    """Notes on channels that exceed their range in the equations' records."""
    out = []
    for name, (low, high) in equations.data.measured.ranges.items():
        if not all(name in record.channels for record in records):
            continue
        samples = np.concatenate([record[name] for record in records])
        least, most = float(np.nanmin(samples)), float(np.nanmax(samples))
        room = BEYOND * (high - low)
        if least < low - room or most > high + room:
            here, there = (" .. ".join(in_digits(end, 3) for end in ends) for ends in ((least, most), (low, high)))
            out.append(
                f"{name}, {here}, goes beyond the {there} of the equations' records: they are extrapolated there"
            )
    return out


def _single_step(equations: Equations, equation: Equation, pieces: Sequence[Record], nrmse: float) -> Error:
    """The error of a target row by row, and the share of its samples within the predictive band."""
    target, unit = equation.target, equation.units.get(equation.target)
    if not all(target in piece.channels for piece in pieces):
        return Error(nrmse, math.nan, unit, None)
    samples = np.concatenate([piece[target] for piece in pieces])
    how = equations.roles, equations.smooth, equations.data.sensors
    rows = (along.rows_of_record(piece, *how) for piece in pieces)
    mean, sd = (np.concatenate(part) for part in zip(*(equation.predict(one, True) for one in rows), strict=True))
    there = np.isfinite(samples)
    inside = float(np.mean(np.abs(samples - mean)[there] <= Z95 * sd[there])) if there.any() else None
    return Error(nrmse, nrmse * float(np.nanstd(samples)), unit, inside)


def _free_run(name: str, runs: Sequence[Forecast], noise: float | None, nrmse: float) -> Error:
    """The error of a state along the free runs, and the share of its samples in their bands, widened by noise."""
    samples = np.concatenate([run.measured[name] for run in runs])
    unit = next((run.units[name] for run in runs if name in run.units), None)
    inside: float | None = None
    there = np.isfinite(samples)
    if noise is not None and all(name in run.low for run in runs) and there.any():
        parts = np.hstack([[run.low[name], run.mean[name], run.high[name]] for run in runs])
        low, mean, high = parts[:, there]
        bottom, top = (np.hypot(side, Z95 * noise) for side in (mean - low, high - mean))
        inside = float(np.mean((samples[there] >= mean - bottom) & (samples[there] <= mean + top)))
    return Error(nrmse, nrmse * float(np.nanstd(samples)), unit, inside)


def _verdict(
    one_step: Mapping[str, Error], free_run: Mapping[str, Error], windows: Mapping[str, float]
) -> tuple[str, str]:
    """Whether the equations hold: by the worst state of the free runs, of single steps where no state is measured."""
    judged = free_run or one_step
    what = "free runs follow" if free_run else "single steps follow"
    worst = max((error.nrmse for error in judged.values()), default=math.inf)
    if worst < EQUATION.as_the_mean:
        if worst <= ROUGHLY:
            return "follows", f"{what} the record within {percent(worst)}"
        return "follows roughly", f"{what} the record only roughly, within {percent(worst)}"
    period = max(windows.values(), default=math.inf)
    if free_run and period <= ROUGHLY:
        return (
            "follows for a period",
            f"free runs over one period follow the record within {percent(period)}, over all of it they are"
            " worse than the mean: small errors add up, as in chaotic or lightly damped motion",
        )
    return "does not hold", "worse than the mean: the equation does not hold for this record"


@dataclass(frozen=True, slots=True)
class TestError:
    """The error of a free run over a record that the equations have not seen."""

    __test__ = False  # for pytest: this is no class of tests

    record: str  # its name
    channel: str  # the measured state
    skip: int  # rows at the beginning that the initial state is estimated from
    rows: int  # finite samples after these, which are scored
    rmse: float  # root mean squared error in the unit of the channel; infinite of a run that blew up
    nrmse: float  # the same over the standard deviation of the channel in these rows
    unit: str | None  # unit of the channel
    notes: tuple[str, ...]  # units converted or assumed

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit not in (None, "1") else ""
        share = f"{100 * self.nrmse:.3g} % of its standard deviation"
        return (
            f"{self.record}: free run over {self.rows} rows, {self.channel} from row {self.skip} on:"
            f" RMSE {self.rmse:.4g}{unit} ({share})"
        )


def test_errors(equations: Equations, records: Sequence[Record], skip: int) -> list[TestError]:
    """Errors of free runs over records that the equations were not found from, one for each record and measured state.

    Each run is driven by the inputs alone, and begins in the state with which it follows the first `skip` rows best.
    Errors are in the units of the equations. InputError for fewer rows than 10 before or 2 after, a channel that is
    missing, a unit that cannot be converted, or no motion.
    """
    out: list[TestError] = []
    for number, record in enumerate(records):
        name = record.name or f"record {number + 1}"
        if not LEAST_SKIPPED <= skip <= record.n - 2:
            raise InputError(
                f"{name}: the initial state is estimated from the rows that are skipped: skip at least {LEAST_SKIPPED}"
                f" of its {record.n} rows, and leave some; got {skip}"
            )
        record, notes = as_equations_have_them(equations, record)
        _require_moving([record.slice(skip, record.n)], equations.roles.measured)
        first = replace(record.slice(0, skip), name=f"{name}, rows 1 to {skip}")
        begin = equations.simulate(first, draws=0)
        start = {state: float(values[0]) for state, values in begin.mean.items()}
        inputs = {channel: record[channel] for channel in equations.inputs}
        units = {channel: unit for channel, unit in record.units.items() if channel in inputs}
        driven = Record.from_arrays(inputs or {"t_": np.zeros(record.n)}, time=record.time, units=units, name=name)
        run = equations.simulate(driven, initial=start, draws=0)
        for state in start:
            if state not in record.channels:
                continue
            measured, found = record[state][skip:], run.mean[state]
            there, rmse = np.isfinite(measured), math.inf
            if np.isfinite(found).all():
                rmse = float(np.sqrt(np.mean((found[skip:] - measured)[there] ** 2)))
            sd = float(np.std(measured[there]))
            nrmse = rmse / sd if sd > 0.0 else math.inf
            unit = run.units.get(state, record.units.get(state))
            out.append(TestError(name, state, skip, int(there.sum()), rmse, nrmse, unit, tuple(notes)))
    return out
