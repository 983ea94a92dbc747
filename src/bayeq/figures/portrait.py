"""The phase portrait."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayeq.errors import InputError, UnknownNameError
from bayeq.figures.answer import Answer
from bayeq.figures.picture import GREY, label_of, one_axes, picture, thinned
from bayeq.figures.run import first_row
from bayeq.figures.style import BLACK, BLUE
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["phase_portrait"]


@picture
def phase_portrait(
    eq: Answer,
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
        Across and up; by default the first two: displacement and velocity.
    start, rows : int, optional
        First row of the free run, and how many; by default those held out, or the last fifth.

    Returns
    -------
    matplotlib.axes.Axes
        Those that were drawn on.

    Raises
    ------
    InputError
        As `Equations.simulate`; a system of one state.
    UnknownNameError
        States that are none of the equations'.
    MissingExtraError
        matplotlib is not installed.
    """
    names = [name for equation in eq.equations for name in equation.chain.states]
    chosen = states or tuple(names[:2])
    if len(chosen) != 2:
        raise InputError("a phase portrait needs two states; the equations have one")
    for name in chosen:
        if name not in names:
            raise UnknownNameError("state", name, names)
    motion = eq.motion(record)
    run = eq.simulate(record, draws=0, start=first_row(eq, record) if start is None else start, rows=rows)
    ax = one_axes(ax, height=58.0)
    x, y = (motion.columns[name][thinned(motion.n)] for name in chosen)
    ax.plot(x, y, color=GREY, linewidth=0.4, label="record")
    across, up = (run.mean[name][thinned(len(run.time))] for name in chosen)
    ax.plot(across, up, color=BLUE, linewidth=1.0, label="free run")
    ax.plot(across[:1], up[:1], "o", color=BLACK, markersize=3.6, label="its start")
    limits = [(float(one.min()), float(one.max())) for one in (x, y)]
    for (low, high), fit in zip(limits, (ax.set_xlim, ax.set_ylim), strict=True):
        margin = 0.1 * (high - low) or 1.0
        fit(low - margin, high + margin)
    units = {key: unit for equation in eq.equations for key, unit in equation.units.items()}
    ax.set_xlabel(label_of(chosen[0], units))
    ax.set_ylabel(label_of(chosen[1], units))
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=3, fontsize=7)
    return ax
