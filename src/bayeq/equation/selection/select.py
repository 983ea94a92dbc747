"""Which terms an equation shows: one policy, applied in one place, from the models that the posterior is about.

The included terms are those with a posterior inclusion probability above 0.5, the median probability model (Barbieri
and Berger 2004). An equation shows these, with four exceptions, each applied to the result of the one before it:

1. *dependent*: any two of a, b and a - b are equivalent, so that each may have a probability of two thirds, though
   hardly a model has all three. The likeliest of the models with included terms alone is shown.
2. *undecided*: the same happens to nearly collinear terms, such as x and abs(x) on one side of zero. They share their
   probability, so that none of several forms of damping may reach 0.5, though there certainly is damping. If the
   included terms predict otherwise than the model average, the likeliest model is shown.
3. *max_terms*: a limit that the user sets. The likeliest model within it is shown.
4. *tolerance*: if a law is only nearly true, terms are left out one by one, as long as free runs of the rest, refitted,
   are worse by no more than a tolerance. In such a law false terms compensate for a missing part, also in the channels:
   a filter in the measurement may give damping that depends on the amplitude thousands of nats of evidence, and no
   effect on a run. Predictions are no criterion, and damping stays: that of a light structure explains next to nothing
   and yet decides how its motion decays.

A rule that does not apply changes nothing. None of them changes probabilities or the included terms.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from bayeq.arrays import Bools
from bayeq.errors import InputError, require_number
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import apart, typical_period, window_runs
from bayeq.forecast.rows import divided, rows_of
from bayeq.inference.collapsed.path import DEPENDENT, best_of_each_size, best_without_one, partial_shares, path_sizes
from bayeq.inference.collapsed.problem import gram_block
from bayeq.inference.engines import ENGINES, spike_slab_methods
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Posterior
from bayeq.numerics.settings import LIKELIHOOD, SELECTION
from bayeq.regression.fit import RegressionFit, refitted
from bayeq.states import Motion

Errors = Mapping[float, float]
Runs = Callable[[Sequence[Posterior]], Errors]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A term that is included and not shown."""

    name: str
    pip: float  # its posterior inclusion probability
    share: float  # loss of R2 on the training rows without it, the other included terms refitted
    reason: str  # "dependent", "max_terms", "tolerance" or "undecided"


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits on the equation that is shown."""

    max_terms: int | None = None  # largest number of terms
    # Least discrepancy that a law may have, as a share of the target's standard deviation, and by how much free runs
    # without a term may be worse, as a share of the states' spread. None: the discrepancy is learned; 0: there is none.
    tolerance: float | None = None

    def check(self, method: str) -> None:
        """Check the limits, and that the method's models can be compared; InputError otherwise."""
        if self.tolerance is not None:
            require_number(self.tolerance, "tolerance")
        if not 0 <= (self.tolerance or 0) < 1:
            raise InputError(f"tolerance is a share of the target's sd, 0 <= tolerance < 1, got {self.tolerance!r}")
        if self.max_terms is None:
            return
        try:
            whole = operator.index(self.max_terms)
        except TypeError:
            raise InputError(f"max_terms must be a whole number of terms, got {self.max_terms!r}") from None
        if isinstance(self.max_terms, bool) or whole < 1:
            raise InputError(f"max_terms must be at least 1, got {self.max_terms!r}")
        if not ENGINES[method].spike_slab:
            raise InputError(
                f"max_terms compares models by their posterior, which method {method!r} does not have; choose one of:"
                f" {', '.join(spike_slab_methods())}"
            )


@dataclass(frozen=True, eq=False)
class Selection:
    """The terms that an equation shows."""

    fit: RegressionFit  # the regression that they were chosen from
    # posterior given the terms shown, in units of `shown_fit.standard`; probabilities are those of `fit.posterior`
    shown: Posterior
    # terms that are included or shown but not both, with the rule that decided
    why: Mapping[str, str] = field(default_factory=dict)
    # regression refitted with the record's likelihood about the terms shown, if these differ from the included ones
    own: RegressionFit | None = None
    full: Selection | None = None  # selection of the full model, if terms are left out within the tolerance

    @property
    def shown_fit(self) -> RegressionFit:
        """The regression that the coefficients shown come from."""
        return self.own or self.fit

    @property
    def left_out(self) -> tuple[LeftOut, ...]:
        """Terms that are included and not shown."""
        found = self.fit.posterior
        shares = partial_shares(self.fit.rows, found.support)
        return tuple(
            LeftOut(found.names[j], float(found.pip[j]), float(shares[j]), self.why[found.names[j]])
            for j in np.flatnonzero(found.support & ~self.shown.support)
        )

    @cached_property
    def reported(self) -> Posterior:
        """The posterior given the terms shown, in original units, as it is reported."""
        return self.shown_fit.reported(self.shown)

    def given(self, shown: Posterior, rule: str) -> Selection:
        """The selection with the terms of another posterior, changed by a rule."""
        names, included, model = self.fit.posterior.names, self.fit.posterior.support, shown.support
        why = dict(self.why) | {names[j]: rule for j in np.flatnonzero(model != self.shown.support)}
        differ = {names[j] for j in np.flatnonzero(model != included)}
        return replace(self, shown=shown, why={name: rule for name, rule in why.items() if name in differ})


