"""Output-error estimation by multiple shooting: parameters whose free run comes closest to the measured channels.

Each segment of a record is a free run from an initial state of its own (Bock 1981). Segments are short enough at first
for the runs to follow the record, and are merged two by two from one solution to the next: continuity is not
penalised but taken up, until a record is one run. Gauss-Newton steps with Levenberg-Marquardt damping; initial
states are eliminated segment by segment, so that the cost is linear in the number of rows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.dynamics import Dynamics
from bayeq.expressions.tape import IndexArray
from bayeq.tangent import shoot

__all__ = ["OutputError", "Piece", "Segments", "minimise", "output_error"]

Floats = NDArray[np.float64]

# A run follows the record while it errs by less than this share of every channel's standard deviation.
FOLLOWS = 0.5

# Segments are not made shorter than this [rows].
SHORTEST = 8

# Channels are weighted by the inverse of their residuals' rms, but as if that were at least this share of their spread.
LEAST_NOISE = 1e-8

# Steps at most; relative decrease of the cost at which segments that will be merged, and the last ones, are done.
MOST_STEPS = 60
ROUGHLY, FINELY = 1e-3, 1e-10

# Rounds of weighting, and the change of every weight at which they end.
MOST_ROUNDS = 20
SAME_WEIGHT = 1e-3


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows of a record that parameters are estimated from.

    Attributes
    ----------
    time : (n,) array
        [s].
    inputs : (n, k, 4) array
        From `bayeq.integrate.interpolant`.
    states : (n, d) array
        Measured or estimated states, from which the initial states of segments are taken at first.
    channels : (n, m) array
        What is measured of states and targets; NaN where a sample is missing.
    """

    time: Floats
    inputs: Floats
    states: Floats
    channels: Floats


@dataclass(frozen=True, eq=False)
class OutputError:
    """Parameters by output error.

    Attributes
    ----------
    parameters : (p,) array
        As in `Dynamics`.
    covariance : (p, p) array
        With the correlation of the residuals taken into account.
    noise_sd : (m,) array
        Standard deviation of what the free runs leave of each channel.
    start_sd : (m,) array
        The same at the parameters that were started from, initial states fitted.
    segments : int
        Free runs at the end; one per record if the runs could follow all of it.
    longest : int
        Rows of the longest.
    steps : int
        Steps taken in all.
    converged : bool
        False if the last steps ended at their limit.
    """

    parameters: Floats
    covariance: Floats
    noise_sd: Floats
    start_sd: Floats
    segments: int
    longest: int
    steps: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Segments:
    """The free runs of all segments and their derivatives, as the cost of parameters and initial states.

    Attributes
    ----------
    dynamics : Dynamics
    pieces : sequence of Piece
    bounds : sequence of int arrays
        For each piece the first rows of its segments, and the number of its rows.
    channels : (m,) uint32 array
        As `shoot` takes them.
    step : float
        Longest step of integration [s].
    low, high : (d,) arrays
        Range of the states; a run that leaves it has infinite cost.
    """

    dynamics: Dynamics
    pieces: Sequence[Piece]
    bounds: Sequence[NDArray[np.intp]]
    channels: IndexArray
    step: float
    low: Floats
    high: Floats

    @property
    def count(self) -> int:
        return sum(len(b) - 1 for b in self.bounds)

    @property
    def longest(self) -> int:
        return max(int(np.diff(b).max()) for b in self.bounds)

    def rows(self) -> list[tuple[Piece, int, int]]:
        """Piece, first row and end of each segment."""
        return [(p, int(a), int(e)) for p, b in zip(self.pieces, self.bounds, strict=True) for a, e in zip(b, b[1:])]

    def starts(self) -> Floats:
        """Initial states as the pieces have them, (K, d)."""
        return np.array([piece.states[a] for piece, a, _ in self.rows()])

    def merged(self, starts: Floats) -> tuple[Segments, Floats]:
        """Every two segments as one, with the initial state of the first."""
        bounds, kept, first = [], [], 0
        for b in self.bounds:
            count = len(b) - 1
            bounds.append(np.unique(np.append(b[:-1:2], b[-1])))
            kept.append(starts[first : first + count : 2])
            first += count
        halved = Segments(self.dynamics, self.pieces, bounds, self.channels, self.step, self.low, self.high)
        return halved, np.concatenate(kept)

    def run(self, parameters: Floats, starts: Floats) -> list[tuple[Floats, Floats]] | None:
        """Residuals (n, m), 0 where a sample is missing, and derivatives (n, m, d + p) of each segment's channels.

        None if a run leaves the range.
        """
        tape, registers = self.dynamics.tape, self.dynamics.registers()
        out = []
        for (piece, a, e), start in zip(self.rows(), starts, strict=True):
            measured = piece.channels[a:e]
            values = np.empty(measured.shape)
            jacobian = np.empty((*measured.shape, len(start) + len(parameters)))
            done = shoot(
                tape.code, tape.outputs, registers, parameters, start, piece.inputs[a:e], piece.time[a:e], self.step,
                self.low, self.high, self.channels, values, jacobian,
            )  # fmt: skip
            if done < e - a or not np.isfinite(jacobian).all():
                return None
            present = np.isfinite(measured)
            if not present.all():
                jacobian[~present] = 0.0
            out.append((np.where(present, measured - values, 0.0), jacobian))
        return out

    def samples(self) -> NDArray[np.intp]:
        """Measured samples of each channel, (m,)."""
        return np.sum([np.isfinite(piece.channels).sum(axis=0) for piece in self.pieces], axis=0)


