"""Runge-Kutta runs of right-hand sides given as tapes: fixed steps, compiled once for all systems.

The tape's variables are the d states, the inputs, then the parameters; its first d outputs are the states'
derivatives. Sensitivities of a run are the derivatives of the discrete run itself, exact to rounding: a variational
equation integrated by the same method (Bock 1981, "internal numerical differentiation").
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, get_args

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.expressions.evaluate import IndexArray, Program, run_tape
from bayeq.kernels import kernel
from bayeq.numerics.spline import spline_slopes

Interpolation = Literal["cubic", "linear", "hold", "band-limited"]

# Sampling intervals count as even if they differ by a smaller share.
EVEN = 1e-3

# Rows of work space: the state between samples, a trial state, and four slopes.
STAGES = 6


class Drive(NamedTuple):
    """Inputs of a run, its sampling intervals and step of integration, and the range of its states."""

    inputs: Floats  # (n, m, 4), from `interpolant`
    intervals: Floats  # (n - 1,), between the samples [s]
    step: float  # longest step of integration [s]; intervals are divided evenly. 0 for a map, which is not integrated
    low: Floats  # (d,), the range of the states; a run that leaves it, or is not finite, stops
    high: Floats  # (d,)
    # (d,), the change of each state by halving an interval's step with which two steps are enough there; or empty
    enough: Floats = np.zeros(0)

    @classmethod
    def over(cls, time: Floats, inputs: Floats, low: Floats, high: Floats) -> Drive:
        """The drive with samples at `time`, (n,), and the median interval as the step."""
        intervals = np.diff(time)
        return cls(inputs, intervals, float(np.median(intervals)), low, high)

    def part(self, start: int, stop: int) -> Drive:
        """The drive over the samples from `start` up to, without, `stop`."""
        return self._replace(inputs=self.inputs[start:stop], intervals=self.intervals[start : stop - 1])


def check_interpolation(kind: object) -> None:
    """Raise an InputError for a text that is not one of `Interpolation`."""
    if isinstance(kind, str) and kind not in get_args(Interpolation):
        raise InputError(f"interpolation must be one of {', '.join(get_args(Interpolation))}, got {kind!r}")


def interpolant(time: Floats, samples: Floats, kind: Interpolation) -> Floats:
    """Inputs (n, m) between their samples, as a cubic polynomial in each sampling interval, (n, m, 4).

    "cubic" is a spline; "linear" straight lines; "hold" the last sample, for commands that are switched; "band-limited"
    the cubic through the trigonometric interpolation of even samples at the thirds of each interval, for forces with
    frequencies up to near half the sampling rate (a spline where steps are uneven).

    The four numbers are the values p, q at both ends of each interval, and r, s of the deviation from a straight line:
    at the fraction w of the interval ``(1 - w) p + w q + w (1 - w) (r + w s)``. Constant after the last sample.
    """
    out = np.zeros((*samples.shape, 4))
    out[:, :, 0] = out[:, :, 1] = samples
    if len(time) < 2 or samples.shape[1] == 0 or kind == "hold":
        return out
    out[:-1, :, 1] = samples[1:]
    steps, rise = np.diff(time), np.diff(samples, axis=0)
    if kind == "band-limited" and np.ptp(steps) <= EVEN * steps.mean():
        finer = _thirds(samples)
        first, second = finer[1::3] - samples[:-1] - rise / 3.0, finer[2::3] - samples[:-1] - rise / 1.5
        out[:-1, :, 2], out[:-1, :, 3] = 4.5 * (2.0 * first - second), 13.5 * (second - first)
    elif kind in ("cubic", "band-limited"):
        h, slopes = steps[:, None], spline_slopes(time, samples)
        # excess of the slopes at both ends over that of the straight line
        start, end = h * slopes[:-1] - rise, h * slopes[1:] - rise
        out[:-1, :, 2], out[:-1, :, 3] = start, -(start + end)
    return out


def with_time(time: Floats, inputs: Floats) -> Floats:
    """Inputs (n, m, 4) from `interpolant`, and the time [s] itself as one more, (n, m + 1, 4)."""
    return np.concatenate([inputs, interpolant(time, np.asarray(time, dtype=np.float64)[:, None], "linear")], axis=1)


def _thirds(samples: Floats) -> Floats:
    """Samples (n, m) and, at the thirds between, trigonometric interpolation about a straight line, (3 n - 2, m)."""
    n = len(samples)
    line = np.linspace(samples[0], samples[-1], 3 * n - 2)
    rest = samples - line[::3]
    periodic = np.concatenate([rest[:-1], -rest[:0:-1]])
    spectrum = np.fft.rfft(periodic, axis=0)
    spectrum[-1] *= 0.5  # the bin at half the sampling rate holds both signs of the frequency
    return np.asarray(3.0 * np.fft.irfft(spectrum, 3 * len(periodic), axis=0)[: 3 * n - 2] + line)


@kernel(borrowing=True)
def slope_at(
    program: Program, inputs: Floats, x: Floats, row: int, fraction: float, tangents: Floats | None, slope: Floats
) -> None:
    """Right-hand side at `x`, at a fraction (0 to 1) of the interval after the sample `row`, into `slope`.

    `x` and `slope`, (d (1 + q),), hold the state, then its derivatives along q directions, state by state. Tangents
    (registers, q) are as for `run_tape`; None for q = 0.
    """
    registers, rest = program.registers, 1.0 - fraction
    size = x.shape[0] if tangents is None else x.shape[0] // (1 + tangents.shape[1])
    for i in range(size):
        registers[i] = x[i]
    for k in range(inputs.shape[1]):
        p = inputs[row, k]
        registers[size + k] = rest * p[0] + fraction * p[1] + fraction * rest * (p[2] + fraction * p[3])
    if tangents is not None:
        for i in range(size):
            for j in range(tangents.shape[1]):
                tangents[i, j] = x[size + i * tangents.shape[1] + j]
    run_tape(program, tangents)
    for i in range(size):
        slope[i] = registers[program.outputs[i]]
        if tangents is not None:
            for j in range(tangents.shape[1]):
                slope[size + i * tangents.shape[1] + j] = tangents[program.outputs[i], j]


@kernel
def advance(
    program: Program, inputs: Floats, row: int, interval: float, substeps: int, tangents: Floats | None, work: Floats
) -> None:
    """Advance the state ``work[0]`` from sample `row` to the next, by `substeps` Runge-Kutta steps; 0 for a map."""
    size = work.shape[1]
    x, y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
    if substeps == 0:
        slope_at(program, inputs, x, row, 0.0, tangents, k1)
        for i in range(size):
            x[i] = k1[i]
        return
    h, share = interval / substeps, 1.0 / substeps
    for step in range(substeps):
        start, middle, end = step * share, (step + 0.5) * share, (step + 1.0) * share
        slope_at(program, inputs, x, row, start, tangents, k1)
        for i in range(size):
            y[i] = x[i] + 0.5 * h * k1[i]
        slope_at(program, inputs, y, row, middle, tangents, k2)
        for i in range(size):
            y[i] = x[i] + 0.5 * h * k2[i]
        slope_at(program, inputs, y, row, middle, tangents, k3)
        for i in range(size):
            y[i] = x[i] + h * k3[i]
        slope_at(program, inputs, y, row, end, tangents, k4)
        for i in range(size):
            x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])


@kernel
def steps_in(interval: float, step: float) -> int:
    """Number of equal steps in an interval, so that none is longer than `step` up to rounding; 0 for a map."""
    if step == 0.0:
        return 0
    return max(1, math.ceil(interval / step - 1e-6))


@kernel
def _halved(program: Program, drive: Drive, row: int, steps: int, scale: Floats, coarse: Floats, fine: Floats) -> float:
    """Advance ``coarse[0]`` by `steps`, and ``fine[0]`` from there by twice as many: the largest change, in `scale`."""
    interval, largest = drive.intervals[row], 0.0
    for i in range(len(scale)):
        fine[0, i] = coarse[0, i]
    advance(program, drive.inputs, row, interval, steps, None, coarse)
    advance(program, drive.inputs, row, interval, 2 * steps, None, fine)
    for i in range(len(scale)):
        error = abs(coarse[0, i] - fine[0, i]) / scale[i]
        if math.isnan(error):
            return math.inf
        largest = max(largest, error)
    return largest


@kernel
def free_runs(
    program: Program, drive: Drive, parameters: Floats, current: Floats, stopped: IndexArray, out: Floats
) -> None:
    """Integrate ``dx/dt = f(x, u; theta)`` from several states, each with its own parameters (runs, p).

    `current` (runs, d) holds the states at the first sample, and afterwards those at the last, so that the next call
    can go on. `stopped` (runs,) is 0, or the row (counted from 1) at which a run left its range. `out` (runs, n, d)
    receives the states at the samples, NaN from where a run stopped. Where ``drive.enough`` says so an interval is two
    steps.
    """
    runs, n, size = out.shape
    first = size + drive.inputs.shape[1]
    work, coarse, fine = np.empty((STAGES, size)), np.empty((STAGES, size)), np.empty((STAGES, size))
    for run in range(runs):
        for j in range(parameters.shape[1]):
            program.registers[first + j] = parameters[run, j]
        for i in range(size):
            work[0, i] = current[run, i]
        for row in range(n):
            if stopped[run] == 0:
                for i in range(size):
                    if not (work[0, i] >= drive.low[i] and work[0, i] <= drive.high[i]):
                        stopped[run] = row + 1
            if stopped[run] > 0:
                for i in range(size):
                    out[run, row, i] = math.nan
                continue
            for i in range(size):
                out[run, row, i] = work[0, i]
            if row < n - 1:
                interval = drive.intervals[row]
                steps = steps_in(interval, drive.step)
                if len(drive.enough) > 0 and steps > 3:
                    for i in range(size):
                        coarse[0, i] = work[0, i]
                    if _halved(program, drive, row, 1, drive.enough, coarse, fine) <= 1.0:
                        for i in range(size):
                            work[0, i] = fine[0, i]
                        continue
                advance(program, drive.inputs, row, interval, steps, None, work)
        for i in range(size):
            current[run, i] = work[0, i]


@kernel
def local_errors(program: Program, drive: Drive, states: Floats, scale: Floats, out: Floats) -> None:
    """Change over each interval, from given states (n, d), by halving the step: the largest in units `scale` (d,)."""
    size = states.shape[1]
    coarse = np.empty((STAGES, size))
    fine = np.empty((STAGES, size))
    for row in range(states.shape[0] - 1):
        for i in range(size):
            coarse[0, i] = states[row, i]
        steps = steps_in(drive.intervals[row], drive.step)
        out[row] = _halved(program, drive, row, steps, scale, coarse, fine)


@kernel
def shoot(
    program: Program,
    drive: Drive,
    parameters: Floats,
    start: Floats,
    channels: IndexArray,
    values: Floats,
    jacobian: Floats,
) -> int:
    """Free run of one segment: measured channels and their derivatives by initial state and parameters.

    The run is from the state `start` (d,) with parameters (p,). `channels` (m,) are numbers of states, from 0 to d - 1,
    or from d on of outputs of the tape. `values` (n, m) receives the channels along the run, `jacobian` (n, m, d + p)
    their derivatives. Returns n, or the row at which the run left its range: from there on nothing was written.
    """
    n, d, p = values.shape[0], start.shape[0], parameters.shape[0]
    q, first = d + p, d + drive.inputs.shape[1]
    registers, outputs = program.registers, program.outputs
    tangents = np.zeros((registers.shape[0], q))
    for j in range(p):
        registers[first + j] = parameters[j]
        tangents[first + j, d + j] = 1.0
    work = np.zeros((STAGES, d * (1 + q)))
    x = work[0]
    for i in range(d):
        x[i] = start[i]
        x[d + i * q + i] = 1.0
    others = False
    for c in channels:
        others = others or c >= d
    for row in range(n):
        for i in range(d):
            if not (x[i] >= drive.low[i] and x[i] <= drive.high[i]):
                return row
        if others:
            slope_at(program, drive.inputs, x, row, 0.0, tangents, work[1])
        for c in range(channels.shape[0]):
            k = channels[c]
            values[row, c] = x[k] if k < d else registers[outputs[k]]
            for j in range(q):
                jacobian[row, c, j] = x[d + k * q + j] if k < d else tangents[outputs[k], j]
        if row < n - 1:
            interval = drive.intervals[row]
            advance(program, drive.inputs, row, interval, steps_in(interval, drive.step), tangents, work)
    return n
