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
from bayeq.expressions.evaluate import Program, run_tape
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
    intervals: Floats  # (n - 1,), between samples [s]
    substeps: Ints  # (n - 1,), Runge-Kutta steps of each interval
    last: Ints  # (C,), see `Layout.last`
    factors: Floats  # (C,), rate of that state for a target of 1; 0 of static laws, whose targets are not integrated
    motion: int  # number of states that are derivatives of chains: the first ones, which alone depend on coefficients
    rising: Bools  # (S,), whether the rate of a state after these is the next state, and not 0
    straight: Ints  # (S,), how a state after these goes from one sample to the next: `SMOOTH`, `STRAIGHT` or `HELD`
    # whether terms hold targets: the program's last outputs are then targets without discrepancies, and (I - A)^-1
    implicit: bool
    discrete: bool  # whether the program gives next values in place of rates: nothing is integrated

    def fresh(self) -> Steps:
        """A copy of the steps with its own registers."""
        program, basis = (one._replace(registers=one.registers.copy()) for one in (self.program, self.basis))
        return self._replace(program=program, basis=basis)


class Tangents(NamedTuple):
    """Derivatives by the states: `tangents` of a program's registers, `powers` of the states outside chains."""

    tangents: Floats
    powers: Floats


@kernel(borrowing=True)
def _set_inputs(program: Program, inputs: Floats, size: int, row: int, fraction: float) -> None:
    """Puts given variables and widths of jumps, at a fraction of the interval after a sample, into the registers."""
    rest = 1.0 - fraction
    for k in range(inputs.shape[1]):
        p = inputs[row, k]
        program.registers[size + k] = rest * p[0] + fraction * p[1] + fraction * rest * (p[2] + fraction * p[3])


@kernel(borrowing=True)
def _drift(steps: Steps, path: Floats, row: int, interval: float, fraction: float, last: bool, powers: Floats) -> None:
    """Puts the states outside chains, at a fraction of an interval after a sample, into the registers.

    They follow Taylor series; an input that is not `SMOOTH` goes straight to the end of its series, or is held until
    there; `last` asks for the end itself. `powers` (S, S) receives derivatives by the states at the sample.
    """
    size = path.shape[1]
    for i in range(steps.motion, size):
        value, power, j = path[row, i], 1.0, i
        course = SMOOTH if last else steps.straight[i]
        time, share = fraction * interval, 1.0
        if course != SMOOTH:
            time, share = interval, fraction if course == STRAIGHT else 0.0
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
    r, chains = width - 1 - size, len(steps.factors)
    first, free = size + chains, len(program.outputs) - chains * (chains + 1)
    if r and not own:
        for i in range(size):
            basis.registers[i] = registers[i]
        _set_inputs(basis, steps.inputs, size, row, fraction)
        if steps.implicit:
            for c in range(chains):
                basis.registers[size + steps.inputs.shape[1] + c] = registers[program.outputs[free + c]]
        run_tape(basis, None)
    for j in range(r if motion else 0):
        c = chosen.chain[j]
        term = registers[program.outputs[first + j]] if own else basis.registers[basis.outputs[chosen.term[j]]]
        if steps.implicit:
            for e in range(chains):
                shared = registers[program.outputs[free + chains * (1 + e) + c]]
                rate[steps.last[e], 1 + size + j] += steps.factors[e] * shared * term
        else:
            rate[steps.last[c], 1 + size + j] += steps.factors[c] * term


@kernel(borrowing=True)
def _ahead(x: Floats, h: float, rate: Floats, y: Floats) -> None:
    """Puts x + h rate into `y`."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            y[i, j] = x[i, j] + h * rate[i, j]


@kernel
def integrate(
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
    """Runge-Kutta steps, or those of a map, from samples `first` to `stop` of a path, with their derivatives.

    The arrays receive the fields of `Linear`, and the targets (n, C); `end`, `transition` and `sources` from their
    first row on. Empty arrays receive nothing. `own` says that the chosen coefficients are those of the model.
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
            if steps.discrete:
                for i in range(motion):
                    for j in range(1 + size + r):
                        x[i, j] = k1[i, j]
                continue
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


@kernel
def add_derivatives(steps: Steps, start: Floats, end: Floats, directions: Floats, between: bool, out: Floats) -> None:
    """Adds to `out` (C, P + 1) the derivatives of the candidates along directions (n, C, S), summed over rows.

    They are taken at the starts of steps, or, if `between`, in the middles of Runge-Kutta steps on straight lines.
    """
    program, (n, size), chains = steps.basis, start.shape, directions.shape[1]
    tangents = np.zeros((program.registers.shape[0], chains))
    model = steps.program
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
            _set_inputs(program, steps.inputs, size, row, fraction)
            if steps.implicit:
                for i in range(size):
                    model.registers[i] = program.registers[i]
                    for c in range(chains):
                        of_model[i, c] = tangents[i, c]
                _set_inputs(model, steps.inputs, size, row, fraction)
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
        models, which = np.unique(average.models @ self.matrix.T.astype(np.bool_), axis=0, return_inverse=True)
        probability: Floats = np.bincount(which.ravel(), weights=average.probability).astype(np.float64)
        order = np.argsort(-probability, kind="stable")
        models, probability = models[order], probability[order]
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
