"""The model linearised about a path: transitions of the states, columns of the candidates, what is left of the data."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.expressions.tape import Program, run_tape
from bayeq.kernels import kernel
from bayeq.likelihood.arrays import arrays
from bayeq.likelihood.blur import Blur, Hold, crossings, first_blur
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.likelihood.series import Series
from bayeq.ode.rk4 import STAGES

__all__ = ["Linear", "derivatives_along", "linearise", "sources_of", "terms_at"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Runge-Kutta steps, at least, of an interval in which a term of the model jumps: the jump is located among them.
JUMP_STEPS = 8


class Steps(NamedTuple):
    """What is integrated from each sample to the next.

    Attributes
    ----------
    program : Program
        Rates of the states, the targets and the terms of the model, in states, inputs and coefficients.
    basis : Program
        The candidates and the constant, in states and inputs.
    inputs : (n, m, 4) array
        Those of the `Series`, then the widths of jumps.
    bends : (n, L, 2) array
        As in `Series`.
    driven : (L,) int array
        See `Layout.driven`.
    intervals : (n - 1,) array
        Between samples [s].
    substeps : (n - 1,) int array
        Runge-Kutta steps of each interval.
    last : (C,) int array
        See `Layout.last`.
    factors : (C,) array
        Rate of that state for a target of 1.
    motion : int
        Number of states that are derivatives of chains: the first ones, which alone depend on coefficients.
    rising : (S,) bool array
        Whether the rate of a state behind them is the next one, and not 0.
    straight : (S,) int array
        Whether a state behind them goes straight from one sample to the next, 1, or is held until that, 2.
    """

    program: Program
    basis: Program
    inputs: Floats
    bends: Floats
    driven: Ints
    intervals: Floats
    substeps: Ints
    last: Ints
    factors: Floats
    motion: int
    rising: NDArray[np.bool_]
    straight: Ints

    def fresh(self) -> Steps:
        """The same with registers of its own."""
        program, basis = (one._replace(registers=one.registers.copy()) for one in (self.program, self.basis))
        return self._replace(program=program, basis=basis)


class Tangents(NamedTuple):
    """Derivatives by the states: `tangents` of a program's registers, `powers` of the states that are no chain's."""

    tangents: Floats
    powers: Floats


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
        Derivatives of each target by the states; where channels drift, of what is measured of it, and behind these of
        each state.
    residual : (n, M) array
        Samples less what the path gives; NaN where there is none.
    kinds : (M,) array
        See `Layout.channels`; -1 - i for a channel of which ``gradient[:, i]`` tells.
    follows, leads : (S, S) int arrays
        Of each state, how many others its next value may depend on, and which; and how many depend on it, and which.
    spread : (n, M) array
        As in `Series`.
    unresolved, force : (n, M) and (n - 1, C) arrays
        As in `Blur`.
    bends : (n - 1, C, L) array
        Squares of what the target of each equation changes by as an input bends between samples.
    discrepancy : (C,) int array
        See `Layout.discrepancy`.
    terms : (n, P + 1) array
        The candidates and the constant at the path.
    open_to : (n, C) array
        Share of a term that shows in a sample of its target: 1, and 0 where a jump makes up for it.
    chosen : Candidates
        The coefficients of the model.
    sources : (n - 1, motion, r) array
        Derivatives of `end` by them, of the states of the chains.
    steps : Steps
        What `sources_of` other coefficients takes.
    holds : tuple of ((k,), (k, motion, motion)) arrays
        Intervals in which the arguments of jumps are held, and what that leaves of changes of the states.
    """

    path: Floats
    end: Floats
    transition: Floats
    gradient: Floats
    residual: Floats
    kinds: Ints
    follows: Ints
    leads: Ints
    spread: Floats
    unresolved: Floats
    force: Floats
    bends: Floats
    discrepancy: Ints
    terms: Floats
    open_to: Floats
    chosen: Candidates
    sources: Floats
    steps: Steps
    holds: tuple[tuple[NDArray[np.intp], Floats], ...]

    def in_order(self, channels: NDArray[np.intp]) -> Linear:
        """The same with the samples of the channels in another order."""
        columns = {name: getattr(self, name)[:, channels] for name in ("residual", "spread", "unresolved")}
        contiguous = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        return self._replace(kinds=self.kinds[channels], **contiguous)


@kernel(borrowing=True)
def _set_inputs(program: Program, inputs: Floats, size: int, row: int, fraction: float) -> None:
    """What is given, and widths, a fraction of the interval after a sample, into the registers behind the states."""
    rest = 1.0 - fraction
    for k in range(inputs.shape[1]):
        p = inputs[row, k]
        program.registers[size + k] = rest * p[0] + fraction * p[1] + fraction * rest * (p[2] + fraction * p[3])


