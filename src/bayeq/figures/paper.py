"""What can be drawn: inclusion probabilities and joint posteriors, as Figs. 4 and 5 of Nayek, Worden and Cross.

Plain arrays in, a matplotlib figure out. Call these inside `bayeq.figures.style.style`.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Height of the triangle of a system [mm].
BLOCK = 90.0

# How VB's mean and the truth are marked.
MEAN: dict[str, Any] = {"color": style.BLACK, "markersize": 5, "markeredgewidth": 1.1}
TRUTH: dict[str, Any] = {"color": style.RED, "markerfacecolor": "none", "markersize": 6, "markeredgewidth": 1.3}


@dataclass(frozen=True, slots=True, eq=False)
class Inclusion:
    """A panel of posterior inclusion probabilities of P candidate terms, the same in all panels of a figure."""

    title: str  # the system
    terms: tuple[str, ...]  # P, as matplotlib sets them
    true: Bools  # (P,), the terms of the true law
    mcmc: Floats  # (P,), probabilities by MCMC
    vb: Floats  # (P,), probabilities by VB


@dataclass(frozen=True, slots=True, eq=False)
class JointPosterior:
    """The joint posterior of p coefficients, of n draws, to be drawn pair by pair."""

    title: str  # the system
    labels: tuple[str, ...]  # p, of the axes, as matplotlib sets them
    names: tuple[str, ...]  # p, the terms, short
    samples: Floats  # (n, p), draws of the coefficients by MCMC
    included: Bools  # (n, p), which of them are in the draw's model; a pair's cloud is the draws that have both
    same_model: Bools  # (n,), whether a draw's model is the one that VB selects
    truth: Floats  # (p,)
    vb_mean: Floats  # (p,)
    vb_included: Bools  # (p,), the coefficients that VB selects
    ellipses: Mapping[tuple[int, int], Floats]  # (2, k), VB's confidence region of coefficients i < j that it selects
    limits: Floats  # (p, 2), ends of the axes


def draw_inclusion(panels: Sequence[Inclusion], axis_label: str = "candidate term") -> Figure:
    """Inclusion probabilities of all terms by MCMC and VB under each other, a panel per system (Fig. 4).

    Panels stand from left to right, `axis_label` beside the terms; the figure is as wide as a journal's page.
    """
    terms = panels[-1].terms
    figure, axes = style.new_panels(1, len(panels), height=26.0 + 3.7 * len(terms), sharey=True)
    for k, (ax, panel) in enumerate(zip(axes[0], panels, strict=True)):
        explained = _bars(ax, panel)
        ax.set_title(textwrap.fill(f"({chr(97 + k)}) {panel.title}", 24))
    axes[0, 0].set_yticks(np.arange(len(terms)), terms)
    axes[0, 0].set_ylim(len(terms) - 0.4, -0.6)
    axes[0, 0].set_ylabel(axis_label)
    figure.legend(handles=explained, loc="outside upper right", ncols=4)
    return figure


def _bars(ax: Axes, panel: Inclusion) -> list[Any]:
    """A panel of inclusion probabilities; returns what the legend explains."""
    at = np.arange(len(panel.terms))
    look: dict[str, Any] = {"edgecolor": style.BLACK, "linewidth": 0.4}
    true = [ax.axhspan(j - 0.5, j + 0.5, color=style.PALE, linewidth=0, zorder=0) for j in np.flatnonzero(panel.true)]
    mcmc = ax.barh(at - 0.19, panel.mcmc, 0.38, color=style.BLUE, label="SS-MCMC", **look)
    vb = ax.barh(at + 0.19, panel.vb, 0.38, color=style.ORANGE, hatch="/////", label="SS-VB", **look)
    half = ax.axvline(0.5, color=style.RED, linestyle=style.DASHED, linewidth=0.8, label="PIP = 0.5", zorder=3)
    ax.set_xlim(0.0, 1.05)
    ax.set_xticks([0.0, 0.5, 1.0])
    ax.set_xlabel("PIP")
    if true:
        true[0].set_label("true term")
    return [mcmc, vb, half, *true[:1]]


def draw_joint(systems: Sequence[JointPosterior], note: str = "") -> Figure:
    """Pairwise joint posteriors: cloud of MCMC, mean and ellipse of VB, truth; a triangle per system (Fig. 5).

    Systems stand row by row, two in a row, and the note above the legend. The figure is as wide as a journal's page, or
    as a column of it for one system.
    """
    from matplotlib.lines import Line2D

    across = min(len(systems), 2)
    rows = -(-len(systems) // across)
    spare = across == 2 and len(systems) % 2 == 1  # a place for the legend
    below = 0.0 if spare else 27.0 if across == 2 else 34.0
    width = style.FULL_WIDTH if across == 2 else style.SINGLE_COLUMN
    figure = style.new_figure(width, rows * BLOCK + below, layout="constrained")
    blocks = figure.subfigures(rows, across, squeeze=False).flat
    for k, (block, system) in enumerate(zip(blocks, systems, strict=False)):
        _triangle(block, system, f"({chr(97 + k)}) {system.title}")
    where: dict[str, Any] = {"loc": "outside lower center", "ncols": across, "labelspacing": 0.5}
    if spare:
        where = {"loc": "center left", "bbox_to_anchor": (0.5 + 10.0 / width, 0.5 / rows), "labelspacing": 0.9}
    samples = {"linestyle": "none", "color": style.BLUE, "marker": "o", "markersize": 3.0}
    looks: dict[str, dict[str, Any]] = {
        "SS-MCMC samples, the model that SS-VB selects": samples,
        "SS-MCMC samples, other models": samples | {"color": style.ORANGE, "marker": "^", "markersize": 4.0},
        "SS-VB mean": {"linestyle": "none", "marker": "x", **MEAN},
        "SS-VB 95 % confidence ellipse": {"color": style.BLACK, "linewidth": 1.0},
        "true values": {"linestyle": "none", "marker": "o", **TRUTH},
    }
    handles = [Line2D([], [], label=label, **look) for label, look in looks.items()]
    legend = figure.legend(handles=handles, columnspacing=1.5, title=note or None, **where)
    legend.set_alignment("left")
    return figure


def _triangle(block: Any, system: JointPosterior, title: str) -> None:
    """The pairs of one system: coefficient i across, j > i up, with shared axes."""
    side = len(system.labels) - 1
    axes = block.subplots(side, side, squeeze=False, sharex="col", sharey="row")
    for j, i in np.ndindex(side, side):
        ax = axes[j, i]
        if i > j:
            ax.remove()
            continue
        _pair(ax, system, i, j + 1)
        if j == side - 1:
            ax.set_xlabel(system.labels[i], linespacing=1.3)
        if i == 0:
            ax.set_ylabel(system.labels[j + 1], linespacing=1.3)
    block.align_ylabels(axes[:, 0])
    axes[0, 0].set_title(title).set_in_layout(False)  # it may be longer than its panel is wide


def _pair(ax: Axes, system: JointPosterior, i: int, j: int) -> None:
    """One pair of coefficients."""
    from matplotlib.patheffects import withStroke

    cloud = system.included[:, i] & system.included[:, j]
    for chosen, marker, colour, size, alpha in (
        (cloud & ~system.same_model, "^", style.ORANGE, 2.0, 0.4),
        (cloud & system.same_model, "o", style.BLUE, 1.2, 0.08),
    ):
        x, y = system.samples[chosen, i], system.samples[chosen, j]
        ax.plot(x, y, marker, color=colour, markersize=size, markeredgewidth=0, alpha=alpha, rasterized=True)
    # light rims, so that the marks stand out from a dark cloud in grey too
    rim = [withStroke(linewidth=2.4, foreground="white")]
    ax.plot(system.truth[i], system.truth[j], "o", path_effects=rim, zorder=3, **TRUTH)
    if (i, j) in system.ellipses:
        ax.plot(*system.ellipses[i, j], color=style.BLACK, linewidth=1.0, path_effects=rim)
        ax.plot(system.vb_mean[i], system.vb_mean[j], "x", path_effects=rim, zorder=4, **MEAN)
    else:
        absent = ", ".join(system.names[a] for a in (i, j) if not system.vb_included[a])
        place: dict[str, Any] = {"ha": "center", "va": "top", "transform": ax.transAxes}
        ax.text(0.5, 0.96, f"not in SS-VB: {absent}", fontsize=7, path_effects=rim, **place)
    ax.set_xlim(*system.limits[i])
    ax.set_ylim(*system.limits[j])
    ax.set_xticks(_ticks(system.limits[i], 2, 0.15))
    ax.set_yticks(_ticks(system.limits[j], 4, 0.07))
    ax.ticklabel_format(useOffset=False, style="plain")
    ax.tick_params(labelsize=6.0)


def _ticks(limits: Floats, intervals: int, margin: float) -> Floats:
    """Round values away from the ends of an axis, so that the numbers of neighbouring panels do not meet."""
    from matplotlib.ticker import MaxNLocator

    room = margin * (limits[1] - limits[0])
    low, high = float(limits[0] + room), float(limits[1] - room)
    ticks = np.asarray(MaxNLocator(intervals).tick_values(low, high))
    return ticks[(ticks >= low) & (ticks <= high)]
