"""The collapsed tableau: model moves at the price of one rank-one update.

With theta and sigma^2 integrated out (eq. (34)) a model z has the log posterior

    sum_{z_i=1} logit(p_0) - r/2 ln v_s - 1/2 ln|A| - h ln(s/2) + const,
    A = D_r'D_r + I/v_s,   s = 2 b_sigma + y'y - y'D_r A^-1 D_r'y,   h = a_sigma + N/2.

The tableau M is the symmetric matrix [[D'D + I/v_s, D'y], [y'D, y'y + 2 b_sigma]] swept (Beaton 1964) on the
active terms. Its entries are then all that a move needs:

    active i, j     M_ij = -(A^-1)_ij          M_iy = posterior mean of theta_i
    inactive j      M_jj = Schur complement    M_jy = partial covariance with y
    y               M_yy = s

so the log-odds of any flip or swap are O(1), and a flip is one rank-one update of M.
"""

from __future__ import annotations

import math

import numpy as np

from bayeq.kernels import kernel

__all__ = ["build", "climb", "flip", "flip_gain", "score", "swap_gain"]

# A climb stops when no move gains this much log posterior: above the rounding of h ln(s).
GAIN_TOLERANCE = 1e-8


@kernel
def build(DtD, Dty, yty, ridge, noise_rate):  # type: ignore[no-untyped-def]
    """Unswept tableau, (P+1, P+1), of the empty model; `ridge` is 1/v_s."""
    p = DtD.shape[0]
    M = np.empty((p + 1, p + 1))
    M[:p, :p] = DtD
    M[:p, p] = Dty
    M[p, :p] = Dty
    for j in range(p):
        M[j, j] += ridge
    M[p, p] = yty + 2.0 * noise_rate
    return M


@kernel
def flip(M, j):  # type: ignore[no-untyped-def]
    """Sweep M in place on term j, in or out; returns ln|pivot|, by which ln|A| changes."""
    q = M.shape[0]
    pivot = M[j, j]
    size = abs(pivot)
    for i in range(q):
        if i != j:
            factor = M[i, j] / pivot
            if factor != 0.0:
                for k in range(q):
                    M[i, k] -= factor * M[j, k]
                # column j is set below from row j, which stays as it was
                M[i, j] += factor * pivot
    for i in range(q):
        value = M[j, i] / size
        M[j, i] = value
        M[i, j] = value
    M[j, j] = -1.0 / pivot
    return math.log(size)


@kernel
def flip_gain(M, active, j, log_odds, half_log_slab, h, floor):  # type: ignore[no-untyped-def]
    """Change of the log posterior when term j is flipped."""
    y = M.shape[0] - 1
    pivot = M[j, j]
    s = max(M[y, y], floor)
    after = max(s - M[j, y] * M[j, y] / pivot, floor)
    data = -0.5 * math.log(abs(pivot)) - h * math.log(after / s)
    if active[j]:
        return data - log_odds[j] + half_log_slab
    return data + log_odds[j] - half_log_slab


@kernel
def swap_gain(M, i, j, log_odds, h, floor):  # type: ignore[no-untyped-def]
    """Change of the log posterior when active term i leaves and inactive term j enters."""
    y = M.shape[0] - 1
    out = M[i, i]
    link = M[i, j] / out
    pivot = M[j, j] - link * M[i, j]
    partial = M[j, y] - link * M[i, y]
    s = max(M[y, y], floor)
    after = max(s - M[i, y] * M[i, y] / out - partial * partial / pivot, floor)
    data = -0.5 * (math.log(abs(out)) + math.log(abs(pivot))) - h * math.log(after / s)
    return data + log_odds[j] - log_odds[i]


@kernel
def climb(M, active, log_odds, half_log_slab, h, floor):  # type: ignore[no-untyped-def]
    """Steepest ascent from the model in `active` by flips, and by swaps where no flip improves.

    M and `active` are changed in place; returns the log posterior gained. Forced terms (log-odds +inf) come
    in first and stay, forbidden ones (-inf) leave first and never return.
    """
    p = M.shape[0] - 1
    gained = 0.0
    for _ in range(20 * p + 20):
        best, best_i, best_j = GAIN_TOLERANCE, -1, -1
        for j in range(p):
            gain = flip_gain(M, active, j, log_odds, half_log_slab, h, floor)
            if gain > best:
                best, best_j = gain, j
        if best_j < 0:
            for i in range(p):
                if active[i] and log_odds[i] < math.inf:
                    for j in range(p):
                        if not active[j] and log_odds[j] > -math.inf:
                            gain = swap_gain(M, i, j, log_odds, h, floor)
                            if gain > best:
                                best, best_i, best_j = gain, i, j
        if best_j < 0:
            break
        if best_i >= 0:
            flip(M, best_i)
            active[best_i] = False
        flip(M, best_j)
        active[best_j] = not active[best_j]
        gained += best
    return gained


@kernel
def score(DtD, Dty, yty, active, log_odds, slab_variance, noise_rate, h, floor):  # type: ignore[no-untyped-def]
    """Log posterior of one model up to the constant of `inference.search.log_constant`, from scratch.

    Cholesky of A, so that it carries none of a tableau's drift.
    """
    index = np.flatnonzero(active)
    r = len(index)
    L = np.empty((r, r))
    half = np.empty(r)
    total = 0.0
    s = yty + 2.0 * noise_rate
    for a in range(r):
        if log_odds[index[a]] < math.inf:
            total += log_odds[index[a]]
        for b in range(a + 1):
            value = DtD[index[a], index[b]]
            if a == b:
                value += 1.0 / slab_variance
            for k in range(b):
                value -= L[a, k] * L[b, k]
            if a == b:
                L[a, a] = math.sqrt(max(value, 1e-300))
            else:
                L[a, b] = value / L[b, b]
        value = Dty[index[a]]
        for k in range(a):
            value -= L[a, k] * half[k]
        half[a] = value / L[a, a]
        s -= half[a] * half[a]
        total -= 0.5 * math.log(slab_variance) + math.log(L[a, a])
    return total - h * math.log(0.5 * max(s, floor))
