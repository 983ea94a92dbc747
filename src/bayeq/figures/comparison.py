"""Two panels: a curve with its band against what was measured, and below it the residual."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.figures.picture import thinned
from bayeq.figures.style import BLACK, BLUE, ORANGE, RED

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["BAND", "compare"]

Floats = NDArray[np.float64]

BAND: dict[str, Any] = {"color": BLUE, "alpha": 0.28, "linewidth": 0.0}


def compare(
    axes: tuple[Axes, Axes],
    time: Floats,
    measured: Floats,
    curve: tuple[Floats, Floats | None, Floats | None],
    label: str,
) -> None:
    """Draw them: `curve` is mean, low and high, the ends None where there is no band.

    What lies far outside the panel, or nowhere, is drawn to beyond its edge.
    """
    upper, lower = axes
    mean, low, high = curve
    every = thinned(len(time))
    finite = measured[np.isfinite(measured)]
    ends = (float(finite.min()), float(finite.max())) if len(finite) else (-1.0, 1.0)
    margin = 0.15 * (ends[1] - ends[0]) or max(abs(ends[0]), 1.0)
    limits = (ends[0] - margin, ends[1] + margin)
    room = 10.0 * (limits[1] - limits[0])
    upper.plot(time[every], measured[every], color=BLACK, linewidth=0.7, label="measured")
    if low is not None and high is not None:
        bottom, top = (np.clip(edge[every], limits[0] - room, limits[1] + room) for edge in (low, high))
        upper.fill_between(time[every], bottom, top, label="95 % band", **BAND)
    upper.plot(time[every], mean[every], color=BLUE, linewidth=0.9, linestyle=(0, (4, 1.2)), label=label)
    upper.set_ylim(*limits)
    residual = measured - mean
    lower.axhline(0.0, color=BLACK, linewidth=0.5)
    if low is not None and high is not None:
        bottom, top = (np.clip(edge[every] - mean[every], -room, room) for edge in (low, high))
        lower.fill_between(time[every], bottom, top, **BAND)
    lower.plot(time[every], residual[every], color=ORANGE, linewidth=0.7, label="residual: measured less " + label)
    known = np.abs(residual[np.isfinite(residual)])
    reach = 1.15 * float(known.max(initial=0.0)) or 1.0
    lower.set_ylim(-reach, reach)
    lower.set_xlim(float(time[0]), float(time[-1]))
    upper.set_xlim(float(time[0]), float(time[-1]))


def mark_blow_up(axes: tuple[Axes, Axes], at: float | None) -> None:
    """A line where a run blew up."""
    for ax in axes if at is not None else ():
        ax.axvline(float(at or 0.0), color=RED, linestyle=(0, (4, 2)), linewidth=0.8, label="blew up")
