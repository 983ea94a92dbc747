"""The answer as text, SymPy, LaTeX, numbers and files."""

from __future__ import annotations

import json
import sys
import warnings

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.equation.equation import RunnerUp
from bayeq.equation.written import round_to
from bayeq.errors import CorrelatedResidualsWarning, FileFormatError, InputError


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=2000, seed=3, noise={"a": 0.02})


@pytest.fixture(scope="module")
def eq(record):
    return bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u")


@pytest.fixture(scope="module")
def flow():
    lorenz = bq.simulate("lorenz", seed=0, noise=0.0)
    return bq.Record.from_arrays({**lorenz.channels, **{k: lorenz.truth.clean[k] for k in ("dx", "dz")}}, fs=100)


@pytest.fixture(scope="module")
def pair(flow):
    with warnings.catch_warnings():
        # without noise the residuals are rounding, and correlated
        warnings.simplefilter("ignore", CorrelatedResidualsWarning)
        return bq.discover(flow, chains=["x:dx", "z:dz"], inputs=["y"], dictionary=["x", "y", "z", "x*y"])


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (-1001.2345, 5.6, "-1001.2"),
        (0.99756, 0.0019, "0.9976"),
        (95012.0, 200.0, "9.501e+04"),
        (2.0, 0.0, "2"),
        (0.0, 1.0, "0"),
        (1.0, 100.0, "1"),
        (1.23456789, 1e-300, "1.23456789"),
    ],
)
def test_numbers_to_a_tenth_of_their_standard_deviation(value, sd, text):
    assert round_to(value, sd) == text
    assert abs(float(round_to(value, sd)) - value) <= max(0.05 * sd, 1e-11 * abs(value)) or abs(value) < sd


def test_table_lists_every_candidate(eq):
    table = eq.table()
    assert list(table.columns) == [
        "target",
        "term",
        "coef",
        "sd",
        "ci_low",
        "ci_high",
        "pip",
        "included",
        "shown",
        "share",
        "unit",
        "shown_coef",
        "shown_sd",
        "shown_ci_low",
        "shown_ci_high",
        "averaged_ci_low",
        "averaged_ci_high",
        "why",
        "effective",
        "bound",
    ]
    assert len(table) == 36
    chosen = table[table.included]
    assert chosen.term.tolist() == ["x", "v", "x**3", "u"]
    np.testing.assert_allclose((chosen.ci_high - chosen.ci_low) / chosen.sd, 2 * 1.959964, rtol=1e-6)
    assert not table[~table.included][["coef", "sd", "ci_low", "ci_high"]].to_numpy().any()


def test_sympy_and_text_are_the_same_equation(eq, pair):
    equation = eq.to_sympy()
    x, v, u = sympy.symbols("x v u")
    assert equation.lhs == sympy.Symbol("a")
    values = {x: 0.02, v: -0.3, u: 4.0}
    exact = sum(c * float(sympy.sympify(t).subs(values)) for t, c in eq[0].coef.items())
    assert float(equation.rhs.subs(values)) == pytest.approx(
        exact + (eq[0].posterior.intercept if eq[0].intercept_matters else 0)
    )
    left, right = eq[0].text.split(" = ")
    assert left == "a"
    assert float(sympy.sympify(right).subs(values)) == pytest.approx(exact, rel=1e-2)
    assert isinstance(pair.to_sympy(), list)


def test_latex_writes_no_dots_over_channels_in_units_of_their_own():
    r = bq.simulate("duffing", n=800, seed=3)
    channels = {"x": 1e3 * r["x"], "v": r["v"], "a": r["a"] / 9.80665, "u": r["u"]}
    mixed = bq.Record.from_arrays(channels, time=r.time, units={"x": "mm", "v": "m/s", "a": "g", "u": "N"})
    found = bq.discover(mixed, chains="x:v:a", inputs="u", dictionary="x, v, x**3, u")
    for latex in (found.to_latex(), found.to_dict()["equations"][0]["latex"], found.to_latex("brackets")):
        assert latex.startswith("a = ")
        assert "\\dot" not in latex
        assert "\\ddot" not in latex


