"""Free runs: where the equations of motion go from an initial state, with bands from the posterior."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import NDArray

from bayeq.dynamics import Dynamics, require_time
from bayeq.errors import InputError, UnknownNameError
from bayeq.free_run import GENEROUS, mean_run, run_bands, state_range
from bayeq.integrate import Interpolation, interpolant
from bayeq.posterior import Posterior
from bayeq.records import Record
from bayeq.report.forecast import Panel, draw_forecast
from bayeq.report.style import require_matplotlib, style
from bayeq.states import Smooth, derive_all
from bayeq.states.grid import on_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Forecast", "Scores", "check_interpolation", "forecast", "normalised_error", "state_columns"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Forecast:
    """A free run, and the band of runs with coefficients drawn from their posterior.

    Attributes
    ----------
    time : (n,) array
        [s].
    mean : mapping of str to (n,) array
        Each state along the run with the posterior means of the coefficients; NaN from `blew_up_at` on.
    low, high : mapping of str to (n,) array
        Pointwise 95 % band of the draws; infinite where more than 2.5 % of them have blown up. Empty without draws.
    draws : int
        Runs with drawn coefficients.
    blown : int
        How many of them blew up.
    blew_up_at : float or None
        Time [s] at which the run with mean coefficients left a thousand times the range of the record, or became
        infinite.
    nrmse : mapping of str to float
        For each measured state the root mean squared error of the run over the standard deviation of the channel;
        infinite if the run blew up.
    measured : mapping of str to (n,) array
        The record's samples of the states.
    units : mapping of str to str
        Units of states, where known.
    """

    time: Floats
    mean: Mapping[str, Floats]
    low: Mapping[str, Floats]
    high: Mapping[str, Floats]
    draws: int
    blown: int
    blew_up_at: float | None
    nrmse: Mapping[str, float]
    measured: Mapping[str, Floats]
    units: Mapping[str, str]

    def plot(self) -> Figure:
        """The run, its band and what was measured, a panel per state.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        require_matplotlib()
        panels = [
            Panel(
                name if name not in self.units else f"{name} [{self.units[name]}]",
                mean,
                self.low.get(name),
                self.high.get(name),
                self.measured.get(name),
            )
            for name, mean in self.mean.items()
        ]
        with style():
            return draw_forecast(self.time, panels, self.blew_up_at)

    def __str__(self) -> str:
        """The free run in a few lines."""
        span = f"{self.time[0]:.6g} to {self.time[-1]:.6g} s"
        lines = [f"free run over {len(self.time)} rows, {span}"]
        if self.blew_up_at is not None:
            lines.append(f"blew up at {self.blew_up_at:.6g} s")
        for name, error in self.nrmse.items():
            lines.append(f"{name}: normalised RMS error {100 * error:.3g} %")
        if self.draws:
            lines.append(f"{self.draws} runs with coefficients from the posterior, {self.blown} of them blew up")
        return "\n".join(lines)


@dataclass(frozen=True)
class Scores:
    """How well equations do on some rows of a record.

    Attributes
    ----------
    start, rows : int
        First row, and how many.
    one_step : mapping of str to float
        For each equation the root mean squared error of the target, given the states and inputs of each row, over the
        standard deviation of the target: the error of the equation.
    free_run : mapping of str to float
        For each measured state the same of the free run from the state of the first row.
    blew_up_at : float or None
        Time [s] at which the free run left any reasonable range.
    """

    start: int
    rows: int
    one_step: Mapping[str, float]
    free_run: Mapping[str, float]
    blew_up_at: float | None

    def __str__(self) -> str:
        """Both scores in a line each."""
        lines = [f"rows {self.start + 1} to {self.start + self.rows}, normalised RMS errors"]
        for label, scores in (("one step", self.one_step), ("free run", self.free_run)):
            lines.append(f"{label}: {', '.join(f'{name} {100 * error:.3g} %' for name, error in scores.items())}")
        if self.blew_up_at is not None:
            lines.append(f"the free run blew up at {self.blew_up_at:.6g} s")
        return "\n".join(lines)


def forecast(
    dynamics: Dynamics,
    posteriors: Sequence[Posterior],
    record: Record,
    smooth: Smooth,
    *,
    initial: Mapping[str, float] | None = None,
    draws: int = 200,
    seed: int = 0,
    start: int = 0,
    rows: int | None = None,
    interpolation: Interpolation = "cubic",
    units: Mapping[str, str] | None = None,
) -> Forecast:
    """Free run over rows of a record; see `bayeq.Equations.simulate`."""
    check_interpolation(interpolation)
    time = require_time(record, "a free run")
    window = _window(record, start, rows)
    draws = _count("draws", draws, 0)
    part = record.slice(window.start, window.stop)
    part.require_finite(dynamics.inputs)
    time = time[window]
    first, low, high = _beginning(dynamics, record, smooth, window.start, initial)
    samples = np.column_stack([part[name] for name in dynamics.inputs]) if dynamics.inputs else np.empty((part.n, 0))
    inputs = interpolant(time, samples, interpolation)
    parameters = dynamics.means(posteriors)
    step, mean, stopped = mean_run(dynamics, parameters, first, inputs, time, low, high)
    bottom: Mapping[str, Floats] = {}
    top: Mapping[str, Floats] = {}
    blown = 0
    if draws:
        drawn = dynamics.draw(posteriors, draws, np.random.default_rng(seed))
        below, above, blown = run_bands(dynamics, drawn, first, inputs, time, step, low, high)
        bottom = dict(zip(dynamics.states, below.T, strict=True))
        top = dict(zip(dynamics.states, above.T, strict=True))
    measured = {name: part[name] for name in dynamics.states if name in part.channels}
    return Forecast(
        time=time,
        mean=dict(zip(dynamics.states, mean.T, strict=True)),
        low=bottom,
        high=top,
        draws=draws,
        blown=blown,
        blew_up_at=None if stopped is None else float(time[stopped]),
        nrmse={
            name: normalised_error(mean[:, dynamics.states.index(name)], samples) for name, samples in measured.items()
        },
        measured=measured,
        units={name: unit for name, unit in (units or {}).items() if name in dynamics.states},
    )


