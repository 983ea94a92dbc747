"""Builds the `Equation` of a selection, with its verdict and the warnings that go with it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from bayeq.dictionary import slopes_of
from bayeq.equation.answer import with_shown
from bayeq.equation.equation import Equation, RunnerUp
from bayeq.equation.plan.information import likeliest_models
from bayeq.equation.selection.alternatives import Alternatives, alternatives_to, bounds, common_root, undetermined
from bayeq.equation.selection.excitation import SPARE, Repeating, repeating
from bayeq.equation.selection.select import Selection
from bayeq.equation.verdict import (
    CAREFUL,
    LEAST_SHOWN,
    LONGER,
    ByRuns,
    Verdict,
    Window,
    alike,
    judge,
    noise_share,
    suspecting,
    window_errors,
    with_clipping,
    with_kinks,
)
from bayeq.equation.written import at_end, chance, is_at_end
from bayeq.errors import (
    AmbiguityWarning,
    BayeqWarning,
    ConvergenceWarning,
    CorrelatedResidualsWarning,
    DataWarning,
    WarningLog,
    in_digits,
    some_of,
)
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.score import Scores, held_out_scores, percent
from bayeq.inference.collapsed.path import model_log_posterior, partial_shares
from bayeq.inference.collapsed.search import neighbours
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.adequacy import Change, Discrepancy, Octave
from bayeq.likelihood.channels import Suspect
from bayeq.numerics.settings import EQUATION, LIKELIHOOD
from bayeq.records.names import in_si, parse_unit
from bayeq.regression.fit import CONTRADICTED, RegressionFit
from bayeq.regression.regression import RecordRegression, Regression, changes_by_noise, inputs_of_hidden_noise
from bayeq.states import Chain, Motion
from bayeq.states.sensors import of_no_unit

# A law that leaves more than this share of the target's standard deviation is at best nearly true: in a short record
# tests may not reject it.
MUCH = 0.2

# If the record gives a smaller share of the precision of a stated coefficient, rounding hides the record's estimate.
TOLD = 1e-8

# Number of independent values whose variance is known to a third.
LEAST_NUMBERS = 18.0

# Noise of an input for the example in a warning that the record hides it, as a share of the input's standard deviation.
NOISE_OF_INPUT = 0.05

# Runner-up models within this log odds are kept; a swap within AMBIGUOUS means columns that cannot be told apart.
RUNNER_UP_WINDOW = 12.0
RUNNERS_UP = 5
AMBIGUOUS = math.log(20.0)

# Advice on columns that are alike over the range of the motion.
TELL_APART = "other amplitudes would tell"


def build_equations(
    selections: Sequence[Selection], units: Mapping[str, str], scored: Sequence[Equation] = ()
) -> tuple[tuple[Equation, ...], Scores | None]:
    """The equations of a system and their scores on the rows held out; `scored` equations give fits and verdicts."""
    design = selections[0].fit.regression.design
    motion = design.motion
    dynamics = Dynamics.on(motion, design.terms, [one.reported for one in selections])
    equations, same = [], alike(dynamics, motion)
    names = [set(compress((one.text for one in design.terms), one.reported.support)) for one in selections]
    given = list(map(_verdict_of, scored, names)) or [None] * len(selections)
    windows = window_errors(dynamics, motion) if None in given else [None] * len(selections)
    for k, one in enumerate(zip(selections, windows, given, strict=True)):
        equation = replace(build_equation(*one), units=units)
        if scored:
            equation = replace(equation, train=scored[k].train, held_out=scored[k].held_out, scored=scored[k])
        if equation.target in same:
            reason = f"the equations for {' and '.join(same)} say the same"
            equation = replace(equation, verdict=Verdict("not determined", reason, f"offer {same[0]} no {same[-1]}"))
        low, high = equation.intercept_ci95
        constant = equation.intercept_matters and not low <= 0.0 <= high
        if not (equation.shown or constant) and equation.verdict.kind != "none":
            without = Verdict("none", "no equation found: no candidate term is in the equation")
            equation = replace(equation, verdict=without)
        equations.append(equation)
    return tuple(equations), held_out_scores(dynamics, motion)


def warn_of(equations: Sequence[Equation], selections: Sequence[Selection], log: WarningLog) -> None:
    """Log what a user must know of each equation."""
    # where a force acts it moves a mass along; others it may move against itself
    along = {name for one in equations for name, value in one.shown_model.coefficients.items() if value > 0.0}
    against = [name for name in selections[0].fit.regression.motion.roles.inputs if name not in along]
    for equation, selection in zip(equations, selections, strict=True):
        for said, category in warnings_of(equation, selection, against):
            log.warn(f"{equation.target}: {said}", category)


def _verdict_of(scored: Equation, names: set[str]) -> Verdict | None:
    """The verdict on a scored equation; None if it is "none" and the equation has other terms, the `names`."""
    return None if scored.verdict.kind == "none" and set(scored.shown) != names else scored.verdict


def build_equation(selection: Selection, window: Window | None, given: Verdict | None = None) -> Equation:
    """The equation of a selection, with its entry in `window_errors`, and the verdict if that is given."""
    fit = selection.fit
    regression, motion = fit.regression, fit.regression.motion
    shown = selection.reported
    same = selection.shown is fit.posterior
    posterior = shown if same else fit.reported(fit.posterior)
    if regression.chain.stated:  # the stated law has the coefficient 1
        shown, posterior = (replace(one, coef=one.support.astype(np.float64)) for one in (shown, posterior))
    train, held_out = regression.fit(shown), regression.held_out_fit(shown)
    # few held-out rows of an estimated target hold too few independent values to judge by
    by_rest = held_out is not None and _numbers(regression) * held_out.n >= LEAST_NUMBERS
    judged, gram = (held_out, regression.held_out) if by_rest else (train, regression.rows)
    assert gram is not None
    assert judged is not None
    variance, whole = gram.yty / gram.n, regression.rows.select([]) + gram.select([]) if by_rest else gram
    noise = noise_share(regression, shown, variance)
    share = variance / (whole.yty / whole.n) if whole.yty > 0.0 else 1.0
    # a term that equalities tie to others has the rule that decided on these
    differ = {
        term.text: selection.why.get(term.text) or next(iter(selection.why.values()))
        for term, inside, seen in zip(regression.design.terms, posterior.support, shown.support, strict=True)
        if inside != seen
    }
    target, numbers = regression.chain.target, _numbers(regression)
    verdict = given or judge(target, judged, by_rest, noise, window, share, numbers)
    # residuals follow the states whose errors they are
    followed = () if isinstance(verdict, ByRuns) else (*motion.roles.inputs, *motion.roles.states)
    residuals = regression.residuals(shown, followed)
    if regression.chain.found:
        verdict = _of_hidden(regression)
    bound = None if verdict.kind == "none" else bounds(fit)
    return Equation(
        chain=with_shown(regression.chain, regression.design.terms, shown),
        unit_gains=tuple(motion.unit_gains[regression.k].tolist()),
        terms=regression.design.terms,
        posterior=posterior,
        shown_posterior=shown,
        train=train,
        held_out=held_out,
        residuals=replace(residuals, discrepancy=regression.discrepancy),
        verdict=verdict,
        runners_up=_runners_up(fit, selection.shown) if ENGINES[posterior.details.method].spike_slab else (),
        fit=fit,
        shown_fit=selection.own,
        share=partial_shares(regression.rows, shown.support),
        why=differ,
        left_out=selection.left_out,
        models=likeliest_models(fit),
        error_probability=None if math.isnan(regression.exact) else max(1.0 - regression.exact, 0.0),
        tau=regression.tau,
        bound=bound,
        undetermined=undetermined(fit, posterior, bound),
        constants=selection.shown_fit.regression.constants,
        forms=regression.forms,
    )


def _of_hidden(regression: Regression) -> Verdict:
    """The verdict on the found law of a hidden state: only whether it is determined; equations with it are judged."""
    z, target = regression.chain.names[0], regression.chain.target
    if isinstance(regression, RecordRegression) and regression.record.flat:
        same = f"sums of {z} and other terms, in place of {z}, predict the same measurements"
        return Verdict("not determined", same, f"give {target} fewer terms")
    return Verdict("found", f"{z} is judged by the equations that it is in")


def _numbers(regression: Regression) -> float:
    """Independent values in a row of the target: less than 1 if a smoother estimated it."""
    smoothing = regression.motion.estimated_by(regression.k)
    return 1.0 if smoothing is None else smoothing.freedom


def with_doubts(
    equations: Sequence[Equation], selections: Sequence[Selection], tolerance: float, clipped: Mapping[str, float]
) -> tuple[Equation, ...]:
    """Equations with verdicts that also consider tests of residuals, models that differ beyond the tolerance, and the
    `clipped` share of each channel."""
    design = selections[0].fit.regression.design
    again = repeating(design.motion, design.terms)
    name, much = max(clipped.items(), key=lambda one: one[1], default=("", 0.0))
    exact: dict[str, Verdict] | None = None
    found = []
    for equation, selection in zip(equations, selections, strict=True):
        verdict, shape = _doubted(equation, selection, tolerance, again), selection.shown_fit.regression.shape
        if verdict.kind == "found":
            exact = _of_noise(selections[0]) if exact is None else exact
            verdict = exact.get(equation.target, verdict)
        same = exchangeable(equation, equations)
        if same is not None and verdict.kind != "none":
            verdict = Verdict("not determined", same, "give the range of the constant that you know, {a: 0.1..1}")
        if much > EQUATION.clipped:
            verdict = with_clipping(verdict, name, much)
        residuals = equation.residuals if shape is None else replace(equation.residuals, **shape._asdict())
        found.append(replace(equation, verdict=verdict, residuals=residuals))
    target = next((one.target for one in found if one.verdict.kind in ("none", "not determined")), None)
    if target is None:
        return tuple(found)
    unsure = Verdict(
        "not determined", f"only free runs speak for it, and they need {target}, which is not found", LONGER
    )
    alone = [isinstance(one.verdict, ByRuns) and one.verdict.kind == "found" for one in found]
    return tuple(replace(one, verdict=unsure) if by_runs else one for one, by_runs in zip(found, alone, strict=True))


def _of_noise(selection: Selection) -> dict[str, Verdict]:
    """Verdicts, by target, on equations with a coefficient that depends on whether inputs have noise or a random force
    acts, which the record does not show."""
    regression, found = selection.fit.regression, dict[str, Verdict]()
    other = regression.record.with_exact_inputs(regression.motion) if isinstance(regression, RecordRegression) else None
    for c, chain in enumerate(regression.motion.roles.chains):
        j, value, apart = (-1, 0.0, 0.0) if other is None else other.farthest(c)
        if other is not None and apart > CONTRADICTED:
            name = regression.design.terms[j].text if j < len(regression.design.terms) else "the constant"
            inputs = ", ".join(other.inputs)
            reason = f"a random force and no noise of {inputs} are as likely, with {name} {value:.4g}"
            found[chain.target] = Verdict("not determined", reason, f"give the noise of {inputs} (--noise)")
    return found


def exchangeable(equation: Equation, equations: Sequence[Equation]) -> str | None:
    """A sentence if the rates of a measured first-order state and of a hidden state that drives it may be exchanged.

    Two first-order lags in series respond alike in either order. None if another term, a state in the hidden law, or
    the range of its constant decides which is which.
    """
    state, own = equation.chain.names[0], equation.shown_coef
    if equation.chain.order != 1 or equation.chain.hidden or state not in own:
        return None
    moving = {name for one in equations for name in one.chain.names}
    for other in equations:
        hidden, law, constants = other.chain.names[0], other.chain.law, other.constants
        alone = set(own) == {state, hidden} and law is not None and law.names & moving == {hidden}
        if law is None or other.chain.found or len(constants) != 1 or not alone:
            continue
        [constant] = law.unknowns.values()
        values = constants[0].value, constant.low, constant.high
        laws = [law.with_unknowns({constant.name: replace(constant, value=x)}) for x in values]
        rates = [float(slope[0]) for one in laws if (slope := slopes_of(one, [hidden])) is not None]
        if len(rates) == 3 and min(rates[1:]) < own[state] < max(rates[1:]):
            return f"{state} and {hidden} may change places: rates {-own[state]:.4g} and {-rates[0]:.4g} /s, as likely"
    return None


def _doubted(equation: Equation, selection: Selection, tolerance: float, again: Repeating | None) -> Verdict:
    # if terms were left out within the tolerance, the full model is compared with the alternatives
    full, regression = selection.full or selection, selection.shown_fit.regression
    # predictions may also differ by tau, the size of the function that the law lacks by the likelihood
    within = max(tolerance, equation.tau)
    others = alternatives_to(full.shown_fit, full.shown_fit.expanded(full.shown), within, equation.tau == 0.0)
    verdict = doubted(equation, others, *regression.tests(), again, regression.counts_rows)
    late = _late(equation, regression.motion) if verdict.kind != "found" else None
    suspect = late or regression.suspect
    # the residual of a small lag follows a slope, so that it looks a quarter of a period late: the likelihood knows it
    if regression.suspect is not None and regression.suspect.off in ("lag", "high-pass", "noise"):
        suspect = regression.suspect
    kinks, chain = regression.kinks, equation.chain
    if suspect is not None and suspect.off != "filter" and kinks is not None and 0.5 * suspect.sds**2 < kinks.gain:
        suspect = None
    if suspect is None and kinks is not None and not chain.stated:
        pulses = kinks.name in regression.motion.roles.inputs and not (chain.static or chain.discrete)
        verdict = with_kinks(verdict, kinks, pulses)
    known = late or verdict.kind in ("nearly true", "found") or verdict.advice == LONGER
    if suspect is not None and (known or suspect.off in ("noise", "offset")):
        seconds = [float(np.ptp(rows.time)) for rows in regression.motion.train if rows.time is not None]
        verdict = suspecting(verdict, suspect, max(seconds))
    odd = of_no_unit(equation.chain, equation.unit_gains, equation.units)
    if odd is not None and verdict.kind == "found":
        name, below, factor = odd
        reason = f"{name} is {factor:.3g} times what {below} gives, and no unit differs by that"
        verdict = Verdict("nearly true", reason, f"check calibration and filters of {name}")
    beyond = selection.fit.beyond_bounds
    refused = [_beyond(name, *one) for name, one in beyond.items()]
    refused += [_stated(equation, *one) for one in _against_stated(equation, selection)]
    refused += [f"the known sign of {name}" for name in _against_signs(selection)]
    if refused and verdict.kind != "none":
        return Verdict("not determined", f"the record contradicts {some_of(refused, 60)}", "check units, or drop it")
    if isinstance(regression, RecordRegression) and regression.record.rivals and verdict.kind != "none":
        other = ", ".join(f"{name} = {value:.4g}" for name, value in regression.record.rivals[0].items())
        return Verdict("not determined", f"as likely with {other}", "give its range ({a: 0.1..1}), or measure longer")
    if verdict.kind in ("none", "not determined"):
        return verdict
    ended = next(filter(is_at_end, equation.shown_constants), None)
    if ended is not None:
        (message,) = at_end(ended, equation.constant_units.get(ended.name, ""), equation.terms)
        reason, _, advice = message.partition(": ")
        return Verdict("not determined", reason, advice)
    root = common_root(equation.chain, equation.terms, equation.shown_posterior)
    if root is not None:
        p = f"{root.real if root.imag == 0.0 else root:.3g}"
        reason = f"both sides have the factor 1 - p/z, p = {p}, within its error: without it the motion is the same"
        return Verdict("not determined", reason, "offer fewer earlier samples, or give the input's noise (--noise)")
    likelier = [one for one in equation.runners_up if one.log_odds > AMBIGUOUS]
    if likelier and not equation.left_out:
        reason = f"by another approximation {likelier[0]} is likelier (odds {likelier[0].odds})"
        return Verdict("not determined", reason, LONGER)
    if equation.posterior.details.converged:
        return verdict
    reason = f"{equation.posterior.details.method} did not converge: probabilities of terms may be off"
    return Verdict("not determined", reason, "give fewer candidate terms, or compare with another method")


def doubted(
    equation: Equation,  # with the verdict of `judge`
    others: Alternatives,  # models with other predictions
    lacking: Discrepancy | None,  # the force that the motion needs and the terms do not explain
    coloured: Octave | None,  # octave in which a channel's innovations are not white
    changing: Change | None,  # a coefficient that changes over the record
    again: Repeating | None = None,  # periodic motion that does not distinguish the candidates
    as_measured: bool = False,  # whether the regression counts rows as they were measured
) -> Verdict:
    """The verdict of an equation, reconsidered: whether the record determines it, and whether it is complete."""
    verdict, chain, share = equation.verdict, equation.chain, equation.error_share
    target, rate = chain.target, "per sample" if chain.discrete else "Hz"
    if verdict.kind in ("none", "not determined") or chain.stated:
        return verdict
    if share is None:
        share = 0.0 if lacking is None else lacking.size
    if share >= EQUATION.as_the_mean:
        return Verdict("none", f"no equation found: the terms leave no less of {target} than its mean does")
    if again is not None and not (chain.discrete and _spare(equation, again.courses) >= SPARE):
        return _on_one_orbit(again, chain)
    for name, gain in zip(chain.measured, equation.unit_gains, strict=False):
        if name is not None and gain < 0.0:
            signs = f"{chain.measured[chain.lowest]} and {name} contradict each other in sign"
            return Verdict("not determined", signs, "reverse one of them")
    if others.probability > EQUATION.doubt:
        change = [f"with {', '.join(others.enter)}"] if others.enter else []
        change += [f"without {', '.join(others.leave)}"] if others.leave else []
        return Verdict(
            "not determined",
            f"other equations, which predict another {target}, have {100 * min(others.probability, 0.99):.2g} % of the"
            f" probability, the likeliest {' and '.join(change) or 'with another constant'}",
            LONGER,
        )
    unexplained = f"{percent(share)} of {target} is not explained by these terms"
    # a changing coefficient explains most of the discrepancy; one that changes sign may stand for a missing term
    if changing is not None and changing.share > share * math.sqrt(0.5) and not changing.reverses:
        return _changing(changing)
    exact = 1.0 - (equation.error_probability or 0.0)
    if exact < LIKELIHOOD.nearly_true and not share < LIKELIHOOD.misfit_least:
        return Verdict(
            "nearly true",
            f"{unexplained}; what is missing depends on the states",
            f"{CAREFUL}: add terms, and check the calibration and timing of the channels",
        )
    # a chaotic map is linearised within the error of its path, which leaves a small discrepancy
    if lacking is not None and not (chain.discrete and share < LEAST_SHOWN):
        low, high = lacking.octave
        return Verdict(
            "nearly true",
            f"{unexplained}, mostly at {in_digits(low)} to {in_digits(high)} {rate}",
            f"{CAREFUL}: add inputs or terms, and check the timing of the channels",
        )
    if changing is not None:
        return _changing(changing)
    if coloured is not None:
        return Verdict(
            "nearly true",
            f"what is left of {coloured.channel} is not white noise: {in_digits(coloured.ratio)} times as much between"
            f" {in_digits(coloured.low)} and {in_digits(coloured.high)} {rate} ({chance(coloured.p, 1)})",
            f"{CAREFUL}: check calibration, timing, filters and hum of {coloured.channel}",
        )
    n, n_eff = equation.residuals.n, equation.residuals.n_eff
    # most rows hold no new information
    if as_measured and equation.train.nrmse > LEAST_SHOWN and n_eff < EQUATION.independent * n:
        return Verdict(
            "nearly true",
            f"the residuals are no white noise: {n} rows tell as much as {n_eff:.0f} independent ones",
            "give the channels as they were measured: filters, of zero phase too, leave what looks like a law",
        )
    if share > MUCH:
        return Verdict("nearly true", unexplained, f"{CAREFUL}: add terms or inputs")
    return verdict


def _spare(equation: Equation, points: int) -> int:
    """Points of a map's cycle, less the number that some law with as many coefficients can always pass through."""
    return points - len(equation.shown) - equation.intercept_matters


