"""Runge-Kutta steps of the model between samples, with their derivatives; and terms that are flows between states."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.expressions.evaluate import Program, RowTangents, dependence, run_on_rows, run_tape
from bayeq.inference.collapsed.listing import summed
from bayeq.inference.posterior import Averaged, ModelAverage, Posterior
from bayeq.kernels import kernel
from bayeq.likelihood.layout import HELD, SMOOTH, STRAIGHT, Candidates, Stated
from bayeq.numerics.rk4 import STAGES

# From LARGE floats (4 MB) on numpy asks for large pages of memory; blocks above SMALL are enlarged to get them.
LARGE = 2**19
SMALL = LARGE // 4


class Steps(NamedTuple):
    """Programs, inputs and settings of the integration from each sample to the next."""

    program: Program  # rates of the states, the targets and the terms of the model, in states, inputs and coefficients
    basis: Program  # the candidates and the constant, in states and inputs
    inputs: Floats  # (n, m, 4), those of the `Series`, then the widths of jumps
    bends: Floats  # (n, L, 2), as in `Series`
    driven: Ints  # (L,), see `Layout.driven`
    intervals: Floats  # (n,), to the next sample [s]; 0 after the last one
    substeps: Ints  # (n,), Runge-Kutta steps of each interval
    last: Ints  # (C,), see `Layout.last`
    factors: Floats  # (C,), rate of that state for a target of 1; 0 of static laws, whose targets are not integrated
    motion: int  # number of states that are derivatives of chains: the first ones, which alone depend on coefficients
    rising: Bools  # (S,), whether the rate of a state after these is the next state, and not 0
    straight: Ints  # (S,), how a state after these goes from one sample to the next: `SMOOTH`, `STRAIGHT` or `HELD`
    # whether terms hold targets: the program's last outputs are then targets without discrepancies, and (I - A)^-1
    implicit: bool
    discrete: bool  # whether the program gives next values in place of rates: nothing is integrated

    def order(self, first: int, stop: int) -> Ints:
        """Samples `first` to `stop`, those of as many steps together."""
        return first + np.argsort(self.substeps[first:stop], kind="stable")


# Rows that are integrated at a time, so that their arithmetic is vectorised, and the floats (2 MB) that their tangents
# may take.
ROWS = 64
CACHED = 2**18


class Work(NamedTuple):
    """Registers of up to R rows, and their derivatives by the S states at the sample."""

    registers: Floats  # (n_registers, R) of the model's program
    tangents: RowTangents  # by the S states
    reach: Bools  # (motion, 1 + S + r), where derivatives of the states of chains may differ from 0
    terms: Floats  # (n_registers, R) of the candidates' program
    powers: Floats  # (S, S, R), derivatives of the states outside chains
    power: Floats  # (R,)
    rows: Ints  # (R,), the samples
    widths: Floats  # (R,), intervals after them [s]


@kernel(borrowing=True)
def _between(inputs: Floats, row: int, i: int, fraction: float) -> float:
    """A given variable or width of jumps at a fraction of the interval after a sample."""
    rest = 1.0 - fraction
    bend = inputs[row, i, 2] + fraction * inputs[row, i, 3]
    return rest * inputs[row, i, 0] + fraction * inputs[row, i, 1] + fraction * rest * bend


@kernel(borrowing=True)
def _set_inputs(registers: Floats, inputs: Floats, size: int, row: int, fraction: float) -> None:
    """Puts given variables and widths of jumps, at a fraction of the interval after a sample, into the registers."""
    for k in range(inputs.shape[1]):
        registers[size + k] = _between(inputs, row, k, fraction)


@kernel(borrowing=True)
def _set_rows(registers: Floats, inputs: Floats, size: int, rows: Ints, fraction: float) -> None:
    """As `_set_inputs`, for some rows."""
    for i in range(inputs.shape[1]):
        for k in range(len(rows)):
            registers[size + i, k] = _between(inputs, rows[k], i, fraction)


@kernel(borrowing=True)
def _drift(steps: Steps, path: Floats, fraction: float, last: bool, work: Work) -> None:
    """Puts the states outside chains, at a fraction of the intervals after samples, into the registers.

    They follow Taylor series; an input that is not `SMOOTH` goes straight to the end of its series, or is held until
    there; `last` asks for the end itself. `work.powers` receives derivatives by the states at the sample.
    """
    size, rows = path.shape[1], work.rows
    for i in range(steps.motion, size):
        course = SMOOTH if last else steps.straight[i]
        duration, share = fraction, 1.0
        if course != SMOOTH:
            duration, share = 1.0, fraction if course == STRAIGHT else 0.0
        for k in range(len(rows)):
            work.registers[i, k] = path[rows[k], i]
            work.powers[i, i, k] = work.power[k] = 1.0
        j = i
        while steps.rising[j]:
            j += 1
            for k in range(len(rows)):
                work.power[k] *= duration * work.widths[k] / (j - i)
                work.powers[i, j, k] = share * work.power[k]
                work.registers[i, k] += share * work.power[k] * path[rows[k], j]
    for i in range(len(steps.driven)):
        for k in range(len(rows)):
            bend = steps.bends[rows[k], i, 0] + fraction * steps.bends[rows[k], i, 1]
            work.registers[steps.driven[i], k] += fraction * (1.0 - fraction) * bend


@kernel
def _rates(steps: Steps, chosen: Candidates, own: bool, fraction: float, work: Work, y: Floats, rate: Floats) -> None:
    """Rates of the states of chains (first column), of their derivatives by all states, and by the coefficients."""
    motion, width, size, registers = steps.motion, y.shape[1], work.powers.shape[0], work.registers
    rows = len(work.rows)
    for i in range(motion):
        registers[i, :rows] = y[i, 0, :rows]
    _set_rows(registers, steps.inputs, size, work.rows, fraction)
    run_on_rows(steps.program.code, registers, rows, work.tangents)
    for i in range(motion):
        output = steps.program.outputs[i]
        rate[i, 0, :rows] = registers[output, :rows]
        rate[i, 1:, :rows] = 0.0
        for o in range(size):
            if not work.tangents.depends[output, o]:
                continue
            factor = work.tangents.values[output, o]
            if o < motion:
                for j in range(1, width):
                    if work.reach[o, j]:
                        work.reach[i, j] = True
                        _add_products(rows, factor, y[o, j], rate[i, j])
                continue
            j = o
            while True:
                work.reach[i, 1 + j] = True
                _add_products(rows, factor, work.powers[o, j], rate[i, 1 + j])
                if not steps.rising[j]:
                    break
                j += 1
    r, chains = width - 1 - size, len(steps.factors)
    terms, free = size + chains, len(steps.program.outputs) - chains * (chains + 1)
    if r and not own:
        work.terms[:size, :rows] = registers[:size, :rows]
        _set_rows(work.terms, steps.inputs, size, work.rows, fraction)
        if steps.implicit:
            for c in range(chains):
                given = registers[steps.program.outputs[free + c], :rows]
                work.terms[size + steps.inputs.shape[1] + c, :rows] = given
        run_on_rows(steps.basis.code, work.terms, rows, None)
    for j in range(r if motion else 0):
        c, out = chosen.chain[j], 1 + size + j
        term = registers[steps.program.outputs[terms + j]] if own else work.terms[steps.basis.outputs[chosen.term[j]]]
        if steps.implicit:
            for e in range(chains):
                shared = registers[steps.program.outputs[free + chains * (1 + e) + c]]
                work.reach[steps.last[e], out] = True
                for k in range(rows):
                    rate[steps.last[e], out, k] += steps.factors[e] * shared[k] * term[k]
        else:
            work.reach[steps.last[c], out] = True
            for k in range(rows):
                rate[steps.last[c], out, k] += steps.factors[c] * term[k]


@kernel(borrowing=True)
def _add_products(rows: int, factor: Floats, values: Floats, out: Floats) -> None:
    """Adds products to `out`; a factor of 0 adds nothing, whatever the value."""
    for k in range(rows):
        out[k] += factor[k] * values[k] if factor[k] != 0.0 else 0.0


@kernel(borrowing=True)
def _ahead(x: Floats, share: float, work: Work, rate: Floats, y: Floats) -> None:
    """Puts x + h rate into `y`, for a step h of a share of each width."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            if work.reach[i, j]:
                for k in range(len(work.rows)):
                    y[i, j, k] = x[i, j, k] + share * work.widths[k] * rate[i, j, k]


