"""The Kalman filter of a linearised record: its likelihood, and the information on coefficients.

The data and the columns of the candidates go through one filter with the same gains (Rosenberg 1973; de Jong 1991): the
innovations E of the columns and their variance S give the information sum E'E/S of the coefficients.

The filter and its adjoint (`bayeq.likelihood.adjoint`) carry vectors and a matrix of the states side by side in the
rows of one array, so that a transition or a sample changes all of them in the same loops: the filter the means, then
their covariance; the adjoint its vectors, then their information. Rows are padded to whole blocks of `LANES`, which
compilers vectorise.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.kernels import kernel
from bayeq.likelihood.layout import Candidates
from bayeq.likelihood.linear import Linear, sources_of
from bayeq.likelihood.steps import arrays

# Rows are padded to a multiple of this many floats, for vector instructions.
LANES = 16

# Floats in a cache line.
LINE = 8

# Floats of innovations (256 kB) that are filtered before they are summed, so that they stay in the processor's cache.
TOGETHER = 2**15
# Number of steps, at least, whose derivatives by coefficients are computed at a time.
AHEAD = 64


class Noise(NamedTuple):
    """Variances of noise, steps and first states."""

    channels: Floats  # (M,), variances R of the channels' noise
    memory: Floats  # (S,), factor of each state from sample to sample: 1 except for discrepancies
    steps: Floats  # (S,), variances of the random steps that are then added
    mean: Floats  # (S,), prior means of the states at the first sample
    start: Floats  # (S,), their prior variances
    # (L,), variance of the interpolation error of each input between samples, as a share of its squared bends
    courses: Floats


class Filtered(NamedTuple):
    """A filtered record."""

    innovation: Floats  # (n, M, 1 + r), of the data, then the derivatives of the prediction by each coefficient
    variance: Floats  # (n, M), of the innovations; 0 where there is no sample
    gain: Floats  # (n, M, S), Kalman gain of each sample
    mean: Floats  # (n, S, 1 + r), filtered deviation from the path, then its derivatives by each coefficient
    covariance: Floats  # (n, S, S), of the filtered states
    product: Floats  # (1 + r, 1 + r), sum of the innovations' products over their variances
    log_variance: float  # sum of ln 2 pi S

    def standardised(self, delta: Floats) -> tuple[Floats, Floats]:
        """Standardised innovations (n, M), with coefficients moved by `delta`, and the predictions' derivatives by the
        coefficients (n, M, r), in the same units; 0 where there is no sample."""
        known = self.variance > 0.0
        sd = np.sqrt(np.where(known, self.variance, 1.0))[..., None]
        standard = np.where(known[..., None], self.innovation / sd, 0.0)
        return standard[..., 0] - standard[..., 1:] @ delta, standard[..., 1:]


class _Running(NamedTuple):
    """State and work space of the recursion; W is the padded width of a row."""

    # (2, S, W), the rows: vectors, one for the data and one for each coefficient, then a matrix. At even samples they
    # stand in ``work[0]``, at odd ones in ``work[1]``.
    work: Floats
    step: Floats  # (S, S), work space of a transition
    turned: Floats  # (2, S, padded S), likewise
    lines: Floats  # (1, W), a sample's prediction error, its derivatives, and its covariances with the states
    scaled: Floats  # (rows M, 1 + r), innovations over their standard deviation
    variance: Floats  # (rows M,), of the innovations
    pulled: Floats  # (1 + r,), of `Linear.pull`: the part of the log likelihood, and its derivatives by coefficients

    @classmethod
    def at_start(cls, linear: Linear, chosen: Candidates, noise: Noise) -> _Running:
        """The recursion before the first sample, with prior means of the deviation from the path and covariance."""
        size, channels, r = linear.path.shape[1], len(linear.kinds), len(chosen.chain)
        work = aligned(2, size, padded(1 + r + size))
        work[0, :, 0] = noise.mean - linear.path[0]
        work[0, :, 1 + r : 1 + r + size] = np.diag(noise.start)
        step, turned, lines = np.empty((size, size)), aligned(2, size, padded(size)), aligned(1, work.shape[2])
        rows = rows_together(channels, r) * channels
        return cls(work, step, turned, lines, np.empty((rows, 1 + r)), np.empty(rows), np.zeros(1 + r))


def padded(width: int) -> int:
    """Width of a row of this many numbers, padded to a multiple of `LANES`."""
    return -(-width // LANES) * LANES


def rows_together(channels: int, r: int) -> int:
    """Number of samples that are filtered before their innovations are summed."""
    return max(1, TOGETHER // (channels * (1 + r)))


def aligned(*shape: int) -> Floats:
    """Zeros that begin with a cache line: vector instructions on others take 1.5 times as long."""
    block = np.zeros(math.prod(shape) + LINE)
    first = -(block.ctypes.data // block.itemsize) % LINE
    return block[first : first + math.prod(shape)].reshape(shape)


# Kernels that are called for every row.
@kernel(borrowing=True)
def _combine_rows(related: Ints, step: Floats, rows: Floats, now: int) -> None:
    """Puts B times ``rows[now]`` into the other half of `rows`; `step` and `related` are as in `multiply`."""
    size, width = rows.shape[1:]
    then = 1 - now
    for i in range(size):
        count, factor = related[i, 0], step[i, 0]
        if count % 2 == 1:
            a, o = step[i, count], related[i, count]
            for j in range(width):
                rows[then, i, j] = factor * rows[now, i, j] + a * rows[now, o, j]
        else:
            for j in range(width):
                rows[then, i, j] = factor * rows[now, i, j]
        whole = count - count % 4
        for s in range(1, whole, 4):  # four at a time: sums stay in registers
            a, b, c, d = step[i, s], step[i, s + 1], step[i, s + 2], step[i, s + 3]
            o, p, q, r = related[i, s], related[i, s + 1], related[i, s + 2], related[i, s + 3]
            for j in range(width):
                total = a * rows[now, o, j] + b * rows[now, p, j]
                rows[then, i, j] += total + (c * rows[now, q, j] + d * rows[now, r, j])
        if count - whole > 1:
            a, b, o, p = step[i, whole + 1], step[i, whole + 2], related[i, whole + 1], related[i, whole + 2]
            for j in range(width):
                rows[then, i, j] += a * rows[now, o, j] + b * rows[now, p, j]


@kernel(borrowing=True)
def multiply(
    A: Floats, k: int, memory: Floats, back: bool, related: Ints, step: Floats, work: Floats, now: int
) -> None:
    """Puts B times the rows of ``work[now]`` into the other half of `work`: B = diag(memory) A[k], or its transpose if
    `back`. `step` receives the entries of B: the diagonal, then the off-diagonal ones that `related` lists."""
    for i in range(work.shape[1]):
        step[i, 0] = memory[i] * A[k, i, i]
        for s in range(1, 1 + related[i, 0]):
            o = related[i, s]
            step[i, s] = memory[o] * A[k, o, i] if back else memory[i] * A[k, i, o]
    _combine_rows(related, step, work, now)


@kernel(borrowing=True)
def close(related: Ints, step: Floats, work: Floats, then: int, start: int, turned: Floats) -> None:
    """Turns the matrix B M that `multiply` left into B M B', exactly symmetric; `turned` is work space."""
    size = work.shape[1]
    if size > LANES:
        for i in range(size):
            for j in range(size):
                turned[0, j, i] = work[then, i, start + j]
        _combine_rows(related, step, turned, 0)
    else:  # too few states for vectors
        for i in range(size):
            for j in range(i + 1):
                total = step[j, 0] * work[then, i, start + j]
                for s in range(1, 1 + related[j, 0]):
                    total += step[j, s] * work[then, i, start + related[j, s]]
                turned[1, i, j] = total
    for i in range(size):
        for j in range(i + 1):
            work[then, i, start + j] = work[then, j, start + i] = turned[1, i, j]


