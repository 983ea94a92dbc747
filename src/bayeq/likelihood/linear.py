"""The model linearised about a path: transitions of the states, columns of the candidates, residuals of the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats, Ints
from bayeq.dictionary import evaluate_terms
from bayeq.likelihood.blur import Blur, Hold, crossings, first_blur
from bayeq.likelihood.layout import Candidates, Layout, Series
from bayeq.likelihood.low_pass import feedback
from bayeq.likelihood.steps import Steps, add_derivatives, arrays, integrate
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.numerics.spline import spline_slopes

# A state's effect on the next value of another is neglected below this share of the other's standard deviation.
ROUNDED = 1e-16


class Linear(NamedTuple):
    """A record's model, linear in the deviations from a path and from some coefficients."""

    path: Floats  # (n, S), states that it is linearised about
    end: Floats  # (n - 1, S), states after a step from each of them, before memories and random steps act
    transition: Floats  # (n - 1, S, S), derivatives of `end` by the states
    # (n, C or more, S), derivatives of each target by the states; followed by those of measured states with a drift or
    # a lag, which are included
    gradient: Floats
    residual: Floats  # (n, M), samples less the values on the path; NaN where there is none
    kinds: Ints  # (M,), see `Layout.channels`; -1 - i for a channel whose derivatives are ``gradient[:, i]``
    follows: Ints  # (S, S), for each state, the number of others that its next value depends on, then these
    leads: Ints  # (S, S), the number of others whose next value depends on it, then these
    spread: Floats  # (n, M), as in `Series`
    unresolved: Floats  # (n, M), as in `Blur`
    force: Floats  # (n - 1, C), as in `Blur`
    # (n - 1, C, L), squared change of each equation's target by the bend of each input between samples
    bends: Floats
    discrepancy: Ints  # (C,), see `Layout.discrepancy`
    terms: Floats  # (n, P + 1), the candidates and the constant at the path
    # (n, C, C), derivatives of the targets by the right-hand sides, (I - A)^-1, where terms hold targets; otherwise
    # empty
    coupling: Floats
    # (n, C), derivative of a sample of each target by a term: 1, less where the force that holds a jump compensates
    open_to: Floats
    chosen: Candidates  # the coefficients of the model
    sources: Floats  # (n - 1, motion, r), derivatives by them of the chains' states in `end`
    steps: Steps  # the integration, for `sources_of` other coefficients
    # intervals in which the arguments of jumps are held, (k,), and the projections of changes of the states there,
    # (k, motion, motion)
    holds: tuple[tuple[NDArray[np.intp], Floats], ...]
    # (n, S), derivatives of a further part of the log likelihood by the states (`determinant`); or empty
    pull: Floats = np.empty((0, 0))

    def in_order(self, channels: NDArray[np.intp]) -> Linear:
        """The model with its channels in another order, in which their samples are filtered."""
        columns = {name: getattr(self, name)[:, channels] for name in ("residual", "spread", "unresolved")}
        contiguous: dict[str, Any] = {name: np.ascontiguousarray(values) for name, values in columns.items()}
        return self._replace(kinds=self.kinds[channels], **contiguous)


