"""Coefficients and their intervals, each over its own size."""

from __future__ import annotations

from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.figures.answer import Answer, equation_of
from bayeq.figures.picture import one_axes, picture, plain, titled, unit_text
from bayeq.figures.style import BLACK, BLUE, PALE, RED, term_label
from bayeq.numerics.normal import Z95
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["coefficient_forest"]


@picture
def coefficient_forest(eq: Answer, record: Record | None = None, ax: Any = None, *, target: str | None = None) -> Axes:
    """Coefficients of the terms shown with their 95 % intervals, as deviations from the estimate in per cent of it.

    So coefficients of different units stand on one scale: how well each is known. The numbers themselves, with their
    units, stand beside them.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record, optional
        Of a simulated record, which knows its law, the true coefficients are marked.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    target : str, optional
        Which equation; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        A bar from end to end of each interval.

    Raises
    ------
    UnknownNameError
        No equation of this target.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = equation_of(eq, target)
    shown = equation.shown_posterior
    kept = np.flatnonzero(shown.support & (shown.coef != 0))
    coef, sd, intervals = shown.coef[kept], shown.sd[kept], equation.printed_ci95[kept]
    names = [term.text for term in equation.terms]
    ax = one_axes(ax, left=24.0, height=6.0 * max(len(kept), 3) + 2.0, right=36.0)
    at = np.arange(len(kept))
    off = 100.0 * np.sort((intervals - coef[:, None]) / np.abs(coef)[:, None], axis=1)
    ax.axvline(0.0, color=PALE, linewidth=1.0, zorder=0)
    ax.hlines(at, off[:, 0], off[:, 1], color=BLUE, linewidth=2.2, label="95 % interval")
    ax.plot(np.zeros(len(kept)), at, "o", color=BLACK, markersize=3.2, label="estimate")
    truth = {} if record is None or record.truth is None else record.truth.coefficients.get(equation.target, {})
    known = [k for k, j in enumerate(kept) if names[j] in truth]
    if known:
        true = np.array([truth[names[kept[k]]] for k in known])
        error = 100.0 * (true - coef[known]) / np.abs(coef[known])
        ax.plot(error, at[known], "D", color=RED, markerfacecolor="none", markersize=5.0, label="true")
    ax.set_yticks(at, [term_label(names[j], names) for j in kept])
    ax.set_ylim(max(len(kept), 3) - 0.4, -0.6)
    reach = 1.15 * float(np.abs(off).max(initial=1e-6))
    ax.set_xlim(-reach, reach)
    for place, j, value, spread in zip(at, kept, coef, sd, strict=True):
        unit = equation.coef_units[j]
        text = f"{_number(value, spread)}{f' {unit_text(unit)}' if unit and unit != '1' else ''}"
        where: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "va": "center", "fontsize": 7}
        ax.text(1.02, place, plain(text.replace("-", "\N{MINUS SIGN}", 1) if value < 0 else text), **where)
    ax.set_xlabel("deviation from the estimate [% of it]")
    titled(ax, eq, equation.target)
    ax.legend(loc="lower left", bbox_to_anchor=(0.12, 1.0), borderaxespad=0.2, ncols=3, fontsize=7, handlelength=1.2)
    return ax


def _number(value: float, sd: float) -> str:
    """A coefficient to a tenth of its standard deviation, and half its interval given the terms shown.

    >>> _number(-1003.62, 2.1), _number(-99640.0, 320.0), _number(2.5e7, 3e4)
    ('-1003.6 ± 4.1', '-99640 ± 630', '(2.500 ± 0.006)e7')
    """
    if not (isfinite(sd) and sd > 0 and value):
        return f"{value:.4g}"
    power = floor(log10(abs(value)))
    if -4 <= power < 6:
        digits = 1 - floor(log10(sd))
        return f"{round(value, digits):.{max(digits, 0)}f} ± {round(Z95 * sd, digits):.{max(digits, 0)}f}"
    digits = max(power - floor(log10(sd)), 0)
    scale = 10.0**-power
    return f"({value * scale:.{digits}f} ± {Z95 * sd * scale:.{digits}f})e{power}"