@kernel(borrowing=True)
def combine(factors: Floats, k: int, c: int, work: Floats, which: int, lines: Floats) -> None:
    """Puts the sum of ``factors[k, c]`` times the rows of ``work[which]`` into ``lines[0]``."""
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
    """Adds the derivatives of a step's end by the coefficients, ``sources[k]``, to those of the means."""
    for i in range(sources.shape[1]):
        for j in range(sources.shape[2]):
            work[now, i, 1 + j] += sources[k, i, j]


@kernel(borrowing=True)
def _add_force(
    transition: Floats, k: int, d: int, variance: float, motion: int, work: Floats, now: int, start: int
) -> None:
    """Adds a random force of this variance over step k, which acts as discrepancy d does, to the covariance."""
    for i in range(motion):
        for j in range(motion):
            work[now, i, start + j] += variance * transition[k, i, d] * transition[k, j, d]


@kernel(borrowing=True)
def _condition(work: Floats, now: int, lines: Floats, variance: float, start: int) -> None:
    """Conditions the rows on a sample, whose innovation, with its derivatives and covariances, is in ``lines[0]``."""
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


@kernel(borrowing=True)
def _add_pull(pull: Floats, k: int, work: Floats, now: int, start: int, pulled: Floats) -> None:
    """Moves the means to where the log density plus a linear function of the states, ``pull[k]``, is largest."""
    for i in range(work.shape[1]):
        factor = pull[k, i]
        if factor != 0.0:
            pulled[0] += factor * (work[now, i, 0] + 0.5 * factor * work[now, i, start + i])
            for j in range(1, start):
                pulled[j] += factor * work[now, i, j]
            for o in range(work.shape[1]):
                work[now, o, 0] += factor * work[now, o, start + i]


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
    """Filters samples `first` to `stop`, given their `sources`; returns the number of innovations in ``at.scaled``."""
    path, end, transition, gradient, residual, kinds, follows = linear[:7]
    added, memory, steps = noise.channels, noise.memory, noise.steps
    spread, unresolved, terms = linear.spread, linear.unresolved, linear.terms
    force, discrepancy, coupling = linear.force, linear.discrepancy, linear.coupling
    work, step, turned, lines, scaled, variances, pulled = at
    innovation, variance, gain, mean, covariance = out[:5]
    size, start, used = path.shape[1], 1 + len(chosen.chain), 0
    chain, term = chosen
    for k in range(first, stop):
        now = k % 2
        if k > 0:
            multiply(transition, k - 1, memory, False, follows, step, work, 1 - now)
            close(follows, step, work, now, start, turned)
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
                    combine(gradient, k, -1 - kind, work, now, lines)
                    for i in range(size):
                        S += gradient[k, -1 - kind, i] * lines[0, start + i]
                    for j in range(len(chain)):
                        if len(coupling):
                            share = coupling[k, -1 - kind, chain[j]] if -1 - kind < coupling.shape[1] else 0.0
                            lines[0, 1 + j] += share * terms[k, term[j]]
                        elif chain[j] == -1 - kind:
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
        if len(linear.pull) > 0:
            _add_pull(linear.pull, k, work, now, start, pulled)
        if keep:
            _keep_state(k, work, now, mean, covariance)
    return used


