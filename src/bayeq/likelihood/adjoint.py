"""The adjoint of the Kalman filter: derivatives of the log likelihood with respect to all variances; smoothed path.

The recursion is that of Koopman and Shephard (1992). It is stored in the rows of one array as the filter is: adjoints
of the data and of the coefficients, then their information N.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats, Ints
from bayeq.kernels import kernel
from bayeq.likelihood.filter import Filtered, Noise, aligned, close, combine, multiply, padded, rows_together
from bayeq.likelihood.linear import Linear

# Eigenvalues of a matrix below this share of the largest are rounding errors.
SINGULAR = 1e-15


class Adjoint(NamedTuple):
    """Derivatives of the log likelihood, and the smoothed path."""

    channels: Floats  # (M,), by the variances R
    courses: Floats  # (L,), by the variances `Noise.courses`
    # (S,) each, by the entries of `Noise`. The one by the memory is for states that are constant between samples; by
    # memory and steps it is 0 for states with memory 1 and no steps.
    memory: Floats
    steps: Floats
    start: Floats
    deviation: Floats  # (n, S), smoothed path less that of the linearisation
    covariance: Floats  # (n, S, S), of the smoothed path, given the coefficients; empty where not asked for
    # (n, C, S) and (n - 1, C, S), directions at samples and between: the candidates' derivatives along them sum to the
    # derivative of the likelihood's log determinant by each coefficient on a fixed path; empty where not asked for
    at_samples: Floats
    between: Floats


class _Returning(NamedTuple):
    """State and work space of the adjoint recursion; coefficients are scaled by the root of their covariance."""

    # (2, S, W), as in `_Running`: adjoints of the data, at the coefficients' mean, and of each coefficient; their
    # information N
    work: Floats
    step: Floats  # (S, S), as in `_Running`
    turned: Floats  # (2, S, padded S), likewise
    lines: Floats  # (4, W), work space of a sample
    innovation: Floats  # (rows, M, 1 + r), at the coefficients' mean, and its derivatives
    lasting: Ints  # (s,), states with a memory other than 1 or with random steps at samples
    mean: Floats  # (rows, s, r), derivatives of their filtered means by the coefficients

    @classmethod
    def at_end(cls, noise: Noise, r: int, scored: bool) -> _Returning:
        """The recursion after the last sample; `scored` if derivatives by the noise are wanted."""
        size, channels = len(noise.memory), len(noise.channels)
        lasting = np.flatnonzero(scored & ((noise.memory != 1.0) | (noise.steps > 0.0)))
        work, rows = aligned(2, size, padded(1 + r + size)), rows_together(channels, r)
        step, turned, lines = np.empty((size, size)), aligned(2, size, padded(size)), aligned(4, work.shape[2])
        innovation, mean = np.empty((rows, channels, 1 + r)), np.empty((rows, len(lasting), r))
        return cls(work, step, turned, lines, innovation, lasting, mean)

    def take(self, found: Filtered, rows: slice, delta: Floats, root: Floats) -> None:
        """Loads rows of a filtered record, with coefficients moved by `delta` and their covariance `root` `root`'."""
        (r, columns), count = root.shape, rows.stop - rows.start
        # derivatives by the coefficients enter with the other sign: e = E_0 - E theta
        units = np.zeros((1 + r, 1 + columns))
        units[0, 0], units[1:, 0], units[1:, 1:] = 1.0, -delta, root
        out = self.innovation[:count].reshape(-1, 1 + columns)
        np.matmul(found.innovation[rows].reshape(-1, 1 + r), units, out=out)
        if self.mean.size:
            mean = found.mean[rows][:, self.lasting, 1:]
            np.matmul(mean.reshape(-1, r), root, out=self.mean[:count].reshape(-1, columns))


@kernel(borrowing=True)
def _excess(work: Floats, then: int, i: int, start: int) -> float:
    """Sum of the squared adjoints of state i less its diagonal entry of N."""
    total = -work[then, i, start + i]
    for j in range(start):
        total += work[then, i, j] ** 2
    return total


@kernel(borrowing=True)
def _excess_of_force(
    transition: Floats, k: int, d: int, motion: int, work: Floats, then: int, lines: Floats, start: int
) -> float:
    """`_excess` for a force over step k that acts as discrepancy d does, instead of for a state."""
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
    """Replaces gain'r and gain'N in ``lines[0]`` by E/S - gain'r and -gain'N; returns 1/S + gain'N gain."""
    share = spread = 1.0 / S
    for j in range(start):
        lines[0, j] = share * innovation[row, channel, j] - lines[0, j]
    for i in range(gain.shape[2]):
        spread += gain[k, channel, i] * lines[0, start + i]
        lines[0, start + i] *= -1.0
    return spread


@kernel(borrowing=True)
def _absorb_state(kind: int, spread: float, work: Floats, now: int, lines: Floats, start: int) -> None:
    """Adds a sample of state `kind` to the adjoints, r + h (E/S - gain'r) with h a unit vector, and to N likewise."""
    for i in range(work.shape[1]):
        work[now, i, start + kind] += lines[0, start + i]
    lines[0, start + kind] += spread
    for j in range(work.shape[2]):
        work[now, kind, j] += lines[0, j]


@kernel(borrowing=True)
def _absorb_target(
    gradient: Floats, k: int, c: int, spread: float, work: Floats, now: int, lines: Floats, start: int
) -> None:
    """Adds a sample of target c to the adjoints and N, as `_absorb_state` does; h is the gradient of the target."""
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
def _add_product(factor: float, A: Floats, k: int, lines: Floats, source: int, target: int) -> None:
    """Adds `factor` times ``A[k]`` times line `source` to line `target`."""
    for i in range(A.shape[1]):
        for o in range(A.shape[1]):
            lines[target, i] += factor * A[k, i, o] * lines[source, o]