def _on_one_orbit(again: Repeating, chain: Chain) -> Verdict:
    if chain.discrete:
        reason = f"the motion is a cycle of {again.courses} points, on which other maps are the same"
        return Verdict("not determined", reason, "start elsewhere, or measure the way to the cycle")
    on_it = f"on it the {again.terms} candidates take {again.courses} independent courses"
    reason = f"the motion repeats itself at {again.frequency:.4g} Hz, and {on_it}"
    if again.single and chain.order == 2:
        square = (2.0 * math.pi * again.frequency) ** 2
        alone = f"determines that alone: {chain.target} = -{square:.4g}*{chain.states[0]}"
        reason = f"the motion has one frequency, {again.frequency:.4g} Hz, and {alone}; {on_it}"
    return Verdict(
        "not determined",
        f"{reason}: other equations are the same there",
        "excite more frequencies and amplitudes (noise, a sweep or a multisine: bayeq plan), or give fewer terms",
    )


def _changing(one: Change) -> Verdict:
    size = "its sign" if one.reverses else f"by {100.0 * one.relative:+.2g} %"
    return Verdict(
        "nearly true",
        f"{one.of} changes {size} over the record ({chance(one.p, 1)})",
        f"{CAREFUL}: answer parts of the record apart (--rows), or offer t times the term",
    )


