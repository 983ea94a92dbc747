"""``Dynamics``: equations of motion as one first-order system on a tape, coefficients as parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from bayeq.expressions import Binary, Expression, Node, Number, Symbol, Tape
from bayeq.inference.posterior import Posterior
from bayeq.ode.rk4 import local_errors
from bayeq.states import Chain

__all__ = ["Dynamics", "finest_step", "normal_draws"]

Floats = NDArray[np.float64]

# A step is halved until this share (of the intervals) errs by less than TOLERANCE of the states' spread in an interval,
# at most MOST_SUBSTEPS times. Where a term jumps, no step is short enough: such intervals are the others.
SHARE = 0.75
TOLERANCE = 1e-6
MOST_SUBSTEPS = 16


@dataclass(frozen=True, eq=False)
class Dynamics:
    """dx/dt = f(x, u; theta): the chains' derivatives, and intercept + sum of coefficient x term for the highest.

    Attributes
    ----------
    chains : tuple of Chain
        One per equation.
    inputs : tuple of str
        Names of the inputs.
    terms : tuple of tuples of Expression
        The terms of each equation.
    intercepts : tuple of bool
        Equations that have an intercept.
    tape : Tape
        Of states, inputs and parameters; its outputs are the states' derivatives. The parameters are, equation by
        equation, the intercept (if there is one) and the coefficients of the terms.
    """

    chains: tuple[Chain, ...]
    inputs: tuple[str, ...]
    terms: tuple[tuple[Expression, ...], ...]
    intercepts: tuple[bool, ...]
    tape: Tape

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        inputs: Sequence[str],
        posteriors: Sequence[Posterior],
        terms: Sequence[Sequence[Expression]],
        intercepts: Sequence[bool] | None = None,
    ) -> Dynamics:
        """From the terms that posteriors include; nothing is compiled to machine code for them.

        Parameters
        ----------
        chains, inputs
            As the attributes.
        posteriors, terms
            Of each equation, with all candidates.
        intercepts : sequence of bool, optional
            By default all have one.
        """
        kept = [tuple(compress(all_, p.support)) for all_, p in zip(terms, posteriors, strict=True)]
        constant = (True,) * len(kept) if intercepts is None else tuple(intercepts)
        right: list[Expression] = []
        parameters: list[str] = []
        for k, (chain, members) in enumerate(zip(chains, kept, strict=True)):
            right += [Expression(Symbol(name)) for name in chain.states[1:]]
            # names that no channel can have
            names = [f"theta[{k},{j}]" for j in range(len(members) + 1)]
            total: Node = Symbol(names[0]) if constant[k] else Number(0)
            for name, term in zip(names[1:], members, strict=True):
                total = Binary("+", total, Binary("*", Symbol(name), term.tree))
            right.append(Expression(total))
            parameters += names[not constant[k] :]
        states = [name for chain in chains for name in chain.states]
        tape = Tape.compile(right, [*states, *inputs, *parameters])
        return cls(tuple(chains), tuple(inputs), tuple(kept), constant, tape)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states, in the tape's order."""
        return tuple(name for chain in self.chains for name in chain.states)

    @cached_property
    def targets(self) -> tuple[str, ...]:
        """Names of the left-hand sides."""
        return tuple(chain.target for chain in self.chains)

    @cached_property
    def slopes(self) -> dict[str, int]:
        """Which of the tape's outputs each target is."""
        last = np.cumsum([chain.order for chain in self.chains]) - 1
        return dict(zip(self.targets, last.tolist(), strict=True))

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(map(len, self.terms)) + sum(self.intercepts)

    def blocks(self) -> Iterator[slice]:
        """Where the parameters of each equation stand."""
        start = 0
        for members, constant in zip(self.terms, self.intercepts, strict=True):
            end = start + constant + len(members)
            yield slice(start, end)
            start = end

    def means(self, posteriors: Sequence[Posterior]) -> Floats:
        """Posterior means of the parameters, (p,)."""
        return np.concatenate(
            [
                np.append(p.intercept, p.coef[p.support])[not constant :]
                for p, constant in zip(posteriors, self.intercepts, strict=True)
            ]
        )

    def covariance(self, posteriors: Sequence[Posterior]) -> Floats:
        """Posterior covariance of the parameters given the terms, (p, p); equations are independent."""
        out = np.zeros((self.size, self.size))
        for block, p, constant in zip(self.blocks(), posteriors, self.intercepts, strict=True):
            # intercept = mean(y) - center'theta, where mean(y) has variance sigma^2/n
            carried = p.covariance @ p.center[p.support]
            whole = np.block([[np.array([[p.intercept_sd**2]]), -carried], [-carried[:, None], p.covariance]])
            out[block, block] = whole[not constant :, not constant :]
        return out

    def draw(self, posteriors: Sequence[Posterior], count: int, rng: np.random.Generator) -> Floats:
        """Parameters from their normal posterior given the terms, (count, p)."""
        return normal_draws(self.means(posteriors), self.covariance(posteriors), count, rng)

    def registers(self, parameters: Floats | None = None) -> Floats:
        """Fresh registers of the tape, with these parameters."""
        registers = self.tape.registers()
        if parameters is not None:
            first = len(self.states) + len(self.inputs)
            registers[first : first + self.size] = parameters
        return registers


def normal_draws(mean: Floats, covariance: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Draws of a normal distribution, (count, p), whose covariance may be singular or badly scaled."""
    sd = np.sqrt(np.diagonal(covariance))
    scale = np.where(sd > 0, sd, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    half = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean + rng.standard_normal((count, len(mean))) @ half.T)


def finest_step(dynamics: Dynamics, parameters: Floats, states: Floats, inputs: Floats, time: Floats) -> float:
    """A step [s] at which integration errs little at given states: the sampling interval, or a fraction of it.

    Parameters
    ----------
    dynamics : Dynamics
        The right-hand side.
    parameters : (p,) array
        Its parameters.
    states : (n, d) array
        Where steps are tried; rows that are not finite are left out of the judgement.
    inputs : (n, m, 4) array
        From `interpolant`.
    time : (n,) array
        [s].

    Returns
    -------
    float
        The median interval over 1, 2, 4, 8 or 16.
    """
    interval = float(np.median(np.diff(time)))
    scale = np.array([_spread(column) for column in states.T])
    errors = np.empty(len(time) - 1)
    substeps = 1
    while substeps < MOST_SUBSTEPS:
        local_errors(
            dynamics.tape.code, dynamics.tape.outputs, dynamics.registers(parameters), states, inputs, time,
            interval / substeps, scale, errors,
        )  # fmt: skip
        finite = errors[np.isfinite(states[:-1]).all(axis=1)]
        finite = np.where(np.isfinite(finite), finite, np.inf)
        if not len(finite) or np.sort(finite)[int(SHARE * (len(finite) - 1))] <= TOLERANCE:
            break
        substeps *= 2
    return interval / substeps


def _spread(column: Floats) -> float:
    """Half of the range between the quantiles that enclose a normal distribution's standard deviation.

    Runs that blow up have values that cannot be squared.
    """
    finite = column[np.isfinite(column)]
    if not len(finite):
        return 1.0
    low, high = np.quantile(finite, [0.16, 0.84])
    spread = 0.5 * float(high - low)
    return spread if spread > 0 else max(float(np.abs(finite).max()), 1e-300)
