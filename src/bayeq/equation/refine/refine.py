"""`refine`: posteriors of coefficients fitted to records by their free runs (output error), not by single steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.equation.refine.output_error import Known, OutputError, Unrefined, output_error
from bayeq.errors import BayeqWarning, ConvergenceWarning, DataWarning, RecordError, in_digits, some_of
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import apart, typical_period, window_runs
from bayeq.forecast.rows import Courses, Rows, divided, predicted_target, require_time, rows_of
from bayeq.forecast.score import Scores, percentages, score_rows
from bayeq.inference.posterior import Posterior
from bayeq.numerics.rk4 import Interpolation
from bayeq.numerics.settings import REFINE
from bayeq.records import Record
from bayeq.regression.constraints import Constraints
from bayeq.regression.residuals import Fit, inspect_residuals
from bayeq.states import Sensors, Smooth, estimate_motion
from bayeq.states.motion import held_out_share

# Least rows of a record for a free run.
LEAST_ROWS = 8

# Interpolations of inputs between samples that are tried, besides those that were found before.
KINDS: tuple[Interpolation, ...] = ("cubic", "linear", "band-limited")

# Errors of runs that differ by less than this share count as equal: errors of the integration may do as much.
SAME = 0.01

# Held-out errors count as worse if they are larger by this many standard errors: as improbable as `worse_chance`.
SURE = 2.0

# Number of rows that represents an intercept without error.
MOST_ROWS = 1e140


@dataclass(frozen=True, slots=True)
class Refinement:
    """How equations were refined.

    Attributes
    ----------
    files : tuple of str
        Names of the records.
    n : int
        Rows used.
    segments, longest : int
        Number of free runs, and rows of the longest.
    noise_sd : mapping of str to float
        Standard deviation of the noise of each measured channel: as given, or that of the runs' residuals.
    interpolation : "cubic", "linear", "hold" or "band-limited"
        Interpolation of the inputs between samples.
    converged : bool
        Whether the fit converged, not stopped at its limit of steps.
    at_bound : tuple of str
        Coefficients that the fit put at 0, the end of their known sign, ``"a: v"``, or at a bound,
        ``"a: x**3 = 5"``.
    """

    files: tuple[str, ...]
    n: int
    segments: int
    longest: int
    noise_sd: Mapping[str, float]
    interpolation: Interpolation
    converged: bool
    at_bound: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The refinement in a line of text."""
        runs = "one run" if self.segments == 1 else f"{self.segments} runs"
        noise = ", ".join(f"{name} {sd:.3g}" for name, sd in self.noise_sd.items())
        ends = [one for one in self.at_bound if " = " not in one], [one for one in self.at_bound if " = " in one]
        bound = f"; closest with 0, the end of the known sign, for {', '.join(ends[0])}" if ends[0] else ""
        bound += f"; closest at a bound, {', '.join(ends[1])}" if ends[1] else ""
        return f"coefficients refined by output error: {runs} of up to {self.longest} rows, noise sd {noise}{bound}"


# A posterior, and the other attributes of its `Equation` that change.
Changed = tuple[Posterior, dict[str, Any]]

# Message and category of a warning.
Doubt = tuple[str, type[BayeqWarning]]