@dataclass(frozen=True, eq=False)
class _Solution:
    parameters: Floats
    starts: Floats
    rms: Floats
    steps: int
    converged: bool


def minimise(
    segments: Segments, parameters: Floats, starts: Floats, weights: Floats, tolerance: float, fixed: bool = False
) -> _Solution | None:
    """Least squares of the weighted residuals over parameters and initial states, by Levenberg-Marquardt.

    Parameters
    ----------
    segments : Segments
    parameters, starts : (p,) and (K, d) arrays
        Where to start.
    weights : (m,) array
        Of each channel's residuals.
    tolerance : float
        Relative decrease of the cost at which to stop.
    fixed : bool
        Keep the parameters.

    Returns
    -------
    _Solution or None
        None if the first run already leaves the range.
    """
    runs = segments.run(parameters, starts)
    if runs is None:
        return None
    damping, steps, converged = 1e-4, 0, False
    cost, rms = _cost(segments, runs, weights)
    while steps < MOST_STEPS and not converged:
        H, g = _normal(runs, weights, starts.shape[1])
        while True:
            change = _step(H, g, damping, starts.shape[1], fixed)
            if change is not None:
                by, moved = change
                trial = segments.run(parameters + by, starts + moved)
                new, new_rms = (math.inf, rms) if trial is None else _cost(segments, trial, weights)
                if trial is not None and new <= cost:
                    break
            damping *= 8.0
            if damping > 1e12:  # no step whatever makes it better: a minimum to rounding
                return _Solution(parameters, starts, rms, steps, True)
        converged = cost - new <= tolerance * cost
        parameters, starts, runs, cost, rms = parameters + by, starts + moved, trial, new, new_rms
        damping = max(damping / 8.0, 1e-14)
        steps += 1
    return _Solution(parameters, starts, rms, steps, converged)


def _cost(segments: Segments, runs: Sequence[tuple[Floats, Floats]], weights: Floats) -> tuple[float, Floats]:
    """Weighted sum of squares, and the rms of each channel's residuals."""
    squares = np.sum([np.einsum("nm,nm->m", r, r) for r, _ in runs], axis=0)
    return float(weights**2 @ squares), np.sqrt(squares / segments.samples())


def _normal(runs: Sequence[tuple[Floats, Floats]], weights: Floats, d: int) -> tuple[Floats, Floats]:
    """J'J and J'r of each segment, (K, d + p, d + p) and (K, d + p)."""
    H, g = [], []
    for r, jacobian in runs:
        J = (jacobian * weights[:, None]).reshape(-1, jacobian.shape[2])
        H.append(J.T @ J)
        g.append(J.T @ (r * weights).ravel())
    return np.array(H), np.array(g)


