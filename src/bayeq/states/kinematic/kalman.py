"""Kalman filter of an integrated Wiener process, its likelihood and score, compiled.

State s = (q, q', ..., q^(m-1)) with d^m q/dt^m white; time is counted in regular steps, so that the regular
transition is F_ij = 1/(j-i)!. Channels with independent noises are taken one at a time, so that every gain is a
vector and a missing sample is a gain of zero.

Covariances do not depend on the samples. `filter_gains` therefore first fills a table of gains, one entry per row until
they reach a steady state on a run of regular rows, and one entry for all rows beyond; `filter_means`, `score` and
`smooth` read it. Covariances are kept as square roots P = S S' throughout (orthogonal triangularisation for the steps,
Potter's update for the samples): nothing is subtracted, so that a diffuse start and channels without noise keep their
digits.

Sources: Kailath, Sayed and Hassibi, *Linear Estimation* (2000), ch. 12 (array algorithms); Potter's update in
Bierman, *Factorization Methods* (1977); Koopman and Shephard, Biometrika 79 (1992) (score); de Jong, Biometrika 75
(1988) (leaving one out); Kraemer and Hennig, JMLR 25 (2024) (stable filters of this prior).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.kernels import kernel

# A covariance has settled when a step changes its square root by less, relative to the standard deviations.
SETTLED = 1e-12
# The state starts again after a gap of more than LONG_GAP regular steps if its standard deviation has grown beyond WIDE
# noise levels: no digit of it is left.
WIDE, LONG_GAP = 1e8, 20.0
# Like SETTLED, for the information matrix in the score's backward recursion: a sum over rows needs no more digits.
SETTLED_SCORE = 1e-8


class Tables(NamedTuple):
    """Results of the filter for n rows, c channels and m states; filled by `filter_gains` and `filter_means`."""

    entry: Ints  # (n,), entry of each row in `gains`, `inverse` and `roots`
    anew: Bools  # (n,), whether the state starts from its prior: at the first row, and after a very long gap
    gains: Floats  # (n, c, m), for each entry the gain of each channel, 0 where missing
    inverse: Floats  # (n, c), for each entry the inverse variance of each channel's innovation, 0 where missing
    roots: Floats  # (n or 0, m, m), for each entry a root of the filtered covariance; not filled if its length is 0
    innovations: Floats  # (n, c), each sample less its prediction
    means: Floats  # (n or 0, m), filtered means; not filled if its length is 0


@kernel
def copy_block(A: Floats, B: Floats) -> None:
    """A = B[:m, :m] of a square A (m, m). An assignment of whole arrays takes numba a second to compile."""
    for i in range(len(A)):
        for j in range(len(A)):
            A[i, j] = B[i, j]


@kernel
def taylor(h: float, f: Floats) -> None:
    """f[j] = h^j / j!, the transition over h: F_ij = f[j - i]."""
    f[0] = 1.0
    for j in range(1, len(f)):
        f[j] = f[j - 1] * h / j


@kernel
def advance(x: Floats, f: Floats) -> None:
    """x <- F x."""
    m = len(x)
    for i in range(m - 1):
        total = x[i]
        for j in range(i + 1, m):
            total += f[j - i] * x[j]
        x[i] = total


@kernel
def _retreat(r: Floats, f: Floats) -> None:
    """r <- F' r."""
    for i in range(len(r) - 1, 0, -1):
        total = r[i]
        for j in range(i):
            total += f[i - j] * r[j]
        r[i] = total


@kernel
def triangularise(M: Floats, rows: int, columns: int) -> None:
    """M <- M Theta, Theta orthogonal: lower triangular with a diagonal that is not negative."""
    for i in range(rows):
        head, tail = M[i, i], 0.0
        for j in range(i + 1, columns):
            tail += M[i, j] * M[i, j]
        norm = np.sqrt(head * head + tail)
        first = head - norm if head <= 0.0 else -tail / (head + norm)
        length = first * first + tail
        if length > 0.0:
            for r in range(i + 1, rows):
                dot = M[r, i] * first
                for j in range(i + 1, columns):
                    dot += M[r, j] * M[i, j]
                dot *= 2.0 / length
                M[r, i] -= dot * first
                for j in range(i + 1, columns):
                    M[r, j] -= dot * M[i, j]
        M[i, i] = norm
        for j in range(i + 1, columns):
            M[i, j] = 0.0


@kernel
def outer(S: Floats, P: Floats) -> None:
    """P = S S'."""
    m = len(S)
    for i in range(m):
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += S[i, k] * S[j, k]
            P[i, j] = total
            P[j, i] = total