def refine(
    before: Dynamics,
    dynamics: Dynamics,
    records: Sequence[Record],
    *,
    smooth: Smooth,
    holdout: float,
    interpolation: Courses,
    constraints: Sequence[Constraints],
    sensors: Sensors,
    noise: Mapping[str, float],
) -> tuple[list[Changed], Refinement, Scores | None, list[Doubt]] | Unrefined:
    """Output-error estimate of the coefficients and intercepts; see `bayeq.Equations.refine`.

    `before` are the equations by regression, with all intercepts; `dynamics` the same with the intercepts that are
    estimated, the others are set to zero. Inputs are interpolated as given, or coefficients are averages over `KINDS`
    and those found before; `noise` has what is known of their standard deviations. Unrefined if free runs over windows
    of the rows used would become worse.

    InputError: channels that are missing, no time, too few rows, or constraints that fix every coefficient.
    """
    known = Known.of(dynamics, constraints)
    kinds: list[Interpolation] = ["cubic"]
    if isinstance(interpolation, str):
        kinds = [interpolation]
    elif dynamics.roles.inputs:
        kinds = list(dict.fromkeys([*KINDS, *interpolation.values()]))
    share = held_out_share(holdout, sum(one.n for one in records))
    measured = motion = estimate_motion(records, dynamics.roles, smooth, share, sensors)
    for rows in measured.records:
        require_time(rows, "refine")
    if not motion.smoothing:
        motion = estimate_motion(records, dynamics.roles, "auto", share, sensors)
    for piece in motion.train:
        if piece.n < LEAST_ROWS:
            raise RecordError(
                f"{piece.name or 'record'}: {piece.n} rows are too few to refine on (at least {LEAST_ROWS})"
            )
    if not motion.smoothing:
        return Unrefined("the records are too short, or have no noise that could be told from motion", "measure more")
    found = output_error(motion, dynamics, dynamics.mean, known, kinds)
    if isinstance(found, Unrefined):
        return found
    train, held_out = divided(measured, rows_of(measured, "refine", found.interpolation))
    duration = REFINE.windows * typical_period(dynamics, train)
    runs = [window_runs(before, train, duration), window_runs(dynamics, train, duration, found.parameters)]
    former, now = (apart(pairs) for pairs in runs)
    # forces that are not in the record (excess: correlated residuals) and noise of inputs drive the motion, which
    # spoils output error unless runs become clearly better
    spoilt = found.excess > 1.0 or any(
        noise.get(name, 0.0) > REFINE.noisy_input * float(np.nanstd(np.concatenate([one[name] for one in records])))
        for name in dynamics.roles.inputs
    )
    if runs_are_worse(*runs) or (spoilt and not runs_are_worse(*reversed(runs))):
        return Unrefined(
            f"free runs over windows of the rows used would err by {100.0 * now:.3g} % instead of {100.0 * former:.3g}"
            f" %{', which may be chance' if now < former else ''}",
            "keep the equations",
        )
    bound, scores = _at_bound(dynamics, found), None
    if held_out:
        scores = score_rows(before, before.mean, held_out), score_rows(dynamics, found.parameters, held_out)
    if spoilt and _worse(scores):
        return Unrefined(f"free runs over the rows held out would err more: {_worse(scores)}", "keep the equations")
    summary = Refinement(
        files=tuple(dict.fromkeys(rows.name for rows in motion.train)),
        n=sum(rows.n for rows in motion.train),
        segments=len(motion.train),
        longest=max(rows.n for rows in motion.train),
        noise_sd=found.noise_sd,
        interpolation=found.interpolation,
        converged=found.converged,
        at_bound=bound,
    )
    refined = [_refined(dynamics, k, block, found, train, held_out) for k, block in enumerate(dynamics.blocks())]
    return refined, summary, scores and scores[1], list(_doubts(found, bound, scores))


def _worse(scores: tuple[Scores, Scores] | None) -> str:
    """Errors of free runs over the rows held out that are clearly larger than before; empty if none is."""
    if scores is None:
        return ""
    before, after = scores
    more = 1.0 + SURE / math.sqrt(2 * after.rows)  # the standard error of a root mean square
    worse = [name for name, error in after.free_run.items() if error > more * before.free_run[name]]
    former, now = (percentages({name: one.free_run[name] for name in worse}) for one in (before, after))
    return f"{now}, before {former}" if worse else ""


def _doubts(found: OutputError, bound: Sequence[str], scores: tuple[Scores, Scores] | None) -> Iterator[Doubt]:
    """Warnings: correlated residuals, worse held-out runs, no convergence, contradicted bounds, noise above given."""
    if found.excess > 1.0:
        times = f"variances of coefficients are {in_digits(found.excess)} times those of white noise"
        yield f"what free runs leave is correlated in time: {times}; add terms", DataWarning
    worse = _worse(scores)
    if worse:
        err = f"free runs over the rows held out err more than before refining: {worse}"
        yield f"{err}; compare both on another record before relying on either", ConvergenceWarning
    if not found.converged:
        limit = "the output-error estimate did not converge within its limit of steps"
        yield f"{limit}: refine the result once more", ConvergenceWarning
    if found.contradicted:
        of = f"{'bound' if any(' = ' in one for one in bound) else 'known sign'} of {some_of(bound, 20)}"
        yield f"free runs contradict the {of} (odds above 100): check directions, or drop it", DataWarning
    for name, ratio in found.misfit.items():
        times = f"{in_digits(ratio)} times the noise that was given"
        yield f"{name}: free runs leave {times}: theirs is taken; check it, or add terms", DataWarning


