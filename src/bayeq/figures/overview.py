"""A quick look at an answer: inclusion probabilities and coefficients, or free runs. Axes are given or made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import InputError
from bayeq.figures.forecast import Strip, draw_panel, forecast_legend
from bayeq.figures.style import BLACK, BLUE, MM_PER_INCH, PALE, require_matplotlib, term_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["PANEL", "TermBar", "chosen_axes", "draw_run", "draw_terms", "terms_height"]

# Width of the figure, height of a bar and of what is around the bars, height of a state's panel [mm].
WIDTH, BAR, AROUND, PANEL = 160.0, 6.0, 20.0, 40.0


@dataclass(frozen=True, slots=True)
class TermBar:
    """A candidate term.

    Attributes
    ----------
    term : str
        Its name.
    pip : float
        Posterior inclusion probability, 0 to 1.
    coefficient : str
        Coefficient and interval as text; empty for a term that is not shown.
    """

    term: str
    pip: float
    coefficient: str


def chosen_axes(given: Any, heights: Sequence[float]) -> list[Axes]:
    """The axes that are given, or those of a new pyplot figure, one for each height [mm].

    Raises
    ------
    InputError
        Another number of axes than is needed.
    MissingExtraError
        matplotlib is not installed.
    """
    require_matplotlib()
    if given is None:
        from matplotlib import pyplot

        size = (WIDTH / MM_PER_INCH, sum(heights) / MM_PER_INCH)
        ratios: dict[str, Any] = {"height_ratios": list(heights)}
        _, made = pyplot.subplots(len(heights), figsize=size, squeeze=False, gridspec_kw=ratios, layout="constrained")
        return list(made[:, 0])
    axes = list(np.ravel(np.asarray(given, dtype=object)))
    if len(axes) != len(heights) or not all(hasattr(ax, "barh") for ax in axes):
        raise InputError(f"ax: {len(heights)} matplotlib axes are needed, one for each panel, got {len(axes)}")
    return axes


def terms_height(bars: Sequence[TermBar]) -> float:
    """Height of a panel of terms [mm]."""
    return AROUND + BAR * max(len(bars), 1)


def draw_terms(ax: Axes, target: str, bars: Sequence[TermBar], score: str) -> None:
    """A bar for each term, as long as its probability; coefficients and intervals to the right."""
    names = [bar.term for bar in bars]
    places = np.arange(len(bars))
    colours = [BLUE if bar.coefficient else PALE for bar in bars]
    ax.barh(places, [bar.pip for bar in bars], height=0.6, color=colours, edgecolor=BLACK, linewidth=0.4)
    ax.axvline(0.5, color=BLACK, linestyle=(0, (4, 2)), linewidth=0.6)
    ax.set_yticks(places, [term_label(name, names) for name in names])
    ax.set_ylim(len(bars) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.0)
    ax.set_xlabel(f"{score} (a blue bar: in the equation; right: coefficient, 95 % interval)")
    ax.set_title(term_label(target), loc="left")
    for place, bar in zip(places, bars, strict=True):
        where: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "ha": "left", "va": "center"}
        ax.text(1.02, float(place), bar.coefficient.replace("-", "\N{MINUS SIGN}"), **where)


def draw_run(axes: Sequence[Axes], strip: Strip) -> None:
    """A free run against what was measured, a state in each of the axes."""
    for ax, panel in zip(axes, strip.panels, strict=True):
        draw_panel(ax, strip, panel)
    axes[-1].set_xlabel("time [s]")
    above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 4}
    axes[0].legend(handles=forecast_legend([strip]), **above)
