"""The filter of a linearised record and its adjoint: likelihood, information on coefficients, scores, and the path.

The data and the columns of the candidates go through one Kalman filter with the same gains (Rosenberg 1973; de Jong
1991): the innovations E of the columns and their variance S give the information sum E'E/S of the coefficients. The
adjoint recursion gives the derivatives of the likelihood by all variances (Koopman and Shephard 1992).

Both recursions carry vectors and a matrix of the states side by side in the rows of one array, so that a transition or
a sample changes all of them in the same loops: of the filter the means, then their covariance; of the adjoint the
adjoints, then their information. Rows are padded to whole blocks of `LANES`, which compilers turn into vectors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.kernels import kernel
from bayeq.likelihood.arrays import arrays
from bayeq.likelihood.layout import Candidates
from bayeq.likelihood.linear import Linear, sources_of

__all__ = ["Adjoint", "Filtered", "Noise", "adjoint", "run_filter"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Numbers that a processor handles at once, at least.
LANES = 16

# Numbers of innovations, 256 kB, that stay in a processor's cache until they are summed.
TOGETHER = 2**15


class Noise(NamedTuple):
    """Second moments of what is random.

    Attributes
    ----------
    channels : (M,) array
        Variances R of the channels' noise.
    memory : (S,) array
        What is left of a state after a sample: 1 but for discrepancies and slopes.
    steps : (S,) array
        Variances of what is then added.
    mean, start : (S,) arrays
        Mean and variance of the states at the first sample.
    courses : (L,) array
        Variance of what the course of each input between samples errs by, as a share of the square of its bends.
    """

    channels: Floats
    memory: Floats
    steps: Floats
    mean: Floats
    start: Floats
    courses: Floats


class Filtered(NamedTuple):
    """What a filter leaves.

    Attributes
    ----------
    innovation : (n, M, 1 + r) array
        Of the data, then the derivatives of the prediction by each coefficient.
    variance : (n, M) array
        Of the innovations; 0 where there is no sample.
    gain : (n, M, S) array
        Of each sample.
    mean : (n, S, 1 + r) array
        Filtered deviation from the path, then its derivatives by each coefficient.
    covariance : (n, S, S) array
        Of the filtered states.
    product : (1 + r, 1 + r) array
        Sum of the innovations' products over their variances.
    log_variance : float
        Sum of ln 2 pi S.
    """

    innovation: Floats
    variance: Floats
    gain: Floats
    mean: Floats
    covariance: Floats
    product: Floats
    log_variance: float


class _Running(NamedTuple):
    """Where a recursion stands, and its work space; W is the padded width of a row.

    Attributes
    ----------
    work : (2, S, W) array
        The rows: vectors, one for the data and one for each coefficient, then a matrix. At even samples they stand in
        ``work[0]``, at odd ones in ``work[1]``.
    step : (S, S) array
        Work space of a transition.
    lines : (1, W) array
        What is left of a sample.
    scaled, variance : (rows M, 1 + r) and (rows M,) arrays
        Innovations over their standard deviation, and their variances.
    """

    work: Floats
    step: Floats
    lines: Floats
    scaled: Floats
    variance: Floats

    @classmethod
    def at_start(cls, linear: Linear, chosen: Candidates, noise: Noise) -> _Running:
        """Before the first sample: means of the deviation, its derivatives by each coefficient; covariance."""
        size, channels, r = linear.path.shape[1], len(linear.kinds), len(chosen.chain)
        work = np.zeros((2, size, _padded(1 + r + size)))
        work[0, :, 0] = noise.mean - linear.path[0]
        work[0, :, 1 + r : 1 + r + size] = np.diag(noise.start)
        lines = np.zeros((1, work.shape[2]))
        rows = _rows(channels, r)
        return cls(work, np.empty((size, size)), lines, np.empty((rows * channels, 1 + r)), np.empty(rows * channels))


def _padded(width: int) -> int:
    return -(-width // LANES) * LANES


def _rows(channels: int, r: int) -> int:
    """Samples that are filtered before their innovations are summed."""
    return max(1, TOGETHER // (channels * (1 + r)))


# Kernels that are called for every row.
@kernel(borrowing=True)
def _multiply(
    A: Floats, k: int, memory: Floats, back: bool, related: Ints, step: Floats, work: Floats, now: int
) -> None:
    """B times the rows of ``work[now]``, into the other ones; B = diag(memory) A[k], or its transpose, into `step`.

    Most of B is 0: `step` holds, as `related` lists them, the diagonal and what may be other than 0 beside it.
    """
    size, width = work.shape[1:]
    then = 1 - now
    for i in range(size):
        factor = memory[i] * A[k, i, i]
        step[i, 0] = factor
        for j in range(width):
            work[then, i, j] = factor * work[now, i, j]
        for s in range(1, 1 + related[i, 0]):
            o = related[i, s]
            factor = memory[o] * A[k, o, i] if back else memory[i] * A[k, i, o]
            step[i, s] = factor
            for j in range(width):
                work[then, i, j] += factor * work[now, o, j]


@kernel(borrowing=True)
def _close(related: Ints, step: Floats, work: Floats, then: int, lines: Floats, start: int) -> None:
    """The matrix B M of `_multiply` becomes B M B', exactly symmetric."""
    size = work.shape[1]
    for i in range(size):
        for j in range(i + 1):
            total = step[j, 0] * work[then, i, start + j]
            for s in range(1, 1 + related[j, 0]):
                total += step[j, s] * work[then, i, start + related[j, s]]
            lines[0, j] = total
        for j in range(i + 1):
            work[then, i, start + j] = work[then, j, start + i] = lines[0, j]