def check_interpolation(kind: str) -> None:
    """Raise an InputError if there is no such interpolation."""
    if kind not in get_args(Interpolation):
        raise InputError(f"interpolation must be one of {', '.join(get_args(Interpolation))}, got {kind!r}")


def normalised_error(run: Floats, samples: Floats) -> float:
    """Root mean squared error over the samples' standard deviation; infinite for a run that does not reach the end."""
    present = np.isfinite(samples)
    error = run[present] - samples[present]
    if not len(error) or not np.isfinite(error).all():
        return math.inf
    spread = float(samples[present].std())
    rms = float(np.sqrt(np.mean(error**2)))
    return rms / spread if spread > 0 else (math.inf if rms > 0 else 0.0)


def state_columns(dynamics: Dynamics, record: Record, smooth: Smooth) -> tuple[Floats, Mapping[str, Floats], Record]:
    """States, targets and inputs of a record, as `discover` has them, and the record with dropped samples put back.

    Returns
    -------
    time : (n,) array
    columns : mapping of str to (n,) array
    record : Record
        NaN in rows that had been dropped.
    """
    time = require_time(record, "a free run")
    columns = derive_all([record], dynamics.chains, dynamics.inputs, smooth)[0].columns
    if len(columns[dynamics.states[0]]) == record.n:
        return time, columns, record
    measured = [name for chain in dynamics.chains for name in chain.measured if name is not None]
    filled = on_grid(record, measured, dynamics.inputs)
    return require_time(filled, "a free run"), columns, filled


def _window(record: Record, start: int, rows: int | None) -> slice:
    start = _count("start", start, 0)
    if start >= record.n:
        raise InputError(f"start is row {start}, but {record.name or 'the record'} has {record.n} rows")
    rows = record.n - start if rows is None else _count("rows", rows, 2)
    if start + rows > record.n or rows < 2:
        raise InputError(
            f"a free run over {rows} rows from row {start} needs 2 rows or more, and at most the {record.n} that"
            f" {record.name or 'the record'} has"
        )
    return slice(start, start + rows)


def _count(what: str, value: int, least: int) -> int:
    try:
        number = operator.index(value)
    except TypeError:
        raise InputError(f"{what} must be a whole number, not {value!r}") from None
    if number < least:
        raise InputError(f"{what} must be at least {least}, not {number}")
    return number


def _beginning(
    dynamics: Dynamics, record: Record, smooth: Smooth, row: int, initial: Mapping[str, float] | None
) -> tuple[Floats, Floats, Floats]:
    """Initial state, and the range in which runs go on."""
    given = dict(initial or {})
    for name, value in given.items():
        if name not in dynamics.states:
            raise UnknownNameError("state", name, dynamics.states, where="initial")
        if not math.isfinite(value):
            raise InputError(f"initial: {name} must be finite, not {value!r}")
    columns, row = _known_states(dynamics, record, smooth, row, [n for n in dynamics.states if n not in given])
    start = np.array([given.get(name, columns[name][row] if name in columns else 0.0) for name in dynamics.states])
    low, high = np.full(len(start), -math.inf), np.full(len(start), math.inf)
    for i, name in enumerate(dynamics.states):
        if name in columns and np.isfinite(columns[name]).any():
            (low[i],), (high[i],) = state_range(columns[name][:, None])
    # a start far from what was measured is the caller's wish
    margin = GENEROUS * np.abs(start)
    return start, np.minimum(low, start - margin), np.maximum(high, start + margin)


def _known_states(
    dynamics: Dynamics, record: Record, smooth: Smooth, row: int, needed: Sequence[str]
) -> tuple[Mapping[str, Floats], int]:
    """Columns of the states that are measured or can be estimated, and the row among them of a row of the record."""
    channels = [name for chain in dynamics.chains for name in chain.measured if name is not None]
    if needed and all(name in record.channels for name in channels):
        time, columns, _ = state_columns(dynamics, record, smooth)
        assert record.time is not None
        return columns, int(np.argmin(np.abs(time - record.time[row])))
    measured = {name: record[name] for name in dynamics.states if name in record.channels}
    for name in needed:
        if name not in measured or not np.isfinite(measured[name][row]):
            raise InputError(
                f"{record.name or 'record'}: the initial {name!r} is not measured: give"
                f" initial={{{', '.join(f'{n!r}: ...' for n in needed)}}}"
            )
    return measured, row
