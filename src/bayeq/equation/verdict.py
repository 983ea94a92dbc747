"""`Verdict`: whether an equation was found, judged by what it predicts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Literal, NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.errors import in_digits
from bayeq.expressions.implicit import multiplied
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import typical_period, window_runs
from bayeq.forecast.rows import divided, rows_of
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.channels import Suspect
from bayeq.likelihood.hinges import Kinks
from bayeq.numerics.settings import EQUATION
from bayeq.regression.regression import Regression
from bayeq.regression.residuals import Fit
from bayeq.states import Motion

Kind = Literal["none", "not determined", "nearly true", "found"]

# Kinds of verdict, the worst first.
KINDS: tuple[Kind, ...] = ("none", "not determined", "nearly true", "found")

# A smaller R2 is zero in two decimals.
NOTHING = 0.005

# A discrepancy below this share of the target's standard deviation has no effect that could be seen.
LEAST_SHOWN = 1e-3

# Runs with drawn coefficients and first states that each window is compared with.
MOVED = 5

LONGER = "a longer record, other amplitudes or frequencies would tell (bayeq plan), or terms known beforehand"
CAREFUL = "parameters may be off by more than their intervals say"

# Most rows at which the effect of the states' errors on an equation is drawn.
MOST_MOVED = 1000

# Most rows at which mass matrices are examined. A determinant counts as 0 below this share of the sum of the magnitudes
# of its products: coefficients that are wrong by as much change its sign.
MOST_MATRICES, SINGULAR = 500, 0.01


# Free runs and the states of the rows there, in units of the spread and noise of the whole motion.
Runs = Sequence[tuple[Floats, Floats]]


class Window(NamedTuple):
    """Median errors of free runs over windows, over the spread and noise of the states in the whole motion.

    Runs of chaotic motion, or near an unstable rest, leave the record however right the equation is: the unit of
    `unexplained` is larger by the distance of runs with first states and coefficients drawn from their distributions.
    """

    error: float
    unexplained: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an equation was found.

    Attributes
    ----------
    kind : "none", "not determined", "nearly true" or "found"
        ``none``: on the rows held out (on the training rows, if none are) the equation explains less than half of the
        target's variance above its noise, or free runs over windows of one period err by at least the spread and noise
        of the whole motion, beside what noise in the first state explains; or the equation has no term. Rows at rest
        are compared with the variance of the whole motion.
        ``not determined``: the engine did not converge, models with other predictions have more than 5 % of the
        probability, the record contradicts what was stated, the first rows refuse terms that all rows ask for, or
        periodic motion does not distinguish the candidates (`bayeq.equation.selection.excitation`).
        ``nearly true``: the law lacks a function of the states (the probability that it lacks none is below 1 %,
        `bayeq.likelihood.spike`), the motion needs a force that no term explains, innovations of a channel are not
        white noise, or a coefficient changes over the record (`bayeq.likelihood.adequacy`); the terms leave more
        than 20 % of the target's standard deviation; or a channel of the motion is clipped in more than 5 % of its
        rows.
    reason : str
        The reason, in a sentence.
    advice : str
        What to do about it, in a sentence; empty if there is nothing.
    """

    kind: Kind
    reason: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}" + (f"; {self.advice}" if self.advice else "")


@dataclass(frozen=True, slots=True)
class ByRuns(Verdict):
    """A verdict by free runs of all equations together alone: errors of estimated states hide what the terms explain.

    It becomes ``not determined`` if another equation is, or if there is none.
    """


