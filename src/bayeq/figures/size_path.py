"""The elbow: evidence and errors of the best model of each size, with the terms that each size adds.

Plain arrays in, a matplotlib figure out. Call `draw_paths` inside `bayeq.figures.style.style`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import BayeqError
from bayeq.figures.style import BLACK, BLUE, FULL_WIDTH, MM_PER_INCH, ORANGE, PALE, RED, add_axes, mathtext, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Elbow", "draw_paths"]

Floats = NDArray[np.float64]
Step = tuple[tuple[str, ...], tuple[str, ...]]

# A row of the figure [mm]: its title, two panels side by side, and below them the terms that each size adds, written
# upwards, so much for each character.
LEFT, PANEL, BETWEEN, ABOVE, HEIGHT, BELOW = 15.0, 78.0, 17.0, 8.0, 46.0, 11.0
CHARACTER = 1.25
POINTS_PER_MM = 72.0 / MM_PER_INCH
LEGEND = 5.0

# Terms of so many characters are cut, and so many per size are named.
LONGEST = 24
NAMED = 3
SIGNS = "+\N{MINUS SIGN}"

# Evidence is drawn as it is down to so many nats below the best, and by its logarithm beyond.
LINEAR = 10.0

# A training error below this share of the largest would squeeze all others.
LEAST_ERROR = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Elbow:
    """A parsimony path, to be drawn.

    Attributes
    ----------
    title : str
        The equation; may be empty.
    size : (K,) int array
        Number of terms.
    steps : K pairs of tuples of str
        Terms added and removed against the size before.
    symbols : tuple of str
        Names in the order in which factors of a term are to stand.
    log_evidence : (K,) array
        Log evidence of the best model of each size.
    error, held_out : (K,) array, (K,) array or None
        Normalised RMS errors on the training rows and on those held out.
    chosen : (int, float, float, float or None)
        Size, log evidence and the two errors of the chosen equation.
    """

    title: str
    size: NDArray[np.int64]
    steps: tuple[Step, ...]
    symbols: tuple[str, ...]
    log_evidence: Floats
    error: Floats
    held_out: Floats | None
    chosen: tuple[int, float, float, float | None]


def draw_paths(rows: Sequence[Elbow]) -> Figure:
    """Evidence (left) and errors (right) against the number of terms, a row per equation.

    Parameters
    ----------
    rows : sequence of Elbow
        From top to bottom.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width.
    """
    below = [BELOW + CHARACTER * max(_length(step) for step in row.steps) for row in rows]
    figure = new_figure(FULL_WIDTH, LEGEND + len(rows) * (ABOVE + HEIGHT) + sum(below))
    for k, row in enumerate(rows):
        top = LEGEND + k * (ABOVE + HEIGHT) + sum(below[:k]) + ABOVE
        left = add_axes(figure, LEFT, top, PANEL, HEIGHT)
        right = add_axes(figure, LEFT + PANEL + BETWEEN, top, PANEL, HEIGHT)
        _evidence(left, row)
        _errors(right, row)
        for ax in (left, right):
            _sizes(ax, row, below[k])
        if row.title:
            left.set_title(_label(row.title))
    figure.legend(handles=_legend(rows), loc="upper right", ncols=4, columnspacing=1.6, handlelength=2.2)
    return figure


def _evidence(ax: Axes, row: Elbow) -> None:
    best = float(row.log_evidence.max())
    ax.plot(row.size, row.log_evidence - best, color=BLACK, marker="s", markersize=3.0)
    size, evidence, _, _ = row.chosen
    _mark(ax, size, [evidence - best])
    ax.set_yscale("symlog", linthresh=LINEAR, linscale=1.0)
    low = min(float(row.log_evidence.min()), evidence) - best
    ax.set_ylim(1.6 * low if low < -LINEAR else -1.1 * LINEAR, 0.15 * LINEAR)
    decades = range(1, int(np.log10(max(-low, LINEAR))) + 1)
    ticks = [*(-float(10**k) for k in reversed(decades)), -0.5 * LINEAR, 0.0]
    ax.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks([], minor=True)
    ax.axhspan(-LINEAR, ax.get_ylim()[1], color=PALE, alpha=0.5, linewidth=0, zorder=0)
    ax.set_ylabel("log evidence below the best [nats]")


def _errors(ax: Axes, row: Elbow) -> None:
    # less is rounding
    least = LEAST_ERROR * max(float(row.error.max()), LEAST_ERROR)
    ax.plot(row.size, np.maximum(row.error, least), color=BLUE, marker="o", markersize=3.0)
    if row.held_out is not None:
        look: dict[str, Any] = {"markersize": 3.4, "markerfacecolor": "white", "linestyle": (0, (4, 1.5))}
        ax.plot(row.size, np.maximum(row.held_out, least), color=ORANGE, marker="D", **look)
    size, _, error, held_out = row.chosen
    _mark(ax, size, [max(value, least) for value in (error, held_out) if value is not None])
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    if high < 10.0 * low:  # room for at least a few labelled ticks
        middle = np.sqrt(low * high)
        ax.set_ylim(middle / np.sqrt(10.0), middle * np.sqrt(10.0))
    _percent_ticks(ax)
    ax.set_ylabel("RMS error / sd of the target")


def _percent_ticks(ax: Axes) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = ax.get_ylim()
    wide = high > 300.0 * low
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0), numticks=20))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100.0 * value:g} %"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _mark(ax: Axes, size: int, values: Sequence[float]) -> None:
    """A line at the size of the chosen equation and rings about its values."""
    ax.axvline(size, color=RED, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
    ring: dict[str, Any] = {"markersize": 7.5, "markerfacecolor": "none", "markeredgewidth": 1.2}
    ax.plot([size] * len(values), values, "o", color=RED, zorder=4, **ring)


def _sizes(ax: Axes, row: Elbow, below: float) -> None:
    """Number of terms, and below each what changes against the one before."""
    ax.set_xlim(row.size[0] - 0.5, row.size[-1] + 0.5)
    ax.set_xticks(row.size)
    for size, step in zip(row.size, row.steps, strict=True):
        ax.annotate(
            _change(step, row.symbols),
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


def _change(step: Step, order: tuple[str, ...]) -> str:
    """Terms added and removed, in a line."""
    parts = []
    for sign, names in zip(SIGNS, step, strict=True):
        parts += [sign + _label(name, order) for name in names[:NAMED]]
        parts += [f"{sign}…"] * (len(names) > NAMED)
    return " ".join(parts)


def _length(step: Step) -> int:
    """About the number of characters of a change as it is set, where a product has no sign and a power is raised."""
    shown = [name[:LONGEST].replace("*", "").replace("abs(", "|") for names in step for name in names[:NAMED]]
    return sum(2 + len(name) for name in shown) + 3 * sum(len(names) > NAMED for names in step)


def _label(term: str, order: tuple[str, ...] = ()) -> str:
    """A term as matplotlib sets it; as it stands where it is no expression, cut short if long."""
    if len(term) > LONGEST:
        return (term[: LONGEST - 1] + "…").replace("$", r"\$")
    try:
        return mathtext(term, order)
    except BayeqError:
        return term.replace("$", r"\$")


def _legend(rows: Sequence[Elbow]) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLACK, marker="s", markersize=3.0, label="log evidence"),
        Line2D([], [], color=BLUE, marker="o", markersize=3.0, label="training rows"),
    ]
    if any(row.held_out is not None for row in rows):
        look: dict[str, Any] = {"markersize": 3.4, "markerfacecolor": "white", "linestyle": (0, (4, 1.5))}
        handles.append(Line2D([], [], color=ORANGE, marker="D", label="held-out rows", **look))
    ring: dict[str, Any] = {"markersize": 7.5, "markerfacecolor": "none", "linestyle": "none", "marker": "o"}
    handles.append(Line2D([], [], color=RED, label="the equation", **ring))
    return handles
