"""From regressions to posteriors: which prior, which engine, the way back to original units; all equations at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import Specification, of_equations
from bayeq.dictionary.families import degree
from bayeq.errors import InputError
from bayeq.inference.auto import VB_STARTS
from bayeq.inference.collapsed.listing import summed
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import (
    exact_posterior,
    given_model,
    learn_slab_variance,
    noise_given_model,
    residual_scale,
)
from bayeq.inference.engines import ENGINES, Engine
from bayeq.inference.gram import Gram, Standardised
from bayeq.inference.posterior import Averaged, Details, Mixture, ModelAverage, Posterior, of_standardised
from bayeq.inference.prior import Prior, limited
from bayeq.inference.vb import spike_slab_vb
from bayeq.likelihood.hidden import seen_in
from bayeq.likelihood.layout import Stated
from bayeq.likelihood.record_fit import RecordFit, fit_record, learned_sensors
from bayeq.likelihood.search import CLEARLY
from bayeq.likelihood.spike import softened_rows
from bayeq.numerics.distributions import Z95, t_quantile
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.constraints import Constraints
from bayeq.regression.design import Design
from bayeq.regression.regression import RecordRegression, Regression, calibrated
from bayeq.states import Sensors

# The record contradicts a stated coefficient if its own estimate is further off than this many joint standard
# deviations, and a bound if the estimate without it is beyond by this many of its own.
CONTRADICTED = 3.0


@dataclass(frozen=True, eq=False)
class RegressionFit:
    """A regression and its posterior by an engine."""

    regression: Regression  # rows, in original units
    constraints: Constraints  # what is known of the coefficients
    # the Gram that the engine was given: equalities between coefficients taken out, standardised
    standard: Standardised
    prior: Prior  # on standardised columns, with the v_s that was used
    posterior: Posterior  # the engine's, in units of `standard`

    @cached_property
    def problem(self) -> Problem:
        """The Gram and the prior by which models are compared."""
        return Problem.of(self.standard.gram, self.prior)

    @cached_property
    def rows(self) -> Gram:
        """Statistics of the training rows, equalities taken out; shares of variance refer to these."""
        return self.constraints.equalities.reduce(self.regression.rows)

    def given(self, model: Bools) -> Posterior:
        """The posterior given a model of other terms, (F,) bool, in units of `standard`; probabilities stay."""
        return self.posterior if bool((model == self.posterior.support).all()) else self.conditional(model)

    def conditional(self, model: Bools) -> Posterior:
        """Like `given`, but computed from `standard` for the included terms too."""
        coef, covariance = exact_posterior(self.problem, model, self.prior.limits)
        noise = noise_given_model(self.problem, model)
        return replace(self.posterior, support=model, coef=coef, covariance=covariance, noise_variance=noise)

    def expanded(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` in original units and of all P terms."""
        return self.constraints.equalities.expand(posterior.rescaled(self.standard), self.regression.gram)

    def reported(self, posterior: Posterior) -> Posterior:
        """A posterior of `standard` as it is reported: the uncertainty of the sensors' calibration is added to it."""
        found, equalities = self.expanded(posterior), self.constraints.equalities
        basis, limits = equalities.basis(found.support), None
        if self.prior.limits is not None:
            limits = np.tile([-np.inf, np.inf], (len(found.support), 1))
            limits[equalities.kept] = self.prior.limits * (self.standard.target_scale / self.standard.scale)[:, None]
            limits = np.where(np.isfinite(self.constraints.limits), self.constraints.limits, limits)
        found = self.regression.reported(found, basis, limits, not self._truncated(posterior.support))
        found = calibrated(self.regression, found, basis)
        return replace(found, details=replace(found.details, bounds=self.constraints.bounds))

    @cached_property
    def beyond_bounds(self) -> dict[str, tuple[float, float, float]]:
        """Terms beyond bounds by more than CONTRADICTED standard deviations without these: bound, coefficient, and by
        how many.

        A coefficient is estimated together with the included terms and, if its bound is contradicted, also with those
        of the likeliest model.
        """
        bounds, kept, names = self.constraints.bounds, self.constraints.equalities.kept, self.standard.gram.names
        found: dict[str, tuple[float, float, float]] = {}
        if bounds is None:
            return found
        for k in np.flatnonzero(limited(bounds[kept]) & (self.problem.log_odds > -np.inf)):
            refused = names[k] in self.posterior.details.contradicted
            for beside in (self.posterior.support, *([best_models(self.problem)[0][1]] if refused else [])):
                model = beside | (np.arange(len(names)) == k)
                mean, covariance = given_model(self.problem, model)
                place, unit = int(model[:k].sum()), self.standard.target_scale / self.standard.scale[k]
                coef, sd, (low, high) = unit * mean[k], unit * np.sqrt(covariance[place, place]), bounds[kept[k]]
                sds = float(max(low - coef, coef - high) / sd)
                if sds > max(CONTRADICTED, found.get(names[k], (0.0, 0.0, 0.0))[2]):
                    found[names[k]] = (float(high if coef > high else low), float(coef), sds)
        return found

    def _truncated(self, model: Bools) -> bool:
        """Whether limits change the posterior given a model: they do unless the data leave no doubt that they hold."""
        limits = self.prior.limits
        if limits is None:
            return False
        # imports scipy.special, which takes a while
        from bayeq.inference.signs import Truncation

        return bool(Truncation(self.problem, limits, model[None, :]).needed.any())