def judge(
    target: str,  # the left-hand side
    fit: Fit,  # R2 and errors of the equation; both sides are smoothed alike if the target is estimated
    held_out: bool,  # whether the fit is on the rows held out, not on the training rows
    noise: float,  # share of the target's variance that is noise, or error of its estimate, as far as it is known
    window: Window | None,  # error of free runs over windows, which decide where noise hides the target
    share: float = 1.0,  # the target's variance on these rows as a share of that over the whole motion
    numbers: float = 1.0,  # independent values in a row of the target
) -> Verdict:
    """The verdict on one equation."""
    where = f"the {'held-out' if held_out else 'training'} rows"
    r2, of_all, limit = fit.r2, "", 3.0 * math.sqrt(2.0 / max(numbers * fit.n, 1.0))
    # a variance of n values has the relative error sqrt(2/n): a signal within three of these may be noise
    signal, signal_of_all = 1.0 - noise, 1.0 - share * noise
    if signal_of_all > limit and share * signal < EQUATION.at_rest * signal_of_all:
        r2, signal = 1.0 - share * (1.0 - r2), signal_of_all
        of_all = ", at rest, by the variance of the whole motion"
    explained = f"R2 {r2:.3g}" if r2 >= NOTHING else "R2 0.00"
    if r2 < -NOTHING:
        explained = f"R2 {r2:.2g}, worse than the mean"
    above = r2 / signal if signal > limit else r2
    little = max(above, r2) < EQUATION.least_r2
    by_runs = little and window is not None and not signal > limit
    if little and not by_runs:
        failed = f"the terms explain little of {target} on {where} ({explained}{of_all})"
        return Verdict("none", f"no equation found: {failed}")
    rows = "" if by_runs else f"{explained} on {where}{of_all}"
    if window is None:
        return Verdict("found", rows)
    if not window.unexplained < EQUATION.as_the_mean:
        though = f", though the terms explain {target} row by row ({rows})" if rows else ""
        failed = "started from a measured state the equation is wrong within one period"
        return Verdict("none", f"no equation found: {failed}{though}")
    within = f"free runs over one period within {in_digits(100 * window.error)} %"
    kind = ByRuns if by_runs else Verdict
    return kind("found", f"{rows}{'; ' if rows else ''}{within}")


def suspecting(verdict: Verdict, found: Suspect, seconds: float) -> Verdict:
    """The verdict, at best nearly true, with advice on a channel that seems off; `seconds` is the record's length."""
    name, size, above = found.channel, abs(found.value), found.value > 0.0
    digit, much = 10.0 ** math.floor(math.log10(size)), "large" if above else "small"
    prior = f"{name}={math.ceil(size / digit) * digit:.1g}"
    off, remedy = {
        "high-pass": (f"{name} may be AC-coupled (a high-pass at {size:.2g} Hz)", "couple it DC, or undo that"),
        "lost": (f"rows seem to be lost, as after {size:.4g} s", "check the logger"),
        "rate": (f"the sampling rate may be {in_digits(100 * size)} % too {'low' if above else 'high'}", "check it"),
        "lag": (f"{name} may be {size:.2g} s {'late' if above else 'early'}", f"--lag-sd {prior} learns that"),
        "factor": (f"{name} may be {in_digits(100 * size)} % too {much}", f"--gain-sd {prior} learns that"),
        "offset": (
            f"{name} may be {in_digits(size, 3)} too {much} throughout",
            f"--remove-offset {name}={found.value:.4g}",
        ),
        "noise": (f"{name} has {size:.2g} times the noise that was stated", f"leave out --noise {name}, or correct it"),
        "filter": (
            f"channels look filtered above {in_digits(size, 3)} Hz",
            f"--band {1.0 / seconds:.1g}:{in_digits(size, 3)} allows for that",
        ),
    }[found.off]
    for other in found.as_well:
        share, another = f"{in_digits(100 * abs(other.value))} %", "" if other.channel == name else f"{other.channel} "
        off += {
            "factor": f", or {other.channel} {share} too {'large' if other.value > 0.0 else 'small'}",
            "rate": f", or the sampling rate {share}",
            "high-pass": f", or {another}AC-coupled (a high-pass at {other.value:.2g} Hz)",
        }[other.off]
    if found.as_well and found.off == "factor":
        remedy = "check which, --gain-sd learns one"
    if verdict.kind == "none":
        return replace(verdict, advice=f"{off}: {remedy}")
    advice = f"{CAREFUL}: {off}: {remedy}"
    if verdict.kind == "found":
        noise = f"the record contradicts the noise stated of {name}"
        return Verdict("nearly true", noise if found.off == "noise" else f"other channels contradict {name}", advice)
    return replace(verdict, advice=advice)


