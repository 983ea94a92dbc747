"""Output-error estimation: parameters whose free run comes closest to the measured channels, with their covariance.

It maximises the likelihood of the records with exact inputs and next to no discrepancy (process noise). In the first
fit the path is free at every sample and follows the record, which is multiple shooting (Bock 1981) with a segment for
each sample. The discrepancy shrinks from fit to fit, to 1e-4 of the target, which errors of the inputs' courses make
anyway; the path is then a free run, and only noise separates it from the samples.

The covariance assumes that the residuals of the run are noise of the channels, independent from sample to sample.
Forces that are not in the record, noise of a measured force or missing terms drive the true motion away from the run:
residuals then have the memory of the system. This is tested (White 1982), and the covariance is widened by the factor
found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError
from bayeq.forecast.dynamics import Dynamics
from bayeq.inference.prior import Prior
from bayeq.likelihood.fit import State, Statistics, adjoints, maximised, quadratic, solved
from bayeq.likelihood.layout import Candidates
from bayeq.likelihood.model import Task, finer
from bayeq.likelihood.search import CLEARLY
from bayeq.likelihood.start import start_of_runs
from bayeq.numerics.rk4 import Interpolation
from bayeq.numerics.settings import REFINE
from bayeq.regression.constraints import Constraints
from bayeq.states import Motion

# Sizes of discrepancies from fit to fit, as shares of the target.
SIZES = (1e-2, 1e-3, 1e-4)

# Most steps of a fit; the step that ends it, in standard deviations of the parameters; most halvings, of steps to where
# the likelihood is not finite.
MOST_STEPS, STEP, MOST_HALVED = 30, 1e-2, 8

# Prior precision of the coefficients, as a share of that in searches: nearly flat.
FLAT = 1e-9

# Courses of a smooth input between its samples.
SMOOTH: tuple[Interpolation, ...] = ("cubic", "band-limited")

# Blocks of rows for the test of the covariance: enough to estimate a variance, each long against the memory of the
# noise. There are fewer if a block would have fewer rows than BLOCK_ROWS.
BLOCKS = 16
BLOCK_ROWS = 8

# Parameters are not identifiable if the condition number of their scaled information matrix exceeds this: three digits
# are left of sixteen.
SINGULAR = 1e13

# A parameter within this relative distance of a limit is at the limit.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class OutputError:
    """Parameters by output error."""

    parameters: Floats  # (p,), as in `Dynamics`; with known limits the mean of the posterior within them
    covariance: Floats  # (p, p), singular where parameters follow from others
    free: Bools  # (p,), whether a parameter is free, not one that follows from others
    # factor by which the covariance is wider than that of independent noise; 1 if residuals look independent
    excess: float
    at_bound: Floats  # (p,), the bound (or 0) at which the fit put a parameter; NaN for other parameters
    contradicted: bool  # whether runs contradict these bounds, by a likelihood ratio of more than a hundred
    noise_sd: Mapping[str, float]  # standard deviation of each channel's noise
    # channels whose residuals are larger than the given noise, by the ratio of standard deviations: their noise is
    # estimated from the residuals
    misfit: Mapping[str, float]
    interpolation: Interpolation  # interpolation of the inputs between samples
    converged: bool  # False if the last fit ended at a limit of steps
    log_likelihood: float


@dataclass(frozen=True)
class Unrefined:
    """The reason why parameters should stay as they are, and advice."""

    reason: str
    advice: str


NO_RUN = Unrefined("no free run follows the records", "check signs and terms, or sample faster")


@dataclass(frozen=True, eq=False)
class Known:
    """Constraints on the parameters of `Dynamics`: theta = offset + basis phi, the free ones, phi, within limits."""

    offset: Floats  # (p,), constant part of the solved equalities between coefficients
    basis: Floats  # (p, f)
    free: Bools  # (p,), which parameters are free: phi = theta[free]
    limits: Floats  # (f, 2), least and largest phi, infinite where there are none

    @classmethod
    def of(cls, dynamics: Dynamics, constraints: Sequence[Constraints]) -> Self:
        """From constraints, one per equation; InputError if the terms shown violate them, or no parameter is free."""
        size = dynamics.size
        offset, basis = np.zeros(size), np.zeros((size, size))
        free, limits = np.ones(size, dtype=np.bool_), np.tile([-np.inf, np.inf], (size, 1))
        for block, law, one in zip(dynamics.blocks(), dynamics.laws, constraints, strict=True):
            support, equalities = law.posterior.support, one.equalities
            if not equalities.closed(support):
                raise InputError(
                    f"{law.chain.target}: the terms shown do not keep to the constraints: find the equations again"
                )
            rows = np.arange(block.stop - int(support.sum()), block.stop)  # the intercept, in front of them, is free
            kept = np.isin(np.flatnonzero(support), equalities.kept)
            basis[block.start : rows[0], block.start : rows[0]] = 1.0
            basis[np.ix_(rows, rows[kept])] = equalities.basis(support)
            offset[rows], free[rows] = equalities.offset(support), kept
            known = one.prior(Prior()).limits
            if known is not None:
                limits[rows[kept]] = known[support[equalities.kept]]
        if not free.any():
            raise InputError("refine: the constraints fix every coefficient: there is nothing to refine")
        return cls(offset, basis[:, free], free, limits[free])

    def full(self, phi: Floats) -> Floats:
        """All parameters, (p,)."""
        return np.asarray(self.offset + self.basis @ phi)

    def start(self, theta: Floats) -> Floats:
        """Parameters (p,) that follow from the free ones in theta (p,), which are clipped to their limits."""
        return self.full(np.clip(theta[self.free], *self.limits.T))

    def at_bound(self, theta: Floats) -> Floats:
        """The limit of each parameter that is at a limit, (p,); NaN for others."""
        out, phi = np.full(len(theta), np.nan), theta[self.free][:, None]
        there = np.abs(phi - self.limits) <= ROUNDING * np.abs(phi)
        out[self.free] = np.where(there.any(axis=1), np.where(there[:, 0], *self.limits.T), np.nan)
        return out


def output_error(
    motion: Motion, dynamics: Dynamics, parameters: Floats, known: Known, kinds: Sequence[Interpolation]
) -> OutputError | Unrefined:
    """Output error on the training rows of a smoothed motion, starting from `parameters`.

    Of the courses that inputs may take between samples, `kinds`, the likeliest is named; mean and covariance of the
    parameters are those of the mixture, weighed by the likelihood.
    """
    found: list[OutputError] = []
    failed: Unrefined | None = None
    for kind in kinds:
        with np.errstate(all="ignore"):
            one = _of_course(motion, dynamics, found[-1].parameters if found else parameters, known, kind)
        if isinstance(one, Unrefined):
            failed = failed or one
        else:
            found.append(one)
    if not found:
        assert failed is not None
        return failed
    # as in `bayeq.likelihood.courses`, inputs are smooth unless the motion clearly shows otherwise
    excess = max(one.excess for one in found)
    logs = np.array([one.log_likelihood / excess - CLEARLY * (one.interpolation not in SMOOTH) for one in found])
    best, weights = found[int(np.argmax(logs))], np.exp(logs - np.logaddexp.reduce(logs))
    # relative to the likeliest, so that what constraints fix stays exact
    moves = [one.parameters - best.parameters for one in found]
    mean = best.parameters + weights @ np.array(moves)
    apart = [one.parameters - mean for one in found]
    covariances = (one.covariance + np.outer(off, off) for one, off in zip(found, apart, strict=True))
    covariance = sum((w * each for w, each in zip(weights, covariances, strict=True)), np.zeros(best.covariance.shape))
    return replace(best, parameters=mean, covariance=covariance)


def _of_course(
    motion: Motion, dynamics: Dynamics, parameters: Floats, known: Known, kind: Interpolation
) -> OutputError | Unrefined:
    terms = tuple({term.text: term for own in dynamics.terms for term in own}.values())
    number = {term.text: j for j, term in enumerate(terms)}
    chain, term = [], []
    for c, (own, constant) in enumerate(zip(dynamics.terms, dynamics.intercepts, strict=True)):
        term += [len(terms)] * constant + [number[one.text] for one in own]
        chain += [c] * (constant + len(own))
    chosen = Candidates(np.array(chain, dtype=np.int64), np.array(term, dtype=np.int64))
    task, state = start_of_runs(motion, terms, kind)
    task = replace(task, precision=FLAT * task.precision)
    state = replace(state, chosen=chosen, theta=known.start(parameters))
    measured = task.layout.first_input
    names = [name for name, _ in task.layout.channels[:measured]]
    try:
        task = finer(task, state)
        run = _followed(task, known, state)
        innovations = _sensitivity(run.found, known.basis)[1]
        power = (innovations**2).sum(axis=0) / np.maximum(np.count_nonzero(innovations, axis=0), 1)
        given = np.sqrt(run.state.levels.channels)
        distrusted = [i for i in range(measured) if not run.state.levels.learned[i] and power[i] > REFINE.misfit]
        if distrusted:
            held = ~run.state.levels.learned
            held[distrusted] = False
            run = _followed(task, known, replace(run.state, levels=replace(run.state.levels, held=held)))
        misfit = {names[i]: float(np.sqrt(run.state.levels.channels[i]) / given[i]) for i in distrusted}
        at_bound, free = known.at_bound(run.state.theta), run
        if np.isfinite(at_bound).any():  # fit without limits, to test them
            free = _followed(task, replace(known, limits=np.full_like(known.limits, np.inf) * [-1.0, 1.0]), run.state)
    except np.linalg.LinAlgError:
        return NO_RUN
    levels = run.state.levels
    if (levels.channels > REFINE.lost**2 * levels.scales.channels)[:measured].any():
        return NO_RUN
    A, scale = free.information, 1.0 / np.sqrt(np.diagonal(free.information))
    if not np.isfinite(scale).all() or np.linalg.cond(A * scale[:, None] * scale) > SINGULAR:
        return Unrefined(
            "the records do not determine all coefficients in a free run",
            "show fewer terms (max_terms, tolerance), or fix one (constraints)",
        )
    covariance = solved(A, np.eye(len(A)))
    covariance = 0.5 * (covariance + covariance.T)
    excess = max(_excess(*_sensitivity(free.found, known.basis)), 1.0)
    mean, spread = free.state.theta[known.free], excess * covariance
    if np.isfinite(known.limits).any():
        from bayeq.inference.signs import truncated

        freedom = 0.5 * max(task.rows - len(A), 1.0)
        mean, spread = truncated(mean, covariance, known.limits, 2.0 * freedom * excess, freedom)
    return OutputError(
        parameters=known.full(mean),
        covariance=known.basis @ spread @ known.basis.T,
        free=known.free,
        excess=excess,
        at_bound=at_bound,
        contradicted=2.0 * (free.found.value - run.found.value) > excess * REFINE.closer,
        noise_sd={name: float(np.sqrt(levels.channels[i])) for i, name in enumerate(names)},
        misfit=misfit,
        interpolation=kind,
        converged=run.converged,
        log_likelihood=run.found.value,
    )


@dataclass(frozen=True, eq=False)
class _Run:
    """The state of a fit, its likelihood, and the information matrix of the free parameters."""

    state: State
    found: Statistics
    information: Floats
    converged: bool


def _followed(task: Task, known: Known, state: State) -> _Run:
    """Fits with ever smaller discrepancy, until the path is a free run that only noise separates from the samples."""
    for size in SIZES:
        levels = replace(state.levels, discrepancy=size**2 * state.levels.target, hessian=None)
        run = _fitted(task, known, replace(state, levels=levels))
        state = run.state
    return run


def _fitted(task: Task, known: Known, state: State) -> _Run:
    """Gauss-Newton steps of the free parameters and the path; noise levels are estimated again at each."""
    last, halved = None, 0
    held = np.arange(len(state.levels.free)) >= len(state.levels.channels)
    for step in range(MOST_STEPS):
        while True:
            linears = task.linearised(state)
            try:
                levels, found = maximised(linears, state, task.precision_of(state), held)
                break
            except np.linalg.LinAlgError:
                halved += 1
                if last is None or halved > MOST_HALVED:
                    raise
                state = state.towards(last)
        last = state = replace(state, levels=levels)
        q, phi = quadratic(found.filtered), state.theta[known.free]
        slope, information = known.basis.T @ q.slope, known.basis.T @ q.information @ known.basis
        moved = _bounded(information, slope, phi, known.limits)
        near = float(np.max(np.abs(moved) * np.sqrt(np.diagonal(information)), initial=0.0)) < STEP
        if near or step == MOST_STEPS - 1:
            break
        smoothed = adjoints(linears, levels, found, known.basis @ moved, smoothed=bool(task.layout.jumps))
        state = replace(state, theta=known.full(phi + moved)).moved(task.layout, task.series, linears, smoothed)
    return _Run(state, found, information, near)


def _bounded(information: Floats, slope: Floats, phi: Floats, limits: Floats) -> Floats:
    """The step (f,) to the maximum of a quadratic within the limits (f, 2) of the parameters."""
    step, (low, high) = solved(information, slope), limits.T - phi
    if ((step >= low) & (step <= high)).all():
        return step
    from scipy.optimize import lsq_linear

    unit = 1.0 / np.sqrt(np.diagonal(information))
    values, vectors = np.linalg.eigh(information * unit[:, None] * unit)
    root = np.sqrt(np.maximum(values, np.finfo(np.float64).eps * values.max()))
    within = (low / unit, high / unit)
    found = lsq_linear(root[:, None] * vectors.T, (vectors.T @ (unit * slope)) / root, within, method="bvls")
    step = unit * found.x
    # a parameter at its limit is exactly there, as 0 at the end of its sign
    step = np.where((found.active_mask < 0) | (step <= low), low, step)
    return np.where((found.active_mask > 0) | (step >= high), high, step)


def _sensitivity(found: Statistics, basis: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the standardised innovations by the free parameters, (n, M, f), and the innovations, (n, M)."""
    columns, residuals = [], []
    for one in found.filtered:
        unit = np.where(one.variance > 0.0, 1.0 / np.sqrt(np.where(one.variance > 0.0, one.variance, 1.0)), 0.0)
        columns.append(one.innovation[:, :, 1:] @ basis * unit[:, :, None])
        residuals.append(one.innovation[:, :, 0] * unit)
    return np.concatenate(columns), np.concatenate(residuals)


