"""`RecordFit`: all equations fitted by the likelihood of the records, with Gram matrices and one joint posterior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary.ranges import ConstantEstimate, Forms
from bayeq.expressions import Expression
from bayeq.inference.collapsed.search import scores_of
from bayeq.inference.gram import Gram, Standardised
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.adequacy import Adequacy, adequacy_of, power_of
from bayeq.likelihood.block import Block, at_its_path
from bayeq.likelihood.channels import Calibration, calibration_of, lags_of
from bayeq.likelihood.courses import with_other_inputs
from bayeq.likelihood.exact_inputs import ExactInputs, exact_inputs
from bayeq.likelihood.fit import Quadratic, State, candidates, integrated_out, of_stated, solved
from bayeq.likelihood.hidden import with_laws_of
from bayeq.likelihood.layout import Stated
from bayeq.likelihood.levels import LEAST_NOISE
from bayeq.likelihood.model import Fitted, Task, calmed, finished, fit, from_all_levels, of_motion, with_model
from bayeq.likelihood.nodes import first_members, fresh
from bayeq.likelihood.peaks import Along, another, farthest
from bayeq.likelihood.profile import Profile, profile_of
from bayeq.likelihood.projection import Leftover, leftover
from bayeq.likelihood.search import CLEARLY, Start, from_starts, resumed, search
from bayeq.likelihood.spike import (
    Nearly,
    Soft,
    among_all_neighbours,
    among_fitted,
    among_neighbours,
    averaged,
    of_gram,
    soft_of,
)
from bayeq.likelihood.start import carried_over, series_and_paths, start_from, stretches
from bayeq.likelihood.unequal import with_unequal_noise
from bayeq.likelihood.unknowns import as_likely, at_other_peaks, joint_covariance, moved, settled, with_constants
from bayeq.numerics.rk4 import Interpolation
from bayeq.numerics.settings import LIKELIHOOD
from bayeq.states import Motion, Sensors
from bayeq.states.motion import with_paths

# Without shrinkage a fit is repeated only if a coefficient moves by more than this share of its standard deviation.
HARDLY = 0.1

# The noise of an input is known from the record if the log likelihoods without noise, with the estimate and with 5 % of
# the standard deviation differ by more nats than this: two standard errors.
SOME, READ = 0.05**2, 2.0


@dataclass(frozen=True, eq=False)
class RecordFit:
    """The fit of all equations of a system to its records."""

    task: Task  # records, candidates and prior
    fitted: Fitted  # a model, at first of the included coefficients, and the likelihood about it
    posterior: Posterior  # over the models of all equations, in units of the coefficients' priors
    nearly: Nearly  # sizes of the functions that the equations lack, and probabilities that they lack none
    likeliest: float = -np.inf  # evidence of the likeliest model that was fitted: the posterior is about that one
    # whether the likelihood is expanded about this model; not if it could not be fitted, but another one was
    own: bool = True
    # a model, and the sums over all rows about it, if the series hold only some rows
    more: tuple[Bools, Block] | None = None
    forms: Forms = field(default_factory=dict)  # of each either-or, the log posteriors of its members
    # other values of constants with which the record is nearly as likely
    rivals: tuple[Mapping[str, float], ...] = ()
    seen: Along | None = None  # the likelihood along coefficients of this fit, or of one to fewer rows

    @classmethod
    def of(cls, task: Task, fitted: Fitted) -> RecordFit:
        """The fit and posterior of the best model, after comparison with its neighbours where this is needed."""
        fitted = fitted.raised(power_of(task, fitted))
        soft = soft_of(task, fitted)
        found = cls(task, fitted, *averaged(task, fitted, soft), fitted.evidence)
        if fitted.power == 1.0 and not max(found.nearly.exact) < LIKELIHOOD.nearly_true:
            # not if a law is only nearly true: as an exact law more terms are likelier, which is no evidence for them
            task, best = among_neighbours(task, fitted)
            soft, fitted = soft if best is fitted else soft_of(task, best), best
            found = cls(task, best, *averaged(task, best, soft), best.evidence)
        included = found.about(found.posterior.support)
        lost = fitted.evidence - included.fitted.evidence
        if included.own and fitted.power * lost < -CLEARLY:
            return cls.of(included.task, included.fitted)  # probabilities must be those about the likelier model
        # with correlated innovations the fit of another model is not more reliable than the Gram, raised to a power
        if included.own and (
            fitted.power < 1.0 or lost < found.worse(included.fitted.model, soft) + LIKELIHOOD.neighbour_window
        ):
            return included
        # the Gram is not reliable for models far from the fitted one
        task, best = (task, fitted) if fitted.tried else among_neighbours(task, fitted, fewer=True)
        if best is not fitted:
            return cls.of(task, best)
        posterior = of_gram(task, fitted.quadratic, partial(among_fitted, task=task, fitted=fitted))
        found = replace(found, posterior=posterior, nearly=Nearly.unknown(task.layout.chains))
        return found.about(found.posterior.support)

    def worse(self, model: Bools, soft: Soft | None) -> float:
        """Nats by which the Gram finds a model less likely than that of the fit, both as exact laws; at least 0."""
        wide = np.array([self.fitted.model, model])
        if soft is not None and soft.constants:
            scores = soft.exact(wide)
        else:
            models = np.array([self.task.narrow(one) for one in wide])
            scores = scores_of(self.task.problem(self.fitted.quadratic), models)
        return max(float(scores[0] - scores[1]), 0.0)

    def of_more(self, task: Task, state: State, quadratic: Quadratic, block: Block) -> RecordFit:
        """The fit by the likelihood of all rows: levels of `state`, `quadratic` and sums of `block` are of all rows."""
        task = replace(task, series=self.task.series, counted=block.samples)
        state = replace(state, paths=self.fitted.state.paths)
        fitted = replace(self.fitted, expand=partial(replace, quadratic), state=state, tried={})
        more = task.model(state.chosen), block
        posterior, nearly = averaged(task, fitted, soft_of(task, fitted))
        found = replace(self, task=task, fitted=fitted, posterior=posterior, nearly=nearly, more=more)
        return found.about(found.posterior.support)

    def about(self, model: Bools) -> RecordFit:
        """The fit of another model, (C (P + 1),) bool; probabilities stay."""
        if self.task.counted is not None:
            state = with_model(self.task, self.fitted, model)
            return replace(self, fitted=replace(self.fitted, model=model, state=state, bent=None))
        if bool((model == self.fitted.model).all()):
            return self
        try:
            other = from_all_levels(self.task, with_model(self.task, self.fitted, model), self.fitted)
            if not (np.diagonal(other.quadratic.information) > 0.0).all():  # a hidden state that nothing depends on
                raise np.linalg.LinAlgError("no information on some candidates")
            task, best = moved(self.task, other)
            return replace(self, task=task, fitted=best.raised(self.fitted.power))
        except np.linalg.LinAlgError:  # it does not stay near the motion: keep the likelihood about the former model
            return replace(self, fitted=replace(self.fitted, model=model), own=False)

    @property
    def of_motion(self) -> float:
        """ln p(data, model) of the motion, given the inputs, up to a constant of the record."""
        return of_motion(self.task, self.fitted)

    @property
    def width(self) -> int:
        """Number of candidates of an equation, the constant included."""
        return len(self.task.layout.terms) + 1

    @property
    def kappa(self) -> Floats:
        """Standard deviation of each equation's discrepancy as a share of its target's, (C,)."""
        return self.fitted.state.levels.kappa

    def told(self, motion: Motion) -> Motion:
        """The motion with the courses of inputs between samples and the noise of channels that the fit found."""
        layout, variance = self.task.layout, self.fitted.state.levels.channels
        pairs = zip(layout.roles.inputs, layout.courses, strict=True)
        courses: dict[str, Interpolation] = {a: b for a, b in pairs if b != "smooth" and b != "cubic"}
        spread = np.concatenate([one.spread for one in self.task.series]).mean(axis=0)
        names = [name for name, _ in layout.channels]
        return replace(
            motion, courses=courses, noise_sd=dict(zip(names, np.sqrt(variance * spread).tolist(), strict=True))
        )

    @property
    def kappa_error(self) -> Floats:
        """Relative standard error of `kappa`, (C,): that of the standard deviation of an AR(1) process."""
        square = self.fitted.state.levels.memory**2
        rows = self.task.rows / len(self.task.layout.channels)
        return np.sqrt((1.0 + square) / (2.0 * rows * (1.0 - square)))

    @cached_property
    def adequacy(self) -> Adequacy:
        """Tests of the fit."""
        with np.errstate(all="ignore"):
            return adequacy_of(self.task, self.fitted)

    @cached_property
    def inputs_of_known_noise(self) -> frozenset[str]:
        """Inputs whose likelihood differs by more than READ between no noise, the estimate, and 5 % of the sd."""
        task, state = self.task, self.fitted.state
        levels, known = state.levels, set()
        for i, name in enumerate(task.layout.roles.inputs, task.layout.first_input):
            sizes = levels.channels[i], *(share * levels.scales.channels[i] for share in (LEAST_NOISE, SOME))
            values = [task.value(replace(state, levels=levels.with_noise(i, size))) for size in sizes]
            if max(values) > min(values) + READ:
                known.add(name)
        return frozenset(known)

    @cached_property
    def flat(self) -> bool:
        """Whether, with a hidden state whose law was found, a sum of coefficients is known mostly by the prior."""
        if all(chain.stated for chain in self.task.layout.roles.hidden):
            return False
        model, unit = self.fitted.model, 1.0 / np.sqrt(self.task.precision[self.fitted.model])
        information = self.fitted.quadratic.information[np.ix_(model, model)] * np.outer(unit, unit)
        return bool(np.linalg.eigvalsh(information)[0] < 1.0)

    @cached_property
    def along(self) -> Along | None:
        """The likelihood along each coefficient; None with constants or flows, or if series hold only some rows."""
        if self.seen is not None and self.seen.fitted is self.fitted:
            return self.seen
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
            if self.own and self.more is None and self.task.flows is None and not self.task.layout.has_constants:
                return Along(self.task, self.fitted, self.seen)
        return None

    @cached_property
    def unshrunk(self) -> tuple[State, Floats]:
        """The fit under a prior that hardly shrinks coefficients, and their covariance with constants estimated too."""
        state, covariance = self._unshrunk
        return state, covariance if self._joint is None else self._joint[0]

    @cached_property
    def _joint(self) -> tuple[Floats, tuple[ConstantEstimate, ...]] | None:
        """Covariance of the coefficients and estimates of constants; None if no candidate has constants."""
        return self._jointly(self.fitted.power)

    def _jointly(self, power: float) -> tuple[Floats, tuple[ConstantEstimate, ...]] | None:
        if not self.task.layout.has_constants:
            return None
        with np.errstate(all="ignore"):
            covariance, found = joint_covariance(self._hardly_shrunk, self._unshrunk[0], power)
            return (covariance, found) if self._profile is None else self._profile.applied(found, power)

    @cached_property
    def _profile(self) -> Profile | None:
        """The likelihood along a constant where it is not normal; None if series hold only some rows, or it fails."""
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
            return profile_of(self._hardly_shrunk, self._unshrunk[0]) if self.more is None else None
        return None

    def constants(self, c: int, power: float = 1.0) -> tuple[ConstantEstimate, ...]:
        """Constants inside the candidates of equation c, with intervals from the likelihood raised to `power`."""
        joint = self._joint if power == 1.0 else self._jointly(power * self.fitted.power)
        allowed, terms = self.task.log_odds[self.block(c)][:-1] > -np.inf, self.task.layout.terms
        names = {name for term, inside in zip(terms, allowed, strict=True) if inside for name in term.unknowns}
        return () if joint is None else tuple(one for one in joint[1] if one.name in names)

    @cached_property
    def _unshrunk(self) -> tuple[State, Floats]:
        """As `unshrunk`, with the constants inside terms held fixed."""
        share, state = 1.0 if self.flat else LIKELIHOOD.unshrunk, self.fitted.state
        if not self.own:  # the state is that of another model
            state = with_model(self.task, self.fitted, self.fitted.model)
        task = replace(self.task, precision=share * self.task.precision)
        included, q = np.flatnonzero(self.fitted.model), self.fitted.quadratic
        precision = task.precision[included]
        with np.errstate(all="ignore"):
            H = q.information[np.ix_(included, included)] + np.diag(precision)
            covariance = solved(H, np.eye(len(H)))
            covariance = 0.5 * (covariance + covariance.T)
            theta = covariance @ q.slope[included]
            moved = np.abs(theta - state.theta) / np.sqrt(np.diagonal(covariance))
            if self.more is None and moved.max(initial=0.0) > HARDLY:
                with suppress(np.linalg.LinAlgError):  # the refit does not stay near the motion
                    there = fit(task, state, coarse=True).state
                    return there, task.marginal(there).covariance / self.fitted.power
            return replace(state, theta=theta), covariance

    @cached_property
    def calibration(self) -> Calibration:
        """Estimated calibration factors of the channels in `gain_sd`, relative to the samples as measured."""
        with np.errstate(all="ignore"):
            return calibration_of(self._hardly_shrunk, self._unshrunk[0], self.fitted.power)

    def elsewhere(self, motion: Motion) -> tuple[Mapping[str, float], ...]:
        """Values of the constants of a family outside of their intervals with which the record is nearly as likely."""
        if self._joint is None or not self.own or self.more is not None:
            return ()
        ends = {one.name: one.ci95 for one in self._joint[1]}
        others = at_other_peaks(motion, self.task, self.fitted)
        return tuple(
            values
            for values, one in others
            if one.evidence > self.fitted.evidence - CLEARLY
            and any(not ends[name][0] <= value <= ends[name][1] for name, value in values.items())
        )

    def with_exact_inputs(self, motion: Motion) -> ExactInputs | None:
        """A fit to the motion as likely as this one, with inputs that have no noise (`exact_inputs`)."""
        if self.more is not None or not self.own:
            return None
        return exact_inputs(motion, self.task, self.fitted, self._unshrunk[1])

    def unstated(self, c: int, j: int) -> float | None:
        """Coefficient of term j in equation c by a fit of the model, and of that term, without the stated coefficients.

        The discrepancy takes up part of what contradicts these, so that an estimate from this fit would be too near
        them. None if such a fit cannot be evaluated, and for conserved sums.
        """
        layout = replace(self.task.layout, stated=())
        if self.task.flows is not None:
            return None
        model = self.fitted.model.copy()
        model[self.block(c).start + j] = True
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
            start = with_model(self.task, self.fitted, model)
            state = from_all_levels(replace(self.task, layout=layout), calmed(fresh(start, layout))).state
            at = np.flatnonzero((state.chosen.chain == c) & (state.chosen.term == j))
            return float(state.theta[at[0]]) if len(at) else None
        return None

    @property
    def _hardly_shrunk(self) -> Task:
        return replace(self.task, precision=LIKELIHOOD.unshrunk * self.task.precision)

    def learned(self, sensors: Sensors) -> Sensors:
        """The sensors with estimated lags and factors, relative to the samples as measured."""
        if not (sensors.lags or sensors.gains):
            return sensors
        with np.errstate(all="ignore"):
            lags = lags_of(self._hardly_shrunk, self._unshrunk[0], self.fitted.power)
        return replace(sensors, lags=lags, gains={name: self.calibration.gains[name] for name in sensors.gains})

    def projectable(self, c: int, model: Bools) -> bool:
        """Whether the fit gives a smoothed right-hand side of equation c for the terms of a model, (P,) bool."""
        if self.task.layout.roles.chains[c].hidden:  # it has no discrepancy
            return False
        about = self.fitted.model if self.more is None else self.more[0]
        same = bool((about == self.fitted.model).all()) and bool((about[self.block(c)][:-1] == model).all())
        return self.own and same and self.task.flows is None and (self.more is None or len(self.more[1].pulls) > 0)

    def own_coefficients(self, c: int) -> tuple[Floats, Floats]:
        """Coefficients of equation c by the likelihood, the constant last if it is in the model; their covariance."""
        state, covariance = self.unshrunk
        own = np.flatnonzero(state.chosen.chain == c)
        covariance = covariance[np.ix_(own, own)]
        if self.along is not None:
            covariance = covariance * np.outer(self.along.widths[own], self.along.widths[own])
        if not isinstance(self.task.between, float):
            number = self.task.number(state.chosen)[own]
            covariance = covariance + self.task.between[np.ix_(number, number)]
        return state.theta[own], covariance

    @cached_property
    def balanced(self) -> tuple[Floats, Floats]:
        """Coefficients (C (P + 1),) of the flows of the model, under a prior that hardly shrinks; their covariance."""
        task, q = self.task, self._softened
        assert task.flows is not None
        chosen = task.flows.narrow(self.fitted.model)
        F, precision = task.flows.matrix[:, chosen], task.flows.precision(task.precision)[chosen]
        H = F.T @ q.information @ F + LIKELIHOOD.unshrunk * np.diag(precision)
        covariance = F @ solved(H, np.eye(len(H))) @ F.T
        return covariance @ q.slope, 0.5 * (covariance + covariance.T)

    def leftover(self, c: int) -> Leftover:
        """Sums for the projection of equation c's smoothed right-hand side on its terms."""
        state, _ = self.unshrunk
        own = np.flatnonzero(state.chosen.chain == c)
        columns, d = state.chosen.term[state.chosen.chain == c], self.task.layout.discrepancy[c]
        left = leftover(
            [terms[:, columns] for terms in candidates(self.task.layout, self.task.series, state)],
            [path[:, d] for path in state.paths],
            [one.intervals for one in self.task.series],
            float(state.levels.target[c]),
        )
        if self.more is None:
            return left
        block = self.more[1]
        return left._replace(
            products=block.products[:, own[:, None], own],
            pulls=block.pulls[:, own],
            square=float(block.squares[c]),
            weight=block.weight,
        )

    def judged(self, motion: Motion) -> Motion:
        """The motion that equations are judged by, held-out rows included: with hidden states smoothed from the record,
        and with drifts removed from channels."""
        layout = self.task.layout
        hidden = [name for chain in layout.roles.hidden for name in chain.states]
        motion = self.told(motion)
        if not (layout.drift or hidden):
            return motion
        motion = with_laws_of(motion, layout.terms, self.fitted.state)
        with np.errstate(all="ignore"):
            series, paths = series_and_paths(layout, motion.records)
            own = replace(self.task, series=series)
            try:
                state, _, smoothed = at_its_path(own, replace(self.fitted.state, paths=paths, blurs=()))
            except np.linalg.LinAlgError:  # the model does not stay near the rows held out
                return motion
        smooth = [path + found.deviation for path, found in zip(state.paths, smoothed, strict=True)]
        if not all(np.isfinite(path).all() for path in smooth):  # the same
            return motion
        if hidden:
            numbers = {name: layout.names.index(name) for name in hidden}
            motion = with_paths(motion, [{name: path[:, i] for name, i in numbers.items()} for path in smooth])
        names, records = [name for name, _ in layout.channels], []
        for rows, path in zip(motion.records, smooth, strict=True):
            drift = dict(zip(names, path[:, layout.drifts].T, strict=False))
            kinds = {"columns": rows.columns, "observed": rows.observed, "samples": rows.samples}
            freed: dict[str, Any] = {
                kind: {name: x - drift[name] if name in drift else x for name, x in columns.items()}
                for kind, columns in kinds.items()
            }
            records.append(replace(rows, **freed))
        return replace(motion, records=tuple(records))

    def block(self, c: int) -> slice:
        """Slice of equation c's candidates among those of all equations."""
        return slice(c * self.width, (c + 1) * self.width)

    @cached_property
    def quadratic(self) -> Quadratic:
        """The likelihood of all candidates with functions of the most probable sizes integrated out; if a sum of states
        is conserved, that of the fit without the ties between equations."""
        task, q = self.task, self.fitted.quadratic
        if task.flows is None:
            return self._softened
        ties = of_stated(task.layout.stated[-task.flows.width :], task.layout.everything, np.zeros(len(q.slope)))
        return replace(q, information=q.information - self.fitted.power * ties.information)

    @cached_property
    def _softened(self) -> Quadratic:
        """The likelihood with functions of the most probable sizes integrated out, or without if that is impossible."""
        tau = self.nearly.tau
        with suppress(np.linalg.LinAlgError):
            if any(tau) or self.task.layout.has_constants:
                return Soft.of(self.task, self.fitted).quadratic(tau)[0]
        return self.fitted.quadratic

    @cached_property
    def standards(self) -> tuple[Standardised, ...]:
        """The regression of each equation, others integrated out, in units of the priors and of the noise.

        The variance of the noise is such that a model's constant is known as well as the mean of n independent rows.
        """
        return tuple(self._standard(c) for c in range(self.task.layout.chains))

    def _standard(self, c: int) -> Standardised:
        q, own = self.quadratic, np.arange(self.block(c).start, self.block(c).stop)
        others = self.fitted.model.copy()
        others[own] = False
        A, b = integrated_out(q, own, np.flatnonzero(others), self.task.precision)
        terms, targets = A[:-1, :-1], b[:-1]
        mean, target_mean = np.zeros(len(targets)), 0.0
        if self.fitted.model[own[-1]]:
            mean, target_mean = A[-1, :-1] / A[-1, -1], float(b[-1] / A[-1, -1])
            terms, targets = terms - np.outer(A[:-1, -1], mean), targets - A[:-1, -1] * target_mean
        n = round(self.task.rows / len(self.task.layout.channels))
        variance = float(n / A[-1, -1])
        names = tuple(term.text for term in self.task.layout.terms)
        yty = max(float(targets @ solved(terms, targets)), 0.0) + n
        gram = Gram(names, n, mean, target_mean, terms * variance, targets * variance, yty * variance, n - 1.0)
        unit = float(np.sqrt(variance))
        return gram.in_units(unit * np.sqrt(self.task.precision[own[:-1]]), unit)

    def left_out_intercept(self, c: int) -> tuple[float, float] | None:
        """Constant of equation c if it were added, and its standard deviation; None if in the model, 0 if hidden."""
        block, q, precision = self.block(c), self.quadratic, self.task.precision
        if self.task.layout.roles.chains[c].hidden:
            return 0.0, 0.0
        if self.fitted.model[block.stop - 1]:
            return None
        inside = np.flatnonzero(self.fitted.model)
        A, b = integrated_out(q, np.array([block.stop - 1]), inside, precision)
        value = 0.0 if self.task.flows is not None else float(b[0] / A[0, 0])
        return value, float(1.0 / np.sqrt(A[0, 0]))


