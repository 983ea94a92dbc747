"""Equations run along records: preparation as in `discover`, states at each row, free runs, scores, output error."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from bayeq.arrays import Floats
from bayeq.equation.answer import Answer, EquationTuple
from bayeq.equation.refine.output_error import Unrefined
from bayeq.equation.refine.refine import refine
from bayeq.errors import ConvergenceWarning, DataWarning, InputError
from bayeq.forecast.free_run import Forecast, forecast
from bayeq.forecast.rows import Courses, require_time, rows_of, window_of
from bayeq.forecast.score import LEAST_ROWS, Scores, score_rows
from bayeq.numerics.rk4 import Interpolation, check_interpolation
from bayeq.records import Record
from bayeq.records.record import in_units
from bayeq.states import Roles, Sensors, Smooth, estimate_motion
from bayeq.states.derive import require_samples
from bayeq.states.prepare import cleaned, divided_at_gaps, has_all

Found = TypeVar("Found", bound=Answer)

# Share of the rows that is scored where none were held out.
LAST = 0.2


def prepared(eq: Answer, records: Sequence[Record], divide: bool = False, level: int = 3) -> list[Record]:
    """The records with NaN in place of bad samples and, with `divide`, divided at long gaps.

    Warns (DataWarning, stack level `level`) about bad samples and gaps that `discover` has not reported before. A
    RecordError names a channel without any sample.
    """
    roles = _without_targets(eq.roles.seen, records)
    require_samples(records, roles.channels, "give rows that have some, as the equations need it")
    found, messages = cleaned(records, roles, eq.smooth)
    if divide:
        found, more = divided_at_gaps(found, roles, eq.smooth)
        messages += more
    for message in dict.fromkeys(messages):
        named = f"{records[0].label}: {message}"  # how `discover` writes it for several records
        if message not in eq.warnings and (len(records) > 1 or named not in eq.warnings):
            warnings.warn(message, DataWarning, stacklevel=level)
    return found


def in_units_of(eq: Answer, record: Record) -> tuple[Record, list[str]]:
    """The record in the equations' units, where both are known, and notes on conversions; InputError if none exists."""
    wanted = {name: unit for name, unit in eq.units.items() if name in eq.roles.channels}
    record, notes, others = in_units(record, wanted)
    for name in others:
        raise InputError(
            f"{record.label}: {name} is in {record.units[name]}, in the equations in {wanted[name]}: give"
            " its unit (--units), or name the channel that is meant (--channel)"
        )
    return record, notes


def _without_targets(roles: Roles, records: Sequence[Record]) -> Roles:
    """The roles without the static laws whose target is missing from a record: only that law needs the target."""
    lacking = [c for c in roles.chains if c.static and not all(c.target in record.channels for record in records)]
    return roles.with_chains([chain for chain in roles.chains if chain not in lacking]) if lacking else roles


def rows_of_record(record: Record, roles: Roles, smooth: Smooth, sensors: Sensors) -> dict[str, Floats]:
    """States and inputs at every row of a record, (n,) each, interpolated where `estimate_motion` gives no row."""
    rows = estimate_motion([record], _without_targets(roles, [record]), smooth, sensors=sensors).records[0]
    if rows.n == record.n:
        return dict(rows.columns)
    if record.time is None or rows.time is None:
        places, there = np.arange(record.n), np.flatnonzero(has_all(record, roles))
    else:
        places, there = np.asarray(record.time), np.asarray(rows.time)
    return {name: np.interp(places, there, values) for name, values in rows.columns.items()}


def require_states(eq: Answer) -> None:
    """Refuse free runs of static laws alone, by an InputError."""
    if not eq.states:
        raise InputError(f"{_static_laws(eq)}: nothing is integrated; predict(record) gives them row by row")


def free_run(eq: Answer, record: Record, *, interpolation: Interpolation | None = None, **how: Any) -> Forecast:
    """See `Equations.simulate`, whose other arguments go to `forecast`."""
    require_states(eq)
    return forecast(
        eq.dynamics(),
        record,
        eq.smooth,
        eq.data.sensors,
        interpolation=_between(eq, interpolation),
        units=eq.units,
        noise=eq.data.noise_sd,
        **how,
    )


def scores(
    eq: Answer,
    records: Sequence[Record],
    *,
    start: int | None = None,
    rows: int | None = None,
    interpolation: Interpolation | None = None,
) -> Scores:
    """See `Equations.score`."""
    courses, share = _between(eq, interpolation), eq.data.holdout or LAST
    check_interpolation(courses)
    motion = estimate_motion(records, eq.roles, eq.smooth, share if start is None else 0.0, eq.data.sensors)
    pieces, dynamics = [], eq.dynamics()
    for record, whole in zip(records, rows_of(motion, "a free run", courses), strict=True):
        time, first = require_time(record, "a free run"), start
        if first is None:
            cut = whole.n - max(int(share * whole.n), LEAST_ROWS)
            # the motion may have dropped rows of the record: find its first held-out row by time
            moment = 0.5 * (whole.time[cut - 1] + whole.time[cut]) if cut else time[0]
            first = min(int(np.searchsorted(time, moment)), record.n - LEAST_ROWS)
        window = window_of(record, first, rows)
        pieces.append(whole.part(slice(whole.nearest(time[window.start]), whole.nearest(time[window.stop - 1]) + 1)))
    return score_rows(dynamics, dynamics.mean, pieces)


def _static_laws(eq: Answer) -> str:
    return f"{', '.join(chain.target for chain in eq.chains if chain.static)}: static laws"


def _between(eq: Answer, interpolation: Interpolation | None) -> Courses:
    return interpolation or (eq.refined.interpolation if eq.refined else eq.data.interpolation)


def refinement(eq: Found, records: Sequence[Record], holdout: float, interpolation: Interpolation | None) -> Found:
    """See `Equations.refine`."""
    if eq.roles.hidden:
        raise InputError("refine needs every state measured: leave it out, the coefficients are those of all rows")
    check_interpolation(interpolation)
    if eq.roles.discrete:
        raise InputError("a map is not refined: its coefficients are those of the likelihood of the record already")
    if any(chain.static for chain in eq.chains):
        raise InputError(f"{_static_laws(eq)}: output error is of free runs, which such laws do not have")
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
    for equation in eq.equations:
        if not equation.shown:
            raise InputError(f"{equation.target}: there are no terms to refine")
    found = refine(
        eq.dynamics(),
        eq.dynamics([equation.intercept_matters for equation in eq.equations]),
        prepared(eq, records, divide=True, level=4),
        smooth=eq.smooth,
        holdout=holdout,
        interpolation=interpolation or eq.data.interpolation,
        constraints=eq.known(),
        sensors=eq.data.sensors,
        noise=eq.data.noise_sd,
    )
    if isinstance(found, Unrefined):
        message = f"not refined: {found.reason}; the equations are returned as they were: {found.advice}"
        warnings.warn(message, ConvergenceWarning, stacklevel=3)
        return eq
    refined, summary, of_held_out, doubts = found
    for message, category in doubts:
        warnings.warn(message, category, stacklevel=3)
    return replace(
        eq,
        equations=EquationTuple(
            old.with_posterior(posterior, **changes)
            for old, (posterior, changes) in zip(eq.equations, refined, strict=True)
        ),
        warnings=(*eq.warnings, *(message for message, _ in doubts)),
        scores=of_held_out,
        refined=summary,
    )