@kernel
def _integrate_rows(
    steps: Steps,
    chosen: Candidates,
    own: bool,
    path: Floats,
    count: int,
    work: Work,
    stages: Floats,
    target: Floats,
    gradient: Floats,
) -> None:
    """Integrates from the samples of `work` in `count` steps; the first of the stages (6, motion, 1 + S + r, R) is then
    the end, with its derivatives by the states and the coefficients."""
    size, motion, share = path.shape[1], steps.motion, 1.0 / count
    x, y, k1, k2, k3, k4 = stages[0], stages[1], stages[2], stages[3], stages[4], stages[5]
    x[:] = y[:] = 0.0
    work.reach[:, 1:] = False
    for i in range(motion):
        work.reach[i, 0] = work.reach[i, 1 + i] = True
        for k in range(len(work.rows)):
            x[i, 0, k], x[i, 1 + i, k] = path[work.rows[k], i], 1.0
    for step in range(count):
        _drift(steps, path, step * share, False, work)
        _rates(steps, chosen, own, step * share, work, x, k1)
        if step == 0:
            for c in range(target.shape[1]):
                output = steps.program.outputs[size + c]
                for k in range(len(work.rows)):
                    target[work.rows[k], c] = work.registers[output, k]
                    for j in range(size):
                        gradient[work.rows[k], c, j] = work.tangents.values[output, j, k]
        if steps.discrete:
            x[:] = k1
            continue
        _ahead(x, 0.5 * share, work, k1, y)
        _drift(steps, path, (step + 0.5) * share, False, work)
        _rates(steps, chosen, own, (step + 0.5) * share, work, y, k2)
        _ahead(x, 0.5 * share, work, k2, y)
        _rates(steps, chosen, own, (step + 0.5) * share, work, y, k3)
        _ahead(x, share, work, k3, y)
        _drift(steps, path, (step + 1.0) * share, False, work)
        _rates(steps, chosen, own, (step + 1.0) * share, work, y, k4)
        for i in range(motion):
            for j in range(x.shape[1]):
                for k in range(len(work.rows) if work.reach[i, j] else 0):
                    slope = k1[i, j, k] + 2.0 * (k2[i, j, k] + k3[i, j, k]) + k4[i, j, k]
                    x[i, j, k] += share * work.widths[k] / 6.0 * slope


