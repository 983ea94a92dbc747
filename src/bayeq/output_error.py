"""Output-error estimation: the parameters whose free run comes closest to what was measured, and how well they are known.

Segments of multiple shooting set how long a run is free. The longer it is, the more it says about the parameters, until
what drives it unseen (noise in a measured force) has grown beyond the noise of the channels. Hence segments are
made longer, or shorter, as long as the covariance of the parameters gets smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.shooting import Measured, Segments, Solution, minimise

__all__ = ["OutputError", "output_error"]

Floats = NDArray[np.float64]

# A run follows the record while it errs by less than this share of every channel's standard deviation.
FOLLOWS = 0.5

# The first segments: this many, fewer where they would have fewer rows than SHORTEST.
FIRST = 16
SHORTEST = 8

# Lengths tried after the best one before the search ends.
PATIENCE = 2

# Channels are weighted by the inverse of their residuals' rms, but as if that were at least this share of their spread.
LEAST_NOISE = 1e-8

# Relative decrease of the cost at which the fit of a length is done, and that of the last; rounds of weighting, and the
# change of every weight at which they end.
ROUGHLY, FINELY = 1e-4, 1e-10
MOST_ROUNDS = 20
SAME_WEIGHT = 1e-3

# Blocks of the sandwich covariance at least, and the rows that a block must have.
BLOCKS = 16
BLOCK_ROWS = 8

# Parameters are not told apart where the condition number of their scaled information exceeds this.
SINGULAR = 1e13


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
    steps : int
        Steps taken in all.
    converged : bool
        False if the last fit ended at its limit.
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
class _Trial:
    segments: Segments
    found: Solution
    log_volume: float


def output_error(measured: Measured, parameters: Floats, length: int | None = None) -> OutputError | None:
    """Parameters by output error, starting from those of a regression.

    Channels are weighted by the inverse of their residuals' standard deviation, by turns with the fit: the maximum
    likelihood of Gaussian noise of unknown levels.

    Parameters
    ----------
    measured : Measured
        Records and the model.
    parameters : (p,) array
        Where to start.
    length : int, optional
        Rows of a segment; by default the length at which the parameters are known best.

    Returns
    -------
    OutputError or None
        None if no free run follows the records, if the parameters cannot be told from each other, or if nothing was
        found that fits better than the start.
    """
    trials = _search(measured, parameters, length)
    if not trials:
        return None
    best = min(trials, key=lambda trial: trial.log_volume) if length is None else trials[-1]
    segments = best.segments
    found = _weighted(segments, best.found.parameters, best.found.starts, FINELY) or best.found
    covariance = _covariance(segments, found)
    before = _weighted(segments, parameters, segments.starts(), FINELY, fixed=True)
    if covariance is None or (before is not None and _misfit(measured, before) < _misfit(measured, found)):
        return None
    return OutputError(
        parameters=found.parameters,
        covariance=covariance,
        noise_sd=found.rms,
        start_sd=np.full(len(found.rms), np.inf) if before is None else before.rms,
        segments=segments.count,
        longest=segments.longest,
        steps=sum(trial.found.steps for trial in trials) + found.steps,
        converged=found.converged,
    )


def _search(measured: Measured, parameters: Floats, length: int | None) -> list[_Trial]:
    """Fits of segments of several lengths; the last is as long as wanted, or as the runs can follow, if that is set."""
    limit = float(measured.longest if length is None else length)
    rows = min(max(measured.longest / FIRST, SHORTEST), limit)
    first = _trial(measured, parameters, rows)
    while first is None and rows >= 2 * SHORTEST:  # the regression follows for a shorter time only
        rows /= 2
        first = _trial(measured, parameters, rows)
    if first is None:
        return []
    trials, worse, longer = [first], 0, rows
    while longer < limit and (worse < PATIENCE or length is not None):
        longer = min(2 * longer, limit)
        trial = _trial(measured, trials[-1].found.parameters, longer)
        if trial is None:
            break
        worse = 0 if all(trial.log_volume < t.log_volume for t in trials) else worse + 1
        trials.append(trial)
    shorter = length is None and all(first.log_volume <= t.log_volume for t in trials)
    last = first
    while shorter and rows >= 2 * SHORTEST:
        rows /= 2
        trial = _trial(measured, last.found.parameters, rows)
        shorter = trial is not None and trial.log_volume < last.log_volume
        if trial is not None and shorter:
            trials.append(trial)
            last = trial
    return trials


def _trial(measured: Measured, parameters: Floats, length: float) -> _Trial | None:
    """Fit of one length; None if its runs do not follow the records, or do not determine the parameters."""
    segments = Segments(measured, length)
    found = _weighted(segments, parameters, segments.starts(), ROUGHLY)
    if found is None or (found.rms > FOLLOWS * measured.spread).any():
        return None
    covariance = _covariance(segments, found)
    if covariance is None:
        return None
    return _Trial(segments, found, float(np.linalg.slogdet(covariance)[1]))


def _weighted(
    segments: Segments, parameters: Floats, starts: Floats, tolerance: float, fixed: bool = False
) -> Solution | None:
    """`minimise` with weights that follow from its residuals."""
    weights = _weights(segments.measured, segments.measured.spread)
    steps = 0
    for _ in range(MOST_ROUNDS):
        found = minimise(segments, parameters, starts, weights, tolerance, fixed)
        if found is None:
            return None
        steps += found.steps
        parameters, starts = found.parameters, found.starts
        former, weights = weights, _weights(segments.measured, found.rms)
        if (np.abs(former / weights - 1.0) < SAME_WEIGHT).all():
            break
    return replace(found, steps=steps)


def _weights(measured: Measured, rms: Floats) -> Floats:
    return np.asarray(1.0 / np.maximum(rms, LEAST_NOISE * measured.spread))


def _misfit(measured: Measured, found: Solution) -> float:
    """-2 log likelihood of Gaussian noise of the levels found, up to a constant."""
    return float(-2.0 * measured.samples @ np.log(_weights(measured, found.rms)))


def _covariance(segments: Segments, found: Solution) -> Floats | None:
    """Covariance of the parameters, initial states eliminated; None if they cannot be told apart.

    Residuals that are correlated in time make (J'J)^-1 too small: between two of them stands the sum over blocks of the
    outer products of J'r, which needs blocks longer than the correlation.
    """
    runs = segments.run(found.parameters, found.starts)
    assert runs is not None
    measured = segments.measured
    weights = _weights(measured, found.rms)
    d, p = found.starts.shape[1], len(found.parameters)
    rows = sum(len(r) for r, _ in runs)
    sandwich = rows >= BLOCKS * BLOCK_ROWS
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
    if sandwich:
        blocks = np.concatenate(scores) * scale
        factor *= len(blocks) / (len(blocks) - 1)
        inverse = inverse @ (blocks.T @ blocks) @ inverse
    covariance = factor * inverse * np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))
