"""Which terms an equation shows: every rule on its own, and that a rule that does not bind changes nothing."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest
from studies.discrepancy import draw_record

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import InputError
from bayeq.forecast.rows import Rows
from bayeq.forecast.windows import apart, typical_period, window_runs
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.ode.rk4 import interpolant

RAW = {"chains": "x:v:a", "inputs": ["u"], "smooth": "none"}
OSCILLATOR = {"chains": "x:v:a", "inputs": ["u"]}
DUFFING = {"x", "v", "x**3", "u"}


def discover(records, **options):
    """Without the warnings of models that miss a term on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", seed=1)


@pytest.fixture(scope="module")
def plain(record):
    return discover(record, **RAW)[0]


# --- undecided: collinear terms that share their probability ----------------------------------------------------------


def shared_out(columns, noise=0.5, seed=0):
    """A first-order state whose derivative follows x and what some inputs hold alike, each as good as another."""
    rng = np.random.default_rng(seed)
    x, hidden = rng.normal(size=(2, 400))
    inputs = {f"u{k}": hidden + 0.02 * rng.normal(size=400) for k in range(columns)}
    target = x + 0.5 * hidden + noise * rng.normal(size=400)
    return bq.Record.from_arrays({"x": x, "xdot": target, **inputs})


def test_the_simplest_of_a_group_is_shown_though_none_is_included():
    rec = shared_out(5)
    terms = ["x", "u0*abs(u1)/u1", "u1*u1/u1", "u2/1", "u3", "2*u4"]
    inputs = [f"u{k}" for k in range(5)]
    eq = discover(rec, chains="x:xdot", inputs=inputs, dictionary=terms, smooth="none", holdout=0.0)
    assert any("hardly tell apart" in message for message in eq.warnings)
    one = eq[0]
    # the case that is meant: none of the five reaches a half, and yet one of them is in for certain
    assert one.included == ("x",)
    average = one.posterior.average
    assert average.models[:, 1:].any(axis=1) @ average.probability > 0.999
    assert one.shown == ("x", "u3")
    assert one.why == {"u3": "undecided"}
    problem, found = one.fit.problem, one.fit.posterior
    shown = np.isin([t.text for t in one.terms], one.shown)
    best = model_log_posterior(problem, average.models[0])
    assert best - model_log_posterior(problem, found.support) > np.log(100)
    assert best - model_log_posterior(problem, shown) < np.log(10)
    # coefficients are those of least squares on the shown columns, hardly shrunk; of the included ones beside them
    ones = np.ones(400)
    wide = np.linalg.lstsq(np.column_stack([ones, rec["x"], rec["u3"]]), rec["xdot"])[0]
    narrow = np.linalg.lstsq(np.column_stack([ones, rec["x"]]), rec["xdot"])[0]
    np.testing.assert_allclose(list(one.shown_coef.values()), wide[1:], rtol=1e-2)
    np.testing.assert_allclose(list(one.coef.values()), narrow[1:], rtol=1e-2)
    assert "shown, though its PIP is 0." in str(eq)
    assert "u3" in one.text


def test_what_is_plausible_stays():
    one = discover(shared_out(1), chains="x:xdot", inputs=["u0"], dictionary=["x", "u0"], smooth="none")[0]
    assert one.shown == one.included == ("x", "u0")
    assert one.why == {}
    assert one.shown_posterior is one.posterior


def test_a_free_decay_keeps_its_damping():
    t = np.arange(700) / 30.0
    rng = np.random.default_rng(4)
    x = 100 * np.exp(-0.0067 * t) * np.cos(2.494 * t) + 0.3 * rng.standard_normal(700)
    one = discover(bq.Record.from_arrays(time=t, x=x), chains="x::")[0]
    assert "x" in one.included
    assert {term for term in one.shown if "dx" in term}
    assert one.posterior.support.tolist() == (one.posterior.pip > 0.5).tolist()


# --- max_terms -------------------------------------------------------------------------------------------------------


def test_at_most_a_number_of_terms(record, plain):
    few = discover(record, **RAW, max_terms=3)[0]
    path = plain.path()
    best = path.models[:4][np.argmax(path.log_evidence[:4])]
    np.testing.assert_array_equal(few.shown_posterior.support, best)
    assert few.shown == ("x", "x**3", "u")
    assert few.why == {"v": "max_terms"}
    np.testing.assert_allclose(few.shown_posterior.coef, path.coef[3], rtol=1e-9)
    # probabilities, the included terms and their coefficients stay what they are
    assert few.included == plain.included
    assert few.coef == plain.coef
    np.testing.assert_array_equal(few.posterior.pip, plain.posterior.pip)
    (left,) = few.left_out
    assert (left.name, left.reason) == ("v", "max_terms")
    assert left.share == pytest.approx(plain.share[1])
    assert left.pip > 0.99
    assert few.noise_sd == pytest.approx(few.train.nrmse * np.std(record["a"][:3200]), rel=2e-3)


