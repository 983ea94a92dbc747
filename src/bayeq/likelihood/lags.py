"""Lags of channels as the likelihood finds them.

A lag is a state that nothing moves (`bayeq.likelihood.layout`), known at first by its prior: coefficients, levels,
evidence and selection are those with the lags integrated out. What a channel sees is linear in its lag only where that
is short; so lags are taken out of the samples, and learned again, until little of them is left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.dictionary import evaluate_terms
from bayeq.expressions import Expression
from bayeq.likelihood.fit import State
from bayeq.likelihood.model import Task
from bayeq.states import Lag, Motion

# Lags of inputs are first sought among whole samples, up to this many standard deviations, this many of them each way
# at most, in this many rows of the longest record.
REACH, EACH_WAY, ROWS = 3.0, 50, 4000


def first_lags(motion: Motion, terms: Sequence[Expression]) -> Mapping[str, Lag]:
    """Lags of inputs by which all terms together explain most of the smoothed rows; 0 of other channels.

    From there the likelihood finds the lags of inputs too whose course over a sample is no straight line.
    """
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
    """The lags of channels about a fit, what was taken out of the samples included.

    Every record has its own, with the same prior; they are averaged by their information. The likelihood is raised to
    `power`.
    """
    found, out = task.marginal(state), {}
    for (channel, lag), s in zip(task.layout.late, task.layout.lags, strict=True):
        known, weights, total = lag.prior_sd**-2.0, 0.0, 0.0
        for path, one in zip(state.paths, found.filtered, strict=True):
            by_theta = one.mean[-1, s, 1:]
            value = lag.value + path[-1, s] + one.mean[-1, s, 0] + by_theta @ found.delta
            variance = one.covariance[-1, s, s] + by_theta @ found.covariance @ by_theta
            # what the record tells beside the prior of mean 0
            total += value / variance
            weights += max(1.0 / variance - known, 0.0)
        precision = power * weights + known
        name = task.layout.channels[channel][0]
        out[name] = Lag(float(power * total / precision), float(precision**-0.5), lag.prior_sd)
    return out
