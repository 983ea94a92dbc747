"""Noise of the channels and unseen forces: a run that is led by the record, and what it does not foresee.

A force that was not measured exactly drives the true motion away from a free run. A Kalman filter takes it as white
noise in samples of the highest derivatives, straight between them: after each row the run is moved towards what was
measured, by a gain that follows from the levels of noise, and the errors of the predictions from row to row
(innovations) are independent (Ljung 1999). Without such forces the gain is zero: the run is free, and its errors are
those of output error.
"""

from __future__ import annotations

import math

import numpy as np

from bayeq.expressions.evaluate import FloatArray
from bayeq.expressions.tape import IndexArray
from bayeq.kernels import kernel
from bayeq.ode.rk4 import STAGES, steps_between
from bayeq.ode.tangents import interval_tangents, slope_tangents

__all__ = ["filter_run", "predict_run"]


@kernel
def filter_run(
    code: IndexArray,
    outputs: IndexArray,
    registers: FloatArray,
    start: FloatArray,
    inputs: FloatArray,
    time: FloatArray,
    step: float,
    low: FloatArray,
    high: FloatArray,
    channels: IndexArray,
    samples: FloatArray,
    noise: FloatArray,
    last: IndexArray,
    unseen: FloatArray,
    slopes: FloatArray,
    gains: FloatArray,
    scale: FloatArray,
) -> float:
    """Extended Kalman filter of a segment from a known initial state, a channel at a time.

    Parameters
    ----------
    code, outputs, registers
        As for `bayeq.ode.rk4.free_runs`, the parameters in their registers.
    start, inputs, time, step, low, high, channels
        As for `bayeq.ode.tangents.shoot`.
    samples : (n, m) array
        What was measured; NaN where a sample is missing.
    noise : (m,) array
        Variance of each channel's noise.
    last : (K,) uint32 array
        The highest state of each chain, that an unseen force drives.
    unseen : (K,) array
        Variance of the unseen forces' samples.
    slopes, gains : (n, m, d + K) arrays
        Receive the derivative of each channel by states and unseen forces, and the gain of its innovation for these.
    scale : (n, m) array
        Receives the standard deviation of each innovation.

    Returns
    -------
    float
        -2 log likelihood up to a constant; infinite for a run that leaves its range.
    """
    n, m = samples.shape
    d, forces = start.shape[0], last.shape[0]
    D = d + forces
    tangents = np.zeros((registers.shape[0], d))
    work = np.zeros((STAGES, d, 1 + d))
    x, slope = work[0], work[2]
    P, AP, moved = np.zeros((D, D)), np.zeros((d, d)), np.zeros(D)
    for i in range(d):
        x[i, 0] = start[i]
    total, dt = 0.0, 0.0
    for row in range(n):
        for i in range(d):
            if not (x[i, 0] >= low[i] and x[i, 0] <= high[i]):
                return math.inf
            for j in range(d):
                x[i, 1 + j] = 1.0 if i == j else 0.0
        slope_tangents(code, outputs, registers, tangents, x, inputs, row, 0.0, slope)
        # a new sample of each unseen force, which acted already in the second half of the interval before
        P[d:, :] = 0.0
        P[:, d:] = 0.0
        for k in range(forces):
            i = last[k]
            P[d + k, d + k] = unseen[k]
            P[i, i] += 0.25 * dt * dt * unseen[k]
            P[i, d + k] = P[d + k, i] = 0.5 * dt * unseen[k]
        moved[:] = 0.0
        for c in range(m):
            if math.isnan(samples[row, c]):
                continue
            measured = channels[c]
            source = x[measured] if measured < d else slope[measured - d]
            h, gain = slopes[row, c], gains[row, c]
            for i in range(d):
                h[i] = source[1 + i]
            for k in range(forces):
                h[d + k] = 1.0 if measured == d + last[k] else 0.0
            variance, error = noise[c], samples[row, c] - source[0]
            for i in range(D):
                gain[i] = 0.0
                for j in range(D):
                    gain[i] += P[i, j] * h[j]
                error -= h[i] * moved[i]
            for i in range(D):
                variance += h[i] * gain[i]
            for i in range(D):
                for j in range(D):
                    P[i, j] -= gain[i] * gain[j] / variance
            for i in range(D):
                gain[i] /= variance
                moved[i] += gain[i] * error
            scale[row, c] = math.sqrt(variance)
            total += math.log(variance) + error * error / variance
        if row < n - 1:
            dt = time[row + 1] - time[row]
            for k in range(forces):
                i = last[k]
                moved[i] += 0.5 * dt * moved[d + k]
                for j in range(D):
                    P[i, j] += 0.5 * dt * P[d + k, j]
                for j in range(D):
                    P[j, i] += 0.5 * dt * P[j, d + k]
            for i in range(d):
                x[i, 0] += moved[i]
            interval_tangents(code, outputs, registers, tangents, inputs, row, dt, steps_between(dt, step), work)
            for i in range(d):
                for j in range(d):
                    AP[i, j] = 0.0
                    for k in range(d):
                        AP[i, j] += x[i, 1 + k] * P[k, j]
            for i in range(d):
                for j in range(d):
                    P[i, j] = 0.0
                    for k in range(d):
                        P[i, j] += AP[i, k] * x[j, 1 + k]
    return total


