"""The restoring-force curve, with the discovered one over it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.errors import UnknownNameError
from bayeq.figures.answer import Answer, equation_of
from bayeq.figures.comparison import BAND
from bayeq.figures.picture import GREY, label_of, one_axes, picture, plain, thinned, titled, unit_text
from bayeq.figures.restoring import discovered_force, measured_force, require_second_order
from bayeq.figures.style import BLUE
from bayeq.numerics.normal import Z95
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["restoring_force_curve"]

# Places along the curve.
PLACES = 400


@picture
def restoring_force_curve(
    eq: Answer, record: Record, ax: Any = None, *, target: str | None = None, over: str | None = None
) -> Axes:
    """The force of the spring over the displacement, measured and discovered; or that of the damper over the velocity.

    What was measured is the acceleration of each row less the equation's terms of other variables, with the other sign:
    per unit of mass.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`, with an equation of second order.
    record : Record
        With the channels that the equations were found from.
    ax : matplotlib.axes.Axes, optional
        By default those of a new figure.
    target : str, optional
        Which equation; by default the first.
    over : str, optional
        Displacement (by default) or velocity of the equation.

    Returns
    -------
    matplotlib.axes.Axes
        Those that were drawn on.

    Raises
    ------
    InputError
        An equation that is not of second order.
    UnknownNameError
        No equation of this target; `over` is neither its displacement nor its velocity.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = equation_of(eq, target)
    names = require_second_order(equation)
    name = over or names[0]
    if name not in names:
        raise UnknownNameError("displacement or velocity", name, names)
    rows = eq.motion(record)
    place = rows.columns[name]
    force = measured_force(equation, rows.columns, rows.observed[equation.target], [name])
    along = np.linspace(float(place.min()), float(place.max()), PLACES)
    mean, sd = discovered_force(equation, {name: along})
    ax = one_axes(ax)
    every = thinned(rows.n)
    dots: dict[str, Any] = {"color": GREY, "markersize": 1.8, "markeredgewidth": 0, "alpha": 0.7, "rasterized": True}
    ax.plot(place[every], force[every], "o", label="measured less other terms", **dots)
    ax.fill_between(along, mean - Z95 * sd, mean + Z95 * sd, label="95 % band", **BAND)
    ax.plot(along, mean, color=BLUE, linewidth=1.4, label="discovered")
    ax.set_xlabel(label_of(name, equation.units))
    unit = equation.units.get(equation.target)
    ax.set_ylabel(plain(f"restoring force per mass{f' [{unit_text(unit)}]' if unit else ''}"))
    titled(ax, eq, equation.target)
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        borderaxespad=0.2,
        ncols=3,
        fontsize=6.5,
        markerscale=2.0,
        handlelength=1.4,
        columnspacing=1.0,
    )
    return ax
