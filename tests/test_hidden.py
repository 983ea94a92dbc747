"""Hidden states with stated laws: roles, paths, first constants, answers, and what users see of them."""

from __future__ import annotations

import json
import math
import re
import shlex
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.answer import HiddenState
from bayeq.equation.report.page import repeat_command
from bayeq.errors import BayeqError, ChainError, InputError
from bayeq.expressions import Unknown
from bayeq.likelihood.hidden import _peaks
from bayeq.states import Roles, with_laws
from bayeq.states.hidden import hidden_columns

LAW = "df = (u - f)/{tau}"
TAU, TRUE = 0.05, {"x": -100.0, "dx": -0.8, "f": 8.0, "x**3": -300.0}
TERMS = {"ddx": "x, dx, f, x**2, x**3, dx*abs(dx), u"}


def actuator(seed: int, tau: float = TAU, rows: int = 600) -> bq.Record:
    """A Duffing oscillator behind an actuator of first order; displacement and command with 2 % of noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * 0.005
    w, phase = rng.uniform(2.0, 25.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)

    def command(s):
        return 2.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1)

    def rate(s, y):
        force = y[2] if tau else command(s)
        lagged = (command(s) - y[2]) / tau if tau else 0.0
        return [y[1], -100.0 * y[0] - 0.8 * y[1] - 300.0 * y[0] ** 3 + 8.0 * force, lagged]

    x = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10).y[0]
    channels = {"x": x, "u": command(t)}
    noisy = {name: one + 0.02 * one.std() * rng.standard_normal(rows) for name, one in channels.items()}
    return bq.Record.from_arrays(noisy, time=t)


@cache
def answer() -> bq.discover:  # type: ignore[valid-type]
    return bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary=TERMS, law=LAW)


def test_the_lag_of_a_channel_beside_a_hidden_state():
    record = actuator(1, rows=400)
    late = bq.Record.from_arrays({"x": record["x"][:-2], "u": record["u"][2:]}, time=record.time[:-2])  # u comes early
    shown = {"ddx": "x, dx, f, x**3"}
    early = bq.discover(late, chains="x::", inputs=["u"], dictionary=shown, law="df = (u - f)/0.05", lag_sd={"u": 0.01})
    lag = early.data.sensors.lags["u"]
    assert abs(lag.value + 0.01) < 4.0 * lag.sd < 0.004
    with pytest.raises(InputError, match=r"gain_sd: .* hidden state"):
        bq.discover(record, chains="x::", inputs=["u"], dictionary=shown, law=LAW, gain_sd={"u": 0.05})


# --- roles and paths ------------------------------------------------------------------------------------------------


def test_a_law_is_a_chain_without_channels():
    roles = with_laws([LAW, "dg = f - g"], Roles.parse("x::", inputs=["u"]))
    assert roles.states == ("x", "dx", "f", "g")
    assert roles.targets == ("ddx", "df", "dg")
    assert roles.channels == ("x", "u")
    assert [str(chain) for chain in roles.chains] == ["x::", "~f:", "~g:"]
    assert roles.seen == Roles.parse("x::", inputs=["u"])


@pytest.mark.parametrize(
    ("law", "why"),
    [
        ("f = u - f", "write the rate of a state"),
        ("df", "write the rate of a state"),
        ("df =", "write the rate of a state"),
        ("dx = u", "x has an equation"),
        ("du = x", "u has an equation"),
        ("df = (u - f)/{tau} + w", "w"),
        ("df = {a} + {b}*f + {c}*u + {d}", "at most 3 constants"),
        ("df = 1", "depends on states or inputs"),
        ("df = {a: 1..2}", "depends on states or inputs"),
        ("df = x*0", "does not change on the data"),
    ],
)
def test_laws_that_cannot_be(law, why):
    with pytest.raises(BayeqError, match=why):
        bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary="x, dx, f", law=law)


@pytest.mark.parametrize("tau", [TAU, 0.0])
def test_files_have_the_hidden_state_of_their_common_equation(tmp_path, tau):
    bq.write(actuator(1, tau, rows=300), tmp_path / "1.csv")
    options = {"chains": "x::", "inputs": ["u"], "law": "df = (u - f)/0.05", "common": True}
    dictionary = "x, dx, f, x**3" if tau else "x, dx, f, u, x**3"  # without a lag the law is not needed
    (one,) = bq.batch(tmp_path / "1.csv", store=tmp_path / "b.db", dictionary=dictionary, **options)
    assert [eq.target for eq in one.equations] == ["ddx", "df"][: 2 if tau else 1]
    assert set(one.equations[0].shown) == {"x", "dx", "f" if tau else "u", "x**3"}


@pytest.mark.slow  # of a law that is found: test_hidden_found
def test_a_scale_that_is_stated_is_the_one_of_the_fit():
    law = "df = {k: 5..100}*u - {c: 1..200}*f"
    eq = bq.discover(
        actuator(1, rows=400),
        chains="x::",
        inputs=["u"],
        dictionary="x, dx, x**3, f",
        law=law,
        constraints="f == 4",
        holdout=0.0,
    )
    found = {one.name: one.value for one in eq.constants}
    assert eq[0].shown_coef["f"] == 4.0
    # 8 f' with f' = (u - f')/tau, in the scale of f = 2 f'
    assert (found["c"], found["k"]) == (pytest.approx(1.0 / TAU, rel=0.05), pytest.approx(2.0 / TAU, rel=0.05))


def test_a_hidden_state_needs_a_law_and_a_use():
    with pytest.raises(ChainError, match="state its rate, --law"):
        bq.discover(actuator(1), chains=["x::", "~f:"], inputs=["u"], dictionary="x, dx, f")
    with pytest.raises(InputError, match="no term uses f"):
        bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary="x, dx, u", law="df = u")
    for law in ("df = ddx - f", "df = u*ddx"):
        with pytest.raises(InputError, match="law df: ddx is a highest derivative: use states and inputs"):
            bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary="x, dx, f", law=law)
    with pytest.raises(InputError, match="no term uses f"):  # its own law is no use of it
        bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary="x, dx, u", law="df = (u - f)/{tau}")
    with pytest.raises(InputError, match="give its range"):
        bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary="x, dx, f", law="df = u - {a}*f**3")


def test_the_path_is_that_of_the_differential_equation():
    roles = with_laws("df = (u - f)/{tau}", Roles.parse("x::", inputs=["u"]))
    law = roles.hidden[0].law.with_unknowns({"tau": Unknown("tau", 0.01, 1.0, 0.1)})
    roles = roles.with_chains([roles.chains[0], roles.chains[1].with_law(law)])
    t = np.arange(2000) / 1000
    u = 1.0 + np.sin(3.0 * t)
    found = hidden_columns(roles, {"x": t, "u": u}, t)
    w, tau = 3.0, 0.1
    steady = 1.0 + (np.sin(w * t) - w * tau * np.cos(w * t)) / (1.0 + (w * tau) ** 2)
    assert found["f"][0] == pytest.approx(1.0)  # where it rests under the first sample
    assert found["f"][1000:] == pytest.approx(steady[1000:], abs=1e-4)
    assert found["df"] == pytest.approx((u - found["f"]) / tau)


# --- the answer -----------------------------------------------------------------------------------------------------


def test_an_actuator_s_lag_is_found_with_the_law_behind_it():
    eq = answer()
    assert set(eq["ddx"].included) == set(TRUE)
    assert eq.verdict.kind == "found"
    table = eq.table().set_index(["target", "term"])
    for name, value in TRUE.items():
        row = table.loc[("ddx", name)]
        assert abs(row["coef"] - value) < 4.0 * row["sd"]
    (tau,) = eq.constants
    assert tau.ci95[0] < TAU < tau.ci95[1]
    assert tau.ci95[1] - tau.ci95[0] < 0.05 * TAU
    assert eq["df"].shown_coef == {"(u-f)/{tau}": pytest.approx(1.0, abs=1e-5)}
    assert eq.hidden[0].state == "f"
    assert eq.hidden[0].log_odds_without < -50.0


def test_a_hidden_state_that_is_not_needed_is_left_out():
    asked = {"chains": "x::", "inputs": ["u"], "dictionary": TERMS, "law": LAW, "holdout": 0.0}
    with pytest.warns(bq.errors.DataWarning, match="hidden f is not needed"):
        eq = bq.discover(actuator(2, tau=0.0), **asked)
    assert [one.target for one in eq] == ["ddx"]
    assert set(eq["ddx"].included) == {"x", "dx", "u", "x**3"}
    assert eq.hidden[0].log_odds_without > -3.0
    words = shlex.split(repeat_command(eq))
    assert "--law" not in words
    assert words[words.index("--dictionary") + 1] == "ddx: x, dx, x**2, x**3, dx*abs(dx), u"


def test_what_is_printed():
    text = str(answer())
    assert "df = (u-f)/{tau}" in text
    assert "hidden f: odds of the equations without it 1:" in text


def test_a_stated_law_is_written_as_it_was_stated(tmp_path):
    eq = answer()
    f, u = sympy.symbols("f u")
    assert sympy.simplify(eq["df"].to_sympy().rhs - (u - f) / eq.constants[0].value) == 0
    assert eq["df"].to_latex("brackets") == r"\dot{f} = \frac{- f + u}{\tau}"
    assert eq["df"].coef == {"(u-f)/{tau}": 1.0}
    words = shlex.split(repeat_command(eq))
    assert re.fullmatch(r"df = \(u-f\)/\{tau: [\d.]+\.\.[\d.]+\}", words[words.index("--law") + 1])
    assert "~f:" not in words
    eq.report(tmp_path / "out.html")
    page = " ".join(re.sub(r"<[^>]+>", " ", (tmp_path / "out.html").read_text(encoding="utf-8")).split())
    assert "Hidden f: odds of the equations without it 1:" in page
    assert len(re.findall(r"intercept (?:none|[-\d\N{MINUS SIGN}])", page)) == 1
    assert page.count("more candidates are not included") == 1


def test_saved_answers_run_and_predict_as_before(tmp_path):
    eq = answer()
    eq.save(tmp_path / "eq.json")
    loaded, other = bq.load(tmp_path / "eq.json"), actuator(5)
    assert loaded.hidden == eq.hidden
    assert loaded.constants == eq.constants
    np.testing.assert_array_equal(loaded.predict(other), eq.predict(other))
    runs = [one.simulate(other, draws=0).mean["f"] for one in (eq, loaded)]
    np.testing.assert_array_equal(*runs)
    y = [0.1, 0.2, 0.3]
    assert eq.rhs(0.0, y, [1.0])[2] == pytest.approx((1.0 - 0.3) / eq.constants[0].value, rel=1e-5)
    assert eq.score(other).one_step["ddx"] < 0.3


@pytest.mark.parametrize("state", ["f", "g"])
def test_odds_that_are_not_finite_keep_their_side(tmp_path, state):
    """Without f, which the equations have, the record cannot be explained; with g, which they lack, it could not."""
    odds = -math.inf if state == "f" else math.inf
    replace(answer(), hidden=(HiddenState(state, odds),)).save(tmp_path / "eq.json")
    assert bq.load(tmp_path / "eq.json").hidden == (HiddenState(state, odds),)


def test_what_is_refused():
    with pytest.raises(InputError, match="every state measured"):
        answer().refine(actuator(1))
    with pytest.raises(InputError, match="hidden states"):
        answer().plan()
    with pytest.raises(InputError, match="likelihood of the record"):
        bq.discover(actuator(1), chains="x::", inputs=["u"], dictionary=TERMS, law=LAW, smooth="none")


def test_on_the_command_line(tmp_path, capsys):
    bq.write(actuator(1, rows=250), tmp_path / "run.csv")
    command = ["discover", str(tmp_path / "run.csv"), "--chain", "x::", "--input", "u", "--law", LAW, "--json"]
    assert main([*command, "--dictionary", "ddx: x, dx, f, x**3", "--holdout", "0"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in found["constants"]] == ["tau"]
    assert found["hidden"][0]["state"] == "f"
    assert math.isfinite(found["hidden"][0]["log_odds_without"])
    assert found["equations"][1]["equation"] == "df = (u-f)/{tau}"


# --- several values of the constants --------------------------------------------------------------------------------


def two_lags(rows: int = 350) -> bq.Record:
    """A room of time constant 2 s behind a sensor of .6 s."""
    rng, t = np.random.default_rng(1), np.arange(rows) * 0.05
    w, phase = rng.uniform(0.1, 3.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)

    def heater(s):
        return 1.0 + np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1) / 2.0

    y = solve_ivp(lambda s, y: [0.5 * (heater(s) - y[0]), (y[0] - y[1]) / 0.6], (0.0, t[-1]), [1.0, 1.0], t_eval=t).y[1]
    return bq.Record.from_arrays({"s": y + 0.01 * y.std() * rng.standard_normal(rows), "u": heater(t)}, time=t)


def through(law: str, dictionary: str = "T, s, u, s**2") -> bq.Equations:
    return bq.discover(two_lags(), chains="s", inputs=["u"], dictionary=dictionary, law=law, holdout=0.0)


def test_two_lags_in_a_row_may_change_places():
    eq = through("dT = {a: 0.02..20}*(u - T)")
    assert eq.verdict.kind == "not determined"
    assert "s and T may change places" in eq["ds"].verdict.reason


def test_a_range_says_which_lag_is_which():
    eq = through("dT = {a: 0.02..1}*(u - T)")  # smoothed rows explain most at its upper end
    assert eq.verdict.kind == "found"
    assert eq.constants[0].value == pytest.approx(0.5, rel=0.05)
    assert eq["ds"].shown_coef["T"] == pytest.approx(1.0 / 0.6, rel=0.05)


def test_peaks_of_a_grid_are_sought_between_its_nodes():
    place = np.linspace(0.0, 10.0, 11)

    def score(at):  # a broad peak at 2.3, a higher one at 7.6, and what rises towards the end
        return 50.0 * np.exp(-((at[0] - 2.3) ** 2)) + 60.0 * np.exp(-((at[0] - 7.6) ** 2)) + np.exp(6.0 * (at[0] - 9.3))

    free = _peaks(score, [place], np.array([False]))
    assert free[0] == (10.0,)
    assert free[1][0] == pytest.approx(7.6, abs=0.02)
    inner = _peaks(score, [place], np.array([True]))
    assert [at[0] for at in inner] == pytest.approx([7.6, 2.3], abs=0.02)
    assert _peaks(lambda at: -math.inf, [place], np.array([False])) == []