@kernel(borrowing=True)
def _drift(steps: Steps, path: Floats, row: int, interval: float, fraction: float, last: bool, powers: Floats) -> None:
    """States that are no derivatives of chains, a fraction of an interval after a sample, into the program's registers.

    Each is constant or has the next one as its rate: Taylor's series; but inputs may go straight to where that ends, or
    be held until then (at the `last`). `powers` (S, S) receive derivatives by the states at the sample.
    """
    size = path.shape[1]
    for i in range(steps.motion, size):
        value, power, j = path[row, i], 1.0, i
        straight = 0 if last else steps.straight[i]
        time, share = (fraction * interval, 1.0) if straight == 0 else (interval, fraction if straight == 1 else 0.0)
        powers[i, i] = 1.0
        while steps.rising[j]:
            j += 1
            power *= time / (j - i)
            powers[i, j] = share * power
            value += share * power * path[row, j]
        steps.program.registers[i] = value
    for k in range(len(steps.driven)):
        bend = steps.bends[row, k, 0] + fraction * steps.bends[row, k, 1]
        steps.program.registers[steps.driven[k]] += fraction * (1.0 - fraction) * bend


@kernel(borrowing=True)
def _rates(
    steps: Steps, chosen: Candidates, own: bool, row: int, fraction: float, work: Tangents, y: Floats, rate: Floats
) -> None:
    """Rates of the states of chains (first column), of their derivatives by all states, and by the coefficients."""
    program, basis, motion = steps.program, steps.basis, steps.motion
    width, size, registers = y.shape[1], work.powers.shape[0], program.registers
    for i in range(motion):
        registers[i] = y[i, 0]
    _set_inputs(program, steps.inputs, size, row, fraction)
    run_tape(program, work.tangents)
    for i in range(motion):
        output = program.outputs[i]
        rate[i, 0] = registers[output]
        for j in range(1, width):
            rate[i, j] = 0.0
        for o in range(size):
            factor = work.tangents[output, o]
            if factor == 0.0:
                continue
            if o < motion:
                for j in range(1, width):
                    rate[i, j] += factor * y[o, j]
            else:
                for j in range(o, size):
                    rate[i, 1 + j] += factor * work.powers[o, j]
    r = width - 1 - size
    first = size + len(steps.factors)
    if r and not own:
        for i in range(size):
            basis.registers[i] = registers[i]
        _set_inputs(basis, steps.inputs, size, row, fraction)
        run_tape(basis, None)
    for j in range(r):
        c = chosen.chain[j]
        term = registers[program.outputs[first + j]] if own else basis.registers[basis.outputs[chosen.term[j]]]
        rate[steps.last[c], 1 + size + j] += steps.factors[c] * term