def _step(H: Floats, g: Floats, damping: float, d: int, fixed: bool) -> tuple[Floats, Floats] | None:
    """Change of the parameters and of the initial states; None where the damped matrix is singular."""
    try:
        A, B = H[:, :d, :d].copy(), H[:, :d, d:]
        index = np.arange(d)
        A[:, index, index] *= 1.0 + damping
        solved = np.linalg.solve(A, np.concatenate([B, g[:, :d, None]], axis=2))
        inverse_B, inverse_g = solved[:, :, :-1], solved[:, :, -1]
        p = B.shape[2]
        if fixed:
            change = np.zeros(p)
        else:
            C = H[:, d:, d:].sum(axis=0)
            C[np.diag_indices(p)] *= 1.0 + damping
            S = C - np.einsum("kdp,kdq->pq", B, inverse_B)
            rest = g[:, d:].sum(axis=0) - np.einsum("kdp,kd->p", B, inverse_g)
            scale = 1.0 / np.sqrt(np.diagonal(C))
            change = scale * np.linalg.solve(S * np.outer(scale, scale), scale * rest)
    except np.linalg.LinAlgError:
        return None
    moved = inverse_g - inverse_B @ change
    return (change, moved) if np.isfinite(change).all() and np.isfinite(moved).all() else None


def output_error(
    dynamics: Dynamics,
    pieces: Sequence[Piece],
    parameters: Floats,
    channels: IndexArray,
    step: float,
    low: Floats,
    high: Floats,
    segment: int | None = None,
) -> OutputError | None:
    """Parameters by output error, starting from those of a regression.

    Channels are weighted by the inverse of their residuals' standard deviation, by turns with the fit: the maximum
    likelihood of Gaussian noise of unknown levels.

    Parameters
    ----------
    dynamics : Dynamics
    pieces : sequence of Piece
        One per record.
    parameters : (p,) array
        Where to start.
    channels : (m,) uint32 array
        As `bayeq.tangent.shoot` takes them.
    step : float
        Longest step of integration [s].
    low, high : (d,) arrays
        Range of the states.
    segment : int, optional
        Rows that a segment has at most; by default all of a record.

    Returns
    -------
    OutputError or None
        None if no free run of the start stays in the range, if the parameters cannot be told from each other, or if
        the start was not improved on.
    """
    spread = np.sqrt(np.nanmean(np.square([0.0]), axis=0)) + _spread(pieces)
    first = _first_segments(dynamics, pieces, parameters, channels, step, low, high, segment, spread)
    if first is None:
        return None
    segments, starts = first
    wanted = max(len(p.time) for p in pieces) if segment is None else segment
    steps = 0
    best: tuple[Segments, _Solution] | None = None
    current = parameters
    while True:
        final = segments.longest >= wanted or all(len(b) == 2 for b in segments.bounds)
        found = _weighted(segments, current, starts, spread, FINELY if final else ROUGHLY)
        if found is None or (best is not None and bool((found.rms > FOLLOWS * spread).any())):
            break
        best = segments, found
        steps += found.steps
        current = found.parameters
        longer, joined = segments.merged(found.starts)
        if final or (segment is not None and longer.longest > segment):
            break
        segments, starts = longer, joined
    if best is None:
        return None
    segments, found = best
    if found.converged is False or segments.count > 0:
        found = _weighted(segments, found.parameters, found.starts, spread, FINELY) or found
    before = _weighted(segments, parameters, segments.starts(), spread, FINELY, fixed=True)
    counts = segments.samples()
    if before is not None and counts @ np.log(before.rms / spread + LEAST_NOISE) < counts @ np.log(
        found.rms / spread + LEAST_NOISE
    ):
        return None
    covariance = _covariance(segments, found)
    if covariance is None:
        return None
    return OutputError(
        parameters=found.parameters,
        covariance=covariance,
        noise_sd=found.rms,
        start_sd=np.full(len(channels), np.inf) if before is None else before.rms,
        segments=segments.count,
        longest=segments.longest,
        steps=steps,
        converged=found.converged,
    )


def _spread(pieces: Sequence[Piece]) -> Floats:
    """Standard deviation of each channel over all records."""
    return np.nanstd(np.concatenate([piece.channels for piece in pieces]), axis=0)


