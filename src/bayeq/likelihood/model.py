"""`Task`: records to be explained by candidates; `Fitted`: the fit of a model, a set of nonzero coefficients."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.likelihood.determinant import Determinant
from bayeq.likelihood.fit import (
    Quadratic,
    State,
    Statistics,
    improved,
    information,
    linearised,
    log_mean,
    marginal,
    maximised,
    of_inputs,
    solved,
)
from bayeq.likelihood.layout import Candidates, Layout, Series
from bayeq.likelihood.levels import Levels
from bayeq.likelihood.linear import Linear
from bayeq.likelihood.steps import Flows
from bayeq.numerics.settings import LIKELIHOOD

# Gauss-Newton steps of a coarse fit, of a model that the search has not finished with.
STEPS = 2

# Settings of the search for the levels in coarse fits.
COARSE: dict[str, Any] = {"steps": 15, "tolerance": 1e-2, "steepest": 0.1}

# A fit has converged when its log likelihood changes by less in a step [nats]; most steps of a fit.
SETTLED = 0.05
MOST_STEPS = 12

# If a step of a fit reverses the one before, the fit continues from a point between the ends of both; largest weight of
# the former end.
MOST_BACK = 0.75

# Gauss-Newton steps to where the likelihood is not finite are halved, at most this often in a fit.
MOST_HALVED = 4

# A discrepancy that explained much restarts from this share of the target and is held there for some steps, while path
# and coefficients converge.
HARDLY_ANY, CALM_STEPS = 1e-3, 3

# Noise of known variance: as if estimated from this many times the record's samples.
KNOWN = 1e4

# Share of a Gram's diagonal that is added to it, above its rounding. Columns of an unstable law grow alike: what tells
# them apart is lost in rounding, which may be larger than the prior, and scores of models are then meaningless.
ROUNDING = 1e-14

# The likelihood is flat near zero discrepancy, so that a search stays there. With many samples a fit is compared with
# one that starts from a discrepancy of this share of its target and this memory, which is taken if it is as likely:
# from there further rows can lower the discrepancy as well as raise it. One that starts worse by FLAT nats is dropped.
NOTICED, ITS_MEMORY = 0.01, 0.7
FLAT = 0.5

# Integration steps are halved, up to MOST_SUBSTEPS an interval, until the share SMOOTH_STEPS of the intervals errs by
# at most STEP_ERROR of the standard deviation of each state, a tenth of the least noise: a larger error looks like a
# term if there is no noise. With more noise it may be HIDDEN of what the noise of all rows hides. The other intervals
# may contain a jump.
MOST_SUBSTEPS, SMOOTH_STEPS, STEP_ERROR, HIDDEN = 8, 0.98, 1e-6, 0.1


@dataclass(frozen=True, eq=False)
class Task:
    """Records to be explained, candidates, and their prior."""

    layout: Layout  # states and candidates
    series: tuple[Series, ...]  # the records
    precision: Floats  # (C (P + 1),), 1/variance of the prior of each coefficient if it is in the model
    log_odds: Floats  # (C (P + 1),), prior log odds of each coefficient being in the model
    substeps: int = 1  # Runge-Kutta steps between two samples
    counted: float | None = None  # number of samples in the likelihood, if the series hold only some of them
    tolerance: float | None = None  # see `bayeq.discover`
    ranges: Floats | None = None  # (C (P + 1),), change of the log odds by the ranges of constants inside terms
    flows: Flows | None = None  # flows, from which models are selected if a sum of states is conserved
    # second moments of coefficients over likely courses of inputs, (C (P + 1),) squared; 0 if none were tried
    between: Floats | float = 0.0
    # cache of the last two linearisations, with the arguments that they were computed from
    recent: list[tuple[tuple[object, ...], list[Linear]]] = field(default_factory=list, init=False, repr=False)

    @cached_property
    def allowed(self) -> Bools:
        """Candidate terms that each equation may have, (C, P)."""
        return np.asarray(self.log_odds.reshape(self.layout.chains, -1)[:, :-1] > -np.inf)

    def linearised(self, state: State) -> list[Linear]:
        """Every record linearised about a state, from the cache if it is there."""
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

    def marginal(self, state: State, keep: bool = True, bent: Floats | None = None) -> Statistics:
        """The marginal likelihood at a state, with its coefficients integrated out; arguments as for `marginal`."""
        return marginal(self.linearised(state), state, state.levels, self.precision_of(state), keep, bent)

    def value(self, state: State) -> float:
        """ln p(data | levels) at a state; -inf where the likelihood cannot be evaluated."""
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

    def number(self, chosen: Candidates) -> Ints:
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
        """The prior of the coefficients, in units of their prior standard deviations and with noise of variance 1."""
        return Prior(slab_variance=1.0, prior_inclusion=1.0 / (1.0 + np.exp(-self.log_odds)))

    @cached_property
    def selected(self) -> Prior:
        """The prior, as `known`, of the quantities that models are selected from: flows if there are any."""
        if self.flows is None:
            return self.known
        return Prior(slab_variance=1.0, prior_inclusion=1.0 / (1.0 + np.exp(-self.flows.log_odds(self.log_odds))))

    def wide(self, model: Bools) -> Bools:
        """A selected model as one of coefficients: flows are replaced by the coefficients that they change."""
        return model if self.flows is None else self.flows.wide(model)

    def narrow(self, model: Bools) -> Bools:
        """A model of coefficients as one of flows: the inverse of `wide`."""
        return model if self.flows is None else self.flows.narrow(model)

    def gram(self, q: Quadratic) -> Gram:
        """The likelihood of the quantities of `selected`, in its units, as a regression with nearly known noise."""
        precision, information, slope = self.precision, q.information, q.slope
        if self.flows is not None:
            precision, F = self.flows.precision(precision), self.flows.matrix
            information, slope = F.T @ information @ F, F.T @ slope
        scale = 1.0 / np.sqrt(precision)
        DtD = information * scale[:, None] * scale
        DtD[np.diag_indices_from(DtD)] *= 1.0 + ROUNDING
        Dty = slope * scale
        rows = KNOWN * self.rows
        names = tuple(map(str, range(len(Dty))))
        return Gram(names, rows, np.zeros(len(Dty)), 0.0, DtD, Dty, float(Dty @ solved(DtD, Dty)) + rows, rows)

    def problem(self, q: Quadratic) -> Problem:
        """The regression that models are compared on."""
        return Problem.of(self.gram(q), self.selected)


def _step_errors(task: Task, levels: Levels) -> Floats:
    """Errors of each state of the motion, (motion,), that a step between samples may make.

    An error e of each step of length h acts as an error e/h of the state's rate, which n rows with noise of a share s
    of each channel hide up to about s/sqrt(n) of the rate's standard deviation.
    """
    layout, scales, motion = task.layout, levels.scales, task.layout.motion
    spread, rate = np.sqrt(scales.variance[:motion]), np.sqrt(scales.variance[1 : motion + 1])
    integrated = np.array([chain.order > 0 for chain in layout.roles.chains])
    rate[layout.last[integrated]] = np.sqrt(levels.target[integrated])
    interval, rows = min(np.median(one.intervals) for one in task.series), sum(len(one.samples) for one in task.series)
    share = (levels.channels / scales.channels)[: layout.first_input].min() / rows
    return np.asarray(np.maximum(STEP_ERROR * spread, HIDDEN * np.sqrt(share) * interval * rate))


def finer(task: Task, state: State) -> Task:
    """The task with as many Runge-Kutta steps between samples as its motion, and the columns of its terms, need."""
    allowed = _step_errors(task, state.levels)
    while task.substeps < MOST_SUBSTEPS and task.layout.motion and not task.layout.discrete:
        twice = replace(task, substeps=2 * task.substeps)
        pairs = list(zip(task.linearised(state), twice.linearised(state), strict=True))
        ends = [np.abs(a.end - b.end)[:, : task.layout.motion] for a, b in pairs]
        parts = [np.abs((a.sources - b.sources) * state.theta).max(axis=2, initial=0.0) for a, b in pairs]
        missed = np.maximum(np.concatenate(ends), np.concatenate(parts)) / allowed
        if np.quantile(np.where(np.isfinite(missed), missed, np.inf), SMOOTH_STEPS) <= 1.0:
            break
        task = twice
    return task


@dataclass(frozen=True, eq=False)
class Fitted:
    """The fit of a model."""

    model: Bools  # (C (P + 1),), coefficients that are not zero
    state: State  # their values, the paths and the levels
    evidence: float  # ln p(data, model), up to a constant
    value: float  # ln p(data | levels)
    expand: Callable[[], Quadratic]  # computes `quadratic`, before it is raised to `power`
    # (C,), change of the evidence by averaging over the size of each discrepancy; None if at the likeliest sizes
    averages: Floats | None = None
    tried: dict[bytes, float] = field(default_factory=dict)  # evidence of the models that were fitted to be compared
    bent: Floats | None = None  # (r,), see `bayeq.likelihood.fit.marginal`
    power: float = 1.0  # power of the likelihood in `quadratic` (`bayeq.likelihood.adequacy`)

    @cached_property
    def quadratic(self) -> Quadratic:
        """The likelihood of all candidates about the fit, computed when it is first asked for."""
        return self.expand().raised(self.power)

    def raised(self, power: float) -> Fitted:
        """The fit with its likelihood raised to another power."""
        return self if power == self.power else replace(self, power=power)


def of_motion(task: Task, fitted: Fitted) -> float:
    """ln p(data, model) less the log likelihood of the samples of inputs: that of the motion, given the inputs."""
    return fitted.evidence - of_inputs(task.linearised(fitted.state), fitted.state.levels)


def fit(task: Task, state: State, coarse: bool = False, calm: int = 0) -> Fitted:
    """Fit a model by Gauss-Newton steps from a state; levels are estimated before each step.

    With much noise steps oscillate: each is mixed with the one before (Anderson, D. G. (1965), Journal of the ACM 12,
    547-560). A `coarse` fit has few steps. In the first `calm` steps discrepancies and other optional levels are held.
    """
    layout, precision = task.layout, task.precision_of(state)
    before, last, halved, former = -np.inf, None, 0, None
    for taken in range(STEPS if coarse else MOST_STEPS + calm):
        held = state.levels.optional if taken < calm else None
        while True:
            linears = task.linearised(state)
            try:
                levels, found = maximised(linears, state, precision, held, **(COARSE if coarse else {}))
                break
            except np.linalg.LinAlgError:
                halved += 1
                if last is None or halved > MOST_HALVED:
                    raise
                state = last.towards(state)
        last = state
        state, bend, bent = improved(layout, task.series, linears, replace(state, levels=levels), found)
        step, unit = state.theta - last.theta, np.linalg.inv(np.linalg.cholesky(found.covariance))
        length, arrived = float(np.linalg.norm(unit @ step)), state
        if former is not None and not coarse:
            turned = unit @ (step - former[1])
            share = float(turned @ unit @ step) / max(float(turned @ turned), np.finfo(np.float64).tiny)
            state = state.towards(former[0], min(max(share, 0.0), MOST_BACK))
        if not np.isfinite(state.theta).all():  # predictions of NaN would make samples count as missing
            raise np.linalg.LinAlgError("a step leads nowhere")
        former = arrived, step
        if abs(found.value - before) < SETTLED and 0.5 * length**2 < FLAT and taken >= calm:
            break
        before = found.value
    # where noise of inputs weakens coefficients, the linearised model without `bent` favours some that the likelihood
    # does not; with much noise of states alone exact laws are found more often without `bent`
    counted = bent if layout.roles.inputs else None
    found = task.marginal(state, False, counted)
    # if steps oscillate, the gain that the next one predicts is not realised; coarse fits have not converged anyway
    evidence = found.value if coarse else found.value - min(found.value - found.here, 0.5 * length**2)
    model = task.model(state.chosen)
    expand = partial(expanded, task, state, bend)
    return Fitted(model, state, evidence + task.prior(model), found.value, expand, bent=counted)


def over_all_sizes(task: Task, fitted: Fitted, beside: Fitted | None = None) -> Fitted:
    """The fit, refitted if other sizes of discrepancies are likelier, with its evidence averaged over these sizes.

    Equations with the same terms in the fit `beside` take the averages from there.
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
        averages = np.minimum(averages, FLAT)  # a mean is below its maximum, and another fit has not found more
    return replace(fitted, evidence=fitted.evidence + float(averages.sum()), averages=averages)