def fit_regression(
    regression: Regression,
    constraints: Constraints,
    engine: Engine,
    prior: Prior | None = None,
    coarsen: float = 1.0,
    tolerance: float | None = None,
    seed: tuple[int, ...] = (0,),
) -> RegressionFit:
    """Posterior of one equation by a row of `bayeq.inference.engines.ENGINES`.

    Equalities are taken out before inference; signs and bounds go into the prior. That is on standardised columns, the
    target in units of the least-squares residual; by default p_0 = 0.1 and a slab variance v_s that maximises the
    evidence. The likelihood is raised to the power `coarsen`; the law may lack a function of size `tolerance`.
    """
    regression = regression.raised(coarsen)
    reduced = constraints.equalities.reduce(regression.gram)
    standard = reduced.standardise(residual_scale(reduced))
    if tolerance and isinstance(standard.gram, Gram) and regression.counts_rows:
        standard = replace(standard, gram=softened_rows(standard.gram, tolerance))
    used = constraints.prior(prior or Prior(), standard.scale / standard.target_scale)
    if prior is None:
        used = replace(used, slab_variance=learn_slab_variance(standard.gram, used))
    options = {"seed": seed} if engine.random else {}
    return RegressionFit(regression, constraints, standard, used, engine.run(standard.gram, used, **options))


# Largest number of models in a mixture, the likeliest: one takes some 0.05 ms.
MOST_MODELS = 300


def mixture_of(fit: RegressionFit, reported: Posterior, struck: Bools | None = None) -> Mixture | None:
    """Posterior over models of the P coefficients, in original units, then of the intercept, which is in all models.

    The change from the posterior of a model to the one `reported` is applied to all models alike (`_moved`). Terms
    `struck`, (F,), are taken out of every model, the others estimated again. None if models are not averaged, or if
    terms are to be taken out and no models are listed.
    """
    posterior, average, draws = fit.posterior, fit.posterior.average, fit.posterior.draws
    again = struck is not None and bool(struck.any())
    if posterior.averaged is None or (again and average is None):
        return None
    whole = fit.expanded(posterior)
    if average is not None:
        count = min(int(np.searchsorted(np.cumsum(average.probability), REGRESSION.mixture_mass)) + 1, MOST_MODELS)
        models = average.models[:count]
        inside, mean, sd = _given_models(fit, models & ~struck if struck is not None else models, reported)
        share = average.probability[: len(models)]
    elif draws is not None:
        assert whole.draws is not None
        z, theta = (values.reshape(-1, len(whole.names)) for values in (whole.draws.z, whole.draws.theta))
        inside = np.vstack([z.T > 0, np.ones(len(z), dtype=np.bool_)])
        mean = np.vstack([theta.T, whole.constant.mean - theta @ whole.constant.center])
        share = np.full(len(z), 1.0 / len(z))
        sd = np.zeros(mean.shape)
        sd[-1] = np.sqrt(_mean_variance(reported))
    else:
        inside, share = np.zeros((len(whole.names) + 1, 1), dtype=np.bool_), np.ones(1)
        mean, sd = np.zeros(inside.shape), np.zeros(inside.shape)
    weight = inside * share
    total = weight.sum(axis=1)
    lost = total == 0.0
    if lost.any():
        first, spread = (reported.coef, reported.sd) if again else _moments_given_in(whole)
        weight[lost, 0], total[lost] = 1.0, 1.0
        mean[lost, 0] = np.append(first, reported.intercept)[lost]
        sd[lost, 0] = np.append(spread, reported.intercept_sd)[lost]
    weight, mean, sd = (np.ascontiguousarray(part) for part in (weight / total[:, None], mean, sd))
    return Mixture(weight, mean, sd, np.append(whole.pip, 1.0))


