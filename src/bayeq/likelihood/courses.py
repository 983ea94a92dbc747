"""Courses, interpolations of inputs between samples: others are tried, and one that is clearly likelier is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.fit import State, of_inputs
from bayeq.likelihood.layout import Course
from bayeq.likelihood.model import Fitted, Task, calmed, finished, fit, of_motion
from bayeq.likelihood.search import CLEARLY, on_the_way
from bayeq.likelihood.start import with_courses
from bayeq.likelihood.unknowns import settled
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.states import Motion


class Tried(NamedTuple):
    """A fit with one course (interpolation) of an input."""

    task: Task
    fitted: Fitted
    # `of_motion` at the likeliest sizes of discrepancies, not averaged over sizes: comparable with coarse fits
    log: float

    @classmethod
    def of(cls, task: Task, fitted: Fitted) -> Tried:
        averages = 0.0 if fitted.averages is None else float(fitted.averages.sum())
        return cls(task, fitted, of_motion(task, fitted) - averages)


def with_other_inputs(motion: Motion, task: Task, best: Fitted) -> tuple[Task, Fitted]:
    """The fit, or one with other courses (interpolations) of inputs if these make the motion clearly likelier.

    Another course may move coefficients by more than noise does: `Task.between` gets their second moments over courses.
    If channels may be late, or there are hidden states, terms and constants can compensate for a wrong course, so that
    each course is compared after a search for its own terms and constants.
    """
    lagging = task.layout.late or bool(task.layout.roles.hidden)
    for k in range(len(task.layout.roles.inputs)):
        first = Tried.of(task, best if best.averages is not None else fit(task, best.state, coarse=True))
        others = list[Tried]()
        for group in with_courses(motion, task, best, k):
            for there, state in group if lagging else [max(group, key=lambda pair: at_once(*pair))]:
                try:
                    others.append(Tried.of(there, fit(there, noisier(there, calmed(state), k), coarse=True)))
                except np.linalg.LinAlgError:
                    continue
        others.sort(key=lambda one: -one.log)
        spread = [first, *others]
        likeliest = max(spread, key=lambda one: one.log)
        if lagging:
            near = [one for one in others if one.log > likeliest.log - LIKELIHOOD.neighbour_window]
            first, *near = [with_suitable(motion, one) for one in (first, *near)]
            likeliest = max([first, *near], key=lambda one: one.log)
        if likeliest.log - first.log > CLEARLY:
            there, found = likeliest.task, likeliest.fitted
            try:
                # `with_suitable` has already searched its terms
                pairs = [(task, best), (there, found) if lagging else on_the_way(there, found.state)]
                most = max(one.state.levels.kappa.max() for _, one in pairs)
                if best.averages is not None or most >= LIKELIHOOD.adequate:
                    # where a discrepancy is left coarse fits may be far from the likeliest levels
                    pairs = [(own, finished(own, one)) for own, one in pairs]
            except np.linalg.LinAlgError:
                continue
            task, best = max(pairs, key=lambda pair: of_motion(*pair))
        task = replace(task, between=task.between + spread_over(spread, task.layout.courses[k], k))
    return task, best


def spread_over(tried: Sequence[Tried], taken: Course, k: int) -> Floats:
    """Second moments, (C (P + 1),) squared, of coefficients over courses of input k, about those of course `taken`."""
    kinds: dict[Course, tuple[float, Floats]] = {}
    for i, (task, fitted, log) in enumerate(tried):
        theta = np.zeros(len(task.precision))
        theta[task.number(fitted.state.chosen)] = fitted.state.theta
        kinds.setdefault(task.layout.courses[k], (log - CLEARLY * (i > 0), theta))
    logs = np.array([log for log, _ in kinds.values()])
    weights = np.exp(logs - logs.max())
    apart = np.stack([theta for _, theta in kinds.values()]) - kinds[taken][1]
    return np.asarray((apart.T * weights / weights.sum()) @ apart)


def with_suitable(motion: Motion, tried: Tried) -> Tried:
    """The fit after a search for the constants and terms of its course; itself if these cannot be evaluated."""
    try:
        there, found = settled(motion, tried.task, tried.fitted)
        return Tried.of(*on_the_way(there, found.state))
    except np.linalg.LinAlgError:
        return tried


def at_once(task: Task, state: State) -> float:
    """`of_motion` at a start, before any fit and without the prior of its model."""
    return task.value(state) - of_inputs(task.linearised(state), state.levels)


def noisier(task: Task, state: State, k: int) -> State:
    """The state with the noise of input k raised to `input_noise`, so that a discrepancy does not explain it."""
    levels, i = state.levels, task.layout.first_input + k
    if not levels.learned[i]:
        return state
    variance = max(levels.channels[i], LIKELIHOOD.input_noise * levels.scales.channels[i])
    return replace(state, levels=levels.with_noise(i, variance))
