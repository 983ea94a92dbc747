"""Inputs between their samples: the motion tells how they go, and what cannot be known of it is no discrepancy."""

from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lsim
from studies.forces import draw_record

import bayeq as bq
from bayeq.equation.applied import apply_to
from bayeq.equation.selection.excitation import repeating
from bayeq.errors import BayeqWarning
from bayeq.expressions import parse
from bayeq.likelihood import courses
from bayeq.states import Roles, estimate_motion


@pytest.mark.parametrize(
    ("kind", "noise", "course"),
    [
        pytest.param("straight", 0.003, "linear", marks=pytest.mark.slow),  # as below
        ("held", 0.003, "hold"),
        pytest.param("taps", 0.02, None, marks=pytest.mark.slow),  # between its samples as forces of other tests
        pytest.param("blows", 0.0, None, marks=pytest.mark.slow),
    ],
)
def test_an_exact_law_is_found_whatever_its_force_does(kind, noise, course):
    record, truth = draw_record(kind, (noise, noise), 21)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(record, chains="x:v:a", inputs=["u"])
    assert set(eq[0].included) == set(truth["a"])
    assert eq.verdict.kind == "found"
    # an acceleration of the interval that a step begins is half a sample ahead of the derivative of x, and says so
    # where the force is not held
    assert not any("correct_delay" in message for message in eq.warnings)
    found = eq[0].fit.regression.record
    assert found.kappa[0] < 0.01
    if course is not None:
        assert found.task.layout.courses == (course,)
        assert eq.data.interpolation == {"u": course}
        assert f"u between samples: {'held' if course == 'hold' else 'straight lines'}" in str(eq)
    p = eq[0].posterior
    for name, value in truth["a"].items():
        j = p.names.index(name)
        assert abs(p.coef[j] - value) < 5.0 * p.sd[j]


@pytest.mark.parametrize("kind", [pytest.param("hold", marks=pytest.mark.slow), "linear"])
def test_runs_are_driven_by_inputs_as_they_were_found(kind, tmp_path):
    record, unseen = commanded(1, kind).slice(0, 500), commanded(2, kind).slice(0, 1200)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u, v*abs(v)")
        assert eq.verdict.kind == "found"
        assert eq.data.interpolation == {"u": kind}
        # of 1 % noise in what they are compared with, and steps of the force that take 1 ms: a spline errs by 13, 22 %
        assert max(eq.scores.free_run.values()) < 0.04
        eq.save(tmp_path / "eq.json")
        again = bq.load(tmp_path / "eq.json")
        assert again.to_dict() == eq.to_dict()
        assert eq.simulate(unseen, draws=0).nrmse["x"] < 0.04
        assert max(again.score(unseen, start=0).free_run.values()) < 0.04
        assert again.simulate(unseen, draws=0).nrmse["x"] < 0.04
        assert again.simulate(unseen, draws=0, interpolation="cubic").nrmse["x"] > 0.1
        for name in ("x", "v", "a"):  # the smoother alone takes the noise of v for motion that jumps
            assert again.data.noise_sd[name] == pytest.approx(0.01 * unseen[name].std(), rel=0.2)
        applied = apply_to(again, [unseen])
        assert min(error.inside for error in applied.free_run.values()) > 0.9
        assert max(applied.windows.values()) < 0.04
        refined = again.refine(record).refined  # None where its runs are no better
        assert refined is None or refined.interpolation == kind
    assert eq.to_dict()["data"]["interpolation"] == {"u": kind}
    assert f"u between samples: {'held' if kind == 'hold' else 'straight lines'}" in str(eq)


def commanded(seed, kind):
    """A Duffing oscillator with 20 samples a second, 20 a period, and a force that is held or straight between them."""
    rng = np.random.default_rng(seed)
    clean = np.convolve(rng.standard_normal(1552), np.ones(3) / 3.0, "valid")[:1500] * 20.0
    fine = np.arange(50 * 1500 - 49) / 50.0
    force = clean[fine.astype(int)] if kind == "hold" else np.interp(fine, np.arange(1500), clean)
    motion = bq.simulate(
        "duffing",
        n=len(fine),
        fs=1000.0,
        noise=0.0,
        force=force,
        parameters={"m": 1.0, "c": 0.6, "k": 40.0, "k3": 60.0},
    )
    channels = {name: np.asarray(motion[name])[::50] for name in ("x", "v", "a")}
    noisy = {name: values + 0.01 * values.std() * rng.standard_normal(1500) for name, values in channels.items()}
    return bq.Record.from_arrays({**noisy, "u": clean}, fs=20.0)


