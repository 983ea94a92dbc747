"""PIPs against v_s, p_0 or the power of the likelihood, with the terms beside the curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, RED, add_axes, log_ticks, new_figure, styled, term_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["LABELS", "Curve", "draw_pip_curves"]

Floats = NDArray[np.float64]

# What varies, by its column in tables.
LABELS = {
    "slab_variance": "slab variance $v_s$",
    "prior_inclusion": "prior inclusion probability $p_0$",
    "coarsen": "power of the likelihood",
}

# Terms whose PIP stays below this run along the axis and are not drawn.
NOTEWORTHY = 0.05

# Terms that are sometimes included have looks of their own, as long as there are any: markers tell them apart in grey
# print, colours are of the palette of all figures.
GREY, GREEN, PURPLE, SKY = "#6E6E6E", "#009E73", "#CC79A7", "#56B4E9"
COLOURS = [RED, ORANGE, GREEN, PURPLE, SKY, BLACK, RED, ORANGE]
LOOKS = [{"color": colour, "marker": marker} for colour, marker in zip(COLOURS, "os^Dv<>P", strict=True)]

# The names of all others take at most this many lines of this many characters: the legend is then as high as a panel.
LINES, WIDTH = 2, 26

# A row of the figure [mm]: scale, panel, gap, panel, legend.
SCALE, PANEL, BETWEEN, LEGEND = 12.0, 60.0, 6.0, 52.0
ABOVE, HEIGHT, BELOW = 10.0, 46.0, 9.0


class Curve(Protocol):
    """What is drawn in a panel; see `bayeq.equation.pip_curve.PipCurve`."""

    @property
    def axis_name(self) -> str: ...
    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def values(self) -> Floats: ...
    @property
    def pip(self) -> Floats: ...
    @property
    def listed(self) -> NDArray[np.bool_]: ...
    @property
    def current(self) -> int: ...


@styled
def draw_pip_curves(rows: Mapping[str, Sequence[Curve]]) -> Figure:
    """A row per equation: a panel per curve, and what the looks of the curves mean.

    Parameters
    ----------
    rows : mapping of str to sequence of Curve
        From top to bottom, by title (which may be empty): the curves of an equation, as many for each.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width where there are two panels to a row.
    """
    panels = max(len(curves) for curves in rows.values())
    one = ABOVE + HEIGHT + BELOW
    figure = new_figure(SCALE + panels * (PANEL + BETWEEN) - BETWEEN + LEGEND, len(rows) * one)
    for k, (title, curves) in enumerate(rows.items()):
        axes = [
            add_axes(figure, SCALE + i * (PANEL + BETWEEN), k * one + ABOVE, PANEL, HEIGHT) for i in range(len(curves))
        ]
        for ax, curve in zip(axes, curves, strict=True):
            _frame(ax, curve)
            ax.tick_params(axis="y", labelleft=ax is axes[0])
        axes[0].set_ylabel("PIP")
        axes[0].set_title(term_label(title), pad=13)
        _draw(axes, curves)
    return figure


def _frame(ax: Axes, curve: Curve) -> None:
    """Scales, and the value used."""
    x, used = curve.values, float(curve.values[curve.current])
    ax.set_xscale("log")
    margin = (x[-1] / x[0]) ** 0.03 if len(x) > 1 else 2.0
    ax.set_xlim(x[0] / margin, x[-1] * margin)
    ax.set_ylim(-0.03, 1.03)
    log_ticks(ax.xaxis)
    ax.set_xlabel(LABELS[curve.axis_name])
    ax.axhline(0.5, color=BLACK, linestyle=(0, (4, 2)), linewidth=0.6)
    ax.axvline(used, color=BLACK, linestyle=(0, (1, 1.5)), linewidth=0.9)
    above: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "ha": "center", "va": "bottom", "fontsize": 7}
    ax.annotate(f"used: {used:.4g}", (used, 1.02), **above)


def _draw(axes: Sequence[Axes], curves: Sequence[Curve]) -> None:
    """Curves that are always, sometimes and never above 0.5, and the legend."""
    names, used = curves[0].names, curves[0].pip[curves[0].current]
    listed = np.concatenate([curve.listed for curve in curves])
    whole = np.concatenate([curve.pip for curve in curves])
    inside = whole[listed | ~listed.any()] > 0.5
    always, ever = inside.all(axis=0), inside.any(axis=0)
    changing = sorted(np.flatnonzero(ever & ~always).tolist(), key=lambda j: (-used[j], j))
    never = np.flatnonzero(~ever & (whole.max(axis=0) > NOTEWORTHY)).tolist()
    certain, more = np.flatnonzero(always).tolist(), changing[len(LOOKS) :]
    groups: list[tuple[list[int], str, dict[str, Any]]] = [
        (certain, f"always: {_names(certain, names)}", {"color": BLUE, "linewidth": 1.5}),
        *(([j], _names([j], names), look | {"markersize": 2.8}) for j, look in zip(changing, LOOKS, strict=False)),
        (more, f"{len(more)} more", {"color": PALE}),
        (never, f"never: {_names(never, names)}", {"color": GREY, "linewidth": 0.6}),
    ]
    open_mark: dict[str, Any] = {"linestyle": "none", "marker": "o", "markerfacecolor": "white", "markersize": 3.6}
    handles, labels = [], []
    for k, (terms, label, look) in enumerate(group for group in groups if group[0]):
        for ax, curve in zip(axes, curves, strict=True):
            x, pip, crowded = curve.values, curve.pip[:, terms], ~curve.listed
            alone: dict[str, Any] = {"marker": "o", "markersize": 2.8} if len(x) == 1 else {}
            lines = ax.plot(x, pip, zorder=3 - 0.01 * k, **(alone | look))  # the first above the others
            ax.plot(x[crowded], pip[crowded], color=look["color"], **open_mark)
        handles.append(lines[0])
        labels.append(label)
    if not listed.all():
        handles += axes[-1].plot([], [], color=GREY, **open_mark)
        labels.append("too many models to list")
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "borderaxespad": 0.0}
    place |= {"fontsize": 7, "labelspacing": 0.25}
    axes[-1].legend(handles, labels, title="included (PIP > 0.5)", alignment="left", **place)


def _names(terms: Sequence[int], names: Sequence[str]) -> str:
    """Terms separated by commas, as many as a few lines hold."""
    lines: list[list[str]] = [[]]
    for j in terms:
        if lines[-1] and sum(len(term) + 2 for term in lines[-1]) + len(names[j]) > WIDTH:
            if len(lines) == LINES:
                lines[-1].append("…")
                break
            lines.append([])
        lines[-1].append(names[j])
    return ",\n".join(", ".join(term_label(term, names) for term in line) for line in lines)
