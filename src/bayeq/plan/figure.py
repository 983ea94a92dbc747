"""Designs of a next measurement by what they tell, beside the best excitation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.style import BLACK, BLUE, FULL_WIDTH, ORANGE, RED, log_ticks, new_figure, picture
from bayeq.plan.result import Outcome, Plan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_plan"]

Floats = NDArray[np.float64]

# Designs that are drawn, the best from the top.
DRAWN = 16

# The figure [mm]: a row for each design, the least number of rows, and what is around them.
ROW, LEAST_ROWS, AROUND = 4.4, 12, 18.0

# Colours and markers of kinds, in the order in which they come; more than these repeat.
LOOKS = ((BLUE, "o"), (ORANGE, "s"), (RED, "^"), (BLACK, "D"))

# The best excitation is drawn over this many periods of the middle of its band.
PERIODS = 20

# Values below this share of the best are not told from none.
LEAST = 1e-4


@picture
def draw_plan(plan: Plan) -> Figure:
    """Information by second of each design (left), spectrum and first part of the best excitation (right).

    Parameters
    ----------
    plan : Plan
        Designs, the best first.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width.
    """
    shown = plan.outcomes[:DRAWN]
    figure = new_figure(FULL_WIDTH, AROUND + ROW * max(len(shown), LEAST_ROWS), layout="constrained")
    axes = figure.subplot_mosaic([["rates", "spectrum"], ["rates", "start"]])
    _rates(axes["rates"], shown, plan.units, plan.purpose)
    _spectrum(axes["spectrum"], plan)
    _start(axes["start"], plan)
    return figure


def _rates(ax: Axes, shown: Sequence[Outcome], units: Mapping[str, str], purpose: str) -> None:
    """A row per design, the mean and one standard deviation to either side."""
    kinds = sorted({one.design.kind for one in shown})
    best = max(shown[0].rate, np.finfo(float).tiny)
    # a spread that reaches down to nothing ends at the edge
    least = max(0.5 * min(one.rate for one in shown), LEAST * best)
    for row, one in enumerate(shown):
        colour, marker = LOOKS[kinds.index(one.design.kind) % len(LOOKS)]
        ax.plot([max(one.rate - one.sd, least), one.rate + one.sd], [row, row], color=colour, linewidth=1.0)
        ax.plot([max(one.rate, least)], [row], color=colour, marker=marker, markersize=3.6)
    ax.set_xscale("log")
    ax.set_xlim(least, 1.5 * max(one.rate + one.sd for one in shown))
    log_ticks(ax.xaxis)
    ax.set_ylim(len(shown) - 0.4, -0.6)
    ax.set_yticks(range(len(shown)), [_label(one, units) for one in shown])
    ax.grid(axis="y", linewidth=0.3, alpha=0.4)
    told = "against the closest rival" if purpose == "models" else "about the coefficients"
    ax.set_xlabel(f"information {told} [nats/s]")
    ax.set_title("designs, mean \N{PLUS-MINUS SIGN} sd over realisations")


def _label(one: Outcome, units: Mapping[str, str]) -> str:
    low, high = one.design.band
    size = ", ".join(
        f"\N{PLUS-MINUS SIGN}{value:.3g} {units.get(name, '')}".rstrip() for name, value in one.amplitudes.items()
    )
    return f"{one.design.kind}, {low:.3g} to {high:.3g} Hz, {size}"


def _inputs(plan: Plan) -> list[tuple[str, Floats, dict[str, Any]]]:
    """Name, samples and look of each input of the best excitation."""
    return [
        (name, samples, {"color": LOOKS[k % len(LOOKS)][0], "linewidth": 0.8})
        for k, (name, samples) in enumerate(plan.inputs.items())
    ]


def _spectrum(ax: Axes, plan: Plan) -> None:
    """Amplitude of each line."""
    n, dt = len(plan.time), float(plan.time[1] - plan.time[0])
    low, high = plan.outcomes[0].design.band
    frequency = np.fft.rfftfreq(n, dt)
    width = high - low
    # lines beyond the band tell nothing but rounding and the skirts of a sweep
    near = (frequency >= low - 0.25 * width) & (frequency <= high + 0.25 * width)
    for name, samples, look in _inputs(plan):
        size = 2.0 / n * np.abs(np.fft.rfft(samples - plan.offsets[name]))
        ax.vlines(frequency[near], 0.0, size[near], **look)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(_quantity(plan, "amplitude of a line"))
    ax.set_title("the best: spectrum")


def _start(ax: Axes, plan: Plan) -> None:
    """The first periods."""
    low, high = plan.outcomes[0].design.band
    shown = plan.time <= PERIODS * 2.0 / (low + high)
    for name, samples, look in _inputs(plan):
        ax.plot(plan.time[shown], samples[shown], label=name, **look)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(_quantity(plan, ", ".join(plan.inputs)))
    part = "all of it" if shown.all() else "its beginning"
    ax.set_title(f"the best: {part}")
    if len(plan.inputs) > 1:
        ax.legend(loc="upper right", ncols=2, fontsize=7)


def _quantity(plan: Plan, what: str) -> str:
    units = {plan.units.get(name, "") for name in plan.inputs}
    unit = units.pop() if len(units) == 1 else ""
    return f"{what} [{unit}]" if unit else what