@kernel(borrowing=True)
def _ahead(x: Floats, h: float, rate: Floats, y: Floats) -> None:
    """x + h rate, into `y`."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            y[i, j] = x[i, j] + h * rate[i, j]


@kernel
def _integrate(
    steps: Steps,
    chosen: Candidates,
    own: bool,
    path: Floats,
    first: int,
    stop: int,
    end: Floats,
    transition: Floats,
    sources: Floats,
    target: Floats,
    gradient: Floats,
) -> None:
    """Runge-Kutta steps from samples `first` to `stop` of a path, with their derivatives by states and coefficients.

    Receives, from its first row on, what `Linear` has; of empty arrays nothing. `own`: these are the coefficients of
    the model.
    """
    (n, size), r, motion = path.shape, len(chosen.chain), steps.motion
    work = Tangents(np.zeros((steps.program.registers.shape[0], size)), np.zeros((size, size)))
    for i in range(size):
        work.tangents[i, i] = 1.0
    stages = np.zeros((STAGES, motion, 1 + size + r))
    x, y, k1, k2, k3, k4 = stages[0], stages[1], stages[2], stages[3], stages[4], stages[5]
    for row in range(first, stop):
        for i in range(motion):
            for j in range(1 + size + r):
                x[i, j] = 1.0 if j == 1 + i else 0.0
            x[i, 0] = path[row, i]
        count = steps.substeps[row] if row < n - 1 else 1
        share = 1.0 / count
        for step in range(count):
            whole = steps.intervals[row] if row < n - 1 else 0.0
            _drift(steps, path, row, whole, step * share, False, work.powers)
            _rates(steps, chosen, own, row, step * share, work, x, k1)
            if step == 0:
                for c in range(target.shape[1]):
                    output = steps.program.outputs[size + c]
                    target[row, c] = steps.program.registers[output]
                    for j in range(size):
                        gradient[row, c, j] = work.tangents[output, j]
            if row == n - 1:
                break
            h = whole * share
            _ahead(x, 0.5 * h, k1, y)
            _drift(steps, path, row, whole, (step + 0.5) * share, False, work.powers)
            _rates(steps, chosen, own, row, (step + 0.5) * share, work, y, k2)
            _ahead(x, 0.5 * h, k2, y)
            _rates(steps, chosen, own, row, (step + 0.5) * share, work, y, k3)
            _ahead(x, h, k3, y)
            _drift(steps, path, row, whole, (step + 1.0) * share, False, work.powers)
            _rates(steps, chosen, own, row, (step + 1.0) * share, work, y, k4)
            for i in range(motion):
                for j in range(1 + size + r):
                    x[i, j] += h / 6.0 * (k1[i, j] + 2.0 * (k2[i, j] + k3[i, j]) + k4[i, j])
        if row < n - 1:
            at = row - first
            if end.shape[1]:
                _drift(steps, path, row, whole, 1.0, True, work.powers)
            for i in range(end.shape[1]):
                end[at, i] = x[i, 0] if i < motion else steps.program.registers[i]
                for j in range(size):
                    transition[at, i, j] = x[i, 1 + j] if i < motion else work.powers[i, j]
            for i in range(motion):
                for j in range(r):
                    sources[at, i, j] = x[i, 1 + size + j]


def linearise(
    layout: Layout,
    series: Series,
    path: Floats,
    chosen: Candidates,
    theta: Floats,
    blur: Blur | None = None,
    substeps: int = 1,
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
    blur : Blur, optional
        Widths of the jumps; by default those between samples.
    substeps : int
        Runge-Kutta steps between two samples; more, `JUMP_STEPS`, where a term of the model jumps.
    """
    n, size, chains = len(path), layout.size, layout.chains
    blur = first_blur(layout, series, path, substeps) if blur is None else blur
    jumping = crossings(layout, series, path, layout.jumps_in(chosen)).any(axis=1)
    program, basis = layout.tape(chosen).program(), layout.terms_tape.program()
    inputs = blur.beside(series.inputs)
    first = size + inputs.shape[1]
    program.registers[first : first + len(theta)] = theta
    steps = Steps(
        program,
        basis,
        inputs,
        series.bends,
        layout.driven,
        series.intervals,
        np.where(jumping, max(substeps, JUMP_STEPS), substeps),
        layout.last,
        np.array([rates[-1] for rates in layout.rates]),
        layout.motion,
        layout.rising,
        layout.straight,
    )
    end, transition, sources, target, gradient = arrays(
        (n - 1, size), (n - 1, size, size), (n - 1, layout.motion, len(theta)), (n, chains), (n, chains, size)
    )
    _integrate(steps, chosen, True, path, 0, n, end, transition, sources, target, gradient)
    motion, holds, open_to = layout.motion, [], np.ones((n, chains))
    for hold in blur.holds:
        if layout.jumps_in(chosen)[hold.jump]:
            rows = hold.rows
            _hold_targets(layout, hold, path, target, gradient, open_to)
            left, moved = hold.projectors(transition[rows, :motion][:, :, layout.discrepancy])
            end[rows, :motion] = np.einsum("kij,kj->ki", left, end[rows, :motion]) + moved
            transition[rows, :motion] = left @ transition[rows, :motion]
            sources[rows] = left @ sources[rows]
            holds.append((rows, left))
    _to_mean(layout, series.intervals, end, transition)
    bends = (gradient[:-1, :, layout.driven] * _bends(path[:, layout.driven])[:, None]) ** 2
    seen, kinds = path[:, np.maximum(layout.kinds, 0)], layout.kinds
    for channel in np.flatnonzero(layout.kinds < 0):
        seen[:, channel] = target[:, -1 - layout.kinds[channel]]
    if layout.drift:
        seen += path[:, layout.drifts]
        kinds, gradient = _with_drifts(layout, gradient)
    related = (transition != 0.0).any(axis=0)
    return Linear(
        path=path,
        end=end,
        transition=transition,
        gradient=gradient,
        residual=series.samples - seen,
        kinds=kinds,
        follows=_others(related),
        leads=_others(related.T),
        spread=series.spread,
        unresolved=blur.unresolved,
        force=blur.force,
        bends=bends,
        discrepancy=layout.discrepancy,
        terms=terms_at(layout, path, inputs),
        open_to=open_to,
        chosen=chosen,
        sources=sources,
        steps=steps,
        holds=tuple(holds),
    )


def _with_drifts(layout: Layout, gradient: Floats) -> tuple[Ints, Floats]:
    """Kinds and gradients of channels that drift: states are rows behind those of the targets."""
    kinds, rows = layout.kinds.copy(), [gradient]
    for i, drift in enumerate(layout.drifts):
        if kinds[i] < 0:
            gradient[:, -1 - kinds[i], drift] = 1.0
        else:
            row = np.zeros((len(gradient), 1, layout.size))
            row[:, :, [kinds[i], drift]] = 1.0
            kinds[i] = -layout.chains - len(rows)
            rows.append(row)
    return kinds, np.concatenate(rows, axis=1)


