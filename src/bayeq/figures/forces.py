"""Restoring forces (Masri and Caughey 1979), measured and discovered, over one state and over two.

With unit mass, x'' + f(x, x') = driving terms: f is the driving terms less the acceleration.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import compress
from typing import TYPE_CHECKING, Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import evaluate_terms
from bayeq.errors import InputError
from bayeq.figures import style
from bayeq.figures.runs import BAND
from bayeq.numerics.distributions import Z95
from bayeq.records import Record
from bayeq.states import MotionRows

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FORCE = "restoring force per mass"

# Points along the curve; rings and rays of the surface; most samples drawn over it, which more would hide.
PLACES = 400
RINGS, RAYS = 24, 72
POINTS = 1500


def _second_order(equation: style.EquationLike) -> tuple[str, str]:
    """Names of displacement and velocity; InputError if the equation is not of second order."""
    if equation.chain.order != 2 or equation.chain.discrete:
        raise InputError(
            f"{equation.target}: a restoring force is that of an equation of second order, such as of the chain x:v:a;"
            f" this one is of order {equation.chain.order}"
        )
    return equation.chain.names[0], equation.chain.names[1]


def _measured(equation: style.EquationLike, rows: MotionRows, of: Iterable[str]) -> Floats:
    """Restoring force per mass of the variables `of` at each row, (n,): other terms less the measured acceleration."""
    p = equation.shown_posterior
    others = p.support & ~_own(equation, of)
    D = evaluate_terms([*compress(equation.terms, others)], rows.columns)
    return np.asarray(D @ p.coef[others] - rows.observed[equation.target])


def _discovered(equation: style.EquationLike, columns: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """The discovered force, intercept included, and its standard deviation at n places, (n,) each."""
    p, own = equation.shown_posterior, _own(equation, columns)
    D = evaluate_terms([*compress(equation.terms, own)], columns)
    # terms of other variables stay at their means
    Z, inside = D - p.constant.center[own], own[p.support]
    variance = np.einsum("ij,jk,ik->i", Z, p.covariance[np.ix_(inside, inside)], Z)
    return -p.intercept - D @ p.coef[own], np.sqrt(np.maximum(variance, 0.0))


def _own(equation: style.EquationLike, of: Iterable[str]) -> Bools:
    """Terms shown that use these variables alone, (P,)."""
    return equation.shown_posterior.support & [term.names <= set(of) for term in equation.terms]


@style.picture
def restoring_force_curve(
    eq: style.Answer, record: Record, ax: Any = None, *, target: str | None = None, over: str | None = None
) -> Axes:
    """The force of the spring over the displacement, measured and discovered; or that of the damper over the velocity.

    The measured force, per unit of mass, is the equation's terms of other variables less the acceleration, in each row.

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
        The axes that were drawn on.

    Raises
    ------
    InputError
        An equation that is not of second order.
    UnknownNameError
        No equation of this target; `over` is neither its displacement nor its velocity.
    MissingExtraError
        matplotlib is not installed.
    """
    equation = style.equation_of(eq, target)
    names = _second_order(equation)
    name = style.named("displacement or velocity", over, names)
    rows = eq.motion(record)
    place = rows.columns[name]
    force = _measured(equation, rows, [name])
    along = np.linspace(float(place.min()), float(place.max()), PLACES)
    mean, sd = _discovered(equation, {name: along})
    (ax,) = style.axes_for(ax, [70.0], style.SINGLE_COLUMN)
    every = style.thinned(rows.n)
    dots: dict[str, Any] = {"markersize": 1.8, "markeredgewidth": 0, "alpha": 0.7, "rasterized": True}
    label = f"{style.given_as(eq, equation.target)} less other terms"
    ax.plot(place[every], force[every], "o", color=style.GREY, label=label, **dots)
    ax.fill_between(along, mean - Z95 * sd, mean + Z95 * sd, label="95 % band", **BAND)
    ax.plot(along, mean, color=style.BLUE, linewidth=1.4, label="discovered")
    ax.set_xlabel(style.label_of(name, equation.units))
    ax.set_ylabel(style.label_of(equation.target, equation.units, FORCE))
    style.titled(ax, eq, equation.target)
    style.above(ax, fontsize=6.5, markerscale=2.0, handlelength=1.4, columnspacing=1.0)
    return ax


@style.picture
def restoring_force_surface(eq: style.Answer, record: Record, ax: Any = None, *, target: str | None = None) -> Axes:
    """The restoring force over displacement and velocity, measured and discovered (Masri and Caughey 1979).

    The measured force, per unit of mass, is the equation's terms of other variables (force, other coordinates) less the
    acceleration, in each row.

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
    equation = style.equation_of(eq, target)
    names = _second_order(equation)
    if ax is not None and not hasattr(ax, "plot_surface"):
        raise InputError("ax: a surface needs axes of three dimensions, figure.add_subplot(projection='3d')")
    rows = eq.motion(record)
    x, v = (rows.columns[name] for name in names)
    force = _measured(equation, rows, names)
    grid_x, grid_v = _ellipse(x, v)
    surface, _ = _discovered(equation, {names[0]: grid_x.ravel(), names[1]: grid_v.ravel()})
    if ax is None:
        ax = style.new_figure(style.SINGLE_COLUMN, 78.0).add_axes((0.11, 0.05, 0.87, 0.9), projection="3d")
        ax.set_box_aspect((1.0, 1.0, 0.75), zoom=1.0)
    every = style.thinned(rows.n, POINTS)
    look: dict[str, Any] = {"color": style.BLUE, "alpha": 0.4, "linewidth": 0.15, "edgecolor": style.BLUE}
    shape: dict[str, Any] = {"rcount": RINGS, "ccount": RAYS, "label": "discovered", "antialiased": True}
    ax.plot_surface(grid_x, grid_v, surface.reshape(grid_x.shape), **shape, **look)
    dots: dict[str, Any] = {"s": 2.2, "color": style.BLACK, "alpha": 0.6, "linewidths": 0, "rasterized": True}
    ax.scatter(x[every], v[every], force[every], label=style.given_as(eq, equation.target), depthshade=False, **dots)
    ax.set_xlabel(style.label_of(names[0], equation.units), labelpad=-2)
    ax.set_ylabel(style.label_of(names[1], equation.units), labelpad=-2)
    ax.set_zlabel(style.label_of(equation.target, equation.units, FORCE), labelpad=-1)
    ax.tick_params(pad=-2)
    ax.locator_params(nbins=5)
    # seen from the low side of the slope: from the high side the surface is seen edge-on
    ax.view_init(elev=28.0, azim=-122.0 if np.polyfit(x, force, 1)[0] >= 0.0 else -58.0)
    style.titled(ax, eq, equation.target)
    ax.legend(loc="upper right", fontsize=7, markerscale=3.0)
    return ax


def _ellipse(x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Grid of displacement and velocity on the ellipse that the motion fills, (RINGS, RAYS) each."""
    angle = np.linspace(0.0, 2.0 * np.pi, RAYS)
    radius = np.linspace(0.0, 1.0, RINGS)[:, None]
    middle = [0.5 * float(one.min() + one.max()) for one in (x, v)]
    half = [0.5 * float(np.ptp(one)) for one in (x, v)]
    # the farthest sample lies on the rim
    reach = np.sqrt(sum(((one - m) / (h or 1.0)) ** 2 for one, m, h in zip((x, v), middle, half, strict=True)))
    scale = min(float(reach.max()), np.sqrt(2.0))
    return (middle[0] + scale * half[0] * radius * np.cos(angle), middle[1] + scale * half[1] * radius * np.sin(angle))
