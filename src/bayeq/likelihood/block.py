"""The likelihood of all rows, expanded about a fit to some: sums over blocks give noise levels and spectra.

About the fit the log likelihood is quadratic in coefficients and levels together. Its gradient and the information on
coefficients are sums over all rows; its other second derivatives are differences over the rows that were fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.likelihood.adjoint import Adjoint
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import Quadratic, State, Statistics, adjoints, bent_by, coefficients, information
from bayeq.likelihood.layout import NOTHING
from bayeq.likelihood.linear import Linear
from bayeq.likelihood.low_pass import SEGMENT, of_segments, periodograms
from bayeq.likelihood.model import Task
from bayeq.likelihood.projection import LEAST_ROWS, batched, time_around
from bayeq.likelihood.start import series_and_paths, with_spectra
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.states import MotionRows

# Most relinearisations about the path, and the move of the path, in standard deviations of each state, that ends them.
STEPS, NEAR = 6, 3e-3

# Step of the finite differences, in an entry of `Levels.free` or the logarithm of a corner.
STEP = 1e-3

# A level within this of its bound, in `Levels.free`, is held there.
AT_BOUND = 1e-2

# Largest steps in `Levels.free`: of noise and input steps (a factor of 2.7), and of the levels that may vanish, such as
# discrepancies (growth by a half) and their memories.
LONGEST, OF_DISCREPANCIES = 1.0, 0.5


@dataclass(frozen=True, eq=False)
class Block:
    """The log likelihood of a block of rows, and sums over them; blocks are added to those of all rows."""

    quadratic: Quadratic  # the log likelihood of all candidates about zero
    score: Floats  # (F,), its derivatives by `Levels.free`, at the coefficients of the linearisation
    power: Floats  # (L, B), sums of the periodograms of the noisy inputs
    segments: int  # number of periodograms in each sum
    samples: float  # number of samples
    # (B, r, r), sums over batches of rows of the products of the model's columns, see `bayeq.likelihood.projection`
    products: Floats
    pulls: Floats  # (B, r), the same of the columns with the discrepancies of their equations
    squares: Floats  # (C,), sums of the squares of the discrepancies
    weight: float = 0.0  # sum of the weights of rows
    lost: int = 0  # number of rows whose likelihood could not be evaluated
    # (2, M), number of samples of each channel that are missing, and that were left out as bad; empty if not counted
    absent: Ints = field(default_factory=lambda: np.zeros((2, 0), dtype=np.int64))

    def __add__(self, other: Block) -> Block:
        pairs = {one.name: (getattr(self, one.name), getattr(other, one.name)) for one in fields(self)}
        batches: dict[str, Any] = {name: np.concatenate(pairs.pop(name)) for name in ("products", "pulls")}
        return Block(**batches, **{name: one + another for name, (one, another) in pairs.items()})


def block_of(task: Task, state: State, pieces: Sequence[MotionRows]) -> Block:
    """The block of smoothed rows, linearised about their likeliest path, given a fit to other rows of the system."""
    power, segments = _power(task, pieces)
    size, r = len(task.precision), len(state.theta)
    nothing = Block(
        Quadratic(0.0, np.zeros(size), np.zeros((size, size))),
        np.zeros(len(state.levels.free)),
        np.zeros_like(power),
        0,
        0.0,
        np.zeros((0, r, r)),
        np.zeros((0, r)),
        np.zeros(task.layout.chains),
        lost=sum(piece.n for piece in pieces),
    )
    if not pieces:
        return nothing
    try:
        series, paths = series_and_paths(task.layout, pieces)
        own, here = replace(task, series=series), replace(state, paths=paths, blurs=())
        here, linears, adjoints = at_its_path(own, here)
        found, score = statistics(own, here, linears, adjoints)
        parts = [_batches(own, here, k, *pair) for k, pair in enumerate(zip(linears, adjoints, strict=True))]
    except np.linalg.LinAlgError:
        return nothing
    if not all(np.isfinite(values).all() for values in (found.slope, found.information, score)):
        return nothing
    products, pulls, squares, weight = zip(*parts, strict=True)
    batches = np.concatenate(products), np.concatenate(pulls), np.sum(squares, axis=0), float(sum(weight))
    return Block(found, score, power, segments, own.rows, *batches)


def _batches(task: Task, state: State, k: int, linear: Linear, found: Adjoint) -> tuple[Floats, Floats, Floats, float]:
    """Sums over batches of record k, for the projection: the fields products, pulls, squares and weight of `Block`."""
    columns, own = linear.terms[:, state.chosen.term], task.layout.discrepancy
    d, w = state.paths[k][:, own] + found.deviation[:, own], time_around(task.series[k].intervals)
    count = max(1, min(LIKELIHOOD.enough_batches, len(w) // LEAST_ROWS))
    return *batched(columns, d[:, state.chosen.chain], w, count), w @ d**2, float(w.sum())


def _power(task: Task, pieces: Sequence[MotionRows]) -> tuple[Floats, int]:
    """Sums of the periodograms of the noisy inputs, (L, B), and their number."""
    layout, segments = task.layout, 0
    power = np.zeros((len(layout.roles.inputs), (SEGMENT - 1) // 2))
    for own, name, centre in zip(power, layout.roles.inputs, layout.centres, strict=True):
        parts = [periodograms(piece.columns[name] - centre, SEGMENT) for piece in pieces]
        segments = sum(count for _, count in parts)
        own[:] = sum(part for part, _ in parts)
    return power, segments


def at_its_path(task: Task, state: State) -> tuple[State, list[Linear], list[Adjoint]]:
    """The state on its likeliest path given coefficients and samples, the model linearised there, and its adjoints."""
    spread = np.sqrt(state.levels.scales.variance)
    for _ in range(STEPS):
        linears = task.linearised(state)
        found = adjoints_of(state, linears)
        if max(float(np.abs(one.deviation / spread).max()) for one in found) < NEAR:
            break
        state = state.moved(task.layout, task.series, linears, found)
        task.recent.clear()
    return state, linears, found


def adjoints_of(state: State, linears: Sequence[Linear]) -> list[Adjoint]:
    """The adjoints of the records, with the coefficients of the linearisation held fixed."""
    none, square = np.zeros(0), np.zeros((0, 0))
    filtered = tuple(run_filter(linear, NOTHING, state.levels.noise) for linear in linears)
    about = Statistics(0.0, 0.0, none, square, filtered)
    return adjoints(linears, state.levels, about, none, square, True, bool(state.levels.layout.jumps))


def statistics(
    task: Task, state: State, linears: Sequence[Linear], found: Sequence[Adjoint]
) -> tuple[Quadratic, Floats]:
    """The log likelihood of all candidates, expanded about zero, and its derivatives by `Levels.free`."""
    bend, _ = bent_by(task.layout, linears, state, found)
    score = np.sum([state.levels.slopes(one) for one in found], axis=0)
    return information(task.layout, linears, state, bend), score


@dataclass(frozen=True, eq=False)
class Curvature:
    """Second derivatives of a fit's log likelihood, per sample."""

    moving: Ints  # (K,), the levels, as entries of `Levels.free`, that are neither known nor at a bound
    turning: Ints  # (L,), the noisy inputs whose spectrum has a corner
    # (C (P + 1), K + L), second derivatives by the coefficients of all candidates and by these levels and the
    # logarithms of these corners
    slopes: Floats
    scores: Floats  # (K, K + L), second derivatives by these levels and by levels and corners
    # (K + L,), largest derivative of a log standard deviation of a coefficient in the model by each level and corner
    spreads: Floats