def select(fits: Sequence[RegressionFit], rules: Rules, motion: Motion, whole: bool = False) -> list[Selection]:
    """The terms that each equation of a system shows.

    Rule 4 does not apply without time or to a static law, whose terms no run depends on. With `whole`, if terms are in
    several equations together, all included terms are shown. InputError if more are forced in than `max_terms`.
    """
    chosen = [Selection(fit, fit.posterior) for fit in fits]
    if whole:
        return chosen
    chosen = [_likeliest_part(one) for one in chosen]
    compared = rules.tolerance != 0.0 and all(ENGINES[fit.posterior.details.method].spike_slab for fit in fits)
    tolerance = rules.tolerance or SELECTION.tolerance
    if compared:
        runs = partial(run_errors, motion, fits) if motion.timed and motion.roles.states else None
        included = [one.shown for one in chosen]
        likeliest = [likeliest_instead(one.fit, k, included, runs, tolerance) for k, one in enumerate(chosen)]
        pairs = zip(chosen, likeliest, strict=True)
        chosen = [one if it is None else one.given(it, "undecided") for one, it in pairs]
    chosen = _refitted([_limited(one, rules.max_terms) for one in chosen])
    nearly = [
        k
        for k, fit in enumerate(fits)
        if (rules.tolerance or fit.regression.exact < LIKELIHOOD.nearly_true) and not fit.regression.chain.static
    ]
    return _simplified(chosen, nearly, tolerance, motion) if compared and motion.timed else chosen


def run_errors(motion: Motion, fits: Sequence[RegressionFit], posteriors: Sequence[Posterior]) -> Errors:
    """Errors of free runs over windows of the training rows, over the states' spread, by window length in periods."""
    expanded = [fit.expanded(one) for fit, one in zip(fits, posteriors, strict=True)]
    dynamics = Dynamics.on(motion, fits[0].regression.design.terms, expanded)
    train, _ = divided(motion, rows_of(motion, "a free run"))
    period = typical_period(dynamics, train)
    lengths = (SELECTION.short_run, SELECTION.long_run)
    return {periods: apart(window_runs(dynamics, train, periods * period)) for periods in lengths}


def hardly_worse(fewer: Errors, whole: Errors, tolerance: float) -> bool:
    """Whether errors `fewer` exceed errors `whole` by at most a tolerance; False if short runs of `whole` are off."""
    compared = [periods for periods in whole if whole[periods] < SELECTION.follows]
    return SELECTION.short_run in compared and all(fewer[periods] <= whole[periods] + tolerance for periods in compared)


def _likeliest_part(one: Selection) -> Selection:
    """The selection of the likeliest model that has included terms alone, by rule 1 or 2."""
    fit, support, average = one.fit, one.shown.support, one.shown.average
    parts = None if average is None else average.models[~(average.models & ~support).any(axis=1)]
    if parts is None or not len(parts) or bool((parts[0] == support).all()):
        return one
    block = gram_block(fit.problem.columns, np.flatnonzero(support))
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(block), np.finfo(np.float64).tiny))
    alike = np.linalg.eigvalsh(block * unit * unit[:, None])[0] > DEPENDENT
    return one.given(fit.given(parts[0]), "undecided" if alike else "dependent")


def prediction_difference(rows: Gram, one: Posterior, other: Posterior) -> float:
    """Root mean square difference of predictions at the rows of a Gram of all terms, as a share of the target's sd."""
    change = one.coef - other.coef
    used = np.flatnonzero(change)
    c = change[used]
    offset = one.intercept - other.intercept + float(rows.mean[used] @ c)
    square = max(float(c @ rows.DtD[np.ix_(used, used)] @ c), 0.0) / rows.n + offset**2
    return math.sqrt(square / (rows.yty / rows.n)) if rows.yty > 0.0 else math.inf


