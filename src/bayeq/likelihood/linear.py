"""The model linearised about a path: transitions of the states, columns of the candidates, what is left of the data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.expressions.tape import Program, run_tape
from bayeq.kernels import kernel
from bayeq.likelihood.arrays import arrays
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.ode.rk4 import STAGES, advance, slope_at

__all__ = ["Linear", "Series", "derivatives_along", "linearise"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Series(NamedTuple):
    """The samples of one record.

    Attributes
    ----------
    intervals : (n - 1,) array
        Between samples [s].
    samples : (n, M) array
        Of `Layout.channels`; NaN where there is none.
    inputs : (n, m, 4) array
        What `Layout.given` names, from `bayeq.ode.rk4.interpolant`.
    spread : (n, M) array
        Variance of the noise of each sample as a multiple of its channel's.
    unresolved : (n, M) array
        Variance that each sample has besides: of what the mean of jumps leaves out.
    """

    intervals: Floats
    samples: Floats
    inputs: Floats
    spread: Floats
    unresolved: Floats


class Linear(NamedTuple):
    """A record's model, linear in the deviations from a path and from some coefficients.

    Attributes
    ----------
    path : (n, S) array
        States that it is linearised about.
    end : (n - 1, S) array
        Where a step from each of them ends, before the discrepancies and slopes change.
    transition : (n - 1, S, S) array
        Derivatives of `end` by the states.
    gradient : (n, C, S) array
        Derivatives of each target by the states.
    residual : (n, M) array
        Samples less what the path gives; NaN where there is none.
    terms, middle : (n, P + 1) and (n - 1, P + 1) arrays
        The candidates and the constant at the path, and between its samples.
    weights : (n - 1, 3, C, S) array
        What a term at the start, in the middle and at the end of a step, as part of each equation, adds to `end`.
    kinds : (M,) array
        See `Layout.channels`.
    follows, leads : (S, S) int arrays
        Of each state, how many others its next value may depend on, and which; and how many depend on it, and which.
    spread, unresolved : (n, M) arrays
        As in `Series`.
    """

    path: Floats
    end: Floats
    transition: Floats
    gradient: Floats
    residual: Floats
    terms: Floats
    middle: Floats
    weights: Floats
    kinds: Ints
    follows: Ints
    leads: Ints
    spread: Floats
    unresolved: Floats


@kernel
def _steps(
    program: Program,
    inputs: Floats,
    intervals: Floats,
    substeps: int,
    path: Floats,
    end: Floats,
    transition: Floats,
    slowing: Floats,
    target: Floats,
    gradient: Floats,
) -> None:
    """Runge-Kutta steps from every state of a path, with their derivatives by it.

    Receives `end`, `transition` (as in `Linear`), how much less the rates are at the end of a step than at its start
    (n - 1, S), the targets (n, C) at the path and their `gradient`. At the next sample rates may be others again, for
    discrepancies and slopes change there.
    """
    n, size = path.shape
    tangents = np.zeros((program.registers.shape[0], size))
    work = np.zeros((STAGES, size * (1 + size)))
    for row in range(n):
        for i in range(size):
            work[0, i] = path[row, i]
            for j in range(size):
                work[0, size + i * size + j] = 1.0 if i == j else 0.0
        slope_at(program, inputs, work[0], row, 0.0, tangents, work[1])
        for c in range(target.shape[1]):
            output = program.outputs[size + c]
            target[row, c] = program.registers[output]
            for j in range(size):
                gradient[row, c, j] = tangents[output, j]
        if row < n - 1:
            for i in range(size):
                slowing[row, i] = work[1, i]
            advance(program, inputs, row, intervals[row], substeps, tangents, work)
            for i in range(size):
                end[row, i] = work[0, i]
                for j in range(size):
                    transition[row, i, j] = work[0, size + i * size + j]
            slope_at(program, inputs, work[0, :size], row, 1.0, None, work[1])
            for i in range(size):
                slowing[row, i] -= work[1, i]


def linearise(
    layout: Layout, series: Series, path: Floats, chosen: Candidates, theta: Floats, substeps: int = 1
) -> Linear:
    """The model of a record about a path and the coefficients `theta` of the chosen candidates.

    Parameters
    ----------
    layout : Layout
        States and channels.
    series : Series
        The record.
    path : (n, S) array
        States.
    chosen, theta : Candidates, (r,) array
        Coefficients that are not zero.
    substeps : int
        Runge-Kutta steps between two samples.
    """
    n, size, chains = len(path), layout.size, layout.chains
    end, transition, slowing, target, gradient = arrays(
        (n - 1, size), (n - 1, size, size), (n - 1, size), (n, chains), (n, chains, size)
    )
    program = layout.tape(chosen).program()
    first = size + series.inputs.shape[1]
    program.registers[first : first + len(theta)] = theta
    _steps(program, series.inputs, series.intervals, substeps, path, end, transition, slowing, target, gradient)
    between = 0.5 * (path[:-1] + end) + 0.125 * series.intervals[:, None] * slowing

    _to_mean(layout, series.intervals, end, transition)
    seen = path[:, np.maximum(layout.kinds, 0)]
    for channel in np.flatnonzero(layout.kinds < 0):
        seen[:, channel] = target[:, -1 - layout.kinds[channel]]
    exact = series.inputs
    halfway = 0.5 * (exact[:, :, 0] + exact[:, :, 1]) + 0.25 * (exact[:, :, 2] + 0.5 * exact[:, :, 3])
    related = (transition != 0.0).any(axis=0)
    return Linear(
        path=path,
        end=end,
        transition=transition,
        gradient=gradient,
        residual=series.samples - seen,
        terms=_terms(layout, path, exact[:, :, 0]),
        middle=_terms(layout, between, halfway[:-1]),
        weights=_weights(layout, series.intervals, transition),
        kinds=layout.kinds,
        follows=_others(related),
        leads=_others(related.T),
        spread=series.spread,
        unresolved=series.unresolved,
    )


def _others(related: NDArray[np.bool_]) -> Ints:
    """In each row the number of entries beside the diagonal, then where they stand."""
    out = np.zeros(related.shape, dtype=np.int64)
    for i, row in enumerate(related):
        others = np.setdiff1d(np.flatnonzero(row), [i])
        out[i, 0], out[i, 1 : 1 + len(others)] = len(others), others
    return out


def _to_mean(layout: Layout, intervals: Floats, end: Floats, transition: Floats) -> None:
    """The highest derivative of each input at the end of steps: what it becomes at the next sample, on average.

    `end` and `transition` receive it.
    """
    for k, (first, slope, centre) in enumerate(zip(layout.driven, layout.slope, layout.centres, strict=True)):
        states = slice(first, slope + 1)
        factors = layout.feedback(k, intervals)
        deviation = end[:, states].copy()
        deviation[:, 0] -= centre
        end[:, slope] = np.einsum("nj,nj->n", factors, deviation)
        transition[:, slope] = np.einsum("nj,njs->ns", factors, transition[:, states])


def _terms(layout: Layout, states: Floats, inputs: Floats) -> Floats:
    """Candidates and the constant at some states, (n, P + 1)."""
    columns = dict(zip(layout.names, np.asfortranarray(states).T, strict=True))
    columns |= dict(zip(layout.given, inputs.T, strict=True))
    out = np.ones((len(states), len(layout.terms) + 1))
    out[:, :-1] = evaluate_terms(layout.blurred, columns)
    return out


def _weights(layout: Layout, intervals: Floats, transition: Floats) -> Floats:
    """Simpson's rule along each step, made exact for what is constant: a discrepancy is such a term."""
    out = np.zeros((len(intervals), 3, layout.chains, layout.size))
    for c, (last, d) in enumerate(zip(layout.last, layout.discrepancy, strict=True)):
        sixth = intervals * (layout.rates[c][-1] / 6.0)
        whole = transition[:, :, d].copy()
        whole[:, d] = 0.0
        out[:, 0, c] = sixth[:, None] * transition[:, :, last]
        out[:, 2, c, last] = sixth
        out[:, 1, c] = whole - out[:, 0, c] - out[:, 2, c]
    return out


