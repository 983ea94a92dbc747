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
from bayeq.forecast.rows import Rows
from bayeq.forecast.windows import apart, typical_period, window_runs
from bayeq.ode.rk4 import interpolant
from bayeq.selection.alternatives import alternatives_to

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
    assert any("hardly tell apart" in message for message in eq.warnings)
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
    mean = D @ one.posterior.averaged_coef
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


def test_limits_that_do_not_bind_change_nothing():
    # 15,000 rows of a cubic stiffness that shifts the period by some 0.01 %: certain with noise this small
    rec = bq.simulate("duffing", n=15_000, seed=3, noise={"a": 1e-4}, parameters={"k3": 20.0})
    first, *others = (
        discover(rec, **OSCILLATOR, **options)[0]
        for options in ({}, {"max_terms": 30}, {"constraints": ["u > 0"]}, {"constraints": ["x < 0", "v < 0"]})
    )
    assert set(first.included) == DUFFING
    assert set(first.shown) == {"x", "v", "u"}
    assert [(left.name, left.reason) for left in first.left_out] == [("x**3", "tolerance")]
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


# --- tolerance: certain, and of no practical difference ---------------------------------------------------------------


@pytest.fixture(scope="module")
def weak():
    """A Duffing oscillator with precise sensors whose cubic stiffness makes 0.2 % of the acceleration."""
    noise = {"x": 1e-4, "v": 1e-4, "a": 1e-3, "u": 1e-4}
    rec = bq.simulate("duffing", seed=3, noise=noise, parameters={"k3": 500.0})
    clean = rec.truth.clean
    assert 500.0 * np.std(clean["x"] ** 3) == pytest.approx(0.0018 * np.std(clean["a"]), rel=0.1)
    return rec


@pytest.fixture(scope="module")
def simpler(weak):
    return discover(weak, **OSCILLATOR)


@pytest.fixture(scope="module")
def whole(weak):
    return discover(weak, **OSCILLATOR, tolerance=0)


def test_what_is_certain_and_within_the_tolerance_is_left_out(simpler, whole):
    one, full = simpler[0], whole[0]
    assert set(one.included) == set(full.included) == set(full.shown) == DUFFING
    assert set(one.shown) == {"x", "v", "u"}
    assert one.why == {"x**3": "tolerance"}
    (left,) = one.left_out
    assert (left.name, left.reason) == ("x**3", "tolerance")
    assert left.pip > 0.99
    assert "certain, but within the tolerance: x**3, PIP 1.000" in str(simpler)
    # probabilities and the included terms stay, and the full model stands beside what is shown
    np.testing.assert_array_equal(one.posterior.pip, full.posterior.pip)
    assert one.coef == full.coef == full.shown_coef
    assert f"full model: {full.text}" in str(simpler)
    assert simpler.to_dict()["equations"][0]["full_equation"] == full.text
    assert (full.effective, full.full_posterior, full.full_text) == ((), None, None)


def test_other_coefficients_than_the_full_models_are_called_effective(simpler, weak):
    one = simpler[0]
    # the linear stiffness makes up for the cubic one; by how much is known of Gaussian motion: 3 k3 sd(x)^2
    change = one.shown_coef["x"] - one.coef["x"]
    assert change == pytest.approx(one.coef["x**3"] * 3 * np.var(weak.truth.clean["x"]), rel=0.3)
    assert "x" in one.effective
    assert "v" not in one.effective
    table = simpler.table().set_index("term")
    assert table.loc["x", "effective"]
    assert table["effective"].sum() == len(one.effective)
    saved = {term["name"]: term["effective"] for term in simpler.to_dict()["equations"][0]["terms"]}
    assert {name for name, effective in saved.items() if effective} == set(one.effective)
    (row,) = (line for line in str(simpler).splitlines() if line.startswith("| x  "))
    assert f"~ {one.shown_coef['x']:.2f}"[:6] in row
    assert str(simpler).count("~ effective coefficients") == 1