@kernel
def integrate(
    steps: Steps,
    chosen: Candidates,
    own: bool,
    path: Floats,
    order: Ints,
    first: int,
    end: Floats,
    transition: Floats,
    sources: Floats,
    target: Floats,
    gradient: Floats,
) -> None:
    """Runge-Kutta steps, or those of a map, from some samples of a path, with their derivatives.

    The arrays receive the fields of `Linear`, and the targets (n, C); `end`, `transition` and `sources` from sample
    `first` on. Empty arrays receive nothing. Samples of as many steps stand together in `order`. `own` says that the
    chosen coefficients are those of the model.
    """
    (n, size), r, motion = path.shape, len(chosen.chain), steps.motion
    given, of_terms = steps.program.registers, steps.basis.registers
    most = max(1, min(ROWS, len(order), CACHED // (len(given) * size)))
    registers, terms = np.empty((len(given), most)), np.empty((len(of_terms), most))
    for i in range(len(given)):
        registers[i] = given[i]
    for i in range(len(of_terms)):
        terms[i] = of_terms[i]
    tangents = RowTangents(np.zeros((len(given), size, most)), np.zeros((len(given), size), dtype=np.bool_))
    for i in range(size):
        tangents.values[i, i], tangents.depends[i, i] = 1.0, True
    dependence(steps.program.code, tangents.depends)
    reach, stages = np.zeros((motion, 1 + size + r), dtype=np.bool_), np.zeros((STAGES, motion, 1 + size + r, most))
    powers, power, widths, stop = np.zeros((size, size, most)), np.empty(most), np.empty(most), 0
    while stop < len(order):
        start, count = stop, steps.substeps[order[stop]]
        while stop < min(start + most, len(order)) and steps.substeps[order[stop]] == count:
            widths[stop - start] = steps.intervals[order[stop]]
            stop += 1
        rows = order[start:stop]
        work = Work(registers, tangents, reach, terms, powers, power, rows, widths[: len(rows)])
        _integrate_rows(steps, chosen, own, path, count, work, stages, target, gradient)
        if end.shape[1]:
            _drift(steps, path, 1.0, True, work)
        for k in range(len(rows)):
            row = rows[k] - first
            if rows[k] == n - 1:
                continue
            for i in range(end.shape[1]):
                end[row, i] = stages[0, i, 0, k] if i < motion else registers[i, k]
                for j in range(size):
                    transition[row, i, j] = stages[0, i, 1 + j, k] if i < motion else powers[i, j, k]
            for i in range(motion):
                for j in range(r):
                    sources[row, i, j] = stages[0, i, 1 + size + j, k]


@kernel
def add_derivatives(steps: Steps, start: Floats, end: Floats, directions: Floats, between: bool, out: Floats) -> None:
    """Adds to `out` (C, P + 1) the derivatives of the candidates along directions (n, C, S), summed over rows.

    They are taken at the starts of steps, or, if `between`, in the middles of Runge-Kutta steps on straight lines.
    """
    (n, size), chains = start.shape, directions.shape[1]
    program = Program(steps.basis.code, steps.basis.outputs, steps.basis.registers.copy())
    tangents = np.zeros((program.registers.shape[0], chains))
    model = Program(steps.program.code, steps.program.outputs, steps.program.registers.copy())
    of_model = np.zeros((model.registers.shape[0] if steps.implicit else 0, chains))
    free = len(model.outputs) - chains * (chains + 1)
    for row in range(n):
        count = steps.substeps[row] if between else 1
        for node in range(count):
            fraction = (node + 0.5) / count if between else 0.0
            for i in range(size):
                moved = end[row, i] - start[row, i] if between and steps.straight[i] != HELD else 0.0
                program.registers[i] = start[row, i] + fraction * moved
                for c in range(chains):
                    tangents[i, c] = directions[row, c, i] / count
            _set_inputs(program.registers, steps.inputs, size, row, fraction)
            if steps.implicit:
                for i in range(size):
                    model.registers[i] = program.registers[i]
                    for c in range(chains):
                        of_model[i, c] = tangents[i, c]
                _set_inputs(model.registers, steps.inputs, size, row, fraction)
                run_tape(model, of_model)
                for e in range(chains):
                    register = size + steps.inputs.shape[1] + e
                    program.registers[register] = model.registers[model.outputs[free + e]]
                    for c in range(chains):
                        tangents[register, c] = of_model[model.outputs[free + e], c]
            run_tape(program, tangents)
            for c in range(chains):
                for j in range(out.shape[1]):
                    out[c, j] += tangents[program.outputs[j], c]


def arrays(*shapes: tuple[int, ...]) -> list[Floats]:
    """Arrays in one block of memory, not initialised: the first touch of small pages takes as long as a filter."""
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    total = int(ends[-1])
    block = np.empty(max(total, LARGE) if total > SMALL else total)
    parts = np.split(block[:total], ends[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


# In fits the standard deviation of a tied sum of coefficients is this share of the prior's of its first one. Models are
# selected, and coefficients reported, in terms of flows, which balance exactly.
TIED = 1e-4


@dataclass(frozen=True, eq=False)
class Flows:
    """Flows between every pair of states of a conserved sum, one per candidate, and coefficients of other equations."""

    weights: Mapping[int, float]  # factor of each state in the sum, by the number of its equation
    chains: int  # C, the number of equations
    width: int  # P + 1, the number of candidates of each, the constant among them

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Equations that flows lead from and to."""
        return list(itertools.combinations(sorted(self.weights), 2))

    @cached_property
    def matrix(self) -> Floats:
        """Matrix from the M flows to the coefficients, (C (P + 1), M)."""
        columns = np.zeros((self.chains, len(self.pairs)))
        for k, (a, b) in enumerate(self.pairs):
            columns[a, k], columns[b, k] = -1.0 / self.weights[a], 1.0 / self.weights[b]
        others = np.delete(np.eye(self.chains), sorted(self.weights), axis=1)
        return np.asarray(np.kron(np.hstack([columns, others]), np.eye(self.width)), dtype=np.float64)

    def ties(self, precision: Floats) -> tuple[Stated, ...]:
        """Constraints that set each term's weighted sum of coefficients over equations, and the constants', to zero."""
        own, first = precision.reshape(self.chains, self.width), min(self.weights)
        sd = TIED * abs(self.weights[first]) / np.sqrt(own[first])
        return tuple(
            Stated(tuple((c, j, w) for c, w in self.weights.items()), 0.0, float(sd[j])) for j in range(self.width)
        )

    def wide(self, model: Bools) -> Bools:
        """The model of coefficients, (C (P + 1),), that a model of flows, (M,), changes."""
        out: Bools = self.matrix.astype(np.bool_) @ model
        return out

    def narrow(self, model: Bools) -> Bools:
        """Flows, (M,), that give the coefficients of a model; a term in only one equation of the sum gives none."""
        inside = model.reshape(self.chains, self.width)
        out = np.zeros((len(self.pairs), self.width), dtype=np.bool_)
        for j in range(self.width):
            for pair in itertools.pairwise(c for c in sorted(self.weights) if inside[c, j]):
                out[self.pairs.index(pair), j] = True
        return np.append(out.ravel(), np.delete(inside, sorted(self.weights), axis=0).ravel())

    def precision(self, precision: Floats) -> Floats:
        """1/variance of the prior of each flow, (M,), from that of the coefficients."""
        return np.asarray((self.matrix**2).T @ precision)

    def log_odds(self, log_odds: Floats) -> Floats:
        """Prior log odds of each flow, (M,): the smallest among its coefficients."""
        return np.where(self.matrix.T != 0.0, log_odds, np.inf).min(axis=1)

    def log_share(self, stated: tuple[Stated, ...], precision: Floats, model: Bools) -> float:
        """ln of the share of the prior probability of a model's coefficients for which the ties hold."""
        out = 0.0
        for parts, _, sd in stated:
            inside = [(c * self.width + j, w) for c, j, w in parts if model[c * self.width + j]]
            if inside:
                out -= 0.5 * math.log1p(sum(w**2 / precision[k] for k, w in inside) / sd**2)
        return out

    def paired(self, found: Posterior, precision: Floats) -> Posterior:
        """A posterior of flows as one of coefficients, both in units of their priors."""
        average = found.average
        assert average is not None
        assert found.averaged is not None
        units = self.matrix * np.sqrt(precision)[:, None] / np.sqrt(self.precision(precision))
        models, probability = summed(average.models @ self.matrix.T.astype(np.bool_), average.probability)
        pip = np.minimum(probability @ models, 1.0)
        support = pip > 0.5
        if not (self.wide(self.narrow(support)) == support).all():
            support = models[0]
        terms = np.flatnonzero(models.any(axis=0))
        spread = units[:, average.terms] @ average.covariance @ units[:, average.terms].T
        coef = units @ found.averaged.coef
        names = tuple(map(str, range(len(pip))))
        return replace(
            found,
            names=names,
            details=replace(found.details, unsettled=() if found.details.converged else names),
            pip=pip,
            support=support,
            coef=np.where(support, coef, 0.0),
            covariance=spread[np.ix_(support, support)],
            constant=replace(found.constant, center=np.zeros(len(pip))),
            averaged=Averaged(coef, np.sqrt(np.maximum(np.diagonal(spread), 0.0))),
            average=ModelAverage(models, probability, average.left_out, terms, spread[np.ix_(terms, terms)]),
        )