@kernel
def pre_array(S: Floats, f: Floats, h: float, noise: Floats, M: Floats) -> None:
    """M[:m] = [F S, root of Qd(h)]: its product with its transpose is the predicted covariance, Qd scaled by rows."""
    m = len(f)
    for i in range(m):
        scale = 1.0 if h == 1.0 else h ** (m - i - 0.5)
        for j in range(m):
            M[i, j] = S[i, j]
            M[i, m + j] = scale * noise[i, j]
        for k in range(i + 1, m):
            for j in range(m):
                M[i, j] += f[k - i] * S[k, j]


@kernel
def close(A: Floats, B: Floats, m: int, tolerance: float) -> bool:
    """Whether two triangular roots agree, each row relative to its norm, a standard deviation."""
    for i in range(m):
        norm = 0.0
        for j in range(i + 1):
            norm += A[i, j] * A[i, j]
        bound = tolerance * np.sqrt(norm)
        for j in range(i + 1):
            if not abs(A[i, j] - B[i, j]) <= bound:
                return False
    return True


@kernel
def _measure(S: Floats, k: int, variance: float, gain: Floats) -> float:
    """Potter's update of the root S for a sample of state k; fills the gain, returns the innovation's variance."""
    m = len(gain)
    total = variance
    for j in range(m):
        total += S[k, j] * S[k, j]
    both = total + np.sqrt(variance * total)
    for i in range(m):
        dot = 0.0
        for j in range(m):
            dot += S[i, j] * S[k, j]
        gain[i] = dot / total
    for i in range(m):
        if i != k:
            factor = gain[i] * total / both
            for j in range(m):
                S[i, j] -= factor * S[k, j]
    shrink = np.sqrt(variance / total)
    for j in range(m):
        S[k, j] *= shrink
    return total


@kernel
def _width(S: Floats, k: int) -> float:
    """Standard deviation of state k."""
    total = 0.0
    for j in range(len(S)):
        total += S[k, j] * S[k, j]
    return np.sqrt(total)


@kernel
def filter_gains(
    steps: Floats,
    present: Bools,
    regular_rows: Bools,
    orders: Ints,
    variances: Floats,
    noise: Floats,
    start: Floats,
    tables: Tables,
) -> tuple[int, int, float]:
    """Gains of the filter of a record; the state is zero before the first row.

    `steps`, (n,), are the time steps before each row in regular steps, exactly 1 where regular. There is a sample of
    channel j, derivative orders[j] with noise of variances[j], where `present`, (n, c); `regular_rows`, (n,), have all
    samples after a regular step. `noise` is the lower root of Qd over a regular step, `start` has standard deviations
    of the first state on the diagonal. `tables`, with zeros in gains and inverse, are filled, except innovations and
    means.

    Returns the number of entries filled; the entry of rows in the steady state, -1 if there are none; and the sum of
    the logarithms of the innovations' variances.
    """
    n, c = present.shape
    m = len(start)
    index, anew, gains, inverse, roots = tables.entry, tables.anew, tables.gains, tables.inverse, tables.roots
    S, S_steady, last, M = np.empty((m, m)), np.empty((m, m)), np.empty((m, m)), np.empty((m, 2 * m))
    f = np.empty(m)
    copy_block(S, start)
    widest = max(start[orders[0], orders[0]], WIDE * np.sqrt(variances[0]))
    entries, steady, log_determinant, steady_log = 0, -1, 0.0, 0.0
    settled, run, blank = False, 0, 0.0
    for t in range(n):
        anew[t] = t == 0
        regular = t > 0 and regular_rows[t]
        if regular and settled:
            index[t] = steady
            log_determinant += steady_log
            continue
        if t > 0:
            taylor(steps[t], f)
            pre_array(S, f, steps[t], noise, M)
            triangularise(M, m, 2 * m)
            copy_block(S, M)
            blank += steps[t]
            if blank > LONG_GAP and _width(S, orders[0]) > widest:
                anew[t], regular, blank = True, False, 0.0
                copy_block(S, start)
        run = run + 1 if regular else 0
        settled = run > 1 and close(S, last, m, SETTLED)
        if settled and steady >= 0:
            copy_block(S, S_steady)
            index[t] = steady
            log_determinant += steady_log
            continue
        copy_block(last, S)
        logs = 0.0
        for j in range(c):
            if present[t, j]:
                variance = _measure(S, orders[j], variances[j], gains[entries, j])
                inverse[entries, j] = 1.0 / variance
                logs += np.log(variance)
                blank = 0.0
        log_determinant += logs
        if len(roots):
            copy_block(roots[entries], S)
        if settled:
            steady, steady_log = entries, logs
            copy_block(S_steady, S)
        index[t] = entries
        entries += 1
    return entries, steady, log_determinant


