"""Sensitivities of a free run by forward differentiation: the tape and RK4 with derivatives carried along.

What is had is the derivative of the discrete run itself, exact to rounding: a variational equation integrated by
the same method (Bock 1981, "internal numerical differentiation").
"""

from __future__ import annotations

import math

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.functions import (
    ABS,
    ACOS,
    ASIN,
    ATAN,
    COS,
    COSH,
    EXP,
    LOG,
    SIGN,
    SIN,
    SINH,
    SQRT,
    TAN,
    TANH,
)
from bayeq.expressions.tape import (
    ADD,
    DIVIDE,
    MULTIPLY,
    NEGATE,
    POWER,
    SUBTRACT,
    IndexArray,
    apply_function,
)
from bayeq.kernels import kernel
from bayeq.ode.rk4 import STAGES, input_at, steps_between

__all__ = ["function_slope", "interval_tangents", "run_tangents", "shoot", "slope_tangents"]


@kernel
def function_slope(opcode: int, a: float, value: float) -> float:
    """Derivative at `a` of the function with this opcode, whose value there is `value`."""
    if opcode == ABS:
        return 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0
    if opcode == SIGN:
        return 0.0
    if opcode == SIN:
        return math.cos(a)
    if opcode == COS:
        return -math.sin(a)
    if opcode == TAN:
        return 1.0 + value * value
    if opcode == ASIN:
        return 1.0 / math.sqrt(1.0 - a * a)
    if opcode == ACOS:
        return -1.0 / math.sqrt(1.0 - a * a)
    if opcode == ATAN:
        return 1.0 / (1.0 + a * a)
    if opcode == EXP:
        return value
    if opcode == LOG:
        return 1.0 / a
    if opcode == SQRT:
        return 0.5 / value
    if opcode == SINH:
        return math.cosh(a)
    if opcode == COSH:
        return math.sinh(a)
    if opcode == TANH:
        return 1.0 - value * value
    return math.nan


@kernel
def run_tangents(code: IndexArray, registers: FloatArray, tangents: FloatArray) -> None:
    """`run_tape` with derivatives: each register's value, and its derivatives along q directions.

    Parameters
    ----------
    code : (instructions, 4) uint32 array
        Of a `bayeq.expressions.Tape`.
    registers : (n,) float array
        Values, those of the variables in front; changed in place.
    tangents : (n, q) float array
        Derivatives of the variables in front, 0 for the constants; changed in place.
    """
    q = tangents.shape[1]
    for i in range(code.shape[0]):
        opcode, to, left, right = code[i, 0], code[i, 1], code[i, 2], code[i, 3]
        a = registers[left]
        b = registers[right]
        if opcode == MULTIPLY:
            value = a * b
            for j in range(q):
                tangents[to, j] = a * tangents[right, j] + b * tangents[left, j]
        elif opcode == ADD:
            value = a + b
            for j in range(q):
                tangents[to, j] = tangents[left, j] + tangents[right, j]
        elif opcode == SUBTRACT:
            value = a - b
            for j in range(q):
                tangents[to, j] = tangents[left, j] - tangents[right, j]
        elif opcode == DIVIDE:
            value = a / b
            for j in range(q):
                tangents[to, j] = (tangents[left, j] - value * tangents[right, j]) / b
        elif opcode == NEGATE:
            value = -a
            for j in range(q):
                tangents[to, j] = -tangents[left, j]
        elif opcode == POWER:
            value = a**b
            for j in range(q):
                # a factor that is 0 leaves out what would be infinite or undefined
                slope = b * a ** (b - 1.0) * tangents[left, j] if tangents[left, j] != 0.0 else 0.0
                if tangents[right, j] != 0.0:
                    slope += value * math.log(a) * tangents[right, j]
                tangents[to, j] = slope
        else:
            if opcode == ABS:
                value = abs(a)
            elif opcode == SIGN:
                value = 1.0 if a > 0.0 else -1.0 if a < 0.0 else 0.0 if a == 0.0 else a
            else:
                value = apply_function(opcode, a)
            slope = function_slope(opcode, a, value)
            for j in range(q):
                tangents[to, j] = slope * tangents[left, j] if tangents[left, j] != 0.0 else 0.0
        registers[to] = value