@kernel(borrowing=True)
def _by_information(work: Floats, now: int, start: int, lines: Floats) -> None:
    """Puts N times ``lines[1]`` into ``lines[2]``."""
    for i in range(work.shape[1]):
        lines[2, i] = 0.0
        for o in range(work.shape[1]):
            lines[2, i] += work[now, i, start + o] * lines[1, o]


@kernel(borrowing=True)
def _curve_between(
    A: Floats, P: Floats, k: int, work: Floats, now: int, start: int, discrete: bool, lines: Floats
) -> None:
    """Puts (I + A) P N w, for maps 2 P N w, into ``lines[2]``, given w in ``lines[1]``: -2 times `Adjoint.between`."""
    size = work.shape[1]
    _by_information(work, now, start, lines)
    for i in range(size):
        lines[1, i] = 0.0
    _add_product(1.0, P, k, lines, 2, 1)
    for i in range(size):
        lines[2, i] = 2.0 * lines[1, i] if discrete else lines[1, i]
    if not discrete:
        _add_product(1.0, A, k, lines, 1, 2)


@kernel(borrowing=True)
def _curve_at(P: Floats, k: int, work: Floats, now: int, start: int, lines: Floats) -> None:
    """Puts (P - P N P) h into ``lines[1]``, given h in ``lines[2]``: -R times `Adjoint.at_samples`, R the noise."""
    for i in range(work.shape[1]):
        lines[1, i] = 0.0
    _add_product(1.0, P, k, lines, 2, 1)
    _by_information(work, now, start, lines)
    _add_product(-1.0, P, k, lines, 2, 1)


@kernel(borrowing=True)
def _smooth(covariance: Floats, k: int, work: Floats, now: int, lines: Floats, start: int, smoothed: Floats) -> None:
    """Puts P - P N P, the covariance of the states given all samples, into ``smoothed[k]``."""
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
    """Runs the recursion backwards over the samples from `stop` - 1 to `first`."""
    path, transition, gradient = linear.path, linear.transition, linear.gradient
    kinds, leads, forces = linear.kinds, linear.leads, linear.discrepancy
    memory, added = noise.memory, noise.channels
    variance, gain, covariance = found.variance, found.gain, found.covariance
    work, step, turned, lines, innovation, lasting, mean = at
    motion = linear.steps.motion
    by_channels, by_courses, by_memory, by_steps, _, deviation, smoothed, at_samples, between = out
    (n, size), start = path.shape, innovation.shape[2]
    for k in range(stop - 1, first - 1, -1):
        now = k % 2
        then = 1 - now
        if k < n - 1:
            multiply(transition, k, memory, True, leads, step, work, then)
            for i in range(size):
                total = deviation[k, i]
                for o in range(size):
                    total += covariance[k, i, o] * work[now, o, 0]
                deviation[k, i] = total
            for s in range(len(lasting)):
                i = lasting[s]
                by_steps[i] += 0.5 * _excess(work, then, i, start)
                combine(covariance, k, i, work, now, lines)
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
                    _curve_between(transition, covariance, k, work, now, start, linear.steps.discrete, lines)
                    for i in range(size):
                        between[k, c, i] = -0.5 * lines[2, i]
            close(leads, step, work, now, start, turned)
        if len(smoothed) > 0:
            _smooth(covariance, k, work, now, lines, start, smoothed)
        if len(at_samples) > 0:
            for channel in range(len(kinds)):
                c = -1 - kinds[channel]
                if 0 <= c < len(forces) and variance[k, channel] > 0.0:
                    for i in range(size):
                        lines[2, i] = gradient[k, c, i]
                    _curve_at(covariance, k, work, now, start, lines)
                    own = added[channel] * linear.spread[k, channel] + linear.unresolved[k, channel]
                    for i in range(size):
                        at_samples[k, c, i] = -lines[1, i] / own
        for channel in range(len(kinds) - 1, -1, -1):
            S, kind = variance[k, channel], kinds[channel]
            if S > 0.0:
                combine(gain, k, channel, work, now, lines)
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
    """The adjoint recursion of a record that `run_filter` filtered with `keep`.

    Coefficients deviate by `delta`, (r,), and are integrated out with covariance V, (r, r); without V derivatives by
    the noise are 0. `curved` asks for `at_samples` and `between`, `smoothed` for `covariance`.
    """
    (n, size), r = linear.path.shape, len(delta)
    chains, root = len(linear.discrepancy), np.zeros((r, 0)) if V is None else root_of(V)
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
    together = rows_together(len(linear.kinds), root.shape[1])
    for first in reversed(range(0, n, together)):
        rows = slice(first, min(first + together, n))
        at.take(found, rows, delta, root)
        np.matmul(found.mean[rows].reshape(-1, 1 + r), np.append(1.0, delta), out=out.deviation[rows].reshape(-1))
        _backward(linear, noise, found, first, rows.stop, at, out)
    if V is None:
        out.channels[:], out.courses[:] = 0.0, 0.0
        return out
    adjoints, width = at.work[0], 1 + root.shape[1]
    out.start[:] = 0.5 * ((adjoints[:, :width] ** 2).sum(axis=1) - np.diagonal(adjoints[:, width : width + size]))
    return out


def root_of(A: Floats) -> Floats:
    """Square root F, (p, r), of a positive semidefinite matrix A = F F'."""
    scale = np.sqrt(np.maximum(np.diagonal(A), np.finfo(np.float64).tiny))
    squares, axes = np.linalg.eigh(A / scale[:, None] / scale)
    kept = squares > SINGULAR * squares.max(initial=0.0)
    return np.asarray(scale[:, None] * axes[:, kept] * np.sqrt(squares[kept]))
