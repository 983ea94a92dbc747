"""Output-error estimation: parameters whose free run comes closest to what was measured, and how well they are known.

The segments of multiple shooting set how long a run is free. Short ones are easy to fit from any start; long ones need
fewer initial states and say more about the parameters. So segments are made longer from fit to fit while their runs
follow the record.

The covariance takes what the runs leave as noise of the channels, independent from sample to sample. Forces that the
record does not show (noise in a measured one, terms that are missing) drive the true motion away from the run, and what
is left then has the memory of the system: intervals would be far too narrow, and the parameters no better than those of
a regression. Whether it is so is tested (White 1982), and such an estimate refused.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayeq.refine.measured import Measured
from bayeq.refine.shooting import Segments, Solution, minimise

__all__ = ["OutputError", "Unrefined", "output_error"]

Floats = NDArray[np.float64]

# Segments at first, in the longest record: short enough for the errors of a regression to matter little within one.
# Where runs leave the record within a segment all the same it is halved, down to these rows: an initial state of two
# and the parameters need more samples than there are unknowns.
FIRST = 16
SHORTEST = 8

# How much longer segments are from fit to fit: a frequency fitted over a segment errs by less than its noise over its
# length, so that a run four times as long is still in step with the record.
LONGER = 4

# A run is lost where it leaves more than this share of a channel's spread, a quarter of its variance: it is out of step
# somewhere, and least squares ends in a minimum of no meaning.
LOST = 0.5

# A longer run, too, where it leaves this share more than the first fit did: noise is the same at any length. Noise of a
# force adds a few per cent, which the test of the covariance sees; chaotic motion out of step adds half of the spread.
FOLLOWS = 0.2

# Noise of a channel at least, as a share of its spread: runs err by 1e-4 to 1e-3 themselves, since inputs are
# interpolated between samples (measured on simulated records without noise). Less is correlated without any force.
LEAST_NOISE = 1e-3

# Other inputs are taken where they make 2 log likelihood greater by this, very strong evidence (Kass and Raftery 1995):
# by chance, against the truth, less often than once in a thousand records.
CLOSER = 10.0

# Relative decrease of the sum of squares at which a fit is done: far below 1/n, that of one standard deviation.
TOLERANCE = 1e-7

# How often channels are weighted again at most; that is enough when it changes no weight by this share.
ROUNDS = 5
SAME_WEIGHT = 1e-2

# Known noise of a channel is not believed where runs leave more than this multiple of its power; see
# `bayeq.equation.build.INADEQUATE`.
MISFIT = 1.75

# Blocks of rows that the covariance is tested with: enough for a variance of some certainty, and yet long against the
# memory of the noise; fewer where one would have fewer rows than this.
BLOCKS = 16
BLOCK_ROWS = 8

# The covariance is refused where independent noise fails it with this probability.
CHANCE = 0.01

# Parameters are not told apart where the condition number of their scaled information exceeds this: three digits are
# left of sixteen.
SINGULAR = 1e13


@dataclass(frozen=True, eq=False)
class OutputError:
    """Parameters by output error.

    Attributes
    ----------
    measured : Measured
        What they were fitted to.
    candidate : int
        Which of those given that is.
    parameters : (p,) array
        As in `Dynamics`; with known signs in doubt the mean of what they leave of the posterior.
    covariance : (p, p) array
        Inverse of the Gauss-Newton Hessian, initial states eliminated; singular where parameters follow from others.
    at_bound : (p,) bool array
        Parameters that were 0, the end of their known sign, where runs were closest.
    contradicted : bool
        Whether runs speak against these signs, by a likelihood ratio of more than a hundred.
    noise_sd : (m,) array
        Standard deviation of each channel's noise.
    misfit : mapping of str to float
        Channels of which runs leave more than the noise that was given, and how many times its standard deviation:
        theirs is what runs leave.
    segments : int
        Free runs; one per record where they are longest.
    longest : int
        Rows of the longest.
    converged : bool
        False if the last fit ended at a limit of steps or of weightings.
    """

    measured: Measured
    candidate: int
    parameters: Floats
    covariance: Floats
    at_bound: NDArray[np.bool_]
    contradicted: bool
    noise_sd: Floats
    misfit: Mapping[str, float]
    segments: int
    longest: int
    converged: bool


@dataclass(frozen=True)
class Unrefined:
    """Why the parameters are better left as they are, and what to do."""

    reason: str
    advice: str


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fit, and the root mean square (m,) of what it leaves of each channel."""

    segments: Segments
    solution: Solution
    rms: Floats

    @property
    def ratio(self) -> Floats:
        """Of channels of known noise, what is left over it, (m,); 1 of others."""
        measured = self.segments.measured
        return np.where(np.isfinite(measured.known_noise), self.rms / _levels(measured, self.rms), 1.0)

    @property
    def misfit(self) -> dict[str, float]:
        """Channels of which far more is left than their known noise, and how many times its standard deviation."""
        names = self.segments.measured.names
        return {n: float(r) for n, r in zip(names, self.ratio, strict=True) if r**2 > MISFIT}

    @property
    def deviance(self) -> float:
        """-2 log likelihood up to a constant, each channel's noise at its likeliest level unless it is known."""
        measured = self.segments.measured
        return float(measured.samples @ (2.0 * np.log(_levels(measured, self.rms)) + self.ratio**2))


