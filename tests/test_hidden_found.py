"""A hidden state whose law is found among terms: first paths, answers, verdicts, files, and what is refused."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import BayeqError, ChainError, InputError
from bayeq.likelihood.hidden import _forgotten

K, C, ALPHA, BETA, GAMMA = 55.0, 0.6, 60.0, 2.0, 1.0
HYSTERESIS = "v, r, abs(v)*r, v*abs(r), x, v**3"
TRUE = {"a": {"x": -K, "v": -C, "u": 15.0}, "dr": {"v": -ALPHA, "abs(v)*r": -BETA, "v*abs(r)": GAMMA}}


def oscillator(seed: int, kind: str = "hysteresis", rows: int = 500, noise: float = 0.01) -> bq.Record:
    """Bouc and Wen's oscillator, one with Maxwell's element, or one with a cubic spring and nothing hidden."""
    rng = np.random.default_rng(seed)
    t, w, phase = np.arange(rows) * 0.01, rng.uniform(1.0, 20.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)

    def force(s):
        return 15.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1) / np.sqrt(6.0)

    def rate(s, y):
        x, v, r = y
        if kind == "hysteresis":
            change = ALPHA * v - BETA * abs(v) * r - GAMMA * v * abs(r)
        else:
            change = ALPHA * v - r / 0.2 if kind == "maxwell" else 3.0 * 15.0 * x**2 * v
        return [v, force(s) - C * v - K * x - r, change]

    x, v, r = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10).y
    channels = {"x": x, "v": v, "a": force(t) - C * v - K * x - r, "u": force(t) / 15.0}
    noisy = {name: one + noise * one.std() * rng.standard_normal(rows) for name, one in channels.items()}
    return bq.Record.from_arrays(noisy, time=t)


def found(record: bq.Record, seen: str = "x, v, u, x**3, r", hidden: str = HYSTERESIS, **options) -> bq.Equations:
    dictionary = {"a": seen, "dr": hidden}
    return bq.discover(record, chains=["x:v:a", "~r:"], inputs=["u"], dictionary=dictionary, **options)


@cache
def answer() -> bq.Equations:
    return found(oscillator(1))


def test_a_law_is_found_with_the_equation_that_its_state_is_in():
    eq = answer()
    assert eq.verdict.kind == "found"
    assert set(eq["a"].included) == {*TRUE["a"], "r"}
    assert set(eq["dr"].included) == set(TRUE["dr"])
    table = eq.table().set_index(["target", "term"])
    for target, terms in TRUE.items():
        for name, value in terms.items():
            row = table.loc[(target, name)]
            assert abs(row["coef"] - value) < 4.0 * row["sd"]
            assert row["sd"] < 0.05 * abs(value)
    assert table.loc[("a", "r"), "coef"] == pytest.approx(1.0, abs=1e-3)
    (hidden,) = eq.hidden
    assert not hidden.stated
    assert hidden.log_odds_without < -100.0


def test_what_is_printed_of_it(tmp_path, capsys):
    answer().save(tmp_path / "eq.json")
    assert main(["show", str(tmp_path / "eq.json")]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 100
    (frequency,) = (line for line in out.splitlines() if line.split()[:1] == ["f_n"])
    assert frequency.endswith("natural frequency without r")  # which adds to the stiffness
    assert "also in the equation: r (" in out
    law = out.partition("dr = ")[2]
    for name in TRUE["dr"]:  # each with its interval
        assert any(line.split()[:1] == [name] and " .. " in line for line in law.splitlines())
    told = answer().to_dict()
    assert told["modes"] == []
    assert {one["name"]: one["meaning"] for one in told["parameters"]}["zeta"] == "damping ratio without r"


def test_another_scale():
    eq = found(oscillator(1, rows=250), constraints="a: r ~ -1 +- 1e-6", holdout=0.0)
    assert set(eq["dr"].included) == set(TRUE["dr"])
    coef = eq["dr"].shown_coef
    assert coef["v"] == pytest.approx(ALPHA, rel=0.05)
    assert coef["v*abs(r)"] < 0.0


def test_a_state_that_is_not_needed_is_left_out():
    with pytest.warns(bq.errors.DataWarning, match="hidden r is not needed"):
        eq = found(oscillator(2, "cubic", rows=350, noise=0.02), holdout=0.0)
    assert [one.target for one in eq] == ["a"]
    assert set(eq["a"].included) == {"x", "v", "u", "x**3"}


@pytest.mark.parametrize("seed", [20, 21])
def test_friction_that_goes_with_the_velocity(seed):
    """Dahl's friction: without r the term of v stands for most of it, and a first path has that share of the term."""
    rng, t = np.random.default_rng(seed), np.arange(400) * 0.01
    w, phase = 2.0 * np.pi * np.linspace(0.2, 3.5, 14), rng.uniform(0.0, 2.0 * np.pi, 14)

    def force(s):
        return 1.9 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1)

    def rate(s, y):
        return [y[1], force(s) - 0.5 * y[1] - 70.0 * y[0] - y[2], 60.0 * y[1] - 25.0 * abs(y[1]) * y[2]]

    x, v, r = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10).y
    channels = {"x": x, "v": v, "a": force(t) - 0.5 * v - 70.0 * x - r, "u": force(t)}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(len(t)) for name, one in channels.items()}
    eq = found(bq.Record.from_arrays(noisy, time=t), "x, v, u, r", "v, r, abs(v)*r, v*abs(r), x", holdout=0.0)
    assert eq.verdict.kind == "found"
    assert set(eq["a"].included) == {"x", "v", "u", "r"}
    assert set(eq["dr"].included) == {"v", "abs(v)*r"}
    assert eq["dr"].shown_coef["abs(v)*r"] == pytest.approx(-25.0, rel=0.03)


