"""`Scores`: errors of the single step and of the free run on rows of records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import in_digits
from bayeq.expressions import Expression
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import fitted_start, mean_run, state_range
from bayeq.forecast.rows import Rows, divided, normalised_error, predicted_target, rows_of
from bayeq.states import Motion
from bayeq.states.roles import NEXT

# A free run over fewer rows says nothing.
LEAST_ROWS = 2

# A channel is still if its spread on the held-out rows is below this share of that on all rows.
STILL = 0.05


@dataclass(frozen=True, slots=True)
class Scores:
    """Errors of equations on some rows.

    Attributes
    ----------
    rows : int
        Number of rows.
    one_step : mapping of str to float
        For each equation the root mean squared error of the target, given the states and inputs of each row, over the
        standard deviation of the target: the error of the equation.
    free_run : mapping of str to float
        For each measured state the same error of free runs, one per record, from the state of its first row; infinite
        if a run blew up.
    blew_up_at : float or None
        Time [s] at which a free run left any reasonable range.
    still : tuple of str
        States and targets that hardly move on these rows, so that errors relative to their spread say little.
    """

    rows: int
    one_step: Mapping[str, float]
    free_run: Mapping[str, float]
    blew_up_at: float | None = None
    still: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Both scores in a line each."""
        lines = [
            f"normalised RMS errors over {self.rows} rows",
            f"one step: {percentages(self.one_step)}",
            f"free run: {percentages(self.free_run)}",
        ]
        if self.blew_up_at is not None:
            lines.append(f"the free run blew up at {self.blew_up_at:.6g} s")
        return "\n".join(lines)


def percentages(errors: Mapping[str, float]) -> str:
    """Errors as text.

    >>> percentages({"x": 0.0123, "v": 0.57})
    'x 1.2 %, v 57 %'
    """
    return ", ".join(f"{name} {percent(error)}" for name, error in errors.items()) or "no state is measured"


def percent(share: float) -> str:
    """A share in per cent, of two significant digits."""
    return f"{in_digits(100.0 * share)} %"


def score_rows(dynamics: Dynamics, parameters: Floats, pieces: Sequence[Rows], motion: Sequence[Rows] = ()) -> Scores:
    """Scores over all rows of records, a free run in each; `motion` (default: these rows) sets the limits of runs."""
    runs, blew_up_at = [], None
    moving = pieces if dynamics.states else []
    limits = state_range(np.concatenate([rows.stack(dynamics.states) for rows in motion or pieces]))
    for rows in moving:
        first, _ = fitted_start(dynamics, parameters, rows, *limits)
        run, stopped, _ = mean_run(dynamics, parameters, first, rows.drive(*limits))
        runs.append(run)
        if stopped is not None and blew_up_at is None:
            blew_up_at = float(rows.time[stopped])
    free = {}
    for i, name in enumerate(dynamics.states):
        if all(name in rows.samples for rows in pieces):
            samples = np.concatenate([rows.samples[name] for rows in pieces])
            free[name] = normalised_error(np.concatenate([run[:, i] for run in runs]), samples)
    one_step = {}
    for target, terms, block in zip(dynamics.roles.targets, dynamics.terms, dynamics.blocks(), strict=True):
        pairs = [_predicted(target, terms, parameters[block], rows) for rows in pieces]
        found, given = (np.concatenate(part) for part in zip(*pairs, strict=True))
        one_step[target] = normalised_error(found, given)
    return Scores(sum(rows.n for rows in pieces), one_step, free, blew_up_at)


def _predicted(target: str, terms: Sequence[Expression], parameters: Floats, rows: Rows) -> tuple[Floats, Floats]:
    """Right-hand side and target; if the target was estimated, both as the smoother shows them, without the ends."""
    values, given = predicted_target(terms, parameters, rows.columns), rows.columns[target]
    if target.endswith(NEXT):  # the last row has no next sample
        return values[:-1], given[:-1]
    if target not in rows.estimated:
        return values, given
    smoothing = rows.estimated[target]
    inner = smoothing.inner(rows.n)
    return smoothing.follow(values[:, None])[inner, 0], given[inner]


def held_out_scores(dynamics: Dynamics, motion: Motion) -> Scores | None:
    """Scores on the rows held out; None where no rows were held out, or a record has no time."""
    if not motion.timed:
        return None
    whole = rows_of(motion, "a free run")
    pieces = [rows for rows in divided(motion, whole)[1] if rows.n >= LEAST_ROWS]
    if not pieces:
        return None
    roles = dynamics.roles
    names = [name for name in (*roles.states, *roles.targets) if all(name in rows.samples for rows in whole)]
    still = tuple(name for name in names if _spread(pieces, name) < STILL * _spread(whole, name))
    return replace(score_rows(dynamics, dynamics.mean, pieces, whole), still=still)


def _spread(pieces: Sequence[Rows], name: str) -> float:
    values = np.concatenate([rows.samples[name] for rows in pieces])
    present = values[np.isfinite(values)]
    return float(present.std()) if len(present) else np.nan
