"""The search for the coefficients that are not zero.

1. `on_the_way`, from each start: linearise, select on the Gram of all candidates, fit, and again until the model
   stays.
2. `bayeq.likelihood.courses.with_other_inputs`: other courses of the inputs between samples are tried.
3. `from_all_levels` fits the model.
4. `resumed`: the model that was found on some rows is fitted to all, in rounds as in 1.
5. `bayeq.likelihood.spike`: flips and swaps of single terms, each compared by the evidence of its own fit.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial

import numpy as np

from bayeq.inference.collapsed.search import best_models, neighbours
from bayeq.likelihood.fit import State
from bayeq.likelihood.model import (
    Fitted,
    Task,
    finer,
    fit,
    from_all_levels,
    over_all_sizes,
    with_model,
    with_small_discrepancy,
)
from bayeq.numerics.settings import LIKELIHOOD

# Most rounds of linearisation and selection.
ROUNDS = 8

# Shares of the candidates, those of the smallest expressions, that are searched first.
SIMPLEST = (0.25, 0.5)

# Approximate number of samples at which the growth of deviations from the path is checked.
CHECKED = 500

# All candidates together are a start if there are at most this many.
MOST_AT_ONCE = 40

# With more samples than this the Gram of a fit tells its neighbours apart, and they are not fitted.
MOST_TO_MOVE = 100_000

# A state, or a function that returns one or None when it is needed; of a tuple the first that a fit can begin from.
Once = State | Callable[[], State | None]
Start = Once | tuple[Once, ...]

# Factors by which the prior variance of coefficients may be increased, if that is likelier by this many nats.
WIDER, CLEARLY = (10.0, 100.0), 3.0


def widened(task: Task, fitted: Fitted) -> Task:
    """The task with a wider prior of the coefficients, which terms that cancel need, if it is clearly likelier."""
    tasks = [task, *(replace(task, precision=task.precision / factor) for factor in WIDER)]
    values = [best_models(one.problem(fitted.quadratic))[0][0] for one in tasks]
    return tasks[int(np.argmax(np.array(values) - CLEARLY * (np.arange(len(tasks)) > 0)))]


def likeliest(task: Task, fitted: Fitted) -> State:
    """A start for the likeliest model, cut down term by term until its motion stays near the path over a step."""
    problem = task.problem(fitted.quadratic)
    path = [best_models(problem)[0][1]]

    @cache
    def shortened(by: int) -> State:
        while len(path) <= by:
            removals = [move for move in neighbours(problem, path[-1], math.inf) if move.enters is None]
            if not removals:
                break
            path.append(removals[0].apply(path[-1]))
        return with_model(task, fitted, task.wide(path[min(by, len(path) - 1)]))

    low, high = 0, 0
    while not steady(task, shortened(high)) and high < len(path):
        low, high = high + 1, 2 * high + 1
    return shortened(bisect_left(range(high), True, low, key=lambda by: steady(task, shortened(by))))


def steady(task: Task, state: State) -> bool:
    """Whether all steps end near the path and, except in maps, multiply deviations by `most_growth` at most."""
    spread = np.sqrt(state.levels.scales.variance[: task.layout.motion])
    most = math.inf if task.layout.discrete else LIKELIHOOD.most_growth
    for linear in task.linearised(state):
        missed = np.abs(linear.end - linear.path[1:])[:, : task.layout.motion] / spread
        few = linear.transition[:: max(1, len(missed) // CHECKED)]
        if not (np.isfinite(missed).all() and np.isfinite(few).all()):
            return False
        if missed.max(initial=0.0) > LIKELIHOOD.most_growth or np.abs(np.linalg.eigvals(few)).max() > most:
            return False
    return True


def rounds(task: Task, state: State, coarse: bool) -> tuple[Task, Fitted]:
    """The best of a sequence of fits, each of the model that is likeliest on the Gram of the last one, and its task."""
    now = fit(task, state, coarse)
    best = task, now
    seen = {now.model.tobytes()}
    for _ in range(ROUNDS):
        try:
            task = widened(task, now) if coarse else task
            state = likeliest(task, now)
            model = task.model(state.chosen).tobytes()
            if model in seen:
                break
            seen.add(model)
            task = finer(task, state) if coarse else task
            now = fit(task, state, coarse)
        except np.linalg.LinAlgError:  # the model does not stay near the motion
            break
        best = max(best, (task, now), key=lambda pair: pair[1].evidence)
    return best


def on_the_way(task: Task, state: State) -> tuple[Task, Fitted]:
    """Coarse rounds from one start without the bound on memories of discrepancies: the shorter way from heavy noise."""
    bounded = state.levels.scales
    state = replace(state, levels=state.levels.unbounded)
    task, best = rounds(finer(task, state), state, coarse=True)
    levels = replace(best.state.levels, scales=bounded)
    return task, replace(best, state=replace(best.state, levels=levels))


def settle(task: Task, state: State) -> tuple[Task, Fitted]:
    """Coarse rounds from one start, then a fit of their model."""
    task, best = on_the_way(task, state)
    return task, from_all_levels(task, best.state)


def all_together(task: Task, empty: State) -> State | None:
    """A start with all candidates, for terms that explain something only together; None if they are many."""
    if len(task.precision) > MOST_AT_ONCE:
        return None
    fitted = fit(task, empty, coarse=True)
    state = with_model(task, fitted, task.log_odds > -np.inf)
    return fit(task, state).state if steady(task, state) else None


def from_the_simplest(task: Task, empty: State) -> State | None:
    """A start found among the simplest candidates, then among more of them; None where all are as simple."""
    sizes = np.array([term.size for term in task.layout.terms])
    state = None
    for share in SIMPLEST:
        simple = np.append(sizes <= np.quantile(sizes, share), True)
        if simple.all():
            break
        log_odds = np.where(np.tile(simple, task.layout.chains), task.log_odds, -np.inf)
        _, found = on_the_way(replace(task, log_odds=log_odds), empty if state is None else state)
        state = found.state
        if state.levels.kappa.max() < LIKELIHOOD.adequate:
            break
    return state


def begun(task: Task, start: Start) -> tuple[Task, Fitted] | None:
    """The fit by coarse rounds from a start, or from the first of a tuple that can be fitted; None if there is none."""
    for one in start if isinstance(start, tuple) else (start,):
        with suppress(np.linalg.LinAlgError):
            state = one if isinstance(one, State) else one()
            return None if state is None else on_the_way(task, state)
    return None


def from_starts(task: Task, starts: Iterable[Start], finish: bool = False) -> tuple[Task, Fitted]:
    """The likeliest fit from the starts; the next start is tried as long as a discrepancy is left.

    If the first fit leaves none it is returned as a coarse one, unless `finish`. A LinAlgError says that no start leads
    to a likelihood that can be evaluated.
    """
    settled: dict[bytes, tuple[Task, Fitted]] = {}
    for one in starts:
        found = begun(task, one)
        if found is None or found[1].model.tobytes() in settled:
            continue
        there, best = found
        if not (finish or settled) and best.state.levels.kappa.max() < LIKELIHOOD.adequate:
            return there, best
        try:
            last = from_all_levels(there, best.state)
        except np.linalg.LinAlgError:
            continue
        adequate = last.state.levels.kappa.max() < LIKELIHOOD.adequate
        if adequate:  # at other levels than those that its terms were chosen at
            _, other = rounds(there, last.state, coarse=False)
            last = max(last, other, key=lambda one: one.evidence)
        settled[best.model.tobytes()] = there, last
        if adequate:
            break
    if not settled:
        raise np.linalg.LinAlgError("no start leads to a likelihood that can be evaluated")
    return max(settled.values(), key=lambda pair: pair[1].evidence)


def search(task: Task, starts: Sequence[Start], finish: bool = False) -> tuple[Task, Fitted]:
    """The best model that rounds of selection lead to, and the task with the steps of integration that were used.

    The last start has only the terms of stated laws; two more begin from there: all candidates together, if they are
    few, and the simplest ones first. `finish` as in `from_starts`.
    """
    assert isinstance(starts[-1], State)
    together, simplest = partial(all_together, task, starts[-1]), partial(from_the_simplest, task, starts[-1])
    return from_starts(task, (*starts, together, simplest), finish)


def resumed(task: Task, state: State) -> Fitted:
    """The best model of a task, searched from a fit of some of its rows (`bayeq.likelihood.start.carried_over`)."""
    _, best = rounds(task, state, coarse=False)
    best = over_all_sizes(task, with_small_discrepancy(task, best) if task.rows > MOST_TO_MOVE else best)
    task.recent.clear()
    return best