def output_error(candidates: Sequence[Measured], parameters: Floats) -> OutputError | Unrefined:
    """Parameters by output error, starting from those of a regression.

    Parameters
    ----------
    candidates : sequence of Measured
        The records and the model with inputs interpolated in one way or another. The first is taken, unless others are
        much likelier.
    parameters : (p,) array
        Of the regression.

    Returns
    -------
    OutputError or Unrefined
    """
    first = _longest_fit(candidates[0], candidates[0].known.start(parameters))
    if first is None:
        return Unrefined("no free run follows the records", "check signs and terms, or sample faster")
    if first.misfit:
        learned = [replace(one, noise=_without(one.noise, first.misfit)) for one in candidates]
        found = output_error(learned, parameters)
        return found if isinstance(found, Unrefined) else replace(found, misfit=first.misfit)
    others = [_fit(other, first.solution.free, first.segments.length, first.rms) for other in candidates[1:]]
    better = [other for other in others if other is not None and other.deviance < first.deviance - CLOSER]
    best = min(better, key=lambda fit: fit.deviance, default=first)
    J, residuals = _sensitivity(best.solution)
    covariance = _inverse(np.einsum("nmp,nmq->pq", J, J))
    if covariance is None:
        return Unrefined(
            "the records do not determine all coefficients in a free run",
            "show fewer terms (max_terms, tolerance), or fix one (constraints)",
        )
    measured, known, free = best.segments.measured, best.segments.measured.known, best.solution.free
    samples, unknowns = int(measured.samples.sum()), len(free) + best.solution.starts.size
    # known noise is no less than it is given; where runs leave more intervals are wider
    squares = float(measured.samples @ np.maximum(best.ratio, 1.0) ** 2)
    # where a sign ended the step the runs would come closer beyond
    beyond = covariance @ np.einsum("nmp,nm->p", J, residuals) if known.at_bound(free).any() else np.zeros(len(free))
    excess = _excess(J, (residuals - J @ beyond) / np.sqrt(squares / samples))
    if excess:
        return Unrefined(
            "what free runs leave of the channels is correlated in time, as noise of a measured force or a missing term"
            f" makes it: the variance of the coefficients would be {excess:.2g} times that of their intervals",
            "add the input or term that is missing, or keep the regression",
        )
    freedom = max(samples - unknowns, 1)
    mean, spread = free, squares / freedom * covariance
    if known.signs.any():
        from bayeq.inference.signs.truncated import truncated

        mean, spread = truncated(free + beyond, covariance, known.signs, squares, 0.5 * freedom)
    at_bound = np.zeros(len(parameters), dtype=np.bool_)
    at_bound[known.free] = known.at_bound(free)
    drop = float(beyond @ np.linalg.solve(covariance, beyond)) * samples / squares
    return OutputError(
        measured=measured,
        candidate=[first, *others].index(best),
        parameters=known.full(mean),
        covariance=known.basis @ spread @ known.basis.T,
        at_bound=at_bound,
        contradicted=drop > CLOSER,
        noise_sd=np.where(
            np.isfinite(measured.known_noise), measured.known_noise, np.sqrt(samples / freedom) * best.rms
        ),
        misfit={},
        segments=best.segments.count,
        longest=best.segments.longest,
        converged=best.solution.converged,
    )


