"""The collapsed tableau: model moves at the price of one rank-one update.

With theta and sigma^2 integrated out (eq. (34)) a model z has the log posterior

    sum_{z_i=1} logit(p_0) - r/2 ln v_s - 1/2 ln|A| - h ln(s/2) + const,
    A = D_r'D_r + I/v_s,   s = 2 b_sigma + y'y - y'D_r A^-1 D_r'y,   h = a_sigma + N/2.

The tableau M is the symmetric matrix [[D'D + I/v_s, D'y], [y'D, y'y + 2 b_sigma]] swept (Beaton 1964) on the
active terms. A move needs only these entries:

    active i, j     M_ij = -(A^-1)_ij          M_iy = posterior mean of theta_i
    inactive j      M_jj = Schur complement    M_jy = partial covariance with y
    y               M_yy = s

so the log-odds of any flip or swap are O(1). No move needs M_jk of two inactive terms: the tableau stores only the rows
of the r active terms, the diagonal and the column of y, and a flip costs O(r P) however large the dictionary.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.inference.collapsed.problem import Problem, fetch
from bayeq.kernels import kernel

# A climb stops when no move gains this much log posterior: above the rounding of h ln(s).
GAIN_TOLERANCE = 1e-8

# A tableau has drifted if entries differ by this from their values by the active rows and the Gram: s and Schur
# complements relatively, M_jy in units of a t-value. Engines that go from model to model check this every LOOK steps.
DRIFT = 1e-6
LOOK = 16

# A column counts as linearly dependent on earlier ones if less than this share of its variance is left given these.
DEPENDENT = 1e-13

# Nats by which the bound on the gain of a swap may be off by rounding.
SLACK = 1e-6

# Largest number of terms in a model.
MOST_ACTIVE = 2048


class Tableau(NamedTuple):
    """M swept on r active terms; changed in place by `enter`, `leave` and `flip`."""

    rows: Floats  # (R, P+1), the first r rows are M_i. of the active terms i; the last column is that of y
    row: Ints  # (P,), row of each term, -1 for an inactive one
    term: Ints  # (R,), term of each of the first r rows
    size: Ints  # (1,), r
    diagonal: Floats  # (P+1,), M_jj of all terms, and s at the end
    partial: Floats  # (P,), M_jy of all terms


@kernel
def build(p: Problem, yty: float, ridge: float) -> Tableau:
    """Unswept tableau, of the empty model; `ridge` is 1/v_s, `yty` holds 2 b_sigma already."""
    terms = len(p.Dty)
    most = min(terms, MOST_ACTIVE)
    row, term, size = np.full(terms, -1), np.empty(most, np.int64), np.zeros(1, np.int64)
    diagonal = np.empty(terms + 1)
    diagonal[:-1] = p.columns.diagonal + ridge
    diagonal[-1] = yty
    return Tableau(np.empty((most, terms + 1)), row, term, size, diagonal, p.Dty.copy())


@kernel
def _sweep(T: Tableau, pivot_row: Floats, j: int, pivot: float, skip: int) -> None:
    """Rank-one update of all stored entries except row `skip`, by the row of term j before its own scaling.

    Both factors are that row: with row and column, the asymmetry of M by rounding would grow from flip to flip.
    """
    p = len(T.partial)
    size = abs(pivot)
    for a in range(T.size[0]):
        if a == skip:
            continue
        i = T.term[a]
        factor = pivot_row[i] / pivot
        other = T.rows[a]
        if factor != 0.0:
            for k in range(p + 1):
                other[k] -= factor * pivot_row[k]
        other[j] = pivot_row[i] / size
    last = pivot_row[p] / pivot
    for k in range(p):
        T.diagonal[k] -= pivot_row[k] * pivot_row[k] / pivot
        T.partial[k] -= pivot_row[k] * last
    T.diagonal[p] -= pivot_row[p] * last
    T.diagonal[j] = -1.0 / pivot
    T.partial[j] = pivot_row[p] / size


@kernel
def enter(p: Problem, T: Tableau, j: int, ridge: float) -> None:
    """Sweep inactive term j in, with `ridge` added to its diagonal in D'D."""
    terms = len(p.Dty)
    r = T.size[0]
    new = T.rows[r]
    if p.columns.slot[j] < 0:
        fetch(p.columns, j)
    own = p.columns.rows[p.columns.slot[j]]
    for k in range(terms):
        new[k] = own[k]
    new[terms] = p.Dty[j]
    for a in range(r):
        factor = own[T.term[a]]
        if factor != 0.0:
            other = T.rows[a]
            for k in range(terms + 1):
                new[k] -= factor * other[k]
    for a in range(r):
        new[T.term[a]] = T.rows[a, j]
    pivot = new[j] + ridge
    new[j] = pivot
    _sweep(T, new, j, pivot, r)
    size = abs(pivot)
    for k in range(terms + 1):
        new[k] /= size
    new[j] = -1.0 / pivot
    T.row[j] = r
    T.term[r] = j
    T.size[0] = r + 1


