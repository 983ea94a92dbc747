"""Noise levels and spectra of all rows, where some of them were fitted and the likelihood of all is a sum over blocks.

About the fit the likelihood is quadratic in coefficients and levels together. How it curves is taken from the rows that
were fitted, by differences; its slopes are those of all rows.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayeq.likelihood.block import Block, adjoints_of, statistics
from bayeq.likelihood.fit import Quadratic, State
from bayeq.likelihood.low_pass import SEGMENT, of_segments
from bayeq.likelihood.search import Task
from bayeq.likelihood.start import with_spectra

__all__ = ["Curvature", "Relearned", "curvature", "relearned"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Differences are taken over this share of a variance or of a corner.
STEP = 1e-3

# A level as near to its bound as this stays there.
AT_BOUND = 1e-2

# Levels move by no more than this in a step: variances by a factor of 2.7.
LONGEST = 1.0


@dataclass(frozen=True, eq=False)
class Curvature:
    """How the likelihood of a fit curves, of one sample on average.

    Attributes
    ----------
    moving : (K,) int array
        The noise of channels and the steps of inputs among `Levels.free`, those at bounds left out.
    turning : (L,) int array
        The noisy inputs whose spectrum has a corner.
    slopes : (C (P + 1), K + L) array
        Derivatives of the slopes by all candidates, by these levels and by the logarithms of these corners.
    scores : (K, K + L) array
        Derivatives of the slopes by the levels.
    """

    moving: Ints
    turning: Ints
    slopes: Floats
    scores: Floats


def curvature(task: Task, state: State) -> Curvature:
    """By differences between likelihoods with one level or corner moved, in threads."""
    from joblib import cpu_count  # which takes a while to import

    levels = state.levels
    low, high = levels.bounds
    free = levels.free
    inside = (free > low + AT_BOUND) & (free < high - AT_BOUND)
    channels = len(levels.channels)
    inside[:channels] &= levels.learned
    inside[channels : channels + 2 * len(levels.discrepancy)] = False
    moving = np.flatnonzero(inside)
    moved = [replace(state, levels=levels.moved(free + STEP * (np.arange(len(free)) == k))) for k in moving]
    layout = task.layout
    turning, corners = np.flatnonzero(layout.smoothness), np.array(layout.corners)
    turned = [tuple((corners * np.exp(STEP * (np.arange(len(corners)) == k))).tolist()) for k in turning]
    tasks = [task] * (1 + len(moving)) + [replace(task, layout=replace(layout, corners=one)) for one in turned]
    states = [state, *moved, *[state] * len(turning)]
    with threadpool_limits(1), ThreadPoolExecutor(cpu_count()) as pool:
        try:
            (slope, score), *others = pool.map(_slopes, tasks, states)
        finally:
            pool.shutdown(cancel_futures=True)
    scale = STEP * task.rows
    slopes = np.array([other[0] - slope for other in others]).reshape(-1, len(slope)).T / scale
    scores = np.array([other[1] - score for other in others]).reshape(-1, len(score)).T / scale
    return Curvature(moving, turning, slopes, scores[moving])


def _slopes(task: Task, state: State) -> tuple[Floats, Floats]:
    """Of the log likelihood, by all candidates and by the levels; record by record, which takes little memory."""
    theta = _coefficients(task, state)
    by_candidates, by_levels = np.zeros(len(theta)), np.zeros(len(state.levels.free))
    for one, path in zip(task.series, state.paths, strict=True):
        own, here = replace(task, series=(one,), recent=[]), replace(state, paths=(path,))
        linears = own.linearised(here)
        # slopes by coefficients are those along the path that these levels make likeliest
        here = replace(here, paths=(path + adjoints_of(here, linears)[0].deviation,))
        linears = own.linearised(here)
        found, score = statistics(own, here, linears, adjoints_of(here, linears))
        by_candidates += found.slope - found.information @ theta
        by_levels += score
    return by_candidates, by_levels


def _coefficients(task: Task, state: State) -> Floats:
    theta = np.zeros(len(task.precision))
    theta[task.number(state.chosen)] = state.theta
    return theta


class Relearned(NamedTuple):
    """A fit with the levels of all rows.

    Attributes
    ----------
    task, state : Task, State
        With the corners and the levels of all rows.
    quadratic : Quadratic
        The likelihood of all candidates there.
    moved : float
        How far the logarithm of a level or a corner has moved at most.
    """

    task: Task
    state: State
    quadratic: Quadratic
    moved: float


def relearned(task: Task, state: State, block: Block, curve: Curvature) -> Relearned:
    """What all rows say: corners from their spectra, and levels by a Newton step that coefficients take part in.

    Parameters
    ----------
    task, state : Task, State
        What the block is about.
    block : Block
        All rows.
    curve : Curvature
        Of the rows that were fitted.
    """
    layout, levels, theta = task.layout, state.levels, _coefficients(task, state)
    spectra = [of_segments(power, block.segments, SEGMENT) for power in block.power]
    task, state = with_spectra(task, state, spectra)
    by_corners = np.log([task.layout.corners[k] / layout.corners[k] for k in curve.turning])
    # what steps of inputs move with their corners
    moved = np.concatenate([(state.levels.free - levels.free)[curve.moving], by_corners])

    B, S, count = block.samples * curve.slopes, block.samples * curve.scores, len(curve.moving)
    included = task.number(state.chosen)
    q, known = block.quadratic, task.precision[included]
    slope = q.slope - q.information @ theta + B @ moved
    score = block.score[curve.moving] + S @ moved
    H = q.information[np.ix_(included, included)] + np.diag(known)
    carried = np.linalg.solve(H, np.column_stack([B[included, :count], slope[included] - known * theta[included]]))
    A = -S[:, :count] - B[included, :count].T @ carried[:, :-1]
    step = _uphill(0.5 * (A + A.T), score + B[included, :count].T @ carried[:, -1])
    moved[:count] += step
    free = levels.free
    free[curve.moving] += moved[:count]
    levels = replace(state.levels.moved(np.clip(free, *levels.bounds)), hessian=levels.hessian)
    quadratic = replace(q, slope=q.slope + B @ moved)
    return Relearned(task, replace(state, levels=levels), quadratic, float(np.abs(moved).max(initial=0.0)))


def _uphill(A: Floats, slope: Floats) -> Floats:
    """A Newton step to a maximum; where the likelihood hardly curves it is that of a unit of information."""
    values, vectors = np.linalg.eigh(A)
    return np.clip(vectors @ ((vectors.T @ slope) / np.maximum(np.abs(values), 1.0)), -LONGEST, LONGEST)
