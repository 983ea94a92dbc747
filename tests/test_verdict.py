"""What the answer says of itself: the verdict, the rows it counts, and warnings that must not fail to come."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.discovery import question
from bayeq.equation.verdict import judge
from bayeq.errors import DataWarning, InputError
from bayeq.regression.residuals import Fit

OSCILLATOR = {"chains": "x:v:a", "inputs": ["u"]}


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


# --- the verdict -----------------------------------------------------------------------------------------------------


def test_found():
    eq = bq.discover(bq.simulate("duffing", seed=1), **OSCILLATOR)
    assert eq.verdict.kind == eq[0].verdict.kind == "found"
    assert f"R2 {eq[0].held_out.r2:.3g} on the held-out rows" in eq.verdict.reason
    assert str(eq).startswith(f"verdict: found: {eq.verdict.reason}\n")


def test_none_where_little_is_explained(tmp_path):
    rng = np.random.default_rng(0)
    noise = bq.Record.from_arrays(x=rng.normal(size=300), v=rng.normal(size=300), fs=10.0)
    with pytest.warns(DataWarning, match="v: no equation found: the terms explain little of v on the held-out rows"):
        eq = bq.discover(noise, chains="x:v", dictionary="polynomial:2", smooth="band")
    assert eq.verdict.kind == "none"
    assert str(eq).startswith("verdict: none: no equation found: ")
    assert "-0 %" not in str(eq)
    eq.save(tmp_path / "eq.json")
    assert json.loads((tmp_path / "eq.json").read_text())["verdict"] == {
        "kind": "none",
        "reason": eq.verdict.reason,
        "advice": "",
    }
    assert bq.load(tmp_path / "eq.json").verdict == eq.verdict


def test_none_where_free_runs_leave_the_record():
    # rows that fit an equation one by one, and are no motion of it
    rng = np.random.default_rng(0)
    x = rng.normal(size=(300, 2))
    shuffled = bq.Record.from_arrays(x=x[:, 0], dx=-x[:, 0] + 0.01 * x[:, 1], fs=10.0)
    eq = quietly(shuffled, chains="x:dx", dictionary=["x", "x**2"], smooth="none")
    assert eq[0].held_out.r2 > 0.9
    assert eq.scores.free_run["x"] > 0.8
    assert eq.verdict.kind == "none"
    assert "free runs over windows of one period are no better than the mean" in eq.verdict.reason
    assert any("no equation found" in message for message in eq.warnings)


def test_chaotic_motion_is_followed_over_a_period():
    # over all held-out rows a run of Lorenz's system is as far off as the mean, however exact the equations
    eq = quietly(bq.simulate("lorenz", n=8000, seed=1, noise=0.01), chains=["x", "y", "z"], dictionary="polynomial:2")
    assert [set(one.shown) for one in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]
    assert eq.scores.free_run["x"] > 0.5
    assert eq.verdict.kind == "found"


@pytest.mark.parametrize(
    ("r2", "noise", "window", "kind"),
    [
        (0.6, 0.0, None, "found"),
        (0.4, 0.0, None, "none"),
        # the terms explain 0.4 of the 0.5 that is not noise
        (0.4, 0.5, 0.3, "found"),
        (0.2, 0.5, 0.3, "none"),
        (0.9, 0.0, 1.0, "none"),
        (0.9, 0.0, np.inf, "none"),
        (0.9, 0.0, 0.99, "found"),
        (0.0, 0.999, None, "none"),
        # broadband motion that the smoother takes for noise, and the force explains
        (0.98, 0.99, 0.1, "found"),
    ],
)
def test_what_decides(r2, noise, window, kind):
    assert judge("a", Fit(1000, r2, np.sqrt(1 - r2)), True, noise, window).kind == kind


def test_a_system_is_as_bad_as_its_worst_equation():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(400, 2))  # rows in no order: there are no runs
    slow = -x[:, 0] + 0.01 * rng.normal(size=400)
    rec = bq.Record.from_arrays(x=x[:, 0], dx=slow, y=x[:, 1], dy=rng.normal(size=400))
    eq = quietly(rec, chains=["x:dx", "y:dy"], dictionary="polynomial:1")
    assert [one.verdict.kind for one in eq] == ["found", "none"]
    assert eq.verdict == eq["dy"].verdict


# --- rows that count -------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize(("rows", "missing", "held_out"), [(60, 13, False), (400, 80, True)])
def test_counts_are_those_of_measured_rows(rows, missing, held_out):
    # 47 measured rows of 60: fewer than 50, so none is held out, whatever the grid of time has been filled up to
    rec = bq.simulate("linear", n=rows, seed=1, noise=0.02)
    gone = 1 + np.random.default_rng(0).choice(rows - 2, missing, replace=False)
    eq = bq.discover(rec.take(np.delete(np.arange(rows), gone)), **OSCILLATOR, dictionary=["x", "v", "u"])
    assert eq.data.n == rows - missing == eq.data.n_train + eq.data.n_held_out
    assert (eq.data.n_held_out > 0) == held_out
    assert (eq.scores is not None) == held_out
    assert eq[0].train.n == eq.data.n_train
    if held_out:
        assert eq[0].held_out.n == eq.data.n_held_out
        again = eq.score(rec.take(np.delete(np.arange(rows), gone)))
        assert again.one_step["a"] == pytest.approx(eq.scores.one_step["a"], rel=0.05)


def test_a_term_that_cannot_be_read_is_refused_before_the_work(monkeypatch):
    def worked(*_, **__):
        raise AssertionError("smoothed first")

    monkeypatch.setattr(question, "estimate_motion", worked)
    rec = bq.simulate("duffing", n=500, seed=1)
    with pytest.raises(InputError, match="dictionary, term 2"):
        bq.discover(rec, **OSCILLATOR, dictionary="x, sine(x)")
    with pytest.raises(InputError, match="constraint"):
        bq.discover(rec, **OSCILLATOR, constraints="x = 3")


# --- a residual that the channels' noise does not explain -------------------------------------------------------------


def with_unmeasured_force(n, share, seed=3):
    """Duffing records under two forces, of which one is measured; both end at 100 Hz."""
    rec = bq.simulate("duffing", n=n, seed=seed)
    rng = np.random.default_rng(seed)
    white = np.fft.rfft(rng.normal(size=n))
    white[np.fft.rfftfreq(n, 1e-3) > 100.0] = 0.0
    other = np.fft.irfft(white, n)
    return rec.with_channels({"u": rec["u"] - share * np.std(rec["u"]) * other / other.std()})


@pytest.mark.parametrize(("n", "smooth"), [(4000, "auto"), (4000, "band"), (70_000, "band")])
def test_an_unmeasured_force_is_warned_of_at_any_length(n, smooth):
    rec = with_unmeasured_force(n, 0.3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        eq = bq.discover(rec, **OSCILLATOR, dictionary=["x", "v", "x**3", "u"], smooth=smooth)
    assert smooth == "auto" or eq[0].residuals.excess > 1.75
    assert eq.verdict.kind == "nearly true"
    assert smooth == "auto" or any("nearly true" in str(w.message) for w in caught)


def test_an_adequate_residual_of_a_long_record():
    record = bq.simulate("duffing", n=70_000, seed=3)
    eq = bq.discover(record, **OSCILLATOR, dictionary=["x", "v", "x**3", "u"], smooth="band")
    assert eq[0].residuals.excess == pytest.approx(1.0, abs=0.15)


def test_only_inputs_in_the_equation_decide_whether_the_noise_is_known():
    # noise of the force is read above its band; that of a second input, white to half the sampling rate, never
    rec = bq.simulate("duffing", seed=1)
    other = rec.with_channels({"w": np.random.default_rng(0).normal(size=rec.n)})
    eq = bq.discover(other, chains="x:v:a", inputs=["u", "w"], dictionary=["x", "v", "x**3", "u", "w"], smooth="band")
    assert "w" not in eq[0].shown
    assert eq[0].residuals.excess == pytest.approx(1.0, abs=0.15)
