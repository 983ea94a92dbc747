"""The slab variance and the scale of the target, learned from the data."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import Gram, GramLike
from bayeq.inference.prior import Prior
from bayeq.inference.search import SearchProblem, best_models
from bayeq.inference.tableau import score
from bayeq.kernels import kernel

__all__ = ["learn_slab_variance", "residual_scale"]

# Bounds of ln v_s above the floor, and how finely a maximum is looked for and polished.
LOG_RANGE = math.log(1e15)
GRID = 41
GOLDEN_STEPS = 30

# A column whose variance left by earlier ones is a smaller share of its own depends on them.
DEPENDENT = 1e-13

# Below this share of the target's standard deviation a residual is rounding of the Gram matrix.
LEAST_RESIDUAL = 1e-6


@kernel
def _best_slab(DtD, Dty, yty, active, log_odds, noise_rate, h, floor, lowest):  # type: ignore[no-untyped-def]
    """ln v_s >= lowest that maximises the log posterior of one model, and that maximum."""
    best, best_k = -math.inf, 0
    step = LOG_RANGE / (GRID - 1)
    for k in range(GRID):
        v = math.exp(lowest + k * step)
        value = score(DtD, Dty, yty, active, log_odds, v, noise_rate, h, floor)
        if value > best:
            best, best_k = value, k
    a = lowest + max(best_k - 1, 0) * step
    b = lowest + min(best_k + 1, GRID - 1) * step
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    for _ in range(GOLDEN_STEPS):
        left, right = b - ratio * (b - a), a + ratio * (b - a)
        f_left = score(DtD, Dty, yty, active, log_odds, math.exp(left), noise_rate, h, floor)
        f_right = score(DtD, Dty, yty, active, log_odds, math.exp(right), noise_rate, h, floor)
        if f_left >= f_right:
            b = right
        else:
            a = left
    middle = 0.5 * (a + b)
    value = score(DtD, Dty, yty, active, log_odds, math.exp(middle), noise_rate, h, floor)
    if value > best:
        return middle, value
    return lowest + best_k * step, best


def learn_slab_variance(gram: GramLike, prior: Prior, floor: float = 10.0) -> float:
    """v_s that maximises the evidence of the best model, not below `floor`.

    With the noise small against the signal, v_s = 10 lets coefficients of standardised columns, which are of
    the size of the signal-to-noise ratio, be shrunk and split among correlated terms. Model and v_s are
    maximised in turn, from the floor and from the signal-to-noise ratio y'y/RSS of all terms together.

    Parameters
    ----------
    gram : GramLike
        Sufficient statistics, standardised.
    prior : Prior
        Everything but its slab variance is used.
    floor : float
        Least value; the paper's 10.
    """
    problem = SearchProblem.of(gram, prior)
    lowest = math.log(floor)
    ratio = gram.yty / max(_residual_sum(problem), LEAST_RESIDUAL**2 * gram.yty, 1e-300)
    best_value, best_log = -math.inf, lowest
    for start in {lowest, max(lowest, math.log(max(ratio, 1e-300)))}:
        log_v = start
        for _ in range(10):
            trial = replace(problem, slab_variance=math.exp(log_v))
            active = best_models(trial)[0][1]
            new, value = _best_slab(
                trial.DtD, trial.Dty, trial.yty, active, trial.log_odds, trial.noise_rate, trial.h, trial.floor,
                lowest,
            )  # fmt: skip
            if value > best_value:
                best_value, best_log = value, new
            if abs(new - log_v) < 1e-3:
                break
            log_v = new
    return math.exp(best_log)


@kernel
def _least_squares_rss(DtD, Dty, yty):  # type: ignore[no-untyped-def]
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


def _residual_sum(problem: SearchProblem) -> float:
    return float(_least_squares_rss(problem.DtD, problem.Dty, problem.yty))


def residual_scale(gram: Gram) -> float:
    """Standard deviation of what all terms together leave of y: the unit in which the noise prior applies.

    b_sigma is not scale free. In units of y, IG(1e-4, 1e-4) weighs on the noise once it falls to about 0.1 % of
    the signal; in units of the least-squares residual it never does. With hardly more rows than terms there is
    no such residual, and the standard deviation of y takes its place.
    """
    sd = math.sqrt(gram.yty / gram.n)
    spare = gram.n - 1 - len(gram.names)
    if sd == 0.0:
        return 1.0
    if spare < max(10, 0.1 * gram.n):
        return sd
    standard = gram.standardise(sd).gram
    problem = SearchProblem.of(standard, Prior())
    rss = _residual_sum(problem)
    return sd * max(math.sqrt(max(rss, 0.0) / spare), LEAST_RESIDUAL)
