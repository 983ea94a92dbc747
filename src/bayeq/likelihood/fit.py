"""Fit of a system's coefficients, path and noise levels to its records, given which coefficients are not zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.likelihood.adjoint import Adjoint, adjoint
from bayeq.likelihood.blur import Blur, blur_of, first_blur
from bayeq.likelihood.determinant import Determinant, determinant_of
from bayeq.likelihood.filter import Filtered, run_filter
from bayeq.likelihood.layout import NOTHING, Candidates, Layout, Series, Stated
from bayeq.likelihood.levels import MOST_NOISE, Levels
from bayeq.likelihood.linear import Linear, linearise, terms_along
from bayeq.numerics.minimise import minimise
from bayeq.numerics.settings import LIKELIHOOD

# Intervals next to the peak of a grid of discrepancy sizes are halved, at most this often.
MOST_HALVED = 8

# Over sizes the log likelihood counts as flat where it changes by less from one to the next, and as -inf this far below
# its peak [nats].
LEVEL, NOTHING_LEFT = 0.01, 30.0

# A matrix of unit diagonal counts as singular if its least Cholesky pivot is at most this.
LEAST_PIVOT = 1e-4

# A channel has hardly any noise below this share of its innovations' variance; these shares are tried instead.
HARDLY_NOISY, NOISIER = 0.01, (0.5, 0.1, 0.02)

# Largest step of a level in `Levels.free`: in the logarithm of a variance or the logit of a memory.
LONGEST = 2.0


@dataclass(frozen=True, eq=False)
class State:
    """A point of a fit: model, coefficients, paths, levels, and widths of jumps."""

    chosen: Candidates  # coefficients that are not zero
    theta: Floats  # (r,), their values
    paths: tuple[Floats, ...]  # (n, S), states of each record
    levels: Levels  # noise and discrepancies
    blurs: tuple[Blur, ...] = ()  # widths of the jumps in each record; empty where no error of the paths is known

    def towards(self, other: State, share: float = 0.5) -> State:
        """The state a share of the way towards another one of the same model; its levels stay."""
        paths = tuple(one + share * (two - one) for one, two in zip(self.paths, other.paths, strict=True))
        return replace(self, theta=self.theta + share * (other.theta - self.theta), paths=paths)

    def moved(
        self, layout: Layout, series: Sequence[Series], linears: Sequence[Linear], found: Sequence[Adjoint]
    ) -> State:
        """The state on the smoothed paths, with the widths of jumps from the covariance of these paths."""
        paths = tuple(path + adj.deviation for path, adj in zip(self.paths, found, strict=True))
        blurs = tuple(
            blur_of(
                layout,
                one,
                path,
                adj.covariance,
                linear.transition[:, :, layout.discrepancy],
                self.chosen,
                self.theta,
                linear.steps.substeps[:-1],
            )
            for one, path, adj, linear in zip(series, paths, found, linears, strict=True)
            if layout.jumps
        )
        return replace(self, paths=paths, blurs=blurs)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The log likelihood about some coefficients: ``level + slope'd - d' information d/2``."""

    level: float
    slope: Floats
    information: Floats

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(self.level + other.level, self.slope + other.slope, self.information + other.information)

    def raised(self, power: float) -> Quadratic:
        """The quadratic of the likelihood raised to a power."""
        return self if power == 1.0 else Quadratic(power * self.level, power * self.slope, power * self.information)


@dataclass(frozen=True, eq=False)
class Statistics:
    """The marginal likelihood of a linearised model, and what it is made of."""

    value: float  # ln p(data | levels), coefficients integrated out
    here: float  # the same without the gain by moving the coefficients by `delta`
    delta: Floats  # (r,), posterior mean of the coefficients' deviations
    covariance: Floats  # (r, r), of the coefficients
    filtered: tuple[Filtered, ...]  # of each record


def linearised(layout: Layout, series: Sequence[Series], state: State, substeps: int = 1) -> list[Linear]:
    blurs = state.blurs or (None,) * len(series)
    return [
        linearise(layout, one, path, state.chosen, state.theta, blur, substeps)
        for one, path, blur in zip(series, state.paths, blurs, strict=True)
    ]


def candidates(layout: Layout, series: Sequence[Series], state: State, step: int = 1) -> list[Floats]:
    """All candidates and the constant along a fit's paths, at every `step`-th sample, (n, P + 1) of each record."""
    blurs, out = state.blurs or (None,) * len(series), []
    for one, path, known in zip(series, state.paths, blurs, strict=True):
        blur = first_blur(layout, one, path) if known is None and layout.jumps else known
        inputs, along = (one.inputs if blur is None else blur.beside(one.inputs))[::step], path[::step]
        out.append(terms_along(layout, along, inputs, state.chosen, state.theta)[0])
    return out