def fit_record(
    motion: Motion,
    terms: Sequence[Expression],
    log_odds: Floats,
    grams: Sequence[Gram],
    tolerance: float | None = None,
    stated: tuple[Stated, ...] = (),
    conserved: Mapping[int, float] | None = None,
    others: Sequence[tuple[Motion, Sequence[Expression], Sequence[Gram]]] = (),
) -> RecordFit | None:
    """Fit P candidates to the training rows of a smoothed motion with time; long records in stretches at first.

    `log_odds`, (C, P + 1), are those of each candidate and of the constant being in the model; `grams`, one per
    equation, are of the smoothed rows; `stated` are priors on sums of coefficients; `conserved` has the factors of the
    states in a conserved sum, by the number of the equation. `others` are other first paths of hidden states, terms
    with the constants of their laws, and Grams: searches start from each, and the likeliest fit is taken. None if the
    likelihood cannot be evaluated.
    """
    with np.errstate(all="ignore"), suppress(np.linalg.LinAlgError):
        some, places = stretches(motion)
        log_odds = first_members(some, terms, log_odds)
        starts = []
        for start, own, sums in [(motion, terms, grams), *others]:
            with suppress(np.linalg.LinAlgError):
                starts.append(start_from(stretches(start)[0], own, sums, log_odds, tolerance, stated, conserved))
        for finish in (False, True):  # the fit of a model that is not finished may fail
            with suppress(np.linalg.LinAlgError):
                return _fitted(motion, some, places, starts, finish)
    return None


