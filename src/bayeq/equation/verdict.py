"""`Verdict`: whether an equation was found, judged by what it predicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.rows import divided, rows_of
from bayeq.forecast.windows import typical_period, window_runs
from bayeq.likelihood.adequacy import Discrepancy, Octave
from bayeq.regression.regression import Regression
from bayeq.regression.residuals import Fit
from bayeq.selection.alternatives import Alternatives
from bayeq.selection.excitation import Repeating
from bayeq.states import Motion

__all__ = ["KINDS", "Verdict", "doubted", "judge", "noise_share", "window_errors", "worst"]

Floats = NDArray[np.float64]

# An equation explains at least this share of what stands above the noise of its target.
LEAST_R2 = 0.5

# More probability of equations that predict otherwise than this leaves an equation undetermined.
DOUBT = 0.05

Kind = Literal["none", "not determined", "nearly true", "found"]

# The worst first.
KINDS: tuple[Kind, ...] = ("none", "not determined", "nearly true", "found")

# An R2 that two decimals show as zero.
NOTHING = 0.005

# A run over a window that errs by the states' own spread is no better than their mean.
AS_THE_MEAN = 1.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an equation was found.

    Attributes
    ----------
    kind : "none", "not determined", "nearly true" or "found"
        ``none``: on the rows held out (on the training rows, if none are) the equation explains less than half of what
        stands above the noise of the target, or free runs over windows of one period are no better than the mean.
        ``not determined``: equations that predict otherwise have more than 5 % of the probability, or the motion
        repeats itself and does not tell the candidates apart (`bayeq.selection.excitation`).
        ``nearly true``: the motion needs a force that the dictionary does not hold, or what is left of a channel is not
        white noise (`bayeq.likelihood.adequacy`).
    reason : str
        In a sentence.
    advice : str
        What to do about it, in a sentence; empty where there is nothing.
    """

    kind: Kind
    reason: str
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}" + (f"; {self.advice}" if self.advice else "")


def judge(
    target: str, fit: Fit, held_out: bool, noise: float, window: float | None, target_estimated: bool = False
) -> Verdict:
    """The verdict on one equation.

    Parameters
    ----------
    target : str
        Its left-hand side.
    fit : Fit
        On the rows held out, or on the training rows.
    held_out : bool
        Which of them.
    noise : float
        Share of the target's variance that is noise, as far as it is known.
    window : float or None
        Error of free runs over windows, as a share of the states' spread; None where there are none.
    target_estimated : bool
        Whether the target is no measurement but a smoother's, and runs tell more.
    """
    if target_estimated and window is not None:
        if not window < AS_THE_MEAN:
            return Verdict(
                "none", "no equation found: free runs over windows of one period are no better than the mean"
            )
        return Verdict("found", f"free runs over one period within {100 * window:.2g} %")
    where = f"the {'held-out' if held_out else 'training'} rows"
    explained = f"R2 {fit.r2:.3g}" if fit.r2 >= NOTHING else "R2 0.00"
    if fit.r2 < -NOTHING:
        explained = f"R2 {fit.r2:.2g}, worse than the mean"
    # the variance of n rows errs by sqrt(2/n) of itself: less than that tells nothing of what is above the noise
    signal = 1.0 - noise
    above = fit.r2 / signal if signal > 3.0 * math.sqrt(2.0 / max(fit.n, 1)) else fit.r2
    if max(above, fit.r2) < LEAST_R2:
        return Verdict("none", f"no equation found: the terms explain little of {target} on {where} ({explained})")
    if window is None:
        return Verdict("found", f"{explained} on {where}")
    if not window < AS_THE_MEAN:
        return Verdict(
            "none",
            f"no equation found: free runs over windows of one period are no better than the mean, though the terms"
            f" explain {target} row by row ({explained} on {where})",
        )
    return Verdict("found", f"{explained} on {where}; free runs over one period within {100 * window:.2g} %")


