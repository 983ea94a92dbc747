"""Factors and lags of channels, estimated by the likelihood; and tests for channels that are off.

A channel whose factor is uncertain measures ``(1 + g) s`` of a signal s, which the path gives: filtering s alone gives
the derivative of the innovations with respect to g, as filtering the candidates' columns does for coefficients. There
is one g for all records.

A lag is a constant state (`bayeq.likelihood.layout`) with a prior: coefficients, levels, evidence and selection are
those with the lags integrated out. A channel is linear in its lag only if the lag is short; so estimated lags are
removed from the samples, and lags are estimated again, until little of them is left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.expressions import Expression
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, Statistics, solved
from bayeq.likelihood.layout import NOTHING, Layout
from bayeq.likelihood.model import Task
from bayeq.likelihood.search import CLEARLY
from bayeq.numerics.distributions import excess_of
from bayeq.numerics.spline import spline_slopes
from bayeq.records.validate import EVEN
from bayeq.states import Gain, Lag, Motion
from bayeq.states.bad_samples import MEDIAN_NORMAL
from bayeq.states.sensors import bridged

# A channel is suspect if its factor, lag or offset is off by more standard deviations (laws that lack a term stay below
# 6, sensors that are off exceed 14: `tests/test_gains.py`) and changes its samples by more than a share of their sd.
SUSPECTED, AS_SAID = 8.0, 1e-3

# Logarithms of factors of the noise that was stated of a channel at which the likelihood is compared with that of the
# stated one, and the distance from the likeliest of these within which the factor is sought.
MULTIPLES, FINER = [math.log(2.0) * k for k in (-12, -8, -4, -2, -1, 1, 2, 4, 8, 12)], math.log(16.0)

# Errors of channels are the same if one explains all but this share of what the other does: of two channels a factor of
# either (1e-4), and not of three (0.3).
SAME = 0.02

# An estimated factor or lag contradicts what was stated of the channel beyond this many stated standard deviations.
CONTRADICTED = 4.0


class Calibration(NamedTuple):
    """Estimated calibration factors of channels."""

    gains: Mapping[str, Gain]  # by the names of the channels
    covariance: Floats  # of the factors, coefficients integrated out
    moved: float  # distance from the factors that were removed from the samples, in standard deviations


def calibration_of(task: Task, state: State, power: float = 1.0) -> Calibration:
    """Factors of channels about a fit, relative to the samples as measured; the likelihood is raised to `power`."""
    uncertain = task.layout.uncertain
    if not uncertain:
        return Calibration({}, np.zeros((0, 0)), 0.0)
    found = _directions(task, state, task.marginal(state), [(i, "factor") for i, _ in uncertain])
    taken = np.array([gain.value for _, gain in uncertain])
    known = np.array([gain.prior_sd for _, gain in uncertain]) ** -2.0 * taken**2
    covariance = solved(power * found.information + np.diag(known), np.eye(len(known)))
    change = covariance @ (power * found.slope + known * (1.0 / taken - 1.0))
    sizes = taken * np.sqrt(np.diagonal(covariance))
    gains = {
        task.layout.channels[i][0]: Gain(float(value), float(sd), gain.prior_sd)
        for (i, gain), value, sd in zip(uncertain, taken * (1.0 + change), sizes, strict=True)
    }
    moved = float(np.sqrt(change @ solved(covariance, change) / len(known)))
    return Calibration(gains, covariance * np.outer(taken, taken), moved)


Off = Literal["factor", "lag", "offset", "high-pass", "filter", "rate", "lost", "noise"]


class Suspect(NamedTuple):
    """A channel whose factor, lag, offset or AC coupling would explain much of the residual, or that was low-pass
    filtered; or, under the name of the channel that shows it most, a wrong sampling rate or rows that were lost."""

    channel: str
    off: Off
    # by `off`: factor - 1 of a channel or the rate; lag [s]; offset [unit of the channel]; corner of the coupling [Hz];
    # frequency [Hz] above which a filter left no noise, time from the start of a record to rows that were lost [s], or
    # the likeliest factor of the noise that was stated
    value: float
    sds: float = 0.0  # size of `value` in standard deviations
    as_well: tuple[Suspect, ...] = ()  # others that explain about as much


def suspects_of(task: Task, state: State, here: Statistics) -> tuple[Suspect, ...]:
    """Channels that others contradict, by score tests of one at a time, or whose estimates contradict their prior."""
    layout, compared = task.layout, set(task.layout.roles.compared)
    lowest = {next(filter(None, chain.measured), None) for chain in layout.roles.chains}
    open_to: dict[Off, set[str]] = {"factor": compared, "lag": compared.union(layout.roles.inputs)}
    if not layout.drift:
        open_to["offset"] = compared.difference(name for name in lowest if name)
    learned: list[tuple[int, Off, float, float]] = [
        *((i, "factor", gain.value - 1.0, gain.prior_sd) for i, gain in layout.uncertain),
        *((i, "lag", lag.value, lag.prior_sd) for i, lag in layout.late),
    ]
    known = {(i, off) for i, off, _, _ in learned}
    sought = [
        (i, off)
        for i, (name, _) in enumerate(layout.channels)
        for off, names in open_to.items()
        if name in names and (i, off) not in known
    ]
    out = [
        Suspect(layout.channels[i][0], off, value, abs(value) / sd)
        for i, off, value, sd in learned
        if abs(value) > CONTRADICTED * sd
    ]
    if not sought or layout.discrete:
        return tuple(out)
    out += lost_rows(task, state, here)
    found = _directions(task, state, here, sought)
    orders = {name: order for chain in layout.roles.chains for order, name in enumerate(chain.measured) if name}
    factors = [orders.get(layout.channels[i][0], 0) * (off == "factor") for i, off in sought]
    if max(factors) and not any(off == "factor" for _, off in known):
        # at another rate a velocity has another factor, and an acceleration its square: this may explain factors
        found, sought = found.beside(np.array(factors)), [*sought, (sought[int(np.argmax(factors))][0], "rate")]
    named = _contradicted(layout, found, sought)
    alike = {k: one for k, one in named.items() if one.off in ("factor", "rate")}
    if {one.off for one in alike.values()} == {"rate"}:
        named = {k: one for k, one in named.items() if k not in alike}
    lagging = [k for k, one in named.items() if one.off == "lag"]
    coupled = dict[str, list[Suspect]]()
    if lagging:  # as a channel with AC coupling seems, which is early, or an input of motion that is measured with it
        corners, gains = _directions(task, state, here, [(sought[k][0], "high-pass") for k in lagging]), found.alone[1]
        for k, value, gain, share in zip(lagging, *corners.alone, corners.shares, strict=True):
            # a corner explains the same innovations: what makes a lag less certain makes it less certain too
            sds = named[k].sds * math.sqrt(gain / gains[k])
            if sds > SUSPECTED and abs(value) * share > AS_SAID:
                coupled[named[k].channel] = _coupled(layout, named[k], float(value) / (2.0 * math.pi), sds)
    for k, one in named.items():
        as_well = [other for m, other in alike.items() if m != k and k in alike and found.same(k, m)]
        if one.off == "lag":  # in a narrow band they are the same
            as_well += [other for other in coupled.get(one.channel, ()) if one.sds**2 - other.sds**2 < 2.0 * CLEARLY]
        named[k] = one._replace(as_well=tuple(as_well))
    return (*out, *named.values(), *(one for some in coupled.values() for one in some))


def misstated(task: Task, state: State) -> tuple[Suspect, ...]:
    """Channels whose stated noise is clearly less likely than a multiple of it, other levels as they are."""
    levels, out = state.levels, []
    for i in np.flatnonzero(~levels.learned).tolist():

        def negative(log_factor: float, i: int = i) -> float:
            variance = math.exp(2.0 * log_factor) * float(levels.channels[i])
            return -task.value(replace(state, levels=levels.with_noise(i, variance)))

        best = min(MULTIPLES, key=negative)
        if negative(best) < negative(0.0) - CLEARLY:
            from scipy.optimize import minimize_scalar

            least = minimize_scalar(negative, bounds=(best - FINER, best + FINER))
            gain = negative(0.0) - float(least.fun)
            out.append(Suspect(task.layout.channels[i][0], "noise", math.exp(float(least.x)), math.sqrt(2.0 * gain)))
    return tuple(out)


def _contradicted(layout: Layout, found: _Directions, sought: Sequence[tuple[int, Off]]) -> dict[int, Suspect]:
    """The errors that score tests find, by their numbers in `sought`."""
    squares, out = np.maximum(np.diagonal(found.information), np.finfo(np.float64).tiny), dict[int, Suspect]()
    values, _ = found.alone
    for k in np.flatnonzero(np.abs(values) * found.shares > AS_SAID).tolist():
        # the scores of the corrected channel show by how much noise that is not white makes the slope less certain
        change, (i, off) = found.changes[..., k], sought[k]
        scores = (change * (found.left - values[k] * change)).sum(axis=1, keepdims=True) / np.sqrt(squares[k])
        excess, _ = excess_of(np.split(scores, found.ends))
        sds = abs(float(found.slope[k])) / np.sqrt(squares[k] * max(excess, 1.0))
        if sds > SUSPECTED:
            out[k] = Suspect(layout.channels[i][0], off, float(values[k]), float(sds))
    return out


def _coupled(layout: Layout, lagging: Suspect, corner: float, sds: float) -> list[Suspect]:
    """The channel of a lag as AC-coupled; if the corner [Hz] is negative, all channels of the motion instead.

    The latter need a lag of an input, and one channel for each coordinate; otherwise there are none.
    """
    measured = [chain.measured for chain in layout.roles.chains]
    alone = [name for names in measured for name in filter(None, names)]
    if corner < 0.0 and (lagging.channel not in layout.roles.inputs or len(alone) > len(measured)):
        return []
    return [Suspect(name, "high-pass", abs(corner), sds) for name in ([lagging.channel] if corner > 0.0 else alone)]


def lost_rows(task: Task, state: State, here: Statistics) -> list[Suspect]:
    """A time at which rows of an evenly sampled record were lost, if any: all coordinates are then ahead at once.

    Derivatives are not looked at: they may jump, with a force or in an impact.
    """
    layout, out = task.layout, list[Suspect]()
    states = {chain.measured[chain.lowest] for chain in layout.roles.chains if chain.lowest < len(chain.measured) - 1}
    which = [i for i, (name, _) in enumerate(layout.channels) if name in states]
    if not which:
        return out
    for one, linear, found in zip(task.series, task.linearised(state), here.filtered, strict=True):
        time, step = np.append(0.0, np.cumsum(one.intervals)), float(np.median(one.intervals))
        if np.ptp(one.intervals) > EVEN * step:
            continue
        seen = np.column_stack([bridged(one.samples[:, i] - linear.residual[:, i]) for i in which])
        variance = found.variance[:, which]
        known = variance > 0.0
        ahead = np.where(known, step * spline_slopes(time, seen) / np.sqrt(np.where(known, variance, 1.0)), 0.0)
        square = np.maximum((ahead**2).sum(axis=1), np.finfo(np.float64).tiny)
        steps = (ahead * found.standardised(here.delta)[0][:, which]).sum(axis=1) / square
        scores = steps * np.sqrt(square)
        scores /= max(float(np.median(np.abs(scores))) / MEDIAN_NORMAL, 1.0)
        at = np.flatnonzero((scores > SUSPECTED) & (steps > 0.5))
        if len(at):
            out.append(Suspect(layout.channels[which[0]][0], "lost", float(time[at[0]]), float(scores[at].max())))
    return out[:1]


class _Directions(NamedTuple):
    """Changes of the innovations of all records by errors of channels, with the coefficients integrated out."""

    left: Floats  # (n, M), standardised innovations of the records, one record after the other
    changes: Floats  # (n, M, G), their changes by a unit of each error, less the part that coefficients can explain
    ends: list[int]  # rows at which a record ends and the next begins
    information: Floats  # (G, G), on the errors
    slope: Floats  # (G,), derivative of the log likelihood by the errors
    shares: Floats  # (G,), change of the channel by a unit of each error, as a share of its standard deviation

    @property
    def alone(self) -> tuple[Floats, Floats]:
        """Each error as if it were the only one, and twice the log likelihood that it gains, (G,) each."""
        values = self.slope / np.maximum(np.diagonal(self.information), np.finfo(np.float64).tiny)
        return values, values * self.slope

    def same(self, k: int, m: int) -> bool:
        """Whether two errors change the record alike, or in opposite ways."""
        own, other, both = self.information[k, k], self.information[m, m], self.information[k, m]
        return bool(own * other - both**2 < SAME * own * other)

    def beside(self, weights: Floats) -> _Directions:
        """The directions, followed by their sum with these weights, (G,)."""
        all_of = np.column_stack([np.eye(len(weights)), weights])
        return self._replace(
            changes=self.changes @ all_of,
            information=all_of.T @ self.information @ all_of,
            slope=self.slope @ all_of,
            shares=np.append(self.shares, 1.0),
        )


def _directions(task: Task, state: State, here: Statistics, sought: Sequence[tuple[int, Off]]) -> _Directions:
    """The changes by the errors `sought`, each given by the number of its channel and its kind."""
    pieces, square = [], np.zeros(len(sought))
    still = state.levels.noise._replace(mean=np.zeros(task.layout.size))
    for one, linear, filtered in zip(task.series, task.linearised(state), here.filtered, strict=True):
        left, columns = filtered.standardised(here.delta)
        time, changes = np.append(0.0, np.cumsum(one.intervals)), np.empty((*left.shape, len(sought)))
        at_rest = linear._replace(path=np.zeros_like(linear.path), end=np.zeros_like(linear.end))
        for k, (i, off) in enumerate(sought):
            seen, samples = bridged(one.samples[:, i] - linear.residual[:, i]), 0.0 * linear.residual
            if task.layout.drift:
                seen -= linear.path[:, task.layout.drifts[i]]
            if off == "lag":
                seen = -spline_slopes(time, seen[:, None])[:, 0]
            if off == "high-pass":  # of a low corner: the signal less the corner, 2 pi f, times its integral
                seen = seen - np.nanmean(seen)
                seen = -np.append(0.0, np.cumsum(0.5 * (seen[1:] + seen[:-1]) * one.intervals))
            samples[:, i] += 1.0 if off == "offset" else seen
            square[k] += float(np.nansum(samples[:, i] ** 2))
            changed = run_filter(at_rest._replace(residual=samples), NOTHING, still)
            changes[..., k] = changed.standardised(np.zeros(0))[0]
        pieces.append((left, columns, changes))
    left, columns, changes = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    alone = changes - columns @ (here.covariance @ np.einsum("tmr,tmi->ri", columns, changes))
    shares = np.sqrt(square / len(left) / state.levels.scales.channels[[i for i, _ in sought]])
    return _Directions(
        left,
        alone,
        np.cumsum([len(part) for part, *_ in pieces])[:-1].tolist(),
        np.einsum("tmi,tmj->ij", alone, changes),
        np.einsum("tmi,tm->i", changes, left),
        shares,
    )


# Lags of inputs are first sought among whole samples: up to this many prior standard deviations, at most this many
# values each way, in the first of this many rows of the longest record.
REACH, EACH_WAY, ROWS = 3.0, 50, 4000


def first_lags(motion: Motion, terms: Sequence[Expression]) -> Mapping[str, Lag]:
    """Lags of channels: for inputs those with which all terms explain the smoothed rows best, for others as given."""
    rows, out = max(motion.train, key=lambda one: one.n), dict(motion.sensors.lags)
    rows = rows.part(slice(0, ROWS))
    assert rows.time is not None
    step = float(np.median(np.diff(rows.time)))
    for name in [name for name in motion.roles.inputs if name in out]:
        sd, u = out[name].prior_sd, rows.columns[name]
        reach = min(int(np.ceil(REACH * sd / step)), rows.n // 4)
        inside = slice(reach, rows.n - reach)
        targets = np.column_stack([rows.columns[target][inside] for target in motion.roles.targets])
        columns = {other: values[inside] for other, values in rows.columns.items()}
        scores = {}
        for late in range(-reach, reach + 1, -(-reach // EACH_WAY) or 1):
            with np.errstate(all="ignore"):
                D = evaluate_terms(terms, {**columns, name: np.roll(u, -late)[inside]})
            D = np.column_stack([D[:, np.isfinite(D).all(axis=0)], np.ones(len(D))])
            D /= np.maximum(np.abs(D).max(axis=0), 1e-300)
            left = targets - D @ np.linalg.lstsq(D, targets, rcond=1e-10)[0]
            unlikely = 0.5 * (late * step / sd) ** 2
            scores[late] = unlikely + 0.5 * len(left) * float(np.log(np.maximum((left**2).sum(axis=0), 1e-300)).sum())
        out[name] = replace(out[name], value=step * min(scores, key=lambda late: scores[late]))
    return out


def lags_of(task: Task, state: State, power: float = 1.0) -> Mapping[str, Lag]:
    """Lags of channels about a fit, of the samples as measured, averaged over records; `power` as for factors."""
    found, out = task.marginal(state), {}
    for (channel, lag), s in zip(task.layout.late, task.layout.lags, strict=True):
        known, weights, total = lag.prior_sd**-2.0, 0.0, 0.0
        for path, one in zip(state.paths, found.filtered, strict=True):
            by_theta = one.mean[-1, s, 1:]
            value = lag.value + path[-1, s] + one.mean[-1, s, 0] + by_theta @ found.delta
            variance = one.covariance[-1, s, s] + by_theta @ found.covariance @ by_theta
            # the information of this record alone, without the prior of mean 0
            total += value / variance
            weights += max(1.0 / variance - known, 0.0)
        precision = power * weights + known
        name = task.layout.channels[channel][0]
        out[name] = Lag(float(power * total / precision), float(precision**-0.5), lag.prior_sd)
    return out
