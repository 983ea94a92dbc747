"""The size path: evidence and errors of the best model of each size, with the terms that each size adds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.style import (
    BLACK,
    BLUE,
    FULL_WIDTH,
    MM_PER_INCH,
    ORANGE,
    PALE,
    RED,
    add_axes,
    log_ticks,
    new_figure,
    styled,
    term_label,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Path", "draw_paths"]

Floats = NDArray[np.float64]
Step = tuple[tuple[str, ...], tuple[str, ...]]

# A row of the figure [mm]: its title, two panels side by side, and below them the terms that each size adds, written
# upwards, CHARACTER mm for each character.
LEFT, PANEL, BETWEEN, ABOVE, HEIGHT, BELOW = 15.0, 78.0, 17.0, 8.0, 46.0, 11.0
CHARACTER = 1.25
POINTS_PER_MM = 72.0 / MM_PER_INCH
LEGEND = 5.0

# Longer terms are shortened, and only the first few of a step are named, or the page would be mostly names.
LONGEST = 24
NAMED = 3
SIGNS = "+\N{MINUS SIGN}"

# Log evidence is drawn on a linear scale down to this many nats below the best, odds of 1 to 22,000, and on a
# logarithmic one beyond, where only its order of magnitude matters.
LINEAR = 10.0

# A training error below this share of the largest, of a record without noise, would squeeze all others.
LEAST_ERROR = 1e-6

HELD_OUT: dict[str, Any] = {"color": ORANGE, "marker": "D", "markersize": 3.4, "markerfacecolor": "white"}
RING: dict[str, Any] = {"color": RED, "marker": "o", "markersize": 7.5, "markerfacecolor": "none", "linestyle": "none"}


class Path(Protocol):
    """What is drawn in a row; see `bayeq.equation.size_path.ParsimonyPath`."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def size(self) -> NDArray[np.int64]: ...
    @property
    def steps(self) -> Sequence[Step]: ...
    @property
    def log_evidence(self) -> Floats: ...
    @property
    def r2(self) -> Floats: ...
    @property
    def held_out_r2(self) -> Floats: ...
    @property
    def chosen(self) -> NDArray[np.bool_]: ...
    @property
    def chosen_log_evidence(self) -> float: ...
    @property
    def chosen_r2(self) -> float: ...
    @property
    def chosen_held_out_r2(self) -> float: ...


@styled
def draw_paths(rows: Mapping[str, Path]) -> Figure:
    """Evidence (left) and errors (right) against the number of terms, a row per equation.

    Parameters
    ----------
    rows : mapping of str to Path
        From top to bottom, by title, which may be empty.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width.
    """
    below = [BELOW + CHARACTER * max(_length(step) for step in path.steps) for path in rows.values()]
    figure = new_figure(FULL_WIDTH, LEGEND + len(rows) * (ABOVE + HEIGHT) + sum(below))
    for k, (title, path) in enumerate(rows.items()):
        top = LEGEND + k * (ABOVE + HEIGHT) + sum(below[:k]) + ABOVE
        left = add_axes(figure, LEFT, top, PANEL, HEIGHT)
        right = add_axes(figure, LEFT + PANEL + BETWEEN, top, PANEL, HEIGHT)
        _evidence(left, path)
        _errors(right, path)
        for ax in (left, right):
            _sizes(ax, path, below[k])
        left.set_title(term_label(title, longest=LONGEST))
    handles = _legend(any(np.isfinite(path.held_out_r2).any() for path in rows.values()))
    figure.legend(handles=handles, loc="upper right", ncols=4, columnspacing=1.6, handlelength=2.2)
    return figure


def _evidence(ax: Axes, path: Path) -> None:
    best = float(path.log_evidence.max())
    ax.plot(path.size, path.log_evidence - best, color=BLACK, marker="s", markersize=3.0)
    _mark(ax, path, [path.chosen_log_evidence - best])
    ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.0)
    low = min(float(path.log_evidence.min()), path.chosen_log_evidence) - best
    ax.set_ylim(1.6 * low if low < -LINEAR else -1.1 * LINEAR, 0.15 * LINEAR)
    decades = range(1, int(np.log10(max(-low, LINEAR))) + 1)
    ticks = [*(-float(10**k) for k in reversed(decades)), -0.5 * LINEAR, 0.0]
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    ax.axhspan(-LINEAR, ax.get_ylim()[1], color=PALE, alpha=0.5, linewidth=0, zorder=0)
    ax.set_ylabel("log evidence below the best [nats]")


def _errors(ax: Axes, path: Path) -> None:
    error, held_out = np.sqrt(1.0 - path.r2), np.sqrt(1.0 - path.held_out_r2)
    # less is rounding
    least = LEAST_ERROR * max(float(error.max()), LEAST_ERROR)
    ax.plot(path.size, np.maximum(error, least), color=BLUE, marker="o", markersize=3.0)
    ax.plot(path.size, np.maximum(held_out, least), linestyle=(0, (4, 1.5)), **HELD_OUT)
    _mark(ax, path, np.maximum(np.sqrt([1.0 - path.chosen_r2, 1.0 - path.chosen_held_out_r2]), least))
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    if high < 10.0 * low:  # room for at least a few labelled ticks
        middle = np.sqrt(low * high)
        ax.set_ylim(middle / np.sqrt(10.0), middle * np.sqrt(10.0))
    log_ticks(ax.yaxis, lambda value: f"{100.0 * value:g} %")
    ax.set_ylabel("RMS error / sd of the target")


def _mark(ax: Axes, path: Path, values: Sequence[float] | Floats) -> None:
    """A line at the size of the chosen equation and rings about its values."""
    size = int(path.chosen.sum())
    ax.axvline(size, color=RED, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
    ax.plot([size] * len(values), values, zorder=4, markeredgewidth=1.2, **RING)


def _sizes(ax: Axes, path: Path, below: float) -> None:
    """Number of terms, and below each what changes against the one before."""
    ax.set_xlim(path.size[0] - 0.5, path.size[-1] + 0.5)
    ax.set_xticks(path.size)
    for size, step in zip(path.size, path.steps, strict=True):
        ax.annotate(
            _change(step, path.names),
            xy=(float(size), 0.0),
            xycoords=ax.get_xaxis_transform(),
            xytext=(0, -13),
            textcoords="offset points",
            rotation=90,
            ha="center",
            va="top",
            fontsize=7,
        )
    ax.set_xlabel("number of terms, and what changes with each", labelpad=(below - BELOW) * POINTS_PER_MM)


def _change(step: Step, dictionary: Sequence[str]) -> str:
    """Terms added and removed, in a line."""
    parts = []
    for sign, names in zip(SIGNS, step, strict=True):
        parts += [sign + term_label(name, dictionary, LONGEST) for name in names[:NAMED]]
        parts += [f"{sign}…"] * (len(names) > NAMED)
    return " ".join(parts)


def _length(step: Step) -> int:
    """About the number of characters of a change as it is set, where a product has no sign and a power is raised."""
    shown = [name[:LONGEST].replace("*", "").replace("abs(", "|") for names in step for name in names[:NAMED]]
    return sum(2 + len(name) for name in shown) + 3 * sum(len(names) > NAMED for names in step)


def _legend(held_out: bool) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLACK, marker="s", markersize=3.0, label="log evidence"),
        Line2D([], [], color=BLUE, marker="o", markersize=3.0, label="training rows"),
    ]
    if held_out:
        handles.append(Line2D([], [], linestyle=(0, (4, 1.5)), label="held-out rows", **HELD_OUT))
    return [*handles, Line2D([], [], label="the equation", **RING)]
