"""Output-error estimation: parameters whose free run comes closest to what was measured, and how well they are known.

The segments of multiple shooting set how long a run is free. Short ones are easy to fit from any start; long ones say
more about the parameters, until what drives a run unseen (noise in a measured force, a model that is only nearly true)
has taken it away from the record. So segments are made longer from fit to fit, and later rows decide which are taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.diagnostics import inspect_residuals
from bayeq.forecast.shooting import Measured, Segments, Solution, minimise

__all__ = ["OutputError", "Unrefined", "output_error"]

Floats = NDArray[np.float64]

# A run follows the record while it errs by less than this share of every channel's standard deviation.
FOLLOWS = 0.5

# Segments at first, fewer where they would have fewer rows than SHORTEST; how much longer they are from fit to fit.
FIRST = 16
SHORTEST = 8
LONGER = 4

# The share of the rows, the last ones, that decides about the length of segments, given so many rows in all; free runs
# over them are as good as each other if their errors differ by less than this factor.
JUDGES = 0.25
LEAST_ROWS = 200
AS_GOOD = 1.1

# Unseen forces show where the variance of the residuals exceeds that of the shortest segments by this share, and by
# five standard errors.
GROWTH = 0.2

# Channels are weighted by the inverse of their residuals' rms, but as if that were at least this share of their spread.
LEAST_NOISE = 1e-8

# Relative decrease of the cost at which a fit is done, and how often its channels are weighted anew at most: while
# the length of segments is looked for, and in the end.
ROUGHLY, FINELY = (1e-4, 3), (1e-10, 20)

# Weighting ends when no weight changes by this share.
SAME_WEIGHT = 1e-3

# Blocks of the sandwich covariance at least, and the rows that a block must have.
BLOCKS = 16
BLOCK_ROWS = 8

# Parameters are not told apart where the condition number of their scaled information exceeds this.
SINGULAR = 1e13

# Level of the test whether output error contradicts the regression.
CONTRADICTED = 0.99


@dataclass(frozen=True, eq=False)
class OutputError:
    """Parameters by output error.

    Attributes
    ----------
    parameters : (p,) array
        As in `Dynamics`.
    covariance : (p, p) array
        Initial states eliminated; a block sandwich, for residuals that are correlated in time.
    noise_sd : (m,) array
        Standard deviation of what the free runs leave of each channel.
    start_sd : (m,) array
        The same at the parameters that were started from, initial states fitted.
    segments : int
        Free runs; one per record where they are longest.
    longest : int
        Rows of the longest.
    converged : bool
        False if the last fit ended at its limit of steps.
    """

    parameters: Floats
    covariance: Floats
    noise_sd: Floats
    start_sd: Floats
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

    Channels are weighted by the inverse of their residuals' standard deviation, by turns with the fit: the maximum
    likelihood of Gaussian noise of unknown levels.

    Parameters
    ----------
    measured : Measured
        Records and the model.
    parameters, covariance : (p,) and (p, p) arrays
        Of the regression.
    length : int, optional
        Rows of a segment; by default the longest segments with which later rows are forecast as well as with any.

    Returns
    -------
    OutputError or Unrefined
    """
    choice = _choose(measured, parameters, covariance, length)
    if isinstance(choice, Unrefined):
        return choice
    segments, start = choice
    found = _weighted(segments, start, segments.starts(), FINELY)
    if found is None:
        return Unrefined("a free run left the range of the record")
    spread = _covariance(segments, found)
    if spread is None:
        return Unrefined("the records do not determine all coefficients in a free run")
    before = _weighted(segments, parameters, segments.starts(), FINELY, fixed=True)
    if before is not None and _misfit(measured, before) < _misfit(measured, found):
        return Unrefined("no coefficients were found whose free run comes closer to the records")
    return OutputError(
        parameters=found.parameters,
        covariance=spread,
        noise_sd=found.rms,
        start_sd=np.full(len(found.rms), np.inf) if before is None else before.rms,
        segments=segments.count,
        longest=segments.longest,
        converged=found.converged,
    )


def _choose(
    measured: Measured, parameters: Floats, covariance: Floats, length: int | None
) -> tuple[Segments, Floats] | Unrefined:
    """Segments, and parameters to start from."""
    judged = length is None and measured.rows >= LEAST_ROWS
    fitted = measured.part(0.0, 1.0 - JUDGES) if judged else measured
    fits = _fits(fitted, parameters, float(fitted.longest if length is None else length))
    if not fits:
        return Unrefined("no free run follows the records")
    if not judged:
        return Segments(measured, fits[-1][0].length), fits[-1][1].parameters
    later = measured.part(1.0 - JUDGES, 1.0)
    errors = [_forecast_error(later, found.parameters) for _, found in fits]
    disturbed = [_disturbed(found.rms, fits[0][1].rms, fitted.rows) for _, found in fits]
    k = _longest_useful(disturbed, errors)
    segments, found = fits[k]
    before = _forecast_error(later, parameters)
    if before * AS_GOOD < errors[k]:
        return Unrefined("coefficients whose free run is closer to the records forecast later rows worse")
    if before <= errors[k] * AS_GOOD:
        if disturbed[-1] or segments.longest < fitted.longest:
            return Unrefined(
                "forces that were not measured, or not exactly, take the free runs away from the records, and nothing"
                " was found that forecasts later rows better"
            )
        if _as_well_known(segments, found, parameters, covariance):
            return Unrefined("free runs determine the coefficients no better than is known already")
    whole = segments.longest >= fitted.longest
    return Segments(measured, float(measured.longest) if whole else segments.length), found.parameters