@kernel
def _derivatives(
    program: Program, inputs: Floats, fraction: float, states: Floats, directions: Floats, out: Floats
) -> None:
    """Adds to `out` (C, P + 1) the derivatives of the tape's outputs along directions (n, C, S), summed over rows."""
    n, size = states.shape
    chains = directions.shape[1]
    tangents = np.zeros((program.registers.shape[0], chains))
    for row in range(n):
        for i in range(size):
            program.registers[i] = states[row, i]
            for c in range(chains):
                tangents[i, c] = directions[row, c, i]
        for k in range(inputs.shape[1]):
            p = inputs[row, k]
            program.registers[size + k] = (
                (1.0 - fraction) * p[0] + fraction * p[1] + fraction * (1.0 - fraction) * (p[2] + fraction * p[3])
            )
        run_tape(program, tangents)
        for c in range(chains):
            for j in range(out.shape[1]):
                out[c, j] += tangents[program.outputs[j], c]


def derivatives_along(
    layout: Layout, series: Series, states: Floats, directions: Floats, fraction: float = 0.0
) -> Floats:
    """Derivatives of every candidate along directions (n, C, S) at states (n, S), summed over rows: (C, P + 1)."""
    out = np.zeros((layout.chains, len(layout.terms) + 1))
    program = layout.terms_tape().program()
    _derivatives(program, series.inputs, fraction, np.ascontiguousarray(states), directions, out)
    return out
