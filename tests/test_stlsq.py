from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.errors import InputError
from bayeq.inference.gram import Gram
from bayeq.inference.stlsq import least_squares, stlsq, sweep_stlsq
from tests import reference


@cache
def matrices(name):
    if name == "duffing":
        rec = bq.simulate("duffing", seed=0)
        terms, y = build_dictionary("oscillator", Variables(("x", "v"), ("u",))), rec["a"]
    else:
        rec = bq.simulate("lorenz", seed=0, noise=0.01)
        terms, y = build_dictionary("polynomial:3", Variables(("x", "y", "z"))), rec.truth.clean["dy"]
    return evaluate_terms(terms, rec.channels), np.array(y)


@pytest.mark.parametrize("name", ["duffing", "lorenz"])
@pytest.mark.parametrize("alpha", [1e-3, 0.05, 1.0])
@pytest.mark.parametrize("threshold", [0.01, 0.1, 1.0, 10.0])
def test_agrees_with_pysindy(name, alpha, threshold):
    # raw columns, no intercept, unbias=False: its refit by LinearRegression has a cutoff that moves ill-conditioned
    # fits by several per cent
    pysindy = pytest.importorskip("pysindy", reason="PySINDy is not installed (bayeq[peers])")
    D, y = matrices(name)
    peer = pysindy.STLSQ(threshold=threshold, alpha=alpha, unbias=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        peer.fit(D, y[:, None])
    theirs = np.ravel(peer.coef_)
    ours = stlsq(Gram.from_data(D, y), threshold=threshold, ridge=alpha, centred=False)
    np.testing.assert_array_equal(ours.support, theirs != 0)
    np.testing.assert_allclose(ours.coef, theirs, rtol=1e-9)
    assert ours.intercept == 0.0


@pytest.mark.parametrize("ridge", [0.0, 0.3])
def test_least_squares_on_chosen_columns(ridge):
    D, y, _ = reference.random_problem(np.random.default_rng(0), n=60, P=6)
    D *= 10.0 ** np.arange(-6, 6, 2)
    active = np.array([True, False, True, True, False, True])
    out = np.empty(6)
    least_squares(D.T @ D, D.T @ y, active, ridge, out)
    Z = D[:, active]
    stacked = np.vstack([Z, np.sqrt(ridge) * np.eye(4)])
    scale = np.linalg.norm(stacked, axis=0)
    expected = np.linalg.lstsq(stacked / scale, np.append(y, np.zeros(4)), rcond=None)[0] / scale
    np.testing.assert_allclose(out[active], expected, rtol=1e-9)
    assert not out[~active].any()


def test_a_dependent_column_gets_nothing():
    rng = np.random.default_rng(1)
    D = rng.normal(size=(50, 2))
    D = np.column_stack([D, D.sum(axis=1)])
    out = np.empty(3)
    least_squares(D.T @ D, D.T @ D[:, 0], np.ones(3, dtype=bool), 0.0, out)
    np.testing.assert_allclose(out, [1, 0, 0], atol=1e-12)


def test_intercept_and_prediction():
    D, y, _ = reference.random_problem(np.random.default_rng(2), n=200, P=4, noise=0.1)
    D, y = D + 5.0, D @ [1.0, 0.0, -2.0, 0.0] + 7.0
    fit = stlsq(Gram.from_data(D, y), threshold=0.5, ridge=0.0)
    assert fit.support.tolist() == [True, False, True, False]
    np.testing.assert_allclose(fit.predict(D), y, rtol=1e-9)


@pytest.mark.parametrize("columns", ["standardised", "raw"])
def test_a_sweep_keeps_the_least_held_out_error(columns):
    D, y = matrices("duffing")
    train, test = Gram.from_data(D[:2000], y[:2000]), Gram.from_data(D[2000:], y[2000:])
    fit = sweep_stlsq(train, held_out=test, columns=columns)
    work = train.standardise() if columns == "standardised" else None
    gram = work.gram if work else train
    best = test.squared_error(fit.coef, fit.intercept)
    # the twin: every threshold by itself, its error from the samples
    full = stlsq(gram, threshold=0.0, ridge=0.0).coef
    for threshold in np.geomspace(np.abs(full).min(), np.abs(full).max(), 60):
        one = stlsq(gram, threshold=threshold, ridge=0.0)
        one = one.rescaled(work) if work else one
        error = np.sum((y[2000:] - one.predict(D[2000:])) ** 2)
        assert best <= error * (1 + 1e-6)
    direct = np.sum((y[2000:] - fit.predict(D[2000:])) ** 2)
    assert best == pytest.approx(direct, rel=1e-6)


def test_without_held_out_rows_the_information_criterion_decides():
    D, y, truth = reference.random_problem(np.random.default_rng(5), n=400, P=8, rho=0.3, noise=0.05, active=0.4)
    fit = sweep_stlsq(Gram.from_data(D, y))
    assert fit.support[truth].all() or truth.sum() == 0


def test_arguments_out_of_range():
    gram = Gram.from_data(*matrices("lorenz"))
    for options in ({"threshold": -1.0}, {"ridge": -1.0}, {"max_iter": 0}):
        with pytest.raises(InputError):
            stlsq(gram, **options)