@kernel(borrowing=True)
def _combine(factors: Floats, k: int, c: int, work: Floats, which: int, lines: Floats) -> None:
    """The sum of factors [k, c] times the rows of ``work[which]``, into ``lines[0]``."""
    size, width = work.shape[1:]
    factor = factors[k, c, 0]
    for j in range(width):
        lines[0, j] = factor * work[which, 0, j]
    for o in range(1, size - 1, 2):
        factor, other = factors[k, c, o], factors[k, c, o + 1]
        for j in range(width):
            lines[0, j] += factor * work[which, o, j] + other * work[which, o + 1, j]
    if size % 2 == 0:
        factor = factors[k, c, size - 1]
        for j in range(width):
            lines[0, j] += factor * work[which, size - 1, j]


@kernel(borrowing=True)
def _add_sources(sources: Floats, k: int, work: Floats, now: int) -> None:
    """What coefficients add to a step: to the derivatives of the means."""
    for i in range(sources.shape[1]):
        for j in range(sources.shape[2]):
            work[now, i, 1 + j] += sources[k, i, j]


@kernel(borrowing=True)
def _add_force(
    transition: Floats, k: int, d: int, variance: float, motion: int, work: Floats, now: int, start: int
) -> None:
    """Noise of a force over a step, which acts as discrepancy d does, to the covariance."""
    for i in range(motion):
        for j in range(motion):
            work[now, i, start + j] += variance * transition[k, i, d] * transition[k, j, d]


@kernel(borrowing=True)
def _condition(work: Floats, now: int, lines: Floats, variance: float, start: int) -> None:
    """On a sample, by what is left of it."""
    size, width = work.shape[1:]
    share = 1.0 / variance
    for i in range(size):
        gain = share * lines[0, start + i]
        for j in range(width):
            work[now, i, j] -= gain * lines[0, j]


@kernel(borrowing=True)
def _keep_sample(
    k: int, channel: int, lines: Floats, S: float, innovation: Floats, variance: Floats, gain: Floats
) -> None:
    share, start = 1.0 / S if S > 0.0 else 0.0, innovation.shape[2]
    variance[k, channel] = S
    for j in range(start):
        innovation[k, channel, j] = lines[0, j] if S > 0.0 else 0.0
    innovation[k, channel, 0] *= -1.0  # lines hold the prediction less the sample
    for i in range(gain.shape[2]):
        gain[k, channel, i] = share * lines[0, start + i]


@kernel(borrowing=True)
def _keep_state(k: int, work: Floats, now: int, mean: Floats, covariance: Floats) -> None:
    start = mean.shape[2]
    for i in range(mean.shape[1]):
        for j in range(start):
            mean[k, i, j] = work[now, i, j]
        for j in range(mean.shape[1]):
            covariance[k, i, j] = work[now, i, start + j]


