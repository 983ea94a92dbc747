"""PIPs under other priors: curves against v_s and against p_0, with the terms beside them.

Plain arrays in, a matplotlib figure out. Call `draw_sensitivity` inside `bayeq.figures.style.style`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import BayeqError
from bayeq.figures.style import BLACK, BLUE, FULL_WIDTH, PALE, RED, add_axes, mathtext, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PipCurves", "draw_coarsening", "draw_sensitivity", "spread"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Terms whose PIP stays below this are not drawn; terms whose PIPs never differ by more than this share a label.
NOTEWORTHY = 0.05
ALIKE = 0.02

# Labels beside a panel: at most so many lines, one every so many mm, broken between terms after so many characters.
MOST_LABELS = 14
LINE = 3.1
WRAP = 16
LONGEST = 18

GREY = "#6E6E6E"
MARKERS = "os^Dv<>P"

# A row of the figure [mm]: labels, panel, its scale, panel, labels. They stand where the prior favours terms most, at
# small v_s and at large p_0: there the curves are apart.
BESIDE, PANEL, BETWEEN, ABOVE, HEIGHT, BELOW = 27.0, 62.0, 12.0, 10.0, 48.0, 9.0
LEGEND = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class PipCurves:
    """PIPs of an equation's terms along v_s and along p_0.

    Attributes
    ----------
    title : str
        The equation; may be empty.
    terms : tuple of str
        The P candidate terms.
    changing : (P,) bool array
        Terms that some of the priors include and others do not.
    base : (float, float)
        v_s and p_0 of the prior used.
    used : (P,) array
        PIPs under that prior.
    axes : pair of arrays
        Values of v_s and of p_0.
    pip : pair of (V, P) and (Q, P) arrays
        PIPs at these values, the other being that of the prior used.
    listed : pair of bool arrays
        Values where the PIPs stand on nearly all of the posterior mass; others get open marks.
    """

    title: str
    terms: tuple[str, ...]
    changing: Bools
    base: tuple[float, float]
    used: Floats
    axes: tuple[Floats, Floats]
    pip: tuple[Floats, Floats]
    listed: tuple[Bools, Bools]


def draw_sensitivity(rows: Sequence[PipCurves]) -> Figure:
    """PIPs against v_s (left) and p_0 (right), a row per equation; terms are named as far as there is room.

    Parameters
    ----------
    rows : sequence of PipCurves
        From top to bottom.

    Returns
    -------
    matplotlib.figure.Figure
        Of a journal page's width.
    """
    one = ABOVE + HEIGHT + BELOW
    figure = new_figure(FULL_WIDTH, LEGEND + len(rows) * one)
    names = ("slab variance $v_s$", "prior inclusion probability $p_0$")
    lefts = (BESIDE, BESIDE + PANEL + BETWEEN)
    for k, row in enumerate(rows):
        top = LEGEND + k * one + ABOVE
        groups = _groups(row)
        for side in (0, 1):
            ax = add_axes(figure, lefts[side], top, PANEL, HEIGHT)
            _panel(ax, row, side, groups)
            ax.set_xlabel(names[side])
            if side == 1:
                ax.set_ylabel("PIP")
            else:
                ax.tick_params(axis="y", left=False, right=True, labelleft=False)
                if row.title:
                    figure.text(1.0 / FULL_WIDTH, ax.get_position().y1, _label(row.title), fontsize=9, va="bottom")
    figure.legend(handles=_legend(rows), loc="upper center", ncols=5, columnspacing=1.6, handlelength=2.2)
    return figure


def draw_coarsening(terms: tuple[str, ...], power: Floats, pip: Floats, listed: Bools) -> Figure:
    """PIPs against the power of the likelihood, terms named at its end where each row counts in full.

    Parameters
    ----------
    terms : tuple of str
        The P candidates.
    power : (K,) array
        Descending.
    pip : (K, P) array
        PIPs.
    listed : (K,) bool array
        Powers where they stand on nearly all of the posterior mass.
    """
    inside = pip > 0.5
    row = PipCurves(
        title="",
        terms=terms,
        changing=np.asarray(inside.any(axis=0) & ~inside.all(axis=0)),
        base=(float(power[0]), float(power[0])),
        used=pip[0],
        axes=(power[::-1], power[::-1]),
        pip=(pip[::-1], pip[::-1]),
        listed=(listed[::-1], listed[::-1]),
    )
    left = BETWEEN + 2.0
    figure = new_figure(left + PANEL + BESIDE, LEGEND + ABOVE + HEIGHT + BELOW)
    ax = add_axes(figure, left, LEGEND + ABOVE, PANEL, HEIGHT)
    _panel(ax, row, 1, _groups(row))
    ax.set_xlabel("power of the likelihood")
    ax.set_ylabel("PIP")
    handles = _legend([row])[:3]
    for handle, label in zip(handles, ("included at all powers", "at some", "at none"), strict=True):
        handle.set_label(label)
    figure.legend(handles=handles, loc="upper center", ncols=3, columnspacing=1.6, handlelength=2.2)
    return figure


def _groups(row: PipCurves) -> list[list[int]]:
    """Terms to draw with a label of their own, and terms that share one, the likeliest first."""
    whole = np.concatenate(row.pip)
    peak = whole.max(axis=0)
    drawn = np.flatnonzero((row.used > 0.5) | (peak > NOTEWORTHY))
    order = sorted(drawn.tolist(), key=lambda j: (not row.changing[j], -row.used[j], j))
    groups: list[list[int]] = []
    for j in order:
        for group in groups:
            first = group[0]
            if not row.changing[j] and not row.changing[first] and np.abs(whole[:, j] - whole[:, first]).max() < ALIKE:
                group.append(j)
                break
        else:
            groups.append([j])
    return groups


def _panel(ax: Axes, row: PipCurves, side: int, groups: list[list[int]]) -> None:
    """The curves of one panel and the labels at their ends: terms that change first, then those included."""
    from matplotlib.transforms import blended_transform_factory

    x, pip, listed = row.axes[side], row.pip[side], row.listed[side]
    ax.set_xscale("log")
    margin = (x[-1] / x[0]) ** 0.03 if len(x) > 1 else 2.0
    ax.set_xlim(x[0] / margin, x[-1] * margin)
    ax.set_ylim(-0.03, 1.03)
    _log_ticks(ax, x)
    ax.axhline(0.5, color=BLACK, linestyle=(0, (4, 2)), linewidth=0.6)
    ax.axvline(row.base[side], color=BLACK, linestyle=(0, (1, 1.5)), linewidth=0.9)
    above = blended_transform_factory(ax.transData, ax.transAxes)
    ax.text(row.base[side], 1.02, f"used: {row.base[side]:.4g}", transform=above, ha="center", va="bottom", fontsize=7)
    order = _names(row.terms)
    labels: list[tuple[str, float, str]] = []
    lines = changing = 0
    for group in groups:
        first = group[0]
        if row.changing[first]:
            look: dict[str, Any] = {"color": RED, "marker": MARKERS[changing % len(MARKERS)], "markersize": 2.8}
            changing += 1
        elif row.used[first] > 0.5:
            look = {"color": BLUE, "linewidth": 1.5}
        else:
            look = {"color": GREY}
        if len(x) == 1:
            look = {"marker": "o", "markersize": 2.8, **look}
        text = _wrapped([row.terms[j] for j in sorted(group)], order)
        fits = lines + 1 + text.count("\n") <= MOST_LABELS
        if fits:
            lines += 1 + text.count("\n")
            labels.append((text, float(pip[-side, group].mean()), look["color"]))
        elif look["color"] == GREY:
            look = {"color": PALE, "zorder": 1}
        for j in group:
            ax.plot(x, pip[:, j], **look)
            ax.plot(x[~listed], pip[~listed, j], "o", color=look["color"], markerfacecolor="white", markersize=3.6)
    _label_ends(ax, labels, side)


def _label_ends(ax: Axes, labels: list[tuple[str, float, str]], side: int) -> None:
    """Texts left (0) or right (1) of the panel, as near to the ends of their curves as their height permits."""
    if not labels:
        return
    labels = sorted(labels, key=lambda label: label[1])
    low, high = ax.get_ylim()
    per_mm = (high - low) / HEIGHT
    heights = np.array([LINE * per_mm * (1 + text.count("\n")) for text, _, _ in labels])
    at = spread(np.array([end for _, end, _ in labels]), heights, low, high)
    away = 2 * side - 1
    for (text, end, colour), y in zip(labels, at, strict=True):
        # from the panel's edge, at the end of the curve, to the text
        from_to = (side, side + away * 3.5 / PANEL), ((end - low) / (high - low), (y - low) / (high - low))
        ax.plot(*from_to, transform=ax.transAxes, color=colour, linewidth=0.4, clip_on=False)
        ax.text(
            side + away * 4.2 / PANEL,
            from_to[1][1],
            text,
            transform=ax.transAxes,
            color=colour,
            fontsize=7,
            ha="left" if side else "right",
            va="center",
            linespacing=1.1,
        )


def spread(wanted: Floats, heights: Floats, low: float, high: float) -> Floats:
    """Centres of labels of given heights that do not overlap, as near to where they are wanted as that permits.

    Parameters
    ----------
    wanted : (k,) array
        Centres in ascending order.
    heights : (k,) array
        Their sum is at most high - low.
    low, high : float
        Ends of the room.

    Returns
    -------
    (k,) array
        The least squares solution: pools of labels that touch stand about the mean of what they want (pool adjacent
        violators), moved into the room.
    """
    # c_i - o_i must not decrease, where o_i is the height of all labels below and half of its own
    offset = np.cumsum(heights) - 0.5 * heights
    pools: list[tuple[float, int]] = []
    for value in wanted - offset:
        mean, count = float(value), 1
        while pools and pools[-1][0] > mean:
            below, many = pools.pop()
            mean, count = (below * many + mean * count) / (many + count), many + count
        pools.append((mean, count))
    shift = np.concatenate([np.full(count, mean) for mean, count in pools])
    return np.clip(shift, low, high - heights.sum()) + offset


def _log_ticks(ax: Axes, values: Floats) -> None:
    """Ticks that a reader can use over many decades as over half of one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    decades = float(np.log10(values[-1] / values[0]))
    wide = decades > 2.5
    locator = LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0))
    ax.xaxis.set_major_locator(locator)
    low, high = ax.get_xlim()
    inside = [tick for tick in np.asarray(locator.tick_values(low, high)) if low <= tick <= high]
    if len(inside) < 2:
        ax.set_xticks(np.unique(values[[0, -1]]))
    if decades > 5:
        return  # powers of ten
    ax.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def _wrapped(terms: list[str], order: tuple[str, ...]) -> str:
    """Terms separated by commas, in lines."""
    text, used = "", 0
    for term in terms:
        text += ("" if not text else ", " if used + len(term) <= WRAP else ",\n") + _label(term, order)
        used = len(term) + (used if text and used + len(term) <= WRAP else 0)
    return text