def linearise(
    layout: Layout,
    series: Series,
    path: Floats,
    chosen: Candidates,
    theta: Floats,
    blur: Blur | None = None,
    substeps: int = 1,
) -> Linear:
    """The model of a record about a path, (n, S), and the coefficients `theta`, (r,), of the chosen candidates.

    `blur` has the widths of jumps, by default of `first_blur`; `substeps` Runge-Kutta steps lie between two samples.
    """
    n, size, chains = len(path), layout.size, layout.chains
    blur = first_blur(layout, series, path, substeps) if blur is None else blur
    jumping = crossings(layout, series, path, layout.jumps_in(chosen)).any(axis=1)
    program, basis = layout.tape(chosen).program(), layout.terms_tape.program()
    inputs = blur.beside(series.inputs)
    program.registers[size + inputs.shape[1] :][: len(theta)] = theta
    steps = Steps(
        program,
        basis,
        inputs,
        series.bends,
        layout.driven,
        np.append(series.intervals, 0.0),
        np.append(np.where(jumping, max(substeps, LIKELIHOOD.jump_steps), substeps), 1),
        layout.last,
        layout.factors,
        layout.motion,
        layout.rising,
        layout.straight,
        layout.implicit,
        layout.discrete,
    )
    end, transition, sources, target, gradient = arrays(
        (n - 1, size), (n - 1, size, size), (n - 1, layout.motion, len(theta)), (n, chains), (n, chains, size)
    )
    integrate(steps, chosen, True, path, steps.order(0, n), 0, end, transition, sources, target, gradient)
    open_to = np.ones((n, chains))
    held = [hold for hold in blur.holds if layout.jumps_in(chosen)[hold.jump]]
    for hold in held:
        _hold_targets(layout, hold, path, target, gradient, open_to)
    holds = _hold_steps(layout, held, end, transition, sources)
    _to_mean(layout, series.intervals, end, transition)
    bends = (gradient[:-1, :, layout.driven] * _bends(path[:, layout.driven])[:, None]) ** 2
    if layout.discrete:
        bends[:] = 0.0
    seen, kinds = path[:, np.maximum(layout.kinds, 0)], layout.kinds
    for channel in np.flatnonzero(layout.kinds < 0):
        seen[:, channel] = target[:, -1 - layout.kinds[channel]]
    if layout.drift:
        seen += path[:, layout.drifts]
        kinds, gradient = _own_rows(kinds, gradient, range(len(kinds)))
        gradient[:, -1 - kinds, layout.drifts] = 1.0
    if layout.late:
        kinds, gradient = _with_lags(layout, series.intervals, path, seen, kinds, gradient)
    spread = path.std(axis=0)
    spread[layout.discrepancy] = target.std(axis=0)
    largest = np.maximum(transition.max(axis=0), -transition.min(axis=0))
    related = (largest * spread > ROUNDED * spread[:, None]) | ((largest > 0.0) & (spread == 0.0))
    terms, coupling = terms_along(layout, path, inputs, chosen, theta)
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
        terms=terms,
        coupling=coupling,
        open_to=open_to,
        chosen=chosen,
        sources=sources,
        steps=steps,
        holds=holds,
    )


def _hold_steps(
    layout: Layout, holds: Sequence[Hold], end: Floats, transition: Floats, sources: Floats
) -> tuple[tuple[NDArray[np.intp], Floats], ...]:
    """Projects `end`, `transition` and `sources` in held intervals; returns their rows and projections."""
    motion, out = layout.motion, []
    for hold in holds:
        rows = hold.rows
        left, moved = hold.projectors(transition[rows, :motion][:, :, layout.discrepancy])
        end[rows, :motion] = np.einsum("kij,kj->ki", left, end[rows, :motion]) + moved
        transition[rows, :motion] = left @ transition[rows, :motion]
        sources[rows] = left @ sources[rows]
        out.append((rows, left))
    return tuple(out)


def _own_rows(kinds: Ints, gradient: Floats, channels: Sequence[int]) -> tuple[Ints, Floats]:
    """Kinds and gradients, with a gradient row appended for each of these channels that measures a state."""
    kinds, rows = kinds.copy(), [gradient]
    for i in channels:
        if kinds[i] >= 0:
            row = np.zeros((len(gradient), 1, gradient.shape[2]))
            row[:, :, kinds[i]] = 1.0
            kinds[i] = -gradient.shape[1] - len(rows)
            rows.append(row)
    return kinds, np.concatenate(rows, axis=1)


def _with_lags(
    layout: Layout, intervals: Floats, path: Floats, seen: Floats, kinds: Ints, gradient: Floats
) -> tuple[Ints, Floats]:
    """Kinds and gradients with channels that may be late: x(t - lag) is about x less the lag times the rate of x."""
    time = np.append(0.0, np.cumsum(intervals))
    kinds, gradient = _own_rows(kinds, gradient, [i for i, _ in layout.late])
    for (i, _), lag in zip(layout.late, layout.lags, strict=True):
        rate = spline_slopes(time, seen[:, [i]])[:, 0]
        gradient[:, -1 - kinds[i], lag] = -rate
        seen[:, i] -= path[:, lag] * rate
    return kinds, gradient