@kernel
def _forward(
    linear: Linear,
    chosen: Candidates,
    sources: Floats,
    noise: Noise,
    first: int,
    stop: int,
    keep: bool,
    at: _Running,
    out: Filtered,
) -> int:
    """Samples from `first` to `stop`, with their `sources`; returns how many innovations now stand in ``at.scaled``."""
    path, end, transition, gradient, residual, kinds, follows = linear[:7]
    added, memory, steps = noise.channels, noise.memory, noise.steps
    spread, unresolved, terms = linear.spread, linear.unresolved, linear.terms
    force, discrepancy = linear.force, linear.discrepancy
    work, step, lines, scaled, variances = at
    innovation, variance, gain, mean, covariance = out[:5]
    size, start, used = path.shape[1], 1 + len(chosen.chain), 0
    chain, term = chosen
    for k in range(first, stop):
        now = k % 2
        if k > 0:
            _multiply(transition, k - 1, memory, False, follows, step, work, 1 - now)
            _close(follows, step, work, now, lines, start)
            for i in range(size):
                work[now, i, 0] += memory[i] * end[k - 1, i] - path[k, i]
                work[now, i, start + i] += steps[i]
            _add_sources(sources, k - max(first, 1), work, now)
            for c in range(force.shape[1]):
                variance_c = force[k - 1, c]
                for i in range(len(noise.courses)):
                    variance_c += noise.courses[i] * linear.bends[k - 1, c, i]
                if variance_c > 0.0:
                    _add_force(transition, k - 1, discrepancy[c], variance_c, sources.shape[1], work, now, start)
        for channel in range(len(kinds)):
            S, kind = 0.0, kinds[channel]
            if not np.isnan(residual[k, channel]):
                S = added[channel] * spread[k, channel] + unresolved[k, channel]
                if kind >= 0:
                    for j in range(work.shape[2]):
                        lines[0, j] = work[now, kind, j]
                    S += lines[0, start + kind]
                else:
                    _combine(gradient, k, -1 - kind, work, now, lines)
                    for i in range(size):
                        S += gradient[k, -1 - kind, i] * lines[0, start + i]
                    for j in range(len(chain)):
                        if chain[j] == -1 - kind:
                            lines[0, 1 + j] += linear.open_to[k, chain[j]] * terms[k, term[j]]
                lines[0, 0] -= residual[k, channel]
                unit = 1.0 / np.sqrt(S)
                for j in range(start):
                    scaled[used, j] = unit * lines[0, j]
                variances[used] = S
                used += 1
            if keep:
                _keep_sample(k, channel, lines, S, innovation, variance, gain)
            if S > 0.0:
                _condition(work, now, lines, S, start)
        if keep:
            _keep_state(k, work, now, mean, covariance)
    return used


def run_filter(linear: Linear, chosen: Candidates, noise: Noise, keep: bool = True) -> Filtered:
    """Filter a record with the columns of the chosen candidates beside the data.

    Parameters
    ----------
    linear, chosen, noise
        The model.
    keep : bool
        Whether what `adjoint` needs is wanted; without, there are no rows but in the sums, and memory does not grow
        with the record.
    """
    (n, size), channels, r = linear.path.shape, len(linear.kinds), len(chosen.chain)
    rows = n if keep else 0
    innovation, variance, gain, mean, covariance = arrays(
        (rows, channels, 1 + r), (rows, channels), (rows, channels, size), (rows, size, 1 + r), (rows, size, size)
    )
    out = Filtered(innovation, variance, gain, mean, covariance, np.zeros((1 + r, 1 + r)), 0.0)
    at, logs = _Running.at_start(linear, chosen, noise), 0.0
    together = _rows(channels, r)
    for first in range(0, n, together):
        stop = min(first + together, n)
        sources = sources_of(linear, chosen, max(first, 1) - 1, stop - 1)
        used = _forward(linear, chosen, sources, noise, first, stop, keep, at, out)
        scaled = at.scaled[:used]
        out.product[:] += scaled.T @ scaled
        logs += float(np.log(2.0 * np.pi * at.variance[:used]).sum())
    # innovations are samples less their prediction
    out.product[0, 1:] *= -1.0
    out.product[1:, 0] *= -1.0
    return out._replace(log_variance=logs)


class Adjoint(NamedTuple):
    """Derivatives of the log likelihood, and the smoothed path.

    Attributes
    ----------
    channels : (M,) array
        By the variances R.
    courses : (L,) array
        By those of the courses.
    memory, steps, start : (S,) arrays
        By the entries of `Noise`; the first for states that stay what they are between samples, and 0 for those that
        have neither memory nor steps.
    deviation : (n, S) array
        Smoothed path less that of the linearisation.
    covariance : (n, S, S) array
        Of the smoothed path, given the coefficients; empty where not asked for.
    at_samples, between : (n, C, S) and (n - 1, C, S) arrays
        Directions along which the derivatives of the candidates at the samples, and between them, give what the
        coefficients change in the determinant of the likelihood; empty where not asked for.
    """

    channels: Floats
    courses: Floats
    memory: Floats
    steps: Floats
    start: Floats
    deviation: Floats
    covariance: Floats
    at_samples: Floats
    between: Floats