def test_forms_that_say_the_same_are_told():
    """With v, x, u and r alone every sum of r and these obeys a law of the same terms."""
    eq = found(oscillator(3, "maxwell", rows=400, noise=0.02), hidden="v, r, x, u", holdout=0.0)
    assert eq.verdict.kind == "not determined"
    assert eq.hidden[0].log_odds_without < -100.0


@pytest.mark.slow  # the same from more channels: the test above
def test_from_displacement_alone():
    record = oscillator(1, rows=1500)
    dictionary = {"ddx": "x, dx, u, x**3, r", "dr": "dx, r, abs(dx)*r, dx*abs(r), x, dx**3"}
    eq = bq.discover(record, chains=["x::", "~r:"], inputs=["u"], dictionary=dictionary)
    assert set(eq["dr"].included) == {"dx", "abs(dx)*r", "dx*abs(r)"}
    assert set(eq["ddx"].included) == {"x", "dx", "u", "r"}


@pytest.mark.slow  # 15 s; hidden states and static laws each have quicker tests
def test_the_hysteretic_force_of_a_damper_on_a_test_machine():
    rng, t = np.random.default_rng(4), np.arange(1500) * 0.01
    w, phase = rng.uniform(1.0, 12.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)

    def speed(s):
        return 0.5 * (w * np.cos(np.multiply.outer(s, w) + phase)).sum(axis=-1)

    def rate(s, y):
        v = speed(s)
        return [20.0 * v - 1.5 * abs(v) * y[0] - 0.8 * v * abs(y[0])]

    x = 0.5 * np.sin(np.multiply.outer(t, w) + phase).sum(axis=-1)
    r = solve_ivp(rate, (0.0, t[-1]), [0.0], t_eval=t, rtol=1e-8, atol=1e-10).y[0]
    channels = {"x": x, "v": speed(t), "F": 5.0 * x + 0.6 * speed(t) + r}
    record = bq.Record.from_arrays(
        {name: one + 0.01 * one.std() * rng.standard_normal(len(t)) for name, one in channels.items()}, time=t
    )
    dictionary = {"F": "x, v, r, v*abs(v)", "dr": "v, r, abs(v)*r, v*abs(r), v**3"}
    eq = bq.discover(record, chains=["=F", "~r:"], inputs=["x", "v"], dictionary=dictionary)
    assert eq.verdict.kind == "found"
    assert set(eq["F"].included) == {"x", "v", "r"}
    assert set(eq["dr"].included) == {"v", "abs(v)*r", "v*abs(r)"}