def _given_models(fit: RegressionFit, models: Bools, reported: Posterior) -> tuple[Bools, Floats, Floats]:
    """For each term, then the intercept, and each model: whether it is in, mean and standard deviation, (P + 1, K)."""
    (factor, change), own = _moved(fit, reported), _mean_variance(reported)
    few = replace(fit.posterior, averaged=None, average=None)
    shape = len(reported.names) + 1, len(models)
    inside, mean, sd = np.ones(shape, dtype=np.bool_), np.zeros(shape), np.zeros(shape)
    for k, model in enumerate(models):
        coef, covariance = exact_posterior(fit.problem, model, fit.prior.limits)
        one = fit.expanded(replace(few, support=model, coef=coef, covariance=covariance))
        kept, wide = one.support, factor[one.support]
        inside[:-1, k], mean[:-1, k], mean[-1, k] = kept, one.coef + kept * change, one.intercept
        sd[:-1, k] = one.sd * factor
        center = one.constant.center[kept] * wide
        sd[-1, k] = np.sqrt(own + center @ one.covariance @ center)
    return inside, mean, sd


def _mean_variance(reported: Posterior) -> float:
    """Variance that the intercept would have with known coefficients: that of the target's mean."""
    center = reported.constant.center[reported.support]
    return max(reported.intercept_sd**2 - float(center @ reported.covariance @ center), 0.0)


def _moved(fit: RegressionFit, reported: Posterior) -> tuple[Floats, Floats]:
    """Differences (P,) of a model as reported from its posterior: factors of standard deviations, changes of means."""
    factor, change = np.ones(len(reported.names)), np.zeros(len(reported.names))
    if reported.projected is not None and reported.support.any():
        exact = fit.expanded(fit.conditional(reported.support[fit.constraints.equalities.kept]))
        known = exact.sd > 0.0
        factor[known] = t_quantile(reported.projected.freedom[known]) / Z95 * reported.sd[known] / exact.sd[known]
        change[known] = (reported.coef - exact.coef)[known]
    return factor, change


def _moments_given_in(whole: Posterior) -> tuple[Floats, Floats]:
    """Mean and standard deviation of each coefficient given that its term is in, from those over all models."""
    assert whole.averaged is not None
    pip = np.maximum(whole.pip, np.finfo(np.float64).tiny)
    mean = whole.averaged.coef / pip
    square = (whole.averaged.sd**2 + whole.averaged.coef**2) / pip
    return mean, np.sqrt(np.maximum(square - mean**2, 0.0))


# Prior standard deviation of a coefficient that is 1, as of a stated law.
EXACTLY = 1e-6

# Methods that average over the models of all equations together.
JOINT = ("auto", "bma")

# Log odds of the constant, those of a term with p_0 = 0.1, except in polynomials with the default prior.
CONSTANT = math.log(0.1 / 0.9)


def record_of(
    design: Design,
    smooth: str,
    dictionary: Specification,
    prior: Prior | None = None,
    tolerance: float | None = None,
    constraints: Sequence[Constraints] = (),
    ties: Sequence[Stated] = (),
    conserved: Mapping[int, float] | None = None,
    others: Sequence[Design] = (),
) -> RecordFit | None:
    """The likelihood of the records of a design; None where it is not used, or cannot be evaluated.

    `ties` are between coefficients of several equations, `others` the design at other starts of hidden states.
    """
    if smooth != "auto" or not design.motion.smoothed:
        return None
    stated = [Stated(((c, j, 1.0),), mean, sd) for c, own in enumerate(constraints) for j, mean, sd in own.stated]
    known = {one.parts[0][:2] for one in stated}
    stated += [Stated(((c, j, 1.0),), 1.0, EXACTLY) for c, j in _ones(design) if (c, j) not in known]
    log_odds = _log_odds(design, dictionary, prior)
    for own, odds in zip(constraints, log_odds, strict=False):  # there may be no constraints
        odds[:-1][own.forced & (odds[:-1] > -np.inf)] = np.inf
    starts = [(one.motion, one.terms, one.train) for one in others]
    stated += ties
    for c, own in enumerate(constraints):
        for factors, value in own.equalities.equations:
            parts = tuple((c, j, factor) for j, factor in factors.items() if design.allowed[c, j])
            stated += [Stated(parts, value, 0.0)] if parts else []
    return fit_record(design.motion, design.terms, log_odds, design.train, tolerance, tuple(stated), conserved, starts)


