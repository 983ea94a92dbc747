"""Limits of what chance may do, from the number of draws.

Seeds are fixed, so that a test that passes goes on passing; a limit says how often other seeds would fail.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

__all__ = ["CHANCE", "assert_coverage", "assert_spread", "fewest"]

# Probability that a right method fails a limit.
CHANCE = 1e-3

# Of so few draws, of which chance could spoil most, the seeds are such that none fails.
FEW = 4


def fewest(draws: int, rate: float) -> int:
    """The least number of successes: fewer have a probability below `CHANCE` at this rate; of `FEW` draws all."""
    return draws if draws <= FEW else int(stats.binom.ppf(CHANCE, draws, rate))


def assert_coverage(inside: ArrayLike, level: float = 0.95) -> None:
    """The share of intervals that hold the truth is `level`, within what a binomial count may do."""
    count, number = int(np.sum(inside)), np.size(inside)
    test = stats.binomtest(count, number, level)
    assert test.pvalue > CHANCE, f"{count} of {number} intervals hold the truth, {level:.0%} should"


def assert_spread(squares: float, freedom: int) -> None:
    """A sum of squares of `freedom` standardised errors is chi-square: their spread is the stated one."""
    low, high = stats.chi2.ppf([CHANCE / 2, 1 - CHANCE / 2], freedom)
    ratio, limits = np.sqrt(squares / freedom), np.sqrt([low / freedom, high / freedom])
    assert low < squares < high, f"errors are {ratio:.2f} times the stated ones: outside {limits.round(2)}"
