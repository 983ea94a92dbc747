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

from bayeq.inference.problem import Bools, Floats, Problem
from bayeq.kernels import kernel

__all__ = ["build", "climb", "flip", "flip_gain", "least_squares_rss", "score", "swap_gain", "swept"]

# A climb stops when no move gains this much log posterior: above the rounding of h ln(s).
GAIN_TOLERANCE = 1e-8

# A column whose variance left by earlier ones is a smaller share of its own depends on them.
DEPENDENT = 1e-13


@kernel
def build(DtD: Floats, Dty: Floats, yty: float, ridge: float) -> Floats:
    """Unswept tableau, (P+1, P+1), of the empty model; `ridge` is 1/v_s, `yty` holds 2 b_sigma already."""
    p = len(Dty)
    M = np.empty((p + 1, p + 1))
    M[:p, :p] = DtD
    M[:p, p] = Dty
    M[p, :p] = Dty
    for j in range(p):
        M[j, j] += ridge
    M[p, p] = yty
    return M


@kernel
def flip(M: Floats, j: int) -> float:
    """Sweep M in place on term j, in or out; returns ln|pivot|, by which ln|A| changes."""
    q = M.shape[0]
    pivot = M[j, j]
    size = abs(pivot)
    # Both factors of the rank-one update are row j: taken from row and column they would let the rounding
    # asymmetry of M grow from flip to flip.
    for i in range(q):
        if i != j:
            factor = M[j, i] / pivot
            if factor != 0.0:
                for k in range(q):
                    M[i, k] -= factor * M[j, k]
    for i in range(q):
        value = M[j, i] / size
        M[j, i] = value
        M[i, j] = value
    M[j, j] = -1.0 / pivot
    return math.log(size)


@kernel
def swept(p: Problem, active: Bools) -> Floats:
    """The tableau of a model, from scratch."""
    M = build(p.DtD, p.Dty, p.yty + 2.0 * p.noise_rate, 1.0 / p.slab_variance)
    for j in range(len(active)):
        if active[j]:
            flip(M, j)
    return M


@kernel
def flip_gain(p: Problem, M: Floats, active: Bools, j: int) -> float:
    """Change of the log posterior when term j is flipped."""
    y = M.shape[0] - 1
    pivot = M[j, j]
    s = max(M[y, y], p.floor)
    after = max(s - M[j, y] * M[j, y] / pivot, p.floor)
    data = -0.5 * math.log(abs(pivot)) - p.h * math.log(after / s)
    if active[j]:
        return data - p.log_odds[j] + p.half_log_slab
    return data + p.log_odds[j] - p.half_log_slab


@kernel
def swap_gain(p: Problem, M: Floats, i: int, j: int) -> float:
    """Change of the log posterior when active term i leaves and inactive term j enters."""
    y = M.shape[0] - 1
    out = M[i, i]
    link = M[i, j] / out
    pivot = M[j, j] - link * M[i, j]
    partial = M[j, y] - link * M[i, y]
    s = max(M[y, y], p.floor)
    after = max(s - M[i, y] * M[i, y] / out - partial * partial / pivot, p.floor)
    data = -0.5 * (math.log(abs(out)) + math.log(abs(pivot))) - p.h * math.log(after / s)
    return data + p.log_odds[j] - p.log_odds[i]


@kernel
def climb(p: Problem, M: Floats, active: Bools, swaps: bool = True) -> float:
    """Steepest ascent from the model in `active` by flips, and with `swaps` by swaps where no flip improves.

    M and `active` are changed in place; returns the log posterior gained. Forced and forbidden terms are left
    as they are.
    """
    terms = len(active)
    gained = 0.0
    for _ in range(20 * terms + 20):
        best, best_i, best_j = GAIN_TOLERANCE, -1, -1
        for j in range(terms):
            if not math.isinf(p.log_odds[j]):
                gain = flip_gain(p, M, active, j)
                if gain > best:
                    best, best_j = gain, j
        if best_j < 0 and swaps:
            for i in range(terms):
                if active[i] and not math.isinf(p.log_odds[i]):
                    for j in range(terms):
                        if not active[j] and not math.isinf(p.log_odds[j]):
                            gain = swap_gain(p, M, i, j)
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
def score(p: Problem, active: Bools, slab_variance: float) -> float:
    """Log posterior of one model up to the constant of `search.log_constant`, from scratch, at any v_s.

    Cholesky of A, so that it carries none of a tableau's drift.
    """
    index = np.flatnonzero(active)
    r = len(index)
    L = np.empty((r, r))
    half = np.empty(r)
    total = 0.0
    s = p.yty + 2.0 * p.noise_rate
    for a in range(r):
        if p.log_odds[index[a]] < math.inf:
            total += p.log_odds[index[a]]
        for b in range(a + 1):
            value = p.DtD[index[a], index[b]]
            if a == b:
                value += 1.0 / slab_variance
            for k in range(b):
                value -= L[a, k] * L[b, k]
            if a == b:
                L[a, a] = math.sqrt(max(value, 1e-300))
            else:
                L[a, b] = value / L[b, b]
        value = p.Dty[index[a]]
        for k in range(a):
            value -= L[a, k] * half[k]
        half[a] = value / L[a, a]
        s -= half[a] * half[a]
        total -= 0.5 * math.log(slab_variance) + math.log(L[a, a])
    return total - p.h * math.log(0.5 * max(s, p.floor))


@kernel
def least_squares_rss(DtD: Floats, Dty: Floats, yty: float) -> float:
    """Residual sum of squares of all terms together; columns that depend on earlier ones add nothing."""
    p = len(Dty)
    L = np.empty((p, p))
    half = np.empty(p)
    s = yty
    for i in range(p):
        for j in range(i + 1):
            value = DtD[i, j]
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if j < i:
                L[i, j] = value / L[j, j]
            elif value > DEPENDENT * DtD[i, i]:
                L[i, i] = math.sqrt(value)
            else:
                L[i, i] = math.inf
        value = Dty[i]
        for k in range(i):
            value -= L[i, k] * half[k]
        half[i] = value / L[i, i]
        s -= half[i] * half[i]
    return s