def with_kinks(verdict: Verdict, kinks: Kinks, pulses: bool) -> Verdict:
    """The verdict where a kink, jump or bend that no candidate has makes the law likelier.

    "found" becomes "nearly true"; other verdicts get the advice to offer terms with the kink. With `pulses` (it is in
    an input, whose interpolation may look like a kink) "found" and "none" stay. "none" also stays unless the kink
    explains nearly all of the target.
    """
    at = " and ".join(f"{place:.2g}" for place in kinks.places)
    kind = "a kink" if kinks.alone else "a function that bends"
    kind = "a jump" if kinks.jumps and len(kinks.terms) == 1 else kind
    said, offer = f"{kinks.name} has {kind} near {at}, which no candidate has", f"offer {', '.join(kinks.terms)}"
    if verdict.kind == "found" and pulses:
        return verdict
    if verdict.kind == "none" and (pulses or not kinks.left < EQUATION.nothing_else):
        return verdict
    if verdict.kind == "found":
        return Verdict("nearly true", said, f"{CAREFUL}: {offer}")
    return replace(verdict, advice=f"{said}: {offer}")


# Words of a verdict on a clipped channel.
CLIPPED = "is clipped in"


def with_clipping(verdict: Verdict, name: str, share: float) -> Verdict:
    """The verdict, at best nearly true, where a channel lacks samples at its peaks, and so not at random."""
    said = f"{name} {CLIPPED} {in_digits(100.0 * share)} % of its rows"
    larger = "measure it in a larger range"
    if verdict.kind in ("none", "not determined"):
        before = f"{verdict.advice}; " if verdict.kind == "not determined" and verdict.advice else ""
        return replace(verdict, advice=f"{before}{said}: {larger}")
    reason = said if verdict.kind == "found" else f"{said}; {verdict.reason}"
    return Verdict("nearly true", reason, f"{CAREFUL}, and terms may be false: {larger}")


def worst(verdicts: Sequence[tuple[str, Verdict]]) -> Verdict:
    """The verdict on a system of equations: the worst of those given with their targets."""
    least = min((one for _, one in verdicts), key=lambda one: KINDS.index(one.kind))
    if least.kind != "found" or len(verdicts) == 1:
        return least
    return Verdict("found", "; ".join(f"{target}: {one.reason}" for target, one in verdicts))


def alike(dynamics: Dynamics, motion: Motion) -> tuple[str, ...]:
    """Targets of dependent equations: along the motion the determinant of the mass matrix I - A is 0 within its error.

    A holds the factors of highest derivatives in the equations (`bayeq.expressions.implicit`). The determinant does not
    depend on units, and its error is that of the entries times their cofactors.
    """
    targets = dynamics.roles.targets
    coupled = [
        (c, *part, coef, sd)
        for c, (law, members) in enumerate(zip(dynamics.laws, dynamics.terms, strict=True))
        for term, coef, sd in zip(
            members, law.posterior.coef[law.posterior.support], law.posterior.sd[law.posterior.support], strict=True
        )
        if (part := multiplied(term, targets)) is not None
    ]
    if not coupled:
        return ()
    few = _some_rows(motion, MOST_MATRICES)
    left = np.tile(np.eye(len(targets)), (len(next(iter(few.values()))), 1, 1))
    error = np.zeros(left.shape)
    for c, k, rest, coef, sd in coupled:
        factor = evaluate_terms([rest], few)[:, 0]
        left[:, c, k] -= coef * factor
        error[:, c, k] += (sd * factor) ** 2
    if not np.isfinite(left).all():
        return ()
    for i, j in np.ndindex(error.shape[1:]):
        error[:, i, j] *= np.linalg.det(np.delete(np.delete(left, i, axis=1), j, axis=2)) ** 2
    parts = np.median(error.sum(axis=2), axis=0)
    order = range(len(targets))
    sizes = sum(np.abs(left[:, order, entries]).prod(axis=1) for entries in permutations(order))
    least = max(1.96 * math.sqrt(float(parts.sum())), SINGULAR * float(np.median(sizes)))
    if np.median(np.abs(np.linalg.det(left))) > least:
        return ()
    return tuple(target for target, part in zip(targets, parts, strict=True) if part > 0.0)