def _fitted(
    motion: Motion,
    some: Motion,
    places: Sequence[tuple[int, int]],
    starts: Sequence[tuple[Task, Sequence[Start]]],
    finish: bool,
) -> RecordFit:
    """The likeliest of the fits that searches from the starts lead to; they use `some`, stretches of the motion."""
    pairs = []
    for task, states in starts:
        with suppress(np.linalg.LinAlgError):
            pairs.append(search(task, states, finish))
    if not pairs:
        raise np.linalg.LinAlgError("no search leads to a likelihood that can be evaluated")
    if any(chain.stated for chain in motion.roles.chains):  # a wrong lag looks like another course of an input
        pairs = [settled(some, task, finished(task, fitted)) for task, fitted in pairs]
    elif motion.roles.hidden:
        pairs = among_all_neighbours(pairs)
    (task, fitted), *others = sorted(pairs, key=lambda pair: -pair[1].evidence)
    rivals = as_likely(task, fitted, others)
    task, fitted = with_other_inputs(some, task, fitted)
    task, fitted, forms = with_constants(some, task, fitted)
    if some is not motion:
        return _resumed(motion, task, fitted, places)
    unequal, state = with_unequal_noise(task, fitted.state, motion.sensors)
    fitted = finished(task, fitted) if unequal is task else resumed(unequal, state)
    found = replace(RecordFit.of(unequal, fitted), forms=forms)
    return _checked(found, motion, rivals)


