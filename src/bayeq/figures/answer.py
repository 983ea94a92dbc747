"""What pictures need of an answer, and how they choose from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions import Expression
from bayeq.records import Record

__all__ = ["Answer", "Chain", "EquationLike", "Posterior", "Rows", "Run", "channel_of", "equation_of", "likely_terms"]

Floats = NDArray[np.float64]

# Candidates that are not in the equation are drawn from this probability on, and this many terms in all.
NOTEWORTHY_PIP = 0.01
MOST_TERMS = 24


class Chain(Protocol):
    """A coordinate and its derivatives; see `bayeq.states.Chain`."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def order(self) -> int: ...
    @property
    def states(self) -> tuple[str, ...]: ...
    @property
    def target(self) -> str: ...


class Posterior(Protocol):
    """Coefficients given a model; see `bayeq.inference.posterior.Posterior`."""

    @property
    def pip(self) -> Floats: ...
    @property
    def support(self) -> NDArray[np.bool_]: ...
    @property
    def coef(self) -> Floats: ...
    @property
    def sd(self) -> Floats: ...
    @property
    def covariance(self) -> Floats: ...
    @property
    def center(self) -> Floats: ...
    @property
    def intercept(self) -> float: ...


class EquationLike(Protocol):
    """One equation; see `bayeq.Equation`."""

    @property
    def chain(self) -> Chain: ...
    @property
    def terms(self) -> tuple[Expression, ...]: ...
    @property
    def posterior(self) -> Posterior: ...
    @property
    def shown_posterior(self) -> Posterior: ...
    @property
    def printed_ci95(self) -> Floats: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def coef_units(self) -> tuple[str | None, ...]: ...
    @property
    def target(self) -> str: ...
    def predict(self, columns: Mapping[str, Floats], return_std: bool = False) -> Any: ...


class Rows(Protocol):
    """States, targets and inputs of a record; see `bayeq.states.motion.MotionRows`."""

    @property
    def time(self) -> Floats | None: ...
    @property
    def columns(self) -> Mapping[str, Floats]: ...
    @property
    def observed(self) -> Mapping[str, Floats]: ...
    @property
    def samples(self) -> Mapping[str, Floats]: ...
    @property
    def n(self) -> int: ...


class Run(Protocol):
    """A free run; see `bayeq.Forecast`."""

    @property
    def time(self) -> Floats: ...
    @property
    def mean(self) -> Mapping[str, Floats]: ...
    @property
    def low(self) -> Mapping[str, Floats]: ...
    @property
    def high(self) -> Mapping[str, Floats]: ...
    @property
    def measured(self) -> Mapping[str, Floats]: ...
    @property
    def blew_up_at(self) -> float | None: ...


class Data(Protocol):
    """What equations were found from."""

    @property
    def holdout(self) -> float: ...
    @property
    def rows_as_time(self) -> bool: ...


class Answer(Protocol):
    """Equations; see `bayeq.Equations`."""

    @property
    def equations(self) -> Sequence[EquationLike]: ...
    @property
    def inputs(self) -> tuple[str, ...]: ...
    @property
    def data(self) -> Data: ...
    def motion(self, record: Record) -> Rows: ...
    def simulate(self, record: Record, *, draws: int = 200, start: int = 0, rows: int | None = None) -> Run: ...


def equation_of(eq: Answer, target: str | None) -> EquationLike:
    """The equation of a target, by default the first.

    Raises
    ------
    UnknownNameError
        There is no such target.
    """
    if target is None:
        return eq.equations[0]
    for equation in eq.equations:
        if equation.target == target:
            return equation
    raise UnknownNameError("equation", target, [equation.target for equation in eq.equations])


def channel_of(run: Run, channel: str | None) -> str:
    """A state of a free run that is measured, by default the first.

    Raises
    ------
    InputError
        No state is measured.
    UnknownNameError
        This one is not.
    """
    if not run.measured:
        raise InputError("no state of the equations is measured: there is nothing to compare the free run with")
    if channel is None:
        return next(iter(run.measured))
    if channel not in run.measured:
        raise UnknownNameError("measured state", channel, list(run.measured))
    return channel


def likely_terms(equation: EquationLike) -> list[int]:
    """Terms shown or included, then the likeliest of the others."""
    pip = equation.posterior.pip
    chosen = equation.shown_posterior.support | equation.posterior.support
    order = np.argsort(-pip, kind="stable").tolist()
    listed = [*np.flatnonzero(chosen).tolist(), *(j for j in order if not chosen[j] and pip[j] >= NOTEWORTHY_PIP)]
    return listed[:MOST_TERMS]
