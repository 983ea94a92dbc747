"""The filter of a linearised record and its adjoint: likelihood, information on coefficients, scores, and the path.

The data and the columns of the candidates go through one Kalman filter with the same gains (Rosenberg 1973; de Jong
1991): the innovations E of the columns and their variance S give the information sum E'E/S of the coefficients. The
adjoint recursion gives the derivatives of the likelihood by all variances (Koopman and Shephard 1992).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.kernels import kernel
from bayeq.likelihood.layout import Candidates
from bayeq.likelihood.linear import Linear

__all__ = ["Adjoint", "Filtered", "Noise", "adjoint", "run_filter"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    """

    channels: Floats
    memory: Floats
    steps: Floats
    mean: Floats
    start: Floats


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
    """

    innovation: Floats
    variance: Floats
    gain: Floats
    mean: Floats
    covariance: Floats


@kernel
def _predict(linear: Linear, chosen: Candidates, noise: Noise, k: int, m: Floats, P: Floats, work: Floats) -> None:
    """From sample k to the next: means `m` (S, 1 + r) and covariance `P` in place."""
    size, columns = m.shape
    step, weights = linear.transition[k], linear.weights[k]
    for j in range(columns):
        for i in range(size):
            total = 0.0
            for l in range(size):
                total += step[i, l] * m[l, j]
            work[i, j] = total
    for i in range(size):
        memory = noise.memory[i]
        m[i, 0] = memory * (work[i, 0] + linear.end[k, i]) - linear.path[k + 1, i]
        for j in range(1, columns):
            c, t = chosen.chain[j - 1], chosen.term[j - 1]
            source = (
                weights[0, c, i] * linear.terms[k, t]
                + weights[1, c, i] * linear.middle[k, t]
                + weights[2, c, i] * linear.terms[k + 1, t]
            )
            m[i, j] = memory * (work[i, j] + source)
    for i in range(size):
        for j in range(size):
            total = 0.0
            for l in range(size):
                total += step[i, l] * P[l, j]
            work[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for l in range(size):
                total += work[i, l] * step[j, l]
            total *= noise.memory[i] * noise.memory[j]
            P[i, j] = P[j, i] = total
        P[i, i] += noise.steps[i]


@kernel
def _forward(linear: Linear, chosen: Candidates, noise: Noise, out: Filtered) -> None:
    n, size = linear.path.shape
    r, channels = len(chosen.chain), len(linear.kinds)
    m, P = np.zeros((size, 1 + r)), np.zeros((size, size))
    work = np.empty((size, max(1 + r, size)))
    ph, h = np.empty(size), np.zeros(size)
    for i in range(size):
        m[i, 0] = noise.mean[i] - linear.path[0, i]
        P[i, i] = noise.start[i]
    for k in range(n):
        if k > 0:
            _predict(linear, chosen, noise, k - 1, m, P, work)
        for channel in range(channels):
            kind = linear.kinds[channel]
            left = linear.residual[k, channel]
            if np.isnan(left):
                out.variance[k, channel] = 0.0
                continue
            variance = noise.channels[channel]
            E = out.innovation[k, channel]
            if kind >= 0:
                for i in range(size):
                    ph[i] = P[i, kind]
                variance += ph[kind]
                for j in range(1 + r):
                    E[j] = m[kind, j]
            else:
                c = -1 - kind
                for i in range(size):
                    h[i] = linear.gradient[k, c, i]
                for i in range(size):
                    total = 0.0
                    for l in range(size):
                        total += P[i, l] * h[l]
                    ph[i] = total
                for i in range(size):
                    variance += h[i] * ph[i]
                for j in range(1 + r):
                    total = 0.0
                    for l in range(size):
                        total += h[l] * m[l, j]
                    if j > 0 and chosen.chain[j - 1] == c:
                        total += linear.terms[k, chosen.term[j - 1]]
                    E[j] = total
            E[0] = left - E[0]
            out.variance[k, channel] = variance
            for i in range(size):
                gain = ph[i] / variance
                out.gain[k, channel, i] = gain
                m[i, 0] += gain * E[0]
                for j in range(1, 1 + r):
                    m[i, j] -= gain * E[j]
            for i in range(size):
                for j in range(i + 1):
                    P[i, j] -= ph[i] * ph[j] / variance
                    P[j, i] = P[i, j]
        for i in range(size):
            for j in range(1 + r):
                out.mean[k, i, j] = m[i, j]
            for j in range(size):
                out.covariance[k, i, j] = P[i, j]


def run_filter(linear: Linear, chosen: Candidates, noise: Noise) -> Filtered:
    """Filter a record with the columns of the chosen candidates beside the data."""
    (n, size), channels, r = linear.path.shape, len(linear.kinds), len(chosen.chain)
    out = Filtered(
        innovation=np.zeros((n, channels, 1 + r)),
        variance=np.zeros((n, channels)),
        gain=np.zeros((n, channels, size)),
        mean=np.empty((n, size, 1 + r)),
        covariance=np.empty((n, size, size)),
    )
    _forward(linear, chosen, noise, out)
    return out


class Adjoint(NamedTuple):
    """Derivatives of the log likelihood, and the smoothed path.

    Attributes
    ----------
    channels : (M,) array
        By the variances R.
    memory, steps, start : (S,) arrays
        By the entries of `Noise`.
    deviation : (n, S) array
        Smoothed path less that of the linearisation.
    curved : (n, C, S) and (n - 1, C, S) arrays
        Directions along which the derivatives of the candidates at the samples, and between them, give what the
        coefficients change in the determinant of the likelihood; empty where not asked for.
    """

    channels: Floats
    memory: Floats
    steps: Floats
    start: Floats
    deviation: Floats
    at_samples: Floats
    between: Floats


@kernel
def _sandwich(G: Floats, N: Floats, work: Floats) -> None:
    """N := G' N G."""
    size = len(G)
    for i in range(size):
        for j in range(size):
            total = 0.0
            for l in range(size):
                total += N[i, l] * G[l, j]
            work[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            total = 0.0
            for l in range(size):
                total += G[l, i] * work[l, j]
            N[i, j] = N[j, i] = total


# One recursion whose state (adjoint, information, work space) each part of it would have to take.
@kernel
def _backward(
    linear: Linear, noise: Noise, found: Filtered, delta: Floats, V: Floats, last: Ints, out: Adjoint
) -> None:
    n, size = linear.path.shape
    channels, r = len(linear.kinds), len(delta)
    adj, N, G = np.zeros((size, 1 + r)), np.zeros((size, size)), np.empty((size, size))
    work, moved = np.empty((size, size)), np.empty((size, 1 + r))
    nk, h, value, u = np.empty(size), np.zeros(size), np.empty((size, 1 + r)), np.empty(1 + r)
    curved = len(out.at_samples) > 0
    for k in range(n - 1, -1, -1):
        P = found.covariance[k]
        if k < n - 1:
            for i in range(size):
                for j in range(size):
                    G[i, j] = noise.memory[i] * linear.transition[k, i, j]
            for j in range(1 + r):
                for i in range(size):
                    total = 0.0
                    for l in range(size):
                        total += G[l, i] * adj[l, j]
                    moved[i, j] = total
            for i in range(size):
                out.steps[i] += 0.5 * _moment(adj[i], adj[i], V, -N[i, i])
        else:
            moved[:] = 0.0
        for i in range(size):
            for j in range(1 + r):
                total = 0.0
                for l in range(size):
                    total += P[i, l] * moved[l, j]
                # derivatives by the coefficients enter with the other sign: e = E_0 - E theta
                value[i, j] = found.mean[k, i, j] + total if j == 0 else total - found.mean[k, i, j]
            for j in range(r):
                value[i, 0] += found.mean[k, i, 1 + j] * delta[j]
            out.deviation[k, i] = value[i, 0]
        if k < n - 1:
            for i in range(size):
                if noise.memory[i] != 1.0 or noise.steps[i] > 0.0:
                    value[i, 0] += linear.path[k, i]
                    total = 0.0  # (P G' N)_ii
                    for l in range(size):
                        part = 0.0
                        for o in range(size):
                            part += P[i, o] * G[l, o]
                        total += part * N[l, i]
                    out.memory[i] += _moment(adj[i], value[i], V, -total)
            if curved:
                _curve_between(linear, noise, P, G, N, k, last, out)
            _sandwich(G, N, work)
            for i in range(size):
                for j in range(1 + r):
                    adj[i, j] = moved[i, j]
        if curved:
            _curve_at(linear, noise, P, N, k, out)
        for channel in range(channels - 1, -1, -1):
            if found.variance[k, channel] == 0.0:
                continue
            gain, S, kind = found.gain[k, channel], found.variance[k, channel], linear.kinds[channel]
            for i in range(size):
                h[i] = (1.0 if i == kind else 0.0) if kind >= 0 else linear.gradient[k, -1 - kind, i]
            spread = 1.0 / S
            for i in range(size):
                total = 0.0
                for l in range(size):
                    total += N[i, l] * gain[l]
                nk[i] = total
            for i in range(size):
                spread += gain[i] * nk[i]
            E = found.innovation[k, channel]
            for j in range(1 + r):
                total = E[j]
                if j == 0:
                    for l in range(r):
                        total -= E[1 + l] * delta[l]
                total /= S
                for i in range(size):
                    total -= gain[i] * adj[i, j]
                u[j] = total
            out.channels[channel] += 0.5 * _moment(u, u, V, -spread)
            for i in range(size):
                for j in range(1 + r):
                    adj[i, j] += h[i] * u[j]
                for j in range(size):
                    N[i, j] += h[i] * h[j] * spread - nk[i] * h[j] - h[i] * nk[j]
    for i in range(size):
        out.start[i] += 0.5 * _moment(adj[i], adj[i], V, -N[i, i])


@kernel
def _moment(a: Floats, b: Floats, V: Floats, rest: float) -> float:
    """a_0 b_0 + rest, and what the uncertainty V of the coefficients adds to the product."""
    total = a[0] * b[0] + rest
    for i in range(len(V)):
        part = 0.0
        for j in range(len(V)):
            part += V[i, j] * b[1 + j]
        total += a[1 + i] * part
    return total


@kernel
def _curve_between(
    linear: Linear, noise: Noise, P: Floats, G: Floats, N: Floats, k: int, last: Ints, out: Adjoint
) -> None:
    """-(1 + Phi)/2 P G' N A w: what the determinant makes of a gradient in the middle of a step."""
    size = len(P)
    first, second = np.empty(size), np.empty(size)
    for c in range(len(last)):
        for i in range(size):
            total = 0.0
            for l in range(size):
                w = linear.weights[k, 0, c, l] + linear.weights[k, 1, c, l] + linear.weights[k, 2, c, l]
                total += N[i, l] * noise.memory[l] * w
            first[i] = total
        for i in range(size):
            total = 0.0
            for l in range(size):
                total += G[l, i] * first[l]
            second[i] = total
        for i in range(size):
            total = 0.0
            for l in range(size):
                total += P[i, l] * second[l]
            first[i] = total
        for i in range(size):
            total = first[i]
            for l in range(size):
                total += linear.transition[k, i, l] * first[l]
            out.between[k, c, i] = -0.5 * total


@kernel
def _curve_at(linear: Linear, noise: Noise, P: Floats, N: Floats, k: int, out: Adjoint) -> None:
    """-(P - P N P) h / R: the same of a target that is measured."""
    size = len(P)
    ph, nph = np.empty(size), np.empty(size)
    for channel in range(len(linear.kinds)):
        kind = linear.kinds[channel]
        if kind >= 0 or np.isnan(linear.residual[k, channel]):
            continue
        h = linear.gradient[k, -1 - kind]
        for i in range(size):
            total = 0.0
            for l in range(size):
                total += P[i, l] * h[l]
            ph[i] = total
        for i in range(size):
            total = 0.0
            for l in range(size):
                total += N[i, l] * ph[l]
            nph[i] = total
        for i in range(size):
            total = ph[i]
            for l in range(size):
                total -= P[i, l] * nph[l]
            out.at_samples[k, -1 - kind, i] = -total / noise.channels[channel]


def adjoint(
    linear: Linear, noise: Noise, found: Filtered, delta: Floats, V: Floats, last: Ints, curved: bool = False
) -> Adjoint:
    """The adjoint recursion of a filtered record.

    Parameters
    ----------
    linear, noise, found
        What was filtered.
    delta, V : (r,) and (r, r) arrays
        Mean and covariance of the coefficients' deviations: derivatives are those of the likelihood marginal over them.
    last : (C,) int array
        `Layout.last`.
    curved : bool
        Whether `at_samples` and `between` are wanted.
    """
    n, size = linear.path.shape
    chains = linear.gradient.shape[1]
    out = Adjoint(
        channels=np.zeros(len(linear.kinds)),
        memory=np.zeros(size),
        steps=np.zeros(size),
        start=np.zeros(size),
        deviation=np.empty((n, size)),
        at_samples=np.zeros((n if curved else 0, chains, size)),
        between=np.zeros((n - 1 if curved else 0, chains, size)),
    )
    _backward(linear, noise, found, delta, V, last, out)
    return out
