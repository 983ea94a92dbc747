"""The likelihood of further rows about a fit: what a long record adds to that of some of its stretches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.likelihood.filter import Adjoint, run_filter
from bayeq.likelihood.fit import Quadratic, State, Statistics, adjoints, corrections, information
from bayeq.likelihood.layout import NOTHING
from bayeq.likelihood.linear import Linear
from bayeq.likelihood.low_pass import SEGMENT, periodograms
from bayeq.likelihood.projection import ENOUGH, LEAST_ROWS, batched, time_around
from bayeq.likelihood.search import Task
from bayeq.likelihood.start import series_and_paths
from bayeq.states import MotionRows

__all__ = ["Block", "at_its_path", "adjoints_of", "block_of", "statistics"]

Floats = NDArray[np.float64]
Counts = NDArray[np.int64]

# Steps of the path at most, and the deviation, in standard deviations of a state, that ends them.
STEPS, NEAR = 6, 3e-3


@dataclass(frozen=True, eq=False)
class Block:
    """What the likelihood says of some rows.

    Attributes
    ----------
    quadratic : Quadratic
        The log likelihood of all candidates about zero.
    score : (F,) array
        Its derivatives by the levels, at the coefficients that it is taken about.
    power : (L, B) array
        Sums of the periodograms of the noisy inputs.
    segments : int
        Number of these.
    samples : float
        Number of samples.
    products, pulls : (B, r, r) and (B, r) arrays
        Over batches of rows, see `bayeq.likelihood.projection`: of the model's columns with each other, and with the
        discrepancies of their equations.
    squares, weight : (C,) array, float
        Sums of the squares of the discrepancies, and of the weights of rows.
    lost : int
        Rows of which it could not be evaluated.
    absent : (2, C) int array
        Samples of each channel that are missing, and that were left out as bad; empty where nobody counted them.
    """

    quadratic: Quadratic
    score: Floats
    power: Floats
    segments: int
    samples: float
    products: Floats
    pulls: Floats
    squares: Floats
    weight: float = 0.0
    lost: int = 0
    absent: Counts = field(default_factory=lambda: np.zeros((2, 0), dtype=np.int64))

    def __add__(self, other: Block) -> Block:
        a, b = self.quadratic, other.quadratic
        return Block(
            Quadratic(a.level + b.level, a.slope + b.slope, a.information + b.information),
            self.score + other.score,
            self.power + other.power,
            self.segments + other.segments,
            self.samples + other.samples,
            np.concatenate([self.products, other.products]),
            np.concatenate([self.pulls, other.pulls]),
            self.squares + other.squares,
            self.weight + other.weight,
            self.lost + other.lost,
            self.absent + other.absent,
        )


def block_of(task: Task, state: State, pieces: Sequence[MotionRows]) -> Block:
    """The likelihood of rows given the coefficients, levels and prior of a fit, about the path that is likeliest there.

    Parameters
    ----------
    task, state : Task, State
        What other rows of the same system were explained by.
    pieces : sequence of MotionRows
        Rows, smoothed.
    """
    power, segments = _power(task, pieces)
    size, rows = len(task.precision), sum(piece.n for piece in pieces)
    nothing = Block(
        Quadratic(0.0, np.zeros(size), np.zeros((size, size))),
        np.zeros(len(state.levels.free)),
        np.zeros_like(power),
        0,
        0.0,
        np.zeros((0, len(state.theta), len(state.theta))),
        np.zeros((0, len(state.theta))),
        np.zeros(task.layout.chains),
        lost=rows,
    )
    if not pieces:
        return nothing
    try:
        series, paths = series_and_paths(task.layout, pieces)
        own, here = replace(task, series=series, recent=[]), replace(state, paths=paths, blurs=())
        here, linears, adjoints = at_its_path(own, here)
        found, score = statistics(own, here, linears, adjoints)
        parts = [
            _batches(own, here, k, linear, adj) for k, (linear, adj) in enumerate(zip(linears, adjoints, strict=True))
        ]
    except np.linalg.LinAlgError:
        return nothing
    if not all(np.isfinite(values).all() for values in (found.slope, found.information, score)):
        return nothing
    products, pulls, squares, weight = zip(*parts, strict=True)
    return Block(
        found,
        score,
        power,
        segments,
        own.rows,
        np.concatenate(products),
        np.concatenate(pulls),
        np.sum(squares, axis=0),
        float(sum(weight)),
    )


def _batches(task: Task, state: State, k: int, linear: Linear, found: Adjoint) -> tuple[Floats, Floats, Floats, float]:
    """Sums of record k for the projection: products, pulls, squares and weight."""
    columns, own = linear.terms[:, state.chosen.term], task.layout.discrepancy
    d, w = state.paths[k][:, own] + found.deviation[:, own], time_around(task.series[k].intervals)
    count = max(1, min(ENOUGH, len(w) // LEAST_ROWS))
    return *batched(columns, d[:, state.chosen.chain], w, count), w @ d**2, float(w.sum())


def _power(task: Task, pieces: Sequence[MotionRows]) -> tuple[Floats, int]:
    """Sums of the periodograms of the noisy inputs, and their number."""
    layout, segments = task.layout, 0
    power = np.zeros((len(layout.roles.inputs), (SEGMENT - 1) // 2))
    for k, (name, centre) in enumerate(zip(layout.roles.inputs, layout.centres, strict=True)):
        segments = 0
        for piece in pieces:
            part, count = periodograms(piece.columns[name] - centre, SEGMENT)
            power[k] += part
            segments += count
    return power, segments


def at_its_path(task: Task, state: State) -> tuple[State, list[Linear], list[Adjoint]]:
    """The model linearised about the path that the coefficients and the samples make likeliest."""
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
    """The adjoints of records at the coefficients that they are linearised about."""
    none, square = np.zeros(0), np.zeros((0, 0))
    about = Statistics(0.0, none, square, tuple(run_filter(linear, NOTHING, state.levels.noise) for linear in linears))
    return adjoints(linears, state.levels, about, none, square, True, bool(state.levels.layout.jumps))


def statistics(
    task: Task, state: State, linears: Sequence[Linear], found: Sequence[Adjoint]
) -> tuple[Quadratic, Floats]:
    """The log likelihood of all candidates about zero, and its derivatives by the levels, from `adjoints_of`."""
    curved = corrections(task.layout, linears, found)
    score = np.sum([state.levels.slopes(one) for one in found], axis=0)
    return information(task.layout, linears, state, curved), score
