"""Tests of a fit: discrepancies, coefficients that change, channels that are off, and whether innovations are white.

If the equations are right the likeliest discrepancy is negligible, and the standardised innovations of every channel
are white: the share of the power that lies in an octave then has a beta distribution, whatever the noise level
(predictive checks: Box 1980; Gelman, Meng and Stern 1996).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.likelihood.channels import Suspect, misstated, suspects_of
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, Statistics, adjoints, bent_by, maximised, of_inputs, solved
from bayeq.likelihood.hinges import Kinks, kinks_of
from bayeq.likelihood.levels import Levels
from bayeq.likelihood.model import Fitted, Task
from bayeq.numerics.distributions import Z95, Shape, excess_of, incomplete_beta, shape_of
from bayeq.numerics.settings import LIKELIHOOD

# Number of memories of a discrepancy at which `turn_of` evaluates the score statistic.
MEMORIES = 33

# Step in log variance of the likelihood's second difference, and the least curvature that gives a finite interval.
STEP, LEAST_BEND = 0.1, 1e-3

# With a memory above this share of its bound, `Levels.longest`, the levels are estimated again without the bound: an
# unmeasured force may be slow.
AT_BOUND = 0.98

# Information on a change below this share of that with all coefficients known is a rounding error.
ROUNDING = 1e-9

# A channel counts as low-pass filtered if its innovations have less than this of white power in the highest octave.
FILTERED = 0.3

# Least number of frequency bins in an octave that is used.
LEAST_BINS = 8


class Discrepancy(NamedTuple):
    """The discrepancy of an equation: the force that its terms do not explain."""

    size: float  # standard deviation of the discrepancy as a share of the target's
    low: float  # ends of the 95 % interval of `size`
    high: float
    p: float  # p value of the likelihood ratio against no discrepancy, see `chance_of`
    octave: tuple[float, float]  # ends [Hz] of the octave that holds most of its power


class Change(NamedTuple):
    """Score test of a linear change of a coefficient over each record."""

    chain: int  # number of the equation
    of: str  # "the coefficient of x", "the constant"
    relative: float  # change from the first sample to the last, along a straight line, as a share of the coefficient
    share: float  # root mean square effect on the target, as a share of the target's standard deviation
    p: float  # two-sided p value against no change

    @property
    def reverses(self) -> bool:
        """Whether the coefficient changes sign over the record."""
        return abs(self.relative) > 2.0


class Octave(NamedTuple):
    """Power of the innovations of a channel in an octave."""

    channel: str
    low: float  # [Hz]
    high: float
    ratio: float  # the power relative to white noise
    p: float  # two-sided p value of the octave's share of the power
    share: float  # the octave's share of all frequency bins


@dataclass(frozen=True)
class Adequacy:
    """Tests of a fit."""

    discrepancies: tuple[Discrepancy, ...]  # one per equation
    octaves: tuple[Octave, ...]  # of the channels of all chains
    shapes: Mapping[str, Shape] = field(default_factory=dict)  # of the standardised innovations of these channels
    changes: tuple[Change, ...] = ()  # of the coefficients of the model
    suspects: tuple[Suspect, ...] = ()  # channels that others contradict
    kinks: Mapping[int, Kinks] = field(default_factory=dict)  # that no candidate has, by the number of the equation

    @property
    def limit(self) -> float:
        """Largest p value that is rejected, at a level of 1 % for all tests together (Holm 1979)."""
        p = sorted(one.p for tests in (self.discrepancies, self.octaves, self.changes) for one in tests)
        for k, value in enumerate(p):
            if value > LIKELIHOOD.test_level / (len(p) - k):
                return LIKELIHOOD.test_level / (len(p) - k)
        return LIKELIHOOD.test_level

    def lacks(self, c: int) -> Discrepancy | None:
        """The discrepancy of equation c if its test rejects that there is none, else None."""
        one = self.discrepancies[c]
        return one if one.p <= self.limit else None

    def coloured(self, channels: Sequence[str]) -> Octave | None:
        """The rejected octave of these channels with the lowest p value, or None."""
        rejected = [one for one in self.octaves if one.channel in channels and one.p <= self.limit]
        return min(rejected, key=lambda one: (one.p, -abs(math.log(one.ratio))), default=None)

    def suspect(self, channels: Sequence[str]) -> Suspect | None:
        """Of these channels the one that the others contradict most, else one that was low-pass filtered, or None."""
        contradicted = [one for one in self.suspects if one.channel in channels]
        if contradicted:
            return max(contradicted, key=lambda one: one.sds)
        empty = list[Octave]()
        for channel in channels:
            octaves = sorted((one for one in self.octaves if one.channel == channel), key=lambda one: -one.low)
            rejected = [one.p <= self.limit and one.ratio < FILTERED for one in octaves]
            if rejected == sorted(rejected, reverse=True):  # hum leaves octaves below it as empty as those above
                empty += compress(octaves, rejected)
        lowest = min(empty, key=lambda one: one.low, default=None)
        return None if lowest is None else Suspect(lowest.channel, "filter", lowest.low)

    def changing(self, c: int) -> Change | None:
        """The rejected, not negligible change of a coefficient of equation c with the lowest p value, or None."""
        least = LIKELIHOOD.misfit_least
        rejected = [one for one in self.changes if one.chain == c and one.p <= self.limit and one.share > least]
        return min(rejected, key=lambda one: one.p, default=None)


def adequacy_of(task: Task, fitted: Fitted) -> Adequacy:
    """Tests of a fit."""
    state = fitted.state
    if (state.levels.memory > AT_BOUND * state.levels.longest).any():
        # fits bound the memory of a discrepancy, but an unmeasured force may be slower
        free = replace(state, levels=state.levels.unbounded)
        state = replace(state, levels=maximised(task.linearised(state), free, task.precision_of(state))[0])
    here = task.marginal(state, bent=fitted.bent)
    interval = float(np.median(np.concatenate([one.intervals for one in task.series])))
    discrepancies = [_discrepancy(task, state, here.value, c, interval) for c in range(task.layout.chains)]
    changes = changes_of(task, state, here, fitted.power)
    innovations = _innovations(task, state, here.delta, interval)
    suspects = misstated(task, state) or suspects_of(task, state, here)  # wrong noise lets channels seem off
    kinks = kinks_of(task, fitted, any(one.p <= LIKELIHOOD.test_level for one in discrepancies))
    return Adequacy(tuple(discrepancies), *innovations, changes, suspects, kinks)


def changes_of(task: Task, state: State, here: Statistics, power: float) -> tuple[Change, ...]:
    """Score tests of coefficients that change along a straight line over each record, one at a time (Nyblom 1989).

    A sample's score with respect to the change is that with respect to the coefficient times its place in the record,
    from -1 to 1.
    """
    r, rows = len(state.theta), 0
    if not r:
        return ()
    slope, turned, within, square = np.zeros((4, r))
    information, across = np.zeros((2, r, r))
    for one, linear, found in zip(task.series, task.linearised(state), here.filtered, strict=True):
        time = np.append(0.0, np.cumsum(one.intervals))
        place = 2.0 * time / time[-1] - 1.0
        left, columns = found.standardised(here.delta)
        columns = columns.reshape(-1, r)
        tilted = np.repeat(place, left.shape[1])[:, None] * columns
        slope, turned = slope + left.ravel() @ columns, turned + left.ravel() @ tilted
        information, across = information + columns.T @ columns, across + columns.T @ tilted
        within += (tilted**2).sum(axis=0)
        square += ((place[:, None] * linear.terms[:, state.chosen.term]) ** 2).sum(axis=0)
        rows += len(place)
    carried = solved(information + np.diag(task.precision_of(state)), np.column_stack([across, slope]))
    variance = within - np.einsum("ij,ij->j", across, carried[:, :-1])
    sd = 1.0 / np.sqrt(np.where(variance > ROUNDING * within, variance, np.inf))
    standard = sd * (turned - across.T @ carried[:, -1])
    chance = [math.erfc(x) for x in np.abs(standard) * math.sqrt(0.5 * power)]
    moved = sd * standard
    share = np.abs(moved) * np.sqrt(square / rows / state.levels.target[state.chosen.chain])
    terms = [f"the coefficient of {term}" for term in task.layout.terms] + ["the constant"]
    numbers = zip(state.chosen.chain.tolist(), state.chosen.term.tolist(), strict=True)
    relative = (2.0 * moved / (state.theta + here.delta)).tolist()
    rest = zip(relative, share.tolist(), chance, strict=True)
    return tuple(Change(chain, terms[term], *one) for (chain, term), one in zip(numbers, rest, strict=True))


def _discrepancy(task: Task, state: State, value: float, c: int, interval: float) -> Discrepancy:
    """Size, interval, p value and octave of the discrepancy of equation c; the fit has the log likelihood `value`."""
    levels, size = state.levels, float(state.levels.kappa[c])

    def log_likelihood(factor: float) -> float:
        return task.value(replace(state, levels=levels.with_discrepancy(c, factor * levels.discrepancy[c])))

    gain = 2.0 * (value - log_likelihood(0.0))
    if LIKELIHOOD.least_gain < gain < math.inf:
        gain = min(gain, 2.0 * gain_of(task, state, c))
    p = 0.0 if gain > 0.0 else 1.0
    if 0.0 < gain < math.inf:
        p = chance_of(gain, _length(task, state, c))
    bend = -(log_likelihood(math.exp(STEP)) - 2.0 * value + log_likelihood(math.exp(-STEP))) / STEP**2
    factor = math.exp(0.5 * Z95 / math.sqrt(bend)) if bend > LEAST_BEND else math.inf
    power, below = _spectrum([path[:, task.layout.discrepancy[c]] for path in state.paths])
    highest = 0.5 / interval * 0.5 ** int(np.argmax(np.bincount(below, weights=power, minlength=1)))
    return Discrepancy(size, size / factor, size * factor, p, (0.5 * highest, highest))


def _innovations(
    task: Task, state: State, delta: Floats, interval: float
) -> tuple[tuple[Octave, ...], dict[str, Shape]]:
    """Octaves and shapes of the innovations of all channels of chains, with coefficients moved by `delta`."""
    layout, levels, noisy = task.layout, state.levels, len(task.layout.roles.inputs)
    # inputs are filtered first, so that others are conditioned on them: their model as low-passed noise may be wrong
    order = np.roll(np.arange(len(layout.channels)), noisy)
    noise = levels.noise._replace(channels=levels.noise.channels[order])
    filtered = [run_filter(one.in_order(order), state.chosen, noise) for one in task.linearised(state)]
    octaves, shapes = list[Octave](), dict[str, Shape]()
    otherwise: set[tuple[float, float]] = set()
    drifting = partial(without_drift, levels, interval)
    for k, (channel, kind) in enumerate(layout.channels[i] for i in order):
        left = []
        for found in filtered:
            measured = found.variance[:, k] > 0.0
            innovation = found.innovation[measured, k]
            left.append((innovation[:, 0] - innovation[:, 1:] @ delta) / np.sqrt(found.variance[measured, k]))
        if k < noisy:
            otherwise |= {
                (one.low, one.high) for one in octaves_of(channel, left, interval) if one.p < LIKELIHOOD.test_level
            }
            continue
        together = np.concatenate(left)
        shapes[channel] = shape_of(together - together.mean())
        # as for discrepancies, less excess power than this share of the channel's variance is ignored
        least = LIKELIHOOD.least_discrepancy * levels.scales.channels[order[k]] / levels.channels[order[k]]
        tested = octaves_of(channel, left, interval, otherwise if kind < 0 else set(), drifting)
        octaves += [one for one in tested if abs(one.ratio - 1.0) * one.share > least]
    return tuple(octaves), shapes


def without_drift(levels: Levels, interval: float, frequency: float) -> float:
    """Least share of noise, over channels, in noise plus drift above a frequency [Hz]: true drifts may be slower."""
    if not levels.layout.drift:
        return 1.0
    drift = 0.5 * levels.drifts * levels.layout.drift / (1.0 - math.cos(2.0 * math.pi * frequency * interval))
    return float((levels.channels / (levels.channels + drift)).min())


def gain_of(task: Task, state: State, c: int) -> float:
    """Log likelihood ratio, given the inputs, of the discrepancy of equation c against none with levels re-estimated.

    The noise of an input is estimated by modelling the input as low-passed noise, which is only a convenience. So noise
    up to the input's power in its quietest octave is plausible, and is tried without the discrepancy.
    """
    linears = task.linearised(state)
    held = np.zeros(len(state.levels.free), dtype=np.bool_)
    held[len(state.levels.channels) + c] = True

    def value(levels: Levels) -> float:
        other, bent = replace(state, levels=levels), None
        if task.layout.roles.inputs:
            found = task.marginal(other)
            curved = adjoints(linears, levels, found, found.delta, curved=True)
            bent = bent_by(task.layout, linears, other, curved, found.filtered)[1]
        return task.marginal(other, False, bent).value - of_inputs(linears, levels)

    without = replace(state, levels=state.levels.with_discrepancy(c, 0.0))
    levels = maximised(linears, without, task.precision_of(state), held)[0]
    best = value(levels)
    first = task.layout.first_input
    for i in (np.flatnonzero(levels.learned[first:]) + first).tolist():
        most = _least_power(task, state, i)
        while levels.channels[i] < most:
            other = levels.with_noise(i, min(LIKELIHOOD.noisier * float(levels.channels[i]), most))
            found = value(other)
            if found < best:
                break
            levels, best = other, found
    return value(state.levels) - best


def _least_power(task: Task, state: State, i: int) -> float:
    """Variance of white noise with the power that channel i, an input, has in its quietest octave; 0 if unknown."""
    own = task.layout.kinds[i]
    pieces = [
        np.where(np.isnan(one.samples[:, i]), path[:, own], one.samples[:, i])
        for one, path in zip(task.series, state.paths, strict=True)
    ]
    power, below = _spectrum([piece / math.sqrt(len(piece)) for piece in pieces])
    bins = np.bincount(below)
    means = np.bincount(below, weights=power)[bins >= LEAST_BINS] / bins[bins >= LEAST_BINS]
    return float(means.min(initial=math.inf)) if len(means) else 0.0


def chance_of(gain: float, length: float) -> float:
    """p value of the likelihood ratio of the likeliest discrepancy, for an equation that has none.

    At a fixed memory the signed root of `gain` is about standard normal, and negative values become zero because a
    variance is not negative. The memory is maximised over as well: to the normal tail at one end of its range is added
    the expected number of upcrossings on the way to the other (Davies 1977, with the rate of Rice).

    `gain` is twice the log likelihood ratio; `length` is the arc length [rad] of the normalised score statistic as the
    memory goes from its least to its largest value: statistics of correlation r are arccos(r) apart.

    Examples
    --------
    >>> round(chance_of(1.96**2, 0.0), 3)
    0.025
    >>> round(chance_of(1.96**2, 2.0), 3)
    0.072
    """
    return min(1.0, 0.5 * math.erfc(math.sqrt(0.5 * gain)) + math.exp(-0.5 * gain) * length / (2.0 * math.pi))


def _length(task: Task, state: State, c: int) -> float:
    """The `length` of `chance_of` for the discrepancy of equation c."""
    levels, d = state.levels, task.layout.discrepancy[c]
    memory = levels.memory.copy()
    memory[c] = LIKELIHOOD.shortest_memory
    # a tiny discrepancy of the least memory, smoothed, is proportional to the score for a force at each sample
    little = replace(levels.with_discrepancy(c, 0.0), memory=memory)
    found = task.marginal(replace(state, levels=little))
    smoothed = adjoints(task.linearised(state), little, found, found.delta)
    return turn_of([path[:, d] + one.deviation[:, d] for path, one in zip(state.paths, smoothed, strict=True)])


def turn_of(pulls: Sequence[Floats]) -> float:
    """The `length` of `chance_of`: arc length [rad] of the normalised score statistic over all memories (Davies 1977).

    The memory is the AR(1) coefficient of the discrepancy, from its least to its largest value. `pulls`, (n,) each:
    derivative of the log likelihood, without a discrepancy, by a force at each sample.
    """
    weights, angles = [], []
    for values in pulls:
        lines = np.fft.rfft(values - values.mean())[1 : (len(values) + 1) // 2]
        weights.append(np.abs(lines) ** 2)
        angles.append(2.0 * np.pi * np.arange(1, len(lines) + 1) / len(values))
    power, angle = np.concatenate(weights), np.concatenate(angles)
    low, high = (math.log(m / (1.0 - m)) for m in (LIKELIHOOD.shortest_memory, LIKELIHOOD.longest_memory))
    memory = 1.0 / (1.0 + np.exp(-np.linspace(low, high, MEMORIES)))[:, None]
    spectra = power * (1.0 - memory**2) / (1.0 - 2.0 * memory * np.cos(angle) + memory**2)
    units = spectra / np.linalg.norm(spectra, axis=1)[:, None]
    cosines = np.einsum("mf,mf->m", units[1:], units[:-1])
    return float(np.arccos(np.clip(cosines, -1.0, 1.0)).sum())


def octaves_of(
    channel: str,
    pieces: Sequence[Floats],
    interval: float,
    without: Set[tuple[float, float]] = frozenset(),
    least: Callable[[float], float] = lambda _: 1.0,
) -> list[Octave]:
    """Test octave by octave whether consecutive samples, (n,) in each piece, of a channel are white; `interval` in s.

    Octaves `without` are left out. From a frequency [Hz] on the share ``least(frequency)`` of white power is enough.
    """
    power, below = _spectrum(pieces)
    highest, out = 0.5 / interval, []
    edges = [(highest * 0.5 ** (k + 1), highest * 0.5**k) for k in range(LIKELIHOOD.octaves)]
    kept = ~np.isin(below, [k for k, edge in enumerate(edges) if edge in without])
    power, below = power[kept], below[kept]
    total = float(power.sum())
    for k, (low, high) in enumerate(edges):
        inside = below == k
        bins = int(inside.sum())
        if bins < LEAST_BINS or bins == len(power):
            continue
        share = float(power[inside].sum()) / total
        upper = 1.0 - incomplete_beta(bins, len(power) - bins, share)
        lower = incomplete_beta(bins, len(power) - bins, min(share / least(low), 1.0))
        p = min(2.0 * min(lower, upper), 1.0)
        out.append(Octave(channel, low, high, share * len(power) / bins, p, bins / len(power)))
    return out


def _spectrum(pieces: Sequence[Floats]) -> tuple[Floats, Ints]:
    """Power in all bins between 0 and the Nyquist frequency, and the octave of each, counted down from Nyquist."""
    power, below = [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    for values in pieces:
        bins = np.arange(1, (len(values) + 1) // 2)
        power.append(np.abs(np.fft.rfft(values)[bins]) ** 2)
        below.append(np.minimum(np.floor(-np.log2(2.0 * bins / len(values))).astype(np.int64), LIKELIHOOD.octaves - 1))
    return np.concatenate(power), np.concatenate(below)


def power_of(task: Task, fitted: Fitted) -> float:
    """Power that the likelihood is raised to for correlated innovations; 1 if the scores look independent."""
    if not len(fitted.state.theta):
        return 1.0
    found = task.marginal(fitted.state, bent=fitted.bent)
    root = np.linalg.cholesky(found.covariance)
    excess, error = excess_of(
        [np.einsum("tk,tki->ti", *one.standardised(found.delta)) @ root for one in found.filtered]
    )
    return 1.0 / excess if excess > 1.0 + LIKELIHOOD.correlated_by * error else 1.0
