"""A quick look at an answer: its figure, and what a notebook shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayeq.equation.answer import Answer
from bayeq.equation.brief import checks, law_in_symbols, sentence, tabled_parameters
from bayeq.equation.equation import Equation
from bayeq.equation.oscillator import own_parameters
from bayeq.equation.rows import Row, rows_of
from bayeq.figures.picture import above, axes_for
from bayeq.figures.runs import draw_states
from bayeq.figures.style import style
from bayeq.figures.terms import draw_terms
from bayeq.inference.engines import ENGINES, NOTEWORTHY_PIP
from bayeq.markup import code, items, join, paragraph, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from bayeq.forecast.run import Forecast

# Candidates that are not in the equation are listed up to this many.
MOST_OTHERS = 10

# Width of the figure, heights of a bar, of what is around the bars, and of a state's panel [mm].
WIDTH, BAR, AROUND, PANEL = 160.0, 6.0, 20.0, 40.0

HEADER = ("term", "coefficient", "sd", "95 % interval")
PARAMETERS = ("parameter", "value", "95 % interval", "unit", "meaning")


def plot_terms(eq: Answer, ax: Any = None) -> list[Axes]:
    """Inclusion probabilities, coefficients and intervals, an equation in each of the axes."""
    score = ENGINES[eq.method].score
    bars = {equation.target: list(map(_bar, _listed(equation))) for equation in eq.equations}
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


def _listed(equation: Equation) -> list[Row]:
    """Terms of the equation, then the likeliest others."""
    *rows, _ = rows_of(equation)
    others = sorted((row for row in rows if row.absent and row.pip >= NOTEWORTHY_PIP), key=lambda row: -row.pip)
    return [*(row for row in rows if row.coefficient and row.score), *others[:MOST_OTHERS]]


def _bar(row: Row) -> tuple[str, float, str]:
    """Term, probability, and coefficient with its interval."""
    return row.name, row.pip, f"{row.coefficient}  ({row.interval})" if row.coefficient else ""


def as_html(eq: Answer) -> str:
    """What a notebook shows: the verdict, each equation and its terms, physical parameters, checks and warnings."""
    parts = [paragraph(f"verdict: {eq.verdict.kind}: {sentence(eq)}", strong=True)]
    header = (*HEADER, ENGINES[eq.method].score, "unit")
    for equation in eq.equations:
        terms = _rows(equation)
        width = len(header) if any(row[-1] for row in terms) else len(header) - 1
        parts += [code(equation.text), table(header[:width], [row[:width] for row in terms])]
    physical = own_parameters(eq)
    if physical is not None:
        law = law_in_symbols(eq, physical)
        parts += [*([] if law is None else [code(law)]), table(PARAMETERS, tabled_parameters(physical), (0, 4))]
    return join(*parts, paragraph(checks(eq)), items([f"warning: {message}" for message in eq.warnings]))


def _rows(equation: Equation) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        (row.name, row.coefficient or "not in it", row.sd, row.interval, row.score, row.unit)
        for row in _listed(equation)
    ]
    constant = rows_of(equation)[-1]
    if equation.intercept_matters:
        rows.append(("1", constant.coefficient, constant.sd, constant.interval, "", constant.unit))
    return rows
