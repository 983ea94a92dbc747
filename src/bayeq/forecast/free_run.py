"""Free runs of dynamics: one with a step that suits it, and the band of many."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics, finest_step
from bayeq.inference.posterior import Posterior
from bayeq.ode.rk4 import Drive, free_runs, interpolant

__all__ = ["ANYWHERE", "GENEROUS", "drawn_sines", "mean_run", "pushed", "run_bands", "state_range"]

Floats = NDArray[np.float64]

# A run has blown up where a state is further from its measured range than this many times the range.
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


def mean_run(dynamics: Dynamics, parameters: Floats, first: Floats, drive: Drive) -> tuple[Floats, int | None, Drive]:
    """A free run, with a step found on the way.

    The step is judged on the run itself, taken with whole sampling intervals at first and again with shorter ones where
    these are coarse.

    Parameters
    ----------
    dynamics : Dynamics
        The right-hand side.
    parameters : (p,) array
        Its parameters.
    first : (d,) array
        Initial state.
    drive : Drive
        From `Drive.over`.

    Returns
    -------
    states : (n, d) array
        NaN from where the run left the range.
    stopped : int or None
        The row where it did.
    drive : Drive
        With the step found.
    """
    n = len(drive.inputs)
    while True:
        stopped, out = np.zeros(1, dtype=np.uint32), np.empty((1, n, len(first)))
        free_runs(dynamics.program(), drive, parameters[None], first[None].copy(), stopped, out)
        reached = int(stopped[0]) - 1 if stopped[0] else n
        judged = min(max(reached, 2), JUDGED_ROWS)
        finer = finest_step(dynamics, parameters, out[0, :judged], drive.part(0, judged))
        if finer >= 0.999 * drive.step:
            return out[0], reached if reached < n else None, drive
        drive = drive._replace(step=finer)


def run_bands(
    dynamics: Dynamics, parameters: Floats, first: Floats, drive: Drive, forces: Sequence[Floats] = ()
) -> tuple[Floats, Floats, int]:
    """Pointwise 95 % band of runs with different parameters, and under different forces.

    Parameters
    ----------
    parameters : (runs, p) array
        Of each run.
    dynamics, first, drive
        As for `mean_run`; the step is taken as it is.
    forces : sequence of (runs, M, 3) arrays
        From `drawn_sines`, for those that `dynamics` has.

    Returns
    -------
    low, high : (n, d) arrays
        Infinite where more than 2.5 % of the runs have left the range.
    blown : int
        How many did at some time.
    """
    runs, n, d = len(parameters), len(drive.inputs), len(first)
    current, stopped = np.tile(first, (runs, 1)), np.zeros(runs, dtype=np.uint32)
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
            free_runs(program, driven, parameters[one], current[one], stopped[one], out[one])
        # a run that blew up may be anywhere
        gone = np.isnan(out)
        bottom[row:end] = np.partition(np.where(gone, -math.inf, out), below, axis=0)[below]
        top[row:end] = np.partition(np.where(gone, math.inf, out), above, axis=0)[above]
    return bottom, top, int(np.count_nonzero(stopped))


def drawn_sines(posterior: Posterior, count: int, rng: np.random.Generator) -> Floats:
    """Random forces of the size and spectrum of what an equation leaves out, sums of sines (Shinozuka and Jan 1972).

    All M sines have the same share of the power. Every force has its own frequencies between the lines that are known:
    a resonance could fall between the same few lines of all runs.

    Returns
    -------
    (count, M, 3) array
        Amplitude, angular frequency [rad/s] and phase.
    """
    size, first = len(posterior.error_lines), np.arange(len(posterior.error_lines))
    levels = (first + rng.random((count, size))) / size
    frequency = np.interp(levels, (first + 0.5) / size, posterior.error_lines)
    a, b = (posterior.error_sd or 0.0) / np.sqrt(size) * rng.standard_normal((2, count, size))
    return np.stack([np.hypot(a, b), 2.0 * np.pi * frequency, np.arctan2(b, a)], axis=2)


def pushed(drive: Drive, time: Floats, forces: Sequence[Floats]) -> Drive:
    """What drives a run, and behind it forces, (M, 3) each, at the times [s] of its samples."""
    if not forces:
        return drive
    parts = [np.cos(time[:, None] * turn - phase) @ size for size, turn, phase in (sines.T for sines in forces)]
    between = interpolant(time, np.column_stack(parts), "cubic")
    return drive._replace(inputs=np.concatenate([drive.inputs, between], axis=1))