def test_what_is_printed():
    text = str(answer())
    assert "\ndr = -" in text
    assert "hidden r: odds of the equations without it 1:" in text
    law = text[text.index("\ndr = -") :]
    assert "abs(v)*r" in law
    assert "R2" not in law  # of a rate that nobody measured


def test_saved_answers_run_as_before(tmp_path):
    eq, other = answer(), oscillator(5)
    eq.save(tmp_path / "eq.json")
    loaded = bq.load(tmp_path / "eq.json")
    assert str(loaded) == str(eq)
    assert loaded.hidden == eq.hidden
    runs = [one.simulate(other, draws=0).mean for one in (eq, loaded)]
    np.testing.assert_array_equal(runs[0]["r"], runs[1]["r"])
    assert np.std(runs[0]["x"] - other["x"]) < 0.05 * np.std(other["x"])
    y = [0.1, 0.2, 0.3]
    coef = eq["dr"].shown_coef
    rate = coef["v"] * 0.2 + coef["abs(v)*r"] * 0.2 * 0.3 + coef["v*abs(r)"] * 0.2 * 0.3
    assert loaded.rhs(0.0, y, [1.0])[2] == pytest.approx(rate)


def test_on_the_command_line(tmp_path, capsys):
    bq.write(oscillator(1, rows=200), tmp_path / "run.csv")
    command = ["discover", str(tmp_path / "run.csv"), "--chain", "x:v:a", "--chain", "~r:", "--input", "u", "--json"]
    command += ["--holdout", "0"]
    assert main([*command, "--dictionary", "a: x, v, u, r; dr: v, abs(v)*r, v*abs(r)"]) == 0
    read = json.loads(capsys.readouterr().out)
    assert read["hidden"][0]["stated"] is False
    assert {one["name"] for one in read["equations"][1]["terms"] if one["included"]} == set(TRUE["dr"])
    assert main([*command, "--dictionary", "a: x, v, u; dr: v, r"]) == 2
    assert "no equation has r by itself as a term" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"dictionary": "x, v, u, r"}, ChainError, "give each equation a dictionary"),
        ({"dictionary": {"a": "x, r"}}, BayeqError, "dr"),
        ({"dictionary": {"a": "x, v*r**2", "dr": "v"}}, InputError, "no equation has r by itself"),
        ({"constraints": "a: r == -1"}, InputError, "r has the coefficient 1"),
        ({"smooth": "none"}, InputError, "hidden states are found by the likelihood"),
        ({"law": "dq = r - q"}, ChainError, "one hidden state may have a dictionary"),
        ({"chains": ["x:v:a", "~r:", "~q:"]}, ChainError, "one hidden state may have a dictionary"),
    ],
)
def test_refusals_are_one_line(options, error, message):
    asked = {"chains": ["x:v:a", "~r:"], "inputs": ["u"], "dictionary": {"a": "x, v, u, r", "dr": HYSTERESIS}}
    with pytest.raises(error, match=message) as caught:
        bq.discover(oscillator(1, rows=300), **{**asked, **options})
    assert "\n" not in str(caught.value)


def test_a_path_is_forgotten_after_a_sixth_of_its_period_whatever_white_noise_it_has():
    t = np.arange(2000)
    wave = np.sin(2 * np.pi * t / 60)
    noisy = wave + 0.7 * np.random.default_rng(0).standard_normal(2000)
    assert _forgotten(wave) == pytest.approx(10, abs=1)
    assert _forgotten(noisy) == pytest.approx(10, abs=2)


