"""Friction that holds a body: what is left of the motion, and what is found of records that come to rest."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from studies.numbers_records import draw_paper, draw_pendulum

import bayeq as bq
from bayeq.likelihood.blur import Hold
from bayeq.likelihood.start import _rounding


def quietly(records, **question):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **question)


def test_a_body_that_is_held_stops_and_stays():
    """x and v over a step of h: the force that stops v by its end moves x by h v / 2, half as far as without."""
    h, x, v = 0.1, 2.0, 0.3
    push = np.array([[[0.5 * h**2], [h]]])
    hold = Hold(0, np.array([0]), np.array([[-4.0]]), np.array([[0.0, 1.0]]), np.zeros(1), 1e9)
    left, moved = hold.projectors(push)
    free = np.array([x + h * v + 0.5 * h**2 * 7.0, v + h * 7.0])  # under any other force, here 7
    np.testing.assert_allclose(left[0] @ free + moved[0], [x + 0.5 * h * v, 0.0], atol=1e-15)
    np.testing.assert_allclose(left[0] @ push[0, :, 0], 0.0, atol=1e-15)


@given(v1=st.floats(-1.0, 1.0), v2=st.floats(-1.0, 1.0), ratio=st.floats(0.1, 10.0), belt=st.floats(-1.0, 1.0))
def test_two_masses_that_hold_each_other_keep_their_momentum(v1, v2, ratio, belt):
    """States x1, v1, x2, v2; friction between them acts on both, by 1 and by -1/ratio; held is v1 - v2 - belt."""
    h = 0.01
    push = np.array([[[0.5 * h**2, 0.0], [h, 0.0], [0.0, 0.5 * h**2], [0.0, h]]])
    hold = Hold(0, np.array([0]), np.array([[-1.0, 1.0 / ratio]]), np.array([[0.0, 1, 0, -1]]), np.array([-belt]), 1e9)
    left, moved = hold.projectors(push)
    after = left[0] @ [0.0, v1, 0.0, v2] + moved[0]
    assert after[1] - after[3] == pytest.approx(belt, abs=1e-12)
    assert after[1] + ratio * after[3] == pytest.approx(v1 + ratio * v2, abs=1e-12)


@given(step=st.floats(1e-6, 1e3), seed=st.integers(0, 100))
def test_rounding_is_read_from_the_samples(step, seed):
    values = np.random.default_rng(seed).normal(size=300)
    assert _rounding(step * np.round(20.0 * values)) == pytest.approx(step**2 / 12.0, rel=1e-6)
    assert _rounding(values) == _rounding(np.full(5, step)) == _rounding(step * np.arange(9)) == 0.0


SOME = ("x", "dx", "sign(dx)", "x**2", "x**3", "x*dx", "dx*abs(dx)", "x*abs(x)")


@pytest.mark.parametrize(
    ("seed", "dictionary"),
    [
        (60036, SOME),
        pytest.param(60036, "oscillator", marks=pytest.mark.slow),
        pytest.param(60024, "oscillator", marks=pytest.mark.slow),
    ],
)
def test_an_oscillator_with_coulomb_friction_comes_to_rest(seed, dictionary):
    """Until 2.4 of 4 s it is at rest; of 36 terms seven and more were found before jumps could hold."""
    record, question, truth = draw_paper(seed, "coulomb", "x::", 0.05, free=True, all_terms=True)
    equation = quietly(record, **{**question, "dictionary": dictionary})[0]
    assert equation.verdict.kind == "found"
    assert set(equation.shown) == set(truth["ddx"])
    intervals = dict(zip((term.text for term in equation.terms), equation.shown_ci95, strict=True))
    for term, value in truth["ddx"].items():
        low, high = intervals[term]
        assert abs(equation.shown_coef[term] - value) < high - low


def test_a_body_that_is_held_has_no_acceleration():
    """An accelerometer beside the displacement: where a sample of it was thought to be of the force without friction,
    known to within friction, the stiffness came out far too sure, and friction was left out."""
    record, question, truth = draw_paper(60003, "coulomb", "x::a", 0.05, free=True, all_terms=False)
    equation = quietly(record, **{**question, "holdout": 0.0})[0]
    assert equation.shown_coef["x"] == pytest.approx(truth["a"]["x"], rel=1e-3)
    assert equation.shown_coef["sign(dx)"] == pytest.approx(truth["a"]["sign(dx)"], rel=0.05)


def test_a_pendulum_with_an_encoder_comes_to_rest():
    """Its held-out part is at rest at one value: the noise is no less than that of rounding, and runs are given up by
    the range of the whole motion."""
    record, question, truth = draw_pendulum(40005, rows=6000, fs=100.0)
    equation = quietly(record, **question)[0]
    assert equation.verdict.kind != "none"
    assert set(equation.shown) == set(truth["ddth"])
    assert equation.shown_coef["sign(dth)"] == pytest.approx(truth["ddth"]["sign(dth)"], rel=0.01)
