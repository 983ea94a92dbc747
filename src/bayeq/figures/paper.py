"""What can be drawn: inclusion probabilities and joint posteriors, as Figs. 4 and 5 of Nayek, Worden and Cross.

Plain arrays in, a matplotlib figure out. Call these inside `bayeq.figures.style.style`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.style import (
    BLACK,
    BLUE,
    FULL_WIDTH,
    ORANGE,
    PALE,
    RED,
    SINGLE_COLUMN,
    add_axes,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Inclusion", "JointPosterior", "draw_inclusion", "draw_joint"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# How VB's mean and the truth are marked.
MEAN: dict[str, Any] = {"color": BLACK, "markersize": 5, "markeredgewidth": 1.1}
TRUTH: dict[str, Any] = {"color": RED, "markerfacecolor": "none", "markersize": 6, "markeredgewidth": 1.3}


@dataclass(frozen=True, slots=True, eq=False)
class Inclusion:
    """A panel of posterior inclusion probabilities.

    Attributes
    ----------
    title : str
        The system.
    terms : tuple of str
        The P candidate terms, as matplotlib sets them; the same in all panels of a figure.
    true : (P,) bool array
        The terms of the true law.
    mcmc, vb : (P,) array
        Inclusion probabilities by MCMC and by VB.
    """

    title: str
    terms: tuple[str, ...]
    true: Bools
    mcmc: Floats
    vb: Floats


@dataclass(frozen=True, slots=True, eq=False)
class JointPosterior:
    """The joint posterior of p coefficients, to be drawn pair by pair.

    Attributes
    ----------
    title : str
        The system.
    labels : tuple of str
        The p axes, as matplotlib sets them.
    names : tuple of str
        The p terms, short, as matplotlib sets them.
    samples : (n, p) array
        Draws of the coefficients by MCMC.
    included : (n, p) bool array
        Which of them are in the draw's model; a pair's cloud is the draws that have both.
    same_model : (n,) bool array
        Whether a draw's model is the one that VB selects.
    truth : (p,) array
        True values.
    vb_mean : (p,) array
        Means by VB.
    vb_included : (p,) bool array
        The coefficients that VB selects.
    ellipses : mapping of (int, int) to (2, k) array
        Outline of VB's confidence region of the coefficients i < j, where it has selected both.
    limits : (p, 2) array
        Ends of the axes.
    """

    title: str
    labels: tuple[str, ...]
    names: tuple[str, ...]
    samples: Floats
    included: Bools
    same_model: Bools
    truth: Floats
    vb_mean: Floats
    vb_included: Bools
    ellipses: Mapping[tuple[int, int], Floats]
    limits: Floats


def draw_inclusion(panels: Sequence[Inclusion], axis_label: str = "candidate term") -> Figure:
    """Inclusion probabilities of all terms by MCMC and VB side by side, a panel per system (Fig. 4).

    Parameters
    ----------
    panels : sequence of Inclusion
        From top to bottom.
    axis_label : str
        Below the terms.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width.
    """
    top, height, gap, below = 11.0, 22.0, 7.5, 14.5
    figure = new_figure(FULL_WIDTH, top + len(panels) * (height + gap) - gap + below)
    first: Axes | None = None
    handles: list[Any] = []
    for k, panel in enumerate(panels):
        ax = add_axes(figure, 13.0, top + k * (height + gap), FULL_WIDTH - 15.0, height, sharex=first)
        first = first or ax
        handles = _bars(ax, panel)
        ax.set_title(f"({chr(97 + k)}) {panel.title}")
        ax.tick_params(axis="x", labelbottom=k == len(panels) - 1)
    ax.set_xticks(np.arange(len(panels[0].terms)), panels[0].terms, rotation=90)
    ax.set_xlim(-0.6, len(panels[0].terms) - 0.4)
    ax.set_xlabel(axis_label)
    figure.legend(handles=handles, loc="upper right", ncols=len(handles), bbox_to_anchor=(1 - 1 / FULL_WIDTH, 1.0))
    return figure


def _bars(ax: Axes, panel: Inclusion) -> list[Any]:
    """A panel of inclusion probabilities; returns what the legend explains."""
    at = np.arange(len(panel.terms))
    band = [ax.axvspan(j - 0.5, j + 0.5, color=PALE, linewidth=0, zorder=0) for j in np.flatnonzero(panel.true)]
    mcmc = ax.bar(at - 0.19, panel.mcmc, 0.38, color=BLUE, edgecolor=BLACK, linewidth=0.4, label="SS-MCMC")
    vb = ax.bar(at + 0.19, panel.vb, 0.38, color=ORANGE, edgecolor=BLACK, linewidth=0.4, hatch="/////", label="SS-VB")
    half = ax.axhline(0.5, color=RED, linestyle=(0, (4, 2)), linewidth=0.8, label="PIP = 0.5", zorder=3)
    for j in np.flatnonzero(panel.true):
        ax.text(float(j), 1.06, panel.terms[j], ha="center", va="bottom", fontsize=8)
    ax.set_ylim(0.0, 1.3)
    ax.set_yticks([0.0, 0.5, 1.0])
    ax.set_ylabel("PIP")
    if band:
        band[0].set_label("true term")
    return [mcmc, vb, half, *band[:1]]


def draw_joint(systems: Sequence[JointPosterior], note: str = "") -> Figure:
    """Pairwise joint posteriors: cloud of MCMC, mean and ellipse of VB, truth; a triangle per system (Fig. 5).

    Parameters
    ----------
    systems : sequence of JointPosterior
        Row by row, two in a row.
    note : str
        Stands above the legend.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width, or of a column's for one system.
    """
    across = min(len(systems), 2)
    rows = -(-len(systems) // across)
    width = FULL_WIDTH if across == 2 else SINGLE_COLUMN
    block_width, block_height = width / across, 90.0
    spare = across == 2 and len(systems) % 2 == 1
    figure = new_figure(width, rows * block_height + (0.0 if spare else 27.0 if across == 2 else 34.0))
    for k, system in enumerate(systems):
        left, top = (k % across) * block_width, (k // across) * block_height
        _triangle(figure, system, f"({chr(97 + k)}) {system.title}", left, top, block_width, block_height)
    if spare:
        where: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (0.5 + 10.0 / width, 0.5 / rows)}
        columns, spacing = 1, 0.9
    else:
        where, columns, spacing = {"loc": "lower center"}, across, 0.5
    legend = figure.legend(
        handles=_joint_legend(), ncols=columns, labelspacing=spacing, columnspacing=1.5, title=note or None, **where
    )
    legend.set_alignment("left")
    return figure


def _triangle(
    figure: Figure, system: JointPosterior, title: str, left: float, top: float, width: float, height: float
) -> None:
    """The pairs of one system: coefficient i across, j > i up, with shared axes."""
    side = len(system.labels) - 1
    before, above, below, gap = 19.5, 7.0, 13.0, 2.0
    w = (width - before - 1.0 - (side - 1) * gap) / side
    h = (height - above - below - (side - 1) * gap) / side
    columns: dict[int, Axes] = {}
    for j in range(1, side + 1):
        row: Axes | None = None
        for i in range(j):
            x, y = left + before + i * (w + gap), top + above + (j - 1) * (h + gap)
            ax = add_axes(figure, x, y, w, h, sharex=columns.get(i), sharey=row)
            columns.setdefault(i, ax)
            row = row or ax
            _pair(ax, system, i, j)
            ax.tick_params(labelbottom=j == side, labelleft=i == 0)
            if j == side:
                ax.set_xlabel(system.labels[i], linespacing=1.3)
            if i == 0:
                ax.set_ylabel(system.labels[j], linespacing=1.3)
                ax.yaxis.set_label_coords(-9.5 / w, 0.5)
            if i == 0 and j == 1:
                ax.set_title(title)


def _pair(ax: Axes, system: JointPosterior, i: int, j: int) -> None:
    """One pair of coefficients."""
    from matplotlib.patheffects import withStroke

    cloud = system.included[:, i] & system.included[:, j]
    for chosen, marker, colour, size, alpha in (
        (cloud & ~system.same_model, "^", ORANGE, 2.0, 0.4),
        (cloud & system.same_model, "o", BLUE, 1.2, 0.08),
    ):
        x, y = system.samples[chosen, i], system.samples[chosen, j]
        ax.plot(x, y, marker, color=colour, markersize=size, markeredgewidth=0, alpha=alpha, rasterized=True)
    # light rims, so that the marks stand out from a dark cloud in grey too
    rim = [withStroke(linewidth=2.4, foreground="white")]
    ax.plot(system.truth[i], system.truth[j], "o", path_effects=rim, zorder=3, **TRUTH)
    if (i, j) in system.ellipses:
        ax.plot(*system.ellipses[i, j], color=BLACK, linewidth=1.0, path_effects=rim)
        ax.plot(system.vb_mean[i], system.vb_mean[j], "x", path_effects=rim, zorder=4, **MEAN)
    else:
        absent = ", ".join(system.names[a] for a in (i, j) if not system.vb_included[a])
        ax.text(
            0.5,
            0.96,
            f"not in SS-VB: {absent}",
            ha="center",
            va="top",
            fontsize=7,
            transform=ax.transAxes,
            path_effects=rim,
        )
    ax.set_xlim(*system.limits[i])
    ax.set_ylim(*system.limits[j])
    ax.set_xticks(_ticks(system.limits[i], 2, 0.15))
    ax.set_yticks(_ticks(system.limits[j], 4, 0.07))
    ax.ticklabel_format(useOffset=False, style="plain")


def _ticks(limits: Floats, intervals: int, margin: float) -> Floats:
    """Round values away from the ends of an axis, so that the numbers of neighbouring panels do not meet."""
    from matplotlib.ticker import MaxNLocator

    room = margin * (limits[1] - limits[0])
    low, high = float(limits[0] + room), float(limits[1] - room)
    ticks = np.asarray(MaxNLocator(intervals).tick_values(low, high))
    return ticks[(ticks >= low) & (ticks <= high)]


def _joint_legend() -> list[Any]:
    from matplotlib.lines import Line2D

    def dots(marker: str, colour: str, size: float, label: str) -> Line2D:
        return Line2D([], [], linestyle="none", marker=marker, color=colour, markersize=size, label=label)

    return [
        dots("o", BLUE, 3.0, "SS-MCMC samples, the model that SS-VB selects"),
        dots("^", ORANGE, 4.0, "SS-MCMC samples, other models"),
        Line2D([], [], linestyle="none", marker="x", label="SS-VB mean", **MEAN),
        Line2D([], [], color=BLACK, linewidth=1.0, label="SS-VB 95 % confidence ellipse"),
        Line2D([], [], linestyle="none", marker="o", label="true values", **TRUTH),
    ]
