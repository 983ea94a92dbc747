"""Free runs of dynamics: initial states, runs with a suitable step, bands of many runs, and windows of records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError, UnknownNameError, in_digits, whole_number
from bayeq.expressions.parse import EARLIER
from bayeq.figures.runs import draw_forecasts
from bayeq.figures.style import joined, write_output
from bayeq.forecast.dynamics import TOLERANCE, Dynamics, finest_step, normal_draws, spreads
from bayeq.forecast.rows import Courses, Rows, between, normalised_error, require_time, rows_of, window_of
from bayeq.inference.posterior import Projected
from bayeq.numerics.rk4 import Drive, check_interpolation, free_runs, interpolant, shoot
from bayeq.records import Record
from bayeq.states import Sensors, Smooth, corrected, estimate_motion, rates
from bayeq.states.prepare import inputs_filled

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

# Most records on a page.
MOST_DRAWN = 6


@dataclass(frozen=True, eq=False)
class Forecast:
    """A free run, and the band of runs with coefficients from their posterior and random forces for the model error.

    Where the record has samples of the motion, the band counts the noise of inputs and the error of the start too.

    Attributes
    ----------
    time : (n,) array
        Times of the rows [s].
    mean : mapping of str to (n,) array
        Each state along the run with the posterior means of the coefficients; NaN from `blew_up_at` on.
    low, high : mapping of str to (n,) array
        Pointwise 95 % band of the draws; infinite where more than 2.5 % of them have blown up. Empty without draws.
    draws : int
        Runs with drawn coefficients and forces, and noise of inputs and starts as far as it counts.
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
        return draw_forecasts([("", self)])

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
            lines.append(f"{name}: normalised RMS error {in_digits(100 * error, 3)} %")
        if self.draws:
            lines.append(f"{self.draws} runs with coefficients from the posterior, {self.blown} of them blew up")
        return "\n".join(lines)


# The parameters are those of `Equations.simulate`, which users call by name.
def forecast(
    dynamics: Dynamics,
    record: Record,
    smooth: Smooth,
    sensors: Sensors,
    *,
    initial: Mapping[str, float] | None = None,
    draws: int = 200,
    seed: int = 0,
    start: int = 0,
    rows: int | None = None,
    interpolation: Courses,
    units: Mapping[str, str],
    noise: Mapping[str, float],  # standard deviations of inputs' noise, as far as they are known
) -> Forecast:
    """Free run over rows of a record; see `bayeq.Equations.simulate`."""
    check_interpolation(interpolation)
    time, roles, raw = require_time(record, "a free run"), dynamics.roles, record
    record = corrected(record, sensors, whole=True)
    window = window_of(record, start, rows)
    draws = whole_number("draws", draws, 0)
    part = inputs_filled(record.slice(window.start, window.stop), roles.inputs)
    part.require_finite(roles.inputs)
    # inputs outside the window are used too, unless inputs had to be filled in
    whole = all(np.isfinite(record[name]).all() for name in roles.inputs)
    source = record if whole else part
    inputs = between(roles, require_time(source, "a free run"), source.channels, interpolation)
    first, error, low, high = _beginning(dynamics, raw, smooth, sensors, interpolation, window, initial)
    driven = Drive.over(time[window], inputs[window] if whole else inputs, low, high)
    mean, stopped, drive = mean_run(dynamics, dynamics.mean, first, driven)

    def by_state(values: Floats) -> Mapping[str, Floats]:
        return dict(zip(roles.states, values.T, strict=True))

    blown = 0
    if draws:
        rng, laws = np.random.default_rng(seed), dynamics.laws
        drawn = dynamics.draw(draws, rng)
        forces = [
            drawn_sines(law.posterior.projected, draws, rng)
            for law in laws
            if law.posterior.projected and law.posterior.error_lines
        ]
        forced = Dynamics.of(laws, roles, dynamics.intercepts, forced=True)
        # inputs of a record without the motion are those of a plan
        sd = np.array([noise.get(name, 0.0) if error is not None else 0.0 for name in roles.inputs])
        starts = np.tile(first, (draws, 1)) if error is None else normal_draws(first, error, draws, rng)
        below, above, blown = run_bands(forced, drawn, starts, drive, forces, sd, rng)
    run = by_state(mean)
    measured = {name: part[name] for name in run if name in part.channels}
    return Forecast(
        time=time[window],
        mean=run,
        low=by_state(below) if draws else {},
        high=by_state(above) if draws else {},
        draws=draws,
        blown=blown,
        blew_up_at=None if stopped is None else float(time[window][stopped]),
        nrmse={name: normalised_error(run[name], samples) for name, samples in measured.items()},
        measured=measured,
        units={name: unit for name, unit in units.items() if name in run},
        clock="samples" if roles.discrete else "s",
    )


