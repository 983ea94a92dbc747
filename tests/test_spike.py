"""Soft spikes: functions of a small size beside the terms, integrated out."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from studies.nearly_true import draw_record

import bayeq as bq
from bayeq.inference.collapsed.listing import search_models
from bayeq.inference.collapsed.search import scores_of
from bayeq.likelihood.fit import Quadratic
from bayeq.likelihood.spike import Soft, coordinates, isotropic, root_of, softened
from bayeq.numerics.settings import LIKELIHOOD


def softened_about(q, S):
    root = root_of(q.information)
    return softened(q.level, root, coordinates(root, q.slope), S)


def test_deviations_are_integrated_out():
    rng = np.random.default_rng(1)
    D, S, theta = rng.standard_normal((30, 5)), 0.3 * rng.standard_normal((5, 3)), rng.standard_normal(5)
    y = D @ theta + rng.standard_normal(30)

    def direct(m, covariance):
        return multivariate_normal.logpdf(y, D @ m, covariance)

    hard = Quadratic(direct(np.zeros(5), np.eye(30)), D.T @ y, D.T @ D)
    soft = softened_about(hard, S)
    for m in (np.zeros(5), theta, rng.standard_normal(5)):
        at = soft.level + soft.slope @ m - 0.5 * m @ soft.information @ m
        assert at == pytest.approx(direct(m, np.eye(30) + D @ S @ S.T @ D.T), abs=1e-9)


def test_little_noise_loses_no_digits():
    """Of A - A S (I + S'A S)^-1 S'A nothing is left here: it is I/tau^2, of information 1e18 times larger."""
    rng = np.random.default_rng(4)
    D = rng.standard_normal((40, 5))
    A, tau = 1e20 * D.T @ D, 0.1
    soft = softened_about(Quadratic(0.0, A @ np.ones(5), A), tau * np.eye(5))
    np.testing.assert_allclose(soft.information, np.eye(5) / tau**2, atol=1e-4)
    np.testing.assert_allclose(soft.slope, np.ones(5) / tau**2, rtol=1e-4)


def test_functions_are_isotropic():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(500)
    columns = np.column_stack([x, x**3, 1e-3 * x**5, x + x**3, np.ones(500)])  # one is the sum of others
    R = isotropic(columns, [], 7.0)
    assert R.shape == (5, 4)
    functions = columns @ R
    np.testing.assert_allclose(functions.T @ functions / 500, np.eye(4) * 7.0**2 / 4, atol=1e-6)


@pytest.fixture(scope="module")
def lorenz():
    record = bq.simulate("lorenz", n=400, noise=0.02, seed=3)
    return bq.discover(record, chains=["x", "y", "z"], dictionary="polynomial:2", holdout=0).equations[0]


def test_the_evidence_of_sizes_is_that_of_all_coefficients_together(lorenz):
    """Slabs and functions are one Gaussian prior of all coefficients, hidden ones too, given the model."""
    record = lorenz.fit.regression.record
    task = record.task
    soft = Soft.of(task, record.fitted)
    assert len(soft.about) > len(task.precision)  # 9 terms and a constant are few
    included, A = record.fitted.model, soft.whole.information
    b = soft.whole.slope - A @ soft.about
    differences = []
    for tau in ((0.0,) * 3, (0.01, 0.0, 0.003), (0.02, 0.005, 0.01)):
        models = dict(zip(map(bytes, soft.models(tau).models), soft.models(tau).log_posterior, strict=True))
        slabs = np.zeros(len(soft.about))
        slabs[soft.visible[included]] = task.precision[included] ** -0.5
        S = np.hstack([np.diag(slabs)[:, slabs > 0], *(t * one for t, one in zip(tau, soft.spreads, strict=True) if t)])
        # about zero: the fit's coefficients are part of the deviation
        slope = b + A @ soft.about
        root = np.linalg.cholesky(np.eye(S.shape[1]) + S.T @ A @ S)
        w = np.linalg.solve(root, S.T @ slope)
        direct = 0.5 * w @ w - np.log(np.diagonal(root)).sum()
        differences.append(models[included.tobytes()] - direct)
    assert differences[1] == pytest.approx(differences[0], abs=0.05)
    assert differences[2] == pytest.approx(differences[0], abs=0.05)


@pytest.mark.parametrize("least", [1e-1, 1e-3])
def test_columns_that_grow_alike_do_not_spoil_scores(lorenz, least):
    """Rounding of the Gram of an unstable law is larger than the prior: scores were too large by 1e8 nats, or inf."""
    task, rng = lorenz.fit.regression.record.task, np.random.default_rng(0)
    terms = len(task.precision)
    D = np.geomspace(1e9, least, terms)[:, None] * np.linalg.qr(rng.standard_normal((terms, terms)))[0]
    D *= np.sqrt(task.precision)
    law = 1e-5 * (np.arange(terms) % 7 == 0) / np.sqrt(task.precision)
    problem = task.problem(Quadratic(0.0, D.T @ (D @ law + rng.standard_normal(terms)), D.T @ D))
    listed = search_models(problem)
    assert listed.left_out < 0.005
    np.testing.assert_allclose(listed.log_posterior, scores_of(problem, listed.models), rtol=0.0, atol=0.01)


def test_an_exact_law_is_exact(lorenz):
    nearly = lorenz.fit.regression.record.nearly
    assert nearly.tau == (0.0,) * 3
    assert min(nearly.exact) > 0.4


def test_a_smooth_misfit_is_one_function():
    record, _ = draw_record(5, 0.02)
    few = "x, dx, x**2, x**3, x*dx, dx**3, dx*abs(dx), u"
    ask = {"chains": "x::a", "inputs": ["u"], "dictionary": few, "holdout": 0}
    equation = bq.discover(record.slice(0, 1000), **ask).equations[0]
    nearly = equation.fit.regression.record.nearly
    assert nearly.exact[0] < LIKELIHOOD.nearly_true**3
    assert nearly.tau[0] > 1e-3
    assert set(equation.included) == {"x", "dx", "x**3", "u"}
