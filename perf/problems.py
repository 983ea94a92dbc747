"""The problems of the comparison: the paper's dictionaries, and synthetic correlated designs from small to large."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms

__all__ = ["CASES", "LARGEST_CORRELATION", "SYSTEMS", "Case", "Data", "Fitted", "correlated", "oscillator"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")

# Synthetic columns come in blocks of so many; neighbours in a block are correlated by 0.5 in the first block, rising
# to 0.98 in the last.
BLOCK = 12
LEAST_CORRELATION = 0.5
LARGEST_CORRELATION = 0.98

TRUE_TERMS = 10

# Rows that are made at a time.
ROWS = 4096

# Elements of D beyond which every contestant runs in a process of its own, where its memory can be told.
LARGE = 2_000_000

# p_0 is the paper's 0.1, but no more than this number of terms is expected beforehand.
EXPECTED_TERMS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """A regression whose answer is known.

    Attributes
    ----------
    D : (N, P) array
        Dictionary matrix.
    y : (N,) array
        Target.
    coef : (P,) array
        True coefficients, most of them 0.
    """

    D: Floats
    y: Floats
    coef: Floats

    @property
    def true(self) -> Bools:
        """The true terms, (P,)."""
        return self.coef != 0.0


class Fitted(NamedTuple):
    """Coefficients (P,) in the units of D and y, and the selected terms (P,)."""

    coef: Floats
    support: Bools


@dataclass(frozen=True, slots=True)
class Case:
    """A kind of problem, of which there is one for every seed.

    Attributes
    ----------
    name, title : str
        What one types, and what the tables show.
    rows, columns : int
        N and P.
    seeds : int
        How many problems are solved to tell how accurate a contestant is.
    make : callable
        ``make(seed) -> Data``.
    """

    name: str
    title: str
    rows: int
    columns: int
    seeds: int
    make: Callable[[int], Data]

    @property
    def large(self) -> bool:
        """Whether every contestant gets a process of its own."""
        return self.rows * self.columns > LARGE

    @property
    def prior_inclusion(self) -> float:
        """p_0 for all contestants that take one."""
        return min(0.1, EXPECTED_TERMS / self.columns)


def oscillator(system: str, seed: int, rows: int = 2000) -> Data:
    """One of the paper's oscillators: 36 candidate terms, 5 % noise on every channel, regressors included."""
    record = bq.simulate(system, n=rows, seed=seed)
    terms = build_dictionary("oscillator", Variables(("x", "v"), ("u",)))
    assert record.truth is not None
    known = record.truth.coefficients["a"]
    return Data(
        D=np.ascontiguousarray(evaluate_terms(terms, record.channels)),
        y=np.array(record["a"]),
        coef=np.array([known.get(term.text, 0.0) for term in terms]),
    )


def neighbour_correlations(columns: int) -> Floats:
    """Correlation of each column with the one before it, (P,); 0 where a block begins."""
    blocks = math.ceil(columns / BLOCK)
    r = np.repeat(np.linspace(LEAST_CORRELATION, LARGEST_CORRELATION, blocks), BLOCK)[:columns]
    r[::BLOCK] = 0.0
    return r


def correlated(rows: int, columns: int, seed: int) -> Data:
    """Gaussian columns, autoregressive within blocks; ten of them, drawn at random, make y with unit noise.

    True coefficients have random signs and sizes between 0.5 and 2. D is made in blocks of rows, in place.
    """
    rng = np.random.default_rng((seed, rows, columns))
    r = neighbour_correlations(columns)
    rest = np.sqrt(1.0 - r * r)
    D = np.empty((rows, columns))
    for start in range(0, rows, ROWS):
        part = D[start : start + ROWS]
        rng.standard_normal(out=part)
        for j in np.flatnonzero(r):
            part[:, j] *= rest[j]
            part[:, j] += r[j] * part[:, j - 1]
    coef = np.zeros(columns)
    true = rng.choice(columns, size=TRUE_TERMS, replace=False)
    coef[true] = rng.choice([-1.0, 1.0], size=TRUE_TERMS) * rng.uniform(0.5, 2.0, size=TRUE_TERMS)
    return Data(D, D[:, true] @ coef[true] + rng.standard_normal(rows), coef)


def _correlated_case(name: str, rows: int, columns: int, seeds: int) -> Case:
    return Case(name, f"P={columns:,}, N={rows:,}", rows, columns, seeds, partial(correlated, rows, columns))


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        *(Case(name, name.capitalize(), 2000, 36, 10, partial(oscillator, name)) for name in SYSTEMS),
        _correlated_case("p36", 2_000, 36, 10),
        _correlated_case("p200", 2_000, 200, 5),
        _correlated_case("p2000", 20_000, 2_000, 1),
        _correlated_case("p10000", 2_000, 10_000, 1),
        _correlated_case("n20000", 20_000, 36, 5),
        _correlated_case("n200000", 200_000, 36, 1),
        _correlated_case("n2000000", 2_000_000, 36, 1),
    )
}