def test_what_is_shown_is_what_is_evaluated_and_integrated(record):
    eq = discover(record, **RAW, max_terms=3)
    one = eq[0]
    state, force = np.array([0.02, 0.3]), 5.0
    by_hand = one.shown_posterior.intercept + sum(
        c * {"x": state[0], "x**3": state[0] ** 3, "u": force}[name] for name, c in one.shown_coef.items()
    )
    np.testing.assert_allclose(eq.rhs(0.0, state, force), [state[1], by_hand], rtol=1e-12)
    assert "v" not in {str(s) for s in eq.to_sympy().rhs.free_symbols}
    assert r"\dot" not in eq.to_latex().split("=")[1]
    table = eq.table().set_index("term")
    assert table.loc["v", ["included", "shown", "why"]].tolist() == [True, False, "max_terms"]
    assert table.loc["v", "coef"] == one.coef["v"]
    assert table.loc["v", "shown_coef"] == 0.0


def test_limits_that_do_not_bind_change_nothing():
    # 15,000 rows of a cubic stiffness that shifts the period by some 0.01 %: certain with noise this small
    rec = bq.simulate("duffing", n=15_000, seed=3, noise={"a": 1e-4}, parameters={"k3": 20.0})
    first, *others = (
        discover(rec, **OSCILLATOR, **options)[0]
        for options in ({}, {"max_terms": 30}, {"constraints": ["u > 0"]}, {"constraints": ["x < 0", "v < 0"]})
    )
    assert set(first.included) == DUFFING
    assert set(first.shown) == {"x", "v", "u"}
    assert [(left.name, left.reason) for left in first.left_out] == [("x**3", "negligible")]
    for other in others:
        assert other.included == first.included
        assert other.shown == first.shown
        assert other.why == first.why
        for name, value in first.shown_coef.items():
            assert other.shown_coef[name] == pytest.approx(value, rel=1e-6)
    assert set(discover(rec, **OSCILLATOR, tolerance=0)[0].shown) == DUFFING


def test_forced_terms_stay(record):
    prior = bq.Prior(prior_inclusion=[0.1, 1.0, 0.1, 0.1], slab_variance=1e3)
    options = {**RAW, "dictionary": ["x", "v", "x**3", "u"], "prior": prior}
    assert "v" in discover(record, **options, max_terms=1)[0].shown
    two = bq.Prior(prior_inclusion=[0.1, 1.0, 0.1, 1.0])
    with pytest.raises(InputError, match="at most 1 terms are asked for, but 2 are forced in"):
        discover(record, **{**options, "prior": two}, max_terms=1)


@pytest.mark.parametrize("method", ["vb", "bma", "gibbs"])
def test_limits_whatever_the_engine(record, method):
    assert discover(record, **RAW, method=method, max_terms=3)[0].shown == ("x", "x**3", "u")


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"max_terms": 0}, "max_terms must be at least 1, got 0"),
        ({"max_terms": 2.5}, "max_terms must be a whole number"),
        ({"max_terms": True}, "max_terms must be"),
        ({"max_terms": 3, "method": "stlsq"}, "choose one of: auto"),
        ({"negligible": -0.1}, "negligible"),
        ({"negligible": 1.0}, "negligible"),
        ({"negligible": math.nan}, "negligible"),
    ],
)
def test_limits_that_make_no_sense(record, options, match):
    with pytest.raises(InputError, match=match):
        discover(record, **RAW, **options)


def test_what_was_left_out_is_kept_and_printed(record, plain, tmp_path):
    few = discover(record, **RAW, max_terms=3)
    few.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.to_dict() == few.to_dict()
    assert str(again) == str(few)
    assert "included, but left out (max_terms): v, PIP 1.000, explains 0.17 %" in str(few)
    (left,) = few.to_dict()["diagnostics"]["equations"]["a"]["left_out"]
    assert left == {"name": "v", "pip": left["pip"], "share": pytest.approx(plain.share[1]), "reason": "max_terms"}
    terms = {term["name"]: term for term in few.to_dict()["equations"][0]["terms"]}
    assert (terms["v"]["included"], terms["v"]["shown"], terms["v"]["why"]) == (True, False, "max_terms")
    assert terms["v"]["coef"] == plain.coef["v"]
    assert terms["v"]["shown_ci95"] == [0.0, 0.0]
    assert (terms["x"]["why"], terms["x"]["shown"]) == (None, True)
    np.testing.assert_array_equal(again.rhs(0.0, [0.01, 0.1], 1.0), few.rhs(0.0, [0.01, 0.1], 1.0))