def run_filter(linear: Linear, chosen: Candidates, noise: Noise, keep: bool = True) -> Filtered:
    """Filter a record: the data together with the columns of the chosen candidates.

    `keep` stores the rows that `adjoint` needs; without it only the sums are returned, and other arrays are empty.
    """
    (n, size), channels, r = linear.path.shape, len(linear.kinds), len(chosen.chain)
    rows = n if keep else 0
    innovation, variance, gain, mean, covariance = arrays(
        (rows, channels, 1 + r), (rows, channels), (rows, channels, size), (rows, size, 1 + r), (rows, size, size)
    )
    out = Filtered(innovation, variance, gain, mean, covariance, np.zeros((1 + r, 1 + r)), 0.0)
    at, logs = _Running.at_start(linear, chosen, noise), 0.0
    together = rows_together(channels, r)
    ahead = together * max(1, AHEAD // together)
    for first in range(0, n, together):
        stop, of = min(first + together, n), max(first - first % ahead, 1) - 1
        if first % ahead == 0:
            integrated = sources_of(linear, chosen, of, min(first + ahead, n) - 1)
        sources = integrated[max(first, 1) - 1 - of : stop - 1 - of]
        used = _forward(linear, chosen, sources, noise, first, stop, keep, at, out)
        scaled = at.scaled[:used]
        out.product[:] += scaled.T @ scaled
        with np.errstate(invalid="ignore"):  # a variance below 0: the likelihood is then not finite
            logs += float(np.log(2.0 * np.pi * at.variance[:used]).sum())
    # innovations are samples less their prediction
    out.product[0, 1:] *= -1.0
    out.product[1:, 0] *= -1.0
    out.product[0, 1:] += at.pulled[1:]
    out.product[1:, 0] += at.pulled[1:]
    out.product[0, 0] -= 2.0 * at.pulled[0]
    return out._replace(log_variance=logs)