def quadratic(filtered: Sequence[Filtered]) -> Quadratic:
    """The log likelihood of all records, from their filters."""
    product = np.sum([found.product for found in filtered], axis=0)
    logs = sum(found.log_variance for found in filtered)
    return Quadratic(-0.5 * (logs + float(product[0, 0])), product[1:, 0], product[1:, 1:])


def of_stated(stated: Sequence[Stated], chosen: Candidates, theta: Floats) -> Quadratic:
    """The log density of stated normal priors on sums of coefficients, about the values `theta` of the chosen ones."""
    r = len(theta)
    level, slope, information = 0.0, np.zeros(r), np.zeros((r, r))
    for parts, mean, sd in stated:
        weight = np.zeros(r)
        for chain, term, factor in parts:
            weight[(chosen.chain == chain) & (chosen.term == term)] = factor
        missed = mean - float(weight @ theta)
        level -= 0.5 * (missed / sd) ** 2
        slope += weight * missed / sd**2
        information += np.outer(weight, weight) / sd**2
    return Quadratic(level, slope, information)


def solved(A: Floats, B: Floats) -> Floats:
    """A^-1 B of a matrix with positive diagonal, by least squares if it is nearly singular; B (r,) or (r, k)."""
    if not (np.diagonal(A) > 0.0).all():
        raise np.linalg.LinAlgError("no positive matrix")
    unit = 1.0 / np.sqrt(np.diagonal(A))
    A, B = A * unit[:, None] * unit, (B.T * unit).T
    try:
        singular = np.diagonal(np.linalg.cholesky(A)).min(initial=1.0) <= LEAST_PIVOT
    except np.linalg.LinAlgError:
        singular = True
    found = np.linalg.lstsq(A, B, rcond=1e-13)[0] if singular else np.linalg.solve(A, B)
    return np.asarray((found.T * unit).T)


def integrated_out(q: Quadratic, own: Ints, rest: Ints, precision: Floats) -> tuple[Floats, Floats]:
    """Information on the coefficients `own` and gradient by these, with the coefficients `rest` integrated out."""
    A, b = q.information[np.ix_(own, own)], q.slope[own]
    if not len(rest):
        return A, b
    across = q.information[np.ix_(own, rest)]
    H = q.information[np.ix_(rest, rest)] + np.diag(precision[rest])
    carried = solved(H, np.column_stack([across.T, q.slope[rest]]))
    return A - across @ carried[:, :-1], b - across @ carried[:, -1]


def marginal(
    linears: Sequence[Linear],
    state: State,
    levels: Levels,
    precision: Floats,
    keep: bool = True,
    bent: Floats | None = None,
) -> Statistics:
    """The likelihood with the chosen coefficients integrated out under N(0, 1/precision); `keep` as in `run_filter`.

    `bent`, (r,), are the derivatives of the log determinant by the chosen coefficients, from `improved`: the linearised
    model lacks them, and would favour coefficients that the likelihood does not.
    """
    filtered = tuple(run_filter(linear, state.chosen, levels.noise, keep) for linear in linears)
    q = quadratic(filtered) + of_stated(levels.layout.stated, state.chosen, state.theta)
    if bent is not None:
        q = replace(q, slope=q.slope + bent)
    if not len(state.theta):
        return Statistics(q.level, q.level, np.zeros(0), np.zeros((0, 0)), filtered)
    if not (np.isfinite(q.level) and np.isfinite(q.information).all()):
        raise np.linalg.LinAlgError("the likelihood is not finite")
    scale = 1.0 / np.sqrt(np.diagonal(q.information) + precision)
    H = (q.information + np.diag(precision)) * scale[:, None] * scale
    root = np.linalg.cholesky(H)
    inverse = np.linalg.inv(root)
    covariance = (inverse.T @ inverse) * scale[:, None] * scale
    pull = q.slope - precision * state.theta
    delta = covariance @ pull
    here = q.level - 0.5 * float(state.theta @ (precision * state.theta))
    here += 0.5 * float(np.log(precision).sum()) - float(np.log(np.diagonal(root)).sum()) + float(np.log(scale).sum())
    return Statistics(here + 0.5 * float(pull @ delta), here, delta, covariance, filtered)