@kernel
def filter_means(samples: Floats, steps: Floats, orders: Ints, tables: Tables) -> float:
    """Fill innovations and means; returns the sum of squared standardised innovations. Missing samples: any number."""
    n, c = samples.shape
    index, anew, gains, inverse, means = tables.entry, tables.anew, tables.gains, tables.inverse, tables.means
    m = gains.shape[2]
    x, f, regular_f = np.empty(m), np.empty(m), np.empty(m)
    taylor(1.0, regular_f)
    squares = 0.0
    for t in range(n):
        if anew[t]:
            for i in range(m):
                x[i] = 0.0
        elif steps[t] == 1.0:
            advance(x, regular_f)
        else:
            taylor(steps[t], f)
            advance(x, f)
        entry = index[t]
        for j in range(c):
            innovation = samples[t, j] - x[orders[j]]
            tables.innovations[t, j] = innovation
            squares += innovation * innovation * inverse[entry, j]
            for i in range(m):
                x[i] += gains[entry, j, i] * innovation
        if len(means):
            for i in range(m):
                means[t, i] = x[i]
    return squares


@kernel
def _information(N: Floats, k: int, gain: Floats, inverse: float, w: Floats) -> float:
    """N <- (I - g e_k')' N (I - g e_k') + e_k e_k'/variance; returns 1/variance + g' N g of the former N."""
    m = len(gain)
    square = 0.0
    for i in range(m):
        dot = 0.0
        for j in range(m):
            dot += N[i, j] * gain[j]
        square += gain[i] * dot
        w[i] = N[i, k] - dot
    corner = w[k] + inverse
    for i in range(m):
        corner -= gain[i] * w[i]
        N[i, k] = w[i]
        N[k, i] = w[i]
    N[k, k] = corner
    return inverse + square


@kernel
def _step_back(N: Floats, f: Floats, scales: Floats, Qd: Floats) -> float:
    """N <- F' N F over a step, kept symmetric for stability; returns tr N Qd of the former N."""
    m = len(f)
    trace = 0.0
    for i in range(m):
        for j in range(m):
            trace += N[i, j] * Qd[i, j] * scales[i] * scales[j]
    for i in range(m):
        _retreat(N[i], f)
    # F'N = (N F)', for N is symmetric
    for i in range(m):
        for j in range(i):
            N[i, j], N[j, i] = N[j, i], N[i, j]
    for i in range(m):
        _retreat(N[i], f)
    for i in range(m):
        for j in range(i):
            N[j, i] = N[i, j]
    return trace


@kernel
def _same_information(A: Floats, B: Floats) -> bool:
    for i in range(len(A)):
        for j in range(i + 1):
            if not abs(A[i, j] - B[i, j]) <= SETTLED_SCORE * np.sqrt(A[i, i] * A[j, j]):
                return False
    return True


@kernel
def score(
    steps: Floats, orders: Ints, tables: Tables, steady: int, noise: Floats, gradient: Floats, errors: Floats
) -> float:
    """Gradient of the log-likelihood with respect to each channel's variance and ln Q, added to zeros (c + 1,).

    With r and N carried backwards from 0 through
    u = v/S - g'r, D = 1/S + g'Ng, r <- r + e_k u, N <- (I - g e_k')'N(I - g e_k') + e_k e_k'/S
    for each sample and r <- F'r, N <- F'NF for each step, the derivatives are sum (u^2 - D)/2 and
    sum (r'Qd r - tr N Qd)/2.

    Returns the leave-one-out log predictive density: given all other samples, a sample errs by u/D with variance 1/D.
    `errors` is filled with these errors and their standard deviations, (n or 0, c, 2), where there is room.
    """
    index, anew, gains = tables.entry, tables.anew, tables.gains
    inverse, innovations = tables.inverse, tables.innovations
    n, c = innovations.shape
    m = len(noise)
    left_out, logs = 0.0, np.zeros(c)
    r, N, last, w = np.zeros(m), np.zeros((m, m)), np.zeros((m, m)), np.empty(m)
    f, regular_f, scales, regular_scales, nothing = np.empty(m), np.empty(m), np.empty(m), np.ones(m), np.zeros((m, m))
    expected, Qd, moments = np.zeros(c + 1), np.empty((m, m)), np.zeros((m, m))
    outer(noise, Qd)
    taylor(1.0, regular_f)
    settled, run = False, 0
    for t in range(n - 1, -1, -1):
        entry = index[t]
        regular = entry == steady and steps[t] == 1.0 and not anew[t]
        run = run + 1 if regular else 0
        if not regular:
            settled = False
        for j in range(c - 1, -1, -1):
            k = orders[j]
            u = innovations[t, j] * inverse[entry, j]
            for i in range(m):
                u -= gains[entry, j, i] * r[i]
            r[k] += u
            if not settled:
                expected[j] = _information(N, k, gains[entry, j], inverse[entry, j], w)
                logs[j] = np.log(expected[j] / (2.0 * np.pi))
            if inverse[entry, j] > 0.0:
                left_out += 0.5 * (logs[j] - u * u / expected[j])
                if len(errors):
                    errors[t, j, 0] = u / expected[j]
                    errors[t, j, 1] = 1.0 / np.sqrt(expected[j])
            gradient[j] += 0.5 * (u * u - expected[j])
        if anew[t]:
            for i in range(m):
                r[i] = 0.0
            copy_block(N, nothing)
            continue
        h = steps[t]
        s, g = regular_scales, regular_f
        if h != 1.0:
            s, g = scales, f
            taylor(h, f)
            for i in range(m):
                scales[i] = h ** (m - i - 0.5)
        for i in range(m):
            for j in range(i + 1):
                moments[i, j] += (s[i] * r[i]) * (s[j] * r[j])
        _retreat(r, g)
        if not settled:
            expected[c] = _step_back(N, g, s, Qd)
            settled = run > 1 and _same_information(N, last)
            copy_block(last, N)
        gradient[c] -= 0.5 * expected[c]
    for i in range(m):
        for j in range(m):
            gradient[c] += 0.5 * Qd[i, j] * moments[max(i, j), min(i, j)]
    return left_out


