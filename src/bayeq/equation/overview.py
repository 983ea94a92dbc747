"""A quick look at an answer: its figure, and what a notebook shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.equation.answer import Answer
from bayeq.equation.equation import Equation
from bayeq.equation.written import round_to
from bayeq.figures.picture import above, axes_for
from bayeq.figures.runs import draw_states
from bayeq.figures.style import style
from bayeq.figures.terms import draw_terms
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.markup import code, items, join, paragraph, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bayeq.forecast.run import Forecast

__all__ = ["as_html", "plot_run", "plot_terms"]

# Candidates that are not in the equation are listed up to this many.
MOST_OTHERS = 10

# Width of the figure, heights of a bar, of what is around the bars, and of a state's panel [mm].
WIDTH, BAR, AROUND, PANEL = 160.0, 6.0, 20.0, 40.0

HEADER = ("term", "coefficient", "sd", "95 % interval")


def plot_terms(eq: Answer, ax: Any = None) -> list[Axes]:
    """Inclusion probabilities, coefficients and intervals, an equation in each of the axes."""
    score = ENGINES[eq.method].score
    bars = {equation.target: _bars(equation) for equation in eq.equations}
    with style():
        axes = axes_for(ax, [AROUND + BAR * max(len(rows), 3) for rows in bars.values()], WIDTH, pyplot=True)
        for one, (target, rows) in zip(axes, bars.items(), strict=True):
            draw_terms(one, target, rows, score)
    return axes


def plot_run(run: Forecast, ax: Any = None) -> list[Axes]:
    """A free run, a state in each of the axes."""
    with style():
        axes = axes_for(ax, [PANEL] * len(run.mean), WIDTH, pyplot=True)
        draw_states(axes, run)
        above(axes[0])
    return axes


def _listed(equation: Equation) -> list[int]:
    """Terms of the equation, then the likeliest others."""
    pip, shown = equation.posterior.pip, equation.shown_posterior.support
    others = [int(j) for j in np.argsort(-pip, kind="stable") if not shown[j] and pip[j] >= NOTEWORTHY_PIP]
    return [*np.flatnonzero(shown).tolist(), *others[:MOST_OTHERS]]


def _numbers(equation: Equation, j: int) -> tuple[str, str, str]:
    """Coefficient of a term, standard deviation and interval as text; empty for one that is not shown."""
    p = equation.shown_posterior
    if not p.support[j]:
        return "", "", ""
    low, high = (round_to(end, p.sd[j]) for end in equation.printed_ci95[j])
    return round_to(p.coef[j], p.sd[j]), f"{p.sd[j]:.2g}", f"{low} .. {high}"


def _bars(equation: Equation) -> list[tuple[str, float, str]]:
    """Term, probability, and coefficient with its interval."""
    bars = []
    for j in _listed(equation):
        value, _, interval = _numbers(equation, j)
        text = f"{value}  ({interval})" if value else ""
        bars.append((equation.terms[j].text, float(equation.posterior.pip[j]), text))
    return bars


def as_html(eq: Answer) -> str:
    """What a notebook shows: the verdict, then each equation and its terms, then the warnings."""
    parts = [paragraph(f"verdict: {eq.verdict}", strong=True)]
    header = (*HEADER, ENGINES[eq.method].score, "unit")
    for equation in eq.equations:
        parts += [code(equation.text), table(header, _rows(equation))]
    parts.append(paragraph(f"{eq.data.n} rows; method: {ENGINES[eq.method].title}"))
    return join(*parts, items([f"warning: {message}" for message in eq.warnings]))


def _rows(equation: Equation) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for j in _listed(equation):
        numbers = _numbers(equation, j)
        unit = equation.coef_units[j] or "" if numbers[0] else ""
        first = numbers if numbers[0] else ("not in it", "", "")
        rows.append((equation.terms[j].text, *first, f"{equation.posterior.pip[j]:.3f}", unit))
    if equation.intercept_matters:
        value, sd = equation.intercept_estimate
        low, high = (round_to(end, sd) for end in equation.printed_intercept_ci95)
        unit = equation.units.get(equation.target, "")
        rows.append(("1", round_to(value, sd), f"{sd:.2g}", f"{low} .. {high}", "", unit))
    return rows
