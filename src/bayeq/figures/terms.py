"""Terms of an equation: probabilities, coefficients with intervals, correlations; drift over files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.expressions import Evaluator
from bayeq.figures import style
from bayeq.markup import shortened
from bayeq.numerics.distributions import Z95
from bayeq.records import Record

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Fewest terms of a correlation map, filled up with the likeliest others.
LEAST_TERMS = 6

# Heights in a quick look: of a bar, and of title and labels around the bars [mm].
BAR, AROUND_BARS = 6.0, 20.0


def _bars(ax: Axes, labels: Sequence[str], pip: Sequence[float], shown: Sequence[bool]) -> None:
    """A bar for each term, as long as its probability: filled where the term is in the equation."""
    at, length, filled = np.arange(len(labels)), np.asarray(pip), np.asarray(shown, dtype=bool)
    ax.set_axisbelow(True)
    ax.grid(axis="x", color=style.PALE, linewidth=0.5)
    for chosen, colour, label in ((filled, style.BLUE, "in the equation"), (~filled, "white", "not in it")):
        if chosen.any():
            ax.barh(at[chosen], length[chosen], 0.62, color=colour, edgecolor=style.BLACK, linewidth=0.5, label=label)
    ax.axvline(0.5, color=style.RED, linestyle=style.DASHED, linewidth=0.8)
    ax.set_yticks(at, labels)
    ax.set(xlim=(0.0, 1.0), ylim=(max(len(at), 3) - 0.4, -0.6))


def draw_terms(by_target: Mapping[str, Sequence[tuple[str, float, str]]], score: str, ax: Any) -> list[Axes]:
    """A bar for each term of each equation: its name, probability, and coefficient, empty where it is not shown."""
    with style.style():
        heights = [AROUND_BARS + BAR * max(len(terms), 3) for terms in by_target.values()]
        axes = style.axes_for(ax, heights, style.QUICK, pyplot=True)
        for one, (target, terms) in zip(axes, by_target.items(), strict=True):
            names = [name for name, _, _ in terms]
            labels = [style.term_label(name, names) for name in names]
            _bars(one, labels, [pip for _, pip, _ in terms], [bool(c) for _, _, c in terms])
            one.set_xlabel(f"{score} (a blue bar: in the equation; right: coefficient, 95 % interval)")
            one.set_title(style.term_label(target), loc="left")
            for place, (_, _, coefficient) in enumerate(terms):
                _beside(one, place, coefficient.replace("-", "\N{MINUS SIGN}"))
    return axes


def _beside(ax: Axes, place: float, text: str, **look: Any) -> None:
    ax.text(1.02, place, text, transform=ax.get_yaxis_transform(), ha="left", va="center", **look)


@style.picture
def pip_bars(eq: style.Answer, record: Record | None = None, ax: Any = None, *, target: str | None = None) -> Axes:
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
    equation = style.equation_of(eq, target)
    listed = style.likely_terms(equation)
    names = [term.text for term in equation.terms]
    pip, shown = equation.posterior.pip[listed], equation.shown_posterior.support[listed]
    (ax,) = style.axes_for(ax, [5.0 * max(len(listed), 3) + 20.0], style.SINGLE_COLUMN)
    _bars(ax, [style.term_label(names[j], names) for j in listed], pip.tolist(), shown.tolist())
    for place, value in enumerate(pip.tolist()):
        inside = value > 0.8
        colour = "white" if inside and shown[place] else style.BLACK
        side: dict[str, Any] = {"ha": "right" if inside else "left", "va": "center", "fontsize": 7, "color": colour}
        ax.text(value + (-0.015 if inside else 0.015), place, f"{value:.3f}", **side)
    rest = len(names) - len(listed)
    most = float(np.delete(equation.posterior.pip, listed).max(initial=0.0))
    ax.set_xlabel(f"PIP ({rest} more terms: at most {most:.1g})" if rest else "posterior inclusion probability")
    style.titled(ax, eq, equation.target)
    if listed:
        style.above(ax)
    return ax


@style.picture
def coefficient_forest(
    eq: style.Answer, record: Record | None = None, ax: Any = None, *, target: str | None = None
) -> Axes:
    """Coefficients of the terms shown with their 95 % intervals, as deviations from the estimate in per cent of it.

    So coefficients of different units stand on one scale: how well each is known. The numbers themselves, with their
    units, stand beside them.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record, optional
        The true coefficients are marked if it is a simulated record, which knows its law.
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
    equation = style.equation_of(eq, target)
    shown = equation.shown_posterior
    kept = np.flatnonzero(shown.support & (shown.coef != 0))
    coef, sd, intervals = shown.coef[kept], shown.sd[kept], equation.printed_ci95[kept]
    names = [term.text for term in equation.terms]
    (ax,) = style.axes_for(ax, [6.0 * max(len(kept), 3) + 20.0], style.SINGLE_COLUMN)
    at = np.arange(len(kept))
    off = 100.0 * np.sort((intervals - coef[:, None]) / np.abs(coef)[:, None], axis=1)
    ax.axvline(0.0, color=style.PALE, linewidth=1.0, zorder=0)
    ax.hlines(at, off[:, 0], off[:, 1], color=style.BLUE, linewidth=2.2, label="95 % interval")
    ax.plot(np.zeros(len(kept)), at, "o", color=style.BLACK, markersize=3.2, label="estimate")
    truth = {} if record is None or record.truth is None else record.truth.coefficients.get(equation.target, {})
    known = [k for k, j in enumerate(kept) if names[j] in truth]
    if known:
        true = np.array([truth[names[kept[k]]] for k in known])
        error = 100.0 * (true - coef[known]) / np.abs(coef[known])
        ax.plot(error, at[known], "D", color=style.RED, markerfacecolor="none", markersize=5.0, label="true")
    ax.set_yticks(at, [style.term_label(names[j], names) for j in kept])
    reach = 1.15 * float(np.abs(off).max(initial=1e-6))
    ax.set(xlim=(-reach, reach), ylim=(max(len(kept), 3) - 0.4, -0.6))
    for place, (j, value, spread) in enumerate(zip(kept, coef, sd, strict=True)):
        unit = shortened(style.unit_text(equation.coef_units[j] or ""))
        text = _number(value, spread) + (f" {unit}" if unit not in ("", "1") else "")
        _beside(ax, place, style.plain(text.replace("-", "\N{MINUS SIGN}", 1) if value < 0 else text), fontsize=7)
    ax.set_xlabel("deviation from the estimate [% of it]")
    style.titled(ax, eq, equation.target)
    style.above(ax, handlelength=1.2)
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