def test_smaller_models_are_kept_in_files(simpler, tmp_path):
    simpler.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.to_dict() == simpler.to_dict()
    assert str(again) == str(simpler)
    assert again[0].intercept_ci95 == simpler[0].intercept_ci95
    np.testing.assert_array_equal(again.rhs(0.0, [0.01, 0.1], 1.0), simpler.rhs(0.0, [0.01, 0.1], 1.0))


def test_intervals_of_a_projection_are_those_of_the_full_model_projected(whole):
    # twin: coefficients drawn from the full posterior, each fitted anew by least squares on the smaller model
    fit = whole[0].fit
    full, names = fit.posterior, np.array(fit.posterior.names)
    model = full.support & (names != "x**3")
    A = fit.standard.gram.DtD + np.eye(len(names)) / fit.prior.slab_variance
    half = np.linalg.cholesky(A).T
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(full.coef[full.support], full.covariance, size=4000)
    projected = np.linalg.lstsq(half[:, model], half[:, full.support] @ draws.T)[0]
    found = fit.projected(full, model)
    np.testing.assert_allclose(found.coef[model], projected.mean(axis=1), atol=4 * found.sd[model].max() / 60)
    # a standard deviation of 4000 draws errs by 1.1 %
    np.testing.assert_allclose(found.sd[model], projected.std(axis=1), rtol=0.05)
    # the conditional mean given the smaller model is the same projection
    np.testing.assert_allclose(found.coef, fit.conditional(model).coef, rtol=1e-6, atol=1e-12)
    # on all terms nothing changes
    same = fit.projected(full, full.support)
    np.testing.assert_allclose(same.coef, full.coef, rtol=1e-9)
    np.testing.assert_allclose(same.covariance, full.covariance, rtol=1e-6, atol=1e-18)


@pytest.mark.parametrize("options", [{}, {"smooth": "none"}, {"smooth": "band"}, {"constraints": ["u == 1"]}])
def test_what_is_shown_is_the_projection_as_reported(weak, options):
    eq = discover(weak, **OSCILLATOR, **options, tolerance=0.005)
    one = eq[0]
    assert "x**3" in one.included
    assert "x**3" not in one.shown
    full, shown = one.full_posterior, one.shown_posterior
    assert full.support.tolist() == one.posterior.support.tolist()
    rec = weak
    D = evaluate_terms(one.terms, rec.channels)
    apart = shown.intercept - full.intercept + D @ (shown.coef - full.coef)
    assert np.sqrt(np.mean(apart[:3200] ** 2)) < 0.0055 * np.std(rec["a"][:3200])
    assert (shown.sd[shown.support & (shown.coef != 1.0)] > 0).all()
    if "constraints" in options:
        assert one.shown_coef["u"] == 1.0


def test_the_equation_shown_is_the_smallest_that_is_hardly_worse():
    # a hysteretic force, which takes many terms; with a larger tolerance the law of the rest is what is left
    rec = draw_record("bouc-wen", 0.05, seed=0, rows=40_000)
    strict, default, loose = (discover(rec, **OSCILLATOR, smooth="band", tolerance=t)[0] for t in (0, 0.01, 0.05))
    assert strict.included == default.included == loose.included == strict.shown
    assert set(loose.shown) == DUFFING
    assert len(loose.shown) <= len(default.shown) < len(strict.shown)
    for left in default.left_out:
        assert left.reason == "tolerance"


def test_friction_that_the_dictionary_lacks_is_told():
    rec = adverse_record(CASES["tanh friction"], 4000, 0)
    one = discover(rec, **OSCILLATOR)[0]
    assert set(one.shown) <= set(one.included)
    assert {"x", "x**3", "u"} <= set(one.shown)
    assert one.verdict.kind != "found"