def _late(equation: Equation, motion: Motion) -> Suspect | None:
    """The channel that explains most of the residuals with a shift of some rows, as a lag; None if there is none."""
    driver, time = equation.residuals.driver, motion.train[0].time
    channels = motion.roles.channels
    if driver is None or driver.name not in channels or len(channels) < 2 or time is None or motion.roles.discrete:
        return None
    if not driver.lag or driver.correlation**2 <= 0.5 or driver.name in motion.sensors.lags:  # learned
        return None
    return Suspect(driver.name, "lag", -driver.lag * float(np.median(np.diff(time))))


def _beyond(name: str, end: float, free: float, sds: float) -> str:
    """A bound, and by how many standard deviations the coefficient would be beyond it."""
    return f"{name} {'<=' if free > end else '>='} {end:.4g} by {in_digits(sds)} sd"


def _stated(equation: Equation, j: int, mean: float, sd: float, _: float) -> str:
    return f"{equation.posterior.names[j]} ~ {mean:.4g} +- {sd:.3g}"


def _against_stated(equation: Equation, selection: Selection) -> Iterator[tuple[int, float, float, float]]:
    """Stated coefficients that the record contradicts: term, mean, sd, and the estimate from the record alone."""
    posterior = equation.posterior
    known = posterior if posterior.projected is None else posterior.projected
    for j, mean, sd in selection.fit.constraints.stated:
        value, spread = float(posterior.coef[j]), math.hypot(sd, float(posterior.sd[j]))  # 0 for a term that is out
        alone = known.sd[j] ** -2.0 - sd**-2.0 if known.sd[j] > 0.0 else 0.0
        if alone * known.sd[j] ** 2 > TOLD:  # else the record tells too little, as of the scale of a hidden state
            value = float((known.coef[j] * known.sd[j] ** -2.0 - mean * sd**-2.0) / alone)
            spread = math.hypot(sd, alone**-0.5)
        if abs(value - mean) > CONTRADICTED * spread:
            yield j, mean, sd, value