def of_inputs(linears: Sequence[Linear], levels: Levels) -> float:
    """Log likelihood of the samples of inputs alone."""
    layout = levels.layout
    if not layout.roles.inputs:
        return 0.0
    alone = []
    for linear in linears:
        residual = linear.residual.copy()
        residual[:, : -len(layout.roles.inputs)] = np.nan
        alone.append(run_filter(linear._replace(residual=residual), NOTHING, levels.noise, keep=False))
    return quadratic(alone).level


def log_mean(log_of: Callable[[float], float], low: float, high: float, peak: float) -> tuple[float, float]:
    """ln of the mean over [low, high] of the function with the logarithm `log_of`, and its argmax, about `peak`."""
    peak = min(max(peak, low), high)
    grid = np.linspace(low, high, LIKELIHOOD.discrepancy_sizes).tolist()
    at, logs = [peak], [log_of(peak)]
    for x in [x for x in reversed(grid) if x < peak]:
        level = len(at) > 2 and abs(logs[0] - logs[1]) < LEVEL  # only from two sizes below the peak
        at, logs = [x, *at], [logs[0] if level else log_of(x), *logs]
    for x in [x for x in grid if x > peak]:
        at.append(x)
        logs.append(-np.inf if logs[-1] < max(logs) - NOTHING_LEFT else log_of(x))
    for _ in range(MOST_HALVED):
        top = int(np.argmax(logs))
        beside = [k for k in (top - 1, top) if 0 <= k < len(at) - 1]
        k = max(beside, key=lambda k: abs(logs[k + 1] - logs[k]))
        if abs(logs[k + 1] - logs[k]) < LIKELIHOOD.size_step:
            break
        at.insert(k + 1, 0.5 * (at[k] + at[k + 1]))
        logs.insert(k + 1, log_of(at[k + 1]))
    whole = np.logaddexp.reduce(np.logaddexp(logs[:-1], logs[1:]) + np.log(0.5 * np.diff(at)))
    return float(whole - np.log(high - low)), at[int(np.argmax(logs))]


def adjoints(
    linears: Sequence[Linear],
    levels: Levels,
    found: Statistics,
    delta: Floats,
    covariance: Floats | None = None,
    curved: bool = False,
    smoothed: bool = False,
) -> list[Adjoint]:
    return [
        adjoint(linear, levels.noise, filtered, delta, covariance, curved, smoothed)
        for linear, filtered in zip(linears, found.filtered, strict=True)
    ]


def maximised(
    linears: Sequence[Linear],
    state: State,
    precision: Floats,
    held: Bools | None = None,
    steps: int = 30,
    tolerance: float = 1e-3,
    steepest: float = 0.03,
) -> tuple[Levels, Statistics]:
    """Levels that maximise the marginal likelihood of a linearised model; those `held`, or known, stay.

    The search ends when a step gains no more than `tolerance` nats, or when the derivative by each level, times the
    level's approximate standard deviation given all others, is at most `steepest`.
    """
    levels = state.levels
    low, high = levels.bounds
    start = np.clip(levels.free, low, high)
    held = levels.known if held is None else held | levels.known
    if held.any():
        low, high = np.where(held, start, low), np.where(held, start, high)
    unit = 1.0 / np.sqrt(np.maximum(levels.curvature(linears), 1.0))
    # values are relative to that at the start, so that tolerances do not depend on the units of the channels
    base: float | None = None
    last: tuple[Floats, Statistics] | None = None

    def negative(moved: Floats) -> tuple[float, Floats]:
        nonlocal base, last
        trial, last = levels.moved(moved * unit), None
        try:
            found = marginal(linears, state, trial, precision)
        except np.linalg.LinAlgError:
            if base is None:
                raise
            return np.inf, np.zeros(len(moved))
        base, last = found.value if base is None else base, (moved, found)
        slope = sum(trial.slopes(one) for one in adjoints(linears, trial, found, found.delta, found.covariance))
        return base - found.value, -np.asarray(slope) * unit

    least = minimise(
        negative,
        start / unit,
        low / unit,
        high / unit,
        hessian=np.eye(len(unit)) if levels.hessian is None else levels.hessian,
        longest=LONGEST / unit,
        gradient_tolerance=steepest,
        value_tolerance=tolerance,
        most_steps=steps,
    )
    levels = replace(levels.moved(least.x * unit), hessian=least.hessian)
    at_least = last is not None and np.array_equal(last[0], least.x)
    found = last[1] if last is not None and at_least else marginal(linears, state, levels, precision)
    slopes = np.where(held, 0.0, -least.gradient / unit)[: len(levels.channels)]
    more = with_more_noise(linears, state, levels, precision, found, slopes, tolerance)
    if more is None:
        return levels, found
    return maximised(linears, replace(state, levels=more), precision, held, steps, tolerance, steepest)