def test_limits_on_the_command_line(record, tmp_path, capsys):
    file = tmp_path / "duffing.csv"
    bq.write(record, file)
    call = ["discover", str(file), "--chain", "x:v:a", "--input", "u", "--smooth", "none"]
    assert main([*call, "--max-terms", "3", "--json"]) == 0
    terms = {t["name"]: t for t in json.loads(capsys.readouterr().out)["equations"][0]["terms"]}
    assert {name for name, t in terms.items() if t["shown"]} == {"x", "x**3", "u"}
    assert terms["v"]["included"]
    assert terms["v"]["share"] is None
    assert terms["x"]["share"] > 0.01
    assert main([*call, "--max-terms", "0"]) == 2
    assert "bayeq: error: max_terms must be at least 1" in capsys.readouterr().err
    assert main([*call, "--max-terms", "few"]) == 2
    capsys.readouterr()


# --- negligible: certain, and of no practical difference --------------------------------------------------------------


@pytest.fixture(scope="module")
def hysteretic():
    return draw_record("bouc-wen", 0.05, seed=0, rows=40_000)


def test_terms_that_compensate_for_what_the_dictionary_lacks_are_left_out(hysteretic):
    eq = discover(hysteretic, **OSCILLATOR, smooth="band")
    shown, everything = eq[0], discover(hysteretic, **OSCILLATOR, tolerance=0, smooth="band")[0]
    assert set(shown.shown) == DUFFING < set(everything.shown)
    assert shown.included == everything.included == everything.shown
    assert {left.name for left in shown.left_out} == set(everything.shown) - DUFFING
    for left in shown.left_out:
        assert left.reason == "negligible"
        assert left.share < 4e-5
        assert left.pip > 0.5
    assert "certain, but negligible: " in str(eq)


def test_the_damping_of_a_light_structure_stays():
    # damping ratio 0.3 %: v explains 3e-5 of the variance, and without it a run is nowhere after a hundred periods
    rec = bq.simulate("linear", n=20_000, seed=3, noise={"a": 0.01}, parameters={"c": 0.2})
    one = bq.discover(rec, **OSCILLATOR, smooth="band")[0]
    share = dict(zip((t.text for t in one.terms), one.share, strict=True))
    assert share["v"] < 4e-5
    assert set(one.shown) == {"x", "v", "u"}


def test_short_records_without_noise_show_the_law_alone():
    # the force between the samples is not what the smoother takes it for; terms come in that make up for the difference
    rec = bq.simulate("quadratic", seed=3, noise=0)
    options = {"chains": "x:v:", "inputs": ["u"]}
    one, law = discover(rec, **options)[0], {"x", "v", "v*abs(v)", "u"}
    assert set(one.shown) == law
    assert {left.name for left in one.left_out} == set(one.included) - law
    assert set(discover(rec, **options, tolerance=0)[0].shown) == set(one.included)


def test_a_form_that_free_runs_leave_undecided_is_warned_of():
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
    eq = discover(rec, chains="th:w:", dictionary=["th", "sin(th)", "w", "w*abs(w)", "sign(w)"], smooth="band")
    assert "sin(th)" in eq[0].shown
    (shown,) = {"w", "w*abs(w)", "sign(w)"} & set(eq[0].shown)
    (message,) = (message for message in eq.warnings if "its form is undecided" in message)
    assert message.startswith(f"ddth: {shown} is needed, but its form is undecided: with ")


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_errors_of_windows_are_those_of_simulate():
    rec = bq.simulate("linear", n=400, seed=3, noise=0.0)
    eq = bq.discover(rec, **OSCILLATOR, dictionary=["x", "u"], holdout=0.0, tolerance=0)
    rows = Rows(rec.time, rec.channels, {}, interpolant(rec.time, rec["u"][:, None], "cubic"))
    dynamics = eq.dynamics()
    assert typical_period(dynamics, [rows]) == pytest.approx(2 * np.pi * rec["x"].std() / rec["v"].std())
    ours = apart(window_runs(dynamics, [rows], 0.1))
    scale = {name: rec[name].std() for name in "xv"}
    errors = []
    for first in np.linspace(0, 400 - 101, 12).astype(int):
        read = {name: float(rec[name][first]) for name in "xv"}
        run = eq.simulate(rec, start=int(first), rows=101, draws=0, initial=read)
        errors.append(np.sqrt(np.mean([((run.mean[n] - rec[n][first : first + 101]) / scale[n]) ** 2 for n in "xv"])))
    assert ours == pytest.approx(np.median(errors), rel=1e-3)
