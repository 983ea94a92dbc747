"""Sequentially thresholded least squares: the SINDy algorithm (Brunton, Proctor and Kutz 2016), on a Gram.

Least squares (with a ridge) on the active terms is repeated, dropping terms with a coefficient below the threshold,
until all are above. The threshold is given, or swept and chosen by the error on held-out rows as in the paper's
comparison (without such rows by the Bayesian information criterion).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError, whole_number
from bayeq.inference.gram import Gram, GramLike, LazyGram, dense
from bayeq.inference.posterior import Constant, Details, Posterior, of_standardised
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

# A column counts as linearly dependent on earlier ones if its pivot is a smaller share of its sum of squares.
DEPENDENT = 1e-13

# Thresholds tried by a sweep, and most regressions at each.
SWEEP, MOST_REGRESSIONS = 60, 20


@kernel
def least_squares(K: Floats, c: Floats, active: Bools, ridge: float, out: Floats) -> None:
    """Coefficients of the active terms that solve (K + ridge I) theta = c, into `out` (P,), 0 elsewhere.

    Columns are scaled to unit diagonal for the factorisation, which is followed by one step of iterative
    refinement; a column that depends on earlier ones gets 0.
    """
    index = np.flatnonzero(active)
    r = len(index)
    L, scale = np.zeros((r, r)), np.empty(r)
    for a in range(r):
        diagonal = K[index[a], index[a]] + ridge
        scale[a] = 1.0 / math.sqrt(diagonal) if diagonal > 0.0 else 0.0
    for a in range(r):
        for b in range(a + 1):
            value = K[index[a], index[b]] * scale[a] * scale[b]
            if a == b:
                value += ridge * scale[a] * scale[a]
            for k in range(b):
                value -= L[a, k] * L[b, k]
            if b < a:
                L[a, b] = value / L[b, b]
            else:
                L[a, a] = math.sqrt(value) if value > DEPENDENT else math.inf
    x, rest = np.zeros(r), np.empty(r)
    for turn in range(2):
        for a in range(r):
            value = c[index[a]] * scale[a]
            if turn > 0:
                for b in range(r):
                    value -= K[index[a], index[b]] * scale[a] * scale[b] * x[b]
                value -= ridge * scale[a] * scale[a] * x[a]
            rest[a] = value
        for a in range(r):
            for k in range(a):
                rest[a] -= L[a, k] * rest[k]
            rest[a] /= L[a, a]
        for a in range(r - 1, -1, -1):
            for k in range(a + 1, r):
                rest[a] -= L[k, a] * rest[k]
            rest[a] /= L[a, a]
            x[a] += rest[a]
    out[:] = 0.0
    for a in range(r):
        out[index[a]] = x[a] * scale[a]


@kernel
def _threshold(K: Floats, c: Floats, threshold: float, ridge: float, max_iter: int, out: Floats) -> int:
    """STLSQ into `out`; returns the number of regressions, negative if the support still changed at the last."""
    terms = len(c)
    active = np.ones(terms, dtype=np.bool_)
    for k in range(max_iter):
        least_squares(K, c, active, ridge, out)
        changed = False
        for j in range(terms):
            if active[j] and not abs(out[j]) >= threshold:
                active[j] = False
                out[j] = 0.0
                changed = True
        if not changed:
            return k + 1
    return -max_iter


def _moments(gram: GramLike, centred: bool) -> tuple[Floats, Floats]:
    """D'D and D'y, about the means or about zero."""
    K, c = np.ascontiguousarray(dense(gram)), np.ascontiguousarray(gram.Dty)
    if centred:
        return K, c
    if not isinstance(gram, Gram | LazyGram):
        raise InputError("uncentred least squares needs a Gram that knows its means")
    return K + gram.n * np.outer(gram.mean, gram.mean), c + gram.n * gram.target_mean * gram.mean


def stlsq(
    gram: GramLike,
    *,
    threshold: float = 0.1,
    ridge: float = 0.05,
    centred: bool = True,
    max_iter: int = MOST_REGRESSIONS,
) -> Posterior:
    """Sequentially thresholded least squares at one threshold, for coefficients in the units of the Gram.

    Terms with a smaller coefficient are dropped, in at most `max_iter` regressions. The ridge is added to the diagonal
    of D'D (PySINDy's alpha). `centred` estimates an intercept; otherwise the regression is on the raw columns as
    PySINDy does. `pip` is 1 for a term that is in; the covariance is that of least squares.
    """
    whole_number("max_iter", max_iter, 1)
    if not (threshold >= 0 and ridge >= 0):
        raise InputError("need threshold >= 0 and ridge >= 0")
    K, c = _moments(gram, centred)
    coef = np.empty(len(c))
    steps = _threshold(K, c, threshold, ridge, max_iter, coef)
    return _posterior(gram, K, c, coef, ridge, centred, steps)


def sweep_stlsq(
    gram: Gram,
    prior: Prior | None = None,
    *,
    held_out: Gram | None = None,
    columns: Literal["standardised", "raw"] = "standardised",
) -> Posterior:
    """STLSQ at the threshold with the least error on held-out rows, in the units of the Gram.

    `held_out` are other rows in the same units; without them the Bayesian information criterion decides. The
    thresholds, 60 from the smallest to the largest coefficient of the regression on all terms, apply to coefficients of
    standardised or raw columns.
    """
    if prior is not None:
        prior.refuse_signs("stlsq")
    if columns == "standardised":
        standard = gram.standardise()
        other = None if held_out is None else standard.apply(held_out)
        return sweep_stlsq(standard.gram, held_out=other, columns="raw").rescaled(standard)
    K, c = _moments(gram, centred=True)
    full = np.empty(len(c))
    least_squares(K, c, np.ones(len(c), dtype=np.bool_), 0.0, full)
    sizes = np.abs(full[full != 0.0])
    thresholds = np.geomspace(sizes.min(), sizes.max(), SWEEP) if len(sizes) else np.zeros(1)
    path = np.empty((len(thresholds), len(c)))
    for threshold, coef in zip(thresholds, path, strict=True):
        _threshold(K, c, threshold, 0.0, MOST_REGRESSIONS, coef)
    errors = [_score(gram, K, c, held_out, theta) for theta in path]
    best = path[int(np.argmin(errors))]
    return _posterior(gram, K, c, best, 0.0, True, len(path))


def _means(gram: GramLike) -> tuple[Floats, float]:
    """Means of the columns and of the target; 0 for a Gram without means, which is standardised."""
    return (gram.mean, gram.target_mean) if isinstance(gram, Gram | LazyGram) else (np.zeros(len(gram.names)), 0.0)


def _residual_sum(yty: float, K: Floats, c: Floats, coef: Floats) -> float:
    kept = np.flatnonzero(coef)
    theta = coef[kept]
    rss = float(yty - 2.0 * theta @ c[kept] + theta @ K[np.ix_(kept, kept)] @ theta)
    return max(rss, 1e-15 * yty, 1e-300)


def _score(gram: GramLike, K: Floats, c: Floats, held_out: Gram | None, coef: Floats) -> float:
    """Held-out squared error, or the Bayesian information criterion."""
    if held_out is not None:
        mean, target_mean = _means(gram)
        return held_out.squared_error(coef, target_mean - float(mean @ coef))
    n = gram.dof + 1.0
    return n * math.log(_residual_sum(gram.yty, K, c, coef) / n) + np.count_nonzero(coef) * math.log(n)


def _posterior(
    gram: GramLike, K: Floats, c: Floats, coef: Floats, ridge: float, centred: bool, steps: int
) -> Posterior:
    support = coef != 0.0
    kept = np.flatnonzero(support)
    n = gram.n if isinstance(gram, Gram | LazyGram) else round(gram.dof) + 1
    mean, target_mean = _means(gram)
    yty = gram.yty if centred else gram.yty + n * target_mean**2
    variance = _residual_sum(yty, K, c, coef) / max(gram.dof - len(kept), 1.0)
    information = K[np.ix_(kept, kept)] + ridge * np.eye(len(kept))
    # scaled to unit diagonal for the inversion; directions lost in rounding get no variance
    scale = 1.0 / np.sqrt(np.diagonal(information))
    unit = np.outer(scale, scale)
    inverse = np.linalg.pinv(information * unit, rcond=len(kept) * np.finfo(np.float64).eps, hermitian=True) * unit
    pip, details = support.astype(np.float64), Details("stlsq", abs(steps), steps > 0)
    found = of_standardised(gram, pip, support, coef.copy(), variance * inverse, variance, details)
    # zero means of the columns and of the target: no intercept
    return replace(found, n=n, constant=Constant(mean, target_mean)) if centred else replace(found, n=n)
