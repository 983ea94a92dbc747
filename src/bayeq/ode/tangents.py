"""Sensitivities of a free run: its derivatives by initial state and parameters, integrated along with it.

They are the derivatives of the discrete run itself, exact to rounding: a variational equation integrated by the same
method (Bock 1981, "internal numerical differentiation").
"""

from __future__ import annotations

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.tape import IndexArray, Program
from bayeq.kernels import kernel
from bayeq.ode.rk4 import STAGES, Drive, advance, slope_at, steps_in

__all__ = ["shoot"]


@kernel
def shoot(
    program: Program,
    drive: Drive,
    parameters: FloatArray,
    start: FloatArray,
    channels: IndexArray,
    values: FloatArray,
    jacobian: FloatArray,
) -> int:
    """Free run of one segment: measured channels and their derivatives by initial state and parameters.

    Parameters
    ----------
    program, drive
        As for `bayeq.ode.rk4.free_runs`.
    parameters : (p,) float array
        theta.
    start : (d,) float array
        State at the first sample.
    channels : (m,) uint32 array
        What is measured: i < d is state i, other numbers are those of the tape's outputs.
    values : (n, m) float array
        Receives the channels along the run.
    jacobian : (n, m, d + p) float array
        Receives their derivatives.

    Returns
    -------
    int
        n, or the row at which the run left its range: from there on nothing was written.
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
