"""Restoring forces (Masri and Caughey 1979): what a record and an equation say of them. Numbers only.

With unit mass, x'' + f(x, x') = what drives the motion: f is the driving terms less the acceleration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.expressions import Evaluator
from bayeq.figures.answer import EquationLike

__all__ = ["discovered_force", "measured_force", "require_second_order"]

Floats = NDArray[np.float64]


def require_second_order(equation: EquationLike) -> tuple[str, str]:
    """Names of displacement and velocity.

    Raises
    ------
    InputError
        The equation is not of second order.
    """
    if equation.chain.order != 2:
        raise InputError(
            f"{equation.target}: a restoring force is that of an equation of second order, such as of the chain x:v:a;"
            f" this one is of order {equation.chain.order}"
        )
    return equation.chain.names[0], equation.chain.names[1]


def measured_force(equation: EquationLike, columns: Mapping[str, Floats], target: Floats, of: Iterable[str]) -> Floats:
    """Restoring force per unit mass of the variables `of` at each row: terms of other variables less the target, (n,).

    Parameters
    ----------
    equation : Equation
        Of second order.
    columns : mapping of str to (n,) array
        States and inputs.
    target : (n,) array
        The acceleration, measured.
    of : sequence of str
        Displacement, velocity, or both.
    """
    own = _own(equation, of)
    evaluate = Evaluator(columns)
    p = equation.shown_posterior
    others = np.zeros(len(target))
    for j in np.flatnonzero(p.support):
        if j not in own:
            others = others + p.coef[j] * evaluate(equation.terms[j])
    return np.asarray(others - target, dtype=np.float64)


def discovered_force(equation: EquationLike, columns: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """The restoring force that the equation has found, and its standard deviation, at columns of its variables, (n,).

    The intercept is in it.
    """
    own = _own(equation, columns)
    evaluate = Evaluator(columns)
    p = equation.shown_posterior
    n = np.broadcast_shapes(*(np.shape(values) for values in columns.values()))
    kept = np.flatnonzero(p.support).tolist()
    # terms of other variables stay at their means
    Z = np.zeros((int(np.prod(n)), len(kept)))
    force = np.full(n, -p.intercept)
    for k, j in enumerate(kept):
        if j in own:
            values = np.broadcast_to(np.asarray(evaluate(equation.terms[j]), dtype=np.float64), n)
            force = force - p.coef[j] * values
            Z[:, k] = values.ravel() - p.center[j]
    variance = np.einsum("ij,jk,ik->i", Z, p.covariance, Z)
    return force, np.sqrt(np.maximum(variance, 0.0)).reshape(n)


def _own(equation: EquationLike, of: Iterable[str]) -> Sequence[int]:
    """Terms shown that use these variables alone."""
    variables = set(of)
    kept = np.flatnonzero(equation.shown_posterior.support).tolist()
    return [j for j in kept if set(equation.terms[j].names) <= variables]