@kernel
def predict_run(
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
    samples: FloatArray,
    last: IndexArray,
    slopes: FloatArray,
    gains: FloatArray,
    scale: FloatArray,
    out: FloatArray,
) -> int:
    """Innovations of a run that given gains lead along the samples, and their derivatives.

    Parameters
    ----------
    code, outputs, registers, parameters, start, inputs, time, step, low, high, channels
        As for `bayeq.ode.tangents.shoot`.
    samples : (n, m) array
        What was measured; NaN where a sample is missing.
    last, slopes, gains, scale
        As for `filter_run`, and from it.
    out : (n, m, 1 + d + p) array
        Receives innovations, and derivatives of the predictions by initial state and parameters, over `scale`; 0 where
        a sample is missing.

    Returns
    -------
    int
        n, or the row at which the run left its range: from there on nothing was written.
    """
    n, d, p = time.shape[0], start.shape[0], parameters.shape[0]
    q, D = d + p, d + last.shape[0]
    first = d + inputs.shape[1]
    tangents = np.zeros((registers.shape[0], q))
    for j in range(p):
        registers[first + j] = parameters[j]
        tangents[first + j, d + j] = 1.0
    work = np.zeros((STAGES, d, 1 + q))
    x, slope = work[0], work[2]
    moved = np.zeros((D, 1 + q))
    for i in range(d):
        x[i, 0] = start[i]
        x[i, 1 + i] = 1.0
    for row in range(n):
        for i in range(d):
            if not (x[i, 0] >= low[i] and x[i, 0] <= high[i]):
                return row
        slope_tangents(code, outputs, registers, tangents, x, inputs, row, 0.0, slope)
        moved[:] = 0.0
        for c in range(channels.shape[0]):
            if math.isnan(samples[row, c]):
                out[row, c, :] = 0.0
                continue
            source = x[channels[c]] if channels[c] < d else slope[channels[c] - d]
            for j in range(1 + q):
                value = source[j] if j > 0 else samples[row, c] - source[0]
                for i in range(D):
                    value -= slopes[row, c, i] * moved[i, j]
                out[row, c, j] = value / scale[row, c]
                for i in range(D):
                    moved[i, j] += gains[row, c, i] * value
        if row < n - 1:
            dt = time[row + 1] - time[row]
            for k in range(last.shape[0]):
                for j in range(1 + q):
                    moved[last[k], j] += 0.5 * dt * moved[d + k, j]
            for i in range(d):
                x[i, 0] += moved[i, 0]
                for j in range(1, 1 + q):
                    x[i, j] -= moved[i, j]
            interval_tangents(code, outputs, registers, tangents, inputs, row, dt, steps_between(dt, step), work)
    return n