def _names(terms: Sequence[str]) -> tuple[str, ...]:
    """Names in the order in which the terms bring them."""
    return tuple(dict.fromkeys(re.findall(r"[^\W\d]\w*", " ".join(terms))))


def _label(term: str, order: tuple[str, ...] = ()) -> str:
    """A term as matplotlib sets it; as it stands where it is a column's name and no expression; shortened if long."""
    if len(term) > LONGEST:
        return _plain(f"{term[: LONGEST // 2 - 1]}…{term[-LONGEST // 2 :]}")
    try:
        return mathtext(term, order)
    except BayeqError:
        return _plain(term)


def _plain(text: str) -> str:
    return text.replace("$", r"\$")


def _legend(rows: Sequence[PipCurves]) -> list[Any]:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=BLUE, linewidth=1.5, label="included by all these priors"),
        Line2D([], [], color=RED, marker=MARKERS[0], markersize=2.8, label="by some of them"),
        Line2D([], [], color=GREY, label="by none"),
        Line2D([], [], color=BLACK, linestyle=(0, (1, 1.5)), label="prior used"),
    ]
    if not all(listed.all() for row in rows for listed in row.listed):
        open_mark: dict[str, Any] = {"linestyle": "none", "marker": "o", "markerfacecolor": "white", "color": GREY}
        handles.append(Line2D([], [], markersize=3.6, label="too many models to list", **open_mark))
    return handles