def _beginning(
    dynamics: Dynamics,
    record: Record,
    smooth: Smooth,
    sensors: Sensors,
    interpolation: Courses,
    window: slice,
    initial: Mapping[str, float] | None,
) -> tuple[Floats, Floats | None, Floats, Floats]:
    """Initial state, its covariance if the run was fitted, and lowest and highest state within which runs continue."""
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
    # if all channels are there that the states are estimated from
    if needed and all(name in record.channels for name in dynamics.roles.measured):
        motion = estimate_motion([record], dynamics.roles, smooth, sensors=sensors)
        (rows,) = rows_of(motion, "a free run", interpolation)
        times = require_time(record, "a free run")
        row = rows.nearest(times[window.start])
        columns = rows.columns
    else:
        row = window.start
        columns = {name: record[name] for name in dynamics.states if name in record.channels}
        for name in needed:
            if name not in columns or not np.isfinite(columns[name][row]):
                raise InputError(
                    f"{record.label}: the initial {name!r} is not measured: give"
                    f" initial={{{', '.join(f'{n!r}: ...' for n in needed)}}}"
                )
    start = np.array([given.get(name, columns[name][row] if name in columns else 0.0) for name in dynamics.states])
    low, high = np.full(len(start), -ANYWHERE), np.full(len(start), ANYWHERE)
    for i, name in enumerate(dynamics.states):
        if name in columns and np.isfinite(columns[name]).any():
            (low[i],), (high[i],) = state_range(columns[name][:, None])
    # a start far from what was measured is the caller's wish
    margin = GENEROUS * np.abs(start)
    low, high = np.minimum(low, start - margin), np.maximum(high, start + margin)
    error = None
    if rows is not None and not given:
        part = rows.part(slice(row, rows.nearest(times[window.stop - 1]) + 1))
        start, error = fitted_start(dynamics, dynamics.mean, part, low, high)
    return start, error, low, high


def write_forecasts(file: Path, runs: Sequence[tuple[str, Forecast]]) -> None:
    """Write free runs of records, by names, as a table (.csv) or a figure (of the first six), as the suffix says."""
    if len(runs) == 1:
        write_output(file, runs[0][1].table, lambda: draw_forecasts([("", runs[0][1])]))
    else:
        write_output(file, lambda: joined("record", runs), lambda: draw_forecasts(runs[:MOST_DRAWN]))


# A run has blown up when a state leaves its measured range by more than this many times the larger of range and
# magnitude.
GENEROUS = 1e3

# Range of a state without samples: values that can be squared.
ANYWHERE = 1e150

# Share of the runs beyond either end of a band.
TAIL = 0.025

# Most numbers held in memory at once while the bands are computed.
BLOCK = 4_000_000

# A step of integration is judged on this many rows at most.
JUDGED_ROWS = 2000

# Fewest rows of a window, and of the first period, to which an initial state is fitted.
LEAST_ROWS = 8

# Assumed errors of samples, and of the state read off at the first row, as shares of the state's spread.
SAMPLE = 0.05
READ = 0.1

