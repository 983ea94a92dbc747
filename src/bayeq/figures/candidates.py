"""Correlation of candidate terms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.expressions import Evaluator
from bayeq.figures.answer import Answer, equation_of, likely_terms
from bayeq.figures.picture import one_axes, picture
from bayeq.figures.style import BLACK, term_label
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["candidate_correlation"]

# A term beside the least that are drawn, so that the map is not of a single one.
LEAST_TERMS = 6


@picture
def candidate_correlation(eq: Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
    """Correlation of the terms shown and of the likeliest others over the rows of a record.

    Terms whose columns are nearly alike (close to 1 or -1) are those that a record can hardly tell apart.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        With the channels that the equations were found from.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    target : str, optional
        Which equation; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        Dark red at 1, white at 0, dark blue at -1, with the numbers; lines between terms shown and others.

    Raises
    ------
    InputError
        There are no candidates.
    UnknownNameError
        No equation of this target, or a channel that is missing.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = equation_of(eq, target)
    listed = likely_terms(equation)
    others = [j for j in np.argsort(-equation.posterior.pip, kind="stable").tolist() if j not in listed]
    listed += others[: max(LEAST_TERMS - len(listed), 0)]
    if not listed:
        raise InputError(f"{equation.target}: there are no candidate terms to compare")
    evaluate = Evaluator(eq.motion(record).columns)
    correlation = _correlation([np.asarray(evaluate(equation.terms[j])) for j in listed])
    names = [term.text for term in equation.terms]
    size = min(max(6.0 * len(listed), 36.0), 62.0)
    ax = one_axes(ax, left=24.0, height=size, right=90.0 - 24.0 - size, above=16.0)
    ax.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    at = np.arange(len(listed))
    labels = [term_label(names[j], names) for j in listed]
    ax.set_xticks(at, labels, rotation=90)
    ax.xaxis.tick_top()
    ax.set_yticks(at, labels)
    ax.tick_params(length=0)
    font = 6.5 if len(listed) <= 10 else 4.5
    for i in range(len(listed)):
        for k in range(len(listed)):
            value = correlation[i, k]
            colour = "white" if abs(value) > 0.6 else BLACK
            text = "1" if i == k else f"{value:.2f}".replace("0.", ".").replace("-", "\N{MINUS SIGN}")
            ax.text(k, i, text, ha="center", va="center", fontsize=font, color=colour)
    shown = equation.shown_posterior.support[listed]
    inside = int(shown.sum())
    for edge in (ax.axvline, ax.axhline):
        if 0 < inside < len(listed):
            edge(inside - 0.5, color=BLACK, linewidth=0.9)
    return ax


def _correlation(columns: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Correlation of columns; 0 with one that does not vary."""
    D = np.column_stack(np.broadcast_arrays(*columns))
    D = D[np.isfinite(D).all(axis=1)]
    D = D - D.mean(axis=0)
    scale = np.sqrt((D**2).mean(axis=0))
    D = D / np.where(scale > 0, scale, 1.0)
    return np.asarray(D.T @ D / len(D))