def doubted(
    verdict: Verdict,
    target: str,
    others: Alternatives,
    lacking: Discrepancy | None,
    coloured: Octave | None,
    spread: float,
    excess: float | None = None,
    again: Repeating | None = None,
) -> Verdict:
    """The verdict of an equation that is not wrong: is it determined, and is it all there is?

    Parameters
    ----------
    verdict : Verdict
        Of `judge`.
    target : str
        Left-hand side.
    others : Alternatives
        Equations that predict otherwise.
    lacking : Discrepancy or None
        What the motion needs and the equation does not hold.
    coloured : Octave or None
        Where what is left of a channel is not white.
    spread : float
        Standard deviation of the target, in its unit.
    excess : float, optional
        Power of the residual over that of the noise, in a band, where it is too large.
    again : Repeating, optional
        Motion that repeats itself and does not tell the candidates apart.
    """
    if verdict.kind == "none":
        return verdict
    if again is not None:
        return Verdict(
            "not determined",
            f"the motion repeats itself at {again.frequency:.4g} Hz, and on it the {again.terms} candidates take"
            f" {again.courses} independent courses: other equations are the same there",
            "excite more frequencies and amplitudes (noise, a sweep or a multisine: bayeq plan), or give fewer terms",
        )
    if others.probability > DOUBT:
        change = [f"with {', '.join(others.enter)}"] if others.enter else []
        change += [f"without {', '.join(others.leave)}"] if others.leave else []
        return Verdict(
            "not determined",
            f"equations that predict {target} otherwise have {100 * others.probability:.2g} % of the probability,"
            f" the likeliest {' and '.join(change) or 'with another constant'}",
            "a longer record, other amplitudes or frequencies would tell (bayeq plan), or terms known beforehand",
        )
    if lacking is not None:
        low, high = lacking.octave
        return Verdict(
            "nearly true",
            f"the motion needs what the dictionary does not hold, {100 * lacking.size:.2g} %"
            f" ({100 * lacking.low:.2g} to {100 * lacking.high:.2g}) of the standard deviation of {target}"
            f" ({lacking.size * spread:.2g}), mostly between {low:.2g} and {high:.2g} Hz",
            "add terms or inputs that may be missing, and check the timing of the channels; included terms may"
            " compensate for what is missing",
        )
    if coloured is not None:
        return Verdict(
            "nearly true",
            f"what is left of {coloured.channel} is not white noise: {coloured.ratio:.2g} times as much between"
            f" {coloured.low:.2g} and {coloured.high:.2g} Hz (p {_chance(coloured.p)})",
            f"check {coloured.channel} against the other channels: calibration, timing, filters, hum",
        )
    if excess is not None:
        return Verdict(
            "nearly true",
            f"the residual of {target} has {excess:.2g} times the power that the noise of the channels explains",
            "add terms or inputs that may be missing, and check the channels against each other",
        )
    return verdict


def _chance(p: float) -> str:
    return f"= {p:.1g}" if p >= 1e-4 else "< 0.0001"


def worst(verdicts: Sequence[tuple[str, Verdict]]) -> Verdict:
    """The verdict on a system of equations, by their targets: the worst of them."""
    for kind in KINDS[:-1]:
        failed = [one for _, one in verdicts if one.kind == kind]
        if failed:
            return failed[0]
    if len(verdicts) == 1:
        return verdicts[0][1]
    return Verdict("found", "; ".join(f"{target}: {one.reason}" for target, one in verdicts))


def noise_share(regression: Regression, variance: float) -> float:
    """Share of a measured target's variance that is noise, where the smoother has learned it; else 0."""
    chain, smoothing = regression.chain, regression.motion.smoothing
    if chain.measured[-1] is None or not smoothing or not variance > 0.0:
        return 0.0
    own = smoothing[regression.k]
    sd = own.model.noise_sd[chain.order]
    return 0.0 if sd is None else min(float((sd * own.unit_gains[chain.order]) ** 2 / variance), 1.0)


def window_errors(dynamics: Dynamics, motion: Motion) -> list[float] | None:
    """Errors of free runs over windows of one period, one per chain, as shares of the spread of its states.

    Each is the median over windows of the rows held out, or of the training rows if none are. A window is one period
    long, 2 pi sd(x)/sd(x'), over which chaotic motion can be followed too.

    Returns
    -------
    list of float or None
        Infinite where most runs blow up; None without time, or where rows are too few for a window.
    """
    if not motion.timed:
        return None
    train, held_out = divided(motion, rows_of(motion, "a free run"))
    for part in (held_out, train):
        pieces = [rows for rows in part if rows.n > 1]
        if pieces:
            windows = window_runs(dynamics, pieces, typical_period(dynamics, pieces))
            if windows:
                return _errors_by_chain(dynamics, windows)
    return None


def _errors_by_chain(dynamics: Dynamics, windows: Sequence[tuple[Floats, Floats]]) -> list[float]:
    out, first = [], 0
    for chain in dynamics.chains:
        part = slice(first, first + len(chain.states))
        squares = [float(np.mean((run[:, part] - states[:, part]) ** 2)) for run, states in windows]
        out.append(math.sqrt(np.median([s if math.isfinite(s) else math.inf for s in squares])))
        first = part.stop
    return out