# Gauss-Newton steps, and the change of the state, as a share of its spread, that ends them.
MOST_STEPS = 20
ENOUGH = 1e-6

# Number of windows over all records together.
WINDOWS = 12


def state_range(states: Floats) -> tuple[Floats, Floats]:
    """Limits (d,) at which runs stop: 1000 times the larger of range and magnitude of the states (n, d) beyond either
    end; 1e150 if all are 0."""
    low, high = np.nanmin(states, axis=0), np.nanmax(states, axis=0)
    largest = np.maximum(high - low, np.maximum(np.abs(low), np.abs(high)))
    margin = np.where(largest > 0, GENEROUS * largest, ANYWHERE)
    return low - margin, high + margin


def mean_run(dynamics: Dynamics, parameters: Floats, first: Floats, drive: Drive) -> tuple[Floats, int | None, Drive]:
    """A free run from a state (d,) with parameters (p,): states (n, d), the row where it left its range, and the drive.

    States are NaN from that row on (None if it stayed inside); the drive has the step that the run needed.
    """
    n = len(drive.inputs)
    if dynamics.roles.discrete:
        drive = drive._replace(step=0.0)
    while True:
        stopped, out = np.zeros(1, dtype=np.uint32), np.empty((1, n, len(first)))
        free_runs(dynamics.program(), drive, parameters[None], first[None].copy(), stopped, out)
        reached = int(stopped[0]) - 1 if stopped[0] else n
        judged = min(max(reached, 2), JUDGED_ROWS)
        finer = finest_step(dynamics, parameters, out[0, :judged], drive.part(0, judged))
        if finer >= 0.999 * drive.step:
            return out[0], reached if reached < n else None, drive
        drive = drive._replace(step=finer)
        if dynamics.jumps:
            drive = drive._replace(enough=TOLERANCE * spreads(out[0, :judged]))


def typical_period(dynamics: Dynamics, pieces: Sequence[Rows]) -> float:
    """Shortest of the chains' periods [s], 2 pi sd(x)/sd(x'); of maps [samples] by the changes in place of x'."""
    periods = []
    for law in dynamics.laws:
        if law.chain.static:
            continue
        name, rate = law.chain.names[-2:] if law.chain.discrete else law.chain.names[:2]
        low, above = (np.concatenate([rows.columns[one] for rows in pieces]) for one in (name, rate))
        if law.chain.discrete:
            above = above - low
        spread = abs(rates(law.chain, law.unit_gains)[0]) * float(above.std())
        periods.append(2.0 * math.pi * float(low.std()) / spread if spread > 0 else math.inf)
    return min(periods)