def _against_signs(selection: Selection) -> list[str]:
    """Terms whose known signs the record contradicts, or whose bounds it contradicts only together with other terms."""
    fit = selection.fit
    return [name for name in fit.posterior.details.contradicted if name not in fit.beyond_bounds]


def _runners_up(fit: RegressionFit, posterior: Posterior) -> tuple[RunnerUp, ...]:
    if isinstance(fit.regression, RecordRegression) and fit.regression.record.task.flows is not None:
        return ()  # odds of one equation by itself do not keep the conserved sum
    problem, limits, shown, names = fit.problem, fit.prior.limits, posterior.support, posterior.names
    moves = neighbours(problem, shown, RUNNER_UP_WINDOW)
    if limits is not None:
        own = model_log_posterior(problem, shown, limits)
        moves = [replace(move, gain=model_log_posterior(problem, move.apply(shown), limits) - own) for move in moves]
    average = fit.posterior.average
    if average is not None:
        # the model average may have more accurate odds than the information matrix about the model shown
        gains = average.log_odds(shown, {move.apply(shown).tobytes(): move.gain for move in moves})
        moves = [replace(move, gain=gain) for move, gain in zip(moves, gains, strict=True)]
    moves = sorted((move for move in moves if move.gain > -RUNNER_UP_WINDOW), key=lambda move: -move.gain)
    return tuple(
        RunnerUp(
            leaves=None if move.leaves is None else names[move.leaves],
            enters=None if move.enters is None else names[move.enters],
            log_odds=move.gain,
        )
        for move in moves[:RUNNERS_UP]
    )


