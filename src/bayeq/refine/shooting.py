"""Multiple shooting: free runs of segments, each from an initial state of its own, fitted to measured channels.

Least squares over the parameters and all initial states (Bock 1981) by Gauss-Newton steps with Levenberg-Marquardt
damping. The normal equations have the shape of an arrow: initial states are eliminated segment by segment, so that the
cost is linear in the number of rows, where a general solver's grows with the cube of the number of segments.

What is known of the parameters holds at every step: equations between them leave fewer free ones (`refine.known`), and
a step ends where a free one would lose its sign.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bayeq.ode.rk4 import Drive
from bayeq.ode.tangents import shoot
from bayeq.refine.measured import Measured, Piece

__all__ = ["Segments", "Solution", "minimise"]

Floats = NDArray[np.float64]

# Of each segment (n, m, 1 + d + f): residuals of the channels, and the derivatives of the run by the initial state and
# the free parameters, both weighted; 0 where a sample is missing.
Runs: TypeAlias = list[Floats]

# Derivatives beyond this have no square in floating point.
LARGEST = 1e140

# Steps at most, and the range of the damping.
MOST_STEPS = 60
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e12


@dataclass(frozen=True, eq=False)
class Segments:
    """Free runs of segments and their derivatives, as functions of parameters and initial states.

    Attributes
    ----------
    measured : Measured
    length : float
        Rows that a segment has about; each piece is divided evenly.
    """

    measured: Measured
    length: float

    @cached_property
    def bounds(self) -> list[tuple[Piece, int, int]]:
        """Piece, first row and end of each segment."""
        out = []
        for piece in self.measured.pieces:
            n = len(piece.time)
            edges = np.linspace(0, n, max(1, round(n / self.length)) + 1).round().astype(int).tolist()
            out += [(piece, a, e) for a, e in itertools.pairwise(edges)]
        return out

    @property
    def count(self) -> int:
        """Number of segments, K."""
        return len(self.bounds)

    @property
    def longest(self) -> int:
        """Rows of the longest segment."""
        return max(e - a for _, a, e in self.bounds)

    def starts(self) -> Floats:
        """Initial states as the pieces have them, (K, d)."""
        return np.array([piece.states[a] for piece, a, _ in self.bounds])

    def runs(self, free: Floats, starts: Floats, weights: Floats) -> Runs | None:
        """Runs with free parameters (f,) from initial states (K, d), residuals times the channels' weights (m,).

        None if one leaves the range.
        """
        m = self.measured
        program = m.dynamics.program()
        parameters, d = m.known.full(free), starts.shape[1]
        out = []
        for (piece, a, e), start in zip(self.bounds, starts, strict=True):
            samples = piece.channels[a:e]
            values = np.empty(samples.shape)
            jacobian = np.empty((*samples.shape, len(start) + len(parameters)))
            drive = Drive(piece.inputs[a:e], np.diff(piece.time[a:e]), m.step, m.low, m.high)
            done = shoot(program, drive, parameters, start, m.channels, values, jacobian)
            if done < e - a or not (np.abs(jacobian) < LARGEST).all():
                return None
            by_free = jacobian[:, :, d:] if m.given is None else jacobian[:, :, d:] @ m.given.basis
            whole = np.concatenate([(samples - values)[:, :, None], jacobian[:, :, :d], by_free], axis=2)
            whole *= weights[:, None]
            out.append(np.where(np.isnan(samples)[:, :, None], 0.0, whole))
        return out

    def rms(self, runs: Runs) -> Floats:
        """Root mean square of each channel's residuals, (m,)."""
        squares = np.sum([np.sum(run[:, :, 0] ** 2, axis=0) for run in runs], axis=0)
        return np.asarray(np.sqrt(squares / np.maximum(self.measured.samples, 1)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the least squares ended.

    Attributes
    ----------
    free, starts : (f,) and (K, d) arrays
        Free parameters and initial states at the minimum.
    runs : list of (n, m, 1 + d + f) arrays
        Residuals and derivatives of the segments there.
    converged : bool
        False if it stopped at their limit.
    """

    free: Floats
    starts: Floats
    runs: Runs
    converged: bool


def minimise(segments: Segments, weights: Floats, free: Floats, starts: Floats, tolerance: float) -> Solution | None:
    """Least squares over free parameters and initial states, by Levenberg-Marquardt.

    Parameters
    ----------
    segments : Segments
        What is run.
    weights : (m,) array
        Of the channels' residuals.
    free, starts : (f,) and (K, d) arrays
        Where to start; no parameter has another sign than its known one.
    tolerance : float
        Relative decrease of the sum of squares at which to stop.

    Returns
    -------
    Solution or None
        None if the first run already leaves the range.
    """
    runs = segments.runs(free, starts, weights)
    if runs is None:
        return None
    damping, steps, converged, cost = 1e-4, 0, False, _cost(runs)
    while steps < MOST_STEPS and not converged:
        H, g = _normal(runs)
        while True:
            change = _step(H, g, damping, starts.shape[1], _ends(free, segments.measured.known.signs))
            if change is not None:
                trial = segments.runs(free + change[0], starts + change[1], weights)
                if trial is not None and (new := _cost(trial)) <= cost:
                    break
            damping *= 8.0
            if damping > MOST_DAMPING:  # no step makes it better: a minimum, to rounding
                return Solution(free, starts, runs, True)
        converged = cost - new <= tolerance * cost
        free, starts, runs, cost = free + change[0], starts + change[1], trial, new
        damping = max(damping / 8.0, LEAST_DAMPING)
        steps += 1
    return Solution(free, starts, runs, converged)


def _cost(runs: Runs) -> float:
    return sum(float(np.sum(run[:, :, 0] ** 2)) for run in runs)


def _normal(runs: Runs) -> tuple[Floats, Floats]:
    """J'J and J'r of each segment, (K, d + f, d + f) and (K, d + f)."""
    H, g = [], []
    for run in runs:
        flat = run.reshape(-1, run.shape[2])
        H.append(flat[:, 1:].T @ flat[:, 1:])
        g.append(flat[:, 1:].T @ flat[:, 0])
    return np.array(H), np.array(g)


def _ends(free: Floats, signs: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Least and largest change that leaves the free parameters their signs, (f,) arrays."""
    return np.where(signs > 0, -free, -np.inf), np.where(signs < 0, -free, np.inf)


def _step(H: Floats, g: Floats, damping: float, d: int, ends: tuple[Floats, Floats]) -> tuple[Floats, Floats] | None:
    """Change of the free parameters, between ends, and of the initial states; None if the damped matrix is singular."""
    A, B, C = H[:, :d, :d].copy(), H[:, :d, d:], H[:, d:, d:].sum(axis=0)
    index = np.arange(d)
    A[:, index, index] *= 1.0 + damping
    try:
        solved = np.linalg.solve(A, np.concatenate([B, g[:, :d, None]], axis=2))
        C[np.diag_indices_from(C)] *= 1.0 + damping
        S = C - np.einsum("kdp,kdq->pq", B, solved[:, :, :-1])
        rest = g[:, d:].sum(axis=0) - np.einsum("kdp,kd->p", B, solved[:, :, -1])
        # a parameter that nothing depends on makes the matrix singular whatever its scale
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(C), np.finfo(float).tiny))
        scaled = S * np.outer(scale, scale)
        change = scale * np.linalg.solve(scaled, scale * rest)
        if (change < ends[0]).any() or (change > ends[1]).any():
            change = _bounded(scaled, scale * rest, scale, ends)
    except np.linalg.LinAlgError:
        return None
    moved = solved[:, :, -1] - solved[:, :, :-1] @ change
    return (change, moved) if np.isfinite(change).all() and np.isfinite(moved).all() else None


def _bounded(S: Floats, rest: Floats, scale: Floats, ends: tuple[Floats, Floats]) -> Floats:
    """The change scale*z between ends for which z'S z/2 - rest'z is least, by an active set; at an end exactly so."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(S)
    low, high = ends
    bounds = low / scale, high / scale
    found = lsq_linear(L.T, solve_triangular(L, rest, lower=True), bounds, method="bvls")
    change = scale * found.x
    change = np.where(found.active_mask < 0, low, np.where(found.active_mask > 0, high, change))
    return np.asarray(np.clip(change, low, high))