class _Returning(NamedTuple):
    """Where the adjoint recursion stands, and its work space.

    The coefficients' columns are in units of their uncertainty: derivatives by uncorrelated numbers of variance 1.

    Attributes
    ----------
    work, step : (2, S, W) and (S, S) arrays
        As in `_Running`: adjoints of the data, at the coefficients' mean, and of each coefficient; their information N.
    lines : (4, W) array
        Work space of a sample.
    innovation : (rows, M, 1 + r) array
        At the coefficients' mean, and its derivatives.
    lasting : (s,) int array
        States that change at samples.
    mean : (rows, s, r) array
        Derivatives of their filtered means.
    """

    work: Floats
    step: Floats
    lines: Floats
    innovation: Floats
    lasting: Ints
    mean: Floats

    @classmethod
    def at_end(cls, noise: Noise, r: int, scored: bool) -> _Returning:
        """After the last sample; `scored` if derivatives by the noise are wanted."""
        size, channels = len(noise.memory), len(noise.channels)
        lasting = np.flatnonzero(scored & ((noise.memory != 1.0) | (noise.steps > 0.0)))
        work, rows = np.zeros((2, size, _padded(1 + r + size))), _rows(channels, r)
        lines, innovation = np.zeros((4, work.shape[2])), np.empty((rows, channels, 1 + r))
        return cls(work, np.empty((size, size)), lines, innovation, lasting, np.empty((rows, len(lasting), r)))

    def take(self, found: Filtered, rows: slice, delta: Floats, root: Floats) -> None:
        """Some rows of a filtered record, at deviations `delta` of the coefficients with covariance `root` `root`'."""
        (r, columns), count = root.shape, rows.stop - rows.start
        # derivatives by the coefficients enter with the other sign: e = E_0 - E theta
        units = np.zeros((1 + r, 1 + columns))
        units[0, 0], units[1:, 0], units[1:, 1:] = 1.0, -delta, root
        out = self.innovation[:count].reshape(-1, 1 + columns)
        np.matmul(found.innovation[rows].reshape(-1, 1 + r), units, out=out)
        if self.mean.size:
            mean = found.mean[rows][:, self.lasting, 1:]
            np.matmul(mean.reshape(-1, r), root, out=self.mean[:count].reshape(-1, r))


@kernel(borrowing=True)
def _excess(work: Floats, then: int, i: int, start: int) -> float:
    """Squares of the adjoints of a state less their variance."""
    total = -work[then, i, start + i]
    for j in range(start):
        total += work[then, i, j] ** 2
    return total


@kernel(borrowing=True)
def _excess_of_force(
    transition: Floats, k: int, d: int, motion: int, work: Floats, then: int, lines: Floats, start: int
) -> float:
    """The same of a force over a step."""
    total = 0.0
    for j in range(start + work.shape[1]):
        lines[1, j] = 0.0
        for i in range(motion):
            lines[1, j] += transition[k, i, d] * work[then, i, j]
        if j < start:
            total += lines[1, j] ** 2
        elif j < start + motion:
            total -= lines[1, j] * transition[k, j - start, d]
    return total


@kernel(borrowing=True)
def _leftover(
    gain: Floats, k: int, channel: int, innovation: Floats, row: int, S: float, lines: Floats, start: int
) -> float:
    """E/S - gain'r and -gain'N into ``lines[0]``, where gain'r and gain'N are; returns 1/S + gain'N gain."""
    share = spread = 1.0 / S
    for j in range(start):
        lines[0, j] = share * innovation[row, channel, j] - lines[0, j]
    for i in range(gain.shape[2]):
        spread += gain[k, channel, i] * lines[0, start + i]
        lines[0, start + i] *= -1.0
    return spread


@kernel(borrowing=True)
def _absorb_state(kind: int, spread: float, work: Floats, now: int, lines: Floats, start: int) -> None:
    """A sample of a state: r + h (E/S - gain'r), and N likewise."""
    for i in range(work.shape[1]):
        work[now, i, start + kind] += lines[0, start + i]
    lines[0, start + kind] += spread
    for j in range(work.shape[2]):
        work[now, kind, j] += lines[0, j]


