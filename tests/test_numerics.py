"""Numerical methods against SciPy's: minima within bounds, cubic splines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize, rosen, rosen_der

from bayeq.numerics.minimise import minimise
from bayeq.numerics.spline import spline_slopes
from tests.draws import draws


def box(rng, n):
    """Some bounds, each with probability 1/2."""
    lower = rng.normal(size=n) - 1.0
    upper = lower + rng.uniform(0.0, 3.0, size=n)
    return np.where(rng.random(n) < 0.5, lower, -math.inf), np.where(rng.random(n) < 0.5, upper, math.inf)


def by_scipy(fun, start, lower, upper):
    return minimize(
        fun,
        np.clip(start, lower, upper),
        jac=True,
        method="L-BFGS-B",
        bounds=list(zip(lower, upper, strict=True)),
        options={"ftol": 0.0, "gtol": 1e-9, "maxiter": 1000},
    )


@given(seed=st.integers(0, 10**6), n=st.integers(1, 10))
@settings(max_examples=draws(60), deadline=None)
def test_a_convex_function_has_the_minimum_of_scipy_within_bounds(seed, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2 * n, n)) * 10 ** rng.uniform(-1, 1, size=n)
    b = rng.normal(size=2 * n)
    lower, upper = box(rng, n)

    def fun(x):
        r = A @ x - b
        return float(np.sum(np.logaddexp(r, -r))) + 0.01 * x @ x, A.T @ np.tanh(r) + 0.02 * x

    start = rng.normal(size=n)
    found = minimise(fun, start, lower, upper, gradient_tolerance=1e-9, value_tolerance=0.0)
    assert (lower <= found.x).all()
    assert (found.x <= upper).all()
    assert found.value == fun(found.x)[0]
    slow = by_scipy(fun, start, lower, upper)
    assert found.value <= slow.fun + 1e-12 * abs(slow.fun)
    np.testing.assert_allclose(found.x, slow.x, rtol=1e-4, atol=1e-5)
    projected = found.x - np.clip(found.x - found.gradient, lower, upper)
    # columns of A are as large as 10, rounding of the sum of squares leaves this much
    assert np.abs(projected).max() < 1e-5


@pytest.mark.parametrize("n", [2, 5, 10])
def test_a_curved_valley_is_followed(n):
    points = []

    def fun(x):
        points.append(x)
        return rosen(x), rosen_der(x)

    found = minimise(fun, np.full(n, 1.5), gradient_tolerance=1e-8)
    assert found.converged
    np.testing.assert_allclose(found.x, 1.0, atol=1e-7)
    slow = by_scipy(lambda x: (rosen(x), rosen_der(x)), np.full(n, 1.5), np.full(n, -np.inf), np.full(n, np.inf))
    assert len(points) < 2 * slow.nfev


def test_a_minimum_in_a_corner_is_reached_exactly():
    found = minimise(lambda x: (x.sum(), np.ones(3)), [3.0, 2.0, 1.0], [0.0, 1.0, -1.0])
    assert found.x.tolist() == [0.0, 1.0, -1.0]
    assert found.converged


def test_equal_bounds_hold_a_parameter():
    found = minimise(lambda x: (float(np.sum((x - 3.0) ** 2)), 2 * (x - 3.0)), [0.0, 0.0], [-5.0, 1.0], [5.0, 1.0])
    np.testing.assert_allclose(found.x, [3.0, 1.0], atol=1e-6)


def test_where_the_value_is_not_finite_steps_are_cut():
    def fun(x):
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(x[0] - np.log(x[0])), 1.0 - 1.0 / x

    found = minimise(fun, [30.0])
    assert found.converged
    np.testing.assert_allclose(found.x, 1.0, atol=1e-5)


@given(seed=st.integers(0, 10**6), n=st.integers(1, 8))
@settings(max_examples=draws(30), deadline=None)
def test_with_its_hessian_a_quadratic_function_takes_one_step(seed, n):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(2 * n, n))
    hessian, centre, points = A.T @ A + np.eye(n), rng.normal(size=n), []

    def fun(x):
        points.append(x)
        pull = hessian @ (x - centre)
        return 0.5 * float((x - centre) @ pull), pull

    found = minimise(fun, centre + rng.normal(size=n), hessian=hessian)
    assert found.converged
    assert len(points) <= 3  # the start, the minimum, and rounding
    np.testing.assert_allclose(found.x, centre, atol=1e-6)
    # what it has learnt is still that: an update with an exact difference changes nothing
    np.testing.assert_allclose(found.hessian, hessian, rtol=1e-6, atol=1e-6 * np.abs(hessian).max())


def test_a_wrong_hessian_only_takes_longer():
    start = np.full(4, 1.5)
    for hessian in (1e-3 * np.eye(4), 1e3 * np.eye(4)):
        found = minimise(lambda x: (rosen(x), rosen_der(x)), start, hessian=hessian, gradient_tolerance=1e-8)
        np.testing.assert_allclose(found.x, 1.0, atol=1e-7)


def test_steps_are_no_longer_than_allowed():
    points = []

    def fun(x):
        points.append(x.copy())
        return float(np.sum((x - 50.0) ** 2)), 2.0 * (x - 50.0)

    found = minimise(fun, [0.0, 49.0], hessian=2.0 * np.eye(2), longest=[3.0, 10.0])
    np.testing.assert_allclose(found.x, 50.0)
    # the direction is kept: the other parameter moves as much less
    np.testing.assert_allclose(points[1], [3.0, 49.06])


def test_what_it_cannot_minimise_has_not_converged():
    assert not minimise(lambda x: (math.nan, x), [1.0]).converged
    # a gradient of the wrong sign
    assert not minimise(lambda x: (float(x @ x), -2 * x), [1.0]).converged
    assert not minimise(lambda x: (rosen(x), rosen_der(x)), [-1.2, 1.0], most_steps=3).converged


def test_nothing_to_minimise_over():
    found = minimise(lambda x: (1.0, x), np.empty(0))
    assert found.converged
    assert found.value == 1.0


@given(seed=st.integers(0, 10**6), n=st.integers(2, 40), m=st.integers(1, 3))
@settings(max_examples=draws(60), deadline=None)
def test_slopes_of_splines_are_those_of_scipy(seed, n, m):
    rng = np.random.default_rng(seed)
    time = np.cumsum(10 ** rng.uniform(-1, 1, size=n))
    samples = rng.normal(size=(n, m))
    slow = CubicSpline(time, samples)(time, 1)
    np.testing.assert_allclose(spline_slopes(time, samples), slow, rtol=1e-9, atol=1e-10 * np.abs(slow).max())


def test_splines_reproduce_cubics_and_converge_by_the_third_order():
    time = np.cumsum(np.random.default_rng(0).uniform(0.1, 1.0, size=20))
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.3])
    np.testing.assert_allclose(spline_slopes(time, cubic(time)[:, None])[:, 0], cubic.deriv()(time), rtol=1e-10)
    errors = []
    for n in (100, 200):
        t = np.linspace(0.0, 6.0, n + 1)
        errors.append(np.abs(spline_slopes(t, np.sin(t)[:, None])[:, 0] - np.cos(t)).max())
    assert errors[0] / errors[1] > 7.0