def _over_sizes(task: Task, fitted: Fitted, former: Floats) -> tuple[Floats, State | None]:
    """ln of the likelihood averaged over sizes of each discrepancy, relative to the fit's; a likelier state or None.

    The prior is flat in the logarithm of each size: a model that needs no discrepancy is as likely at any small one.
    Averages in `former`, (C,), that are not NaN are kept.
    """
    state, levels = fitted.state, fitted.state.levels
    bounds = np.log(levels.sizes)
    means, met = np.where(levels.stated, 0.0, former), levels.discrepancy.copy()
    for c in np.flatnonzero(np.isnan(former)).tolist():
        likeliest = float(np.log(levels.discrepancy[c]))

        def log_ratio(size: float, c: int = c, likeliest: float = likeliest) -> float:
            if size == likeliest:
                return 0.0
            other = replace(state, levels=levels.with_discrepancy(c, np.exp(size)))
            return task.marginal(other, False, fitted.bent).value - fitted.value

        low, high = bounds[:, c].tolist()
        means[c], size = log_mean(log_ratio, low, high, likeliest)
        met[c] = met[c] if size == likeliest else np.exp(size)
    other = replace(state, levels=replace(levels, discrepancy=met))
    if (met == levels.discrepancy).all() or not task.marginal(other, False, fitted.bent).value > fitted.value + FLAT:
        return means, None
    return means, other


