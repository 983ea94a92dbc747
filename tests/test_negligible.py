"""Certain, and of no practical difference."""

from __future__ import annotations

import numpy as np
import pytest
from studies.discrepancy import draw_record

import bayeq as bq
from bayeq.errors import InputError
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.rows import Rows
from bayeq.forecast.windows import apart, typical_period, window_runs
from bayeq.ode.rk4 import interpolant

DUFFING = {"x", "v", "x**3", "u"}
OSCILLATOR = {"chains": "x:v:a", "inputs": ["u"]}


@pytest.fixture(scope="module")
def hysteretic():
    return draw_record("bouc-wen", 0.05, seed=0, rows=40_000)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_terms_that_stand_in_for_what_the_dictionary_lacks_stand_beside(hysteretic):
    shown = bq.discover(hysteretic, **OSCILLATOR)[0]
    everything = bq.discover(hysteretic, **OSCILLATOR, negligible=0.0)[0]
    assert set(shown.included) == DUFFING < set(everything.included)
    assert {left.name for left in shown.left_out} == set(everything.included) - DUFFING
    for left in shown.left_out:
        assert left.reason == "negligible"
        assert left.share < 4e-5
        assert left.pip > 0.5
    assert "certain, but negligible: " in str(bq.discover(hysteretic, **OSCILLATOR))


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_limits_of_one_s_own_take_the_place_of_the_rule(hysteretic):
    eq = bq.discover(hysteretic, **OSCILLATOR, max_terms=30)[0]
    assert len(eq.included) > 4
    assert eq.left_out == ()


def test_the_damping_of_a_light_structure_stays():
    # damping ratio 0.3 %: v explains 3e-5 of the variance, and without it a run is nowhere after a hundred periods
    rec = bq.simulate("linear", n=20_000, seed=3, noise={"a": 0.01}, parameters={"c": 0.2})
    eq = bq.discover(rec, **OSCILLATOR)[0]
    share = dict(zip((t.text for t in eq.terms), eq.share, strict=True))
    assert share["v"] < 4e-5
    assert set(eq.included) == {"x", "v", "u"}


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_small_and_without_effect_and_yet_true_is_told():
    # a cubic stiffness that shifts the period by some 0.01 %: certain with noise this small
    rec = bq.simulate("duffing", n=15_000, seed=3, noise={"a": 1e-4}, parameters={"k3": 20.0})
    eq = bq.discover(rec, **OSCILLATOR)[0]
    assert set(eq.included) == {"x", "v", "u"}
    assert [left.name for left in eq.left_out] == ["x**3"]
    assert set(bq.discover(rec, **OSCILLATOR, negligible=0)[0].included) == DUFFING


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_errors_of_windows_are_those_of_simulate():
    rec = bq.simulate("linear", n=400, seed=3, noise=0.0)
    eq = bq.discover(rec, **OSCILLATOR, dictionary=["x", "u"], holdout=0.0, negligible=0.0)
    rows = Rows(rec.time, rec.channels, {}, interpolant(rec.time, rec["u"][:, None], "cubic"))
    posteriors = [e.posterior for e in eq]
    dynamics = Dynamics.of(eq.chains, eq.inputs, posteriors, [e.terms for e in eq])
    assert typical_period(dynamics, [rows]) == pytest.approx(2 * np.pi * rec["x"].std() / rec["v"].std())
    ours = apart(window_runs(dynamics, dynamics.means(posteriors), [rows], 0.1))
    scale = {name: rec[name].std() for name in "xv"}
    errors = []
    for first in np.linspace(0, 400 - 101, 12).astype(int):
        read = {name: float(rec[name][first]) for name in "xv"}
        run = eq.simulate(rec, start=int(first), rows=101, draws=0, initial=read)
        errors.append(np.sqrt(np.mean([((run.mean[n] - rec[n][first : first + 101]) / scale[n]) ** 2 for n in "xv"])))
    assert ours == pytest.approx(np.median(errors), rel=1e-3)


@pytest.mark.parametrize("value", [-0.1, 1.0, np.nan])
def test_shares_out_of_range(value):
    with pytest.raises(InputError, match="negligible"):
        bq.discover(bq.simulate("linear", n=100), **OSCILLATOR, negligible=value)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_short_records_without_noise_show_the_law_alone():
    # the force between the samples is not what the smoother takes it for; terms come in that stand for the difference
    rec = bq.simulate("quadratic", seed=3, noise=0)
    options = {"chains": "x:v:", "inputs": ["u"]}
    assert set(bq.discover(rec, **options)[0].included) == {"x", "v", "v*abs(v)", "u"}
    everything = bq.discover(rec, **options, negligible=0)[0]
    assert {left.name for left in bq.discover(rec, **options)[0].left_out} == (
        set(everything.included) - {"x", "v", "v*abs(v)", "u"}
    )


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_form_that_free_runs_leave_undecided_is_told_of():
    # friction that is partly viscous and partly dry; over a hundred periods either kind alone follows the motion
    rng = np.random.default_rng(0)
    t = np.arange(15_000) / 200.0
    th, w, states = 1.0, 0.0, []
    for _ in t:
        states.append((th, w))
        for _ in range(5):  # semi-implicit Euler steps of 1 ms
            w += 1e-3 * (-39.5 * np.sin(th) - 0.02 * w - 0.01 * np.sign(w))
            th += 1e-3 * w
    th, w = np.array(states).T
    rec = bq.Record.from_arrays(
        time=t, th=th + 5e-4 * rng.standard_normal(len(t)), w=w + 5e-3 * rng.standard_normal(len(t))
    )
    eq = bq.discover(rec, chains="th:w:", dictionary=["th", "sin(th)", "w", "w*abs(w)", "sign(w)"])
    assert "sin(th)" in eq[0].included
    friction = {"w", "w*abs(w)", "sign(w)"}
    (shown,) = friction & set(eq[0].included)
    told = [message for message in eq.warnings if "its form is undecided" in message]
    assert len(told) == 1
    assert told[0].startswith(f"ddth: {shown} is needed, but its form is undecided: with ")