def _first_segments(
    dynamics: Dynamics,
    pieces: Sequence[Piece],
    parameters: Floats,
    channels: IndexArray,
    step: float,
    low: Floats,
    high: Floats,
    segment: int | None,
    spread: Floats,
) -> tuple[Segments, Floats] | None:
    """The longest segments over which the start follows the record, or comes closest to it."""
    best, least = None, math.inf
    halvings = 0
    while True:
        bounds = [_bounds(len(p.time), halvings) for p in pieces]
        segments = Segments(dynamics, pieces, bounds, channels, step, low, high)
        if segment is None or segments.longest <= segment:
            starts = segments.starts()
            runs = segments.run(parameters, starts)
            if runs is not None:
                worst = float((_cost(segments, runs, 1.0 / spread)[1] / spread).max())
                if worst < least:
                    best, least = (segments, starts), worst
                if worst < FOLLOWS:
                    break
        if segments.longest // 2 < SHORTEST:
            break
        halvings += 1
    return best


def _bounds(n: int, halvings: int) -> NDArray[np.intp]:
    """First rows of 2^halvings segments, or of as many as have enough rows, and n."""
    while n >> halvings < SHORTEST and halvings > 0:
        halvings -= 1
    return np.linspace(0, n, (1 << halvings) + 1).round().astype(np.intp)


def _weighted(
    segments: Segments, parameters: Floats, starts: Floats, spread: Floats, tolerance: float, fixed: bool = False
) -> _Solution | None:
    """`minimise` with weights that follow from its residuals."""
    rms = spread
    steps = 0
    for _ in range(MOST_ROUNDS):
        weights = 1.0 / np.maximum(rms, LEAST_NOISE * spread)
        found = minimise(segments, parameters, starts, weights, tolerance, fixed)
        if found is None:
            return None
        steps += found.steps
        parameters, starts = found.parameters, found.starts
        same = bool((np.abs(weights * np.maximum(found.rms, LEAST_NOISE * spread) - 1.0) < SAME_WEIGHT).all())
        rms = found.rms
        if same:
            break
    return _Solution(parameters, starts, rms, steps, found.converged)


def _covariance(segments: Segments, found: _Solution) -> Floats | None:
    """Covariance of the parameters, initial states eliminated; None if they cannot be told apart."""
    d = found.starts.shape[1]
    runs = segments.run(found.parameters, found.starts)
    assert runs is not None
    spread = _spread(segments.pieces)
    weights = 1.0 / np.maximum(found.rms, LEAST_NOISE * spread)
    p = len(found.parameters)
    information = np.zeros((p, p))
    middle = np.zeros((p, p))
    for r, jacobian in runs:
        J = (jacobian * weights[:, None]).reshape(-1, d + p)
        J = J[:, d:] - J[:, :d] @ np.linalg.lstsq(J[:, :d], J[:, d:])[0]
        information += J.T @ J
        middle += _coloured(r * weights, J.reshape(*r.shape, p))
    scale = 1.0 / np.sqrt(np.diagonal(information))
    if not np.isfinite(scale).all():
        return None
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > 1e14:
        return None
    inverse = np.linalg.inv(scaled)
    n = int(segments.samples().sum())
    factor = n / max(n - p - found.starts.size, 1)
    covariance = factor * inverse @ (middle * np.outer(scale, scale)) @ inverse * np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))


# Frequencies on either side over which the spectrum of the residuals is averaged.
NEIGHBOURS = 5


def _coloured(r: Floats, J: Floats) -> Floats:
    """J' Gamma J, where Gamma is the covariance of residuals with this sample's smoothed spectrum, (p, p).

    Morelli and Klein (1997): the covariance of parameters under coloured residuals. For white residuals of unit
    variance it is J'J.
    """
    n = len(r)
    R = np.fft.fft(r, axis=0, norm="ortho")
    cross = np.einsum("fa,fb->fab", R, R.conj())
    reach = min(NEIGHBOURS, (n - 1) // 2)
    kernel = np.zeros(n)
    kernel[np.arange(-reach, reach + 1)] = 1.0 / (2 * reach + 1)
    smooth = np.fft.ifft(np.fft.fft(cross, axis=0) * np.fft.fft(kernel)[:, None, None], axis=0)
    transformed = np.fft.fft(J, axis=0, norm="ortho")
    return np.asarray(np.einsum("fap,fab,fbq->pq", transformed.conj(), smooth, transformed).real)
