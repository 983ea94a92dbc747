"""What a study of calibration adds up, and the tests of it.

Ranks of true values among posterior draws (simulation-based calibration, Talts et al. 2018), and the share of true
terms in bins of the posterior inclusion probability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "BINS",
    "DRAWS",
    "QUANTITIES",
    "TAIL",
    "Tally",
    "bin_of",
    "bin_p",
    "correlation_time",
    "holm",
    "joined",
    "rank",
    "uniform_p",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS = 10

# Of 199 draws those of order 5 and 195 enclose 190 of the 200 places that a value can take among them: 95 %.
DRAWS = 199
TAIL = 5

# What is ranked among its posterior draws: x'theta at a random row x, one coefficient at random, sigma^2, and the log
# likelihood of theta and sigma^2, which unlike the others looks at the data (Modrak et al. 2023).
QUANTITIES = ("prediction", "coefficient", "noise", "likelihood")

# Cells of the chi-square test of uniform ranks.
CELLS = 20

# Least variance of the number of true terms in a bin for which it is tested as Gaussian.
LEAST_VARIANCE = 25.0


@dataclass(frozen=True, slots=True)
class Tally:
    """Sums over problems; tallies add up.

    Attributes
    ----------
    problems, sampled : int
        How many, and in how many of them chains took the place of model averaging.
    terms, stated, true : (BINS,) arrays
        For each bin of PIP the number of terms, the sum of their PIPs, and how many of them are true.
    variance : (BINS,) array
        Sum over the problems of the posterior variance of the number of true terms in the bin: dependent terms count
        as such.
    squared : (BINS,) array
        Sum over the problems of (true - stated)^2: what `variance` is, were it not known.
    ranks : (len(QUANTITIES), DRAWS + 1) array
        How often a true value had each rank among its draws.
    enclosed : int
        How often the draws of order 5 and 195, themselves included, enclosed the true x'theta.
    included, covered : int
        Terms of the median probability models, and how many of their `ci95`, which take that model for granted, cover.
    most_left_out : float
        The largest mass left out of an averaging.
    slowest, rhat : float
        The longest autocorrelation time of x'theta in a chain, in samples, and the largest multivariate R-hat.
    """

    problems: int
    sampled: int
    terms: Ints
    stated: Floats
    true: Ints
    variance: Floats
    squared: Floats
    ranks: Ints
    enclosed: int
    included: int
    covered: int
    most_left_out: float
    slowest: float
    rhat: float

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.problems + other.problems,
            self.sampled + other.sampled,
            self.terms + other.terms,
            self.stated + other.stated,
            self.true + other.true,
            self.variance + other.variance,
            self.squared + other.squared,
            self.ranks + other.ranks,
            self.enclosed + other.enclosed,
            self.included + other.included,
            self.covered + other.covered,
            max(self.most_left_out, other.most_left_out),
            max(self.slowest, other.slowest),
            max(self.rhat, other.rhat),
        )


def bin_of(pip: Floats) -> Ints:
    """The bin of each probability: [0, 0.1), [0.1, 0.2) ... [0.9, 1].

    Examples
    --------
    >>> bin_of(np.array([0.0, 0.05, 0.1, 0.95, 1.0]))
    array([0, 0, 1, 9, 9])
    """
    return np.minimum((pip * BINS).astype(np.int64), BINS - 1)


def rank(draws: Floats, value: float, rng: np.random.Generator) -> int:
    """How many draws lie below `value`; ties, of which a coefficient that is zero has many, are broken at random."""
    return int(np.sum(draws < value)) + int(rng.integers(int(np.sum(draws == value)) + 1))


def bin_p(tally: Tally) -> list[float | None]:
    """p-value of each bin's number of true terms, by its variance under the posterior; None where that is small.

    If the posteriors are right, the difference of true and stated has mean 0 and this variance exactly, dependent terms
    and all. An empirical variance would depend on the difference itself where few terms are wrong.
    """
    out: list[float | None] = []
    for true, stated, variance in zip(tally.true, tally.stated, tally.variance, strict=True):
        tested = variance >= LEAST_VARIANCE
        out.append(math.erfc(abs(true - stated) / math.sqrt(2.0 * variance)) if tested else None)
    return out


def uniform_p(counts: Ints) -> float:
    """p-value of uniform ranks from how often each occurred, by chi-square over 20 cells."""
    from scipy.stats import chisquare

    return float(chisquare(counts.reshape(CELLS, -1).sum(axis=1)).pvalue)


def holm(p: ArrayLike) -> Floats:
    """p-values adjusted for their number, whatever their dependence (Holm 1979).

    Examples
    --------
    >>> holm([0.04, 0.01, 0.5])
    array([0.08, 0.03, 0.5 ])
    """
    p = np.asarray(p, dtype=np.float64)
    order = np.argsort(p, kind="stable")
    adjusted = p[order] * np.arange(len(order), 0, -1)
    out = np.empty(len(order))
    out[order] = np.minimum(np.maximum.accumulate(adjusted), 1.0)
    return out


def correlation_time(values: Floats) -> float:
    """Integrated autocorrelation time of chains (m, n) in samples, by Geyer's initial positive sequence (1992).

    n m over this is their effective sample size; 1 if nothing varies.
    """
    centred = values - values.mean()
    n = values.shape[1]
    spectrum = np.abs(np.fft.rfft(centred, 2 * n, axis=1)) ** 2
    covariance = np.fft.irfft(spectrum, axis=1)[:, :n].mean(axis=0)
    if not covariance[0] > 0.0:
        return 1.0
    pairs = covariance[1 : 2 * (n // 2) - 1].reshape(-1, 2).sum(axis=1) / covariance[0]
    ends = np.flatnonzero(pairs < 0.0)
    return float(1.0 + 2.0 * pairs[: ends[0] if len(ends) else None].sum())


def joined(tallies: Sequence[Tally]) -> Tally:
    """The sum of at least one tally."""
    total = tallies[0]
    for tally in tallies[1:]:
        total = total + tally
    return total
