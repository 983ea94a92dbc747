"""The restoring-force surface, with the discovered one through it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.figures.answer import Answer, equation_of
from bayeq.figures.picture import label_of, picture, plain, thinned, titled, unit_text
from bayeq.figures.restoring import discovered_force, measured_force, require_second_order
from bayeq.figures.style import BLACK, BLUE, SINGLE_COLUMN, new_figure
from bayeq.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["restoring_force_surface"]

Floats = NDArray[np.float64]

# More points hide the surface.
POINTS = 1500
RINGS, RAYS = 24, 72


@picture
def restoring_force_surface(eq: Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
    """The restoring force over displacement and velocity, measured and discovered (Masri and Caughey 1979).

    What was measured is the acceleration of each row less the equation's terms of other variables (force, other
    coordinates), with the other sign: per unit of mass.

    Parameters
    ----------
    eq : Equations
        From `discover` or `load`, with an equation of second order.
    record : Record
        With the channels that the equations were found from.
    ax : mpl_toolkits.mplot3d.Axes3D, optional
        With ``projection="3d"``; by default those of a new figure.
    target : str, optional
        Which equation; by default the first.

    Returns
    -------
    mpl_toolkits.mplot3d.Axes3D
        Samples as dots; the discovered surface within the ellipse that the motion fills.

    Raises
    ------
    InputError
        An equation that is not of second order; axes without three dimensions.
    UnknownNameError
        No equation of this target, or a channel that is missing.
    MissingExtraError
        matplotlib is not installed.

    References
    ----------
    S. F. Masri and T. K. Caughey, "A nonparametric identification technique for nonlinear dynamic problems", Journal of
    Applied Mechanics 46(2), 433-447, 1979.
    """
    equation = equation_of(eq, target)
    names = require_second_order(equation)
    if ax is not None and not hasattr(ax, "plot_surface"):
        raise InputError("ax: a surface needs axes of three dimensions, figure.add_subplot(projection='3d')")
    rows = eq.motion(record)
    x, v = (rows.columns[name] for name in names)
    force = measured_force(equation, rows.columns, rows.observed[equation.target], names)
    grid_x, grid_v = _ellipse(x, v)
    surface, _ = discovered_force(equation, {names[0]: grid_x, names[1]: grid_v})
    if ax is None:
        ax = new_figure(SINGLE_COLUMN + 20.0, 88.0).add_axes((0.0, 0.03, 0.9, 0.93), projection="3d")
        ax.set_box_aspect((1.0, 1.0, 0.8), zoom=1.08)
    every = thinned(rows.n, POINTS)
    look: dict[str, Any] = {"color": BLUE, "alpha": 0.35, "linewidth": 0.15, "edgecolor": BLACK, "antialiased": True}
    ax.plot_surface(grid_x, grid_v, surface, rcount=RINGS, ccount=RAYS, label="discovered", **look)
    ax.scatter(
        x[every],
        v[every],
        force[every],
        s=1.6,
        color=BLACK,
        alpha=0.5,
        linewidths=0,
        label="measured",
        depthshade=False,
        rasterized=True,
    )
    ax.set_xlabel(label_of(names[0], equation.units), labelpad=-2)
    ax.set_ylabel(label_of(names[1], equation.units), labelpad=-2)
    unit = equation.units.get(equation.target)
    ax.set_zlabel(plain(f"restoring force per mass{f' [{unit_text(unit)}]' if unit else ''}"), labelpad=-1)
    ax.tick_params(pad=-2)
    ax.locator_params(nbins=5)
    ax.view_init(elev=26.0, azim=-52.0)
    titled(ax, eq, equation.target)
    ax.legend(loc="upper right", fontsize=7, markerscale=3.0)
    return ax


def _ellipse(x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Rings and rays of the ellipse that motion fills, (RINGS, RAYS) each."""
    angle = np.linspace(0.0, 2.0 * np.pi, RAYS)
    radius = np.linspace(0.0, 1.0, RINGS)[:, None]
    middle = [0.5 * float(one.min() + one.max()) for one in (x, v)]
    half = [0.5 * float(np.ptp(one)) for one in (x, v)]
    # the farthest sample lies on the rim
    reach = np.sqrt(sum(((one - m) / (h or 1.0)) ** 2 for one, m, h in zip((x, v), middle, half, strict=True)))
    scale = min(float(reach.max()), np.sqrt(2.0))
    return (middle[0] + scale * half[0] * radius * np.cos(angle), middle[1] + scale * half[1] * radius * np.sin(angle))