def test_latex_writes_derivatives_as_dots(eq, pair):
    latex = eq.to_latex()
    assert latex.startswith(r"\ddot{x} = ")
    assert r"\dot{x}" in latex
    assert "x^{3}" in latex
    assert pair.to_latex().count("\n") == 1


def test_terms_that_are_sums_are_put_in_parentheses():
    rng = np.random.default_rng(0)
    x, u = rng.normal(size=(2, 300))
    rec = bq.Record.from_arrays(x=x, dx=2 * (x + u) ** 2 - 3 * (x - u * x) + 0.01 * rng.normal(size=300), u=u)
    eq = bq.discover(rec, chains=["x:dx"], inputs=["u"], dictionary=["(x+u)**2", "x-u*x", "u**3"], noise={"u": 0})
    assert "*(x+u)**2" in eq[0].text
    assert "*(x-u*x)" in eq[0].text
    value = float(sympy.sympify(eq[0].text.split(" = ")[1]).subs({"x": 0.5, "u": -1.0}))
    assert value == pytest.approx(float(eq[0].evaluate({"x": 0.5, "u": -1.0})), rel=1e-2)


def test_rhs_is_what_a_solver_takes(record, eq):
    assert eq.states == ("x", "v")
    clean = record.truth.clean
    dx, dv = eq.rhs(0.0, [clean["x"][100], clean["v"][100]], clean["u"][100])
    assert dx == clean["v"][100]
    assert dv == pytest.approx(clean["a"][100], abs=0.05 * np.std(clean["a"]))
    solution = solve_ivp(lambda t, s: eq.rhs(t, s, 0.0), (0, 0.5), [0.02, 0.0], rtol=1e-8)
    assert solution.success
    # a free oscillation at about sqrt(k/m) rad/s, damped by exp(-c t/2m)
    envelope = np.abs(solution.y[0][solution.t > 0.3]).max()
    assert 0.5 * 0.02 < envelope < 0.02 * np.exp(-0.3) * 1.1
    with pytest.raises(InputError, match="2 entries"):
        eq.rhs(0.0, [1.0], 0.0)
    with pytest.raises(InputError, match="input"):
        eq.rhs(0.0, [1.0, 2.0])


def test_prediction_of_a_record(record, eq, pair, flow):
    mean, sd = eq.predict(record, return_std=True)
    # the states are smoothed, by next to nothing here
    np.testing.assert_allclose(mean, eq[0].evaluate(record.channels), atol=1e-3)
    inside = np.mean(np.abs(record["a"] - mean) < 1.96 * sd)
    assert 0.93 < inside < 0.97
    both, spread = pair.predict(flow, return_std=True)
    assert both.shape == spread.shape == (flow.n, 2)


def test_indexing_by_position_and_target(pair):
    assert pair["dz"] is pair[1]
    assert len(pair) == len(list(pair)) == 2
    with pytest.raises(KeyError):
        pair["dy"]


def test_plain_text_for_a_pipe_and_style_for_a_terminal(monkeypatch, eq):
    plain = str(eq)
    assert plain.isascii()
    assert plain.splitlines()[0] == f"verdict: {eq.verdict}"
    assert plain.splitlines()[2] == eq[0].text
    assert "| x**3 " in plain
    assert "held-out rows (400)" in plain
    assert "\x1b" not in plain
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert "\x1b[1m" in str(eq)
    assert eq[0].text in repr(eq)


@pytest.mark.filterwarnings("ignore::bayeq.errors.CorrelatedResidualsWarning")
def test_markup_in_names_is_not_interpreted(record):
    rec = bq.Record.from_arrays(x=record["x"], v=record["v"], a=record["a"], fs=1000, name="[red]run[/red].csv")
    found = bq.discover(rec, chains="x:v:a", dictionary="x,v", holdout=0.0, smooth="none")
    assert "[red]run[/red].csv" in str(found)


