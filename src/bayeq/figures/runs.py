"""Measured motion against equations: free runs, one step, measured over predicted, and the phase portrait."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.errors import InputError
from bayeq.figures import style
from bayeq.numerics.distributions import Z95
from bayeq.records import Record
from bayeq.states import MotionRows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Mean, low and high; the ends are None where there is no band.
Curve = tuple[Floats, Floats | None, Floats | None]

BAND: dict[str, Any] = {"color": style.BLUE, "alpha": 0.28, "linewidth": 0.0}

# Measured samples are a wide grey line, which shows on both sides of a run that agrees with it.
MEASURED: dict[str, Any] = {"color": "#A8A8A8", "linewidth": 2.6, "label": "measured"}
DRAWN: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.9}

# Heights of a panel and of the residual below it [mm]; those of many panels; that of a state in a quick look.
HEIGHTS = (56.0, 28.0)
LOW = (30.0, 15.0)
STATE = 40.0

# A panel of residuals shows its band whole, up to this multiple of the largest residual, which would else be a line.
WIDEST = 20.0

# Share of a record that is drawn where no rows were held out.
LAST = 0.2


def _compare(ax: Axes, time: Floats, measured: Floats | None, curve: Curve, label: str, of: str = "measured") -> None:
    """Draw a curve and its band over measured or estimated samples, which set the limits: a run may diverge."""
    every = style.thinned(len(time))
    known = curve[0] if measured is None else measured
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
    margin = 0.15 * (high - low) or max(abs(low), 1.0)
    ax.set(xlim=(float(time[0]), float(time[-1])), ylim=(low - margin, high + margin))
    if measured is not None:
        ax.plot(time[every], measured[every], **MEASURED | {"label": of})
    _band(ax, time[every], curve[1:], every, "95 % band")
    ax.plot(time[every], curve[0][every], label=label, **DRAWN)


def _band(ax: Axes, time: Floats, ends: Sequence[Floats | None], every: slice, label: str | None = None) -> None:
    """Draw a band; ends far outside the panel, or infinite, are clipped beyond its edge."""
    bottom, top = ax.get_ylim()
    room = 10.0 * (top - bottom)
    low, high = (None if end is None else np.clip(end[every], bottom - room, top + room) for end in ends)
    if low is not None and high is not None:
        ax.fill_between(time, low, high, label=label, **BAND)


def _residual(ax: Axes, time: Floats, measured: Floats, curve: Curve, label: str, of: str = "measured") -> None:
    """Draw the residual, samples less a curve, and its band."""
    every = style.thinned(len(time))
    mean, *ends = curve
    residual, ends = measured - mean, [None if end is None else end - mean for end in ends]
    largest, widest = (_largest(*values) for values in ((residual,), ends))
    reach = 1.15 * max(largest, min(widest, WIDEST * largest)) or 1.0
    ax.set(xlim=(float(time[0]), float(time[-1])), ylim=(-reach, reach))
    ax.axhline(0.0, color=style.BLACK, linewidth=0.5)
    _band(ax, time[every], ends, every)
    ax.plot(time[every], residual[every], color=style.ORANGE, linewidth=0.9, label=f"residual: {of} less {label}")


def _largest(*series: Floats | None) -> float:
    """The largest size of a finite value, 0 without any."""
    values = np.concatenate([np.zeros(1), *(one for one in series if one is not None)])
    return float(np.abs(values[np.isfinite(values)]).max())


def _curve(run: style.Run, name: str) -> Curve:
    return run.mean[name], run.low.get(name), run.high.get(name)


def _state(ax: Axes, run: style.Run, name: str) -> None:
    """Draw a state of a free run: samples, run, band, and the time of a blow-up."""
    _compare(ax, run.time, run.measured.get(name), _curve(run, name), "free run")
    ax.set_ylabel(style.label_of(name, run.units))
    _mark_blow_up(ax, run)


def _mark_blow_up(ax: Axes, run: style.Run) -> None:
    if run.blew_up_at is not None:
        ax.axvline(run.blew_up_at, color=style.RED, linestyle=style.DASHED, linewidth=0.8, label="blew up")


def draw_states(run: style.Run, ax: Any) -> list[Axes]:
    """Draw a free run against the samples, a state in each of the given axes, or in those of a pyplot figure."""
    with style.style():
        axes = style.axes_for(ax, [STATE] * len(run.mean), style.QUICK, pyplot=True)
        for one, name in zip(axes, run.mean, strict=True):
            _state(one, run, name)
        axes[-1].set_xlabel(f"time [{run.clock}]")
        style.above(axes[0])
    return axes


@style.picture
def draw_forecasts(runs: Sequence[tuple[str, style.Run]], time: str = "") -> Figure:
    """Draw free runs one below the other, with titles (may be empty) and a time label; a panel for each state."""
    heights = [height for _, run in runs for name in run.mean for height in LOW[: 1 + (name in run.measured)]]
    titles = sum(bool(title) for title, _ in runs)
    whole = 7.0 + sum(heights) + 8.0 * len(runs) + 6.0 * titles
    figure, axes = style.new_panels(len(heights), height=whole, height_ratios=heights)
    panels = iter(axes[:, 0])
    for title, run in runs:
        for k, name in enumerate(run.mean):
            ax = next(panels)
            _state(ax, run, name)
            if title and k == 0:
                ax.set_title(style.plain(title))
            if name in run.measured:
                ax.tick_params(axis="x", labelbottom=False)
                ax = next(panels)
                _residual(ax, run.time, run.measured[name], _curve(run, name), "free run")
                ax.set_ylabel("residual")
            ax.tick_params(axis="x", labelbottom=k == len(run.mean) - 1)
        ax.set_xlabel(time or f"time [{run.clock}]")
    figure.align_ylabels()
    figure.legend(handles=style.labelled(axes.flat), loc="outside upper right", ncols=4, handlelength=2.2)
    return figure


@style.picture
def free_run(
    eq: style.Answer,
    record: Record,
    ax: Any = None,
    *,
    channel: str | None = None,
    start: int | None = None,
    rows: int | None = None,
    draws: int = 200,
) -> tuple[Axes, Axes]:
    """A free run of the equations against a measured state, with the band of the posterior's runs and the residual.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        Times, inputs and measured states.
    ax : pair of matplotlib.axes.Axes, optional
        For the run and for the residual; by default those of a new figure.
    channel : str, optional
        A measured state; by default the first.
    start, rows : int, optional
        First row, and how many; by default those held out, or the last fifth.
    draws : int
        Runs with coefficients from their posterior; 0 for no band.

    Returns
    -------
    pair of matplotlib.axes.Axes
        Of the run and of the residual.

    Raises
    ------
    InputError
        As `Equations.simulate`; no state is measured.
    UnknownNameError
        A channel that is no measured state.
    MissingExtraError
        matplotlib is not installed.
    """
    run = eq.simulate(record, draws=draws, start=_first_row(eq, record.n) if start is None else start, rows=rows)
    name = style.channel_of(run, channel)
    upper, lower = style.axes_for(ax, HEIGHTS, style.FULL_WIDTH, sharex=True)
    _state(upper, run, name)
    _residual(lower, run.time, run.measured[name], _curve(run, name), "free run")
    _mark_blow_up(lower, run)
    lower.set(xlabel=style.time_label(eq), ylabel=style.label_of(name, run.units, "residual"))
    error = run.measured[name] - run.mean[name]
    spread = float(np.nanstd(run.measured[name]))
    share = float(np.sqrt(np.nanmean(error**2))) / spread if spread > 0 and np.isfinite(error).any() else np.nan
    error_text = f": RMS error {100 * share:.2g} %" if share == share else ""
    upper.set_title(f"free run of {style.term_label(name)}{error_text}")
    style.above(upper)
    return upper, lower


def _observed(eq: style.Answer, rows: MotionRows, target: str) -> Floats:
    """The target as it was observed; in a map only where the next sample and the earlier ones were."""
    return np.where(rows.known, rows.observed[target], np.nan) if eq.roles.discrete else rows.observed[target]


def _first_row(eq: style.Answer, n: int) -> int:
    """The first row that was held out, or that of the last fifth."""
    start = n - int((eq.data.holdout or LAST) * n)
    return start if start < n - 1 else 0


@style.picture
def one_step(
    eq: style.Answer,
    record: Record,
    ax: Any = None,
    *,
    target: str | None = None,
    start: int | None = None,
    rows: int | None = None,
) -> tuple[Axes, Axes]:
    """The target of an equation at the measured states and inputs of each row, eqs. (29) and (30), and the residual.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        With the channels that the equations were found from.
    ax : pair of matplotlib.axes.Axes, optional
        For the target and for the residual; by default those of a new figure.
    target : str, optional
        Which equation; by default the first.
    start, rows : int, optional
        First row, and how many; by default those held out, or the last fifth.

    Returns
    -------
    pair of matplotlib.axes.Axes
        The band holds 95 % of the measured samples, if the equation and the noise are right.

    Raises
    ------
    InputError
        Rows out of range.
    UnknownNameError
        No equation of this target, or a channel that is missing.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = style.equation_of(eq, target)
    motion = eq.motion(record)
    first = motion.n - int((eq.data.holdout or LAST) * motion.n) if start is None else start
    last = motion.n if rows is None else first + rows
    if not 0 <= first < last - 1 < motion.n:
        raise InputError(f"rows {first} to {last}: the record has {motion.n}; give a start and at least two rows in it")
    part = slice(first, last)
    mean, sd = equation.predict({name: values[part] for name, values in motion.columns.items()}, return_std=True)
    time = np.arange(first, last, dtype=np.float64) if motion.time is None else motion.time[part]
    measured = _observed(eq, motion, equation.target)[part]
    upper, lower = style.axes_for(ax, HEIGHTS, style.FULL_WIDTH, sharex=True)
    curve = (mean, mean - Z95 * sd, mean + Z95 * sd)
    _compare(upper, time, measured, curve, "one step", style.given_as(eq, equation.target))
    _residual(lower, time, measured, curve, "one step", style.given_as(eq, equation.target))
    across = "row" if motion.time is None else style.time_label(eq)
    lower.set(xlabel=across, ylabel=style.label_of(equation.target, equation.units, "residual"))
    label = style.label_of(equation.target, equation.units)
    upper.set(ylabel=label, title=f"one step of {style.term_label(equation.target)}")
    style.above(upper)
    return upper, lower


