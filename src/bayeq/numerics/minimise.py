"""The minimum of a smooth function of a few parameters within bounds, by a projected quasi-Newton method.

SciPy's `minimize` does the same for any number of parameters; importing it takes longer than what is minimised here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Floats

# The function to minimise, which returns its value and gradient.
Objective = Callable[[Floats], tuple[float, Floats]]

# Weak Wolfe conditions: least share of the decrease that the slope predicts, largest share of the slope that is left.
DECREASE, SLOPE_LEFT = 1e-4, 0.9
# Line search: smallest factor that cuts a step, factor that lengthens one that is too short, number of trials.
LEAST_CUT, GROWTH, TRIALS = 0.1, 4.0, 30
# Length of the first step, of which only the direction is known.
FIRST_STEP = 1.0
# A parameter this near to its bound, and pushed against it, gets a step of its own (the epsilon of Bertsekas).
NEAR_BOUND = 1e-3
# Least cosine between a step and its change of the gradient for a BFGS update.
LEAST_CURVATURE = 1e-10
# Smaller decreases may be rounding, as shares of max(1, |value|).
ROUNDING = 1e-13


class Minimum(NamedTuple):
    """Result of `minimise`."""

    x: Floats  # (n,), the parameters
    value: float
    gradient: Floats  # (n,)
    converged: bool  # whether the search ended because of one of its tolerances
    hessian: Floats | None  # (n, n), BFGS estimate, or the given one if no step was learnt from; None without both


def minimise(
    fun: Objective,
    start: ArrayLike,
    lower: ArrayLike = -math.inf,
    upper: ArrayLike = math.inf,
    *,
    hessian: ArrayLike | None = None,
    longest: ArrayLike = math.inf,
    gradient_tolerance: float = 1e-6,
    value_tolerance: float = 0.0,
    most_steps: int = 200,
) -> Minimum:
    """Local minimum of a smooth function within bounds.

    Each step goes along ``x(t) = P(x + t d)``, P the projection onto the bounds, until it satisfies the weak Wolfe
    conditions. For the parameters that no bound holds d is a Newton step with the Hessian as BFGS updates it; each of
    the others descends by itself, so that d is a direction of descent even where P bends it. For a few parameters:
    the Hessian is a full matrix. (Bertsekas, D. P. (1982). Projected Newton methods for optimization problems with
    simple constraints. SIAM Journal on Control and Optimization 20, 221-246.)

    `fun` gives the value and its gradient at an (n,) array within the bounds; where they are not finite, steps are cut.
    The search starts at `start`, (n,), moved into the bounds `lower` and `upper`, (n,) or one for all, infinite where
    there is none; parameters with equal bounds stay. `hessian`, (n, n), is an estimate near the minimum; without it the
    first step only follows the gradient. A step is at first at most `longest` in each parameter, (n,) or one for all,
    but grows if it is found to be too short.

    The search ends where the projected gradient, ``x - P(x - gradient)``, has no element above `gradient_tolerance`,
    where a step decreases the value by no more than `value_tolerance`, or than rounding, or after `most_steps`. It has
    not converged if the start's value is not finite, no step leads down, or steps run out.

    Examples
    --------
    >>> def rosenbrock(x):
    ...     bent = x[1] - x[0] ** 2
    ...     return (1 - x[0]) ** 2 + 100 * bent**2, np.array([2 * (x[0] - 1) - 400 * x[0] * bent, 200 * bent])
    >>> minimise(rosenbrock, [-1.2, 1.0]).x.round(4)
    array([1., 1.])
    >>> minimise(rosenbrock, [-1.2, 1.0], upper=[0.5, 2.0]).x.round(4)
    array([0.5 , 0.25])
    """
    at = np.array(start, dtype=np.float64)
    box = _Box(np.broadcast_to(lower, at.shape).astype(np.float64), np.broadcast_to(upper, at.shape).astype(np.float64))
    limit = np.broadcast_to(longest, at.shape).astype(np.float64)
    known = None if hessian is None else np.asarray(hessian, dtype=np.float64)
    here = _at(fun, box.project(at))
    learnt, converged = None, False
    for _ in range(most_steps if here.finite else 0):
        left = box.projected(here)
        converged = bool(np.abs(left).max(initial=0.0) <= gradient_tolerance)
        if converged:
            break
        fresh = np.eye(len(at)) * (float(np.linalg.norm(left)) / FIRST_STEP) if known is None else known
        step = box.direction(here, fresh if learnt is None else learnt)
        with np.errstate(over="ignore"):  # of a step of 0
            step *= np.min(limit / np.maximum(np.abs(step), np.finfo(np.float64).tiny), initial=1.0)
        there = _search(fun, box, here, step)
        if there is None and learnt is None:
            break
        if there is None:
            # what was learnt elsewhere may not hold here
            learnt = None
            continue
        converged = here.value - there.value <= max(value_tolerance, ROUNDING * max(1.0, abs(here.value)))
        learnt = _updated(known if learnt is None else learnt, there.x - here.x, there.gradient - here.gradient)
        here = there
        if converged:
            break
    return Minimum(*here, converged, known if learnt is None else learnt)


class _Point(NamedTuple):
    """Parameters, with the value and the gradient there."""

    x: Floats
    value: float
    gradient: Floats

    @property
    def finite(self) -> bool:
        return math.isfinite(self.value) and bool(np.isfinite(self.gradient).all())


class _Box(NamedTuple):
    lower: Floats
    upper: Floats

    def project(self, x: Floats) -> Floats:
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def projected(self, here: _Point) -> Floats:
        """The projected gradient, ``x - P(x - gradient)``: zero at a minimum."""
        return here.x - self.project(here.x - here.gradient)

    def direction(self, here: _Point, hessian: Floats) -> Floats:
        """The Newton step of free parameters, and a step along its axis for each parameter pushed against its bound."""
        near = min(NEAR_BOUND, float(np.abs(self.projected(here)).max()))
        held = np.where(here.gradient > 0, here.x <= self.lower + near, here.x >= self.upper - near)
        out = -here.gradient / np.diagonal(hessian)
        free = np.flatnonzero(~held)
        if len(free):
            out[free] = -np.linalg.solve(hessian[np.ix_(free, free)], here.gradient[free])
        return out


def _at(fun: Objective, x: Floats) -> _Point:
    value, gradient = fun(x)
    return _Point(x, float(value), np.asarray(gradient, dtype=np.float64))


def _search(fun: Objective, box: _Box, here: _Point, direction: Floats) -> _Point | None:
    """A point on the projected path with a sufficient decrease, the step cut or grown; None if there is none."""
    low, high, t = 0.0, math.inf, 1.0
    best = None
    for _ in range(TRIALS):
        x = box.project(here.x + t * direction)
        promised = float(here.gradient @ (x - here.x))
        if not promised < 0:
            # steps have become as small as rounding
            break
        there = _at(fun, x)
        if not (there.finite and there.value <= here.value + DECREASE * promised):
            excess = there.value - here.value - promised
            cut = min(0.5, max(LEAST_CUT, -0.5 * promised / excess)) if there.finite else LEAST_CUT
            high, t = t, cut * t if low == 0 else 0.5 * (low + t)
            continue
        if best is None or there.value < best.value:
            best = there
        moving = (x > box.lower) & (x < box.upper)
        slope, left = (float(p.gradient[moving] @ direction[moving]) for p in (here, there))
        if left >= SLOPE_LEFT * slope:
            break
        low, t = t, GROWTH * t if high == math.inf else 0.5 * (t + high)
    return best


def _updated(hessian: Floats | None, step: Floats, change: Floats) -> Floats | None:
    """BFGS update; the first one starts from a multiple of the identity that has the curvature along the step."""
    curvature = float(step @ change)
    if not curvature > LEAST_CURVATURE * float(np.linalg.norm(step) * np.linalg.norm(change)):
        return hessian
    if hessian is None:
        hessian = np.eye(len(step)) * (float(change @ change) / curvature)
    along = hessian @ step
    new = hessian + np.outer(change, change) / curvature - np.outer(along, along) / float(step @ along)
    return np.asarray(0.5 * (new + new.T))
