"""Coefficients by projection of the smoothed right-hand side, discrepancy included, on the terms of an equation.

The likelihood fixes the sum of terms and discrepancy, not how it is divided: that depends on the memory that the
discrepancy is assumed to have. One division leaves the discrepancy orthogonal to the terms (orthogonal discrepancy,
Plumlee 2017): the least squares fit of the sum by the terms, with the same weight at every moment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayeq.arrays import Floats
from bayeq.likelihood.fit import solved
from bayeq.numerics.distributions import correlation, memory_of
from bayeq.numerics.settings import LIKELIHOOD

# Least number of rows in a batch; least number of batches that a covariance is estimated from.
LEAST_ROWS, LEAST_BATCHES = 8, 4

# Largest number of batches.
MOST_BATCHES = 64

# Number of frequencies that represent the spectrum of the residual.
LINES = 12


class Leftover(NamedTuple):
    """Sums over batches of samples for the projection of an equation's right-hand side on its terms."""

    products: Floats  # (B, r, r), of the columns with each other
    pulls: Floats  # (B, r), of the columns with the discrepancy
    square: float  # sum of squares of the discrepancy
    weight: float  # sum of the weights of samples
    target: float  # variance of the target
    lines: tuple[float, ...]  # `lines_of_equal_power` of the projection's residual


class Projected(NamedTuple):
    """Coefficients by projection."""

    change: Floats  # (r,), of the coefficients, from those of the likelihood
    # (r, r), of that change, from the scatter of the residual's sums over batches; zero if batches are too few
    covariance: Floats
    freedom: float  # degrees of freedom of that covariance
    share: float  # root mean square of the residual, over the target's standard deviation


def leftover(
    columns: Sequence[Floats], discrepancies: Sequence[Floats], intervals: Sequence[Floats], target: float
) -> Leftover:
    """Sums over batches, which do not cross records.

    Columns, (n, r), and smoothed discrepancies, (n,), are of each record; a sample is weighted by the time around it,
    from the intervals [s]. `target` is the variance of the target.
    """
    weights = [time_around(one) for one in intervals]
    whole = sum((w[:, None] * D).T @ D for w, D in zip(weights, columns, strict=True))
    pull = sum((w[:, None] * D).T @ d for w, D, d in zip(weights, columns, discrepancies, strict=True))
    change = solved(np.asarray(whole), np.asarray(pull)) if np.size(pull) else np.zeros(0)
    courses = tuple(d - D @ change for D, d in zip(columns, discrepancies, strict=True))
    scores = [D * r[:, None] for D, r in zip(columns, courses, strict=True)]
    total = sum(map(len, courses))
    length = max(
        min(LIKELIHOOD.batch * _correlated(scores), total / LIKELIHOOD.enough_batches), total / MOST_BATCHES, LEAST_ROWS
    )
    pairs = [
        batched(D, d[:, None], w, max(1, int(len(d) / length)))
        for w, D, d in zip(weights, columns, discrepancies, strict=True)
    ]
    products, pulls = map(np.concatenate, zip(*pairs, strict=True))
    lines = lines_of_equal_power(courses, float(np.median(np.concatenate(intervals))))
    square = sum(float(w @ d**2) for w, d in zip(weights, discrepancies, strict=True))
    weight = sum(float(w.sum()) for w in weights)
    return Leftover(products, pulls, square, weight, target, lines)


def batched(columns: Floats, discrepancies: Floats, weights: Floats, count: int) -> tuple[Floats, Floats]:
    """Sums of products over batches of one record: of columns (n, r), and of these with discrepancies (n, r or 1)."""
    weighted = weights[:, None] * columns
    batches = np.array_split(np.arange(len(columns)), count)
    products = [weighted[rows].T @ columns[rows] for rows in batches]
    return np.array(products), np.array([(weighted * discrepancies)[rows].sum(axis=0) for rows in batches])


def projected(left: Leftover, basis: Floats) -> Projected:
    """The projection with coefficients restricted to ``basis @ free``; `basis` (r, f), `free` (f,)."""
    A = basis.T @ left.products.sum(axis=0) @ basis
    pull = basis.T @ left.pulls.sum(axis=0)
    r, batches = len(basis), len(left.pulls)
    if not len(pull):
        return Projected(np.zeros(r), np.zeros((r, r)), math.inf, math.sqrt(left.square / left.weight / left.target))
    free = solved(A, pull)
    share = math.sqrt(max(left.square - float(pull @ free), 0.0) / left.weight / left.target)
    change, covariance, freedom = basis @ free, np.zeros((r, r)), math.inf
    if batches >= LEAST_BATCHES:
        scores = (left.pulls - left.products @ change) @ basis
        half = basis @ solved(A, scores.T)
        covariance, freedom = batches / (batches - 1.0) * half @ half.T, batches - 1.0
    return Projected(change, covariance, freedom, share)


def lines_of_equal_power(courses: Sequence[Floats], interval: float) -> tuple[float, ...]:
    """Frequencies [Hz] that divide the power of evenly sampled `courses` into equal shares; empty without power."""
    frequency = np.concatenate([np.fft.rfftfreq(len(one), interval) for one in courses])
    power = np.concatenate([np.abs(np.fft.rfft(one)) ** 2 / len(one) for one in courses])
    power[frequency > 0.0] *= 2.0  # of both signs
    order = np.argsort(frequency, kind="stable")
    cumulative = np.cumsum(power[order])
    places = np.searchsorted(cumulative, (np.arange(LINES) + 0.5) / LINES * cumulative[-1])
    return tuple(frequency[order][places].tolist()) if 0.0 < cumulative[-1] < math.inf else ()


def time_around(intervals: Floats) -> Floats:
    """Time around each sample, 1 on average."""
    around = np.append(intervals, 0.0) + np.append(0.0, intervals)
    around[[0, -1]] *= 2.0
    return np.asarray(around / around.mean())


def _correlated(scores: Sequence[Floats]) -> float:
    """Longest integrated correlation time of the columns, in samples, each summed up to the first zero."""
    columns = ([one[:, j] - one[:, j].mean() for one in scores] for j in range(scores[0].shape[1]))
    return max([1.0, *(1.0 / memory_of(correlation(own, own), 1)[1] for own in columns)])