def fitted_start(
    dynamics: Dynamics, parameters: Floats, rows: Rows, low: Floats, high: Floats
) -> tuple[Floats, Floats | None]:
    """The initial state (d,) with which a free run follows the first period of some rows best, and its covariance.

    A state read off at the first row carries that row's noise, and the run keeps the error. It is therefore estimated
    from the samples of the first period (as output-error methods do; Ljung, System Identification, 1999, section 16.3),
    with the state that was read off as a weak prior; that state is returned, without a covariance, if no run from it
    can be compared.
    Runs go on from `low` to `high`, (d,) each; parameters are (p,).
    """
    whole = rows.stack(dynamics.states)
    first, spread = whole[0], whole.std(axis=0)
    scale = np.where(spread > 0, spread, 1.0)
    known = np.array([i for i, name in enumerate(dynamics.states) if name in rows.samples], dtype=np.uint32)
    if rows.n < LEAST_ROWS or not len(known):
        return first, None
    drive = rows.drive(low, high)
    n = int(min(max(typical_period(dynamics, [rows]) / drive.step, LEAST_ROWS), rows.n))
    chosen = np.column_stack([rows.samples[dynamics.states[i]][:n] for i in known])
    drive = drive.part(0, n)
    drive = drive._replace(step=finest_step(dynamics, parameters, whole[:n], drive))
    program = dynamics.program()
    # samples before the first one of a map are unknown
    back = [int(one["back"]) if (one := EARLIER.fullmatch(name)) else 0 for name in dynamics.states]
    read = np.where(np.array(back) > rows.time[0], 1.0, READ) if dynamics.roles.discrete else READ

    def errors(start: Floats) -> tuple[Floats, Floats] | None:
        """Weighted errors of samples and state, and their derivatives by the state."""
        values = np.empty(chosen.shape)
        jacobian = np.empty((*chosen.shape, len(start) + len(parameters)))
        done = shoot(program, drive, parameters, start, known, values, jacobian)
        if done < n or not np.isfinite(jacobian).all():
            return None
        weight = 1.0 / (SAMPLE * scale[known])
        there = np.isfinite(chosen)
        left = np.where(there, (chosen - values) * weight, 0.0)
        slopes = np.where(there[:, :, None], jacobian[:, :, : len(start)] * weight[:, None], 0.0)
        prior = np.diag(1.0 / (read * scale))
        return (
            np.concatenate([left.ravel(), prior @ (first - start)]),
            np.concatenate([slopes.reshape(-1, len(start)), prior]),
        )

    best, found = first, errors(first)
    for _ in range(MOST_STEPS):
        if found is None:
            return first, None
        left, slopes = found
        change = np.linalg.lstsq(slopes, left)[0]
        trial = errors(best + change)
        if trial is None or not float(trial[0] @ trial[0]) < float(left @ left):
            break
        best, found = best + change, trial
        if (np.abs(change) <= ENOUGH * scale).all():
            break
    assert found is not None
    left, slopes = found
    return best, np.linalg.pinv(slopes.T @ slopes) * float(left @ left) / np.count_nonzero(np.isfinite(chosen))