def _longest_fit(measured: Measured, free: Floats) -> _Fit | None:
    """The fit of the longest segments whose runs follow the records."""
    rows = min(max(measured.longest / FIRST, SHORTEST), measured.longest)
    best = _fit(measured, free, rows, measured.spread)
    while best is None and rows >= 2 * SHORTEST:  # the regression follows for a shorter time only
        rows /= 2
        best = _fit(measured, free, rows, measured.spread)
    if best is None:
        return None
    most = best.rms**2 + (FOLLOWS * measured.spread) ** 2
    while rows < measured.longest:
        rows = min(LONGER * rows, measured.longest)
        longer = _fit(measured, best.solution.free, rows, best.rms)
        if longer is None or (longer.rms**2 > most).any():
            break
        best = longer
    return best


def _without(noise: Mapping[str, float], names: Collection[str]) -> dict[str, float]:
    return {name: sd for name, sd in noise.items() if name not in names}


def _levels(measured: Measured, rms: Floats) -> Floats:
    """Noise of each channel, (m,): as it is known, else what runs leave; not below what runs err by themselves."""
    known = measured.known_noise
    return np.maximum(np.where(np.isfinite(known), known, rms), LEAST_NOISE * measured.spread)


def _fit(measured: Measured, free: Floats, length: float, rms: Floats) -> _Fit | None:
    """Output error, channels weighted by the inverse of what it leaves (at first of `rms`); None if a run is lost."""
    segments = Segments(measured, length)
    found = Solution(free, segments.starts(), [], True)
    for _ in range(ROUNDS):
        former = _levels(measured, rms)
        again = minimise(segments, 1.0 / former, found.free, found.starts, TOLERANCE)
        if again is None:
            return None
        found = again
        rms = segments.rms(found.runs) * former
        if (np.abs(_levels(measured, rms) - former) <= SAME_WEIGHT * former).all():
            break
    else:
        found = replace(found, converged=False)
    return None if (rms > LOST * measured.spread).any() else _Fit(segments, found, rms)


def _sensitivity(found: Solution) -> tuple[Floats, Floats]:
    """Derivatives of runs by the free parameters, initial states eliminated, (n, m, f), and the residuals, (n, m)."""
    d, p = found.starts.shape[1], len(found.free)
    out = []
    for run in found.runs:
        J = run[:, :, 1:].reshape(-1, d + p)
        J = J[:, d:] - J[:, :d] @ np.linalg.lstsq(J[:, :d], J[:, d:])[0]
        out.append(J.reshape(*run.shape[:2], p))
    return np.concatenate(out), np.concatenate([run[:, :, 0] for run in found.runs])


def _inverse(information: Floats) -> Floats | None:
    """Covariance of the parameters; None if they cannot be told apart."""
    diagonal = np.diagonal(information)
    if not (np.isfinite(information).all() and (diagonal > 0).all()):
        return None
    scale = 1.0 / np.sqrt(diagonal)
    scaled = information * np.outer(scale, scale)
    if np.linalg.cond(scaled) > SINGULAR:
        return None
    covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
    return np.asarray(0.5 * (covariance + covariance.T))


def _excess(J: Floats, residuals: Floats) -> float:
    """Variance of the parameters over that by (J'J)^-1, as parts of the record show it; 0 where it is no larger.

    With orthonormal Q for J, Q'r of a block of rows has the covariance A = Q'Q of the block if the noise is
    independent, less what the minimum takes: all blocks together add up to zero. The sum of their squares is then
    nearly a multiple of chi-squared, of the same mean and variance (Satterthwaite 1946). Noise with a memory makes it
    larger.
    """
    from scipy.linalg import block_diag
    from scipy.special import chdtri

    p = J.shape[2]
    blocks = max(min(BLOCKS, len(J) // BLOCK_ROWS), 2)
    Q = np.linalg.qr(J.reshape(-1, p))[0].reshape(J.shape)
    # of like information, not length: a decay has next to none in its last rows
    edges = np.searchsorted(np.cumsum(np.sum(Q**2, axis=(1, 2))), p * np.arange(1, blocks) / blocks)
    parts, left = (np.split(whole, edges) for whole in (Q, residuals))
    A = [part.reshape(-1, p).T @ part.reshape(-1, p) for part in parts]
    spread = block_diag(*A) - np.concatenate(A) @ np.concatenate(A).T
    mean, scale = float(np.trace(spread)), float(np.sum(spread**2) / np.trace(spread))
    squares = sum(float(np.sum(np.einsum("nmp,nm->p", part, e) ** 2)) for part, e in zip(parts, left, strict=True))
    return squares / mean if squares > scale * chdtri(mean / scale, CHANCE) else 0.0