@kernel
def _backward_gain(S: Floats, f: Floats, h: float, noise: Floats, M: Floats, J: Floats, rest: Floats) -> None:
    """Gain J = B A^-1 of the smoother and a root of the covariance given the state at the next row, `rest`.

    [[F S, root of Qd], [S, 0]] is triangularised to [[A, 0], [B, rest]].
    """
    m = len(f)
    pre_array(S, f, h, noise, M)
    for i in range(m):
        for j in range(m):
            M[m + i, j] = S[i, j]
            M[m + i, m + j] = 0.0
    triangularise(M, 2 * m, 2 * m)
    for i in range(m):
        for j in range(m - 1, -1, -1):
            total = M[m + i, j]
            for k in range(j + 1, m):
                total -= J[i, k] * M[k, j]
            J[i, j] = total / M[j, j]
            rest[i, j] = M[m + i, m + j]


@kernel
def smooth(steps: Floats, tables: Tables, steady: int, noise: Floats, covariances: Floats, rows: Ints) -> int:
    """Rauch-Tung-Striebel smoother: the filtered means in `tables` become smoothed ones.

    Returns the number of `covariances` filled, one per row until they settle; `rows` receives each row's index in them.
    """
    index, anew, roots, means = tables.entry, tables.anew, tables.roots, tables.means
    n, m = means.shape
    M, S, last = np.empty((2 * m, 2 * m)), np.empty((m, m)), np.empty((m, m))
    J, rest = np.empty((m, m)), np.empty((m, m))
    steady_J, steady_rest = np.empty((m, m)), np.empty((m, m))
    f, regular_f, x, d = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    taylor(1.0, regular_f)
    copy_block(S, roots[index[n - 1]])
    outer(S, covariances[0])
    rows[n - 1] = 0
    entries = 1
    settled, run, known = False, 0, False
    for t in range(n - 2, -1, -1):
        if anew[t + 1]:
            copy_block(S, roots[index[t]])
            outer(S, covariances[entries])
            rows[t] = entries
            entries += 1
            settled, run = False, 0
            continue
        h = steps[t + 1]
        regular = index[t] == steady and h == 1.0
        run = run + 1 if regular else 0
        if regular and not known:
            _backward_gain(roots[steady], regular_f, 1.0, noise, M, steady_J, steady_rest)
            known = True
        gain, remainder, g = steady_J, steady_rest, regular_f
        if not regular:
            settled = False
            gain, remainder = J, rest
            if h != 1.0:
                g = f
                taylor(h, f)
            _backward_gain(roots[index[t]], g, h, noise, M, J, rest)
        for i in range(m):
            x[i] = means[t, i]
        advance(x, g)
        for i in range(m):
            d[i] = means[t + 1, i] - x[i]
        for i in range(m):
            total = means[t, i]
            for j in range(m):
                total += gain[i, j] * d[j]
            means[t, i] = total
        if settled:
            rows[t] = entries - 1
            continue
        copy_block(last, S)
        for i in range(m):
            for j in range(m):
                total = 0.0
                for k in range(m):
                    total += gain[i, k] * last[k, j]
                M[i, j] = total
                M[i, m + j] = remainder[i, j]
        triangularise(M, m, 2 * m)
        copy_block(S, M)
        settled = run > 1 and close(S, last, m, SETTLED)
        outer(S, covariances[entries])
        rows[t] = entries
        entries += 1
    return entries