def with_model_of(record: RecordFit, more: RecordFit) -> tuple[RecordFit, float]:
    """The fit of the model that more rows led to, if it is clearly likelier on these, else `record`; its gain [nats].

    The gain is 0 where models cannot be compared: with constants, whose values are those of the record's model, and
    if the records of `more` are read some rows at a time.
    """
    with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):
        if more.task.counted is None and not record.task.layout.has_constants:
            other = record.about(more.fitted.model)
            gain = other.fitted.evidence - record.fitted.evidence if other.own else -math.inf
            if not gain > CLEARLY:
                return record, gain
            found = RecordFit.of(other.task, other.fitted)
            _ = found.standards  # an error here if an equation cannot be solved
            return found, gain
    return record, 0.0


def sensors_of_design(design: Design, dictionary: Specification, prior: Prior | None) -> tuple[Sensors, float]:
    """Lags and factors of channels, as `learned_sensors`; an InputError where the likelihood cannot be evaluated."""
    try:
        return learned_sensors(design.motion, design.terms, _log_odds(design, dictionary, prior), design.train)
    except np.linalg.LinAlgError:
        raise InputError(
            "lag_sd, gain_sd: both are learned by the likelihood of the record, which could not be evaluated near its"
            " motion: give fewer terms, or smaller ones"
        ) from None


def _log_odds(design: Design, dictionary: Specification, prior: Prior | None) -> Floats:
    """Prior log odds, (C, P + 1), that each candidate of each equation, and the constant, is not zero."""
    roles = design.motion.roles
    given = of_equations(dictionary, roles.sought)
    own = [_of_dictionary(design, dictionary if given is None else given[t], prior) for t in roles.sought]
    out = np.array([*own, *(np.full(len(design.terms) + 1, -np.inf) for _ in roles.chains[len(own) :])])
    out[:, :-1][~design.allowed] = -np.inf
    out[[chain.hidden for chain in roles.chains], -1] = -np.inf  # a shift of the state's origin is equivalent
    for c, j in _ones(design):
        out[c, j] = np.inf
    return out


def _ones(design: Design) -> list[tuple[int, int]]:
    """(equation, term) with a coefficient fixed at 1: of stated laws, and of terms that set a hidden state's scale."""
    roles = design.motion.roles
    stated = [(c, np.flatnonzero(design.allowed[c]), chain.law) for c, chain in enumerate(roles.chains) if chain.stated]
    for _, own, law in stated:
        if not len(own):
            raise InputError(f"law {law}: it does not change on the data: name a state or an input that does")
    laws = [(c, int(own[0])) for c, own, _ in stated]
    found = [chain for chain in roles.hidden if not chain.stated]
    seen = [one for chain in found for one in seen_in(chain, roles, design.terms, design.allowed)]
    return [*laws, *((one.equation, one.term) for one in seen if one.scaled)]


def _of_dictionary(design: Design, dictionary: Specification, prior: Prior | None) -> Floats:
    """Prior log odds, (P + 1,), of the candidates of one equation and of its constant."""
    terms, inputs = design.terms, design.motion.roles.inputs
    if prior is None and isinstance(dictionary, str) and dictionary.partition(":")[0] == "polynomial":
        degrees = [1 if term.text in inputs else degree(term) for term in terms]
        return REGRESSION.first_odds - REGRESSION.odds_per_degree * np.array([*degrees, 0])
    return np.append((prior or Prior()).log_odds(len(terms)), CONSTANT)


def fit_equations(
    regressions: Sequence[Regression],
    constraints: Sequence[Constraints],
    method: str,
    prior: Prior | None = None,
    coarsen: float = 1.0,
    tolerance: float | None = None,
    seed: int | tuple[int, ...] = 0,
) -> list[RegressionFit]:
    """The posterior of every equation: all jointly where method and constraints allow it, otherwise one by one."""
    record = regressions[0].record if isinstance(regressions[0], RecordRegression) else None
    free = prior is None and coarsen == 1.0 and not any(one.binding for one in constraints)
    if record is not None and method in JOINT and free:
        return [_equation(one, record, own, method) for one, own in zip(regressions, constraints, strict=True)]
    engine, first = ENGINES[method], (seed,) if isinstance(seed, int) else seed
    equal = any(len(one.equalities.eliminated) for one in constraints)
    if record is not None and engine.spike_slab and prior is None and coarsen == 1.0 and not equal:
        return [
            _by_engine(one, record, own, method, (*first, one.k))
            for one, own in zip(regressions, constraints, strict=True)
        ]
    used = [one.thinned() if engine.spike_slab else one for one in regressions]
    return [
        fit_regression(one, own.among(one.design.allowed[one.k]), engine, prior, coarsen, tolerance, (*first, one.k))
        for one, own in zip(used, constraints, strict=True)
    ]


