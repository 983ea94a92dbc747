"""The likelihood along single coefficients where it is not normal: bent ridges and other maxima.

A weak mode of vibration explains some of the noise at many frequencies: the likelihood has a maximum at each, or a long
ridge with waves, and a fit ends at the one whose basin its start is in. About a single maximum the log likelihood falls
by d^2/2 where a coefficient is held d standard deviations off and all others follow. Where it falls by clearly less, a
fit is begun again with large discrepancies: the likelihood is then nearly that of a regression of the targets on the
smoothed states, which has one maximum. Intervals reach as far as the likelihood does not fall.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import Quadratic, linearised, of_stated, quadratic, solved
from bayeq.likelihood.layout import NOTHING, Candidates
from bayeq.likelihood.linear import Linear
from bayeq.likelihood.model import Fitted, Task, fit
from bayeq.likelihood.search import CLEARLY, settle
from bayeq.numerics.distributions import Z95

# Distance in standard deviations at which the likelihood is compared with that of a single maximum, and the least fall
# [nats] that is taken for one. Where it differs from a normal one's by less than the share NORMAL with the others on
# the tangent, these need not follow.
FAR, NORMAL = 10.0, 0.1
FALL = 0.5 * FAR**2
AS_ONE = 0.8 * FALL

# Discrepancies that another fit begins with, as a share of the target, and its Gauss-Newton steps with these.
MUCH, CALM = 0.3, 12

# A likelihood that is not normal is followed until it is lower by LOW nats, in at most MOST steps: of FIRST standard
# deviations, then each longer than the one before by the factor LONGER. Other coefficients follow by STEPS Gauss-Newton
# steps.
LOW, MOST, FIRST, LONGER, STEPS = 8.0, 20, 0.7, 1.25, 2

# Number of places at which a likelihood that was followed is interpolated, for the ends of an interval.
PLACES = 2000


class Along:
    """The likelihood of a fit's model, levels given, along one coefficient with all others where they are likeliest.

    What holds for `former`, that of a fit to fewer rows, holds for more rows too.

    Attributes
    ----------
    covariance : (r, r) array
        That of the coefficients by the curvature at the fit.
    known : (r,) array of bool
        Coefficients along which the likelihood of `former` falls as a normal one.
    single : bool
        Whether no other maximum nearly as high was found.
    """

    def __init__(self, task: Task, fitted: Fitted, former: Along | None = None) -> None:
        self.task, self.fitted, self.state = task, fitted, fitted.state
        self.single: bool = former is not None and former.single
        self.known = np.zeros(len(fitted.state.theta), dtype=np.bool_)
        if former is not None:
            self.known = former.plain[fitted.model]
        self.precision = task.precision_of(fitted.state)
        information = fitted.quadratic.information[np.ix_(fitted.model, fitted.model)] / fitted.power
        self.covariance = solved(information + np.diag(self.precision), np.eye(len(self.precision)))

    @cached_property
    def top(self) -> float:
        """ln p(data, coefficients | levels) at the fit, up to a constant."""
        return self._level(self.state.theta, self._models(self.state.theta))

    @property
    def normal(self) -> bool:
        """Whether the likelihood falls as about a single maximum along each coefficient."""
        return bool((self.falls > AS_ONE).all())

    @cached_property
    def plain(self) -> Bools:
        """Whether it falls as a normal one along each coefficient of the model, among all, (C (P + 1),)."""
        out = np.zeros(len(self.fitted.model), dtype=np.bool_)
        out[self.fitted.model] = (np.abs(self.falls - FALL) <= NORMAL * FALL).all(axis=1)
        return out

    @cached_property
    def falls(self) -> Floats:
        """Falls at FAR standard deviations below and above each coefficient, (r, 2)."""
        out = np.full((len(self.known), 2), FALL)
        for k, way in itertools.product(np.flatnonzero(~self.known).tolist(), (0, 1)):
            there = self.state.theta + (2 * way - 1) * FAR * self._direction(k)
            out[k, way] = self._fall(k, there, 1, normal=FALL)[0]
        return out

    @cached_property
    def widths(self) -> Floats:
        """Half-widths of the coefficients' 95 % intervals that the likelihood along each gives, in normal ones, (r,);
        1 where it is normal, and at least 1."""
        out = np.ones(len(self.state.theta))
        for k in np.unique(np.argwhere(self.falls <= AS_ONE)[:, 0]).tolist():
            out = np.maximum(out, self._reached(k))
        return out

    def _reached(self, k: int) -> Floats:
        """Distances of all coefficients from the fit where that of coefficient k is at the end of its interval, in
        normal half-widths, (r,)."""
        (below, lower, under), (above, upper, over) = self._followed(k, -1.0), self._followed(k, 1.0)
        at, falls = np.append(-below[::-1], above[1:]), np.append(lower[::-1], upper[1:])
        moves = np.concatenate([under[::-1], over[1:]]) / np.sqrt(np.diagonal(self.covariance))
        places, power = np.linspace(at[0], at[-1], PLACES), self.fitted.power
        mass = np.cumsum(np.exp(-power * np.interp(places, at, np.sqrt(np.maximum(falls, 0.0))) ** 2))
        ends = np.interp([0.025, 0.975], mass / mass[-1], places)
        reached = [float(np.abs(np.interp(ends, at, one)).max()) for one in moves.T]
        return np.array(reached) * math.sqrt(power) / Z95

    def _followed(self, k: int, way: float) -> tuple[Floats, Floats, Floats]:
        """Distances from the fit to one side of coefficient k, in standard deviations, the falls there, and the changes
        of all coefficients, (m, r)."""
        before, now = self.state.theta, self.state.theta + way * FIRST * self._direction(k)
        places, falls, changes = [0.0, FIRST], [0.0], [np.zeros(len(before))]
        while len(falls) < MOST:
            fall, there = self._fall(k, now, STEPS)
            if not math.isfinite(fall):  # the path does not lead there
                fall, there = LOW / self.fitted.power, now
            falls.append(fall)
            changes.append(there - self.state.theta)
            if fall * self.fitted.power >= LOW:
                break
            before, now = there, there + LONGER * (there - before)
            places.append((1.0 + LONGER) * places[-1] - LONGER * places[-2])
        return np.array(places[: len(falls)]), np.array(falls), np.array(changes)

    def _direction(self, k: int) -> Floats:
        """Change of all coefficients by one standard deviation of coefficient k, (r,)."""
        return np.asarray(self.covariance[:, k] / np.sqrt(self.covariance[k, k]))

    def _fall(self, k: int, theta: Floats, steps: int, normal: float = math.inf) -> tuple[float, Floats]:
        """Fall of the likelihood from the fit to where coefficient k is that of `theta`, and all coefficients there:
        the others after Gauss-Newton steps from `theta`, which end where the fall is about `normal`."""
        rest, theta = np.arange(len(theta)) != k, theta.copy()
        try:
            linears = self._models(theta)
            if normal < math.inf:
                fall = self.top - self._level(theta, linears)
                if abs(fall - normal) <= NORMAL * normal:
                    return fall, theta
            for _ in range(steps):
                found = self._expanded(theta, linears)
                theta[rest] += solved(found.information[np.ix_(rest, rest)], found.slope[rest])
                linears = self._models(theta)
            fall = self.top - self._level(theta, linears)
        except np.linalg.LinAlgError:
            return math.inf, theta
        return fall if math.isfinite(fall) else math.inf, theta

    def _expanded(self, theta: Floats, linears: Sequence[Linear]) -> Quadratic:
        """ln p(data, coefficients | levels) up to a constant, about coefficients and the models there."""
        found = self._filtered(linears, self.state.chosen)
        found += of_stated(self.state.levels.layout.stated, self.state.chosen, theta)
        pull = self.precision * theta
        return found + Quadratic(-0.5 * float(theta @ pull), -pull, np.diag(self.precision))

    def _level(self, theta: Floats, linears: Sequence[Linear]) -> float:
        """The same there, without its slope and information."""
        stated = of_stated(self.state.levels.layout.stated, self.state.chosen, theta)
        return self._filtered(linears, NOTHING).level + stated.level - 0.5 * float(self.precision @ theta**2)

    def _filtered(self, linears: Sequence[Linear], columns: Candidates) -> Quadratic:
        return quadratic([run_filter(one, columns, self.state.levels.noise, keep=False) for one in linears])

    def _models(self, theta: Floats) -> list[Linear]:
        return linearised(self.task.layout, self.task.series, replace(self.state, theta=theta), self.task.substeps)


def another(along: Along) -> tuple[Task, Fitted] | None:
    """The fit about another maximum; None if the likelihood has one maximum, or none is nearly as high as this."""
    task, fitted = along.task, along.fitted
    if along.normal or along.single:
        return None
    levels = fitted.state.levels
    discrepancy = np.maximum(levels.discrepancy, MUCH**2 * levels.target)
    much = replace(levels, discrepancy=discrepancy, memory=levels.longest, hessian=None)
    task, other = settle(task, fit(task, replace(fitted.state, levels=much), calm=CALM).state)
    same = bool((other.model == fitted.model).all()) and not farthest(along, other, 1.0)
    along.single = same or other.evidence < fitted.evidence - CLEARLY
    return None if along.single else (task, other)


def farthest(along: Along, other: Fitted, widths: Floats | float) -> dict[str, float]:
    """The coefficient of another fit that is farthest outside of its 95 % interval in a fit, in half-widths; empty if
    none is."""
    task, fitted = along.task, along.fitted
    sd, theta, there = np.ones((3, len(fitted.model)))
    sd[fitted.model] = widths * np.sqrt(np.diagonal(along.covariance) / fitted.power)
    theta[fitted.model], there[other.model] = fitted.state.theta, other.state.theta
    apart = np.where(fitted.model & other.model, np.abs(there - theta) / sd, 0.0)
    at = int(np.argmax(apart))
    if apart[at] <= Z95:
        return {}
    c, j = divmod(at, len(task.layout.terms) + 1)
    term = task.layout.terms[j].text if j < len(task.layout.terms) else "the constant"
    return {f"{term} in {task.layout.roles.targets[c]}": float(there[at])}
