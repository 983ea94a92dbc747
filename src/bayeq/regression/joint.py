"""Fits of all equations at once, from the joint posterior that the likelihood of the records gives."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.dictionary import Specification, of_equations
from bayeq.dictionary.families import degree
from bayeq.errors import InputError
from bayeq.inference.auto import VB_STARTS
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Averaged, Constant, Details, ModelAverage, Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.likelihood.hidden import seen_in
from bayeq.likelihood.layout import Stated
from bayeq.likelihood.record_fit import RecordFit, fit_record, learned_sensors
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.by_likelihood import RecordRegression
from bayeq.regression.constraints import Constraints
from bayeq.regression.design import Design
from bayeq.regression.fit import RegressionFit, fit_regression
from bayeq.regression.regression import Regression
from bayeq.states import Sensors

# Standard deviation of the coefficient 1 of a stated law.
EXACTLY = 1e-6

# Methods that average over the models of all equations together.
JOINT = ("auto", "bma")


# Log odds of the constant otherwise: those of a term, p_0 = 0.1.
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

    Of constraints it takes what is stated of coefficients, equalities between them, and which terms are in for their
    bounds; `ties` are between those of several equations, `others` the design at other starts of hidden states.
    """
    if smooth != "auto" or not design.motion.smoothed:
        return None
    stated = [Stated(((c, j, 1.0),), mean, sd) for c, own in enumerate(constraints) for j, mean, sd in own.stated]
    known = {one.parts[0][:2] for one in stated}
    stated += [Stated(((c, j, 1.0),), 1.0, EXACTLY) for c, j in _ones(design) if (c, j) not in known]
    log_odds = _log_odds(design, dictionary, prior)
    for own, odds in zip(constraints, log_odds, strict=False):  # of none there may be no constraints
        odds[:-1][own.forced & (odds[:-1] > -np.inf)] = np.inf
    starts = [(one.motion, one.terms, one.train) for one in others]
    stated += ties
    for c, own in enumerate(constraints):
        tied = own.equalities
        for e, row, value in zip(tied.eliminated, tied.slopes, tied.offsets, strict=True):
            parts = [(c, int(e), 1.0), *((c, int(tied.kept[k]), -row[k]) for k in np.flatnonzero(row))]
            parts = [one for one in parts if design.allowed[c, one[1]]]
            stated += [Stated(tuple(parts), float(value), 0.0)] if parts else []
    return fit_record(design.motion, design.terms, log_odds, design.train, tolerance, tuple(stated), conserved, starts)


def sensors_of_design(design: Design, dictionary: Specification, prior: Prior | None) -> tuple[Sensors, float]:
    """Lags and factors of channels, see `bayeq.likelihood.record_fit.learned_sensors`.

    An InputError says that the likelihood cannot be evaluated.
    """
    try:
        return learned_sensors(design.motion, design.terms, _log_odds(design, dictionary, prior), design.train)
    except np.linalg.LinAlgError:
        raise InputError(
            "lag_sd, gain_sd: both are learned by the likelihood of the record, which could not be evaluated near its"
            " motion: give fewer terms, or smaller ones"
        ) from None


def _log_odds(design: Design, dictionary: Specification, prior: Prior | None) -> Floats:
    """Of every candidate of each equation, and of the constant, not being zero, (C, P + 1)."""
    roles = design.motion.roles
    given = of_equations(dictionary, roles.sought)
    own = [_of_dictionary(design, dictionary if given is None else given[t], prior) for t in roles.sought]
    out = np.array([*own, *(np.full(len(design.terms) + 1, -np.inf) for _ in roles.chains[len(own) :])])
    out[:, :-1][~design.allowed] = -np.inf
    out[[chain.hidden for chain in roles.chains], -1] = -np.inf  # another zero of the state says the same
    for c, j in _ones(design):
        out[c, j] = np.inf
    return out


def _ones(design: Design) -> list[tuple[int, int]]:
    """Equations, and the term of each, whose coefficient is 1: stated laws, and hidden states for their scale."""
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
    """The same, (P + 1,), of one equation."""
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
    """The posterior of every equation: of all together where the method and what is known allow it.

    There is one regression, and one of the constraints, per equation. The method is a row of
    `bayeq.inference.engines.ENGINES`; what follows is as for `bayeq.regression.fit.fit_regression`.
    """
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
    """The same posteriors with the likelihood of the records about other models of the terms, (P,) bool each.

    None where rows count, or where equalities tie coefficients: these have no fit of their own.
    """
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
    """A posterior of equation k with what the likelihood says of the constant."""
    pip = float(record.posterior.pip[record.block(k).stop - 1])
    constant = replace(posterior.constant, pip=pip, left_out=record.left_out_intercept(k))
    return replace(posterior, constant=constant)


def _equation(regression: Regression, record: RecordFit, constraints: Constraints, method: str) -> RegressionFit:
    """The posterior of one equation from that of all; variational Bayes adds a lower bound to "auto"."""
    k, joint = regression.k, record.posterior
    block = np.arange(record.block(k).start, record.block(k).stop)
    terms = block[:-1]
    standard = record.standards[k]
    prior = Prior(slab_variance=1.0, prior_inclusion=np.asarray(record.task.known.prior_inclusion)[terms])
    support = joint.support[terms]
    coef, covariance = exact_posterior(Problem.of(standard.gram, prior), support, None)
    assert joint.averaged is not None
    assert joint.average is not None
    average = _marginal(joint.average, terms)
    posterior = Posterior(
        names=standard.source.names,
        pip=joint.pip[terms],
        support=support,
        coef=coef,
        covariance=covariance,
        constant=Constant(np.zeros(len(terms))),
        noise_variance=1.0,
        n=standard.source.n,
        details=Details(method, joint.details.n_iter, joint.details.converged, 1.0),
        averaged=Averaged(joint.averaged.coef[terms], joint.averaged.sd[terms]),
        average=average,
    )
    if method == "auto":
        vb = spike_slab_vb(standard.gram, prior, models=list(average.models[:VB_STARTS]))
        posterior = replace(posterior, details=replace(posterior.details, elbo_trace=vb.details.elbo_trace))
    return RegressionFit(regression, constraints, standard, prior, _judged(posterior, record, k))


def _marginal(joint: ModelAverage, terms: np.ndarray[tuple[int], np.dtype[np.intp]]) -> ModelAverage:
    """The models of one equation, whatever those of the others."""
    models, which = np.unique(joint.models[:, terms], axis=0, return_inverse=True)
    probability: Floats = np.bincount(which.ravel(), weights=joint.probability).astype(np.float64)
    order = np.argsort(-probability, kind="stable")
    inside = np.flatnonzero(np.isin(joint.terms, terms))
    return ModelAverage(
        models=models[order],
        probability=probability[order],
        left_out=joint.left_out,
        terms=np.asarray(joint.terms[inside] - terms[0], dtype=np.intp),
        covariance=joint.covariance[np.ix_(inside, inside)],
    )
