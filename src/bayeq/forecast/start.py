"""Where a free run starts: the state with which it follows the first period best.

A state read off the record at the first row carries that row's noise, and a smoothed one is least sure at the ends of a
record; the run then keeps the error for good. So the state is estimated from what was measured over the first period
(as output-error methods do with initial conditions; Ljung, System Identification, 1999, section 16.3), held to the one
that was read off where the samples say little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics, finest_step
from bayeq.forecast.rows import Rows
from bayeq.forecast.windows import typical_period
from bayeq.ode.tangents import shoot

__all__ = ["fitted_start"]

Floats = NDArray[np.float64]

# Least rows of the first period.
LEAST_ROWS = 8

# Errors that samples, and the state read off, are taken to have, as shares of the spread of their state.
SAMPLE = 0.05
READ = 0.1

# Gauss-Newton steps, and the change of the state, as a share of its spread, that ends them.
MOST_STEPS = 20
ENOUGH = 1e-6


def fitted_start(dynamics: Dynamics, parameters: Floats, rows: Rows, low: Floats, high: Floats) -> Floats:
    """The initial state with which a free run follows the first period of some rows best.

    Parameters
    ----------
    dynamics, parameters : Dynamics, (p,) array
        The equations.
    rows : Rows
        What the run is to follow, from its first row on.
    low, high : (d,) arrays
        Range in which runs go on.

    Returns
    -------
    (d,) array
        The state of the first row, where nothing better is found.
    """
    whole = rows.stack(dynamics.states)
    first, spread = whole[0], whole.std(axis=0)
    scale = np.where(spread > 0, spread, 1.0)
    known = np.array([i for i, name in enumerate(dynamics.states) if name in rows.samples], dtype=np.uint32)
    if rows.n < LEAST_ROWS or not len(known):
        return first
    drive = rows.drive(low, high)
    n = int(min(max(typical_period(dynamics, [rows]) / drive.step, LEAST_ROWS), rows.n))
    chosen = np.column_stack([rows.samples[dynamics.states[i]][:n] for i in known])
    drive = drive.part(0, n)
    drive = drive._replace(step=finest_step(dynamics, parameters, whole[:n], drive))
    program = dynamics.program()

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
        prior = np.diag(1.0 / (READ * scale))
        return (
            np.concatenate([left.ravel(), prior @ (first - start)]),
            np.concatenate([slopes.reshape(-1, len(start)), prior]),
        )

    best, found = first, errors(first)
    for _ in range(MOST_STEPS):
        if found is None:
            return first
        left, slopes = found
        change = np.linalg.lstsq(slopes, left)[0]
        trial = errors(best + change)
        if trial is None or not float(trial[0] @ trial[0]) < float(left @ left):
            break
        best, found = best + change, trial
        if (np.abs(change) <= ENOUGH * scale).all():
            break
    return best