def _against(equation: Equation, inputs: Sequence[str]) -> str | None:
    """The only input of an oscillator, if its coefficient is negative and it is no acceleration (of a base)."""
    found = {name: value for name, value in equation.shown_model.coefficients.items() if name in inputs}
    if equation.chain.order != 2 or equation.chain.discrete or len(found) != 1:
        return None
    ((name, value),) = found.items()
    unit = in_si(parse_unit(equation.units.get(name, "")))
    return None if value > 0.0 or (unit is not None and unit[1] == {"m": 1, "s": -2}) else name


Said = Iterator[tuple[str, type[BayeqWarning]]]


def warnings_of(equation: Equation, selection: Selection, against: Sequence[str]) -> Said:
    """Warnings about an equation: message and category; inputs `against` act along the motion in no equation."""
    details = equation.posterior.details
    if not details.converged:
        rhat = "" if details.rhat is None else f", multivariate R-hat {details.rhat:.3g}"
        yield f"the search was stopped early{rhat}: probabilities may be off; give fewer terms", ConvergenceWarning
    regression = selection.fit.regression
    if not regression.counts_rows and math.isnan(regression.exact):
        yield "whether the law is exact or only nearly true is not known: measure longer", ConvergenceWarning
    for one in _against_stated(equation, selection):
        record = regression.record if isinstance(regression, RecordRegression) else None
        free = None if record is None else record.unstated(regression.k, one[0])
        said = f"it says {one[-1] if free is None else free:.4g}"
        yield f"the record contradicts {_stated(equation, *one)}: {said}; check both, or drop it", DataWarning
    if (force := _against(equation, against)) is not None:
        against = f"{force} acts against {equation.chain.names[0]}"
        yield f"{against}: reverse it, if a force (--scale {force}=-1)", DataWarning
    beyond = selection.fit.beyond_bounds
    if contradicted := _against_signs(selection):
        what = "sign" if selection.fit.constraints.bounds is None else "sign or bound"
        of = some_of(contradicted, 16)
        yield f"the data contradict the known {what} of {of}: check directions, or drop it", DataWarning
    for name, (end, free, sds) in beyond.items():
        bound = _beyond(name, end, free, sds)
        yield f"the record contradicts {bound} (free: {free:.4g}): check units", DataWarning
    if equation.verdict.kind == "none":
        why = equation.verdict.reason.removeprefix("no equation found: ").partition(", though")[0].partition(" (")[0]
        why = why.replace("started from a measured state the equation is", "free runs are")
        yield f"no equation: {why.replace(f' of {equation.target}', '')}; check channels", DataWarning
    else:  # without an equation no terms are shown
        yield from _of_rivals(equation, selection)
    yield from _of_residuals(equation, regression)
    yield from _of_hidden_noise(equation, selection.shown_fit.regression)