@kernel
def leave(T: Tableau, j: int) -> None:
    """Sweep active term j out. M_jj then holds the ridge it entered with."""
    a = T.row[j]
    last = T.size[0] - 1
    old = T.rows[a]
    _sweep(T, old, j, old[j], a)
    T.row[j] = -1
    if a != last:
        moved = T.rows[last]
        for k in range(len(moved)):
            old[k] = moved[k]
        T.term[a] = T.term[last]
        T.row[T.term[a]] = a
    T.size[0] = last


@kernel
def flip(p: Problem, T: Tableau, j: int) -> None:
    """Sweep term j in or out, in place."""
    if T.row[j] >= 0:
        leave(T, j)
    else:
        enter(p, T, j, 1.0 / p.slab_variance)


@kernel
def swept(p: Problem, active: Bools) -> Tableau:
    """The tableau of a model, from scratch."""
    T = build(p, p.yty + 2.0 * p.noise_rate, 1.0 / p.slab_variance)
    for j in range(len(active)):
        if active[j]:
            flip(p, T, j)
    return T


@kernel
def renew(p: Problem, T: Tableau, active: Bools) -> None:
    """Sweep the tableau of a model again, in place."""
    T.row[:] = -1
    T.partial[:] = p.Dty
    T.diagonal[:-1] = p.columns.diagonal + 1.0 / p.slab_variance
    T.diagonal[-1] = p.yty + 2.0 * p.noise_rate
    T.size[0] = 0
    for j in range(len(active)):
        if active[j]:
            flip(p, T, j)


@kernel
def strayed(p: Problem, T: Tableau, yty: float, ridges: Floats, floor: float) -> bool:
    """Whether rounding has spoilt a tableau that was moved from model to model, so that it must be swept again.

    M_yy, M_jy and M_jj are compared to their definitions given the active rows, b - sum_a M_ja b_a with b from the
    Gram. This costs about one flip. `ridges` (P,) are those of each term, `floor` is the least s that counts.
    """
    columns, terms = p.columns, len(p.Dty)
    s = max(T.diagonal[terms], floor)
    left, pull, own = yty, p.Dty.copy(), columns.diagonal + ridges
    for a in range(T.size[0]):
        i = T.term[a]
        gram, row, mean = columns.rows[columns.slot[i]], T.rows[a], T.partial[i]
        left -= mean * p.Dty[i]
        for j in range(terms):
            pull[j] -= mean * gram[j]
            own[j] -= row[j] * gram[j]
    if not abs(max(left, floor) - s) <= DRIFT * s:
        return True
    for j in range(terms):
        if T.row[j] >= 0:
            # the residual of the normal equations, in units of a t-value of the column alone
            error, pivot = pull[j] - ridges[j] * T.partial[j], -1.0 / T.diagonal[j]
        elif p.log_odds[j] > -math.inf:
            error, pivot = pull[j] - T.partial[j], T.diagonal[j]
            if not abs(own[j] - pivot) <= DRIFT * pivot:
                return True
        else:  # a term that never enters may be as good as dependent on the active ones
            continue
        if not abs(error) <= DRIFT * math.sqrt(pivot * s):
            return True
    return False


