"""``rk4``: one compiled fixed-step integrator for every right-hand side that is a tape."""

from __future__ import annotations

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.tape import IndexArray, run_tape
from bayeq.kernels import kernel

__all__ = ["rk4"]


@kernel
def _slope(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    x: FloatArray,
    inputs: FloatArray,
    row: int,
    weight: float,
    slope: FloatArray,
) -> None:
    """Right-hand side at `x`, inputs interpolated between `row` (weight 0) and ``row + 1`` (weight 1)."""
    states = x.shape[0]
    for i in range(states):
        registers[i] = x[i]
    for j in range(inputs.shape[1]):
        registers[states + j] = (1.0 - weight) * inputs[row, j] + weight * inputs[row + 1, j]
    run_tape(code, registers)
    for i in range(states):
        slope[i] = registers[outputs[i]]


@kernel
def rk4(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    x0: FloatArray,
    inputs: FloatArray,
    dt: float,
    substeps: int,
    out: FloatArray,
) -> int:
    """Integrate ``dx/dt = f(x, u)`` by the classical fourth-order Runge-Kutta method with fixed steps.

    The tape's variables are the states, then the inputs, then anything constant (parameters); its outputs
    are the states' derivatives. Sampled inputs are interpolated linearly inside a sampling interval, which is
    itself divided into `substeps` equal steps.

    Parameters
    ----------
    code, outputs : uint32 arrays
        Of a `bayeq.expressions.Tape`.
    registers : float array
        From `Tape.registers`, the constant variables in their places; changed in place, reusable.
    x0 : (states,) float array
        Initial state.
    inputs : (n, m) float array
        Samples of the inputs; ``m`` may be 0.
    dt : float
        Sampling interval [s].
    substeps : int
        Steps per sampling interval.
    out : (n, states) float array
        Receives the states at the samples; the first row is `x0`.

    Returns
    -------
    int
        ``n``, or the first row that is not finite: the run stopped there, and the rows from there on were
        not written.
    """
    n = int(out.shape[0])
    states = x0.shape[0]
    h = dt / substeps
    work = np.empty((6, states))
    x, y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
    for i in range(states):
        x[i] = x0[i]
    for row in range(n):
        for i in range(states):
            if not np.isfinite(x[i]):
                return row
        for i in range(states):
            out[row, i] = x[i]
        if row == n - 1:
            break
        for step in range(substeps):
            start, middle, end = step / substeps, (step + 0.5) / substeps, (step + 1.0) / substeps
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
    return n