@style.picture
def candidate_correlation(eq: style.Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
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
    equation = style.equation_of(eq, target)
    listed = style.likely_terms(equation)
    others = [j for j in np.argsort(-equation.posterior.pip, kind="stable").tolist() if j not in listed]
    listed += others[: max(LEAST_TERMS - len(listed), 0)]
    if not listed:
        raise InputError(f"{equation.target}: there are no candidate terms to compare")
    evaluate = Evaluator(eq.motion(record).columns)
    correlation = _correlation([np.asarray(evaluate(equation.terms[j])) for j in listed])
    names = [term.text for term in equation.terms]
    (ax,) = style.axes_for(ax, [min(max(6.0 * len(listed), 36.0), 62.0) + 18.0], style.SINGLE_COLUMN)
    image = ax.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    ax.figure.colorbar(image, ax=ax, label="correlation", shrink=0.9).outline.set_linewidth(0.5)
    at = np.arange(len(listed))
    labels = [style.term_label(names[j], names) for j in listed]
    ax.set_xticks(at, labels, rotation=90)
    ax.xaxis.tick_top()
    ax.set_yticks(at, labels)
    ax.tick_params(length=0)
    font = 6.5 if len(listed) <= 10 else 4.5
    for (i, k), value in np.ndenumerate(correlation):
        text = "1" if i == k else f"{value:.2f}".replace("0.", ".").replace("-", "\N{MINUS SIGN}")
        colour = "white" if abs(value) > 0.6 else style.BLACK
        ax.text(k, i, text, ha="center", va="center", fontsize=font, color=colour)
    inside = int(equation.shown_posterior.support[listed].sum())
    for edge in (ax.axvline, ax.axhline):
        if 0 < inside < len(listed):
            edge(inside - 0.5, color=style.BLACK, linewidth=0.9)
    return ax


def _correlation(columns: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Correlation of columns; 0 with one that does not vary."""
    D = np.column_stack(np.broadcast_arrays(*columns))
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.corrcoef(D[np.isfinite(D).all(axis=1)], rowvar=False)
    return np.nan_to_num(np.atleast_2d(found))


# Height of the panel of a term, and of legend and labels around all panels [mm].
PANEL, AROUND = 35.0, 30.0

# Verdicts by mark and colour, which differ in lightness too.
MARKS: dict[str, dict[str, Any]] = {
    "found": {"marker": "o", "color": style.BLUE},
    "nearly true": {"marker": "s", "color": style.ORANGE, "markeredgecolor": style.BLACK, "markeredgewidth": 0.4},
    "not determined": {"marker": "o", "color": style.BLUE, "markerfacecolor": "white"},
    "none": {"marker": "x", "color": style.RED},
}

# Maximum number of panels; terms found in most files come first.
MOST = 12

# Names of files below the axis, without folder and suffix: their maximum number, and maximum length.
NAMES, LONGEST = 24, 16


@style.picture
def draw_drift(table: pd.DataFrame) -> Figure:
    """Coefficients of `Batch.table` with 95 % intervals over files, from left to right, a panel for each term.

    Marks are those of the verdict; a grey band is the interval of the common equation. InputError if there are no rows.
    """
    if not len(table):
        raise InputError("no file has an equation: there is nothing to draw; see the messages of the files")
    every = list(dict.fromkeys(zip(table.target, table.term, strict=True)))
    files = table.groupby(["target", "term"]).shown.sum()
    kept = sorted(every, key=lambda one: -files[one])[:MOST]
    panels, rest = [one for one in every if one in kept], [int(files[one]) for one in every if one not in kept]
    figure, axes = style.new_panels(len(panels), height=len(panels) * PANEL + AROUND, sharex=True)
    several = table.target.nunique() > 1
    for ax, (target, term) in zip(axes[:, 0], panels, strict=True):
        rows = table[(table.target == target) & (table.term == term)]
        _panel(ax, rows, f"{target}: " if several else "")
    _files(axes[-1, 0], table)
    handles = style.labelled(axes.flat)
    style.above(axes[0, 0], len(handles), handles=handles, fontsize=8)
    if rest:
        note = f"{len(rest)} more terms, each in at most {max(rest)} of the files, are in the table"
        figure.supxlabel(note, x=0.01, ha="left", fontsize=7)
    return figure


def _panel(ax: Axes, rows: pd.DataFrame, before: str) -> None:
    ax.set_axisbelow(True)
    ax.grid(axis="y", color=style.PALE, linewidth=0.5)
    if "common_coef" in rows:
        common = rows.iloc[0]
        band: dict[str, Any] = {"color": style.PALE, "linewidth": 0, "zorder": 0, "label": "common equation, 95 %"}
        ax.axhspan(common.common_ci_low, common.common_ci_high, **band)
        ax.axhline(common.common_coef, color=style.BLACK, linewidth=0.6, zorder=1)
    drawn = rows[rows.shown]
    look: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.9, "zorder": 2, "label": "95 % interval"}
    ax.vlines(drawn.order, drawn.ci_low, drawn.ci_high, **look)
    size = 3.4 if len(rows) <= 80 else 2.2
    for kind, look in MARKS.items():
        own = drawn[drawn.verdict == kind]
        if len(own):
            ax.plot(own.order, own.coef, linestyle="none", markersize=size, zorder=3, label=kind, **look)
    units = {unit if isinstance(unit, str) else "" for unit in rows.unit}  # pandas makes NaN of None
    unit = "units differ" if len(units) > 1 else style.plain(style.unit_text(units.pop()))
    name = style.term_label(rows.term.iloc[0], tuple(rows.term)) if rows.term.iloc[0] != "1" else "constant"
    ax.set_ylabel(f"{style.plain(before)}{name}" + (f"\n[{unit}]" if unit not in ("", "1") else ""))
    ax.locator_params(axis="y", nbins=5)
    ax.ticklabel_format(axis="y", useOffset=False, scilimits=(-4, 5))


def _files(ax: Axes, table: pd.DataFrame) -> None:
    """Names of files below the lowest panel."""
    names = dict(zip(table.order, table.file, strict=True))
    orders = sorted(names)
    shown = orders[:: -(-len(orders) // NAMES)]
    stems = [PurePath(str(names[order])).stem for order in shown]
    short = [stem if len(stem) <= LONGEST else f"…{stem[1 - LONGEST :]}" for stem in stems]
    ax.set_xticks(shown, [style.plain(stem) for stem in short], rotation=90)
    ax.set_xlim(orders[0] - 0.8, orders[-1] + 0.8)
