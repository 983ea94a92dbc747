from __future__ import annotations

import math

import numpy as np
import pytest

from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import given_model, learn_slab_variance, residual_scale
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from tests import reference


def correlated(noise, seed=0, n=500):
    rng = np.random.default_rng(seed)
    D, _, _ = reference.random_problem(rng, n=n, P=6, rho=0.9)
    y = D @ [1.0, 0, 0, -0.8, 0, 0] + noise * rng.normal(size=n)
    return D, y - y.mean()


@pytest.mark.parametrize("noise", [1.0, 0.1, 1e-3])
def test_maximises_the_evidence_over_the_slab_variance(noise):
    D, y = correlated(noise)
    v = learn_slab_variance(Gram.from_data(D, y), Prior(), floor=0.01)

    def best(v_s):
        return reference.enumerate_models(D, y, v_s=v_s, N=len(y) - 1)[1].max()

    top = best(v)
    for other in np.geomspace(0.01, 1e9, 45):
        assert best(other) <= top + 1e-3


def test_is_not_below_its_floor_and_grows_with_the_signal():
    values = [learn_slab_variance(Gram.from_data(*correlated(noise)), Prior()) for noise in (3.0, 0.03, 0.003)]
    assert values[0] == pytest.approx(10.0)
    assert values[2] == pytest.approx(100 * values[1], rel=0.3)


@pytest.mark.parametrize("noise", [1.0, 1e-2, 1e-4])
def test_residual_scale_is_that_of_least_squares(noise):
    D, y = correlated(noise)
    residual = y - D @ np.linalg.lstsq(D, y, rcond=None)[0]
    expected = math.sqrt(residual @ residual / (len(y) - 7))
    assert residual_scale(Gram.from_data(D, y)) == pytest.approx(expected, rel=1e-4)


def test_residual_scale_without_noise_without_signal_and_without_rows_to_spare():
    D, y = correlated(0.0)
    assert residual_scale(Gram.from_data(D, y)) == pytest.approx(1e-6 * y.std(), rel=1e-6)
    assert residual_scale(Gram.from_data(D, np.ones(500))) == 1.0
    rng = np.random.default_rng(0)
    wide, target = rng.normal(size=(20, 15)), rng.normal(size=20)
    # five columns, a quarter of the rows, by forward selection
    D, y = wide - wide.mean(axis=0), target - target.mean()
    chosen: list[int] = []
    for _ in range(5):
        left = [np.linalg.lstsq(D[:, [*chosen, j]], y)[1].sum() if j not in chosen else np.inf for j in range(15)]
        chosen.append(int(np.argmin(left)))
    assert residual_scale(Gram.from_data(wide, target)) == pytest.approx(math.sqrt(min(left) / 14), rel=1e-6)


def test_little_noise_is_seen_in_few_rows_too():
    # 40 rows, 36 columns: in units of y the prior of the noise would hide a term that explains 1e-5
    rng = np.random.default_rng(1)
    D = rng.normal(size=(40, 36))
    y = D[:, 0] + 3e-3 * D[:, 1] + 1e-4 * rng.normal(size=40)
    assert 1e-5 < residual_scale(Gram.from_data(D, y)) < 1e-3


def test_copies_share_a_coefficient_where_the_prior_is_lost_in_rounding():
    column = 1e12 * np.random.default_rng(0).normal(size=(200, 1))
    problem = Problem.of(Gram.from_data(np.hstack([column, column]), 3.0 * column[:, 0]), Prior())
    coef, covariance = given_model(problem, np.array([True, True]))
    assert coef == pytest.approx([1.5, 1.5])
    assert np.isfinite(covariance).all()
    assert (np.diagonal(covariance) > 0).all()