def _some_rows(motion: Motion, most: int) -> dict[str, Floats]:
    """Columns of about `most` training rows, spread evenly over the records; of all if there are fewer."""
    step = max(1, sum(rows.n for rows in motion.train) // most)
    return {
        name: np.concatenate([rows.columns[name][::step] for rows in motion.train]) for name in motion.train[0].columns
    }


def noise_share(regression: Regression, posterior: Posterior, variance: float) -> float:
    """Share of a target's variance that is noise, as far as a smoother has learned it: of the target, or the error of
    its estimate, and what errors of the estimated states make of the equation's terms."""
    motion, target = regression.motion, regression.chain.target
    own, kept = motion.estimated_by(regression.k), np.flatnonzero(posterior.support)
    error = state_noise(motion).get(target, 0.0) ** 2 if own is None else own.variances[-1]
    sds = {
        name: math.sqrt(own_variance)
        for chain, smoothing in zip(motion.roles.chains, motion.smoothing, strict=False)
        for name, own_variance in zip(chain.states, smoothing.variances[:-1], strict=False)
    }
    if sds and len(kept):
        terms, rng = [regression.design.terms[j] for j in kept], np.random.default_rng(0)
        columns = _some_rows(motion, MOST_MOVED)
        moved = {name: columns[name] + sd * rng.standard_normal(len(columns[name])) for name, sd in sds.items()}
        with np.errstate(all="ignore"):  # a state may leave the range of sqrt(x)
            change = evaluate_terms(terms, {**columns, **moved}) - evaluate_terms(terms, columns)
            squares = (change @ posterior.coef[kept]) ** 2
        error += float(squares[np.isfinite(squares)].sum()) / len(squares)
    return min(error / variance, 1.0) if variance > 0.0 else 0.0


def state_noise(motion: Motion) -> dict[str, float]:
    """Standard deviation of the noise of each measured channel of the chains, where a smoother has learned it."""
    return {
        name: abs(sd * float(gain))
        for chain, smoothing in zip(motion.roles.chains, motion.smoothing, strict=False)
        for name, sd, gain in zip(chain.measured, smoothing.model.noise_sd, smoothing.unit_gains, strict=True)
        if name is not None and sd is not None
    }


def window_errors(dynamics: Dynamics, motion: Motion) -> Sequence[Window | None]:
    """The errors of each equation in free runs over windows of a typical period.

    Windows are from the rows held out, or from the training rows if none fit there. None without time, with too few
    rows, and for static laws.
    """
    none = [None] * len(dynamics.laws)
    if not (motion.timed and dynamics.states):
        return none
    whole = rows_of(motion, "a free run")
    states = np.concatenate([rows.stack(dynamics.states) for rows in whole])
    known = state_noise(motion)
    noise = np.array([known.get(name, 0.0) for name in dynamics.states])
    unit, period = np.hypot(states.std(axis=0), noise), typical_period(dynamics, whole)
    rng = np.random.default_rng(0)
    moved = [(theta, noise * rng.standard_normal(len(noise))) for theta in dynamics.draw(MOVED, rng)]
    train, held_out = divided(motion, whole)
    for part in (held_out, train):
        pieces = [rows for rows in part if rows.n > 1]
        windows = window_runs(dynamics, pieces, period, unit=unit) if pieces else []
        if windows:
            others = [window_runs(dynamics, pieces, period, theta, unit, off) for theta, off in moved]
            places = [[dynamics.states.index(name) for name in chain.states] for chain in dynamics.roles.chains]
            return [_window(windows, others, own) if own else None for own in places]
    return none


def _window(runs: Runs, others: Sequence[Runs], places: Sequence[int]) -> Window:
    """The errors in the states `places`, from runs and from `others` of drawn coefficients and first states."""

    def squares(pairs: Iterable[tuple[Floats, Floats]], blown: float) -> Floats:
        found = np.array([np.mean((one[:, places] - other[:, places]) ** 2) for one, other in pairs])
        return np.where(np.isfinite(found), found, blown)

    errors = squares(runs, math.inf)
    distances = [squares(((run, moved) for (run, _), (moved, _) in zip(runs, one, strict=True)), 0.0) for one in others]
    unexplained = errors / (1.0 + np.mean(distances, axis=0))
    return Window(math.sqrt(np.median(errors)), math.sqrt(np.median(unexplained)))
