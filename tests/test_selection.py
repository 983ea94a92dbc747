"""Which terms an equation shows: every rule on its own, and that a rule that does not bind changes nothing."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest
from studies.adverse_records import CASES
from studies.adverse_records import draw_record as adverse_record
from studies.discrepancy import draw_record

import bayeq as bq
from bayeq.cli.app import main
from bayeq.dictionary import evaluate_terms
from bayeq.errors import InputError

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


def test_the_likeliest_of_a_group_is_shown_though_none_is_included():
    rec = shared_out(5)
    terms = ["x", "u0*abs(u1)/u1", "u1*u1/u1", "u2/1", "u3", "2*u4"]
    inputs = [f"u{k}" for k in range(5)]
    eq = discover(rec, chains="x:xdot", inputs=inputs, dictionary=terms, smooth="none", holdout=0.0)
    assert any("cannot tell" in message for message in eq.warnings)
    one = eq[0]
    # the case that is meant: none of the five reaches a half, and yet one of them is in for certain
    assert one.included == ("x",)
    average = one.posterior.average
    assert average.models[:, 1:].any(axis=1) @ average.probability > 0.999
    best = [t.text for t, kept in zip(one.terms, average.models[0], strict=True) if kept]
    assert one.shown == tuple(best)
    (likeliest,) = set(best) - {"x"}
    assert one.why == {likeliest: "undecided"}
    # without it the equation does not predict what the average of all models does; with it, nearly
    D = np.column_stack([evaluate_terms(one.terms, rec.channels)])
    mean = D @ one.posterior.averaged.coef
    without, shown = (D @ p.coef for p in (one.posterior, one.shown_posterior))
    assert np.std(without - mean) > 0.01 * np.std(rec["xdot"])
    assert np.std(shown - mean) < np.std(without - mean)
    # coefficients are those of least squares on the shown columns, hardly shrunk; of the included ones beside them
    ones = np.ones(400)
    column = D[:, [t.text for t in one.terms].index(likeliest)]
    wide = np.linalg.lstsq(np.column_stack([ones, rec["x"], column]), rec["xdot"])[0]
    narrow = np.linalg.lstsq(np.column_stack([ones, rec["x"]]), rec["xdot"])[0]
    np.testing.assert_allclose(list(one.shown_coef.values()), wide[1:], rtol=1e-2)
    np.testing.assert_allclose(list(one.coef.values()), narrow[1:], rtol=1e-2)
    assert "shown, though its PIP is 0." in str(eq)
    assert likeliest in one.text
    # no tolerance, nothing to tell what differs
    options = {"chains": "x:xdot", "inputs": inputs, "dictionary": terms, "smooth": "none", "holdout": 0.0}
    assert discover(rec, **options, tolerance=0)[0].shown == one.included


def test_what_predicts_as_the_average_stays():
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


@pytest.mark.parametrize(
    ("rows", "fs", "k3"), [(700, 250.0, 60.0), pytest.param(15_000, 1000.0, 20.0, marks=pytest.mark.slow)]
)
def test_limits_that_do_not_bind_change_nothing(rows, fs, k3):
    # a cubic stiffness that shifts the period by some 0.01 to 0.03 %: certain with noise this small
    rec = bq.simulate("duffing", n=rows, fs=fs, seed=3, noise={"a": 1e-4}, parameters={"k3": k3})
    asked = {**OSCILLATOR, "dictionary": "x, v, x**2, x**3, x*v, v**2, v*abs(v), sign(v), u"}
    first, *others = (
        discover(rec, **asked, **options)[0]
        for options in ({}, {"max_terms": 7}, {"constraints": ["u > 0", "x < 0", "v < 0"]})
    )
    assert set(first.shown) == set(first.included) == DUFFING
    for other in others:
        assert other.included == first.included
        assert other.shown == first.shown
        assert other.why == first.why
        for name, value in first.shown_coef.items():
            assert other.shown_coef[name] == pytest.approx(value, rel=1e-6)
    assert set(discover(rec, **asked, tolerance=0)[0].shown) == DUFFING


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
        ({"tolerance": -0.1}, "tolerance is a share"),
        ({"tolerance": 1.0}, "tolerance is a share"),
        ({"tolerance": math.nan}, "tolerance is a share"),
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


# --- tolerance: what a law may lack -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def weak():
    """A Duffing oscillator with precise sensors whose cubic stiffness makes 0.3 % of the acceleration."""
    noise = {"x": 1e-4, "v": 1e-4, "a": 1e-3, "u": 1e-4}
    rec = bq.simulate("duffing", n=1000, fs=250.0, seed=3, noise=noise, parameters={"k3": 500.0})
    clean = rec.truth.clean
    assert 500.0 * np.std(clean["x"] ** 3) == pytest.approx(0.0032 * np.std(clean["a"]), rel=0.1)
    return rec


@pytest.mark.parametrize(
    "options",
    [{"smooth": "none"}, *(pytest.param(one, marks=pytest.mark.slow) for one in ({}, {"constraints": ["u == 1"]}))],
)
def test_a_small_term_of_an_exact_law_is_shown_unless_the_law_may_lack_as_much(weak, options):
    one = discover(weak, **OSCILLATOR, **options)[0]
    assert set(one.shown) == set(one.included) == DUFFING
    assert one.why == {}
    # a function of the states of 2 %, in as many directions as there are candidates, covers it
    one = discover(weak, **OSCILLATOR, **options, tolerance=0.02)[0]
    assert {"x", "v", "u"} <= set(one.shown) <= DUFFING
    assert one.posterior.pip[[term.text for term in one.terms].index("x**3")] < 0.99


def test_how_nearly_true_is_in_the_answer_and_its_file(weak, tmp_path):
    asked = {"chains": "x::a", "inputs": ["u"], "dictionary": "x, dx, x**2, x**3, u"}
    eq = discover(weak, **asked, tolerance=0.02)
    assert eq[0].tau >= 0.02
    assert 0.0 <= eq[0].error_probability < 1.0
    (saved,) = eq.to_dict()["equations"]
    assert (saved["tau"], saved["error_probability"]) == (eq[0].tau, eq[0].error_probability)
    assert saved["full_equation"] is None
    assert not any(term["effective"] for term in saved["terms"])
    eq.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.to_dict() == eq.to_dict()
    assert str(again) == str(eq)
    exact = discover(weak, **asked, tolerance=0, holdout=0.0)[0]
    assert (exact.tau, exact.error_probability) == (0.0, 0.0)
    # rows as measured do not tell
    assert discover(weak, **asked, smooth="none")[0].error_probability is None


@pytest.mark.parametrize(
    ("rows", "step", "noise", "dictionary"),
    [
        (3200, 8, 0.005, "x, v, x**3, u, x**2*v, x*v**2, v**3, v*abs(v), sign(v)"),
        pytest.param(40_000, 1, 0.05, "oscillator", marks=pytest.mark.slow),
    ],
)
def test_terms_without_which_a_nearly_true_law_runs_as_well_are_not_shown(rows, step, noise, dictionary):
    # a hysteretic force, which takes many terms
    rec = draw_record("bouc-wen", noise, seed=0, rows=rows).slice(step=step)
    strict, loose = (discover(rec, **OSCILLATOR, dictionary=dictionary, tolerance=t)[0] for t in (0, 0.05))
    assert strict.shown == strict.included
    assert set(loose.shown) >= DUFFING
    assert len(loose.shown) < len(strict.shown)
    assert {left.reason for left in loose.left_out} <= {"tolerance"}


@pytest.mark.slow  # of other terms that are lacking: test_likelihood, test_static_laws
def test_friction_that_the_dictionary_lacks_is_told():
    rec = adverse_record(CASES["tanh friction"], 4000, 0)
    one = discover(rec, **OSCILLATOR)[0]
    assert set(one.shown) <= set(one.included)
    assert {"x", "x**3", "u"} <= set(one.shown)
    assert one.verdict.kind != "found"


def test_the_damping_of_a_light_structure_stays():
    # damping ratio 0.1 %: v explains 3e-6 of the variance, and its runs are off by several per cent after ten periods
    rec = bq.simulate("linear", seed=3, noise=0.01, parameters={"c": 0.0632})
    one = discover(rec, **OSCILLATOR, dictionary="x, v, x**2, x**3, x*v, v*abs(v), u")[0]
    share = dict(zip((t.text for t in one.terms), one.share, strict=True))
    assert share["v"] < 1e-5
    # predictions alone would do without it
    assert math.sqrt(share["v"]) < 0.01
    assert set(one.shown) == {"x", "v", "u"}


def test_without_time_no_smaller_model_is_shown(weak):
    order = np.random.default_rng(0).permutation(weak.n)  # rows in order would be taken for time
    untimed = bq.Record.from_arrays({name: weak[name][order] for name in "xvau"})
    one = discover(untimed, **RAW)[0]
    assert one.shown == one.included
    assert "x**3" in one.shown


def test_of_a_few_rows_included_terms_may_be_copies_of_each_other():
    # the information on the included coefficients of these 60 rows is singular
    one = discover(adverse_record(CASES["few rows"], 60, 120007), **OSCILLATOR)[0]
    assert one.verdict.kind != "found"
    assert np.isfinite(one.shown_posterior.covariance).all()


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_term_that_is_infinite_at_twice_the_motion_says_nothing_raw():
    rng = np.random.default_rng(0)
    x = rng.uniform(-300.0, 300.0, 400)
    record = bq.Record.from_arrays(x=x, y=3.0 * x + rng.normal(size=400), fs=10.0)
    found = bq.discover(record, target="y", inputs=["x"], dictionary="x, exp(x), sin(x)", smooth="none")
    assert found[0].shown == ("x",)