def _disturbed(rms: Floats, least: Floats, rows: int) -> bool:
    """Whether residuals exceed those of the shortest segments: unseen forces, or a model that is only nearly true."""
    return bool((rms**2 > (1.0 + max(GROWTH, 5.0 * math.sqrt(2.0 / rows))) * least**2).any())


def _longest_useful(disturbed: list[bool], errors: list[float]) -> int:
    """The longest segments that forecast as well as any; where disturbed, only if they forecast better."""
    chosen = 0
    for k in range(1, len(errors)):
        if errors[k] * AS_GOOD < errors[chosen] or (not disturbed[k] and errors[k] <= AS_GOOD * min(errors)):
            chosen = k
    return chosen


def _fits(measured: Measured, parameters: Floats, limit: float) -> list[tuple[Segments, Solution]]:
    """Fits of segments that get longer, up to the limit or as long as their runs follow the records."""
    rows = min(max(measured.longest / FIRST, SHORTEST), limit)
    first = _fit(measured, parameters, rows)
    while first is None and rows >= 2 * SHORTEST:  # the regression follows for a shorter time only
        rows /= 2
        first = _fit(measured, parameters, rows)
    fits = []
    while first is not None:
        fits.append(first)
        if rows >= limit:
            break
        rows = min(LONGER * rows, limit)
        first = _fit(measured, first[1].parameters, rows)
    return fits


def _fit(measured: Measured, parameters: Floats, length: float) -> tuple[Segments, Solution] | None:
    segments = Segments(measured, length)
    found = _weighted(segments, parameters, segments.starts(), ROUGHLY)
    if found is None or (found.rms > FOLLOWS * measured.spread).any():
        return None
    return segments, found


def _forecast_error(measured: Measured, parameters: Floats) -> float:
    """Geometric mean over the channels of the rms error of free runs, initial states fitted."""
    segments = Segments(measured, float(measured.longest))
    found = _weighted(segments, parameters, segments.starts(), ROUGHLY, fixed=True)
    if found is None:
        return math.inf
    return float(np.exp(-np.mean(np.log(_weights(measured, found.rms)))))


def _as_well_known(segments: Segments, found: Solution, parameters: Floats, covariance: Floats) -> bool:
    """Whether the regression is at least as precise, and not contradicted (Hausman 1978)."""
    from scipy.stats import chi2

    ours = _covariance(segments, found)
    if ours is None:
        return True
    change = found.parameters - parameters
    contradicted = change @ np.linalg.solve(ours, change) > chi2.ppf(CONTRADICTED, len(change))
    return bool(np.linalg.slogdet(covariance)[1] <= np.linalg.slogdet(ours)[1] and not contradicted)


def _weighted(
    segments: Segments, parameters: Floats, starts: Floats, effort: tuple[float, int], fixed: bool = False
) -> Solution | None:
    """`minimise` with weights that follow from its residuals."""
    tolerance, rounds = effort
    weights = _weights(segments.measured, segments.measured.spread)
    found = minimise(segments, parameters, starts, weights, tolerance, fixed)
    for _ in range(rounds):
        if found is None:
            return None
        former, weights = weights, _weights(segments.measured, found.rms)
        if (np.abs(former / weights - 1.0) < SAME_WEIGHT).all():
            break
        found = minimise(segments, found.parameters, found.starts, weights, tolerance, fixed)
    return found


def _weights(measured: Measured, rms: Floats) -> Floats:
    return np.asarray(1.0 / np.maximum(rms, LEAST_NOISE * measured.spread))


def _misfit(measured: Measured, found: Solution) -> float:
    """-2 log likelihood of Gaussian noise of the levels found, up to a constant."""
    return float(-2.0 * measured.samples @ np.log(_weights(measured, found.rms)))


def _covariance(segments: Segments, found: Solution) -> Floats | None:
    """Covariance of the parameters, initial states eliminated; None if they cannot be told apart.

    Residuals that are correlated in time make (J'J)^-1 too small: between two of them stands the sum over blocks of the
    outer products of J'r, for blocks that are longer than the correlation.
    """
    runs = segments.run(found.parameters, found.starts)
    assert runs is not None
    measured = segments.measured
    weights = _weights(measured, found.rms)
    d, p = found.starts.shape[1], len(found.parameters)
    per_segment = max(1, math.ceil(BLOCKS / segments.count))
    information, scores = np.zeros((p, p)), []
    for r, jacobian in runs:
        J = (jacobian * weights[:, None]).reshape(-1, d + p)
        J = J[:, d:] - J[:, :d] @ np.linalg.lstsq(J[:, :d], J[:, d:])[0]
        information += J.T @ J
        gradient = np.einsum("nmp,nm->np", J.reshape(*r.shape, p), r * weights)
        edges = np.linspace(0, len(r), per_segment + 1)[:-1].round().astype(np.intp)
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
    factor = samples / max(samples - p - found.starts.size, 1)
    if measured.rows >= BLOCKS * BLOCK_ROWS and any(
        inspect_residuals([r[:, c] for r, _ in runs]).correlated for c in range(len(weights))
    ):
        blocks = np.concatenate(scores) * scale
        factor *= len(blocks) / max(len(blocks) - p, 1)
        inverse = inverse @ (blocks.T @ blocks) @ inverse
    covariance = factor * inverse * np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))