@kernel
def drifted(p: Problem, T: Tableau) -> bool:
    """Whether the tableau of a model has `strayed`."""
    ridges = np.full(len(p.Dty), 1.0 / p.slab_variance)
    return strayed(p, T, p.yty + 2.0 * p.noise_rate, ridges, p.floor)


@kernel(borrowing=True)
def move_to(p: Problem, T: Tableau, current: Bools, model: Bools) -> bool:
    """Move the tableau, and `current` with it, from one model to another, in place; False if rounding spoils it."""
    for j in range(len(current)):
        if model[j] != current[j]:
            flip(p, T, j)
            current[j] = model[j]
    if drifted(p, T):
        renew(p, T, current)
        return not drifted(p, T)
    return True


def active_block(T: Tableau, index: Ints) -> Floats:
    """A^-1 of the active terms `index`, (r, r)."""
    return -T.rows[np.ix_(T.row[index], index)]


@kernel
def data_gain(pivot: float, partial: float, s: float, floor: float, h: float) -> float:
    """Change of -1/2 ln|A| - h ln(s/2) by a flip with this pivot and partial covariance with y."""
    s = max(s, floor)
    return -0.5 * math.log(abs(pivot)) - h * math.log(max(s - partial * partial / pivot, floor) / s)


@kernel
def expit(log_odds: float) -> float:
    """The probability with these log-odds, without cancellation near 0 and 1."""
    if log_odds >= 0.0:
        return 1.0 / (1.0 + math.exp(-log_odds))
    e = math.exp(log_odds)
    return e / (1.0 + e)


@kernel
def size_gains(p: Problem, T: Tableau) -> tuple[float, float]:
    """Changes of the log prior when any term enters, and when any leaves, without the term's own log-odds."""
    r = T.size[0]
    full = r == len(T.rows)
    enters = -math.inf if full else p.size_prior[r + 1] - p.size_prior[r] - p.half_log_slab
    leaves = p.size_prior[r - 1] - p.size_prior[r] + p.half_log_slab if r > 0 else -math.inf
    return enters, leaves


@kernel
def flip_gains(p: Problem, T: Tableau, out: Floats) -> None:
    """Changes of the log posterior by flips of each term, into `out` (P,); -inf for a forced or forbidden one."""
    enters, leaves = size_gains(p, T)
    diagonal, partial, row, log_odds = T.diagonal, T.partial, T.row, p.log_odds
    floor, h, s = p.floor, p.h, T.diagonal[-1]
    for j in range(len(out)):
        if math.isinf(log_odds[j]):
            out[j] = -math.inf
        else:
            data = data_gain(diagonal[j], partial[j], s, floor, h)
            out[j] = data - log_odds[j] + leaves if row[j] >= 0 else data + log_odds[j] + enters


@kernel
def swap_gains(p: Problem, T: Tableau, i: int, least: float, out: Floats) -> int:
    """Changes of the log posterior by swaps of active term i for each inactive one, into `out`.

    They are -inf if forbidden, and where they are less than `least` by a bound that takes no logarithm: -ln(1 - x) is
    at most x/(1 - x), and a pivot at least 1/v_s. Returns the number of swaps that took logarithms.
    """
    diagonal, partial, row, log_odds = T.diagonal, T.partial, T.row, p.log_odds
    own = T.rows[row[i]]
    floor, h, s, price = p.floor, p.h, max(diagonal[-1], p.floor), log_odds[i]
    without = max(s - partial[i] * partial[i] / diagonal[i], floor)
    first = -0.5 * math.log(abs(diagonal[i])) - h * math.log(without / s) - price
    mean, inverse, needed, count = partial[i] / diagonal[i], 1.0 / diagonal[i], least - first - p.half_log_slab, 0
    for j in range(len(out)):
        out[j] = -math.inf
        if row[j] >= 0 or math.isinf(log_odds[j]) or math.isinf(price):
            continue
        pivot, rest = diagonal[j] - own[j] * own[j] * inverse, partial[j] - own[j] * mean
        square = rest * rest
        if (needed - log_odds[j] - SLACK) * (pivot * without - square) <= h * square or square >= pivot * without:
            out[j] = first + data_gain(pivot, rest, without, floor, h) + log_odds[j]
            count += 1
    return count