def with_more_noise(
    linears: Sequence[Linear],
    state: State,
    levels: Levels,
    precision: Floats,
    found: Statistics,
    slopes: Floats,
    least: float,
) -> Levels | None:
    """The levels with noise of channels that have hardly any, if that gains more than `least` nats; otherwise None.

    The `slopes`, (M,), of the log likelihood in the log variances vanish with the variances: a search that a wrong law
    has led there would stay, and discrepancies (process noise) would follow every sample.
    """
    variance = np.concatenate([one.variance for one in found.filtered])
    innovations = variance.sum(axis=0) / np.maximum((variance > 0.0).sum(axis=0), 1)
    innovations = np.minimum(innovations, MOST_NOISE * levels.scales.channels)
    hardly = (levels.channels < HARDLY_NOISY * innovations) & (slopes * innovations > least * levels.channels)
    for share in NOISIER if hardly.any() else ():
        channels = np.where(hardly, share * innovations, levels.channels)
        more = replace(levels, channels=channels, hessian=None)
        with suppress(np.linalg.LinAlgError):
            if marginal(linears, state, more, precision, keep=False).value > found.value + least:
                return more
    return None


def bent_by(
    layout: Layout,
    linears: Sequence[Linear],
    state: State,
    found: Sequence[Adjoint],
    filtered: Sequence[Filtered] | None = None,
) -> tuple[Determinant, Floats]:
    """Derivatives of the log determinant; also those by the chosen coefficients, (r,), which the path follows.

    `filtered` are the records with the columns of these coefficients, if they are there. Where the correction of the
    coefficients, in their standard deviations, would be larger than on a fixed path, as at the fold of a map, the
    expansion fails: the path follows less, by the square of that ratio.
    """
    bend = determinant_of(layout, linears, found)
    fixed = bend.slopes[state.chosen.chain, state.chosen.term]
    if not any(map(len, bend.pulls)):
        return bend, fixed

    def likelihood(models: Sequence[Linear]) -> Quadratic:
        return quadratic([run_filter(one, state.chosen, state.levels.noise, keep=False) for one in models])

    alone = likelihood(linears) if filtered is None else quadratic(filtered)
    follows = likelihood(bend.beside(linears)).slope - alone.slope
    told = np.flatnonzero(np.diagonal(alone.information) > 0.0)
    H = alone.information[np.ix_(told, told)]
    before, after = (float(one[told] @ solved(H, one[told])) for one in (fixed, fixed + follows))
    share = before / after if after > before else 1.0
    return bend._replace(pulls=tuple(share * pull for pull in bend.pulls)), fixed + share * follows


def improved(
    layout: Layout, series: Sequence[Series], linears: Sequence[Linear], state: State, found: Statistics
) -> tuple[State, Determinant, Floats]:
    """One Gauss-Newton step of coefficients and paths; also the results of `bent_by`."""
    first = adjoints(linears, state.levels, found, found.delta, curved=True)
    bend, bent = bent_by(layout, linears, state, first, found.filtered)
    delta = found.delta + found.covariance @ bent
    second = adjoints(linears, state.levels, found, delta, smoothed=bool(layout.jumps))
    return replace(state, theta=state.theta + delta).moved(layout, series, linears, second), bend, bent


def information(layout: Layout, linears: Sequence[Linear], state: State, bend: Determinant) -> Quadratic:
    """The log likelihood of all candidates, expanded about zero, on which models are compared."""
    every = layout.everything
    filtered = [run_filter(linear, every, state.levels.noise, keep=False) for linear in bend.beside(linears)]
    theta = coefficients(layout, state)
    q = quadratic(filtered) + of_stated(layout.stated, every, theta)
    return Quadratic(q.level, q.information @ theta + q.slope + bend.slopes.ravel(), q.information)


def coefficients(layout: Layout, state: State) -> Floats:
    """Coefficients of all candidates of all equations, (C (P + 1),): 0 for those that are not chosen."""
    theta = np.zeros(len(layout.everything.chain))
    theta[state.chosen.chain * (len(layout.terms) + 1) + state.chosen.term] = state.theta
    return theta
