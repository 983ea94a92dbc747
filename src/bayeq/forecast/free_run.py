"""Free runs of dynamics: one with a step that suits it, and the band of many."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics, finest_step
from bayeq.ode.rk4 import free_runs

__all__ = ["ANYWHERE", "GENEROUS", "mean_run", "run_bands", "state_range"]

Floats = NDArray[np.float64]

# A run has blown up where a state is further from its measured range than so many times the range.
GENEROUS = 1e3

# The range of a state of which nothing is known: what can be squared.
ANYWHERE = 1e150

# Bands are the runs' central share.
TAIL = 0.025

# Numbers held at once for the bands.
BLOCK = 4_000_000

# A step of integration is judged on this many rows at most.
JUDGED_ROWS = 2000


def state_range(states: Floats) -> tuple[Floats, Floats]:
    """Where runs are given up: a thousand times the range of the states (n, d), on either side.

    Of a state that was zero throughout nothing is known.
    """
    low, high = np.nanmin(states, axis=0), np.nanmax(states, axis=0)
    largest = np.maximum(high - low, np.maximum(np.abs(low), np.abs(high)))
    margin = np.where(largest > 0, GENEROUS * largest, ANYWHERE)
    return low - margin, high + margin


def mean_run(
    dynamics: Dynamics, parameters: Floats, first: Floats, inputs: Floats, time: Floats, low: Floats, high: Floats
) -> tuple[float, Floats, int | None]:
    """A free run, with a step found on the way.

    The run itself is where the step is judged: taken with whole sampling intervals at first, and anew where that is
    coarse.

    Parameters
    ----------
    dynamics : Dynamics
        The right-hand side.
    parameters : (p,) array
        Its parameters.
    first : (d,) array
        Initial state.
    inputs : (n, m, 4) array
        From `bayeq.ode.rk4.interpolant`.
    time : (n,) array
        [s].
    low, high : (d,) arrays
        Range in which the run goes on.

    Returns
    -------
    step : float
        Longest step [s].
    states : (n, d) array
        NaN from where the run left the range.
    stopped : int or None
        The row where it did.
    """
    step = float(np.median(np.diff(time)))
    while True:
        current, stopped = first[None].copy(), np.zeros(1, dtype=np.uint32)
        out = np.empty((1, len(time), len(first)))
        _run(dynamics, parameters[None], current, stopped, inputs, time, step, low, high, out)
        reached = int(stopped[0]) - 1 if stopped[0] else len(time)
        rows = slice(0, min(max(reached, 2), JUDGED_ROWS))
        finer = finest_step(dynamics, parameters, out[0, rows], inputs[rows], time[rows])
        if finer >= 0.999 * step:
            return step, out[0], reached if reached < len(time) else None
        step = finer


def _run(
    dynamics: Dynamics,
    parameters: Floats,
    current: Floats,
    stopped: NDArray[np.uint32],
    inputs: Floats,
    time: Floats,
    step: float,
    low: Floats,
    high: Floats,
    out: Floats,
) -> None:
    tape = dynamics.tape
    free_runs(
        tape.code, tape.outputs, tape.registers(), parameters, current, stopped, inputs, time, step, low, high, out
    )


def run_bands(
    dynamics: Dynamics,
    parameters: Floats,
    first: Floats,
    inputs: Floats,
    time: Floats,
    step: float,
    low: Floats,
    high: Floats,
) -> tuple[Floats, Floats, int]:
    """Pointwise 95 % band of runs with different parameters.

    Parameters
    ----------
    parameters : (runs, p) array
        Of each run.
    dynamics, first, inputs, time, step, low, high
        As for `mean_run`.

    Returns
    -------
    low, high : (n, d) arrays
        Infinite where more than 2.5 % of the runs have left the range.
    blown : int
        How many did at some time.
    """
    runs, n, d = len(parameters), len(time), len(first)
    current, stopped = np.tile(first, (runs, 1)), np.zeros(runs, dtype=np.uint32)
    bottom, top = np.empty((n, d)), np.empty((n, d))
    below, above = math.floor(TAIL * (runs - 1)), math.ceil((1.0 - TAIL) * (runs - 1))
    size = max(2, BLOCK // (runs * d))
    for row in range(0, max(n - 1, 1), size - 1):  # a block starts with the last row of the one before
        rows = slice(row, min(row + size, n))
        out = np.empty((runs, rows.stop - row, d))
        _run(dynamics, parameters, current, stopped, inputs[rows], time[rows], step, low, high, out)
        # a run that blew up may be anywhere
        gone = np.isnan(out)
        bottom[rows] = np.partition(np.where(gone, -math.inf, out), below, axis=0)[below]
        top[rows] = np.partition(np.where(gone, math.inf, out), above, axis=0)[above]
    return bottom, top, int(np.count_nonzero(stopped))
