"""Drift: coefficients over many files, with their intervals."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from bayeq.errors import InputError
from bayeq.figures.picture import above, unit_text
from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, RED, labelled, new_panels, picture, plain, term_label

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Height of the panel of a term, and of what is around all panels [mm].
PANEL, AROUND = 35.0, 30.0

# Verdicts by mark and colour, which differ in lightness too.
MARKS: dict[str, dict[str, Any]] = {
    "found": {"marker": "o", "color": BLUE},
    "nearly true": {"marker": "s", "color": ORANGE, "markeredgecolor": BLACK, "markeredgewidth": 0.4},
    "not determined": {"marker": "o", "color": BLUE, "markerfacecolor": "white"},
    "none": {"marker": "x", "color": RED},
}

# Panels at most, of the terms that are in most files.
MOST = 12

# Names of files below the axis, without folder and suffix: as many as can be read, of at most this many characters.
NAMES, LONGEST = 24, 16


@picture
def draw_drift(table: pd.DataFrame) -> Figure:
    """Coefficients with 95 % intervals over files, from left to right, a panel for each target and term.

    The table is that of `Batch.table`: its rows of terms that are in the equation of their file are drawn, of 12 terms
    at most. Marks are those of the verdict; a grey band is the interval of the common equation, where there is one.
    InputError if there are no rows.
    """
    if not len(table):
        raise InputError("no file has an equation: there is nothing to draw; see the messages of the files")
    panels, note = _panels(table)
    figure, axes = new_panels(len(panels), height=len(panels) * PANEL + AROUND, sharex=True)
    several = table.target.nunique() > 1
    for ax, (target, term) in zip(axes[:, 0], panels, strict=True):
        rows = table[(table.target == target) & (table.term == term)]
        _panel(ax, rows, f"{target}: " if several else "")
    _files(axes[-1, 0], table)
    handles = labelled(axes.flat)
    above(axes[0, 0], len(handles), handles=handles, fontsize=8)
    if note:
        figure.supxlabel(note, x=0.01, ha="left", fontsize=7)
    return figure


def _panels(table: pd.DataFrame) -> tuple[list[tuple[str, str]], str]:
    """Targets and terms to draw, those of most files, and what is said of the others."""
    every = list(dict.fromkeys(zip(table.target, table.term, strict=True)))
    files = table.groupby(["target", "term"]).shown.sum()
    kept = sorted(every, key=lambda one: -files[one])[:MOST]
    rest = [int(files[one]) for one in every if one not in kept]
    note = f"{len(rest)} more terms, each in at most {max(rest)} of the files, are in the table" if rest else ""
    return [one for one in every if one in kept], note


def _panel(ax: Axes, rows: pd.DataFrame, before: str) -> None:
    """The coefficient of one term."""
    ax.set_axisbelow(True)
    ax.grid(axis="y", color=PALE, linewidth=0.5)
    if "common_coef" in rows:
        common = rows.iloc[0]
        band: dict[str, Any] = {"color": PALE, "linewidth": 0, "zorder": 0, "label": "common equation, 95 %"}
        ax.axhspan(common.common_ci_low, common.common_ci_high, **band)
        ax.axhline(common.common_coef, color=BLACK, linewidth=0.6, zorder=1)
    drawn = rows[rows.shown]
    ax.vlines(drawn.order, drawn.ci_low, drawn.ci_high, color=BLUE, linewidth=0.9, zorder=2, label="95 % interval")
    size = 3.4 if len(rows) <= 80 else 2.2
    for kind, look in MARKS.items():
        own = drawn[drawn.verdict == kind]
        if len(own):
            ax.plot(own.order, own.coef, linestyle="none", markersize=size, zorder=3, label=kind, **look)
    units = {unit if isinstance(unit, str) else "" for unit in rows.unit}  # pandas makes NaN of None
    unit = "units differ" if len(units) > 1 else plain(unit_text(units.pop()))
    name = term_label(rows.term.iloc[0], tuple(rows.term)) if rows.term.iloc[0] != "1" else "constant"
    ax.set_ylabel(f"{plain(before)}{name}" + (f"\n[{unit}]" if unit not in ("", "1") else ""))
    ax.locator_params(axis="y", nbins=5)
    ax.ticklabel_format(axis="y", useOffset=False, scilimits=(-4, 5))


def _files(ax: Axes, table: pd.DataFrame) -> None:
    """Names of files below the lowest panel."""
    names = dict(zip(table.order, table.file, strict=True))
    orders = sorted(names)
    shown = orders[:: -(-len(orders) // NAMES)]
    stems = [PurePath(str(names[order])).stem for order in shown]
    short = [stem if len(stem) <= LONGEST else f"…{stem[1 - LONGEST :]}" for stem in stems]
    ax.set_xticks(shown, [plain(stem) for stem in short], rotation=90)
    ax.set_xlim(orders[0] - 0.8, orders[-1] + 0.8)
