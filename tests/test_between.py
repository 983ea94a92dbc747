"""What is known between equations and records: ties, coefficients measured before, differences by record."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.report.page import repeat_command
from bayeq.errors import BayeqWarning, InputError, UnknownNameError
from bayeq.expressions import parse
from bayeq.likelihood.fit import of_stated
from bayeq.likelihood.layout import Candidates, Stated
from bayeq.regression.constraints import parse_constraints, parse_ties
from bayeq.systems import BandLimitedForce, System, simulate

TERMS = [parse(text) for text in ("x1-x2", "x2-x1", "x1", "u")]


def test_a_tie_is_read() -> None:
    [(text, parts, value)] = parse_ties(["a1: x1-x2 == 2*(a2: x2-x1)", "u == 1"], TERMS, ["a1", "a2"])
    assert text.startswith("a1")
    assert (parts, value) == (((0, 0, 1.0), (1, 1, -2.0)), 0.0)
    assert parse_constraints(["a1: x1-x2 == 2*(a2: x2-x1)"], TERMS, ["a1", "a2"])[0].binding is False


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a1: x1-x2 == 0*(a2: x2-x1)", InputError),
        ("a1: x1-x2 == (a2: )", InputError),
        ("a1: x1-x2 == 2*(a2: x2-x1", InputError),
        ("a1: x1-x2 == 2*a2: x2-x1)", InputError),
        ("a1: x1-x2 <= a2: x2-x1", InputError),
        ("a1: x1-x2 == a3: x2-x1", UnknownNameError),
        ("a1: x1-x2 == a2: x9", UnknownNameError),
    ],
)
def test_what_is_wrong_with_a_tie_is_said(text: str, error: type[Exception]) -> None:
    with pytest.raises(error, match="constraint"):
        parse_ties([text], TERMS, ["a1", "a2"])


def test_a_factor_of_a_tie_without_its_sign_is_told() -> None:
    with pytest.raises(InputError, match=r"a \* is missing"):
        parse_ties(["a1: x1-x2 == 2(a2: x2-x1)"], TERMS, ["a1", "a2"])


@pytest.mark.parametrize("text", ["u ~ 1", "u + x1 ~ 1 +- 1", "u ~ one +- 2", "u ~ 1 +- 0", "u ~ 1 +- -1"])
def test_what_is_wrong_with_a_measured_coefficient_is_said(text: str) -> None:
    with pytest.raises(InputError, match=r"u ~ 0\.1 \+- 0\.001"):
        parse_constraints([text], TERMS, ["a1", "a2"])


def test_a_measured_coefficient_is_read_with_its_factor() -> None:
    first, second = parse_constraints(["a1: 2*u ~ 3 +/- 0.4"], TERMS, ["a1", "a2"])
    assert first.stated == ((3, 1.5, 0.2),)
    assert second.stated == ()


def test_statements_are_a_normal_likelihood() -> None:
    """Value, slope and curvature against the logarithm of the density by differences."""
    stated = (Stated(((0, 0, 1.0), (1, 1, -2.0)), 0.3, 0.5), Stated(((1, 1, 1.0),), 1.0, 0.2))
    chosen = Candidates(np.array([0, 0, 1]), np.array([0, 2, 1]))
    theta = np.array([0.7, -1.0, 0.4])

    def log_density(t: np.ndarray) -> float:
        return -0.5 * ((t[0] - 2.0 * t[2] - 0.3) / 0.5) ** 2 - 0.5 * ((t[2] - 1.0) / 0.2) ** 2

    found = of_stated(stated, chosen, theta)
    assert found.level == pytest.approx(log_density(theta))
    for k in range(3):
        step = 1e-5 * np.eye(3)[k]
        slope = (log_density(theta + step) - log_density(theta - step)) / 2e-5
        assert found.slope[k] == pytest.approx(slope, abs=1e-6)
        for j in range(3):
            other = of_stated(stated, chosen, theta + 1e-5 * np.eye(3)[j]).slope[k]
            assert -(other - found.slope[k]) / 1e-5 == pytest.approx(found.information[k, j], abs=1e-4)


TWO = System(
    name="two-masses",
    title="Two masses in a row",
    chains=("x1:v1:a1", "x2:v2:a2"),
    rhs={
        "x1": "v1",
        "v1": "u-300*x1-0.6*v1-200*(x1-x2)-0.4*(v1-v2)",
        "x2": "v2",
        "v2": "-100*(x2-x1)-0.2*(v2-v1)",
    },
    terms={"a1": {}, "a2": {}},
    parameters={},
    initial={"x1": 0.0, "v1": 0.0, "x2": 0.0, "v2": 0.0},
    inputs=("u",),
    force=BandLimitedForce(30.0, (0.2, 6.0)),
    n=600,
    fs=200.0,
    noise=0.02,
    citation="made for this test",
)
DICTIONARY = {"ddx1": "x1, dx1, x1-x2, dx1-dx2, u", "ddx2": "x2, dx2, x2-x1, dx2-dx1, u"}


def _two_masses(constraints: list[str]) -> bq.Equations:
    record = simulate(TWO, seed=5, n=300)
    return bq.discover(
        record, chains=["x1::", "x2::"], inputs=["u"], dictionary=DICTIONARY, constraints=constraints, holdout=0.0
    )


def test_a_true_tie_holds_and_a_wrong_one_is_refused_with_its_odds() -> None:
    free = _two_masses([])
    tied = _two_masses(["ddx1: x1-x2 == 2*(ddx2: x2-x1)"])
    one, two = (eq.shown_coef for eq in tied)
    sd = {eq.target: dict(zip(eq.posterior.names, eq.shown_posterior.sd, strict=True)) for eq in tied}
    assert one["x1-x2"] == pytest.approx(2.0 * two["x2-x1"], abs=0.3 * sd["ddx1"]["x1-x2"])
    assert (
        sd["ddx1"]["x1-x2"]
        <= 1.02 * dict(zip(free[0].posterior.names, free[0].shown_posterior.sd, strict=True))["x1-x2"]
    )
    assert not tied.warnings
    with pytest.warns(BayeqWarning, match=r"contradicts ddx1: x1-x2 == ddx2: x2-x1 \(odds 1:"):
        wrong = _two_masses(["ddx1: x1-x2 == ddx2: x2-x1"])
    assert [eq.shown for eq in wrong] == [eq.shown for eq in free]
    assert not wrong.constraints
    assert tied.constraints == ("ddx1: x1-x2 == 2*(ddx2: x2-x1)",)


def test_of_several_ties_only_the_wrong_one_is_refused() -> None:
    true, wrong = "ddx1: x1-x2 == 2*(ddx2: x2-x1)", "ddx1: dx1-dx2 == 9*(ddx2: dx2-dx1)"
    with pytest.warns(BayeqWarning, match=r"contradicts ddx1: dx1-dx2 == 9\*\(ddx2: dx2-dx1\) \(odds 1:"):
        found = _two_masses([true, wrong])
    assert found.constraints == (true,)


def test_an_equality_in_one_equation_is_a_tie_too() -> None:
    record = simulate("duffing", n=450, fs=250.0, seed=1, noise=0.05)
    ask = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "holdout": 0.0}
    ask |= {"dictionary": "x, v, x**3, u, x**2, v*abs(v)"}
    (free,) = bq.discover(record, **ask)
    (held,) = bq.discover(record, constraints=["u == 1"], **ask)
    assert held.shown == free.shown
    assert held.shown_coef["u"] == 1.0
    with pytest.warns(BayeqWarning, match=r"contradicts u == 1\.1 \(odds 1:.*shown without"):
        wrong = bq.discover(record, constraints=["u == 1.1", "v <= 0"], **ask)
    assert wrong[0].shown_coef["u"] == pytest.approx(1.0, abs=0.02)
    assert wrong.constraints == ("v <= 0",)
    # four standard deviations off
    with pytest.warns(BayeqWarning, match=r"speaks against u == 1\.0105 \(odds 1:.*shown with it"):
        doubtful = bq.discover(record, constraints=["u == 1.0105"], **ask)
    assert doubtful[0].shown_coef["u"] == 1.0105


def test_a_difference_the_other_way_round_is_the_same_term() -> None:
    terms = [parse(text) for text in ("x2-x1", "x1", "u")]
    [(_, parts, _)] = parse_ties(["2*(a1: x1-x2) == a2: x2-x1"], terms, ["a1", "a2"])
    assert parts == ((0, 0, -2.0), (1, 0, -1.0))
    one, _ = parse_constraints(["a1: 2*(x1-x2) == -3"], terms, ["a1", "a2"])
    assert (one.equalities.eliminated.tolist(), one.equalities.offsets.tolist()) == ([0], [1.5])
    with pytest.raises(InputError, match=r"term x2-x1 was left out of the dictionary: a copy of x1-x2"):
        parse_ties(["a1: x1 == a2: x1-x2"], terms[1:], ["a1", "a2"], {"x2-x1": "a copy of x1-x2 on the data"})
    allowed = np.array([[True, True, True], [True, True, False]])
    with pytest.raises(InputError, match=r"u is no candidate of a2"):
        parse_ties(["a1: u == a2: u"], terms, ["a1", "a2"], allowed=allowed)


def test_a_coefficient_that_was_measured_before_is_sharper_and_a_wrong_one_is_told() -> None:
    record = simulate("duffing", n=450, fs=250.0, seed=1, noise=0.05)
    ask = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "holdout": 0.0}
    ask |= {"dictionary": "x, v, x**3, u, x**2, v*abs(v)"}
    (known,) = bq.discover(record, constraints=["u ~ 1 +- 0.0005"], **ask)
    u = list(known.posterior.names).index("u")
    # the record alone knows it five times less well
    assert known.shown_posterior.sd[u] == pytest.approx(0.0005, rel=0.15)
    assert known.shown_coef["u"] == pytest.approx(1.0, abs=0.001)
    with pytest.warns(BayeqWarning, match="contradicts u ~ 1.1"):
        bq.discover(record, constraints=["u ~ 1.1 +- 0.001"], **ask)
    # the discrepancy takes up what a wrong damping leaves: what is printed is far from it, its posterior was near
    with pytest.warns(BayeqWarning, match=r"contradicts v ~ -3 \+- 0\.01: it says -[12]\.\d+"):
        bq.discover(record, constraints=["v ~ -3 +- 0.01"], **ask)
    # a term that is not needed is left out, and the discrepancy hides how well the sign of damping is known
    with pytest.warns(BayeqWarning, match=r"contradicts v\*abs\(v\) ~ 0\.3 \+- 0\.01: it says 0"):
        bq.discover(record, constraints=["v*abs(v) ~ 0.3 +- 0.01"], **ask)
    bare = ask | {"dictionary": "x, v, x**3, u"}
    with pytest.warns(BayeqWarning, match=r"contradicts v ~ 2 \+- 0\.01: it says -[12]\.\d+"):
        bq.discover(record, constraints=["v ~ 2 +- 0.01"], **bare)
    # from displacement alone the discrepancy takes up two thirds of what a wrong mass leaves
    alone = {"chains": "x::", "inputs": ["u"], "holdout": 0.0, "dictionary": "x, dx, x**3, u"}
    (free,) = bq.discover(simulate("duffing", n=900, fs=250.0, seed=1, noise=0.02), **alone)
    with pytest.warns(BayeqWarning, match=r"contradicts u ~ 1\.1 ") as caught:
        bq.discover(simulate("duffing", n=900, fs=250.0, seed=1, noise=0.02), constraints=["u ~ 1.1 +- 0.001"], **alone)
    said = next(re.search(r"it says ([\d.]+)", str(one.message)) for one in caught if "it says" in str(one.message))
    assert float(said[1]) == pytest.approx(free.shown_coef["u"], abs=0.004)
    with pytest.raises(InputError, match="likelihood of the record"):
        bq.discover(record, constraints=["u ~ 1 +- 0.1"], smooth="none", **ask)


def _runs(heavier: float) -> list[bq.Record]:
    """Three records of an oscillator, the last one of which has another mass."""
    return [
        simulate("linear", seed=k, n=250, noise=0.02, parameters={"m": heavier if k == 2 else 1.0}) for k in range(3)
    ]


def test_a_record_of_another_mass_differs_in_every_coefficient_and_no_other_record_does() -> None:
    names = ("x", "v", "u")
    ask = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "holdout": 0.0}
    (eq,) = bq.discover(_runs(1.5), dictionary="x, v, u, x**3", differs="all", **ask)
    assert set(eq.shown) == {*names, *(f"{name}*run3" for name in names)}
    units = dict(zip(eq.posterior.names, eq.coef_units, strict=True))
    assert all(units[f"{name}*run3"] == units[name] for name in names)
    # a mass of 1.5 divides every coefficient by 1.5
    for name in names:
        assert eq.shown_coef[f"{name}*run3"] == pytest.approx(-eq.shown_coef[name] / 3.0, rel=0.2)
    (same,) = bq.discover(_runs(1.0), dictionary="x, v, u, x**3", differs="x, u", **ask)
    assert set(same.shown) == set(names)


def test_records_that_differ_are_numbered_as_in_the_fit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / f"{k}.csv" for k in range(3)]
    for file, record in zip(files, _runs(1.5), strict=True):
        bq.write(record, file)
    given, saved = [str(file) for file in files], str(tmp_path / "eq.json")
    asked = ["discover", *given, "--chain", "x:v:a", "--input", "u", "--dictionary", "x, v, u", "--differs", "x, v, u"]
    assert main([*asked, "--save", saved, "--forecast", str(tmp_path / "runs.csv"), "--holdout", "0"]) == 0
    assert "run2 0" not in capsys.readouterr().out
    assert main(["predict", saved, *given]) == 0
    assert "free runs follow the record" in capsys.readouterr().out
    assert main(["predict", saved, *given[:2]]) == 2
    said = capsys.readouterr().err
    assert "differ between the 3 records of the equations: give as many, in that order, or channels run2, run3" in said
    eq = bq.load(saved)
    assert eq.score(_runs(1.5)).one_step["a"] < 0.1
    marked = _runs(1.5)[2].with_channels({"run2": np.zeros(250), "run3": np.ones(250)})
    assert eq.score(marked).one_step["a"] < 0.1
    words = shlex.split(repeat_command(eq))
    assert words[words.index("--differs") + 1] == "x, v, u"
    assert "run2" not in words


def test_differences_need_records_and_candidates() -> None:
    ask = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
    with pytest.raises(InputError, match="2 to 20 are needed"):
        bq.discover(_runs(1.0)[0], differs="all", **ask)
    with pytest.raises(UnknownNameError, match="candidate term"):
        bq.discover(_runs(1.0), differs="x**99", **ask)
    taken = [record.with_channels({"run2": record["x"]}) for record in _runs(1.0)]
    with pytest.raises(InputError, match="run2 numbers a record"):
        bq.discover(taken, differs="all", **ask)
