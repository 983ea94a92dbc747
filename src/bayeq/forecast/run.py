"""Free runs: where the equations of motion go from an initial state, with bands from the posterior; as files too."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError, whole_number
from bayeq.figures.runs import draw_forecasts
from bayeq.figures.style import write_output
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import (
    ANYWHERE,
    GENEROUS,
    drawn_sines,
    fitted_start,
    mean_run,
    run_bands,
    state_range,
)
from bayeq.forecast.rows import (
    Courses,
    between,
    normalised_error,
    require_time,
    rows_of,
    window_of,
)
from bayeq.ode.rk4 import Drive, check_interpolation
from bayeq.records import Record
from bayeq.states import Sensors, Smooth, estimate_motion, without_lags
from bayeq.states.prepare import inputs_filled

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

# More records do not fit on a page.
MOST_DRAWN = 6


@dataclass(frozen=True, eq=False)
class Forecast:
    """A free run, and the band of runs with coefficients from their posterior and random forces for what is left out.

    Attributes
    ----------
    time : (n,) array
        [s].
    mean : mapping of str to (n,) array
        Each state along the run with the posterior means of the coefficients; NaN from `blew_up_at` on.
    low, high : mapping of str to (n,) array
        Pointwise 95 % band of the draws; infinite where more than 2.5 % of them have blown up. Empty without draws.
    draws : int
        Runs with drawn coefficients and forces.
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
    clock : str
        Unit of time, "samples" of maps.
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
    clock: str = "s"

    def plot(self) -> Figure:
        """The run, its band and what was measured, a panel per state.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        return draw_forecasts([("", self)], f"time [{self.clock}]")

    def table(self) -> pd.DataFrame:
        """Columns time, and of each state ``x``, ``x_low``, ``x_high`` and ``x_measured``, as far as known."""
        import pandas as pd

        columns = {"time": self.time}
        for name, mean in self.mean.items():
            others = {"low": self.low.get(name), "high": self.high.get(name), "measured": self.measured.get(name)}
            columns[name] = mean
            columns |= {f"{name}_{what}": values for what, values in others.items() if values is not None}
        return pd.DataFrame(columns)

    def __str__(self) -> str:
        """The free run in a few lines."""
        span = f"{self.time[0]:.6g} to {self.time[-1]:.6g} {self.clock}"
        lines = [f"free run over {len(self.time)} rows, {span}"]
        if self.blew_up_at is not None:
            lines.append(f"blew up at {self.blew_up_at:.6g} {self.clock}")
        for name, error in self.nrmse.items():
            lines.append(f"{name}: normalised RMS error {100 * error:.3g} %")
        if self.draws:
            lines.append(f"{self.draws} runs with coefficients from the posterior, {self.blown} of them blew up")
        return "\n".join(lines)


# The parameters are those of `Equations.simulate`, which users call by name.
def forecast(
    dynamics: Dynamics,
    record: Record,
    smooth: Smooth,
    sensors: Sensors | None = None,
    *,
    initial: Mapping[str, float] | None = None,
    draws: int = 200,
    seed: int = 0,
    start: int = 0,
    rows: int | None = None,
    interpolation: Courses = "cubic",
    units: Mapping[str, str] | None = None,
) -> Forecast:
    """Free run over rows of a record; see `bayeq.Equations.simulate`."""
    check_interpolation(interpolation)
    time = require_time(record, "a free run")
    raw = record
    if sensors is not None and sensors.lags:
        record = without_lags(record, sensors.lags, whole=True)
    window = window_of(record, start, rows)
    draws = whole_number("draws", draws, 0)
    part = inputs_filled(record.slice(window.start, window.stop), dynamics.inputs)
    part.require_finite(dynamics.inputs)
    time = time[window]
    inputs = _inputs(dynamics, record, part, window, interpolation)
    first, low, high = _beginning(dynamics, raw, (smooth, sensors, interpolation), window, initial)
    mean, stopped, drive = mean_run(dynamics, dynamics.mean, first, Drive.over(time, inputs, low, high))
    bottom: Mapping[str, Floats] = {}
    top: Mapping[str, Floats] = {}
    blown = 0
    if draws:
        rng, laws = np.random.default_rng(seed), dynamics.laws
        drawn = dynamics.draw(draws, rng)
        forces = [drawn_sines(law.posterior, draws, rng) for law in laws if law.posterior.error_lines]
        forced = Dynamics.of(laws, dynamics.inputs, dynamics.intercepts, dynamics.timed, forced=True)
        below, above, blown = run_bands(forced, drawn, first, drive, forces)
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
        clock="samples" if dynamics.roles.discrete else "s",
    )


def _inputs(dynamics: Dynamics, record: Record, part: Record, window: slice, interpolation: Courses) -> Floats:
    """Inputs between the rows of a window, by what is known of them outside it too; `part` is the window, filled in."""
    whole = all(np.isfinite(record[name]).all() for name in dynamics.inputs)
    source = record if whole else part
    columns = {name: np.asarray(source[name]) for name in dynamics.inputs}
    out = between(dynamics.roles, require_time(source, "a free run"), columns, interpolation)
    return out[window] if whole else out


def _beginning(
    dynamics: Dynamics,
    record: Record,
    how: tuple[Smooth, Sensors | None, Courses],
    window: slice,
    initial: Mapping[str, float] | None,
) -> tuple[Floats, Floats, Floats]:
    """Initial state, and the range in which runs go on."""
    if initial is not None and not hasattr(initial, "items"):
        names = ", ".join(f"{name!r}: ..." for name in dynamics.states)
        raise InputError(f"initial: states go by their names, initial={{{names}}}")
    given = dict(initial or {})
    for name, value in given.items():
        if name not in dynamics.states:
            raise UnknownNameError("state", name, dynamics.states, where="initial")
        if not math.isfinite(value):
            raise InputError(f"initial: {name} must be finite, not {value!r}")
    needed = [name for name in dynamics.states if name not in given]
    rows = None
    # where all channels are measured that the states come from
    if needed and all(name in record.channels for name in dynamics.roles.measured):
        smooth, sensors, interpolation = how
        motion = estimate_motion([record], dynamics.roles, smooth, sensors=sensors)
        (rows,) = rows_of(motion, "a free run", interpolation)
        times = require_time(record, "a free run")
        row = rows.nearest(times[window.start])
        columns = rows.columns
    else:
        row = window.start
        columns = _measured_states(dynamics, record, row, needed)
    start = np.array([given.get(name, columns[name][row] if name in columns else 0.0) for name in dynamics.states])
    low, high = np.full(len(start), -ANYWHERE), np.full(len(start), ANYWHERE)
    for i, name in enumerate(dynamics.states):
        if name in columns and np.isfinite(columns[name]).any():
            (low[i],), (high[i],) = state_range(columns[name][:, None])
    # a start far from what was measured is the caller's wish
    margin = GENEROUS * np.abs(start)
    low, high = np.minimum(low, start - margin), np.maximum(high, start + margin)
    if rows is not None and not given:
        part = rows.part(slice(row, rows.nearest(times[window.stop - 1]) + 1))
        start = fitted_start(dynamics, dynamics.mean, part, low, high)
    return start, low, high


def _measured_states(dynamics: Dynamics, record: Record, row: int, needed: Sequence[str]) -> Mapping[str, Floats]:
    """Columns of the states that happen to be measured; those needed must be, in a row."""
    measured = {name: record[name] for name in dynamics.states if name in record.channels}
    for name in needed:
        if name not in measured or not np.isfinite(measured[name][row]):
            raise InputError(
                f"{record.name or 'record'}: the initial {name!r} is not measured: give"
                f" initial={{{', '.join(f'{n!r}: ...' for n in needed)}}}"
            )
    return measured


def write_forecasts(file: Path, runs: Sequence[tuple[str, Forecast]]) -> None:
    """Write a table (.csv) of the free runs of some records, by their names, or a figure (of the first six).

    The suffix, which `bayeq.figures.style.require_suffix` has checked, says what to write.
    """
    several = len(runs) > 1

    def table() -> pd.DataFrame:
        import pandas as pd

        tables = [run.table() for _, run in runs]
        if several:
            for (name, _), one in zip(runs, tables, strict=True):
                one.insert(0, "record", name)
        return pd.concat(tables, ignore_index=True)

    def figure() -> Figure:
        return draw_forecasts([(name if several else "", run) for name, run in runs[:MOST_DRAWN]])

    write_output(file, table, figure)