def _of_rivals(equation: Equation, selection: Selection) -> Said:
    """Warnings about other terms that may be in the equation."""
    found, posterior = selection.fit.posterior, equation.posterior
    optimum = found.details.optimum
    if optimum is not None and bool((optimum != found.support).any()):
        other = some_of([n for n, kept in zip(found.names, optimum, strict=True) if kept] or ["none"], 24)
        yield f"variational Bayes alone takes other terms ({other}): measure longer", AmbiguityWarning
    written = [left.name for left in equation.left_out if left.reason == "dependent"]
    if written:
        by = "can be written by the terms shown; either may be in: give fewer terms"
        yield f"{some_of(written, 20)} {by}", AmbiguityWarning
    likelier = [f"{r} (odds {r.odds})" for r in equation.runners_up if r.log_odds > 0.0]
    if likelier and not equation.left_out:
        listed = some_of(likelier, 30, "; ")
        yield f"shown are PIPs above 0.5; likelier is the equation {listed}: measure longer", AmbiguityWarning
    swaps = [r for r in equation.runners_up if r.leaves and r.enters and r.log_odds > -AMBIGUOUS]
    if posterior.average is None and swaps:
        listed = some_of([f"{r} (odds {r.odds})" for r in swaps], 30, "; ")
        yield f"the record cannot tell terms apart: {listed}; {TELL_APART}", AmbiguityWarning
    names, left_out = posterior.names, [left.name for left in equation.left_out]
    for members, some in posterior.average.credible_groups() if posterior.average is not None else ():
        group = [names[j] for j in members]
        if some <= 0.5 or not {*written}.isdisjoint(group):
            continue  # more likely than not that none of them is in; or said already
        listed = some_of([f"{names[j]} (PIP {posterior.pip[j]:.2f})" for j in members], 30)
        shown = [name for name in group if name in equation.shown]
        beside = [name for name in group if name in left_out]
        none = f"none, for {', '.join(beside)} is left out" if beside else "none"
        yield f"cannot tell {listed} apart; shown: {some_of(shown or [none], 12)}; {TELL_APART}", AmbiguityWarning


