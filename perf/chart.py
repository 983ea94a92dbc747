"""The chart of the comparison: python -m perf.chart draws docs/figures/performance from perf/results/compare.csv."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, new_panels, save, style
from perf.peers import CONTESTANTS
from perf.problems import CASES, SYSTEMS
from perf.rows import Row, read_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "write_chart"]

STEM = Path(__file__).parents[1] / "docs" / "figures" / "performance"

# Whose times are followed from size to size, and how.
LINES: dict[str, dict[str, Any]] = {
    "vb": {"color": BLUE, "marker": "o"},
    "auto": {"color": BLUE, "marker": "s", "linestyle": "--"},
    "lstsq": {"color": BLACK, "marker": "x"},
    "pysindy-stlsq": {"color": ORANGE, "marker": "^"},
    "ard": {"color": ORANGE, "marker": "D", "linestyle": "--"},
    "lasso": {"color": ORANGE, "marker": "v", "linestyle": ":"},
    "millipede": {"color": ORANGE, "marker": "P", "linestyle": "-."},
}

# The cases along each axis.
BY_ROWS = ("p36", "n20000", "n200000", "n2000000")
BY_COLUMNS = ("p36", "p200", "p2000", "p10000")

# Height [mm].
HEIGHT = 105.0

# Several triangles at one place are set side by side.
APART = 1.15


def _dots(axes: Axes, rows: Sequence[Row]) -> None:
    """Times of all contestants on the oscillators, and how often they find the law."""
    found = {
        name: [row for row in rows if row.contestant == name and row.case in SYSTEMS and row.status == "ok"]
        for name in CONTESTANTS
    }
    seconds = {name: median(row.seconds for row in some) for name, some in found.items() if some}
    names = sorted(seconds, key=lambda name: -seconds[name])
    for k, name in enumerate(names):
        colour = BLUE if CONTESTANTS[name].ours else ORANGE
        axes.axhline(k, color=PALE, linewidth=0.5, zorder=0)
        axes.plot(seconds[name], k, "o", color=colour, markersize=4.5)
        exact = sum(round(row.exact * row.problems) for row in found[name])
        count = f"{exact}/{sum(row.problems for row in found[name])}"
        axes.annotate(count, (1.03, k), xycoords=("axes fraction", "data"), va="center", fontsize=7)
    axes.annotate("exact", (1.03, 1.01), xycoords="axes fraction", va="bottom", fontsize=7)
    axes.set_yticks(range(len(names)), [CONTESTANTS[name].title for name in names])
    axes.set_ylim(-0.7, len(names) - 0.3)
    axes.tick_params(axis="y", length=0)
    axes.set_xscale("log")
    axes.set_xlabel("time of a whole fit [s]")
    axes.set_title("Oscillators, P = 36 (blue: bayeq)")


def _limit(rows: Sequence[Row]) -> float:
    """The time limit, if somebody has exceeded it."""
    over = [row.status for row in rows if CASES[row.case].large and row.status.startswith(">")]
    seconds = [float(status[1:-1]) for status in over if status.endswith(" s")]
    return seconds[0] if seconds else math.nan


def _curves(axes: Axes, rows: Sequence[Row], cases: Sequence[str], size: Mapping[str, int]) -> None:
    """Times from size to size; an empty triangle at the limit stands for a fit that took longer."""
    at = {(row.contestant, row.case): row for row in rows}
    limit = _limit(rows)
    taken: dict[int, int] = {}
    for name, look in LINES.items():
        some = [(size[case], at[name, case]) for case in cases if (name, case) in at]
        done = [(x, row.seconds) for x, row in some if row.status == "ok"]
        axes.plot(*zip(*done, strict=True) if done else ([], []), markersize=3.5, label=CONTESTANTS[name].title, **look)
        for x, row in some:
            if row.status.startswith((">", "not tried")):
                place = x * APART ** taken.get(x, 0)
                taken[x] = taken.get(x, 0) + 1
                axes.plot(place, limit, "^", color=look["color"], markerfacecolor="none", markersize=4.5)
    axes.set_xscale("log")
    axes.set_yscale("log")


def draw(rows: Sequence[Row]) -> Figure:
    """Times of all on the oscillators, and of some from size to size."""
    figure, axes = new_panels(1, 3, height=HEIGHT, width_ratios=(1.5, 1.0, 1.0))
    every, tall, wide = axes[0]
    wide.sharey(tall)
    _dots(every, rows)
    _curves(tall, rows, BY_ROWS, {name: CASES[name].rows for name in BY_ROWS})
    _curves(wide, rows, BY_COLUMNS, {name: CASES[name].columns for name in BY_COLUMNS})
    tall.set_title("P = 36")
    tall.set_xlabel("rows N")
    tall.set_ylabel("time of a whole fit [s]")
    wide.set_title("N = 2000*")
    wide.set_xlabel("columns P")
    wide.tick_params(axis="y", labelleft=False)
    note = "* 20 000 at P = 2000"
    if not math.isnan(_limit(rows)):
        note += f"; empty triangles: over {_limit(rows):g} s"
    handles, labels = tall.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", ncols=4, title=note, alignment="left")
    return figure


def write_chart(rows: Sequence[Row], stem: Path = STEM) -> list[Path]:
    """Draw the chart and write it as PNG and SVG."""
    with style():
        return save(draw(rows), stem)


if __name__ == "__main__":
    from perf.compare import TABLE

    write_chart(read_rows(TABLE)[1])