@kernel(borrowing=True)
def _absorb_target(
    gradient: Floats, k: int, c: int, spread: float, work: Floats, now: int, lines: Floats, start: int
) -> None:
    """A sample of a target, whose h is its gradient."""
    size, width = work.shape[1:]
    for i in range(size):
        for j in range(size):
            work[now, i, start + j] += lines[0, start + i] * gradient[k, c, j]
    for i in range(size):
        lines[0, start + i] += spread * gradient[k, c, i]
    for i in range(size):
        factor = gradient[k, c, i]
        for j in range(width):
            work[now, i, j] += factor * lines[0, j]


@kernel(borrowing=True)
def _curve_between(
    transition: Floats,
    covariance: Floats,
    k: int,
    c: int,
    work: Floats,
    now: int,
    lines: Floats,
    between: Floats,
    start: int,
) -> None:
    """-(1 + Phi)/2 P G' N w, w in ``lines[1]``: what the determinant makes of a gradient in the middle of a step."""
    size = work.shape[1]
    for i in range(size):
        lines[2, i] = 0.0
        for o in range(size):
            lines[2, i] += work[now, i, start + o] * lines[1, o]
    for i in range(size):
        lines[1, i] = 0.0
        for o in range(size):
            lines[1, i] += covariance[k, i, o] * lines[2, o]
    for i in range(size):
        total = lines[1, i]
        for o in range(size):
            total += transition[k, i, o] * lines[1, o]
        between[k, c, i] = -0.5 * total


@kernel(borrowing=True)
def _curve_at(
    gradient: Floats,
    covariance: Floats,
    k: int,
    c: int,
    work: Floats,
    now: int,
    lines: Floats,
    at_samples: Floats,
    start: int,
) -> None:
    """-(P - P N P) h: the same of a target that is measured."""
    size = work.shape[1]
    for i in range(size):
        lines[1, i] = 0.0
        for o in range(size):
            lines[1, i] += covariance[k, i, o] * gradient[k, c, o]
    for i in range(size):
        lines[2, i] = 0.0
        for o in range(size):
            lines[2, i] += work[now, i, start + o] * lines[1, o]
    for i in range(size):
        total = lines[1, i]
        for o in range(size):
            total -= covariance[k, i, o] * lines[2, o]
        at_samples[k, c, i] = -total


@kernel(borrowing=True)
def _smooth(covariance: Floats, k: int, work: Floats, now: int, lines: Floats, start: int, smoothed: Floats) -> None:
    """P - P N P: the covariance of a state given all samples."""
    size = work.shape[1]
    for i in range(size):
        for o in range(size):
            lines[1, o] = 0.0
            for m in range(size):
                lines[1, o] += covariance[k, i, m] * work[now, m, start + o]
        for j in range(size):
            total = covariance[k, i, j]
            for o in range(size):
                total -= lines[1, o] * covariance[k, o, j]
            smoothed[k, i, j] = total


