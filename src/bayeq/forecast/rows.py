"""Rows of records with the data of free runs: initial states, drivers, and samples to compare them with."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.errors import InputError, RecordError, whole_number
from bayeq.expressions import Expression
from bayeq.numerics.rk4 import Drive, Interpolation, interpolant, with_time
from bayeq.records import Record
from bayeq.states import ChainSmoothing, Motion, MotionRows, Roles

# Interpolation of inputs between samples: the same for all, or by name, "cubic" for the others.
Courses = Interpolation | Mapping[str, Interpolation]


@dataclass(frozen=True, eq=False)
class Rows(MotionRows):
    """Rows of one record with time; targets in `columns` are the measured ones, where there are any."""

    time: Floats
    # (n, m, 4), inputs, and t where it is used, between the rows, from `bayeq.numerics.rk4.interpolant` over the whole
    # record
    driven: Floats
    # how targets that were not measured were estimated
    estimated: Mapping[str, ChainSmoothing] = field(default_factory=dict)

    def part(self, rows: slice) -> Rows:
        """Some of the rows."""
        return Rows(**vars(super().part(rows)), driven=self.driven[rows], estimated=self.estimated)

    def drive(self, low: Floats, high: Floats) -> Drive:
        """The drive of a run over these rows, within limits of the states, (d,) each."""
        return Drive.over(self.time, self.driven, low, high)

    def nearest(self, time: float) -> int:
        """The row that is nearest to a time."""
        return int(np.argmin(np.abs(self.time - time)))

    def stack(self, names: Sequence[str]) -> Floats:
        """Columns side by side, (n, k)."""
        return np.column_stack([self.columns[name] for name in names]) if names else np.empty((self.n, 0))


def rows_of(motion: Motion, purpose: str, interpolation: Courses | None = None) -> list[Rows]:
    """All rows of each record of some motion, inputs by default as found; RecordError for a record without time."""
    interpolation = motion.courses if interpolation is None else interpolation
    roles = motion.roles
    estimated = {
        target: smoothing for k, target in enumerate(roles.targets) if (smoothing := motion.estimated_by(k)) is not None
    }
    out = []
    for rows in motion.records:
        time = require_time(rows, purpose)
        driven = between(roles, time, rows.columns, interpolation)
        judged = replace(rows, columns={**rows.columns, **rows.observed})
        out.append(Rows(**vars(judged), driven=driven, estimated=estimated))
    return out


def divided(motion: Motion, records: Sequence[Rows]) -> tuple[list[Rows], list[Rows]]:
    """Training rows of each record, and held-out rows of each that has some; without ends that lack an input.

    A lag that was removed leaves such ends; the values that fill them must not drive a run.
    """
    train, held_out = [], []
    for rows, cut in zip(records, motion.cuts, strict=True):
        inputs = [np.isfinite(rows.samples[name]) for name in motion.roles.inputs]
        driven = np.flatnonzero(np.all(inputs, axis=0)) if inputs else np.arange(rows.n)
        first, stop = (int(driven[0]), int(driven[-1]) + 1) if len(driven) else (0, 0)
        train.append(rows.part(slice(first, min(cut, stop))))
        if cut < stop:
            held_out.append(rows.part(slice(max(cut, first), stop)))
    return train, held_out


def between(roles: Roles, time: Floats, columns: Mapping[str, Floats], kind: Courses) -> Floats:
    """Interpolants of the drivers of a run between samples, (n, m, 4): inputs, and t if it is used."""
    kinds = {name: kind if isinstance(kind, str) else kind.get(name, "cubic") for name in roles.inputs}
    each = [interpolant(time, columns[name][:, None], one) for name, one in kinds.items()]
    inputs = np.concatenate([np.empty((len(time), 0, 4)), *each], axis=1)
    return with_time(time, inputs) if roles.timed else inputs


def require_time(record: Record | MotionRows, purpose: str) -> Floats:
    """Sampling times of a record; RecordError if it has none."""
    if record.time is None:
        raise RecordError(f"{record.name or 'record'}: {purpose} needs a time column or fs")
    return record.time


def normalised_error(run: Floats, samples: Floats) -> float:
    """Root mean squared error over the samples' standard deviation; infinite for a run that does not reach the end."""
    present = np.isfinite(samples)
    error = run[present] - samples[present]
    if not len(error) or not np.isfinite(error).all():
        return math.inf
    spread = float(samples[present].std())
    rms = float(np.sqrt(np.mean(error**2)))
    return rms / spread if spread > 0 else (math.inf if rms > 0 else 0.0)


def predicted_target(terms: Sequence[Expression], parameters: Floats, columns: Mapping[str, Floats]) -> Floats:
    """Right-hand side at each row; `parameters` are the coefficients of the terms, the intercept (if any) in front."""
    constant = len(parameters) - len(terms)
    return np.asarray(evaluate_terms(terms, columns) @ parameters[constant:] + (parameters[0] if constant else 0.0))


def window_of(record: Record, start: int, rows: int | None) -> slice:
    """Rows of a record from `start` on, checked."""
    start = whole_number("start", start, 0)
    if start >= record.n:
        raise InputError(f"start is row {start}, but {record.name or 'the record'} has {record.n} rows")
    rows = record.n - start if rows is None else whole_number("rows", rows, 2)
    if start + rows > record.n or rows < 2:
        raise InputError(
            f"a free run over {rows} rows from row {start} needs 2 rows or more, and at most the {record.n} that"
            f" {record.name or 'the record'} has"
        )
    return slice(start, start + rows)
