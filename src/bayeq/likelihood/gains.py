"""Factors of channels as the likelihood finds them: one number each for all records; and channels that are off.

A channel that may be off by a factor is a measurement ``(1 + g) s`` of s, about s as it is along the path: the filter
of these samples alone gives the derivative of the innovations by g, beside those by the coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.filter import run_filter
from bayeq.likelihood.fit import State, solved
from bayeq.likelihood.layout import NOTHING
from bayeq.likelihood.model import Task
from bayeq.numerics.distributions import excess_of
from bayeq.numerics.spline import spline_slopes
from bayeq.states import Gain
from bayeq.states.sensors import bridged

# A channel is named whose factor, lag or offset explains what is left by more standard deviations: laws that lack a
# term stay below 6, sensors that are off exceed 14 (`tests/test_gains.py`); and moves its samples by more than a share.
SUSPECTED, AS_SAID = 8.0, 1e-3

# What is learned of a channel contradicts what was said of it by more of the standard deviations that were given.
CONTRADICTED = 4.0


class Calibration(NamedTuple):
    """What is known of the factors of some channels."""

    gains: Mapping[str, Gain]  # by the names of the channels
    covariance: Floats  # of the factors, coefficients integrated out
    moved: float  # how far they are from what was taken out of the samples, in standard deviations


def calibration_of(task: Task, state: State, power: float = 1.0) -> Calibration:
    """The factors of channels about a fit, those that were taken out of the samples included.

    The likelihood is raised to `power`.
    """
    uncertain = task.layout.uncertain
    if not uncertain:
        return Calibration({}, np.zeros((0, 0)), 0.0)
    _, _, information, slope, _ = _directions(task, state, [(i, "factor") for i, _ in uncertain])
    taken = np.array([gain.value for _, gain in uncertain])
    known = np.array([gain.prior_sd for _, gain in uncertain]) ** -2.0 * taken**2
    covariance = solved(power * information + np.diag(known), np.eye(len(known)))
    change = covariance @ (power * slope + known * (1.0 / taken - 1.0))
    sizes = taken * np.sqrt(np.diagonal(covariance))
    gains = {
        task.layout.channels[i][0]: Gain(float(value), float(sd), gain.prior_sd)
        for (i, gain), value, sd in zip(uncertain, taken * (1.0 + change), sizes, strict=True)
    }
    moved = float(np.sqrt(change @ solved(covariance, change) / len(known)))
    return Calibration(gains, covariance * np.outer(taken, taken), moved)


Off = Literal["factor", "lag", "offset"]


class Suspect(NamedTuple):
    """A channel whose factor, lag or offset would explain much of what is left."""

    channel: str
    off: Off
    value: float  # by what share its samples are too large, or how late [s], or by how much [unit of the channel]
    sds: float  # the size of that in standard deviations


def suspects_of(task: Task, state: State) -> tuple[Suspect, ...]:
    """Channels that the others contradict, one at a time, by score tests, or that what was said of them contradicts.

    Nothing tells the factor of an input, or of the only channel of a chain; the offset of the lowest may be a term.
    """
    layout = task.layout
    chains = [[name for name in chain.measured if name is not None] for chain in layout.roles.chains]
    several = {name for names in chains if len(names) > 1 for name in names}
    shifted = set() if layout.drift else several.difference(names[0] for names in chains if names)
    open_to: dict[Off, set[str]] = {"factor": several, "lag": several.union(layout.roles.inputs), "offset": shifted}
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
    contradicted = tuple(
        Suspect(layout.channels[i][0], off, value, abs(value) / sd)
        for i, off, value, sd in learned
        if abs(value) > CONTRADICTED * sd
    )
    if not sought or layout.discrete:
        return contradicted
    found = _directions(task, state, sought)
    values = found.slope / np.maximum(np.diagonal(found.information), np.finfo(np.float64).tiny)
    out = list(contradicted)
    for k, (i, off) in enumerate(sought):
        if abs(values[k]) * found.shares[k] > AS_SAID:
            # noise that is not white makes the slope less certain: by the scores with the channel put right
            own = [(change[..., k], left) for left, change in zip(found.left, found.changes, strict=True)]
            scores = [(change * (left - values[k] * change)).sum(axis=1)[:, None] for change, left in own]
            unit = float(np.sqrt(found.information[k, k]))
            excess, _ = excess_of([one / unit for one in scores])
            sds = abs(float(found.slope[k])) / unit / np.sqrt(max(excess, 1.0))
            if sds > SUSPECTED:
                out.append(Suspect(layout.channels[i][0], off, float(values[k]), float(sds)))
    return tuple(out)


class _Directions(NamedTuple):
    """How the innovations of records change with what channels are off by, coefficients integrated out."""

    left: list[Floats]  # (n, M), standardised innovations
    changes: list[Floats]  # (n, M, G), their derivatives, less what coefficients make up for
    information: Floats  # (G, G)
    slope: Floats  # (G,)
    shares: Floats  # (G,), what each changes its channel by, as a share of the channel's standard deviation


def _directions(task: Task, state: State, sought: Sequence[tuple[int, Off]]) -> _Directions:
    """Those of channels, each with what is sought of it."""
    found, size, pieces = task.marginal(state), task.layout.size, []
    square, rows = np.zeros(len(sought)), sum(len(one.samples) for one in task.series)
    still = state.levels.noise._replace(mean=np.zeros(size))
    for one, linear, filtered in zip(task.series, task.linearised(state), found.filtered, strict=True):
        left, columns = filtered.standardised(found.delta)
        time, changes = np.append(0.0, np.cumsum(one.intervals)), np.empty((*left.shape, len(sought)))
        for k, (i, off) in enumerate(sought):
            seen, samples = bridged(one.samples[:, i] - linear.residual[:, i]), 0.0 * linear.residual
            if task.layout.drift:
                seen = seen - linear.path[:, task.layout.drifts[i]]
            if off != "factor":
                seen = -spline_slopes(time, seen[:, None])[:, 0] if off == "lag" else np.ones(len(seen))
            samples[:, i] += seen
            square[k] += float(np.nansum(samples[:, i] ** 2))
            at_rest = linear._replace(path=0.0 * linear.path, end=0.0 * linear.end, residual=samples)
            changes[..., k] = run_filter(at_rest, NOTHING, still).standardised(np.zeros(0))[0]
        pieces.append((left, columns, changes))
    across = sum(np.einsum("tmr,tmi->ri", columns, changes) for _, columns, changes in pieces)
    alone = [changes - columns @ (found.covariance @ across) for _, columns, changes in pieces]
    both = [(own, left, changes) for own, (left, _, changes) in zip(alone, pieces, strict=True)]
    information = np.sum([np.einsum("tmi,tmj->ij", own, changes) for own, _, changes in both], axis=0)
    slope = np.sum([np.einsum("tmi,tm->i", changes, left) for _, left, changes in both], axis=0)
    shares = np.sqrt(square / rows / state.levels.scales.channels[[i for i, _ in sought]])
    return _Directions([left for left, _, _ in pieces], alone, information, slope, shares)