@kernel
def best_swap(p: Problem, T: Tableau, least: float) -> tuple[float, int, int]:
    """The swap that gains most, if more than `least`: gain, the term that leaves and the one that enters (-1: none)."""
    best, best_i, best_j = least, -1, -1
    gains = np.empty(len(T.partial))
    for a in range(T.size[0]):
        i = T.term[a]
        swap_gains(p, T, i, best, gains)
        for j in range(len(gains)):
            if gains[j] > best:
                best, best_i, best_j = gains[j], i, j
    return best, best_i, best_j


@kernel
def climb(p: Problem, T: Tableau, active: Bools, swaps: bool) -> None:
    """Steepest ascent from a model, in place, by flips, and if `swaps` by swaps where no flip improves."""
    terms = len(active)
    gains = np.empty(terms)
    for step in range(20 * terms + 20):
        if step % LOOK == LOOK - 1 and drifted(p, T):
            renew(p, T, active)
        flip_gains(p, T, gains)
        best, best_i, best_j = GAIN_TOLERANCE, -1, -1
        for j in range(terms):
            if gains[j] > best:
                best, best_j = gains[j], j
        if best_j < 0 and swaps:
            best, best_i, best_j = best_swap(p, T, GAIN_TOLERANCE)
        if best_j < 0:
            break
        if best_i >= 0:
            leave(T, best_i)
            active[best_i] = False
        flip(p, T, best_j)
        active[best_j] = not active[best_j]


@kernel
def score(p: Problem, active: Bools, slab_variance: float) -> float:
    """Log posterior of one model up to `search.log_constant`, at any v_s, by Cholesky, which does not drift."""
    index = np.empty(len(active), np.int64)
    r = 0
    for j in range(len(active)):
        if active[j]:
            index[r] = j
            r += 1
    L = np.empty((r, r))
    half = np.empty(r)
    rows, slot = p.columns.rows, p.columns.slot
    total = p.size_prior[r]
    s = p.yty + 2.0 * p.noise_rate
    for a in range(r):
        if slot[index[a]] < 0:
            fetch(p.columns, index[a])
        own = rows[slot[index[a]]]
        if p.log_odds[index[a]] < math.inf:
            total += p.log_odds[index[a]]
        for b in range(a + 1):
            value = own[index[b]]
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


def residual_sum(p: Problem) -> float:
    """Residual sum of squares of all terms together; 0 where there are as many terms as degrees of freedom."""
    if len(p.Dty) >= p.dof:
        return 0.0
    DtD, Dty = p.DtD, p.Dty
    try:
        pivots = np.diagonal(np.linalg.cholesky(np.block([[DtD, Dty[:, None]], [Dty, np.float64(p.yty)]]))) ** 2
    except np.linalg.LinAlgError:
        pivots = np.zeros(len(Dty) + 1)
    if (pivots[:-1] > DEPENDENT * DtD.diagonal()).all():
        return float(pivots[-1])
    # columns that depend on others
    values, vectors = np.linalg.eigh(DtD)
    kept = values > DEPENDENT * values[-1]
    explained = float(np.sum((vectors[:, kept].T @ Dty) ** 2 / values[kept]))
    return max(p.yty - explained, 0.0)