def run_bands(
    dynamics: Dynamics,
    parameters: Floats,
    starts: Floats,
    drive: Drive,
    forces: Sequence[Floats],
    noise: Floats,
    rng: np.random.Generator,
) -> tuple[Floats, Floats, int]:
    """Pointwise 95 % band of runs with different parameters (runs, p) and starts (runs, d), under different forces.

    `forces` are arrays (runs, M, 3) from `drawn_sines`, one for each force of `dynamics`; `noise` (m,) are standard
    deviations of white noise that is drawn for each input. Integrated with the step of `drive`. Returns low and high,
    (n, d) each, infinite where more than 2.5 % of the runs have left the range, and the number of runs that left it.
    """
    (runs, d), n, noisy = starts.shape, len(drive.inputs), np.flatnonzero(noise)
    current, stopped = starts.copy(), np.zeros(runs, dtype=np.uint32)
    drawing = rng.spawn(runs) if len(noisy) else []  # one generator a run, so that blocks do not matter
    latest = noise[noisy] * np.array([one.standard_normal(len(noisy)) for one in drawing])
    bottom, top = np.empty((n, d)), np.empty((n, d))
    time = np.append(0.0, np.cumsum(drive.intervals))
    below, above = math.floor(TAIL * (runs - 1)), math.ceil((1.0 - TAIL) * (runs - 1))
    size = max(2, BLOCK // (runs * d))
    for row in range(0, max(n - 1, 1), size - 1):  # a block starts with the last row of the one before
        end = min(row + size, n)
        out = np.empty((runs, end - row, d))
        program, part = dynamics.program(), drive.part(row, end)
        for one in (slice(run, run + 1) for run in range(runs)):
            driven = pushed(part, time[row:end], [sines[one.start] for sines in forces])
            if len(noisy):
                drawn = noise[noisy] * drawing[one.start].standard_normal((end - row - 1, len(noisy)))
                errors = np.concatenate([latest[one], drawn])
                latest[one] = errors[-1]
                inputs = driven.inputs if forces else driven.inputs.copy()
                inputs[:, noisy] += interpolant(time[row:end], errors, "linear")
                driven = driven._replace(inputs=inputs)
            free_runs(program, driven, parameters[one], current[one], stopped[one], out[one])
        # a run that blew up may be anywhere
        gone = np.isnan(out)
        bottom[row:end] = np.partition(np.where(gone, -math.inf, out), below, axis=0)[below]
        top[row:end] = np.partition(np.where(gone, math.inf, out), above, axis=0)[above]
    return bottom, top, int(np.count_nonzero(stopped))


def drawn_sines(own: Projected, count: int, rng: np.random.Generator) -> Floats:
    """Random forces of the size and spectrum of an equation's error, sums of sines (Shinozuka and Jan 1972).

    Returns amplitude, angular frequency [rad/s] and phase of the M sines of each force, (count, M, 3). Each force has
    its own frequencies: otherwise a resonance could fall between the same few lines in all runs.
    """
    size, first = len(own.error_lines), np.arange(len(own.error_lines))
    levels = (first + rng.random((count, size))) / size
    frequency = np.interp(levels, (first + 0.5) / size, own.error_lines)
    a, b = own.error_sd / np.sqrt(size) * rng.standard_normal((2, count, size))
    return np.stack([np.hypot(a, b), 2.0 * np.pi * frequency, np.arctan2(b, a)], axis=2)


def pushed(drive: Drive, time: Floats, forces: Sequence[Floats]) -> Drive:
    """The drive of a run with forces, (M, 3) each, appended to its inputs, at the times [s] of its samples."""
    if not forces:
        return drive
    parts = [np.cos(time[:, None] * turn - phase) @ size for size, turn, phase in (sines.T for sines in forces)]
    between = interpolant(time, np.column_stack(parts), "cubic")
    return drive._replace(inputs=np.concatenate([drive.inputs, between], axis=1))


def window_runs(
    dynamics: Dynamics,
    pieces: Sequence[Rows],
    duration: float,
    theta: Floats | None = None,
    unit: Floats | None = None,
    off: Floats | float = 0.0,
) -> list[tuple[Floats, Floats]]:
    """Free runs over windows of `duration` [s], and the states of the rows there, (m, d) each, in units of `unit`.

    Each starts at the states of its first row plus `off` (d,). Windows are at most half a record, and overlap in a
    short one; there are none if no record is long enough. Steps of time may be uneven. By default the parameters
    `theta` (p,) are their posterior means, and the unit of each state (d,) its spread over these rows.
    """
    theta = dynamics.mean if theta is None else theta
    states = [rows.stack(dynamics.states) for rows in pieces]
    whole = np.concatenate(states)
    spread = whole.std(axis=0) if unit is None else unit
    scale = np.where(spread > 0, spread, 1.0)
    limits = state_range(np.concatenate([whole, [-scale], [scale]]))
    least = 2 if dynamics.roles.discrete else LEAST_ROWS  # a map may be chaotic from one sample to the next
    out = []
    for rows, known in zip(pieces, states, strict=True):
        drive = rows.drive(*limits)
        intervals = duration / drive.step
        length = min(round(intervals) + 1 if math.isfinite(intervals) else rows.n, rows.n // 2)
        if length < least:
            continue
        count = max(1, round(WINDOWS * rows.n / len(whole)))
        for first in np.linspace(0, rows.n - length, count).astype(int):
            end = first + length
            run, _, needed = mean_run(dynamics, theta, known[first] + off, drive.part(first, end))
            # a step that another window needed is not too long for this one
            drive = drive._replace(step=needed.step, enough=needed.enough)
            out.append((run / scale, known[first:end] / scale))
    return out


def apart(pairs: Iterable[tuple[Floats, Floats]]) -> float:
    """Root mean square difference of pairs, the median of them; infinite for one that blew up, NaN for none."""
    squares = [float(np.mean((one - other) ** 2)) for one, other in pairs]
    roots = [math.sqrt(square) if math.isfinite(square) else math.inf for square in squares]
    return float(np.median(roots)) if roots else math.nan
