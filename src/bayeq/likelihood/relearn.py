"""Noise levels and spectra of all rows, where some of them were fitted and the likelihood of all is a sum over blocks.

About the fit the likelihood is quadratic in coefficients and levels together. How it curves is taken from the rows that
were fitted, by differences; its slopes are those of all rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from bayeq.likelihood.block import Block, adjoints_of, statistics
from bayeq.likelihood.fit import Quadratic, State, coefficients
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

# Levels move by no more than this in a step: variances of noise by a factor of 2.7, those of discrepancies, whose
# memory goes with them, by a half.
LONGEST, OF_DISCREPANCIES = 1.0, 0.5


@dataclass(frozen=True, eq=False)
class Curvature:
    """How the likelihood of a fit curves, of one sample on average.

    Attributes
    ----------
    moving : (K,) int array
        The levels, as entries of `Levels.free`, that are neither known nor at a bound.
    turning : (L,) int array
        The noisy inputs whose spectrum has a corner.
    slopes : (C (P + 1), K + L) array
        Derivatives of the slopes by all candidates, by these levels and by the logarithms of these corners.
    scores : (K, K + L) array
        Derivatives of the slopes by the levels.
    spreads : (K + L,) array
        How far the logarithms of the standard deviations of coefficients in the model follow them, at most.
    """

    moving: Ints
    turning: Ints
    slopes: Floats
    scores: Floats
    spreads: Floats


def curvature(task: Task, state: State) -> Curvature:
    """By differences between likelihoods with one level or corner moved, in threads."""
    from joblib import cpu_count  # which takes a while to import

    levels = state.levels
    low, high = levels.bounds
    free = levels.free
    moving = np.flatnonzero((free > low + AT_BOUND) & (free < high - AT_BOUND) & ~levels.known)
    moved = [replace(state, levels=levels.moved(free + STEP * (np.arange(len(free)) == k))) for k in moving]
    layout = task.layout
    turning, corners = np.flatnonzero(layout.smoothness), np.array(layout.corners)
    turned = [tuple((corners * np.exp(STEP * (np.arange(len(corners)) == k))).tolist()) for k in turning]
    tasks = [task] * (1 + len(moving)) + [replace(task, layout=replace(layout, corners=one)) for one in turned]
    states = [state, *moved, *[state] * len(turning)]
    with threadpool_limits(1), ThreadPoolExecutor(cpu_count()) as pool:
        try:
            found = list(pool.map(_slopes, tasks, states))
        finally:
            pool.shutdown(cancel_futures=True)

    def by_levels(values: Sequence[Floats], count: float) -> Floats:
        moves = np.array([value - values[0] for value in values[1:]]).reshape(len(values) - 1, len(values[0]))
        return np.asarray(moves.T / (STEP * count))

    spreads = by_levels([one.log_sd for one in found], 1.0)
    return Curvature(
        moving,
        turning,
        by_levels([one.by_candidates for one in found], task.rows),
        by_levels([one.by_levels for one in found], task.rows)[moving],
        np.abs(spreads).max(axis=0, initial=0.0),
    )


class _Slopes(NamedTuple):
    """Of the log likelihood, by all candidates and by the levels; logarithms of standard deviations of the included."""

    by_candidates: Floats
    by_levels: Floats
    log_sd: Floats


def _slopes(task: Task, state: State) -> _Slopes:
    """Record by record, which takes little memory."""
    theta, included = coefficients(task.layout, state), task.number(state.chosen)
    by_candidates, by_levels = np.zeros(len(theta)), np.zeros(len(state.levels.free))
    H = np.diag(task.precision[included])
    for k, (one, path) in enumerate(zip(task.series, state.paths, strict=True)):
        own, here = replace(task, series=(one,), recent=[]), replace(state, paths=(path,), blurs=state.blurs[k : k + 1])
        linears = own.linearised(here)
        # slopes by coefficients are those along the path that these levels make likeliest
        here = replace(here, paths=(path + adjoints_of(here, linears)[0].deviation,))
        linears = own.linearised(here)
        found, score = statistics(own, here, linears, adjoints_of(here, linears))
        by_candidates += found.slope - found.information @ theta
        by_levels += score
        H += found.information[np.ix_(included, included)]
    return _Slopes(by_candidates, by_levels, 0.5 * np.log(np.diagonal(np.linalg.inv(H))))


class Relearned(NamedTuple):
    """A fit with the levels of all rows.

    Attributes
    ----------
    task, state : Task, State
        With the corners and the levels of all rows.
    quadratic : Quadratic
        The likelihood of all candidates there.
    moved : float
        How far the logarithm of a noise level, a corner or a standard deviation has moved, at most.
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
    layout, levels, theta = task.layout, state.levels, coefficients(task.layout, state)
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
    others = ~levels.optional[curve.moving]
    longest = np.where(others, LONGEST, OF_DISCREPANCIES)
    moved[:count] += _uphill(0.5 * (A + A.T), score + B[included, :count].T @ carried[:, -1], longest)
    quadratic = replace(q, slope=q.slope + B @ moved)
    free = levels.free
    free[curve.moving] += moved[:count]
    # the likelihood is smooth in a discrepancy's variance, which may be nothing, rather than in its logarithm
    sizes = slice(len(levels.channels), len(levels.channels) + len(levels.discrepancy))
    free[sizes] = levels.free[sizes] + np.log1p(free[sizes] - levels.free[sizes])
    levels = replace(state.levels.moved(np.clip(free, *levels.bounds)), hessian=levels.hessian)
    # those of discrepancies count by what they do
    by_levels = np.abs(np.append(moved[:count][others], by_corners)).max(initial=0.0)
    farthest = max(float(by_levels), float(curve.spreads @ np.abs(moved)))
    return Relearned(task, replace(state, levels=levels), quadratic, farthest)


def _uphill(A: Floats, slope: Floats, longest: Floats) -> Floats:
    """A Newton step to a maximum; steps that would be too long are cut, and the others solved again for these."""
    step = _newton(A, slope)
    cut = np.clip(step, -longest, longest)
    short, rest = np.flatnonzero(cut != step), np.flatnonzero(cut == step)
    again = _newton(A[np.ix_(rest, rest)], slope[rest] - A[np.ix_(rest, short)] @ cut[short])
    cut[rest] = np.clip(again, -longest[rest], longest[rest])
    return cut


def _newton(A: Floats, slope: Floats) -> Floats:
    """Where the likelihood hardly curves the step is that of a unit of information."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray(vectors @ ((vectors.T @ slope) / np.maximum(np.abs(values), 1.0)))
