"""Which coefficients are not zero.

1. `on_the_way`, from each start: linearise, select on the Gram of all candidates, fit, and again until the model
   stays.
2. `bayeq.likelihood.courses.with_other_inputs`: other courses of the inputs between samples are tried.
3. `from_all_levels` fits the model.
4. `resumed`: what was found on some rows is fitted to all, in rounds as in 1.
5. `among_neighbours`: flips and swaps of single terms, each compared by the evidence of its own fit.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.arrays import Bools, Floats
from bayeq.gram import Gram
from bayeq.inference.collapsed.conditional import exact_posterior
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models, neighbours
from bayeq.inference.prior import Prior
from bayeq.likelihood.fit import (
    Quadratic,
    State,
    Statistics,
    improved,
    information,
    linearised,
    marginal,
    maximised,
    of_inputs,
    over_sizes,
    solved,
)
from bayeq.likelihood.flows import Flows
from bayeq.likelihood.layout import Candidates, Layout, Series
from bayeq.likelihood.linear import Linear
from bayeq.likelihood.settings import LIKELIHOOD

# Linearisations until the support stays, and Gauss-Newton steps about each support.
ROUNDS = 8
STEPS = 2

# Steps and tolerance of the search for the levels about models that are on the way.
COARSE: dict[str, Any] = {"steps": 15, "tolerance": 1e-2, "steepest": 0.1}

# A fit has converged when its evidence changes by less [nats]; steps at most.
SETTLED = 0.05
MOST_STEPS = 12

# Gauss-Newton steps to where the likelihood is not finite are halved, at most this often in a fit.
MOST_HALVED = 4

# Shares of the candidates that are looked at first, the smallest expressions of them.
SIMPLEST = (0.25, 0.5)

# Samples at which growth of deviations from the path is looked for.
CHECKED = 500

# All candidates together are a start if they are not more than this.
MOST_AT_ONCE = 40

# With more samples than this the Gram of a fit tells its neighbours apart, and they are not fitted.
MOST_TO_MOVE = 100_000

# Moves to a neighbour, at most.
MOVES = 5

# A discrepancy that explained much is tried at this share of the target, and held there for some steps, while path and
# coefficients find each other.
HARDLY_ANY, CALM_STEPS = 1e-3, 3

# Factors by which the variance of coefficients' priors may be wider, where that is likelier by this many nats.
WIDER, CLEARLY = (10.0, 100.0), 3.0

# Noise of known variance: as if estimated from this many times the record's samples.
KNOWN = 1e4

# The likelihood is flat near zero discrepancy, so that a search stays there: of many samples a fit is compared with one
# that starts from a discrepancy of this share of its target, and this memory. If that is as likely it is taken: from
# there more rows lead to less of it as well as to more. One that begins worse by FLAT nats is dropped.
NOTICED, ITS_MEMORY = 0.01, 0.7
FLAT = 0.5

# Steps between samples are halved, up to this number, until this share of them errs by less than STEP_ERROR of the
# standard deviation of each state, a tenth of the least noise: what is more looks like a term where there is no noise.
# The others may hold a jump.
MOST_SUBSTEPS, SMOOTH_STEPS, STEP_ERROR = 8, 0.98, 1e-6


@dataclass(frozen=True, eq=False)
class Task:
    """Records to be explained, candidates, and their prior.

    Attributes
    ----------
    layout : Layout
        States and candidates.
    series : tuple of Series
        The records.
    precision : (C (P + 1),) array
        1/variance of each coefficient's prior, were it not zero.
    log_odds : (C (P + 1),) array
        Of each coefficient not being zero.
    substeps : int
        Runge-Kutta steps between two samples.
    counted : float or None
        Number of samples that the likelihood is of, where the series are some of them only.
    tolerance : float or None
        See `bayeq.discover`.
    ranges : (C (P + 1),) array or None
        What the log odds have lost to the ranges of constants inside terms.
    flows : Flows or None
        What models are selected from, where a sum of states is conserved.
    recent : list
        The last two linearisations and what they are of: fits go on from where others have stood.
    """

    layout: Layout
    series: tuple[Series, ...]
    precision: Floats
    log_odds: Floats
    substeps: int = 1
    counted: float | None = None
    tolerance: float | None = None
    ranges: Floats | None = None
    flows: Flows | None = None
    recent: list[tuple[tuple[object, ...], list[Linear]]] = field(default_factory=list, repr=False)

    def linearised(self, state: State) -> list[Linear]:
        """Every record linearised where a fit stands."""
        about = (self.layout, self.series, self.substeps, state.chosen, state.theta, state.paths, state.blurs)
        for other, linears in self.recent:
            if all(one is another for one, another in zip(other, about, strict=True)):
                return linears
        del self.recent[:-1]
        self.recent.append((about, linearised(self.layout, self.series, state, self.substeps)))
        return self.recent[-1][1]

    def precision_of(self, state: State) -> Floats:
        """1/variance of the prior of each coefficient of a fit, (r,)."""
        return self.precision[self.number(state.chosen)]

    def marginal(self, state: State, keep: bool = True) -> Statistics:
        """The likelihood where a fit stands, its coefficients integrated out; `keep` as in `run_filter`."""
        return marginal(self.linearised(state), state, state.levels, self.precision_of(state), keep)

    def value(self, state: State) -> float:
        """ln p(data | levels) where a fit stands; -inf where that is far from any motion."""
        try:
            return self.marginal(state, keep=False).value
        except np.linalg.LinAlgError:
            return -math.inf

    @property
    def rows(self) -> float:
        """Number of samples."""
        if self.counted is not None:
            return self.counted
        return float(sum(np.isfinite(one.samples).sum() for one in self.series))

    def number(self, chosen: Candidates) -> NDArray[np.int64]:
        """Indices of coefficients among those of all equations."""
        return chosen.chain * (len(self.layout.terms) + 1) + chosen.term

    def model(self, chosen: Candidates) -> Bools:
        """The model, (C (P + 1),) bool, in which these coefficients are not zero."""
        out = np.zeros(len(self.precision), dtype=np.bool_)
        out[self.number(chosen)] = True
        return out

    def prior(self, model: Bools) -> float:
        """Log prior of a model, up to a constant."""
        odds, chosen, share = self.log_odds, model, 0.0
        if self.flows is not None:
            odds, chosen = self.flows.log_odds(odds), self.flows.narrow(model)
            share = self.flows.log_share(self.layout.stated, self.precision, model)
        return float(odds[chosen & np.isfinite(odds)].sum()) - share

    @cached_property
    def known(self) -> Prior:
        """The prior of coefficients in units of their own prior's standard deviation, noise of variance 1."""
        return Prior(slab_variance=1.0, prior_inclusion=1.0 / (1.0 + np.exp(-self.log_odds)))

    @cached_property
    def selected(self) -> Prior:
        """The same of what models are selected from."""
        if self.flows is None:
            return self.known
        return Prior(slab_variance=1.0, prior_inclusion=1.0 / (1.0 + np.exp(-self.flows.log_odds(self.log_odds))))

    def wide(self, model: Bools) -> Bools:
        """The coefficients of a model that was selected."""
        return model if self.flows is None else self.flows.wide(model)

    def narrow(self, model: Bools) -> Bools:
        """The opposite of `wide`."""
        return model if self.flows is None else self.flows.narrow(model)

    def gram(self, q: Quadratic) -> Gram:
        """The likelihood of all that models are selected from, in those units: a regression of known noise, about."""
        precision, information, slope = self.precision, q.information, q.slope
        if self.flows is not None:
            precision, F = self.flows.precision(precision), self.flows.matrix
            information, slope = F.T @ information @ F, F.T @ slope
        scale = 1.0 / np.sqrt(precision)
        DtD = information * scale[:, None] * scale
        Dty = slope * scale
        rows = KNOWN * self.rows
        names = tuple(map(str, range(len(Dty))))
        return Gram(names, rows, np.zeros(len(Dty)), 0.0, DtD, Dty, float(Dty @ solved(DtD, Dty)) + rows, rows)

    def problem(self, q: Quadratic) -> Problem:
        """The regression that models are compared on."""
        return Problem.of(self.gram(q), self.selected)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model fitted.

    Attributes
    ----------
    model : (C (P + 1),) bool array
        Coefficients that are not zero.
    state : State
        Their values, the paths and the levels.
    evidence : float
        ln p(data, model), up to a constant.
    value : float
        ln p(data | levels).
    expand : callable
        Gives `quadratic`.
    averages : (C,) array or None
        What averaging over the size of each discrepancy makes of it; None where its likeliest size is taken.
    tried : dict of bytes to float
        Evidence of the models that were fitted to be compared.
    power : float
        That `quadratic` is raised to (`bayeq.likelihood.power`).
    """

    model: Bools
    state: State
    evidence: float
    value: float
    expand: Callable[[], Quadratic]
    averages: Floats | None = None
    tried: dict[bytes, float] = field(default_factory=dict)
    power: float = 1.0

    @cached_property
    def quadratic(self) -> Quadratic:
        """The likelihood of all candidates about the fit, computed when it is first asked for."""
        return self.expand().raised(self.power)


def fit(task: Task, state: State, coarse: bool = False, calm: int = 0) -> Fitted:
    """Fit a model by Gauss-Newton steps; before each the levels are learned.

    Parameters
    ----------
    task, state : Task, State
        What is to be explained, and where the steps start.
    coarse : bool
        Few steps only.
    calm : int
        Number of first steps in which discrepancies keep their size.
    """
    layout, precision = task.layout, task.precision_of(state)
    before, length, last, halved = -np.inf, np.inf, None, 0
    for step in range(STEPS if coarse else MOST_STEPS + calm):
        held = state.levels.optional if step < calm else None
        while True:
            linears = task.linearised(state)
            try:
                levels, found = maximised(linears, state, precision, held, **(COARSE if coarse else {}))
                break
            except np.linalg.LinAlgError:
                halved += 1
                if last is None or halved > MOST_HALVED:
                    raise
                state = last.halfway(state)
        last = state
        state, curved = improved(layout, task.series, linears, replace(state, levels=levels), found)
        moved = float(np.linalg.norm(np.linalg.solve(np.linalg.cholesky(found.covariance), state.theta - last.theta)))
        if moved > length:  # to and fro, further each time
            state = state.halfway(last)
        length = moved
        if abs(found.value - before) < SETTLED and 0.5 * moved**2 < FLAT and step >= calm:
            break
        before = found.value
    found = task.marginal(state, keep=False)
    # where steps go to and fro, what the next one promises is not kept; coarse fits have few steps, and are on the way
    evidence = found.value if coarse else found.value - min(found.value - found.here, 0.5 * length**2)
    model = task.model(state.chosen)
    return Fitted(model, state, evidence + task.prior(model), found.value, partial(expanded, task, state, curved))


def over_all_sizes(task: Task, fitted: Fitted, beside: Fitted | None = None) -> Fitted:
    """The fit, or a likelier one, with its evidence averaged over the sizes of its discrepancies.

    It starts once more from the likeliest size of each discrepancy if the average finds a likelier one: about a
    discrepancy of nearly zero the likelihood is flat, and a search stays there. Equations with the same terms in a fit
    `beside` take its averages.
    """
    averages = np.full(task.layout.chains, np.nan)
    if beside is not None and beside.averages is not None:
        same = (beside.model == fitted.model).reshape(len(averages), -1).all(axis=1)
        averages[same] = beside.averages[same]
    averages, likelier = _over_sizes(task, fitted, averages)
    if likelier is not None:
        own = fitted.state.levels.discrepancy
        fitted = fit(task, likelier)
        averages, _ = _over_sizes(task, fitted, np.where(likelier.levels.discrepancy == own, averages, np.nan))
    return replace(fitted, evidence=fitted.evidence + float(averages.sum()), averages=averages)


def _over_sizes(task: Task, fitted: Fitted, known: Floats) -> tuple[Floats, State | None]:
    """Averages over the sizes of discrepancies, (C,), and the state with likelier ones if there are."""
    state, own = fitted.state, fitted.state.levels.discrepancy
    averages, met = over_sizes(task.linearised(state), state, task.precision_of(state), fitted.value, known)
    likelier = replace(state, levels=met)
    if (met.discrepancy == own).all() or not task.marginal(likelier, keep=False).value > fitted.value + FLAT:
        return averages, None
    return averages, likelier


def expanded(task: Task, state: State, curved: Floats) -> Quadratic:
    """The likelihood of all candidates about a fit that has converged."""
    return information(task.layout, task.linearised(state), state, curved)


def with_model(task: Task, fitted: Fitted, model: Bools) -> State:
    """A start for another model: its coefficients as the Gram gives them, the path and levels of the fit."""
    coef, _ = exact_posterior(task.problem(fitted.quadratic), task.narrow(model), None)
    if task.flows is None:
        theta = coef[model] / np.sqrt(task.precision[model])
    else:
        theta = (task.flows.matrix @ (coef / np.sqrt(task.flows.precision(task.precision))))[model]
    return replace(fitted.state, chosen=task.layout.everything.take(np.flatnonzero(model)), theta=theta)


def calmed(state: State) -> State:
    """The state with smaller discrepancies: with hardly any where they explain much of the motion."""
    levels = state.levels
    kappa = np.where(levels.kappa > LIKELIHOOD.explains_much, HARDLY_ANY, levels.kappa / LIKELIHOOD.calmed)
    return replace(state, levels=replace(levels, discrepancy=kappa**2 * levels.target))


def from_all_levels(task: Task, state: State, beside: Fitted | None = None) -> Fitted:
    """The likelier fit of a model of those that start from the levels as they are, and from less discrepancy.

    Levels of another model may keep a discrepancy that nothing needs any more. `beside` as in `over_all_sizes`.
    """
    first = fit(task, state)
    if (state.levels.kappa >= NOTICED).any():
        much = bool((state.levels.kappa > LIKELIHOOD.explains_much).any())
        with suppress(np.linalg.LinAlgError):
            calm = fit(task, calmed(state), calm=CALM_STEPS if much else 0)
            if abs(calm.evidence - first.evidence) >= FLAT:  # another maximum
                both = [over_all_sizes(task, one, beside) for one in (first, calm)]
                return max(both, key=lambda one: one.evidence)
    return over_all_sizes(task, first, beside)


def finished(task: Task, fitted: Fitted) -> Fitted:
    """A fit of the model, its evidence averaged over sizes; coarse ones are of a model on the way."""
    return from_all_levels(task, fitted.state) if fitted.averages is None else fitted


def roused(state: State) -> State:
    """The state with vanishing discrepancies raised to a size that a search moves."""
    levels = state.levels
    hardly = levels.kappa < NOTICED
    discrepancy = np.where(hardly, NOTICED**2 * levels.target, levels.discrepancy)
    memory = np.where(hardly, ITS_MEMORY, levels.memory)
    return replace(state, levels=replace(levels, discrepancy=discrepancy, memory=memory, hessian=None))


def with_small_discrepancy(task: Task, best: Fitted) -> Fitted:
    """The fit, or one of the same model with some discrepancy that is as likely or likelier."""
    if not (best.state.levels.kappa < NOTICED).any():
        return best
    before, state = task.marginal(best.state, keep=False).value, fit(task, roused(best.state), coarse=True).state
    if task.marginal(state, keep=False).value < before - FLAT:
        return best
    again = fit(task, state)
    return again if task.marginal(again.state, keep=False).value > before - SETTLED else best


def widened(task: Task, fitted: Fitted) -> Task:
    """The task with a wider prior of the coefficients, where the likeliest model is clearly likelier under it.

    Terms that cancel each other, as those of a growth that needs a crowd, have coefficients far larger than either
    would need alone.
    """
    tasks = [task, *(replace(task, precision=task.precision / factor, recent=[]) for factor in WIDER)]
    values = [best_models(one.problem(fitted.quadratic))[0][0] for one in tasks]
    return tasks[int(np.argmax(np.array(values) - CLEARLY * (np.arange(len(tasks)) > 0)))]


def likeliest(task: Task, fitted: Fitted) -> State:
    """A start for the likeliest model, cut down term by term until its motion stays near the path over a step.

    Where the discrepancy still explains all the motion many terms may make up for each other, with coefficients by
    which a deviation from the path would explode.
    """
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
    """Whether a step multiplies deviations from the path by less than `most_growth`, and ends near the path.

    Those of chaotic maps may grow by more.
    """
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
    """Fits, each of the model that is likeliest on the Gram of the one before, until that stays; the best of them.

    Between coarse fits priors may become wider, and steps of the integration finer: the task has these.
    """
    best = now = fit(task, state, coarse)
    seen = {now.model.tobytes()}
    for _ in range(ROUNDS):
        task = widened(task, now) if coarse else task
        state = likeliest(task, now)
        model = task.model(state.chosen).tobytes()
        if model in seen:
            break
        seen.add(model)
        try:
            task = finer(task, state) if coarse else task
            now = fit(task, state, coarse)
        except np.linalg.LinAlgError:  # of no motion that it stays near
            if not coarse:
                raise
            break
        best = max(best, now, key=lambda one: one.evidence)
    return task, best


def on_the_way(task: Task, state: State) -> tuple[Task, Fitted]:
    """Coarse rounds from one start, with steps as fine as they need.

    The memory of discrepancies is not bounded: from heavy noise that is the shorter way.
    """
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
    """A start found among the simplest candidates, then among more of them; None where all are as simple.

    Of many candidates that noise hardly tells apart those that fit best together explain nothing but the noise.
    """
    sizes = np.array([term.size for term in task.layout.terms])
    state = None
    for share in SIMPLEST:
        simple = np.append(sizes <= np.quantile(sizes, share), True)
        if simple.all():
            break
        log_odds = np.where(np.tile(simple, task.layout.chains), task.log_odds, -np.inf)
        _, found = on_the_way(replace(task, log_odds=log_odds, recent=[]), empty if state is None else state)
        state = found.state
        if state.levels.kappa.max() < LIKELIHOOD.adequate:
            break
    return state


def finer(task: Task, state: State) -> Task:
    """The task with as many Runge-Kutta steps between samples as its motion, and the columns of its terms, need."""
    spread = np.sqrt(state.levels.scales.variance[: task.layout.motion])
    while task.substeps < MOST_SUBSTEPS and task.layout.motion and not task.layout.discrete:
        twice = replace(task, substeps=2 * task.substeps)
        pairs = list(zip(task.linearised(state), twice.linearised(state), strict=True))
        ends = [np.abs(a.end - b.end)[:, : task.layout.motion] for a, b in pairs]
        parts = [np.abs((a.sources - b.sources) * state.theta).max(axis=2, initial=0.0) for a, b in pairs]
        missed = np.maximum(np.concatenate(ends), np.concatenate(parts)) / spread
        if np.quantile(np.where(np.isfinite(missed), missed, np.inf), SMOOTH_STEPS) <= STEP_ERROR:
            break
        task = twice
    return task


def of_motion(task: Task, fitted: Fitted) -> float:
    """ln p(data, model) less what the samples of inputs have in it: of the motion, given the inputs."""
    return fitted.evidence - of_inputs(task.linearised(fitted.state), fitted.state.levels)


def from_starts(task: Task, starts: Iterable[State | Callable[[], State | None]]) -> tuple[Task, Fitted]:
    """The likeliest fit that starts lead to, from the next one too where those before left a discrepancy.

    A start may be what gives it, or None, when it is needed. The first model is on the way if it leaves none; a model
    that starts lead to again is not fitted again.

    Raises
    ------
    numpy.linalg.LinAlgError
        No start leads to a likelihood that can be evaluated.
    """
    settled: dict[bytes, tuple[Task, Fitted]] = {}
    for one in starts:
        try:
            start = one if isinstance(one, State) else one()
            if start is None:
                continue
            there, best = on_the_way(task, start)
            key = best.model.tobytes()
            if key in settled:
                continue
            if not settled and best.state.levels.kappa.max() < LIKELIHOOD.adequate:
                return there, best
            settled[key] = there, from_all_levels(there, best.state)
        except np.linalg.LinAlgError:
            continue
        if settled[key][1].state.levels.kappa.max() < LIKELIHOOD.adequate:
            break
    if not settled:
        raise np.linalg.LinAlgError("no start leads to a likelihood that can be evaluated")
    return max(settled.values(), key=lambda pair: pair[1].evidence)


def search(task: Task, starts: Sequence[State]) -> tuple[Task, Fitted]:
    """The best model that rounds of selection lead to, and the task with the steps of integration that were used.

    Rounds start from the next start too where those before left a discrepancy. The last one has no terms but those of
    stated laws; the fit of all candidates from there is a further start if these are few.
    """
    together, simplest = partial(all_together, task, starts[-1]), partial(from_the_simplest, task, starts[-1])
    return from_starts(task, (*starts, together, simplest))


def resumed(task: Task, state: State) -> Fitted:
    """The best model of a task, looked for from a fit of some of its rows (`bayeq.likelihood.start.carried_over`)."""
    _, best = rounds(task, state, coarse=False)
    best = over_all_sizes(task, with_small_discrepancy(task, best) if task.rows > MOST_TO_MOVE else best)
    task.recent.clear()
    return best


def among_neighbours(task: Task, best: Fitted) -> Fitted:
    """The model that single moves lead to, each compared by its own fit; with many samples the Gram suffices."""
    if task.rows > MOST_TO_MOVE:
        return best
    tried = {best.model.tobytes(): best.evidence}
    for _ in range(MOVES):
        better = best
        chosen = task.narrow(best.model)
        for move in neighbours(task.problem(best.quadratic), chosen, LIKELIHOOD.neighbour_window)[
            : LIKELIHOOD.neighbours
        ]:
            model = task.wide(move.apply(chosen))
            if model.tobytes() in tried:
                continue
            try:
                other = over_all_sizes(task, fit(task, calmed(with_model(task, best, model))), best)
            except np.linalg.LinAlgError:
                continue
            tried[model.tobytes()] = other.evidence
            better = max(better, other, key=lambda one: one.evidence)
        if better is best:
            break
        best = better
    best.tried.update(tried)
    task.recent.clear()
    return best