@kernel
def slope_tangents(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    tangents: FloatArray,
    x: FloatArray,
    inputs: FloatArray,
    row: int,
    since: float,
    slope: FloatArray,
) -> None:
    """Right-hand side and its derivatives at `x`, (d, 1 + q): values in the first column."""
    states, columns = x.shape
    for i in range(states):
        registers[i] = x[i, 0]
        for j in range(1, columns):
            tangents[i, j - 1] = x[i, j]
    for k in range(inputs.shape[1]):
        registers[states + k] = input_at(inputs, row, k, since)
    run_tangents(code, registers, tangents)
    for i in range(states):
        slope[i, 0] = registers[outputs[i]]
        for j in range(1, columns):
            slope[i, j] = tangents[outputs[i], j - 1]


@kernel
def interval_tangents(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    tangents: FloatArray,
    inputs: FloatArray,
    row: int,
    dt: float,
    substeps: int,
    work: FloatArray,
) -> None:
    """One sampling interval of RK4 on ``work[0]``, states and derivatives together."""
    states, columns = work.shape[1], work.shape[2]
    x, y, k1, k2, k3, k4 = work[0], work[1], work[2], work[3], work[4], work[5]
    h = dt / substeps
    for step in range(substeps):
        start, middle, end = h * step, h * (step + 0.5), h * (step + 1.0)
        slope_tangents(code, outputs, registers, tangents, x, inputs, row, start, k1)
        for i in range(states):
            for j in range(columns):
                y[i, j] = x[i, j] + 0.5 * h * k1[i, j]
        slope_tangents(code, outputs, registers, tangents, y, inputs, row, middle, k2)
        for i in range(states):
            for j in range(columns):
                y[i, j] = x[i, j] + 0.5 * h * k2[i, j]
        slope_tangents(code, outputs, registers, tangents, y, inputs, row, middle, k3)
        for i in range(states):
            for j in range(columns):
                y[i, j] = x[i, j] + h * k3[i, j]
        slope_tangents(code, outputs, registers, tangents, y, inputs, row, end, k4)
        for i in range(states):
            for j in range(columns):
                x[i, j] += h / 6.0 * (k1[i, j] + 2.0 * (k2[i, j] + k3[i, j]) + k4[i, j])


@kernel
def shoot(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    parameters: FloatArray,
    start: FloatArray,
    inputs: FloatArray,
    time: FloatArray,
    step: float,
    low: FloatArray,
    high: FloatArray,
    channels: IndexArray,
    values: FloatArray,
    jacobian: FloatArray,
) -> int:
    """Free run of one segment: measured channels and their derivatives by initial state and parameters.

    Parameters
    ----------
    code, outputs, registers
        As for `bayeq.ode.rk4.free_runs`; the tape's variables are the d states, the inputs, then the p
        parameters.
    parameters : (p,) float array
        theta.
    start : (d,) float array
        State at the first sample.
    inputs, time, step, low, high
        As for `bayeq.ode.rk4.free_runs`.
    channels : (m,) uint32 array
        What is measured: state i is i, the derivative of state i is d + i.
    values : (n, m) float array
        Receives the channels along the run.
    jacobian : (n, m, d + p) float array
        Receives their derivatives.

    Returns
    -------
    int
        n, or the row at which the run left its range: from there on nothing was written.
    """
    n, d, p = time.shape[0], start.shape[0], parameters.shape[0]
    q = d + p
    first = d + inputs.shape[1]
    tangents = np.zeros((registers.shape[0], q))
    for j in range(p):
        registers[first + j] = parameters[j]
        tangents[first + j, d + j] = 1.0
    work = np.zeros((STAGES, d, 1 + q))
    x, slope = work[0], work[2]
    for i in range(d):
        x[i, 0] = start[i]
        x[i, 1 + i] = 1.0
    derivative = False
    for c in channels:
        derivative = derivative or c >= d
    for row in range(n):
        for i in range(d):
            if not (x[i, 0] >= low[i] and x[i, 0] <= high[i]):
                return row
        if derivative:
            slope_tangents(code, outputs, registers, tangents, x, inputs, row, 0.0, slope)
        for c in range(channels.shape[0]):
            which = channels[c]
            source = x[which] if which < d else slope[which - d]
            values[row, c] = source[0]
            for j in range(q):
                jacobian[row, c, j] = source[1 + j]
        if row < n - 1:
            dt = time[row + 1] - time[row]
            interval_tangents(code, outputs, registers, tangents, inputs, row, dt, steps_between(dt, step), work)
    return n
