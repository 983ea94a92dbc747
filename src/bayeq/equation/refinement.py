"""Equations with coefficients by output error."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayeq.equation.answer import Answer
from bayeq.equation.prepare import prepared
from bayeq.equation.several import EquationTuple
from bayeq.errors import ConvergenceWarning, InputError
from bayeq.forecast.rows import check_interpolation
from bayeq.records import Record
from bayeq.refine.output_error import Unrefined
from bayeq.refine.refine import refine

if TYPE_CHECKING:
    from bayeq.ode.rk4 import Interpolation

__all__ = ["refinement"]


def refinement(
    eq: Answer, records: Sequence[Record], holdout: float, interpolation: Interpolation | None
) -> dict[str, Any]:
    """What `Equations.refine` gives new: some fields of `Equations`, or none if nothing better was found."""
    check_interpolation(interpolation)
    if not 0 <= holdout < 1:
        raise InputError(f"holdout is a share of the rows, 0 <= holdout < 1, got {holdout!r}")
    for equation in eq.equations:
        if not equation.shown:
            raise InputError(f"{equation.target}: there are no terms to refine")
    found = refine(
        eq.dynamics(),
        eq.dynamics([equation.intercept_matters for equation in eq.equations]),
        prepared(records, eq.roles, eq.smooth, eq.warnings, divide=True, level=4),
        smooth=eq.smooth,
        holdout=holdout,
        interpolation=interpolation,
        constraints=eq.known(),
        sensors=eq.data.sensors,
    )
    if isinstance(found, Unrefined):
        message = f"not refined: {found.reason}; the equations are returned as they were: {found.advice}"
        warnings.warn(message, ConvergenceWarning, stacklevel=3)
        return {}
    found.log.emit(stacklevel=4)
    return {
        "equations": EquationTuple(
            old.with_posterior(new.posterior, train=new.train, held_out=new.held_out, residuals=new.residuals)
            for old, new in zip(eq.equations, found.equations, strict=True)
        ),
        "warnings": (*eq.warnings, *found.log.messages),
        "scores": found.scores,
        "refined": found.summary,
    }
