"""The likelihood along a constant inside terms where it is not normal: along a bent ridge, or to the end of its range.

Two constants, or a constant and coefficients, may have nearly the same effect: the combinations that the record allows
then bend away from the tangent at the likeliest point. There intervals come from fits with the constant held at several
values; at each the coefficients and the other constants are normal.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary.ranges import ConstantEstimate, constants_of, jumps_at, to_plain, to_scale
from bayeq.likelihood.fit import State
from bayeq.likelihood.model import Task, fit
from bayeq.likelihood.unknowns import NEAR, STEPS, as_one, at_values, joint_covariance, stepped, with_tangents
from bayeq.numerics.distributions import Z95

# A normal likelihood is lower by 2 nats at FAR standard deviations. One that differs from this by more than BENT, which
# moves the end of an interval by an eighth, is followed each way until it is lower by LOW, or for MOST fits. The first
# step is a standard deviation, and steps double while the likelihood changes by less than BENT; intervals over which it
# changes by more than STEEP are halved, at most MOST times.
FAR, BENT, STEEP, LOW, MOST = 2.0, 0.5, 1.5, 5.0, 6

# Number of places at which the likelihood is interpolated, to see where an interval ends.
PLACES = 400


class Node(NamedTuple):
    """Fit with a constant held at a value: on scales of the constants, and given this value."""

    name: str  # of the constant
    place: float
    value: float  # largest log likelihood, up to a constant
    theta: Floats  # (r,), coefficients
    covariance: Floats  # (r, r), of these
    others: Mapping[str, tuple[float, float]]  # place and standard deviation of the other constants
    now: tuple[Task, State]


@dataclass(frozen=True, eq=False)
class Profile:
    """Fits along a constant."""

    nodes: Sequence[Node]  # by place
    best: Node  # the one at the constant's estimate

    def applied(
        self, estimates: Sequence[ConstantEstimate], power: float
    ) -> tuple[Floats, tuple[ConstantEstimate, ...]]:
        """Covariance of the coefficients, and the estimates of constants with intervals along the profile, by the
        likelihood raised to a power."""
        from scipy.interpolate import PchipInterpolator

        at, logs = np.array([one.place for one in self.nodes]), power * np.array([one.value for one in self.nodes])
        # trapezoidal weights of the nodes
        weight = np.exp(logs - logs.max()) * (np.append(np.diff(at), 0.0) + np.append(0.0, np.diff(at)))
        weight /= weight.sum()
        apart = np.array([one.theta - self.best.theta for one in self.nodes])
        within = np.array([one.covariance for one in self.nodes]) / power
        covariance = np.tensordot(weight, within, 1) + (weight[:, None] * apart).T @ apart
        places = np.linspace(at[0], at[-1], PLACES)
        likely = places[PchipInterpolator(at, logs)(places) > logs.max() - 0.5 * Z95**2]
        found = []
        for one in estimates:
            if one.sd is None:
                found.append(one)
                continue
            where, sds = np.array([node.others.get(one.name, (node.place, 0.0)) for node in self.nodes]).T
            mean = float(weight @ where)
            sd = math.sqrt(float(weight @ ((where - mean) ** 2 + sds**2 / power)))
            ends = [mean - Z95 * sd, mean + Z95 * sd]
            if one.name == self.best.name:
                ends = [float(likely[0]), float(likely[-1])]
            low, high = np.exp(ends).tolist() if one.logarithmic else ends
            found.append(replace(one, sd=sd, ci95=(max(low, one.low), min(high, one.high))))
        return covariance, tuple(found)


def profile_of(task: Task, state: State) -> Profile | None:
    """Fits along the constant whose likelihood differs most from a normal one; None if none differs by BENT."""
    _, estimates = joint_covariance(task, state)
    constants, terms = constants_of(task.layout.terms), task.layout.terms
    worst: tuple[float, float, Node | None] = BENT, 0.0, None
    for one in estimates:
        if one.sd is None or any(jumps_at(term, one.name) for term in terms if one.name in term.unknowns):
            continue
        constant = constants[one.name]
        place, ends = to_scale(constant, one.value), [to_scale(constant, end) for end in (one.low, one.high)]
        best, bent = _node((task, state), one.name, place), 0.0
        for way in (-1.0, 1.0):
            there = float(np.clip(place + way * FAR * one.sd, ends[0], ends[1]))
            expected = -0.5 * ((there - place) / one.sd) ** 2
            try:
                change = _node(best.now, one.name, there).value - best.value if there != place else 0.0
                bent = max(bent, abs(change - expected))
            except np.linalg.LinAlgError:
                bent = math.inf
        worst = max(worst, (bent, one.sd, best), key=lambda each: each[0])
    return None if worst[2] is None else _followed(worst[2], worst[1])


def _followed(best: Node, sd: float) -> Profile:
    """The profile along the constant of a node, its best one."""
    constant = constants_of(best.now[0].layout.terms)[best.name]
    ends, found = [to_scale(constant, end) for end in (constant.low, constant.high)], [best]
    with suppress(np.linalg.LinAlgError):
        for way in (-1.0, 1.0):
            last, step = best, sd
            for _ in range(MOST):
                there = float(np.clip(last.place + way * step, ends[0], ends[1]))
                if last.value < best.value - LOW or there == last.place:
                    break
                with suppress(np.linalg.LinAlgError):
                    found.append(_node(last.now, best.name, there))
                    step *= 2.0 if abs(found[-1].value - last.value) < BENT else 1.0
                    last = found[-1]
                    continue
                step *= 0.5  # the fit does not stay near the motion
        for _ in range(MOST):
            found.sort(key=lambda one: one.place)
            steep = [
                (abs(a.value - b.value), a, b)
                for a, b in itertools.pairwise(found)
                if max(a.value, b.value) > best.value - LOW
            ]
            change, one, other = max(steep, key=lambda each: each[0], default=(0.0, best, best))
            if change < STEEP:
                break
            nearest = max(one, other, key=lambda each: each.value)
            found.append(_node(nearest.now, best.name, 0.5 * (one.place + other.place)))
    return Profile(sorted(found, key=lambda one: one.place), best)


def _node(now: tuple[Task, State], name: str, place: float) -> Node:
    """The fit with a constant held at a place on its scale, other constants where they are likeliest."""
    constants = constants_of(now[0].layout.terms)
    now = at_values(*now, {name: to_plain(constants[name], place)})
    for _ in range(STEPS if len(constants) > 1 else 0):
        now, farthest = stepped(*now, held=name)
        if farthest < NEAR:
            break
    task, fitted = now[0], fit(*now)
    own, wide, tangents = with_tangents(task, fitted.state, name)
    _, covariance, first = as_one(tangents, wide.theta, own.marginal(wide, keep=False).covariance)
    sds, r = np.sqrt(np.diagonal(covariance)), len(fitted.state.theta)
    # the evidence is that maximum times the volume of likely coefficients, which grows along a ridge by itself
    volume = float(np.linalg.slogdet(task.marginal(fitted.state, keep=False).covariance)[1])
    constants = constants_of(task.layout.terms)
    others = {key: (to_scale(constants[key], constants[key].value), float(sds[k])) for key, k in first.items()}
    state, value = fitted.state, fitted.evidence - 0.5 * volume
    return Node(name, place, value, state.theta, covariance[:r, :r], others, (task, state))