def test_a_force_that_is_smaller_than_the_noise_of_the_input_is_none():
    # noise of u alone: by the model of its course it is as well a force
    record, truth = draw_record("straight", (0.0, 0.0), 4)
    u = record["u"] + 0.003 * record["u"].std() * np.random.default_rng(3).standard_normal(record.n)
    few = [*truth["a"], "x**2", "x*v", "v*abs(v)", "x**2*v"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        asked = {"chains": "x:v:a", "inputs": ["u"], "dictionary": few, "holdout": 0.0}
        eq = bq.discover(record.with_channels({"u": u}), **asked)
    assert set(eq[0].included) == set(truth["a"])
    assert eq[0].fit.regression.record.adequacy.lacks(0) is None


def test_a_single_row_has_no_frequency():
    motion = estimate_motion([bq.simulate("duffing", n=12, seed=1)], Roles.parse("x:v:a", inputs=["u"]))
    assert repeating(replace(motion, cuts=(1,)), [parse("x", ["x"])]) is None


def test_a_held_input_behind_a_lag_is_no_further_term():
    """A straight course is half a sample early; f + dt/(2 tau) (f - u) in place of f makes up for that."""
    rng = np.random.default_rng(1)
    step = expm(np.array([[0, 1, 0, 0], [-400, -2, 1, 0], [0, 0, -50, 50], [0, 0, 0, 0]]) / 500.0)
    force, states = np.repeat(10.0 * rng.standard_normal(80), 10), np.zeros((801, 4))
    for i, value in enumerate(force):
        states[i, 3] = value
        states[i + 1] = step @ states[i]
    x, v, _, u = states[:-1].T
    measured = {name: s + 0.01 * s.std() * rng.standard_normal(800) for name, s in {"x": x, "v": v}.items()}
    record = bq.Record.from_arrays({**measured, "u": u}, fs=500.0)
    asked = {"chains": "x:v:", "inputs": ["u"], "dictionary": "x, v, f, u", "law": "df = (u - f)/{tau}"}
    eq = bq.discover(record, **asked, holdout=0.0)
    assert eq[0].included == ("x", "v", "f")
    assert eq[0].coef["f"] == pytest.approx(1.0, rel=0.02)


def test_coefficients_are_spread_over_courses_that_are_nearly_as_likely():
    tried = [
        courses.Tried(
            SimpleNamespace(
                layout=SimpleNamespace(courses=(course,)), precision=np.ones(3), number=lambda chosen: chosen
            ),
            SimpleNamespace(state=SimpleNamespace(chosen=np.array([0, 2]), theta=np.array(theta))),
            log,
        )
        for course, theta, log in (
            ("smooth", [1.0, 2.0], 10.0),
            ("linear", [1.1, 2.0], 12.0),
            ("hold", [9.0, 9.0], -90.0),
        )
    ]
    found = courses.spread_over(tried, "smooth", 0)
    weight = np.exp(12.0 - courses.CLEARLY) / (np.exp(10.0) + np.exp(12.0 - courses.CLEARLY))
    np.testing.assert_allclose(found, weight * np.outer([0.1, 0.0, 0.0], [0.1, 0.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_smooth_force_stays_smooth_unless_the_motion_clearly_tells(seed):
    fine = np.arange(12_000) / 4000.0
    force = 30.0 * np.sin(2.0 * np.pi * np.multiply.outer(fine, [3.1, 7.7, 12.9, 21.3])).sum(axis=1)
    law = [[0.0, 1.0], [-1600.0, -4.0]], [[0.0], [0.3125]], np.eye(2), np.zeros((2, 1))
    x, v = lsim(law, force, fine)[1][::10].T
    t, force = fine[::10], force[::10]
    a = 0.3125 * force - 4.0 * v - 1600.0 * x
    rng = np.random.default_rng(seed)
    channels = {"x": x, "a": a, "u": force}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(1200) for name, one in channels.items()}
    asked = {"chains": "x::a", "inputs": ["u"], "dictionary": "x, dx, u", "holdout": 0.0}
    eq = bq.discover(bq.Record.from_arrays(noisy, time=t), **asked)
    low, high = dict(zip([term.text for term in eq[0].terms], eq[0].ci95.tolist(), strict=True))["u"]
    assert low < 0.3125 < high