def expanded(task: Task, state: State, bend: Determinant) -> Quadratic:
    """The likelihood of all candidates about a fit that has converged."""
    return information(task.layout, task.linearised(state), state, bend)


def with_model(task: Task, fitted: Fitted, model: Bools) -> State:
    """A start for another model: posterior means of its coefficients by the Gram, path and levels of the fit."""
    coef, _ = exact_posterior(task.problem(fitted.quadratic), task.narrow(model), None)
    if task.flows is None:
        theta = coef[model] / np.sqrt(task.precision[model])
    else:
        theta = (task.flows.matrix @ (coef / np.sqrt(task.flows.precision(task.precision))))[model]
    return replace(fitted.state, chosen=task.layout.everything.take(np.flatnonzero(model)), theta=theta)


def calmed(state: State) -> State:
    """The state with smaller discrepancies: HARDLY_ANY if they explain much of the motion, else less by a factor."""
    levels = state.levels
    kappa = np.where(levels.kappa > LIKELIHOOD.explains_much, HARDLY_ANY, levels.kappa / LIKELIHOOD.calmed)
    return replace(state, levels=replace(levels, discrepancy=kappa**2 * levels.target))


def from_all_levels(task: Task, state: State, beside: Fitted | None = None) -> Fitted:
    """The likelier of the fits from the state's levels and from smaller discrepancies, averaged over all sizes."""
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
    """The fit if its evidence is averaged over sizes of discrepancies, else that by `from_all_levels` from there."""
    return from_all_levels(task, fitted.state) if fitted.averages is None else fitted


def with_small_discrepancy(task: Task, best: Fitted) -> Fitted:
    """The fit, or an equally likely one of the same model with discrepancies large enough for a search to move."""
    levels = best.state.levels
    hardly = levels.kappa < NOTICED
    if not hardly.any():
        return best
    discrepancy = np.where(hardly, NOTICED**2 * levels.target, levels.discrepancy)
    memory = np.where(hardly, ITS_MEMORY, levels.memory)
    roused = replace(levels, discrepancy=discrepancy, memory=memory, hessian=None)
    some = fit(task, replace(best.state, levels=roused), coarse=True)
    if some.value < best.value - FLAT:
        return best
    again = fit(task, some.state)
    return again if again.value > best.value - SETTLED else best