def likeliest_instead(
    fit: RegressionFit, k: int, found: Sequence[Posterior], runs: Runs | None, tolerance: float
) -> Posterior | None:
    """The likeliest model of equation k, whose regression is `fit`, if the included terms misrepresent the average.

    They do if their predictions differ from those of the average by more than the tolerance, and more than those of the
    likeliest model do; or if their free runs are worse than those of the average by more than the tolerance, and no
    better than those of the likeliest model (rule 2). `found` are the posteriors of every equation given its included
    terms; `runs` gives errors of free runs, None without time.
    """
    included = found[k]
    if included.average is None or included.averaged is None or not len(included.average.models):
        return None
    best = included.average.models[0]
    if bool((best == included.support).all()):
        return None
    likeliest = fit.given(best)
    used = included.averaged.coef != 0.0
    mean = replace(included, support=used, coef=included.averaged.coef, covariance=np.zeros((int(used.sum()),) * 2))
    rows, whole = fit.regression.rows, fit.expanded(mean)
    own, other = (prediction_difference(rows, fit.expanded(one), whole) for one in (included, likeliest))
    if own > tolerance and other < own:
        return likeliest
    if runs is None:
        return None
    errors, former = runs([*found[:k], mean, *found[k + 1 :]]), runs(found)
    if not errors[SELECTION.short_run] < SELECTION.follows or hardly_worse(former, errors, tolerance):
        return None
    instead = runs([*found[:k], likeliest, *found[k + 1 :]])
    return likeliest if hardly_worse(instead, former, 0.0) else None


def _simplified(chosen: list[Selection], nearly: Sequence[int], tolerance: float, motion: Motion) -> list[Selection]:
    """Rule 4 for the equations `nearly`: their smallest models within the tolerance, refitted; damping stays."""
    out = chosen
    whole = _errors(motion, chosen) if nearly else {}
    for k in nearly:
        while True:
            one = out[k]
            fit, inside = one.shown_fit, one.shown.support
            stays = inside & (_damping(fit) | np.isposinf(fit.problem.log_odds))
            if int(inside.sum()) <= max(int(stays.sum()), 1):
                break
            problem = fit.problem._replace(log_odds=np.where(stays, math.inf, fit.problem.log_odds))
            model = best_without_one(problem, inside, fit.prior.limits)
            fewer = list(out)
            fewer[k] = replace(one.given(fit.conditional(model), "tolerance"), full=one.full or one)
            if not _errors(motion, fewer)[SELECTION.short_run] < SELECTION.follows:
                break  # refitting cannot compensate for that
            fewer = _refitted(fewer)
            if not hardly_worse(_errors(motion, fewer), whole, tolerance):
                break
            out = fewer
    return out


def _errors(motion: Motion, chosen: Sequence[Selection]) -> Errors:
    return run_errors(motion, [one.shown_fit for one in chosen], [one.shown for one in chosen])


def _damping(fit: RegressionFit) -> Bools:
    """Whether each term is one of an oscillator's velocity alone, (F,)."""
    design, chain = fit.regression.design, fit.regression.chain
    terms = [design.terms[int(j)] for j in fit.constraints.equalities.kept]
    return np.array([chain.order > 1 and term.names == {chain.states[-1]} for term in terms], dtype=np.bool_)


def _refitted(chosen: list[Selection]) -> list[Selection]:
    """Selections refitted about the terms shown, if these differ from the included ones by whatever rule."""
    models = [one.shown.support for one in chosen]
    differ = any(bool((model != one.fit.posterior.support).any()) for one, model in zip(chosen, models, strict=True))
    fits = refitted([one.fit for one in chosen], models) if differ else None
    if fits is None:
        return chosen
    return [
        replace(one, own=fit, shown=fit.conditional(one.shown.support)) for one, fit in zip(chosen, fits, strict=True)
    ]


def _limited(selection: Selection, max_terms: int | None) -> Selection:
    """The likeliest model of at most `max_terms` terms, if more are shown."""
    if max_terms is None:
        return selection
    problem, shown = selection.fit.problem, selection.shown.support
    path_sizes(problem, max_terms)  # refuses fewer than are forced in
    if int(shown.sum()) <= max_terms:
        return selection
    limits = selection.fit.prior.limits
    best, _ = max(best_of_each_size(problem, max_terms, [shown], limits), key=lambda found: found[1])
    return selection.given(selection.fit.given(best), "max_terms")