@style.picture
def measured_against_predicted(eq: style.Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
    """The target of an equation, measured or estimated, over its prediction from the states of the same row.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        With the channels that the equations were found from.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    target : str, optional
        Which equation; by default the first.

    Returns
    -------
    matplotlib.axes.Axes
        Rows used as dots, rows held out (the last of the record, as many as in `discover`) as crosses, and the line on
        which both are equal.

    Raises
    ------
    UnknownNameError
        No equation of this target, or a channel that is missing.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = style.equation_of(eq, target)
    rows = eq.motion(record)
    measured = _observed(eq, rows, equation.target)
    predicted = np.asarray(equation.predict(rows.columns))
    (ax,) = style.axes_for(ax, [70.0], style.SINGLE_COLUMN)
    every = style.thinned(rows.n)
    used = np.arange(rows.n)[every] < rows.n - int(eq.data.holdout * rows.n)
    look: dict[str, Any] = {"markersize": 2.6, "markeredgewidth": 0.6, "alpha": 0.6, "rasterized": True}
    kinds = ((used, ".", style.BLUE, "rows used"), (~used, "+", style.ORANGE, "rows held out"))
    for part, marker, colour, label in kinds:
        if part.any():
            ax.plot(predicted[every][part], measured[every][part], marker, color=colour, label=label, **look)
    ends = np.array([np.nanmin([measured, predicted]), np.nanmax([measured, predicted])])
    ax.plot(ends, ends, color=style.BLACK, linewidth=0.7, label="equal")
    error = measured - predicted
    r2 = 1.0 - float(np.nanvar(error) / np.nanvar(measured)) if np.nanvar(measured) > 0 else float("nan")
    ax.text(0.04, 0.96, f"$R^2$ = {r2:.4f}", transform=ax.transAxes, ha="left", va="top")
    ax.set_xlabel(style.label_of(equation.target, equation.units, "predicted {}"))
    ax.set_ylabel(style.label_of(equation.target, equation.units, f"{style.given_as(eq, equation.target)} {{}}"))
    style.titled(ax, eq, equation.target)
    ax.legend(loc="lower right", fontsize=7, markerscale=2.0, handlelength=1.4)
    return ax


@style.picture
def phase_portrait(
    eq: style.Answer,
    record: Record,
    ax: Any = None,
    *,
    states: tuple[str, str] | None = None,
    start: int | None = None,
    rows: int | None = None,
) -> Axes:
    """Two states against each other: as measured (or estimated), and along a free run.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`.
    record : Record
        With the channels that the equations were found from, and time.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    states : (str, str), optional
        Horizontal and vertical axis; by default the first two states, displacement and velocity.
    start, rows : int, optional
        First row of the free run, and how many; by default those held out, or the last fifth.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    InputError
        As `Equations.simulate`; a system of one state.
    UnknownNameError
        States that the equations do not have.
    MissingExtraError
        matplotlib is not installed.
    """
    chosen = states or eq.states[:2]
    if len(chosen) != 2:
        raise InputError("a phase portrait needs two states; the equations have one")
    for name in chosen:
        style.named("state", name, eq.states)
    motion = eq.motion(record)
    run = eq.simulate(record, draws=0, start=_first_row(eq, record.n) if start is None else start, rows=rows)
    (ax,) = style.axes_for(ax, [70.0], style.SINGLE_COLUMN)
    x, y = (motion.columns[name] for name in chosen)
    times = np.arange(motion.n) if motion.time is None else motion.time
    same = (times >= run.time[0]) & (times <= run.time[-1])
    # a map has points and no path
    every, dots = style.thinned(motion.n), {"linestyle": "none", "marker": "."} if eq.roles.discrete else {}
    ax.plot(x[every], y[every], color=style.PALE, linewidth=0.6, label="record", **dots)
    ax.plot(x[same], y[same], **MEASURED | {"label": "record, rows of the run"} | dots)
    across, up = (run.mean[name][style.thinned(len(run.time))] for name in chosen)
    ax.plot(across, up, label="free run", **DRAWN | dots)
    ax.plot(across[:1], up[:1], "o", color=style.BLACK, markersize=3.6, label="start")
    for values, fit in ((x, ax.set_xlim), (y, ax.set_ylim)):
        low, high = float(values.min()), float(values.max())
        margin = 0.1 * (high - low) or 1.0
        fit(low - margin, high + margin)
    ax.set(xlabel=style.label_of(chosen[0], eq.units), ylabel=style.label_of(chosen[1], eq.units))
    style.above(ax, handlelength=1.4, columnspacing=0.9)
    return ax
