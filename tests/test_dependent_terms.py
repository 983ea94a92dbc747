"""Terms that depend on each other, such as x1, x2 and x1 - x2, any two of which say the same."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import AmbiguityWarning
from bayeq.gram import Gram
from bayeq.inference.bma import independent, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.prior import Prior

TIED = np.array([[True, True, False], [True, False, True], [False, True, True]])


@pytest.fixture(scope="module")
def columns() -> np.ndarray:
    return np.random.default_rng(1).normal(size=(400, 2))


def _problem(D: np.ndarray, y: np.ndarray) -> Problem:
    return Problem.of(Gram.from_data(D, y).standardise(1.0).gram, Prior())


def test_the_likeliest_part_stands_for_terms_that_depend_on_each_other(columns: np.ndarray) -> None:
    a, b = columns.T
    D, y = np.column_stack([a, b, a - b]), 2.0 * a + 3.0 * b
    assert independent(_problem(D, y), np.ones(3, dtype=np.bool_), TIED).tolist() == [True, True, False]
    assert independent(_problem(D, y), np.ones(3, dtype=np.bool_), TIED[::-1]).tolist() == [False, True, True]
    # models with other terms are no part of it
    assert independent(_problem(D, y), TIED[1], TIED).tolist() == TIED[1].tolist()


@pytest.mark.parametrize("apart", [1e-4, 1e-2, 1.0])
def test_terms_that_hardly_differ_do_not_depend_on_each_other(columns: np.ndarray, apart: float) -> None:
    a, b = columns.T
    D = np.column_stack([a, b, a - b + apart * np.random.default_rng(2).normal(size=len(a))])
    assert independent(_problem(D, a + b), np.ones(3, dtype=np.bool_), TIED).all()


def test_averages_over_models_keep_the_probability_of_each(columns: np.ndarray) -> None:
    a, b = columns.T
    y = 2.0 * a - b + 0.1 * np.random.default_rng(3).normal(size=len(a))
    gram = Gram.from_data(np.column_stack([a, b, a - b]), y).standardise(1.0).gram
    found = spike_slab_bma(gram, Prior(slab_variance=1e6))
    assert (found.pip > 0.5).all()
    assert found.support.sum() == 2
    assert (found.coef[found.support] != 0.0).all()
    assert found.covariance.shape == (2, 2)


def test_an_equation_is_not_written_with_more_terms_than_it_needs() -> None:
    record = bq.simulate("linear", n=1500, seed=2, noise=0.02)
    with pytest.warns(
        AmbiguityWarning, match=r"^a: .* can be written by the terms shown; either may be in: give fewer"
    ):
        (eq,) = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "x+v", "u", "x**3"])
    assert len(eq.shown) == 3
    assert "u" in eq.shown
    sd = dict(zip((term.text for term in eq.terms), eq.posterior.sd, strict=True))
    assert all(sd[name] < 10.0 for name in eq.shown)
    assert not any("x+v" in line for line in str(eq).splitlines() if line.startswith("too small"))
