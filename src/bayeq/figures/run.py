"""A free run with its band, and what it leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.figures.answer import Answer, channel_of
from bayeq.figures.comparison import compare, mark_blow_up
from bayeq.figures.picture import above, label_of, picture, time_label, two_axes
from bayeq.figures.style import term_label
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["LAST", "first_row", "free_run"]

# Share of a record that is drawn where no rows were held out.
LAST = 0.2


@picture
def free_run(
    eq: Answer,
    record: Record,
    ax: Any = None,
    *,
    channel: str | None = None,
    start: int | None = None,
    rows: int | None = None,
    draws: int = 200,
) -> tuple[Axes, Axes]:
    """A free run of the equations against what was measured, with the band of the posterior's runs and the residual.

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
    run = eq.simulate(record, draws=draws, start=first_row(eq, record) if start is None else start, rows=rows)
    name = channel_of(run, channel)
    axes = two_axes(ax)
    compare(axes, run.time, run.measured[name], (run.mean[name], run.low.get(name), run.high.get(name)), "free run")
    mark_blow_up(axes, run.blew_up_at)
    units = {key: unit for equation in eq.equations for key, unit in equation.units.items()}
    axes[0].set_ylabel(label_of(name, units))
    axes[1].set_ylabel(label_of(name, units, "residual"))
    axes[1].set_xlabel(time_label(eq))
    error = run.measured[name] - run.mean[name]
    spread = float(np.nanstd(run.measured[name]))
    share = float(np.sqrt(np.nanmean(error**2))) / spread if spread > 0 and np.isfinite(error).any() else np.nan
    axes[0].set_title(
        f"free run of {term_label(name)}" + (f": RMS error {100 * share:.2g} %" if share == share else "")
    )
    above(axes[0])
    return axes


def first_row(eq: Answer, record: Record) -> int:
    """The first row that was held out, or that of the last fifth."""
    start = record.n - int((eq.data.holdout or LAST) * record.n)
    return start if start < record.n - 1 else 0