def two_masses(seed: int, rows: int = 300) -> bq.Record:
    """A mass on a spring that drives another one, which is not measured."""
    rng = np.random.default_rng(seed)
    t, w, phase = np.arange(rows) * 0.02, rng.uniform(1.0, 18.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)

    def rate(s, y):
        x, other, v, its = y
        spring = 100.0 * (x - other) + 0.4 * (v - its)
        force = 10.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1) / np.sqrt(6.0)
        return [v, its, force - 80.0 * x - 0.5 * v - spring, spring / 1.25]

    y = solve_ivp(rate, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-10).y
    a = np.array([rate(s, column)[2] for s, column in zip(t, y.T, strict=True)])
    u = np.sin(np.multiply.outer(t, w) + phase).sum(axis=-1) / np.sqrt(6.0)
    channels = {"x1": y[0], "a1": a, "u": u}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(rows) for name, one in channels.items()}
    return bq.Record.from_arrays(noisy, time=t)


MASSES = {"a1": "x1, dx1, u, x1-x2, dx1-dx2, x1**3", "ddx2": "x2-x1, dx2-dx1, (x2-x1)**3"}


@cache
def of_two_masses() -> bq.Equations:
    return bq.discover(two_masses(1), chains=["x1::a1", "~x2::"], inputs=["u"], dictionary=MASSES)


def test_a_mass_that_nobody_measures_is_found_in_differences():
    eq = of_two_masses()
    assert eq.verdict.kind == "found"
    assert set(eq["a1"].included) == {"x1", "dx1", "u", "x1-x2", "dx1-dx2"}
    assert set(eq["ddx2"].included) == {"x2-x1", "dx2-dx1"}
    assert eq["ddx2"].shown_coef["x2-x1"] == pytest.approx(-80.0, rel=0.01)
    assert eq.physical()["m_2"].mean == pytest.approx(0.125, rel=0.02)  # 1.25 of the first, which u's 10 says is 1/10


def test_its_answer_is_saved_and_runs(tmp_path):
    eq = of_two_masses()
    eq.save(tmp_path / "eq.json")
    loaded, other = bq.load(tmp_path / "eq.json"), two_masses(2)
    assert [str(one.chain) for one in loaded] == ["x1::a1", "~x2::"]
    np.testing.assert_array_equal(loaded.predict(other), eq.predict(other))
    runs = [one.simulate(other, draws=0).mean["dx2"] for one in (eq, loaded)]
    np.testing.assert_array_equal(*runs)


def test_a_mass_with_a_spring_to_the_ground_has_no_unit():
    dictionary = {**MASSES, "ddx2": "x2, x2-x1, dx2-dx1"}
    with pytest.raises(InputError, match=r"x2 would do in any unit of it: have it in differences alone, as in x1-x2"):
        bq.discover(two_masses(1), chains=["x1::a1", "~x2::"], inputs=["u"], dictionary=dictionary)


def test_a_state_that_is_a_factor_alone_is_found():
    def rate(s, y):  # Lorenz
        return [10.0 * (y[1] - y[0]), y[0] * (28.0 - y[2]) - y[1], y[0] * y[1] - 8.0 / 3.0 * y[2]]

    t, rng = np.arange(600) * 0.01, np.random.default_rng(1)
    y = solve_ivp(rate, (0.0, t[-1]), [-3.0, -4.0, 22.0], t_eval=t, rtol=1e-9).y[:2]
    noisy = y + 0.01 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    record = bq.Record.from_arrays({"x": noisy[0], "y": noisy[1]}, time=t)
    dictionary = {"dx": "x, y, x**2", "dy": "x, y, x*z, x*y", "dz": "x, z, x*y, x**2"}
    eq = bq.discover(record, chains=["x", "y", "~z:"], dictionary=dictionary, holdout=0.0)
    assert [set(one.included) for one in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]
    assert eq["dy"].shown_coef["x*z"] == pytest.approx(1.0, rel=1e-4)
    assert eq["dz"].shown_coef["x*y"] == pytest.approx(-1.0, rel=0.05)