def _excess(J: Floats, residuals: Floats) -> float:
    """Factor of the parameters' variance over (J'J)^-1, by blocks of the record; 0 if not significantly larger.

    With an orthonormal basis Q of the columns of J, the score Q'r of a block of rows has the covariance A = Q'Q of the
    block if the noise is independent, less a correction: at the minimum the scores of all blocks sum to zero. The sum
    of their squares is then nearly a multiple of chi-squared, of the same mean and variance (Satterthwaite 1946).
    Correlated noise makes it larger.
    """
    from scipy.linalg import block_diag
    from scipy.special import chdtri

    p = J.shape[2]
    blocks = max(min(BLOCKS, len(J) // BLOCK_ROWS), 2)
    Q = np.linalg.qr(J.reshape(-1, p))[0].reshape(J.shape)
    # blocks of equal information, not of equal length: the last rows of a decay have next to none
    edges = np.searchsorted(np.cumsum(np.sum(Q**2, axis=(1, 2))), p * np.arange(1, blocks) / blocks)
    parts, left = (np.split(whole, edges) for whole in (Q, residuals))
    A = [part.reshape(-1, p).T @ part.reshape(-1, p) for part in parts]
    spread = block_diag(*A) - np.concatenate(A) @ np.concatenate(A).T
    mean, scale = float(np.trace(spread)), float(np.sum(spread**2) / np.trace(spread))
    squares = sum(float(np.sum(np.einsum("nmp,nm->p", part, e) ** 2)) for part, e in zip(parts, left, strict=True))
    return squares / mean if squares > scale * chdtri(mean / scale, REFINE.wider_chance) else 0.0