def curvature(task: Task, state: State) -> Curvature:
    """The curvature by finite differences: one level or corner is moved at a time, in threads."""
    from concurrent.futures import ThreadPoolExecutor

    from joblib import cpu_count  # which takes a while to import
    from threadpoolctl import threadpool_limits

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
            found = list(zip(*pool.map(_slopes, tasks, states), strict=True))
        finally:
            pool.shutdown(cancel_futures=True)

    def by_levels(values: Sequence[Floats], count: float) -> Floats:
        moves = np.array([value - values[0] for value in values[1:]]).reshape(len(values) - 1, len(values[0]))
        return np.asarray(moves.T / (STEP * count))

    slopes, scores = by_levels(found[0], task.rows), by_levels(found[1], task.rows)[moving]
    return Curvature(moving, turning, slopes, scores, np.abs(by_levels(found[2], 1.0)).max(axis=0, initial=0.0))


def _slopes(task: Task, state: State) -> tuple[Floats, Floats, Floats]:
    """Gradients of the log likelihood, summed over records, by all candidates and levels; log sds of coefficients."""
    theta, included = coefficients(task.layout, state), task.number(state.chosen)
    by_candidates, by_levels = np.zeros(len(theta)), np.zeros(len(state.levels.free))
    H = np.diag(task.precision[included])
    for k, (one, path) in enumerate(zip(task.series, state.paths, strict=True)):
        own, here = replace(task, series=(one,)), replace(state, paths=(path,), blurs=state.blurs[k : k + 1])
        linears = own.linearised(here)
        # the gradient by coefficients is taken on the path that is likeliest with these levels
        here = replace(here, paths=(path + adjoints_of(here, linears)[0].deviation,))
        linears = own.linearised(here)
        found, score = statistics(own, here, linears, adjoints_of(here, linears))
        by_candidates += found.slope - found.information @ theta
        by_levels += score
        H += found.information[np.ix_(included, included)]
    return by_candidates, by_levels, 0.5 * np.log(np.diagonal(np.linalg.inv(H)))