@kernel
def _backward(
    linear: Linear, noise: Noise, found: Filtered, first: int, stop: int, at: _Returning, out: Adjoint
) -> None:
    """Samples from the one before `stop` back to `first`."""
    path, transition, gradient, kinds, leads, forces = (
        linear.path,
        linear.transition,
        linear.gradient,
        linear.kinds,
        linear.leads,
        linear.discrepancy,
    )
    memory, added = noise.memory, noise.channels
    variance, gain, covariance = found.variance, found.gain, found.covariance
    work, step, lines, innovation, lasting, mean = at
    motion = linear.steps.motion
    by_channels, by_courses, by_memory, by_steps, _, deviation, smoothed, at_samples, between = out
    (n, size), start = path.shape, innovation.shape[2]
    for k in range(stop - 1, first - 1, -1):
        now = k % 2
        then = 1 - now
        if k < n - 1:
            _multiply(transition, k, memory, True, leads, step, work, then)
            for i in range(size):
                total = deviation[k, i]
                for o in range(size):
                    total += covariance[k, i, o] * work[now, o, 0]
                deviation[k, i] = total
            for s in range(len(lasting)):
                i = lasting[s]
                by_steps[i] += 0.5 * _excess(work, then, i, start)
                _combine(covariance, k, i, work, now, lines)
                total = work[then, i, 0] * (path[k, i] + deviation[k, i]) - lines[0, start + i]
                for j in range(1, start):
                    total += work[then, i, j] * (lines[0, j] - mean[k - first, s, j - 1])
                by_memory[i] += total
            if len(lasting) > 0:
                for c in range(len(forces) if len(by_courses) > 0 else 0):
                    total = _excess_of_force(transition, k, forces[c], motion, work, then, lines, start)
                    for i in range(len(by_courses)):
                        by_courses[i] += 0.5 * linear.bends[k, c, i] * total
            if len(between) > 0:
                for c in range(between.shape[1]):
                    for i in range(size):
                        lines[1, i] = transition[k, i, forces[c]] if i < motion else 0.0
                    _curve_between(transition, covariance, k, c, work, now, lines, between, start)
            _close(leads, step, work, now, lines, start)
        if len(smoothed) > 0:
            _smooth(covariance, k, work, now, lines, start, smoothed)
        if len(at_samples) > 0:
            for channel in range(len(kinds)):
                if -len(forces) <= kinds[channel] < 0 and variance[k, channel] > 0.0:
                    _curve_at(gradient, covariance, k, -1 - kinds[channel], work, now, lines, at_samples, start)
                    own = added[channel] * linear.spread[k, channel] + linear.unresolved[k, channel]
                    for i in range(size):
                        at_samples[k, -1 - kinds[channel], i] /= own
        for channel in range(len(kinds) - 1, -1, -1):
            S, kind = variance[k, channel], kinds[channel]
            if S > 0.0:
                _combine(gain, k, channel, work, now, lines)
                spread = _leftover(gain, k, channel, innovation, k - first, S, lines, start)
                total = -spread
                for j in range(start):
                    total += lines[0, j] ** 2
                by_channels[channel] += 0.5 * total * linear.spread[k, channel]
                if kind >= 0:
                    _absorb_state(kind, spread, work, now, lines, start)
                else:
                    _absorb_target(gradient, k, -1 - kind, spread, work, now, lines, start)


def adjoint(
    linear: Linear,
    noise: Noise,
    found: Filtered,
    delta: Floats,
    V: Floats | None = None,
    curved: bool = False,
    smoothed: bool = False,
) -> Adjoint:
    """The adjoint recursion of a filtered record.

    Parameters
    ----------
    linear, noise, found
        What was filtered, by `run_filter` with `keep`.
    delta : (r,) array
        The coefficients' deviations.
    V : (r, r) array, optional
        Their covariance: derivatives are those of the likelihood marginal over them. Without, those by the noise are
        left out, and 0.
    curved : bool
        Whether `at_samples` and `between` are wanted.
    smoothed : bool
        Whether `covariance` is.
    """
    (n, size), r = linear.path.shape, len(delta)
    chains, root = len(linear.discrepancy), np.zeros((r, 0)) if V is None else _root(V)
    out = Adjoint(
        channels=np.zeros(len(linear.kinds)),
        courses=np.zeros(len(noise.courses)),
        memory=np.zeros(size),
        steps=np.zeros(size),
        start=np.zeros(size),
        deviation=np.empty((n, size)),
        covariance=np.empty((n if smoothed else 0, size, size)),
        at_samples=np.zeros((n if curved else 0, chains, size)),
        between=np.empty((n - 1 if curved else 0, chains, size)),
    )
    at = _Returning.at_end(noise, root.shape[1], V is not None)
    together = _rows(len(linear.kinds), root.shape[1])
    for first in reversed(range(0, n, together)):
        rows = slice(first, min(first + together, n))
        at.take(found, rows, delta, root)
        np.matmul(found.mean[rows].reshape(-1, 1 + r), np.append(1.0, delta), out=out.deviation[rows].reshape(-1))
        _backward(linear, noise, found, first, rows.stop, at, out)
    if V is None:
        out.channels[:], out.courses[:] = 0.0, 0.0
        return out
    adjoints = at.work[0]
    out.start[:] = 0.5 * ((adjoints[:, : 1 + r] ** 2).sum(axis=1) - np.diagonal(adjoints[:, 1 + r : 1 + r + size]))
    return out


def _root(V: Floats) -> Floats:
    """L with L L' = V, which may be singular."""
    unit = np.sqrt(np.diagonal(V))
    unit = np.where(unit > 0.0, unit, 1.0)
    values, vectors = np.linalg.eigh(V / unit[:, None] / unit)
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
