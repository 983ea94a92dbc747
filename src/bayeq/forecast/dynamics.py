"""``Dynamics``: equations of motion as one first-order system on a tape, coefficients as parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.expressions import Binary, Expression, Node, Number, Symbol, Tape, number
from bayeq.expressions.evaluate import Program
from bayeq.expressions.implicit import solved
from bayeq.expressions.nodes import jumps_of
from bayeq.inference.posterior import Constant, Posterior
from bayeq.numerics.rk4 import Drive, local_errors
from bayeq.states import Chain, Motion, Roles, rates

# The step is halved until the local error is below TOLERANCE of the states' spread in this SHARE of the intervals, but
# not below 1/MOST_SUBSTEPS of the sampling interval. Laws that jump use that shortest step where two steps an interval
# are not as accurate: at a jump the Runge-Kutta method loses its order, and the error depends on the step.
SHARE = 0.75
TOLERANCE = 1e-6
MOST_SUBSTEPS = 16


class Law(NamedTuple):
    """An equation for the highest derivative of a chain."""

    chain: Chain
    terms: Sequence[Expression]  # all candidates
    posterior: Posterior  # says which of them are included
    unit_gains: Sequence[float] = ()  # of the chain's channels, see `bayeq.states.sensors`; empty where all are 1
    # (P, 2), 95 % intervals over models where these are unlike those of the posterior, NaN elsewhere
    over_models: Floats | None = None


def solved_laws(laws: Sequence[Law]) -> list[Law]:
    """The same laws, or, if terms hold highest derivatives, each with a single term, solved for its own one."""
    heads = [law.chain.target for law in laws]
    if not any(term.names.intersection(heads) for law in laws for term in compress(law.terms, law.posterior.support)):
        return list(laws)
    summed = []
    for law in laws:
        p, one = law.posterior, Expression(number(1))
        members = zip(p.coef[p.support].tolist(), compress(law.terms, p.support), strict=True)
        summed.append([(number(value), term) for value, term in [(p.intercept, one), *members]])
    sides, _ = solved(summed, heads)
    alone = np.ones(1, dtype=np.bool_)
    return [
        law._replace(
            terms=(Expression(side),),
            posterior=replace(law.posterior, support=alone, coef=np.ones(1), constant=Constant(np.zeros(1))),
        )
        for law, side in zip(laws, sides, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Dynamics:
    """dx/dt = f(x, u; theta), for maps the next x; a highest derivative is intercept + sum of coefficient x term."""

    laws: tuple[Law, ...]  # the equations
    roles: Roles  # their chains, inputs, and whether terms may use t, the time [s]: the last of what drives a run
    terms: tuple[tuple[Expression, ...], ...]  # the terms that each equation includes
    intercepts: tuple[bool, ...]  # equations that have an intercept
    # Function of states, inputs, t (if used) and parameters; its outputs are the states' derivatives, then the targets.
    # The parameters are, equation by equation, the intercept (if there is one) and the coefficients of the terms.
    tape: Tape

    @classmethod
    def of(
        cls, laws: Sequence[Law], roles: Roles, intercepts: Sequence[bool] | None = None, forced: bool = False
    ) -> Dynamics:
        """Dynamics of the included terms of equations, one per chain, and by default of their intercepts.

        If `forced`, each equation with `error_lines` has a force too; these are the last drivers of a run.
        """
        kept = [tuple(compress(law.terms, law.posterior.support)) for law in laws]
        constant = (True,) * len(kept) if intercepts is None else tuple(intercepts)
        slopes: list[Expression] = []
        parameters: list[str] = []
        forces: list[str] = []
        one = Expression(Number(1))
        summed: list[list[tuple[Node, Expression]]] = []
        for k, (law, members) in enumerate(zip(laws, kept, strict=True)):
            # names that no channel can have
            names = [f"theta[{k},{j}]" for j in range(len(members) + 1)]
            own = list(zip(names, [one, *members], strict=True))[not constant[k] :]
            parameters += names[not constant[k] :]
            if forced and law.posterior.error_lines:
                forces.append(f"force[{k}]")
                own.append((forces[-1], one))
            summed.append([(Symbol(name), term) for name, term in own])
        sides, _ = solved(summed, roles.targets)
        for law, side in zip(laws, sides, strict=True):
            above = [*map(Symbol, law.chain.states[1:]), side]
            factors = rates(law.chain, law.unit_gains)
            for factor, node in zip(factors, above, strict=False):  # a static law gives no derivative
                slopes.append(Expression(node if factor == 1.0 else Binary("*", number(factor), node)))
        variables = [*roles.states, *roles.drivers, *forces, *parameters]
        tape = Tape.compile([*slopes, *map(Expression, sides)], variables)
        return cls(tuple(laws), roles, tuple(kept), constant, tape)

    @classmethod
    def on(cls, motion: Motion, terms: Sequence[Expression], posteriors: Sequence[Posterior]) -> Dynamics:
        """Dynamics from the posterior of each equation of a motion, all with the same candidate terms."""
        parts = zip(motion.roles.chains, posteriors, motion.unit_gains, strict=True)
        laws = [Law(chain, terms, posterior, gains.tolist()) for chain, posterior, gains in parts]
        return cls.of(laws, motion.roles)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in the tape's order."""
        return self.roles.states

    @cached_property
    def jumps(self) -> bool:
        """Whether a term jumps."""
        return any(True for own in self.terms for term in own for _ in jumps_of(term.tree))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(map(len, self.terms)) + sum(self.intercepts)

    def blocks(self) -> Iterator[slice]:
        """Slices of the parameters of each equation."""
        start = 0
        for members, constant in zip(self.terms, self.intercepts, strict=True):
            end = start + constant + len(members)
            yield slice(start, end)
            start = end

    @cached_property
    def mean(self) -> Floats:
        """Posterior means of the parameters, (p,)."""
        parts = zip(self.laws, self.intercepts, strict=True)
        return np.concatenate([moments(law.posterior)[0][not constant :] for law, constant in parts])

    @cached_property
    def covariance(self) -> Floats:
        """Posterior covariance of the parameters given the terms, (p, p); equations are independent."""
        out = np.zeros((self.size, self.size))
        for block, law, constant in zip(self.blocks(), self.laws, self.intercepts, strict=True):
            out[block, block] = moments(law.posterior)[1][not constant :, not constant :]
        return out

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Parameters from their normal posterior given the terms, (count, p)."""
        return normal_draws(self.mean, self.covariance, count, rng)

    def program(self, parameters: Floats | None = None) -> Program:
        """The tape with fresh registers, with these parameters."""
        program = self.tape.program()
        if parameters is not None:
            first = len(self.tape.variables) - self.size
            program.registers[first : first + self.size] = parameters
        return program


def moments(p: Posterior) -> tuple[Floats, Floats]:
    """Mean (1 + r,) and covariance of the intercept and the coefficients of the included terms."""
    # intercept = mean(y) - center'theta, where mean(y) has variance sigma^2/n
    carried = p.covariance @ p.constant.center[p.support]
    covariance = np.block([[np.array([[p.intercept_sd**2]]), -carried], [-carried[:, None], p.covariance]])
    return np.append(p.intercept, p.coef[p.support]), covariance


def normal_draws(mean: Floats, covariance: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Draws of a normal distribution, (count, p), whose covariance may be singular or badly scaled.

    InputError if it is not finite.
    """
    if not np.isfinite(covariance).all():
        raise InputError("the covariance of coefficients is not finite: the record does not determine them; give fewer")
    sd = np.sqrt(np.diagonal(covariance))
    scale = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    half = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean + rng.standard_normal((count, len(mean))) @ half.T)


