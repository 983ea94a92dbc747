"""Which terms an equation shows: one policy, applied in one place, from the models that the posterior is about.

The included terms are those with a posterior inclusion probability above 0.5, the median probability model (Barbieri
and Berger 2004). An equation shows these, with three exceptions, each applied to what the one before it leaves:

1. *undecided*: collinear terms share their probability, so that none of several forms of damping reaches 0.5, however
   sure it is that there is damping. The included terms then make a far less likely model than others, and the simplest
   of the models that are hardly less likely than the best is shown.
2. *max_terms*: a limit that the user sets. The likeliest model within it is shown.
3. *negligible*: terms that are certain and yet make no practical difference (`bayeq.selection.negligible`).

A rule that does not bind changes nothing. None of them touches probabilities or the included terms.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.inference.collapsed.path import best_of_each_size, model_log_posterior, partial_shares, path_sizes
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Posterior
from bayeq.regression.fit import RegressionFit
from bayeq.selection.negligible import NEGLIGIBLE, FreeRuns, less_negligible, undecided_forms
from bayeq.states import Motion

__all__ = ["LeftOut", "Rules", "Selection", "select"]

Bools = NDArray[np.bool_]

# The included terms are not shown if the likeliest model has more than these posterior odds against them.
LEAST_PLAUSIBLE = 100.0

# Models that are hardly less likely than the best have at most these odds against them.
HARDLY = 10.0


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A term that is included and not shown.

    Attributes
    ----------
    name : str
        The term.
    pip : float
        Its posterior inclusion probability.
    share : float
        What R2 loses on the training rows when it is left out of the included terms and the others are refitted.
    reason : str
        ``"max_terms"``, ``"negligible"`` or ``"undecided"``.
    """

    name: str
    pip: float
    share: float
    reason: str


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits of the equation that is shown.

    Parameters
    ----------
    max_terms : int, optional
        Largest number of terms.
    negligible : float
        Share of the target's variance that negligible terms together explain at most; 0 shows them.
    """

    max_terms: int | None = None
    negligible: float = NEGLIGIBLE

    def check(self, method: str) -> None:
        """Check the limits, and that the method's models can be compared.

        Raises
        ------
        InputError
            Values out of range, or a method without spike-and-slab prior.
        """
        if not 0 <= self.negligible < 1:
            raise InputError(f"negligible is a share of the variance, 0 <= negligible < 1, got {self.negligible!r}")
        if self.max_terms is None:
            return
        try:
            whole = operator.index(self.max_terms)
        except TypeError:
            raise InputError(f"max_terms must be a whole number of terms, got {self.max_terms!r}") from None
        if isinstance(self.max_terms, bool) or whole < 1:
            raise InputError(f"max_terms must be at least 1, got {self.max_terms!r}")
        if not ENGINES[method].spike_slab:
            known = ", ".join(name for name, engine in ENGINES.items() if engine.spike_slab)
            raise InputError(
                f"max_terms compares models by their posterior, which method {method!r} does not have; choose one of:"
                f" {known}"
            )


@dataclass(frozen=True, eq=False)
class Selection:
    """The terms that an equation shows.

    Attributes
    ----------
    fit : RegressionFit
        What they were chosen from.
    shown : Posterior
        Given the terms shown, in units of `shown_fit.standard`; probabilities are those of `fit.posterior`.
    why : mapping of str to str
        Terms that are included or shown and not both, with the rule that decided.
    undecided : mapping of str to tuple of str
        Terms that are shown, each with terms left out that could as well take its place.
    own : RegressionFit, optional
        What the coefficients shown come from, where the likelihood of the record is about them.
    """

    fit: RegressionFit
    shown: Posterior
    why: Mapping[str, str] = field(default_factory=dict)
    undecided: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    own: RegressionFit | None = None

    @property
    def shown_fit(self) -> RegressionFit:
        """What the coefficients shown come from."""
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

    def given(self, model: Bools, rule: str) -> Selection:
        """The selection with the terms of another model, changed by a rule."""
        names, included = self.fit.posterior.names, self.fit.posterior.support
        why = dict(self.why) | {names[j]: rule for j in np.flatnonzero(model != self.shown.support)}
        differ = {names[j] for j in np.flatnonzero(model != included)}
        return replace(
            self, shown=self.fit.given(model), why={name: rule for name, rule in why.items() if name in differ}
        )


def select(fits: Sequence[RegressionFit], rules: Rules, motion: Motion) -> list[Selection]:
    """The terms that each equation of a system shows.

    Parameters
    ----------
    fits : sequence of RegressionFit
        One per equation.
    rules : Rules
        Limits.
    motion : Motion
        Its training rows are what free runs are compared on; without time nothing is negligible.

    Raises
    ------
    InputError
        More terms are forced in than `max_terms`.
    """
    chosen = [_limited(_plausible(Selection(fit, fit.posterior)), rules.max_terms) for fit in fits]
    if rules.negligible and motion.timed and all(ENGINES[fit.posterior.method].spike_slab for fit in fits):
        runs = FreeRuns(motion, fits)
        for k, fit in enumerate(fits):
            shown = [one.shown for one in chosen]
            fewer = less_negligible(fit, k, shown, rules.negligible, runs)
            if fewer is not None:
                undecided = undecided_forms(fit, k, shown, fewer, rules.negligible, runs)
                chosen[k] = replace(chosen[k].given(fewer, "negligible"), undecided=undecided)
    return _refitted(chosen)


def _refitted(chosen: list[Selection]) -> list[Selection]:
    """Coefficients shown by a fit of their own, where others are shown than are included.

    So the same terms have the same coefficients however they were come by.
    """
    found = [one.fit for one in chosen]
    record = found[0].regression.record
    differ = any(bool((one.shown.support != one.fit.posterior.support).any()) for one in chosen)
    if record is None or not differ or any(len(fit.constraints.equalities.eliminated) for fit in found):
        return chosen
    model = record.fitted.model.copy()
    for k, one in enumerate(chosen):
        model[record.block(k)][:-1] = one.shown.support
    about = record.about(model)
    fits = [fit.about(about) for fit in found]
    return [
        replace(one, own=fit, shown=fit.conditional(one.shown.support)) for one, fit in zip(chosen, fits, strict=True)
    ]


def _plausible(selection: Selection) -> Selection:
    """The simplest of the likely models, if the included terms make an unlikely one."""
    fit, average = selection.fit, selection.fit.posterior.average
    if average is None or not len(average.models):
        return selection
    support = fit.posterior.support
    signs = fit.prior.known_signs
    best, own = (model_log_posterior(fit.problem, model, signs) for model in (average.models[0], support))
    if best - own <= math.log(LEAST_PLAUSIBLE):
        return selection
    near = average.models[average.probability >= average.probability[0] / HARDLY]
    holding = near[~(support & ~near).any(axis=1)]
    candidates = holding if len(holding) else near
    # the first of the simplest is the likeliest of them
    simplest = int(np.argmin(candidates @ fit.complexity))
    return selection.given(candidates[simplest], "undecided")


def _limited(selection: Selection, max_terms: int | None) -> Selection:
    """The likeliest model of at most `max_terms` terms, if more are shown."""
    if max_terms is None:
        return selection
    problem, shown = selection.fit.problem, selection.shown.support
    path_sizes(problem, max_terms)  # refuses fewer than are forced in
    if int(shown.sum()) <= max_terms:
        return selection
    signs = selection.fit.prior.known_signs
    best, _ = max(best_of_each_size(problem, max_terms, [shown], signs), key=lambda found: found[1])
    return selection.given(best, "max_terms")
