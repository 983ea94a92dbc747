"""The few lines that `bayeq discover` prints."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.brief import brief

FULL = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    path = tmp_path_factory.mktemp("brief") / "duffing.csv"
    bq.write(bq.simulate("duffing", n=2000, seed=1), path)
    eq = bq.discover(bq.read(path), displacement="x", velocity="v", acceleration="a", force="u")
    eq.save(path.with_name("eq.json"))
    return path, eq


def printed(capsys, *arguments):
    assert main([*map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_an_oscillator_in_sixteen_lines(answer, capsys):
    path, eq = answer
    out = printed(capsys, "show", path.with_name("eq.json"))
    lines = out.splitlines()
    assert len(lines) <= 16
    assert max(map(len, lines)) <= 100
    assert lines[0].startswith("verdict: found: no test speaks against it for x -")
    assert "m*a + c*v + k*x + k3*x**3 = u" in lines
    assert eq[0].text in lines
    for one in eq.physical(draws=2000):
        if one.symbol != "omega_n":
            (line,) = (line for line in lines if line.split()[:1] == [one.symbol])
            assert float(line.split()[1]) == pytest.approx(one.mean, rel=1e-3)
    assert re.search(
        r"^checked on 400 rows that were not used: a within [\d.]+ %, free run within x", out, re.MULTILINE
    )
    assert "what is left looks like noise" in " ".join(out.split())
    assert "sign(x) below" in out  # too small to be seen
    assert lines[-1].startswith("2000 rows at 1000 Hz, 2 s, of duffing.csv, all used")
    # all terms are certain and there is no rival: no table
    assert "probability" not in out.lower().split("too small")[0]
    assert "PIP" not in out


def test_all_of_it_on_request(answer, capsys):
    path, _ = answer
    full = printed(capsys, "show", path.with_name("eq.json"), "--verbose")
    assert "| term " in full
    assert "runners-up" in full


@pytest.mark.filterwarnings("ignore::bayeq.errors.DataWarning")
def test_no_equation_is_printed_where_none_was_found(tmp_path, capsys):
    rng = np.random.default_rng(0)
    path = tmp_path / "walk.csv"
    bq.write(
        bq.Record.from_arrays(x=rng.normal(size=400).cumsum(), a=rng.normal(size=400), u=rng.normal(size=400), fs=50.0),
        path,
    )
    out = printed(
        capsys,
        "discover",
        path,
        "--disp",
        "x",
        "--acc",
        "a",
        "--force",
        "u",
        "--smooth",
        "none",
        "--dictionary",
        "x, u",
    )
    assert out.startswith("verdict: none: ")
    assert "a = " not in out
    assert f"Try: bayeq info {path}" in " ".join(out.split())


@pytest.mark.filterwarnings("ignore::bayeq.errors.AmbiguityWarning")
def test_terms_in_doubt_have_probabilities(tmp_path, capsys):
    path = tmp_path / "few.csv"
    bq.write(bq.simulate("duffing", n=400, seed=0, noise=0.2), path)
    out = printed(capsys, "discover", path, *FULL, "--dictionary", "x, v, x**3, v**3, u")
    assert out.startswith("verdict: not determined: ")
    rows = [line.split() for line in out.splitlines()]
    (header,) = (row for row in rows if row[:1] == ["term"])
    assert header[-1] == "PIP"
    (damping,) = (row for row in rows if row[:1] == ["v"] and len(row) > 5)
    assert 0.5 < float(damping[-1]) < 0.99


@pytest.mark.filterwarnings("ignore::bayeq.errors.TermWarning")
def test_a_term_that_another_may_stand_for_is_named(tmp_path, capsys):
    record = bq.simulate("duffing", n=600, seed=1)
    path = tmp_path / "above.csv"
    bq.write(bq.Record.from_arrays({**{k: record[k] for k in "vau"}, "x": record["x"] + 2.0}, time=record.time), path)
    out = printed(capsys, "discover", path, *FULL, "--dictionary", "x, v, x**2, x**3, u, x*abs(x)*x, x*x*x")
    assert "x*abs(x)*x is the same as x**3 on this record: either may be right beyond it" in out
    assert "x*x*x is" not in out


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_late_force_is_the_likely_cause_where_nothing_is_found(tmp_path, capsys):
    record = bq.simulate("duffing", n=2040, seed=1)
    path = tmp_path / "late.csv"
    channels = {**{k: record[k][40:] for k in "xva"}, "u": record["u"][:-40]}
    bq.write(bq.Record.from_arrays(channels, time=record.time[40:]), path)
    out = printed(capsys, "discover", path, *FULL, "--dictionary", "x, v, x**3, u", "--smooth", "none")
    assert out.startswith("verdict: none: the terms explain little of a")
    assert "Likely u may be 0.04 s late: --lag-sd u=0.05 learns that." in out


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_warning_with_a_remedy_may_say_why_nothing_is_found():
    noise = dict(zip("xvau", np.random.default_rng(1).normal(size=(4, 400)), strict=True))
    eq = bq.discover(bq.Record.from_arrays(noise, fs=100.0), chains="x:v:a", inputs=["u"], dictionary=["x", "v", "u"])
    assert eq.verdict.kind == "none"
    assert "Try: bayeq info" in brief(eq)
    warned = replace(eq, warnings=("a may be noise", "a has a mean of 2: take it out (--remove-offset a)"))
    assert "A warning may say why: a has a mean of 2: take it out (--remove-offset a)." in brief(warned)


def test_an_offset_of_the_force_is_offered_beside_a_position_of_rest(tmp_path, capsys):
    record = bq.simulate("duffing", n=2000, seed=1)
    path = tmp_path / "moved.csv"
    for offset, said in ((40.0, True), (0.0, False)):
        moved = bq.Record.from_arrays({**{k: record[k] for k in "xva"}, "u": record["u"] + offset}, time=record.time)
        bq.write(moved, path)
        out = printed(capsys, "discover", path, *FULL, "--dictionary", "x, v, x**2, x**3, u")
        assert ("but for the constant the law is odd: u may have an offset: --remove-offset u=" in out) == said


def test_intervals_of_several_equations(tmp_path, capsys):
    path = tmp_path / "flow.csv"
    bq.write(bq.simulate("vanderpol", n=600, seed=1), path)
    out = printed(capsys, "discover", path, "--chain", "x", "--chain", "y", "--dictionary", "x, y, x**2*y, x**3")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 100
    for name in ("x", "y", "x**2*y"):
        assert any(line.split()[:1] == [name] and " .. " in line for line in lines)


def test_of_a_target_that_nobody_measured_the_runs_are_printed(tmp_path, capsys):
    path = tmp_path / "duffing.csv"
    bq.write(bq.simulate("duffing", n=600, seed=1), path)
    asked = ["discover", path, "--disp", "x", "--force", "u", "--dictionary", "x, dx, x**3, u"]
    out = printed(capsys, *asked)
    assert "ddx within" not in out
    assert re.search(r"that were not used: free run within x [\d.]+ %", out)
    assert "held-out rows (" in printed(capsys, *asked, "--verbose")


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_rows_at_rest_are_said_to_test_little(tmp_path, capsys):
    t = np.arange(600) / 10
    rng, path = np.random.default_rng(0), tmp_path / "down.csv"
    bq.write(bq.Record.from_arrays(s=3000.0 * np.exp(-0.2 * t) + rng.normal(size=600), time=t), path)
    out = printed(capsys, "discover", path, "--chain", "s", "--dictionary", "s, s**2", "--save", tmp_path / "eq.json")
    said = " ".join(out.split())
    assert "rows that were not used: s hardly moves there, which tests little" in said
    assert "%" not in said.partition("checked on")[2]
    assert bq.load(tmp_path / "eq.json").scores.still == ("s",)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_an_answer_in_much_doubt_is_short_too(tmp_path, capsys):
    path = tmp_path / "few.csv"
    bq.write(bq.simulate("duffing", n=400, seed=0, noise=0.2), path)
    lines = printed(capsys, "discover", path, *FULL).splitlines()
    assert lines[0].startswith("verdict: not determined: ")
    assert len(lines) <= 16
    assert max(map(len, lines)) <= 100
    said = " ".join(" ".join(lines).split())
    assert re.search(r"95 % intervals: x \(.*in doubt: x \(PIP 0\.\d+\), .*sign\(x\) \(PIP 0\.\d+, not in it\)", said)
    assert "* interval over all models that hold the term" in said


def test_a_series_for_a_kink_is_named(capsys, tmp_path):
    """A spring that is 10 % stiffer beyond 2 mm: polynomials fit it as well, with another slope at rest."""
    rng, t = np.random.default_rng(926510), np.arange(4000) / 400.0
    w, phase = 2.0 * np.pi * np.linspace(0.8, 11.0, 25), rng.uniform(0.0, 2.0 * np.pi, 25)

    def force(s):
        return 2.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1)

    def acceleration(s, x, v):
        stop = np.maximum(x - 2e-3, 0.0) + np.minimum(x + 2e-3, 0.0)
        return 0.186 * force(s) - 1240.0 * (x + 0.1 * stop) - 1.06 * v

    x, v = solve_ivp(lambda s, y: [y[1], acceleration(s, *y)], (0.0, 10.0), [0, 0], t_eval=t, max_step=2e-3).y
    channels = {"x": x, "v": v, "a": acceleration(t, x, v), "u": force(t)}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(len(t)) for name, one in channels.items()}
    bq.write(bq.Record.from_arrays(noisy, time=t), tmp_path / "stop.csv")
    said = printed(capsys, "discover", tmp_path / "stop.csv", "--chain", "x:v:a", "--input", "u")
    assert re.search("nearly true: x has a kink near -0.00(19|2) and 0.00(19|2), which no candidate has", said)
