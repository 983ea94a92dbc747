"""Free runs of any right-hand side that is a tape, many side by side: RK4 in fixed steps, compiled once for all.

`bayeq.systems.integrate` is its plainer relation: one run, even sampling, inputs interpolated linearly.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.tape import IndexArray, run_tape
from bayeq.kernels import kernel

__all__ = ["STAGES", "Interpolation", "free_runs", "input_at", "interpolant", "local_errors", "steps_between"]

Interpolation = Literal["cubic", "linear", "hold"]

# Rows of work space: the state between samples, a trial state, and four slopes.
STAGES = 6


def interpolant(time: FloatArray, samples: FloatArray, kind: Interpolation) -> FloatArray:
    """Inputs between their samples, as a cubic polynomial in each sampling interval.

    Parameters
    ----------
    time : (n,) array
        [s].
    samples : (n, m) array
        Inputs.
    kind : "cubic", "linear" or "hold"
        Cubic spline, for forces that are smooth between their samples; straight lines; or the last sample held, for
        commands that are switched.

    Returns
    -------
    (n, m, 4) array
        In powers of the time since the sample, the lowest first; constant after the last.
    """
    n = len(time)
    out = np.zeros((*samples.shape, 4))
    out[:, :, 0] = samples
    if n < 2 or samples.shape[1] == 0 or kind == "hold":
        return out
    if kind == "linear":
        out[:-1, :, 1] = np.diff(samples, axis=0) / np.diff(time)[:, None]
        return out
    from scipy.interpolate import CubicSpline

    coefficients = CubicSpline(time, samples, axis=0).c
    out[:-1] = np.moveaxis(coefficients[::-1], 0, -1)
    out[:-1, :, 0] = samples[:-1]
    return out


@kernel
def input_at(inputs: FloatArray, row: int, which: int, since: float) -> float:
    """Value of an input, `since` seconds after the sample `row`."""
    c = inputs[row, which]
    return c[0] + since * (c[1] + since * (c[2] + since * c[3]))


@kernel
def _slope(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    x: FloatArray,
    inputs: FloatArray,
    row: int,
    since: float,
    slope: FloatArray,
) -> None:
    """Right-hand side at `x`, `since` seconds after the sample `row`."""
    states = x.shape[0]
    for i in range(states):
        registers[i] = x[i]
    for k in range(inputs.shape[1]):
        registers[states + k] = input_at(inputs, row, k, since)
    run_tape(code, registers)
    for i in range(states):
        slope[i] = registers[outputs[i]]


@kernel
def _interval(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    inputs: FloatArray,
    row: int,
    dt: float,
    substeps: int,
    work: FloatArray,
) -> None:
    """From the sample `row` to the next by classical Runge-Kutta steps: the state ``work[0]`` is advanced by `dt`."""
    states = work.shape[1]
    x, y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
    h = dt / substeps
    for step in range(substeps):
        start, middle, end = h * step, h * (step + 0.5), h * (step + 1.0)
        _slope(code, outputs, registers, x, inputs, row, start, k1)
        for i in range(states):
            y[i] = x[i] + 0.5 * h * k1[i]
        _slope(code, outputs, registers, y, inputs, row, middle, k2)
        for i in range(states):
            y[i] = x[i] + 0.5 * h * k2[i]
        _slope(code, outputs, registers, y, inputs, row, middle, k3)
        for i in range(states):
            y[i] = x[i] + h * k3[i]
        _slope(code, outputs, registers, y, inputs, row, end, k4)
        for i in range(states):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])


@kernel
def steps_between(dt: float, step: float) -> int:
    """Equal steps that divide an interval `dt` so that none is longer than `step`, up to rounding."""
    return max(1, math.ceil(dt / step - 1e-6))


@kernel
def free_runs(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    parameters: FloatArray,
    current: FloatArray,
    stopped: IndexArray,
    inputs: FloatArray,
    time: FloatArray,
    step: float,
    low: FloatArray,
    high: FloatArray,
    out: FloatArray,
) -> None:
    """Integrate ``dx/dt = f(x, u; theta)`` from several states, each with parameters of its own.

    The tape's variables are the states, then the inputs, then the parameters; its outputs are the states' derivatives.

    Parameters
    ----------
    code, outputs : uint32 arrays
        Of a `bayeq.expressions.Tape`.
    registers : float array
        From `Tape.registers`; changed in place.
    parameters : (runs, p) float array
        Of each run.
    current : (runs, states) float array
        States at the first sample; afterwards those at the last, so that the next call can go on.
    stopped : (runs,) uint32 array
        0 for a run that goes on; set to the row (counted from 1) at which a run left its range.
    inputs : (n, m, 4) float array
        From `interpolant`.
    time : (n,) float array
        Sampling times [s].
    step : float
        Longest step [s].
    low, high : (states,) float arrays
        The range of the states; a run that leaves it, or is not finite, stops.
    out : (runs, n, states) float array
        Receives the states at the samples, NaN from where a run stopped.
    """
    runs, n, states = out.shape
    first = states + inputs.shape[1]
    work = np.empty((STAGES, states))
    for run in range(runs):
        for j in range(parameters.shape[1]):
            registers[first + j] = parameters[run, j]
        for i in range(states):
            work[0, i] = current[run, i]
        for row in range(n):
            if stopped[run] == 0:
                for i in range(states):
                    if not (work[0, i] >= low[i] and work[0, i] <= high[i]):
                        stopped[run] = row + 1
            if stopped[run] > 0:
                for i in range(states):
                    out[run, row, i] = math.nan
                continue
            for i in range(states):
                out[run, row, i] = work[0, i]
            if row < n - 1:
                dt = time[row + 1] - time[row]
                _interval(code, outputs, registers, inputs, row, dt, steps_between(dt, step), work)
        for i in range(states):
            current[run, i] = work[0, i]


@kernel
def local_errors(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    time: FloatArray,
    step: float,
    scale: FloatArray,
    out: FloatArray,
) -> None:
    """What half the step changes in each sampling interval, started from given states.

    Parameters
    ----------
    code, outputs, registers
        As for `free_runs`, the parameters in their registers.
    states : (n, states) float array
        Where each interval starts.
    inputs, time
        As for `free_runs`.
    step : float
        Longest step [s]; compared are twice as many.
    scale : (states,) float array
        Unit of each state's error.
    out : (n - 1,) float array
        Receives the largest difference of any state, in these units.
    """
    size = states.shape[1]
    coarse = np.empty((STAGES, size))
    fine = np.empty((STAGES, size))
    for row in range(states.shape[0] - 1):
        for i in range(size):
            coarse[0, i] = states[row, i]
            fine[0, i] = states[row, i]
        dt = time[row + 1] - time[row]
        substeps = steps_between(dt, step)
        _interval(code, outputs, registers, inputs, row, dt, substeps, coarse)
        _interval(code, outputs, registers, inputs, row, dt, 2 * substeps, fine)
        out[row] = 0.0
        for i in range(size):
            error = abs(coarse[0, i] - fine[0, i]) / scale[i]
            if not error <= out[row]:  # NaN too
                out[row] = error
