"""Free runs: each state with its band and what was measured. Plain arrays in, a matplotlib figure out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.style import BLACK, BLUE, FULL_WIDTH, RED, add_axes, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Panel", "Strip", "draw_forecasts", "draw_panel", "forecast_legend"]

Floats = NDArray[np.float64]

# A panel and what is around it [mm].
LEFT, WIDTH, HEIGHT, GAP, LEGEND, BELOW, TITLE = 20.0, 166.0, 34.0, 4.0, 7.0, 10.0, 6.0

# More rows than the page has places are drawn as every second, third ... of them.
MOST_POINTS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One state.

    Attributes
    ----------
    label : str
        Of the vertical axis.
    mean : (n,) array
        The run; NaN where it has blown up.
    low, high : (n,) array or None
        The band.
    measured : (n,) array or None
        Samples.
    """

    label: str
    mean: Floats
    low: Floats | None
    high: Floats | None
    measured: Floats | None


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """A free run.

    Attributes
    ----------
    title : str
        Above its panels; may be empty.
    time : (n,) array
        [s].
    panels : sequence of Panel
        From top to bottom.
    blew_up_at : float or None
        Time of a vertical line.
    """

    title: str
    time: Floats
    panels: Sequence[Panel]
    blew_up_at: float | None


def draw_forecasts(strips: Sequence[Strip]) -> Figure:
    """Free runs under each other; call it inside `bayeq.figures.style.style`."""
    heights = [len(strip.panels) * (HEIGHT + GAP) - GAP + BELOW for strip in strips]
    above = [TITLE if strip.title else 0.0 for strip in strips]
    figure = new_figure(FULL_WIDTH, LEGEND + sum(heights) + sum(above))
    top = LEGEND
    for strip, height, title in zip(strips, heights, above, strict=True):
        _draw(figure, strip, top + title)
        top += title + height
    figure.legend(handles=forecast_legend(strips), loc="upper center", ncols=4, handlelength=2.2)
    return figure


def _draw(figure: Figure, strip: Strip, top: float) -> None:
    for k, panel in enumerate(strip.panels):
        ax = add_axes(figure, LEFT, top + k * (HEIGHT + GAP), WIDTH, HEIGHT)
        draw_panel(ax, strip, panel)
        if k == 0 and strip.title:
            ax.set_title(strip.title.replace("$", r"\$"))
        if k < len(strip.panels) - 1:
            ax.tick_params(axis="x", labelbottom=False)
        else:
            ax.set_xlabel("time [s]")


def draw_panel(ax: Axes, strip: Strip, panel: Panel) -> None:
    """One state of a free run: what was measured, the run, its band, and where it blew up."""
    every = slice(None, None, -(-len(strip.time) // MOST_POINTS))
    t = strip.time[every]
    shown = [panel.mean[every]]
    if panel.measured is not None:
        shown.append(panel.measured[every])
        ax.plot(t, shown[-1], color=BLACK, linewidth=0.5)
    low, high = _limits(shown)
    if panel.low is not None and panel.high is not None:
        # what lies outside the panel, or nowhere, is drawn to its edge
        room = 10.0 * (high - low)
        bottom, upper = (np.clip(edge[every], low - room, high + room) for edge in (panel.low, panel.high))
        ax.fill_between(t, bottom, upper, color=BLUE, alpha=0.25, linewidth=0.0)
    ax.plot(t, shown[0], color=BLUE, linewidth=0.8)
    if strip.blew_up_at is not None:
        ax.axvline(strip.blew_up_at, color=RED, linestyle=(0, (4, 2)), linewidth=0.8)
    ax.set_xlim(float(strip.time[0]), float(strip.time[-1]))
    ax.set_ylim(low, high)
    ax.set_ylabel(panel.label.replace("$", r"\$"))


def _limits(curves: Sequence[Floats]) -> tuple[float, float]:
    """Limits of a panel: those of what was measured where there is any, for a run may go far away."""
    values = curves[-1][np.isfinite(curves[-1])]
    low, high = (float(values.min()), float(values.max())) if len(values) else (-1.0, 1.0)
    margin = 0.2 * (high - low) or max(abs(low), 1.0)
    return low - margin, high + margin


def forecast_legend(strips: Sequence[Strip]) -> list[Any]:
    """What the looks of lines and bands mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    panels = [panel for strip in strips for panel in strip.panels]
    handles: list[Any] = [Line2D([], [], color=BLUE, linewidth=0.8, label="free run")]
    if any(panel.low is not None for panel in panels):
        handles.append(Patch(facecolor=BLUE, alpha=0.25, label="95 % of the posterior's runs"))
    if any(panel.measured is not None for panel in panels):
        handles.append(Line2D([], [], color=BLACK, linewidth=0.5, label="measured"))
    if any(strip.blew_up_at is not None for strip in strips):
        handles.append(Line2D([], [], color=RED, linestyle=(0, (4, 2)), linewidth=0.8, label="blew up"))
    return handles