def finest_step(dynamics: Dynamics, parameters: Floats, states: Floats, drive: Drive) -> float:
    """Step [s] at which integration is accurate: the median sampling interval over 1, 2, 4, 8 or 16; 0 for maps.

    Local errors are evaluated at those states (n, d) that are finite, with parameters (p,) and the drive of these rows.
    """
    if dynamics.roles.discrete:
        return 0.0
    interval, scale = float(np.median(drive.intervals)), spreads(states)
    errors = np.empty(len(drive.intervals))
    program = dynamics.program(parameters)
    substeps = MOST_SUBSTEPS if dynamics.jumps else 1
    while substeps < MOST_SUBSTEPS:
        local_errors(program, drive._replace(step=interval / substeps), states, scale, errors)
        finite = errors[np.isfinite(states[:-1]).all(axis=1)]
        finite = np.where(np.isfinite(finite), finite, np.inf)
        if not len(finite) or np.sort(finite)[int(SHARE * (len(finite) - 1))] <= TOLERANCE:
            break
        substeps *= 2
    return interval / substeps


def spreads(states: Floats) -> Floats:
    """A standard deviation of each state, (d,), of those values, (n, d), that are finite."""
    return np.array([_spread(column) for column in states.T])


def _spread(column: Floats) -> float:
    """Half the range of the middle 68 %, a normal distribution's standard deviation: huge values have no squares."""
    finite = np.sort(column[np.isfinite(column)])
    if not len(finite):
        return 1.0
    low, high = finite[[round(0.16 * (len(finite) - 1)), round(0.84 * (len(finite) - 1))]]
    spread = 0.5 * float(high - low)
    return spread if spread > 0 else max(float(np.abs(finite).max()), 1e-300)
