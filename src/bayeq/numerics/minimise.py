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

# What is minimised: its value, or the value and the gradient.
Objective = Callable[[Floats], float | tuple[float, Floats]]

# Weak Wolfe conditions: the share of the decrease that the slope promises, and of the slope that may be left.
DECREASE, SLOPE_LEFT = 1e-4, 0.9
# Least share of a step that interpolation cuts it to, ratio by which one too short grows, and trials.
LEAST_CUT, GROWTH, TRIALS = 0.1, 4.0, 30
# Length of the first step, of which only the direction is known.
FIRST_STEP = 1.0
# A parameter this near to its bound, and pushed against it, moves by itself (the epsilon of Bertsekas).
NEAR_BOUND = 1e-3
# Least cosine between a step and the change of the gradient that it makes, for the change to be learnt from.
LEAST_CURVATURE = 1e-10
# Decreases that may be rounding, as shares of max(1, |value|).
ROUNDING = 1e-13
# Steps of differences, as shares of max(1, |parameter|).
DIFFERENCE = np.finfo(np.float64).eps ** (1.0 / 3.0)


class Minimum(NamedTuple):
    """Where `minimise` ended."""

    x: Floats  # (n,), the parameters
    value: float  # there
    gradient: Floats  # (n,), there
    converged: bool  # whether the search ended because of one of its tolerances
    evaluations: int  # points at which the function was computed, those of differences left out
    hessian: Floats | None  # (n, n), what is known of it from the steps; None where that is nothing, and none was given


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
    the Hessian is a full matrix.

    Parameters
    ----------
    fun : callable
        Of an (n,) array within the bounds. Returns the value, or the value and its gradient; without it, differences
        of second order are taken, 2n values for each gradient. Where the value is not finite, steps are cut.
    start : (n,) array_like
        Where the search starts; moved into the bounds.
    lower, upper : (n,) array_like or float
        Bounds, infinite where there is none. Parameters with equal bounds stay.
    hessian : (n, n) array_like, optional
        About what it is near the minimum; without, the first step only follows the gradient.
    longest : (n,) array_like or float
        How far a step goes in each parameter at most, before it is found to be too short.
    gradient_tolerance : float
        The search ends where the projected gradient, ``x - P(x - gradient)``, has no larger element.
    value_tolerance : float
        It ends too where a step decreases the value by no more than this, or than rounding.
    most_steps : int
        Steps at most.

    Returns
    -------
    Minimum
        The lowest point found; not converged if the start's value is not finite, no step leads down, or steps run out.

    References
    ----------
    Bertsekas, D. P. (1982). Projected Newton methods for optimization problems with simple constraints. SIAM Journal
    on Control and Optimization 20, 221-246.

    Examples
    --------
    >>> def rosenbrock(x):
    ...     return (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2
    >>> minimise(rosenbrock, [-1.2, 1.0]).x.round(4)
    array([1., 1.])
    >>> minimise(rosenbrock, [-1.2, 1.0], upper=[0.5, 2.0]).x.round(4)
    array([0.5 , 0.25])
    """
    at = np.array(start, dtype=np.float64)
    box = _Box(np.broadcast_to(lower, at.shape).astype(np.float64), np.broadcast_to(upper, at.shape).astype(np.float64))
    counted, limit = _Counted(fun, box), np.broadcast_to(longest, at.shape).astype(np.float64)
    known = None if hessian is None else np.asarray(hessian, dtype=np.float64)
    here = counted(box.project(at))
    learnt, converged = None, False
    for _ in range(most_steps if here.finite else 0):
        left = box.projected(here)
        converged = bool(np.abs(left).max(initial=0.0) <= gradient_tolerance)
        if converged:
            break
        fresh = np.eye(len(at)) * (float(np.linalg.norm(left)) / FIRST_STEP) if known is None else known
        step = box.direction(here, fresh if learnt is None else learnt)
        step *= np.min(limit / np.maximum(np.abs(step), np.finfo(np.float64).tiny), initial=1.0)
        there = _search(counted, box, here, step)
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
    return Minimum(
        here.x, here.value, here.gradient, converged, counted.evaluations, known if learnt is None else learnt
    )


class _Point(NamedTuple):
    """Parameters, with the value and the gradient there."""

    x: Floats
    value: float
    gradient: Floats

    @property
    def finite(self) -> bool:
        return math.isfinite(self.value) and bool(np.isfinite(self.gradient).all())


class _Box(NamedTuple):
    """Bounds of the parameters."""

    lower: Floats
    upper: Floats

    def project(self, x: Floats) -> Floats:
        return np.minimum(np.maximum(x, self.lower), self.upper)

    def projected(self, here: _Point) -> Floats:
        """The gradient as far as the bounds let it be followed: zero at a minimum."""
        return here.x - self.project(here.x - here.gradient)

    def direction(self, here: _Point, hessian: Floats) -> Floats:
        """The Newton step of free parameters, and one along its own axis for each that is pushed against its bound."""
        near = min(NEAR_BOUND, float(np.abs(self.projected(here)).max()))
        held = np.where(here.gradient > 0, here.x <= self.lower + near, here.x >= self.upper - near)
        out = -here.gradient / np.diagonal(hessian)
        free = np.flatnonzero(~held)
        if len(free):
            out[free] = -np.linalg.solve(hessian[np.ix_(free, free)], here.gradient[free])
        return out


class _Counted:
    """The function with its gradient, counted."""

    def __init__(self, fun: Objective, box: _Box) -> None:
        self.fun, self.box, self.evaluations = fun, box, 0

    def __call__(self, x: Floats) -> _Point:
        self.evaluations += 1
        found = self.fun(x)
        if isinstance(found, tuple):
            return _Point(x, float(found[0]), np.asarray(found[1], dtype=np.float64))
        return _Point(x, float(found), self._differences(x, float(found)))

    def _differences(self, x: Floats, value: float) -> Floats:
        """Gradient by central differences, by one-sided ones of the same order next to a bound."""
        gradient = np.zeros(len(x))
        room = self.box.upper - self.box.lower
        for i in map(int, np.flatnonzero(room > 0)):
            h = min(DIFFERENCE * max(1.0, abs(x[i])), room[i] / 4)
            side = 1.0 if x[i] - h < self.box.lower[i] else -1.0 if x[i] + h > self.box.upper[i] else 0.0
            if side:
                one, two = self._moved(x, i, side * h), self._moved(x, i, 2 * side * h)
                gradient[i] = side * (4 * one - two - 3 * value) / (2 * h)
            else:
                gradient[i] = (self._moved(x, i, h) - self._moved(x, i, -h)) / (2 * h)
        return gradient

    def _moved(self, x: Floats, i: int, by: float) -> float:
        moved = x.copy()
        moved[i] += by
        found = self.fun(moved)
        assert not isinstance(found, tuple)
        return float(found)


def _search(counted: _Counted, box: _Box, here: _Point, direction: Floats) -> _Point | None:
    """A point on the projected path with a sufficient decrease; None if there is none.

    The step is cut by quadratic interpolation where the decrease does not suffice, and grows where the slope along the
    path has hardly changed.
    """
    low, high, t = 0.0, math.inf, 1.0
    best = None
    for _ in range(TRIALS):
        x = box.project(here.x + t * direction)
        promised = float(here.gradient @ (x - here.x))
        if not promised < 0:
            # steps have become as small as rounding
            break
        there = counted(x)
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