def _of_residuals(equation: Equation, regression: Regression) -> Said:
    residuals = equation.residuals
    if residuals.discrepancy is not None:
        return
    if residuals.correlated:
        counted = regression.gram.n < equation.train.n
        so = ", which is what the rows count for" if counted else ": intervals may be too narrow"
        advice = "add terms or inputs" if regression.motion.smoothing else "use --smooth auto"
        worth = f"worth {residuals.n_eff:.0f} of {residuals.n:d} rows"
        yield f"correlated residuals, {worth}{so}; {advice}", CorrelatedResidualsWarning
    if residuals.driven and residuals.driver is not None:
        cure = "add a term, or learn its lag (--lag-sd)"
        yield f"the residuals follow {residuals.driver}: {cure}", CorrelatedResidualsWarning


def _of_hidden_noise(equation: Equation, regression: Regression) -> Said:
    """Warnings of inputs whose noise is neither given nor visible: the coefficient that such noise would shift most."""
    for name in inputs_of_hidden_noise(regression, equation.shown_posterior):
        try:
            changes = changes_by_noise(regression, equation.shown_posterior, name, [NOISE_OF_INPUT])
        except np.linalg.LinAlgError:  # terms that are nearly infinite somewhere
            continue
        term, (change,) = max(changes.items(), key=lambda one: abs(one[1][0]))
        shift = f"{100 * NOISE_OF_INPUT:.0f} % would shift {term} by {100 * change:+.2g} %"
        channel = name.partition("[")[0]  # of an earlier sample
        yield f"noise of {channel} unseen, {shift}: give --noise {channel}=SD", DataWarning