def learned_sensors(
    motion: Motion, terms: Sequence[Expression], log_odds: Floats, grams: Sequence[Gram]
) -> tuple[Sensors, float]:
    """Sensors with lags and factors estimated by a first fit of a dictionary to the training rows, and the largest
    distance from values removed from the samples, in standard deviations; arguments as for `fit_record`.

    A LinAlgError says that the likelihood cannot be evaluated.
    """
    with np.errstate(all="ignore"):
        some, _ = stretches(motion)
        task, states = start_from(some, terms, grams, first_members(some, terms, log_odds), None)
        task, fitted = from_starts(task, states)
        state, before = finished(task, fitted).state, motion.sensors
        lags, found = lags_of(task, state), calibration_of(task, state)
    moved = [abs(one.value - before.lags[name].value) / one.sd for name, one in lags.items()]
    gains = {name: found.gains[name] for name in before.gains}
    return replace(before, lags=lags, gains=gains), max(*moved, found.moved if gains else 0.0, 0.0)


def refit_record(
    motion: Motion, former: RecordFit, terms: Sequence[Expression], grams: Sequence[Gram]
) -> RecordFit | None:
    """Fit all rows of a motion, starting from the fit of the first rows of each record.

    If that leaves a larger discrepancy the search is repeated, and the likelier fit is taken; None if the likelihood
    cannot be evaluated.
    """
    try:
        with np.errstate(all="ignore"):
            places = [(record, 0) for record in range(len(motion.train))]
            found: RecordFit | None = _resumed(motion, former.task, former.fitted, places, former.seen)
    except np.linalg.LinAlgError:
        found = None
    task, most = former.task, np.maximum(LIKELIHOOD.adequate, former.kappa * (1.0 + 2.0 * former.kappa_error))
    if found is not None and found.own and (found.kappa <= most).all():
        return replace(found, rivals=former.rivals or found.rivals)
    log_odds = task.log_odds if task.ranges is None else task.log_odds - task.ranges
    stated, conserved = task.layout.stated, None
    if task.flows is not None:
        stated, conserved = stated[: len(stated) - task.flows.width], task.flows.weights
    other = fit_record(motion, terms, log_odds.reshape(-1, former.width), grams, task.tolerance, stated, conserved)
    pairs = [one for one in (found, other) if one is not None]
    return max(pairs, key=lambda one: one.likeliest, default=None)


