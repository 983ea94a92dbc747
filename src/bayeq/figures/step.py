"""One step: the target at the measured states, with its band, and what it leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import InputError
from bayeq.figures.answer import Answer, equation_of
from bayeq.figures.comparison import compare
from bayeq.figures.picture import above, label_of, picture, time_label, two_axes
from bayeq.figures.run import LAST
from bayeq.figures.style import term_label
from bayeq.numerics.normal import Z95
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["one_step"]


@picture
def one_step(
    eq: Answer,
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
    equation = equation_of(eq, target)
    motion = eq.motion(record)
    first = motion.n - int((eq.data.holdout or LAST) * motion.n) if start is None else start
    last = motion.n if rows is None else first + rows
    if not 0 <= first < last - 1 < motion.n:
        raise InputError(f"rows {first} to {last}: the record has {motion.n}; give a start and at least two rows in it")
    part = slice(first, last)
    columns = {name: values[part] for name, values in motion.columns.items()}
    mean, sd = equation.predict(columns, return_std=True)
    time = np.arange(first, last, dtype=np.float64) if motion.time is None else motion.time[part]
    axes = two_axes(ax)
    measured = motion.observed[equation.target][part]
    compare(axes, time, measured, (mean, mean - Z95 * sd, mean + Z95 * sd), "one step")
    axes[0].set_ylabel(label_of(equation.target, equation.units))
    axes[1].set_ylabel(label_of(equation.target, equation.units, "residual"))
    axes[1].set_xlabel("row" if motion.time is None else time_label(eq))
    axes[0].set_title(f"one step of {term_label(equation.target)}")
    above(axes[0])
    return axes