def runs_are_worse(before: Iterable[tuple[Floats, Floats]], after: Iterable[tuple[Floats, Floats]]) -> bool:
    """Whether free runs over the same windows err more than before, by a sign test, or blow up where none did.

    Both are pairs of run and states from `bayeq.forecast.free_run.window_runs`.

    >>> exact, off, further = (np.full((10, 1), error) for error in (0.0, 1.0, 2.0))
    >>> runs_are_worse([(off, exact)] * 12, [(further, exact)] * 12)
    True
    >>> runs_are_worse([(off, exact)] * 12, [(further, exact)] * 8 + [(exact, exact)] * 4)
    False
    >>> runs_are_worse([(off, exact)] * 12, [(exact, exact)] * 11 + [(exact + np.nan, exact)])
    True
    """
    errors = [(apart([one]), apart([other])) for one, other in zip(before, after, strict=True)]
    if any(math.isinf(now) and not math.isinf(former) for former, now in errors):
        return True
    more = sum(now > (1.0 + SAME) * former for former, now in errors)
    n = more + sum(former > (1.0 + SAME) * now for former, now in errors)
    return sum(math.comb(n, k) for k in range(more, n + 1)) < REFINE.worse_chance * 2**n


def _refined(
    dynamics: Dynamics, k: int, block: slice, found: OutputError, train: Sequence[Rows], held_out: Sequence[Rows]
) -> Changed:
    """The k-th equation's posterior, and its attributes that change: fits on rows used and held out, residuals."""
    law, terms, parameters, free = dynamics.laws[k], dynamics.terms[k], found.parameters[block], found.free[block]
    target = law.chain.target

    def left(pieces: Sequence[Rows]) -> list[Floats]:
        return [rows.columns[target] - predicted_target(terms, parameters, rows.columns) for rows in pieces]

    def fit(pieces: Sequence[Rows]) -> Fit:
        variance = float(np.concatenate([rows.columns[target] for rows in pieces]).var())
        residual = np.concatenate(left(pieces))
        share = float(np.mean(residual**2)) / variance if variance > 0 else 1.0
        return Fit(n=len(residual), r2=1.0 - share, nrmse=math.sqrt(share))

    residuals = left(train)
    noise = sum(float(e @ e) for e in residuals) / max(sum(map(len, residuals)) - int(free.sum()), 1)
    names = (*dynamics.roles.inputs, *law.chain.states)
    return _posterior(law.posterior, parameters, found.covariance[block, block], free, noise), {
        "train": fit(train),
        "held_out": fit(held_out) if held_out else None,
        "residuals": inspect_residuals(residuals, {name: [rows.columns[name] for rows in train] for name in names}),
    }


def _at_bound(dynamics: Dynamics, found: OutputError) -> tuple[str, ...]:
    """Coefficients that the fit put at the end of their known sign, or at a bound, with their target in front."""
    return tuple(
        f"{target}: {term.text}" + (f" = {there:.6g}" if there else "")
        for target, terms, block in zip(dynamics.roles.targets, dynamics.terms, dynamics.blocks(), strict=True)
        for term, there in zip(terms, found.at_bound[block][-len(terms) :], strict=True)
        if np.isfinite(there)
    )


def _posterior(before: Posterior, parameters: Floats, covariance: Floats, free: Bools, noise: float) -> Posterior:
    """A posterior with coefficients and intercept from output error; terms and probabilities stay."""
    support = before.support
    r = int(support.sum())
    coef, center = np.zeros(len(support)), np.zeros(len(support))
    coef[support], spread = parameters[-r:], covariance[-r:, -r:]
    intercept, left = 0.0, 0.0
    if len(parameters) > r:
        # intercept = target_mean - center'coef: this center gives the covariance with the coefficients that was found,
        # and noise_variance/n represents the rest of the intercept's variance. Only free coefficients are solved for:
        # those that follow from others make the covariance singular
        among = np.flatnonzero(free[1:])
        center[np.flatnonzero(support)[among]] = -np.linalg.solve(
            spread[np.ix_(among, among)], covariance[1 + among, 0]
        )
        intercept = float(parameters[0])
        left = float(covariance[0, 0] - center[support] @ spread @ center[support])
    return replace(
        before,
        coef=coef,
        covariance=spread,
        constant=replace(before.constant, center=center, mean=intercept + float(center @ coef)),
        noise_variance=noise,
        # noise_variance/n is the rest of the intercept's variance; an intercept of zero is known exactly
        n=min(noise / max(left, 1e-300), MOST_ROWS),
        averaged=None,
    )