def _bends(path: Floats) -> Floats:
    """How far inputs are from straight lines halfway between samples, about, (n - 1, L): the larger of both ends."""
    bend = np.zeros(path.shape)
    bend[1:-1] = np.abs(np.diff(path, 2, axis=0)) / 8.0
    return np.maximum(bend[1:], bend[:-1])


def _hold_targets(layout: Layout, hold: Hold, path: Floats, target: Floats, gradient: Floats, open_to: Floats) -> None:
    """The targets while a jump holds its argument, with as much of the jump as keeps the argument from changing."""
    rows = hold.rows
    by_force = hold.gradient[:, layout.last] * np.array([rates[-1] for rates in layout.rates])
    change, slopes = np.einsum("kc,kc->k", by_force, target[rows]), np.einsum("kc,kcs->ks", by_force, gradient[rows])
    for last, rates in zip(layout.last, layout.rates, strict=True):
        for i, rate in enumerate(rates[:-1], last + 1 - len(rates)):
            change += rate * hold.gradient[:, i] * path[rows, i + 1]
            slopes[:, i + 1] += rate * hold.gradient[:, i]
    share = hold.half / np.einsum("kc,kc->k", by_force, hold.half)[:, None]
    target[rows] -= share * change[:, None]
    gradient[rows] -= share[:, :, None] * slopes[:, None, :]
    open_to[rows] -= share * by_force


def sources_of(linear: Linear, chosen: Candidates, first: int, stop: int) -> Floats:
    """Derivatives of the ends of steps `first` to `stop` by coefficients, (stop - first, motion, r)."""
    r = len(chosen.chain)
    if chosen is linear.chosen or r == 0:
        return linear.sources[first:stop, :, :r]
    out = np.empty((stop - first, linear.steps.motion, r))
    no_ends, no_slopes = np.empty((0, 0)), np.empty((0, 0, 0))
    steps = linear.steps.fresh()
    _integrate(steps, chosen, False, linear.path, first, stop, no_ends, no_slopes, out, no_ends, no_slopes)
    for rows, left in linear.holds:
        inside = (first <= rows) & (rows < stop)
        out[rows[inside] - first] = left[inside] @ out[rows[inside] - first]
    return out


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


def terms_at(layout: Layout, path: Floats, inputs: Floats) -> Floats:
    """Candidates and the constant at the states of a path, (n, P + 1), what is given (n, m, 4) with widths of jumps."""
    columns = dict(zip(layout.names, np.asfortranarray(path).T, strict=True))
    columns |= dict(zip((*layout.given, *layout.jump_widths), inputs[:, :, 0].T, strict=True))
    out = np.ones((len(path), len(layout.terms) + 1))
    out[:, :-1] = evaluate_terms(layout.blurred, columns)
    return out


@kernel
def _derivatives(steps: Steps, start: Floats, end: Floats, directions: Floats, between: bool, out: Floats) -> None:
    """Adds to `out` (C, P + 1) the derivatives of the candidates along directions (n, C, S), summed over rows.

    They are taken at the starts of steps, or, `between`, as the mean over the middles of the Runge-Kutta steps on the
    straight lines to their ends.
    """
    program, (n, size), chains = steps.basis, start.shape, directions.shape[1]
    tangents = np.zeros((program.registers.shape[0], chains))
    for row in range(n):
        count = steps.substeps[row] if between else 1
        for node in range(count):
            fraction = (node + 0.5) / count if between else 0.0
            for i in range(size):
                moved = end[row, i] - start[row, i] if between and steps.straight[i] < 2 else 0.0
                program.registers[i] = start[row, i] + fraction * moved
                for c in range(chains):
                    tangents[i, c] = directions[row, c, i] / count
            _set_inputs(program, steps.inputs, size, row, fraction)
            run_tape(program, tangents)
            for c in range(chains):
                for j in range(out.shape[1]):
                    out[c, j] += tangents[program.outputs[j], c]


def derivatives_along(linear: Linear, at_samples: Floats, between: Floats) -> Floats:
    """Derivatives of all candidates along directions (n, C, S) at samples, and (n - 1, C, S) between: (C, P + 1)."""
    out = np.zeros((at_samples.shape[1], linear.terms.shape[1]))
    steps = linear.steps.fresh()
    _derivatives(steps, linear.path, linear.end, at_samples, False, out)
    _derivatives(steps, linear.path[:-1], linear.end, between, True, out)
    return out