def _resumed(
    motion: Motion, task: Task, fitted: Fitted, places: Sequence[tuple[int, int]], seen: Along | None = None
) -> RecordFit:
    task, state = carried_over(motion, task, fitted, places)
    task, state = with_unequal_noise(task, state, motion.sensors)
    task, fitted, forms = with_constants(motion, task, resumed(task, state))
    return _checked(replace(RecordFit.of(task, fitted), forms=forms, seen=seen), motion)


def _checked(found: RecordFit, motion: Motion, rivals: tuple[Mapping[str, float], ...] = ()) -> RecordFit:
    """The fit, or one about a likelier maximum, with its rivals; an error here if an equation cannot be solved."""
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        other = None if found.along is None else another(found.along)
        if other is not None:
            task, less = other
            if less.evidence > found.fitted.evidence:
                higher = _solved(replace(RecordFit.of(task, less), forms=found.forms))
                found, less = higher, found.fitted
            if found.along is not None and found.fitted.evidence < less.evidence + CLEARLY / found.fitted.power:
                one = farthest(found.along, less, found.along.widths)
                rivals = (*rivals, one) if one else rivals
    return _solved(replace(found, rivals=rivals or found.elsewhere(motion), seen=found.along or found.seen))


def _solved(found: RecordFit) -> RecordFit:
    _ = found.standards
    return found