def refitted(fits: Sequence[RegressionFit], models: Sequence[Bools]) -> list[RegressionFit] | None:
    """The posteriors with the likelihood expanded about other models, (P,) bool each; None with rows or equalities."""
    first = fits[0].regression
    if not isinstance(first, RecordRegression) or any(len(one.constraints.equalities.eliminated) for one in fits):
        return None
    model = first.record.fitted.model.copy()
    for k, own in enumerate(models):
        model[first.record.block(k)][:-1] = own
    record = first.record.about(model)
    return [
        replace(
            one,
            regression=replace(one.regression, gram=record.standards[k].source, record=record),
            standard=record.standards[k],
            posterior=_judged(one.posterior, record, k),
        )
        for k, one in enumerate(fits)
        if isinstance(one.regression, RecordRegression)
    ]


def _by_engine(
    regression: Regression, record: RecordFit, constraints: Constraints, method: str, seed: tuple[int, ...]
) -> RegressionFit:
    """The posterior of one equation by an engine, with the prior of the likelihood."""
    k, engine = regression.k, ENGINES[method]
    standard = record.standards[k]
    inclusion = np.asarray(record.task.known.prior_inclusion)[record.block(k)][:-1]
    unit = standard.scale / standard.target_scale
    prior = constraints.prior(Prior(slab_variance=1.0, prior_inclusion=inclusion), unit)
    options = {"seed": seed} if engine.random else {}
    posterior = engine.run(standard.gram, prior, **options)
    return RegressionFit(regression, constraints, standard, prior, _judged(posterior, record, k))


def _judged(posterior: Posterior, record: RecordFit, k: int) -> Posterior:
    """A posterior of equation k with the probability and the estimate of its constant by the likelihood."""
    pip = float(record.posterior.pip[record.block(k).stop - 1])
    constant = replace(posterior.constant, pip=pip, left_out=record.left_out_intercept(k))
    return replace(posterior, constant=constant)


def _equation(regression: Regression, record: RecordFit, constraints: Constraints, method: str) -> RegressionFit:
    """The posterior of one equation from the joint one of all; for "auto" with the ELBO of variational Bayes."""
    k, joint = regression.k, record.posterior
    block = np.arange(record.block(k).start, record.block(k).stop)
    terms = block[:-1]
    standard = record.standards[k]
    prior = Prior(slab_variance=1.0, prior_inclusion=np.asarray(record.task.known.prior_inclusion)[terms])
    support = joint.support[terms]
    settled = not {joint.names[j] for j in block}.intersection(joint.details.unsettled)
    coef, covariance = exact_posterior(Problem.of(standard.gram, prior), support, None)
    assert joint.averaged is not None
    assert joint.average is not None
    average = _marginal(joint.average, terms)
    averaged = Averaged(joint.averaged.coef[terms], joint.averaged.sd[terms])
    details, pip = Details(method, joint.details.n_iter, settled, 1.0), joint.pip[terms]
    posterior = of_standardised(standard.gram, pip, support, coef, covariance, 1.0, details, averaged, average)
    if method == "auto":
        vb = spike_slab_vb(standard.gram, prior, models=list(average.models[:VB_STARTS]))
        posterior = replace(posterior, details=replace(posterior.details, elbo_trace=vb.details.elbo_trace))
    return RegressionFit(regression, constraints, standard, prior, _judged(posterior, record, k))


def _marginal(joint: ModelAverage, terms: np.ndarray[tuple[int], np.dtype[np.intp]]) -> ModelAverage:
    """The models of one equation, with probabilities summed over the models of the others."""
    models, probability = summed(joint.models[:, terms], joint.probability)
    inside = np.flatnonzero(np.isin(joint.terms, terms))
    return ModelAverage(
        models=models,
        probability=probability,
        left_out=joint.left_out,
        terms=np.asarray(joint.terms[inside] - terms[0], dtype=np.intp),
        covariance=joint.covariance[np.ix_(inside, inside)],
    )
