"""`PipCurve`: sensitivity of posterior inclusion probabilities to v_s, to p_0 and to the power of the likelihood.

The curves, their tables and their figure; `bayeq.equation.sensitivity` computes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.figures.style import BLACK, BLUE, ORANGE, PALE, RED, log_ticks, new_panels, picture, term_label
from bayeq.inference.settings import INFERENCE

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

# The figure [mm]: a row, the first panel with its scale, other panels, the legend.
HEIGHT, FIRST, PANEL, LEGEND = 65.0, 72.0, 66.0, 52.0


@dataclass(frozen=True, eq=False)
class PipCurve:
    """Posterior inclusion probabilities (PIPs) by model averaging as one number varies.

    Attributes
    ----------
    axis_name : str
        What varies, as the column of the table is named: ``slab_variance`` (v_s), ``prior_inclusion`` (p_0) or
        ``coarsen`` (the power of the likelihood).
    names : tuple of str
        The P candidate terms.
    values : (K,) array
        Its values, ascending.
    pip : (K, P) array
        PIPs at these values.
    left_out : (K,) array
        Posterior mass of models that were not listed, an estimate that errs upwards: a PIP is off by no more.
    current : int
        Index of the value that the equation was found with.
    rows : (K,) array or None
        Number of rows that the data count for, where it varies.
    """

    axis_name: str
    names: tuple[str, ...]
    values: Floats
    pip: Floats
    left_out: Floats
    current: int
    rows: Floats | None = None

    @property
    def listed(self) -> Bools:
        """Values at which the models listed hold at least 98 % of the posterior mass, (K,)."""
        return self.left_out <= INFERENCE.most_left_out

    def table(self) -> pd.DataFrame:
        """A row per value and term: the value, under `axis_name`; rows, where they vary; term, pip and left_out."""
        import pandas as pd

        terms = len(self.names)
        columns = {self.axis_name: np.repeat(self.values, terms)}
        if self.rows is not None:
            columns["rows"] = np.repeat(self.rows, terms)
        return pd.DataFrame(columns).assign(
            term=list(self.names) * len(self.values),
            pip=self.pip.ravel(),
            left_out=np.repeat(self.left_out, terms),
        )

    def changes(self) -> pd.DataFrame:
        """Terms that are included (PIP > 0.5) at some values and not at others; see `PriorSensitivity.changes`."""
        return _changes([self])

    def plot(self) -> Figure:
        """PIPs against the value.

        Shown are the terms that are included as used and those whose PIP exceeds 0.05 anywhere; those that are included
        at some values only stand out.

        Raises
        ------
        MissingExtraError
            matplotlib is not installed.
        """
        return draw_pip_curves({"": [self]})

    def __str__(self) -> str:
        """The terms that are always included, and between which values others are, a line each."""
        inside = self.pip[self.listed] > 0.5
        values = self.values[self.listed]
        count = inside.sum(axis=0)
        always = [name for name, k in zip(self.names, count, strict=True) if 0 < k == len(values)]
        what = LABELS[self.axis_name].replace("$", "")
        lines = [
            f"included (PIP > 0.5), {what} from {self.values[0]:.3g} to {self.values[-1]:.3g}"
            f" (used: {self.values[self.current]:.3g})",
            f"always: {', '.join(always) or 'none'}",
        ]
        for j in np.argsort(-count, kind="stable"):
            if 0 < count[j] < len(values):
                at = np.flatnonzero(inside[:, j])
                runs = np.split(values[at], np.flatnonzero(np.diff(at) > 1) + 1)
                between = ", ".join(" to ".join(f"{end:.3g}" for end in np.unique(run[[0, -1]])) for run in runs)
                lines.append(f"{self.names[j]}: {between}; PIP {self.pip[self.current, j]:.2f} as used")
        if missing := len(self.values) - len(values):
            lines.append(f"not counted: {missing} values at which too many models share the posterior mass")
        return "\n".join(lines)


class PriorSensitivity(NamedTuple):
    """Prior sensitivity of the PIPs: one of v_s and p_0 varies while the other is the one used.

    Attributes
    ----------
    slab_variance : PipCurve
        PIPs against v_s.
    prior_inclusion : PipCurve
        PIPs against p_0. Where terms have p_0 of their own, the log-odds of all are shifted by the same amount, and the
        value is the probability of their mean; where p_0 ~ Beta(a, b), it is a/(a + b), and a + b stays. Terms forced
        in or kept out remain so.
    """

    slab_variance: PipCurve
    prior_inclusion: PipCurve

    def table(self) -> pd.DataFrame:
        """A row per prior and term: slab_variance, prior_inclusion, term, pip, left_out; the prior used once."""
        import pandas as pd

        keys = [curve.axis_name for curve in self]
        tables = [curve.table() for curve in self]
        for table, other in zip(tables, reversed(self), strict=True):
            table[other.axis_name] = other.values[other.current]
        joined = pd.concat(tables)[[*keys, "term", "pip", "left_out"]].drop_duplicates([*keys, "term"])
        return joined.sort_values(keys, kind="stable", ignore_index=True)

    def changes(self) -> pd.DataFrame:
        """Terms that some of the priors include (PIP > 0.5) and others do not.

        Priors that are not `PipCurve.listed` do not count.

        Returns
        -------
        DataFrame
            ``term``, ``pip`` under the prior used (NaN if it is not listed), ``lowest`` and ``highest`` PIP; the widest
            range first.
        """
        return _changes(self)

    def plot(self) -> Figure:
        """PIPs against v_s and against p_0, side by side; see `PipCurve.plot`."""
        return draw_pip_curves({"": self})

    def __str__(self) -> str:
        return "\n".join(str(curve) for curve in self)


def _changes(curves: Sequence[PipCurve]) -> pd.DataFrame:
    """Of all values of some curves through the same point, see `PriorSensitivity.changes`."""
    import pandas as pd

    first = curves[0]
    pip = np.concatenate([curve.pip[curve.listed] for curve in curves])
    out = pd.DataFrame(
        {
            "term": first.names,
            "pip": np.where(first.listed[first.current], first.pip[first.current], np.nan),
            # none listed: nothing changes
            "lowest": pip.min(axis=0, initial=1.0),
            "highest": pip.max(axis=0, initial=0.0),
        }
    )
    out = out[(out.lowest <= 0.5) & (out.highest > 0.5)]
    widest_first = np.argsort((out.lowest - out.highest).to_numpy(), kind="stable")
    return out.iloc[widest_first].reset_index(drop=True)


@picture
def draw_pip_curves(rows: Mapping[str, Sequence[PipCurve]]) -> Figure:
    """A row per equation, by title (may be empty): a panel per curve, as many for each, and what their looks mean."""
    panels = max(len(curves) for curves in rows.values())
    width = FIRST + (panels - 1) * PANEL + LEGEND
    figure, axes = new_panels(len(rows), panels, width=width, height=HEIGHT * len(rows), sharey=True)
    for in_row, (title, curves) in zip(axes, rows.items(), strict=True):
        for ax, curve in zip(in_row, curves, strict=True):
            _frame(ax, curve)
        in_row[0].set_ylabel("PIP")
        in_row[0].set_title(term_label(title), pad=13)
        _draw(in_row, curves)
    return figure


def _frame(ax: Axes, curve: PipCurve) -> None:
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


def _draw(axes: Sequence[Axes], curves: Sequence[PipCurve]) -> None:
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
