"""The equations of an answer: a tuple, and as text where it is called."""

from __future__ import annotations

from bayeq.equation.equation import Equation

__all__ = ["EquationTuple", "coefficients"]

# The constant as a term, as libraries of polynomials call it.
CONSTANT = "1"


class EquationTuple(tuple[Equation, ...]):
    """Equations in the order of the chains: a tuple of `Equation`, and a list of strings where it is called.

    ``eq.equations[0]`` is an `Equation`; ``eq.equations()`` are the lines that are printed, as those who come from
    PySINDy expect them.
    """

    __slots__ = ()

    def __call__(self) -> list[str]:
        """The equations as text, coefficients to a tenth of their standard deviation."""
        return [equation.text for equation in self]


def coefficients(equations: tuple[Equation, ...]) -> dict[str, dict[str, float]]:
    """Coefficients of the terms shown, by target and term; "1" is the constant, where the equation has one."""
    out: dict[str, dict[str, float]] = {}
    for equation in equations:
        terms = {name: float(value) for name, value in equation.shown_coef.items()}
        if equation.intercept_matters:
            terms[CONSTANT] = float(equation.shown_posterior.intercept)
        out[equation.target] = terms
    return out