def test_the_damping_of_a_light_structure_stays():
    # damping ratio 0.1 %: v explains 3e-6 of the variance, and its runs are off by several per cent after ten periods
    rec = bq.simulate("linear", seed=3, noise=0.01, parameters={"c": 0.0632})
    one = discover(rec, **OSCILLATOR)[0]
    share = dict(zip((t.text for t in one.terms), one.share, strict=True))
    assert share["v"] < 1e-5
    # predictions alone would do without it
    assert math.sqrt(share["v"]) < 0.01
    assert set(one.shown) == {"x", "v", "u"}


def test_equations_of_a_system_are_simplified_each(weak, whole):
    # two oscillators that do not know of each other; the cubic stiffness of the second one matters
    stiff = bq.simulate("duffing", seed=4, noise={"x": 1e-4, "v": 1e-4, "a": 1e-3, "u": 1e-4})
    channels = {f"{name}{k}": rec[name] for k, rec in ((1, weak), (2, stiff)) for name in "xvau"}
    both = bq.Record.from_arrays(channels, time=weak.time)
    eq = discover(
        both,
        chains=["x1:v1:a1", "x2:v2:a2"],
        inputs=["u1", "u2"],
        dictionary=["x1", "v1", "x1**3", "u1", "x2", "v2", "x2**3", "u2"],
    )
    assert eq[0].included == ("x1", "v1", "x1**3", "u1")
    assert eq[0].shown == ("x1", "v1", "u1")
    assert eq[1].shown == eq[1].included == ("x2", "v2", "x2**3", "u2")
    assert eq[1].full_posterior is None
    assert eq[0].full_posterior.coef[2] == pytest.approx(whole[0].coef["x**3"], rel=0.02)


def test_without_time_no_smaller_model_is_shown(weak):
    order = np.random.default_rng(0).permutation(weak.n)  # rows in order would be taken for time
    untimed = bq.Record.from_arrays({name: weak[name][order] for name in "xvau"})
    one = discover(untimed, **RAW)[0]
    assert one.shown == one.included
    assert "x**3" in one.shown


def test_another_equation_within_the_tolerance_is_none(simpler):
    # the verdict compares with the full model: what the tolerance takes away makes no alternative
    one = simpler[0]
    assert alternatives_to(one.fit, one.full_posterior, 0.01).probability < 0.05
    assert simpler.verdict.kind == "found"
    # a much finer look tells the two apart
    assert alternatives_to(one.fit, one.shown_posterior, 1e-4).probability > 0.9


def test_a_form_that_is_undecided_is_warned_of():
    # friction that is partly viscous and partly dry; over ten periods either kind alone follows the motion
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
    options = {"chains": "th:w:", "dictionary": ["th", "sin(th)", "w", "w*abs(w)", "sign(w)"], "smooth": "band"}
    eq = discover(rec, **options, tolerance=0.03)
    assert eq[0].included == ("sin(th)", "w", "sign(w)")
    assert eq[0].shown == ("sin(th)", "w")
    (message,) = (message for message in eq.warnings if "its form is undecided" in message)
    assert message.startswith("ddth: w is needed, but its form is undecided: with sign(w) instead predictions and free")
    # and the default tells them apart
    assert not any("its form is undecided" in message for message in discover(rec, **options).warnings)


def test_the_tolerance_on_the_command_line(weak, tmp_path, capsys):
    file = tmp_path / "weak.csv"
    bq.write(weak, file)
    call = ["discover", str(file), "--chain", "x:v:a", "--input", "u", "--smooth", "none", "--json"]
    found = []
    for options in (["--tolerance", "0.02"], ["--tolerance", "0"]):
        assert main([*call, *options]) == 0
        terms = json.loads(capsys.readouterr().out)["equations"][0]["terms"]
        found.append({term["name"] for term in terms if term["shown"]})
    assert found[0] < found[1]
    assert main([*call, "--tolerance", "2"]) == 2
    assert "bayeq: error: tolerance is a share" in capsys.readouterr().err
    assert main([*call, "--negligible", "0"]) == 2
    assert "No such option" in capsys.readouterr().err


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
