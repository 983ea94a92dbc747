"""From a posterior to an equation, with what makes it less than it seems."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import replace

from bayeq.equation.equation import Equation, Fit, Regression, RunnerUp
from bayeq.errors import AmbiguityWarning, ConvergenceWarning, CorrelatedResidualsWarning, DataWarning, WarningLog
from bayeq.gram import Gram
from bayeq.inference import ENGINES, Prior
from bayeq.inference.collapsed.path import partial_shares
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import neighbours
from bayeq.inference.posterior import Posterior
from bayeq.regression.fit import Inferred, Setting, fit_of, inspected, posterior_of

__all__ = ["equation_of"]

# An equation that explains a smaller share of the target's variance is warned of.
LITTLE = 0.5

# A residual of more than this many times the power that is explained is warned of; of adequate models it is 0.9 to 1.3.
INADEQUATE = 1.75

# Runner-up models within this log odds are kept; a swap within AMBIGUOUS means columns that cannot be told apart.
RUNNER_UP_WINDOW = 12.0
RUNNERS_UP = 5
AMBIGUOUS = math.log(20.0)


def equation_of(setting: Setting, inferred: Inferred, log: WarningLog) -> Equation:
    """The equation, its fits and diagnostics; what is to be warned of goes to the log."""
    k, standard, prior, shown = inferred.which, inferred.standard, inferred.prior, inferred.shown
    chain, rows = setting.chains[k], setting.design.train[k]
    posterior, excess = posterior_of(setting, inferred)
    if not posterior.converged:
        rhat = "" if posterior.rhat is None else f", multivariate R-hat {posterior.rhat:.3g}"
        log.warn(
            f"{chain.target}: {setting.method} not converged after {posterior.n_iter} steps{rhat}", ConvergenceWarning
        )
    spike_slab = ENGINES[setting.method].spike_slab
    runners_up = _runners_up(standard.gram, prior, shown) if spike_slab else ()
    if shown.optimum is not None and bool((shown.optimum != inferred.found.support).any()):
        other = [n for n, kept in zip(standard.gram.names, shown.optimum, strict=True) if kept]
        log.warn(
            f"{chain.target}: the optimum of variational Bayes is another model ({', '.join(other) or 'no terms'});"
            " the terms shown are those with a model-averaged PIP above 0.5",
            AmbiguityWarning,
        )
    if posterior.average is None:
        _warn_of_ambiguity(chain.target, runners_up, log)
    else:
        _warn_of_groups(chain.target, posterior, {left.name for left in inferred.left_out}, log)
    states = [name for one in setting.chains for name in one.states]
    residuals = replace(inspected(setting, k, posterior, (*setting.inputs, *states)), excess=excess)
    equation = Equation(
        chain=chain,
        terms=setting.design.terms,
        posterior=posterior,
        train=_fit(rows, posterior),
        held_out=_fit(setting.design.held_out[k], posterior) if setting.design.held_out else None,
        residuals=residuals,
        runners_up=runners_up,
        regression=Regression(
            standard,
            prior,
            inferred.fitted,
            inferred.constraints.reduce(setting.design.held_out[k]) if setting.design.held_out else None,
            shown.support,
        ),
        share=partial_shares(rows, posterior.support),
        left_out=inferred.left_out,
    )
    _warn_of_misfit(equation, inferred, log)
    return equation


def _fit(gram: Gram, posterior: Posterior) -> Fit:
    share = fit_of(gram, posterior)
    return Fit(n=round(gram.n), r2=1.0 - share, nrmse=math.sqrt(share))


def _warn_of_misfit(equation: Equation, inferred: Inferred, log: WarningLog) -> None:
    chain, residuals = equation.chain, equation.residuals
    if equation.train.r2 < LITTLE:
        estimated = " (it is estimated, not measured)" if chain.measured[-1] is None else ""
        log.warn(
            f"{chain.target}: the terms explain only {100 * equation.train.r2:.0f} % of the target's"
            f" variance{estimated}: this is hardly the law; check the channels, their derivatives and the dictionary",
            DataWarning,
        )
    counted = ", which is what the rows count for" if inferred.gram.n < equation.train.n else ""
    if inferred.in_band is None and residuals.correlated:
        log.warn(
            f"{chain.target}: the residuals are correlated in time (lag-1 autocorrelation {residuals.lag1:.2f},"
            f" effective sample size about {residuals.n_eff:.0f} of {residuals.n}{counted}): standard deviations and"
            " intervals may be too narrow, and terms may be included that only fit the correlation",
            CorrelatedResidualsWarning,
        )
    if residuals.excess is not None and residuals.excess > INADEQUATE:
        log.warn(
            f"{chain.target}: the residual has {residuals.excess_text} times the power that the noise of the channels"
            " explains: the equation is only nearly true, or the channels do not fit each other. Terms may be certain"
            " that stand in for what is missing, and intervals do not cover that",
            DataWarning,
        )
    for term, others in inferred.undecided.items():
        log.warn(
            f"{chain.target}: {term} is needed, but its form is undecided: with {' or '.join(others)} instead the fit"
            " and free runs are hardly worse",
            AmbiguityWarning,
        )
    if residuals.driven and residuals.driver is not None:
        log.warn(
            f"{chain.target}: the residuals follow {residuals.driver}: the equation misses dynamics, or channels are"
            " delayed against each other",
            CorrelatedResidualsWarning,
        )


def _runners_up(gram: Gram, prior: Prior, posterior: Posterior) -> tuple[RunnerUp, ...]:
    problem = Problem.of(gram, prior)
    if len(problem.signs):
        from bayeq.inference.signs.listing import signed_neighbours

        moves = signed_neighbours(problem, posterior.support, RUNNER_UP_WINDOW)
    else:
        moves = neighbours(problem, posterior.support, RUNNER_UP_WINDOW)
    names = gram.names
    return tuple(
        RunnerUp(
            leaves=None if move.leaves is None else names[move.leaves],
            enters=None if move.enters is None else names[move.enters],
            log_odds=move.gain,
        )
        for move in moves[:RUNNERS_UP]
    )


def _warn_of_ambiguity(target: str, runners_up: Sequence[RunnerUp], log: WarningLog) -> None:
    swaps = [r for r in runners_up if r.leaves and r.enters and r.log_odds > -AMBIGUOUS]
    if swaps:
        listed = "; ".join(f"{r} (odds {r.odds})" for r in swaps)
        log.warn(f"{target}: columns that the data hardly tell apart: {listed}", AmbiguityWarning)


def _warn_of_groups(target: str, posterior: Posterior, left_out: Set[str], log: WarningLog) -> None:
    assert posterior.average is not None
    for members, some in posterior.average.credible_groups():
        if some <= 0.5:
            continue  # more likely than not that none of them is in
        listed = ", ".join(f"{posterior.names[j]} (PIP {posterior.pip[j]:.2f})" for j in members)
        included = [posterior.names[j] for j in members if posterior.support[j]]
        beside = [posterior.names[j] for j in members if posterior.names[j] in left_out]
        none = f"none, for {', '.join(beside)} stands beside the equation" if beside else "none"
        shown = ", ".join(included) or none
        decided = len(included) == 1 or (not included and beside)
        advice = "" if decided else "; keep one of them in the dictionary, or decide by other knowledge"
        log.warn(
            f"{target}: columns that the data hardly tell apart: {listed}; at least one of them is in with"
            f" probability {some:.2f}; included here: {shown}{advice}",
            AmbiguityWarning,
        )
