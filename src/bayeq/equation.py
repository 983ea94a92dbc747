"""`Equation`: one discovered equation of motion, as numbers, text, SymPy and LaTeX."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import exp, floor, isfinite, log10
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayeq.diagnostics import Residuals
from bayeq.expressions import Evaluator, Expression, to_sympy
from bayeq.posterior import Posterior
from bayeq.states import Chain

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Z95", "Equation", "Fit", "RunnerUp"]

Floats = NDArray[np.float64]

# Half-width of a 95 % interval of a normal distribution, in standard deviations.
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class Fit:
    """How well an equation gives the target on some rows.

    Attributes
    ----------
    n : int
        Rows.
    r2 : float
        Share of the target's variance explained.
    nrmse : float
        Root mean squared error over the standard deviation of the target.
    """

    n: int
    r2: float
    nrmse: float


@dataclass(frozen=True, slots=True)
class RunnerUp:
    """A model one move away from the chosen one.

    Attributes
    ----------
    leaves, enters : str or None
        Term taken out of and put into the chosen model.
    log_odds : float
        Log posterior odds against the chosen model, ln p(runner-up | y) / p(chosen | y).
    """

    leaves: str | None
    enters: str | None
    log_odds: float

    @property
    def odds(self) -> str:
        """The odds as a person says them: ``1:7`` against, ``2:1`` for."""
        ratio = exp(min(abs(self.log_odds), 700.0))
        number = f"{ratio:.1f}" if ratio < 9.95 else f"{ratio:.0f}" if ratio < 1e6 else f"{ratio:.0e}"
        return f"1:{number}" if self.log_odds <= 0 else f"{number}:1"

    def __str__(self) -> str:
        if self.leaves and self.enters:
            return f"{self.enters} instead of {self.leaves}"
        return f"without {self.leaves}" if self.leaves else f"with {self.enters} added"


@dataclass(frozen=True)
class Equation:
    """One equation: target = intercept + sum of coefficient x term.

    Attributes
    ----------
    chain : Chain
        The coordinate whose highest derivative is the target.
    terms : tuple of Expression
        All P candidates.
    posterior : Posterior
        In original units.
    train, held_out : Fit
        Fit on the rows used and on rows not used (None if none were held out).
    residuals : Residuals
        Whiteness of the training residuals.
    runners_up : tuple of RunnerUp
        The likeliest models one move away, where the engine compares models.
    """

    chain: Chain
    terms: tuple[Expression, ...]
    posterior: Posterior
    train: Fit
    held_out: Fit | None
    residuals: Residuals
    runners_up: tuple[RunnerUp, ...] = ()

    @property
    def target(self) -> str:
        """Name of the left-hand side."""
        return self.chain.target

    @property
    def included(self) -> tuple[str, ...]:
        """Names of the included terms."""
        return tuple(t.text for t, kept in zip(self.terms, self.posterior.support, strict=True) if kept)

    @property
    def coef(self) -> dict[str, float]:
        """Coefficient of each included term, in original units."""
        return dict(zip(self.included, self.posterior.coef[self.posterior.support].tolist(), strict=True))

    @property
    def noise_sd(self) -> float:
        """Standard deviation of what the terms leave of the target."""
        return float(np.sqrt(self.posterior.noise_variance))

    @property
    def ci95(self) -> Floats:
        """95 % intervals of the coefficients given the included set, (P, 2); 0 for a term not included."""
        half = Z95 * self.posterior.sd
        return np.column_stack([self.posterior.coef - half, self.posterior.coef + half])

    @property
    def intercept_ci95(self) -> tuple[float, float]:
        """95 % interval of the intercept."""
        half = Z95 * self.posterior.intercept_sd
        return self.posterior.intercept - half, self.posterior.intercept + half

    @property
    def intercept_matters(self) -> bool:
        """Whether the interval of the intercept excludes zero; only then it is written out."""
        low, high = self.intercept_ci95
        return low > 0 or high < 0

    def table(self) -> pd.DataFrame:
        """All candidates: term, coef, sd, ci_low, ci_high, pip, included."""
        import pandas as pd

        ci = self.ci95
        return pd.DataFrame(
            {
                "term": [term.text for term in self.terms],
                "coef": self.posterior.coef,
                "sd": self.posterior.sd,
                "ci_low": ci[:, 0],
                "ci_high": ci[:, 1],
                "pip": self.posterior.pip,
                "included": self.posterior.support,
            }
        )

    @cached_property
    def text(self) -> str:
        """The equation as a line of text, coefficients to a tenth of their standard deviation."""
        p = self.posterior
        parts = [
            (round_to(value, sd), term.text)
            for term, value, sd, kept in zip(self.terms, p.coef, p.sd, p.support, strict=True)
            if kept
        ]
        if self.intercept_matters:
            parts.append((round_to(p.intercept, p.intercept_sd), ""))
        pieces: list[str] = []
        for number, term in parts:
            sign, size = ("-", number[1:]) if number.startswith("-") else ("+", number)
            body = f"{size}*{_factor(term)}" if term else size
            pieces.append(f"{sign} {body}" if pieces else (f"-{body}" if sign == "-" else body))
        return f"{self.target} = {' '.join(pieces) or '0'}"

    def to_sympy(self) -> Any:
        """The equation as `sympy.Eq`, with full-precision coefficients.

        The intercept is in it where its 95 % interval excludes zero; `evaluate` and `predict` always add it.
        """
        import sympy

        return sympy.Eq(sympy.Symbol(self.target), self._right_hand_side(digits=None), evaluate=False)

    def to_latex(self) -> str:
        r"""The equation in LaTeX, derivatives of the coordinate as dots: ``\ddot{x} = - 2.0 \dot{x} ...``."""
        import sympy

        base = sympy.latex(sympy.Symbol(self.chain.names[0]))
        dots = [base, rf"\dot{{{base}}}", rf"\ddot{{{base}}}", rf"\dddot{{{base}}}", rf"\ddddot{{{base}}}"]
        names = {sympy.Symbol(name): dots[k] for k, name in enumerate(self.chain.names)}
        right = sympy.latex(self._right_hand_side(digits=2), symbol_names=names)
        return f"{dots[self.chain.order]} = {right}"

    def _right_hand_side(self, digits: int | None) -> Any:
        import sympy

        p = self.posterior

        def number(value: float, sd: float) -> Any:
            return sympy.Float(value if digits is None else float(round_to(value, sd)), 15 if digits is None else None)

        total = sympy.Integer(0)
        for term, value, sd, kept in zip(self.terms, p.coef, p.sd, p.support, strict=True):
            if kept:
                total += number(float(value), float(sd)) * to_sympy(term)
        if self.intercept_matters:
            total += number(p.intercept, p.intercept_sd)
        return total

    def evaluate(self, columns: Mapping[str, ArrayLike]) -> Floats:
        """Predictive mean of the target (29) from columns (or numbers) of states and inputs."""
        return self._mean(Evaluator(columns))

    def _mean(self, evaluate: Evaluator) -> Floats:
        p = self.posterior
        total: Any = p.intercept
        for j in np.flatnonzero(p.support):
            total = total + p.coef[j] * evaluate(self.terms[j])
        return np.asarray(total, dtype=np.float64)

    def predict(self, columns: Mapping[str, Floats], return_std: bool = False) -> Any:
        """Predictive mean (29), and with `return_std` the standard deviation (30), at n rows of columns."""
        evaluate = Evaluator(columns)
        n = len(next(iter(columns.values())))
        mean = np.broadcast_to(self._mean(evaluate), (n,)).copy()
        if not return_std:
            return mean
        D = np.zeros((n, len(self.terms)))
        for j in np.flatnonzero(self.posterior.support):
            D[:, j] = evaluate(self.terms[j])
        return mean, self.posterior.predictive_sd(D)


def _factor(term: str) -> str:
    """A term as the factor of a product: in parentheses if it is a sum or a quotient."""
    depth = 0
    for k, character in enumerate(term):
        depth += (character == "(") - (character == ")")
        exponent = k > 0 and term[k - 1] in "eE" and k > 1 and term[k - 2].isdigit()
        if depth == 0 and character in "+-/" and not exponent:
            return f"({term})"
    return term


def round_to(value: float, sd: float) -> str:
    """A number with digits down to a tenth of its standard deviation, between 3 and 12 significant ones."""
    if value == 0 or not isfinite(value):
        return f"{value:g}"
    digits = 12 if sd <= 0 else floor(log10(abs(value))) - floor(log10(sd)) + 2
    return f"{value:.{min(max(digits, 3), 12)}g}"