@pytest.mark.parametrize(
    ("runner_up", "text", "odds"),
    [
        (RunnerUp("x", None, -2.0), "without x", "1:7.4"),
        (RunnerUp(None, "v", 0.5), "with v added", "1.6:1"),
        (RunnerUp("x", "v", -30.0), "v instead of x", "1:1e+13"),
        (RunnerUp("x", "v", -5.0), "v instead of x", "1:148"),
        (RunnerUp("x", "v", -1e9), "v instead of x", "1:1e+304"),
    ],
)
def test_runners_up_in_words(runner_up, text, odds):
    assert str(runner_up) == text
    assert runner_up.odds == odds


# Files --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", ["eq", "pair"], ids=["one", "two"])
def test_saved_and_loaded(answer, tmp_path, record, request):
    eq = request.getfixturevalue(answer)
    path = tmp_path / "eq.json"
    eq.save(path)
    again = bq.load(path)
    assert again.to_dict() == eq.to_dict()
    assert str(again) == str(eq)
    state = np.full(len(eq.states), 0.1)
    u = np.full(len(eq.inputs), 0.2)
    np.testing.assert_array_equal(again.rhs(0, state, u), eq.rhs(0, state, u))
    if answer == "eq":
        for a, b in zip(again.predict(record, True), eq.predict(record, True), strict=True):
            np.testing.assert_array_equal(a, b)
    again.save(tmp_path / "twice.json")
    assert (tmp_path / "twice.json").read_bytes() == path.read_bytes()


def test_json_has_the_shape_of_the_contract(eq):
    out = eq.to_dict()
    json.dumps(out, allow_nan=False)
    assert list(out) == ["version", "method", "verdict", "data", "equations", "parameters", "modes", "diagnostics"]
    assert {"file", "n"} <= set(out["data"])
    equation = out["equations"][0]
    assert {"target", "intercept", "noise_sd", "elbo", "equation", "latex", "terms"} <= set(equation)
    assert len(equation["terms"]) == 36
    assert list(equation["terms"][0]) == [
        "name", "coef", "sd", "ci95", "pip", "included", "shown", "why", "effective", "shown_coef", "shown_sd",
        "shown_ci95", "likelihood_coef", "likelihood_sd", "likelihood_ci95", "printed_ci95", "printed_over_models",
        "averaged_coef", "averaged_sd", "averaged_ci95", "share", "unit", "bound",
    ]  # fmt: skip
    for term in equation["terms"]:
        assert term["included"] == (term["pip"] > 0.5)
        assert term["shown"] == term["included"]
        assert term["why"] is None
    assert out["verdict"] == equation["verdict"] == {"kind": "found", "reason": eq.verdict.reason, "advice": ""}
    assert isinstance(equation["intercept"], float)
    assert equation["intercept_sd"] > 0
    low, high = equation["intercept_ci95"]
    assert low < equation["intercept"] < high


def test_damaged_files_are_refused(tmp_path, eq):
    path = tmp_path / "eq.json"
    eq.save(path)
    good = json.loads(path.read_text())
    with pytest.raises(FileFormatError):
        bq.load(tmp_path / "missing.json")
    for text in ("", "[1]", "{}", "null", "[" * 100_000, '{"format": "other"}', path.read_text()[:-40]):
        path.write_text(text)
        with pytest.raises(FileFormatError):
            bq.load(path)

    def spoiled(change):
        copy = json.loads(json.dumps(good))
        change(copy)
        path.write_text(json.dumps(copy))
        with pytest.raises(FileFormatError, match="damaged"):
            bq.load(path)

    spoiled(lambda c: c.pop("equations"))
    spoiled(lambda c: c["equations"][0]["terms"][0].update(name="__import__('os').system('true')"))
    spoiled(lambda c: c["equations"][0]["terms"][0].update(coef="NaN"))
    spoiled(lambda c: c["posteriors"][0].update(center=[1.0]))
    spoiled(lambda c: c["posteriors"][0].update(covariance=[[1.0]]))
    spoiled(lambda c: c["data"].update(chains=["x:v:a", "y"]))
    spoiled(lambda c: c["data"].update(chains="::"))
