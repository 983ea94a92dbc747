"""What the answer says of itself: the verdict, the rows it counts, and warnings that must not fail to come."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from studies.numbers_records import draw_heater

import bayeq as bq
from bayeq.discovery import question
from bayeq.equation.brief import brief
from bayeq.equation.verdict import ByRuns, Verdict, Window, _window, judge, with_clipping
from bayeq.errors import DataWarning, InputError
from bayeq.inference import gibbs
from bayeq.likelihood import spike
from bayeq.regression.residuals import Fit
from bayeq.study import dysts

OSCILLATOR = {"chains": "x:v:a", "inputs": ["u"]}


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


# --- the verdict -----------------------------------------------------------------------------------------------------


def test_found():
    eq = bq.discover(bq.simulate("duffing", n=1000, seed=1), **OSCILLATOR)
    assert eq.verdict.kind == eq[0].verdict.kind == "found"
    assert f"R2 {eq[0].held_out.r2:.3g} on the held-out rows" in eq.verdict.reason
    assert str(eq).startswith(f"verdict: found: {eq.verdict.reason}\n")


def test_none_where_little_is_explained(tmp_path):
    rng = np.random.default_rng(0)
    noise = bq.Record.from_arrays(x=rng.normal(size=300), v=rng.normal(size=300), fs=10.0)
    with pytest.warns(DataWarning, match="v: no equation: the terms explain little on the held-out rows"):
        eq = bq.discover(noise, chains="x:v", dictionary="polynomial:2", smooth="none")
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
    assert "started from a measured state the equation is wrong within one period" in eq.verdict.reason
    assert any("no equation: " in message for message in eq.warnings)


def test_chaotic_motion_is_followed_over_a_period():
    # over all held-out rows a run of Lorenz's system is as far off as the mean, however exact the equations
    eq = quietly(bq.simulate("lorenz", n=5000, seed=1, noise=0.01), chains=["x", "y", "z"], dictionary="polynomial:2")
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
    runs = None if window is None else Window(2.0 * window, window)  # half of the error is that of the first state
    assert judge("a", Fit(1000, r2, np.sqrt(1 - r2)), True, noise, runs).kind == kind


@pytest.mark.parametrize(
    ("r2", "noise", "share", "kind", "why"),
    [
        # of the 0.4 above the error of the estimate the terms explain 0.3, or 0.1
        (0.3, 0.6, 1.0, "found", "R2 0.3 on the held-out rows; free runs over"),
        (0.1, 0.6, 1.0, "none", "the terms explain little of a"),
        # little is left above the error of the estimate: runs decide
        (-0.5, 0.95, 1.0, "found", "free runs over one period within 60 %"),
        # rows at rest
        (-3.0, 0.0, 0.05, "found", "R2 0.8 on the held-out rows, at rest, by the variance of the whole motion"),
        (-30.0, 0.0, 0.05, "none", "R2 -0.55, worse than the mean, at rest, by the variance of the whole motion"),
        # rows that move, though less than others
        (-0.5, 0.0, 0.2, "none", "the terms explain little of a"),
    ],
)
def test_what_decides_on_a_target_that_is_estimated(r2, noise, share, kind, why):
    fit = Fit(1000, r2, np.sqrt(1 - r2))
    verdict = judge("a", fit, True, noise, Window(0.6, 0.3), share)
    assert verdict.kind == kind
    assert why in verdict.reason
    assert judge("a", fit, True, noise, Window(1.0, 1.0), share).kind == "none"


def solved(rate, start, seconds, rows):
    t = np.linspace(0.0, seconds, rows)
    return t, solve_ivp(lambda _, x: rate(x), (0.0, seconds), start, t_eval=t, rtol=1e-10, atol=1e-12).y


def noisy(states, share, seed):
    rng = np.random.default_rng(seed)
    return [x + share * x.std() * rng.normal(size=len(x)) for x in states]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_an_epidemic_that_is_over_is_found(seed):
    t, states = solved(lambda x: [-1.5 * x[0] * x[1], 1.5 * x[0] * x[1] - 0.4 * x[1]], [0.99, 0.01], 30.0, 300)
    s, i = noisy(states, 0.02, seed)
    eq = quietly(bq.Record.from_arrays(S=s, I=i, time=t), chains=["S", "I"], dictionary="polynomial:2")
    assert [set(one.shown) for one in eq] == [{"S*I"}, {"I", "S*I"}]
    assert eq.verdict.kind == "found"
    # the last rows hardly move, and what a smoother makes of them are a few numbers
    assert "free runs over one period" in eq.verdict.reason
    # no equation of other terms is
    wrong = quietly(bq.Record.from_arrays(S=s, I=i, time=t), chains=["S", "I"], dictionary="polynomial:1")
    assert wrong.verdict.kind != "found"


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_ring_down_that_has_died_out_is_not_none(seed):
    t, states = solved(lambda x: [x[1], -0.5 * x[1] - 25.0 * x[0]], [1.0, 0.0], 24.0, 1200)
    x, _ = noisy(states, 0.02, seed)
    eq = quietly(bq.Record.from_arrays(x=x, time=t), chains="x::", dictionary=["x", "x**2", "x**3", "dx", "dx**3"])
    assert set(eq[0].shown) == {"x", "dx"}
    assert eq.verdict.kind != "none"


def test_an_equation_without_terms_is_none():
    walk = np.random.default_rng(1).normal(size=400).cumsum()  # nothing but chance moves it
    eq = quietly(bq.Record.from_arrays(x=walk.cumsum(), fs=10.0), chains="x::", dictionary=["x", "dx", "x**3"])
    assert not eq[0].shown
    assert eq.verdict.kind == "none"
    assert eq[0].verdict.reason == "no equation found: no candidate term is in the equation"


def test_terms_that_only_all_rows_ask_for_are_not_determined():
    # a heater behind a slow sensor: without the last fifth the fit has no term
    record, question, truth = draw_heater(200_000, lag=20.0)
    (eq,) = quietly(record, **question)
    assert eq.scored.shown == ()
    assert eq.shown == ("T",)
    assert eq.verdict.kind == "not determined"
    assert eq.shown_coef["T"] == pytest.approx(truth["dT"]["T"], rel=0.25)


def test_an_engine_that_did_not_converge_finds_nothing(monkeypatch):
    # chains of a few sweeps are told from others that have settled by their R-hat
    monkeypatch.setattr(gibbs, "RHAT_LIMIT", 1.0)
    eq = quietly(
        bq.simulate("duffing", n=1000, seed=1), **OSCILLATOR, dictionary=["x", "v", "x**3", "u"], method="gibbs"
    )
    assert not eq[0].posterior.details.converged
    assert eq.verdict.kind == "not determined"
    assert "did not converge" in eq.verdict.reason
    assert eq.verdict.advice == "give fewer candidate terms, or compare with another method"


def test_an_equation_whose_terms_are_settled_is_found_beside_one_of_a_search_stopped_early(monkeypatch):
    averaged = spike.spike_slab_bma

    def stopped(*args, **options):
        found = averaged(*args, **options)
        return replace(found, details=replace(found.details, converged=False, unsettled=(found.names[0],)))

    monkeypatch.setattr(spike, "spike_slab_bma", stopped)
    eqs = quietly(
        bq.simulate("lorenz", n=500, seed=1), chains=["x", "y", "z"], dictionary=["x", "y", "x*y", "x*z", "z"]
    )
    assert [one.verdict.kind for one in eqs] == ["not determined", "found", "found"]
    assert [one.posterior.details.converged for one in eqs] == [False, True, True]


# --- how long runs are -----------------------------------------------------------------------------------------------


def lorenz(x):
    return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]


def over_the_top(x):  # the last state is the time
    return [x[1], -9.0 * np.sin(x[0]) - 0.1 * x[1] + 4.0 * np.cos(x[2]), 1.0]


def relaxing(x):
    return [x[1], 5 * (1 - x[0] ** 2) * x[1] - x[0]]


@pytest.mark.parametrize(
    ("rate", "start", "seconds", "chains", "dictionary"),
    [
        (lorenz, [-8.0, 7.0, 27.0], 40.0, ["x", "y", "z"], "polynomial:2"),
        (relaxing, [1.0, 1.0], 80.0, ["x:y:"], "polynomial:3"),
        (over_the_top, [3.1, 0.5, 0.0], 40.0, ["x:y:"], ["sin(x)", "y", "cos(t)"]),
    ],
)
def test_runs_that_noise_drives_apart_say_nothing_against_a_law(rate, start, seconds, chains, dictionary):
    t, states = solved(rate, start, seconds, 4000)
    channels = dict(zip("xyz", noisy(states, 0.05, 3), strict=False))
    eq = quietly(bq.Record.from_arrays(channels, time=t), chains=chains, dictionary=dictionary)
    assert eq.verdict.kind == "found"


def test_errors_of_windows_are_measured_by_what_noise_explains():
    true, noise = np.zeros((50, 2)), 0.1 * np.random.default_rng(4).standard_normal(5)
    grows = np.exp(np.linspace(0.0, 4.0, 50))[:, None] * [1.0, 0.0]

    def of(run, places):
        others = [[(run + one * grows, true)] * 3 for one in noise]
        return _window([(run, true)] * 3, others, places)

    assert of(0.1 * grows, [0]).error > 1.0 > of(0.1 * grows, [0]).unexplained
    assert of(grows, [0]).unexplained > 2.0  # an unstable law that is wrong by ten times the noise of the first state
    assert of(grows, [1]) == (0.0, 0.0)
    assert of(grows * np.nan, [0]) == (np.inf, np.inf)


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


@pytest.mark.slow  # of one that is told sooner: test_left_out
@pytest.mark.parametrize("n", [4000, 30_000])
def test_an_unmeasured_force_is_told_at_any_length(n):
    eq = bq.discover(with_unmeasured_force(n, 0.3), **OSCILLATOR, dictionary=["x", "v", "x**3", "u"])
    assert eq.verdict.kind == "nearly true"


def test_an_equation_of_a_channel_that_is_clipped_at_its_peaks_is_at_best_nearly_true():
    record = bq.simulate("duffing", seed=1)
    limits = np.quantile(np.abs(record["a"]), [0.76, 0.998])
    much, little = (record.with_channels({"a": np.clip(record["a"], -one, one)}) for one in limits)
    settings = {"chains": "::a", "inputs": ["u"], "dictionary": ["x", "dx", "x**3", "x**2", "u"]}
    eq = quietly(much, **settings)
    assert eq.verdict.kind in ("nearly true", "none")
    assert "a is clipped in 24 % of its rows" in str(eq.verdict)
    assert "measure it in a larger range" in str(eq.verdict)
    assert "tails" not in brief(eq)
    assert "is clipped" not in str(quietly(little, **settings).verdict)


def test_clipping_is_named_as_the_cause():
    none = with_clipping(Verdict("none", "no equation found: R2 0"), "a", 0.21)
    assert none == Verdict(
        "none", "no equation found: R2 0", "a is clipped in 21 % of its rows: measure it in a larger range"
    )
    assert with_clipping(Verdict("found", "R2 1"), "a", 0.21).kind == "nearly true"
    both = with_clipping(Verdict("nearly true", "5 % of a is not explained", "add terms"), "a", 0.21)
    assert both.reason == "a is clipped in 21 % of its rows; 5 % of a is not explained"
    other = with_clipping(Verdict("not determined", "two models", "measure longer"), "a", 0.21)
    assert other.advice == "measure longer; a is clipped in 21 % of its rows: measure it in a larger range"


HALF_NOISE = {"dx": ["x", "y"], "dy": ["x", "y", "x*z"], "dz": ["z", "x*y"]}


def under_half_noise(records, **laws):
    drawn = dysts.draw("Lorenz", 50.0, 5000)[:records]
    return quietly(drawn, chains=["x", "y", "z"], dictionary={**HALF_NOISE, **laws}, holdout=0.0)


def test_half_of_the_motion_is_noise():
    """Terms of smoothed states that are half noise explain little of a smoothed rate, however right the law is."""
    right = under_half_noise(3)
    assert [(one.verdict.kind, set(one.shown)) for one in right] == [("found", set(law)) for law in HALF_NOISE.values()]
    assert right[0].train.r2 < 0.5
    assert [isinstance(one.verdict, ByRuns) for one in right] == [True, False, False]
    assert right[0].residuals.driver is None  # errors of states follow these
    # runs are of all equations together, and one record does not determine that of dy
    unsure = under_half_noise(1)
    assert [one.verdict.kind for one in unsure[:2]] == ["not determined", "not determined"]
    assert unsure[0].verdict.reason.startswith("only free runs speak for it, and they need dy")


@pytest.mark.slow
def test_under_half_of_noise_a_wrong_law_is_not_found():
    assert under_half_noise(5, dx=["x", "z"])[0].verdict.kind == "none"
    unsure = under_half_noise(5, dz="polynomial:1")
    assert unsure[2].verdict.kind in ("none", "not determined")
    assert unsure[0].verdict.kind == "not determined"
    assert unsure[0].verdict.reason.startswith("only free runs speak for it")
