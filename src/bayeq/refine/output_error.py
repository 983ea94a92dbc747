"""Output-error estimation: parameters whose free run comes closest to what was measured, and how well they are known.

The segments of multiple shooting set how long a run is free. Short ones are easy to fit from any start; long ones need
fewer initial states and say more about the parameters. So segments are made longer from fit to fit while their runs
follow the record. What then drives the runs away unseen (noise in a measured force, a model that is only nearly true)
is estimated together with the noise of the channels, and residuals are weighted accordingly (`innovations`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.refine.measured import Measured
from bayeq.refine.noise import Noise, likeliest_noise
from bayeq.refine.shooting import Runs, Segments, Solution, minimise
from bayeq.regression.residuals import inspect_residuals

__all__ = ["OutputError", "Unrefined", "follows_better", "output_error"]

Floats = NDArray[np.float64]

# A run follows the record while its residuals exceed those of the shortest segments by less than this share of every
# channel's standard deviation, and are themselves below this one.
FOLLOWS = 0.2
LOST = 0.5

# Segments at first, fewer where they would have fewer rows than SHORTEST; how much longer they are from fit to fit.
FIRST = 16
SHORTEST = 8
LONGER = 4

# Channels are weighted by the inverse of their residuals' rms, but as if that were at least this share of their spread.
LEAST_NOISE = 1e-8

# Relative decrease of the cost at which a fit is done: while the length of segments is looked for, and in the end.
ROUGHLY, FINELY = 1e-4, 1e-8

# How often weights, and levels of noise, are estimated anew at most; that is enough when it changes no weight by this
# share, or no parameter by this share of its standard deviation.
ROUNDS, ROUNDS_OF_NOISE = 4, 8
SAME_WEIGHT = 1e-2
SAME_ESTIMATE = 0.05

# Blocks of the sandwich covariance at least, and the rows that a block must have.
BLOCKS = 16
BLOCK_ROWS = 8

# Parameters are not told apart where the condition number of their scaled information exceeds this.
SINGULAR = 1e13

# Other inputs are taken where they make 2 log likelihood greater by this.
CLOSER = 20.0

# Output error is of use where its errors make runs err less, by this factor, than those of the regression do, or
# contradicts the regression at this level.
PRECISER = 0.97
PRECISER_DISTURBED = 0.8
CONTRADICTED = 0.99

# Unseen forces disturb runs above this share of the spread of the targets: free runs over other rows then err by these
# forces, which better coefficients hardly change.
TRIFLE = 0.005


@dataclass(frozen=True, eq=False)
class OutputError:
    """Parameters by output error.

    Attributes
    ----------
    parameters : (p,) array
        As in `Dynamics`.
    covariance : (p, p) array
        Initial states eliminated; a block sandwich, where innovations are correlated in time.
    noise_sd : (m,) array
        Standard deviation of each channel's noise.
    unseen_sd : (K,) array
        Standard deviation of the unseen force in each of K equations, as noise in samples of the target.
    segments : int
        Free runs; one per record where they are longest.
    longest : int
        Rows of the longest.
    converged : bool
        False if the last fit, or its turns with the levels of noise, ended at their limit.
    """

    parameters: Floats
    covariance: Floats
    noise_sd: Floats
    unseen_sd: Floats
    segments: int
    longest: int
    converged: bool


@dataclass(frozen=True)
class Unrefined:
    """Why the parameters are better left as they are."""

    reason: str


def output_error(
    measured: Measured, parameters: Floats, covariance: Floats, length: int | None = None
) -> OutputError | Unrefined:
    """Parameters by output error, starting from those of a regression.

    Noise is estimated by turns with the fit: the maximum likelihood of Gaussian noise of unknown levels.

    Parameters
    ----------
    measured : Measured
        Records and the model.
    parameters, covariance : (p,) and (p, p) arrays
        Of the regression.
    length : int, optional
        Rows of a segment; by default the longest with which runs follow the records.

    Returns
    -------
    OutputError or Unrefined
    """
    rough = _longest_fit(measured, parameters, float(measured.longest if length is None else length))
    if rough is None:
        return Unrefined("no free run follows the records")
    segments = rough[0]
    fine = _likeliest(segments, rough[1], rough[2])
    if fine is None:
        return Unrefined("the records do not determine all coefficients in a free run")
    found, spread, noise = fine
    least = PRECISER_DISTURBED if _disturbed(measured, noise.unseen) else PRECISER
    if length is None and _as_well_known(found.parameters, spread, parameters, covariance, least):
        return Unrefined("free runs determine the coefficients no better than is known already")
    return OutputError(
        parameters=found.parameters,
        covariance=spread,
        noise_sd=np.sqrt(noise.channels),
        unseen_sd=np.sqrt(noise.unseen),
        segments=segments.count,
        longest=segments.longest,
        converged=found.converged,
    )


def follows_better(other: Measured, measured: Measured, parameters: Floats, length: int | None) -> bool:
    """Whether free runs come closer to the records with other inputs than with the given ones."""
    rough = _longest_fit(measured, parameters, float(measured.longest if length is None else length))
    if rough is None:
        return False
    again = _fit(other, rough[1].parameters, rough[0].length)
    if again is None:
        return False
    return bool(2.0 * measured.samples @ np.log(rough[2][0] / again[2]) > CLOSER)


def _longest_fit(
    measured: Measured, parameters: Floats, limit: float
) -> tuple[Segments, Solution, tuple[Floats, Floats]] | None:
    """The fit of the longest segments, up to a limit, whose runs follow the records; what it and the first leave."""
    rows = min(max(measured.longest / FIRST, SHORTEST), limit)
    best = _fit(measured, parameters, rows)
    while best is None and rows >= 2 * SHORTEST:  # the regression follows for a shorter time only
        rows /= 2
        best = _fit(measured, parameters, rows)
    if best is None:
        return None
    first = best[2]
    while rows < limit:
        rows = min(LONGER * rows, limit)
        longer = _fit(measured, best[1].parameters, rows)
        if longer is None or (longer[2] ** 2 > first**2 + (FOLLOWS * measured.spread) ** 2).any():
            break
        best = longer
    return best[0], best[1], (best[2], first)


def _fit(measured: Measured, parameters: Floats, length: float) -> tuple[Segments, Solution, Floats] | None:
    """Output error with channels weighted by what the fit leaves of them; also the rms of that."""
    segments = Segments(measured, length)
    rms = measured.spread
    found = Solution(parameters, segments.starts(), [], 0, True)
    for _ in range(ROUNDS):
        weights = 1.0 / np.maximum(rms, LEAST_NOISE * measured.spread)
        again = minimise(segments.free(weights), found.parameters, found.starts, ROUGHLY)
        if again is None:
            return None
        found = again
        former, rms = rms, segments.rms(found.runs) / weights
        if (np.abs(rms - former) <= SAME_WEIGHT * former).all():
            break
    return None if (rms > LOST * measured.spread).any() else (segments, found, rms)


def _likeliest(segments: Segments, found: Solution, left: Sequence[Floats]) -> tuple[Solution, Floats, Noise] | None:
    """The estimate with noise and unseen forces at their likeliest levels, and its covariance.

    None if parameters cannot be told apart.
    """
    measured = segments.measured
    states = np.std(np.concatenate([piece.states for piece in measured.pieces]), axis=0)
    # none moves a state by more than its spread in an interval
    largest = states[measured.last] / measured.interval
    floor = LEAST_NOISE * measured.spread
    noise: Noise | None = None
    spread: Floats | None = None
    for _ in range(ROUNDS_OF_NOISE):
        parameters, starts = found.parameters, found.starts

        def cost(levels: Noise, parameters: Floats = parameters, starts: Floats = starts) -> float:
            return segments.led(parameters, starts, levels)[1]

        noise = likeliest_noise(cost, left, floor, largest, int(measured.samples.sum()), noise)
        again = minimise(segments.led(parameters, starts, noise)[0], parameters, starts, FINELY)
        if again is None:
            return None
        found, spread = again, _covariance(segments, again)
        if spread is None:
            return None
        if (np.abs(found.parameters - parameters) <= SAME_ESTIMATE * np.sqrt(np.diagonal(spread))).all():
            break
        found = replace(found, converged=False)
    assert spread is not None
    assert noise is not None
    return found, spread, noise


def _disturbed(measured: Measured, unseen: Floats) -> bool:
    """Whether unseen forces of these variances are more than a trifle beside the targets."""
    for k, state in enumerate(measured.last):
        rates = [np.diff(piece.states[:, state]) / np.diff(piece.time) for piece in measured.pieces]
        if math.sqrt(unseen[k]) > TRIFLE * float(np.nanstd(np.concatenate(rates))):
            return True
    return False


def _as_well_known(found: Floats, ours: Floats, parameters: Floats, covariance: Floats, least: float) -> bool:
    """Whether runs with the regression's coefficients err about as little, and it is not contradicted (Hausman 1978).

    What errors of the coefficients do to runs over the rows is their mean square in the metric of the output error's
    information, the inverse of its covariance: p for its own errors, tr(information x covariance) for the regression's.
    """
    from scipy.stats import chi2

    change = found - parameters
    contradicted = change @ np.linalg.solve(ours + covariance, change) > chi2.ppf(CONTRADICTED, len(change))
    excess = float(np.trace(np.linalg.solve(ours, covariance))) / len(change)
    return bool(excess < least**-2 and not contradicted)


def _covariance(segments: Segments, found: Solution) -> Floats | None:
    """Covariance of the parameters, initial states eliminated; None if they cannot be told apart.

    Innovations that are correlated in time make (J'J)^-1 too small: between two of them stands the sum over blocks of
    the outer products of J'r, for blocks that are longer than the correlation.
    """
    measured, even = segments.measured, found.runs
    d, p = found.starts.shape[1], len(found.parameters)
    per_segment = max(1, math.ceil(BLOCKS / segments.count))
    information, scores, squares = np.zeros((p, p)), [], 0.0
    for run in even:
        J = run[:, :, 1:].reshape(-1, d + p)
        J = J[:, d:] - J[:, :d] @ np.linalg.lstsq(J[:, :d], J[:, d:])[0]
        information += J.T @ J
        squares += float(np.sum(run[:, :, 0] ** 2))
        gradient = np.einsum("nmp,nm->np", J.reshape(*run.shape[:2], p), run[:, :, 0])
        edges = np.linspace(0, len(run), per_segment + 1)[:-1].round().astype(np.intp)
        scores.append(np.add.reduceat(gradient, np.unique(edges), axis=0))
    diagonal = np.diagonal(information)
    if not (np.isfinite(information).all() and (diagonal > 0).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > SINGULAR:
        return None
    inverse = np.linalg.inv(scaled)
    samples = int(measured.samples.sum())
    factor = max(squares, samples) / max(samples - p - found.starts.size, 1)
    if measured.rows >= BLOCKS * BLOCK_ROWS and _correlated(even):
        blocks = np.concatenate(scores) * scale
        factor = len(blocks) / max(len(blocks) - p, 1)
        inverse = inverse @ (blocks.T @ blocks) @ inverse
    covariance = factor * inverse * np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))


def _correlated(even: Runs) -> bool:
    return any(inspect_residuals([run[:, c, 0] for run in even]).correlated for c in range(even[0].shape[1]))
