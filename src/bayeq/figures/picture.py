"""What all pictures of an answer have in common: axes that are given or made, labels, and thinning."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import wraps
from inspect import signature
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.figures.answer import Answer
from bayeq.figures.style import FULL_WIDTH, SINGLE_COLUMN, add_axes, new_figure, require_matplotlib, style, term_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "GREY",
    "above",
    "bracketed",
    "frequency_label",
    "label_of",
    "one_axes",
    "picture",
    "plain",
    "thinned",
    "time_label",
    "titled",
    "two_axes",
    "unit_text",
]

P = ParamSpec("P")
T = TypeVar("T")
Floats = NDArray[np.float64]

# Measured samples, where many lie upon each other.
GREY = "#8A8A8A"

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# More points than this are drawn as every second, third ... of them.
MOST_POINTS = 4000


def picture(draw: Callable[P, T]) -> Callable[P, T]:
    """A function that draws on its argument ``ax``, made to draw in the style of all figures where it has none."""
    arguments = signature(draw)

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        require_matplotlib()
        if arguments.bind(*args, **kwargs).arguments.get("ax") is not None:
            return draw(*args, **kwargs)
        with style():
            made = draw(*args, **kwargs)
            figure = np.ravel(np.array(made, dtype=object))[0].figure
            figure.draw_without_rendering()  # ticks are made on drawing, by the settings of that moment
        return made

    return drawn


def one_axes(ax: Any, left: float = 15.0, height: float = 52.0, right: float = 4.0, above: float = 8.0) -> Axes:
    """The axes that are given, or those of a new figure of a column's width; margins and height in mm.

    Raises
    ------
    InputError
        Not one matplotlib axes.
    """
    if ax is not None:
        if not hasattr(ax, "plot"):
            raise InputError(f"ax: one matplotlib axes is needed, got {type(ax).__name__}")
        return ax
    figure = new_figure(SINGLE_COLUMN, above + height + 10.0)
    return add_axes(figure, left, above, SINGLE_COLUMN - left - right, height)


def two_axes(ax: Any, upper: float = 42.0, lower: float = 20.0) -> tuple[Axes, Axes]:
    """The two axes that are given, or those of a new figure of a page's width, one above the other; heights in mm.

    Raises
    ------
    InputError
        Not two matplotlib axes.
    """
    if ax is not None:
        axes = list(np.ravel(np.asarray(ax, dtype=object)))
        if len(axes) != 2 or not all(hasattr(one, "plot") for one in axes):
            raise InputError(f"ax: two matplotlib axes are needed, one above the other, got {len(axes)}")
        return axes[0], axes[1]
    left, top, gap = 18.0, 9.0, 3.0
    figure = new_figure(FULL_WIDTH, top + upper + gap + lower + 10.0)
    width = FULL_WIDTH - left - 4.0
    first = add_axes(figure, left, top, width, upper)
    second = add_axes(figure, left, top + upper + gap, width, lower, sharex=first)
    first.tick_params(axis="x", labelbottom=False)
    return first, second


def plain(text: str) -> str:
    """Text that matplotlib sets as it stands."""
    return text.replace("$", r"\$")


def unit_text(unit: str) -> str:
    """A unit with its powers raised.

    >>> unit_text("m/s^2"), unit_text("1/m^2/s^2")
    ('m/s²', '1/m²/s²')
    """
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(RAISED), unit)


def bracketed(unit: str) -> str:
    """A unit to be divided or raised: in brackets unless it is a single one.

    >>> bracketed("mm"), bracketed("m/s")
    ('mm', '(m/s)')
    """
    return unit if unit.isalpha() else f"({unit_text(unit)})"


def label_of(name: str, units: Mapping[str, str], what: str = "") -> str:
    """Label of an axis: what is shown of a channel, and its unit where that is known."""
    unit = units.get(name, "")
    return plain(f"{what} {name}".strip() + (f" [{unit_text(unit)}]" if unit else ""))


def time_label(eq: Answer) -> str:
    """Label of an axis of time, which is counted in rows where it is not known."""
    return "row" if eq.data.rows_as_time else "time [s]"


def frequency_label(eq: Answer) -> str:
    """Label of an axis of frequency."""
    return "frequency [1/row]" if eq.data.rows_as_time else "frequency [Hz]"


def titled(ax: Axes, eq: Answer, target: str) -> None:
    """The target as title, where there are several equations."""
    if len(eq.equations) > 1:
        ax.set_title(term_label(target))


def thinned(n: int, most: int = MOST_POINTS) -> slice:
    """Rows to be drawn of n."""
    return slice(None, None, -(-n // most) or None)


def above(ax: Axes, columns: int = 4, **options: Any) -> None:
    """The legend in a line above the axes, at its right end."""
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
    ax.legend(ncols=columns, handlelength=1.8, columnspacing=1.2, fontsize=7, **place, **options)
