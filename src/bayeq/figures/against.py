"""Measured against predicted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.figures.answer import Answer, equation_of
from bayeq.figures.picture import label_of, one_axes, picture, thinned, titled
from bayeq.figures.style import BLACK, BLUE, ORANGE
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["measured_against_predicted"]


@picture
def measured_against_predicted(eq: Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
    """The target of an equation as it was measured, over what the equation gives at the states of the same row.

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
        Rows used as dots, rows held out (the last of the record, as many as in `discover`) as crosses, and the line on
        which both are equal.

    Raises
    ------
    UnknownNameError
        No equation of this target, or a channel that is missing.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = equation_of(eq, target)
    rows = eq.motion(record)
    measured = rows.observed[equation.target]
    predicted = np.asarray(equation.predict(rows.columns))
    cut = rows.n - int(eq.data.holdout * rows.n)
    ax = one_axes(ax, height=58.0)
    every = thinned(rows.n)
    used = np.arange(rows.n)[every] < cut
    for part, marker, colour, label in ((used, ".", BLUE, "rows used"), (~used, "+", ORANGE, "rows held out")):
        if part.any():
            x, y = predicted[every][part], measured[every][part]
            look: dict[str, Any] = {"markersize": 2.6, "alpha": 0.6, "rasterized": True}
            ax.plot(x, y, marker, color=colour, markeredgewidth=0.6, label=label, **look)
    ends = np.array([np.nanmin([measured, predicted]), np.nanmax([measured, predicted])])
    ax.plot(ends, ends, color=BLACK, linewidth=0.7, label="equal")
    error = measured - predicted
    r2 = 1.0 - float(np.nanvar(error) / np.nanvar(measured)) if np.nanvar(measured) > 0 else float("nan")
    ax.text(0.04, 0.96, f"$R^2$ = {r2:.4f}", transform=ax.transAxes, ha="left", va="top")
    ax.set_xlabel(label_of(equation.target, equation.units, "predicted"))
    ax.set_ylabel(label_of(equation.target, equation.units, "measured"))
    titled(ax, eq, equation.target)
    ax.legend(loc="lower right", fontsize=7, markerscale=2.0, handlelength=1.4)
    return ax