def _bends(path: Floats) -> Floats:
    """About how far inputs bend from straight lines between samples, (n - 1, L): the larger estimate of both ends."""
    bend = np.zeros(path.shape)
    bend[1:-1] = np.abs(np.diff(path, 2, axis=0)) / 8.0
    return np.maximum(bend[1:], bend[:-1])


def _hold_targets(layout: Layout, hold: Hold, path: Floats, target: Floats, gradient: Floats, open_to: Floats) -> None:
    """Corrects targets and gradients in held intervals by the part of the jump that keeps its argument constant."""
    rows = hold.rows
    by_force = hold.gradient[:, layout.last] * layout.factors
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
    out, steps = np.empty((stop - first, linear.steps.motion, r)), linear.steps
    order, no_ends, no_slopes = steps.order(first, stop), np.empty((0, 0)), np.empty((0, 0, 0))
    integrate(steps, chosen, False, linear.path, order, first, no_ends, no_slopes, out, no_ends, no_slopes)
    for rows, left in linear.holds:
        inside = (first <= rows) & (rows < stop)
        out[rows[inside] - first] = left[inside] @ out[rows[inside] - first]
    return out


def _others(related: Bools) -> Ints:
    """In each row the number of true entries off the diagonal, then their columns."""
    out = np.zeros(related.shape, dtype=np.int64)
    for i, row in enumerate(related):
        others = np.flatnonzero(row)
        others = others[others != i]
        out[i, 0], out[i, 1 : 1 + len(others)] = len(others), others
    return out


def _to_mean(layout: Layout, intervals: Floats, end: Floats, transition: Floats) -> None:
    """Puts the mean of the highest derivative of each input after the next sample into `end` and `transition`."""
    for k, (first, slope, centre) in enumerate(zip(layout.driven, layout.slope, layout.centres, strict=True)):
        states = slice(first, slope + 1)
        factors = np.column_stack([-1.0 / intervals, np.zeros(len(intervals))])  # a random sequence: back to its mean
        if layout.smoothness[k]:
            factors = feedback(int(layout.widths[k]), layout.corners[k], intervals)
        deviation = end[:, states].copy()
        deviation[:, 0] -= centre
        end[:, slope] = np.einsum("nj,nj->n", factors, deviation)
        transition[:, slope] = np.einsum("nj,njs->ns", factors, transition[:, states])


def terms_along(
    layout: Layout, path: Floats, inputs: Floats, chosen: Candidates, theta: Floats
) -> tuple[Floats, Floats]:
    """Candidates and the constant along a path, (n, P + 1), and (I - A)^-1 of implicit equations, (n, C, C); `inputs`,
    (n, m + J, 4), are the given variables and the widths of jumps."""
    columns = dict(zip(layout.names, np.asfortranarray(path).T, strict=True))
    columns |= dict(zip((*layout.given, *layout.jump_widths), inputs[:, :, 0].T, strict=True))
    coupling = np.zeros((0, layout.chains, layout.chains))
    if layout.implicit:
        free, coupling = layout.targets_along(columns, chosen, theta, layout.blurred)
        columns |= dict(zip(layout.roles.targets, free.T, strict=True))
    out = np.ones((len(path), len(layout.terms) + 1))
    out[:, :-1] = evaluate_terms(layout.blurred, columns)
    return out, coupling


def derivatives_along(linear: Linear, at_samples: Floats, between: Floats) -> Floats:
    """Sums of all candidates' derivatives along directions (n, C, S) at samples, (n - 1, C, S) between: (C, P + 1)."""
    out = np.zeros((at_samples.shape[1], linear.terms.shape[1]))
    steps = linear.steps
    if len(linear.coupling):
        # a term acts on every target; its effect on the mass matrix is neglected
        at_samples = np.einsum("nec,nes->ncs", linear.coupling, at_samples)
        between = np.einsum("nec,nes->ncs", linear.coupling[:-1], between)
    add_derivatives(steps, linear.path, linear.end, at_samples, False, out)
    add_derivatives(steps, linear.path[:-1], linear.end, between, not steps.discrete, out)
    return out
