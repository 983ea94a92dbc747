"""Posterior inclusion probabilities as bars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.figures.answer import Answer, equation_of, likely_terms
from bayeq.figures.picture import one_axes, picture, titled
from bayeq.figures.style import BLACK, BLUE, PALE, RED, term_label
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["pip_bars"]


@picture
def pip_bars(eq: Answer, record: Record | None = None, ax: Any = None, *, target: str | None = None) -> Axes:
    """Posterior inclusion probabilities (PIP) of the terms shown and of the likeliest others.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record, optional
        Not used; all pictures take one.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    target : str, optional
        Which equation; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        A bar per term: filled where the term is shown, white where it is not.

    Raises
    ------
    UnknownNameError
        No equation of this target.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = equation_of(eq, target)
    listed = likely_terms(equation)
    names = [term.text for term in equation.terms]
    pip, shown = equation.posterior.pip[listed], equation.shown_posterior.support[listed]
    ax = one_axes(ax, left=24.0, height=5.0 * max(len(listed), 3) + 2.0)
    at = np.arange(len(listed))
    ax.set_axisbelow(True)
    ax.grid(axis="x", color=PALE, linewidth=0.5)
    for chosen, colour, label in ((shown, BLUE, "in the equation"), (~shown, "white", "not in it")):
        if chosen.any():
            ax.barh(at[chosen], pip[chosen], 0.62, color=colour, edgecolor=BLACK, linewidth=0.5, label=label)
    for place, value in zip(at, pip, strict=True):
        inside = value > 0.8
        side: dict[str, Any] = {"ha": "right" if inside else "left", "va": "center", "fontsize": 7}
        colour = "white" if inside and shown[place] else BLACK
        ax.text(value + (-0.015 if inside else 0.015), place, f"{value:.3f}", color=colour, **side)
    ax.axvline(0.5, color=RED, linestyle=(0, (4, 2)), linewidth=0.8)
    ax.set_yticks(at, [term_label(names[j], names) for j in listed])
    ax.set_ylim(max(len(listed), 3) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.0)
    rest = len(names) - len(listed)
    most = float(np.delete(equation.posterior.pip, listed).max(initial=0.0))
    ax.set_xlabel(f"PIP ({rest} more terms: at most {most:.1g})" if rest else "posterior inclusion probability")
    titled(ax, eq, equation.target)
    if listed:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2, fontsize=7)
    return ax