def relearned(task: Task, state: State, block: Block, curve: Curvature) -> tuple[Task, State, Quadratic, float]:
    """Corners from the spectra of all rows, and levels by a Newton step of their likelihood jointly with coefficients.

    Also returned: the likelihood of all candidates there, and a bound on the change of the logarithm of any level of
    noise or input steps, corner, or standard deviation of a coefficient.
    """
    layout, levels, theta = task.layout, state.levels, coefficients(task.layout, state)
    spectra = [of_segments(power, block.segments, SEGMENT) for power in block.power]
    task, state = with_spectra(task, state, spectra)
    by_corners = np.log([task.layout.corners[k] / layout.corners[k] for k in curve.turning])
    # changes of the variances of input steps with the corners, then of the corners
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
    # the likelihood is smooth in a discrepancy's variance, which may be near zero, not in its logarithm
    sizes = slice(len(levels.channels), len(levels.channels) + len(levels.discrepancy))
    free[sizes] = levels.free[sizes] + np.log1p(free[sizes] - levels.free[sizes])
    levels = replace(state.levels.moved(np.clip(free, *levels.bounds)), hessian=levels.hessian)
    # levels that may vanish count only by their effect on the standard deviations of coefficients
    by_levels = np.abs(np.append(moved[:count][others], by_corners)).max(initial=0.0)
    farthest = max(float(by_levels), float(curve.spreads @ np.abs(moved)))
    return task, replace(state, levels=levels), quadratic, farthest


def _uphill(A: Floats, slope: Floats, longest: Floats) -> Floats:
    """A Newton step to a maximum; entries above `longest` are clipped, and the others are solved again given these."""
    step = _newton(A, slope)
    cut = np.clip(step, -longest, longest)
    short, rest = np.flatnonzero(cut != step), np.flatnonzero(cut == step)
    again = _newton(A[np.ix_(rest, rest)], slope[rest] - A[np.ix_(rest, short)] @ cut[short])
    cut[rest] = np.clip(again, -longest[rest], longest[rest])
    return cut


def _newton(A: Floats, slope: Floats) -> Floats:
    """A Newton step with the eigenvalues of the information A replaced by their absolute values, 1 at least."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray(vectors @ ((vectors.T @ slope) / np.maximum(np.abs(values), 1.0)))
