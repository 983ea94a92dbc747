"""Sums of states that are conserved: flows and coefficients, their priors, and equations that balance exactly."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import BayeqWarning, InputError, TermWarning, UnknownNameError
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.likelihood.steps import Flows
from bayeq.regression.constraints import parse_conserved
from bayeq.states import Roles
from tests.draws import draws

DICTIONARY = "S, I, R, S*I, S*R, I*R, S**2, I**2, R**2"


def sir(seed: int, lost: float = 0.0, n: int = 200) -> bq.Record:
    """An epidemic of 30 days with 5 % noise, dS = -S I, dI = S I - 0.3 I, dR = (0.3 - lost) I."""
    steps, y = 10 * n, np.array([0.99, 0.01, 0.0])
    h, out = 30.0 / steps, []

    def rate(y: np.ndarray) -> np.ndarray:
        return np.array([-y[0] * y[1], y[0] * y[1] - 0.3 * y[1], (0.3 - lost) * y[1]])

    for k in range(steps):
        if k % 10 == 0:
            out.append(y)
        middle = rate(y + 0.5 * h * rate(y))
        y = y + h * middle
    rng, clean = np.random.default_rng(seed), np.array(out).T
    noisy = {name: x + 0.05 * x.std() * rng.standard_normal(n) for name, x in zip("SIR", clean, strict=True)}
    return bq.Record.from_arrays(noisy, fs=n / 30.0)


def found(record: bq.Record, conserve: str = "S + I + R", **options) -> bq.Equations:
    return bq.discover(record, chains=["S", "I", "R"], **{"dictionary": DICTIONARY, "conserve": conserve, **options})


# --------------------------------------------------------------------------------------------------------------- flows


def some(chains: int, seed: int) -> tuple[Flows, np.random.Generator]:
    rng = np.random.default_rng(seed)
    states = rng.choice(chains, size=rng.integers(2, chains + 1), replace=False)
    return Flows({int(c): float(rng.uniform(0.5, 3.0)) for c in states}, chains, 4), rng


@settings(max_examples=draws(50), deadline=None)
@given(chains=st.integers(2, 5), seed=st.integers(0, 2**32 - 1))
def test_flows_leave_the_sum_as_it_is_and_stand_for_all_that_do(chains: int, seed: int) -> None:
    flows, rng = some(chains, seed)
    k = len(flows.weights)
    assert flows.matrix.shape == (4 * chains, 4 * (k * (k - 1) // 2 + chains - k))
    model = rng.random(flows.matrix.shape[1]) < 0.3
    phi = rng.normal(size=len(model)) * model
    theta = (flows.matrix @ phi).reshape(chains, 4)
    np.testing.assert_allclose(sum(w * theta[c] for c, w in flows.weights.items()), 0.0, atol=1e-12)
    # coefficients of what was selected, and back: other flows may stand for the same coefficients, of the same span
    wide = flows.wide(model)
    assert (wide == (np.abs(flows.matrix) @ model > 0)).all()
    again = flows.narrow(wide)
    assert (flows.wide(again) == wide).all()
    free = int(wide.sum()) - sum(wide.reshape(chains, 4)[list(flows.weights)].any(axis=0))
    assert np.linalg.matrix_rank(flows.matrix[:, again]) == again.sum() == free


def test_one_coefficient_alone_is_of_no_flow() -> None:
    flows = Flows({0: 1.0, 1: 1.0, 2: 1.0}, 4, 2)
    model = np.zeros(8, dtype=bool)
    model[[0, 7]] = True  # the first of dS, and the constant of an equation that is not in the sum
    assert flows.wide(flows.narrow(model)).nonzero()[0].tolist() == [7]


def test_odds_and_priors_of_flows_are_those_of_their_coefficients() -> None:
    flows = Flows({0: 1.0, 1: 2.0}, 2, 2)
    np.testing.assert_allclose(flows.precision(np.array([1.0, 2.0, 4.0, 8.0])), [1.0 + 4.0 / 4, 2.0 + 8.0 / 4])
    assert flows.log_odds(np.array([-1.0, 1.0, -2.0, -np.inf])).tolist() == [-2.0, -np.inf]


def test_the_share_of_the_prior_that_ties_leave_by_draws() -> None:
    flows, precision = Flows({0: 1.0, 1: 2.0}, 2, 1), np.array([4.0, 0.25])
    [tie] = flows.ties(precision)
    wide = tie._replace(sd=0.3)
    theta = np.random.default_rng(0).normal(size=(400_000, 2)) / np.sqrt(precision)
    expected = np.exp(-0.5 * ((theta @ [1.0, 2.0]) / 0.3) ** 2).mean()
    share = flows.log_share((wide,), precision, np.array([True, True]))
    assert share == pytest.approx(math.log(expected), abs=0.02)
    assert flows.log_share((wide,), precision, np.array([False, False])) == 0.0


def test_the_posterior_of_coefficients_is_that_of_flows() -> None:
    """Against every model of flows by hand: moments are linear, and models of the same coefficients are one."""
    rng = np.random.default_rng(1)
    flows, precision = Flows({0: 1.0, 1: 1.0, 2: 2.0}, 3, 1), np.array([1.0, 4.0, 2.0])
    D = rng.normal(size=(40, 3))
    y = D @ [1.0, 0.3, 0.0] + rng.normal(size=40)
    one = spike_slab_bma(Gram.from_data(D - D.mean(axis=0), y - y.mean()), Prior(prior_inclusion=0.3))
    pairs = flows.paired(one, precision)
    unit = np.sqrt(precision)[:, None] * flows.matrix / np.sqrt(flows.precision(precision))
    np.testing.assert_allclose(pairs.averaged.coef, unit @ one.averaged.coef)
    in_any = sum(
        p * (np.abs(flows.matrix) @ m > 0) for m, p in zip(one.average.models, one.average.probability, strict=True)
    )
    np.testing.assert_allclose(pairs.pip, in_any)
    assert len(np.unique(pairs.average.models, axis=0)) == len(pairs.average.models) == 5  # none, three pairs, all
    assert pairs.average.probability.sum() == pytest.approx(1.0)
    weighted = np.array([1.0, 1.0, 2.0]) / np.sqrt(precision)
    np.testing.assert_allclose(weighted @ pairs.average.covariance, 0.0, atol=1e-9)
    assert (np.diff(pairs.average.probability) <= 0.0).all()


# -------------------------------------------------------------------------------------------------- through `discover`


def test_an_epidemic_is_found_as_its_flows_and_balances_to_the_last_digit() -> None:
    record = sir(7)
    eq = found(record, dictionary="S, I, R, S*I, S*R, I*R")
    assert {one.target: set(one.shown) for one in eq} == {"dS": {"S*I"}, "dI": {"S*I", "I"}, "dR": {"I"}}
    dS, dI, dR = (one.shown_coef for one in eq)
    assert dS["S*I"] == -dI["S*I"] == pytest.approx(-1.0, rel=0.03)
    assert dR["I"] == -dI["I"] == pytest.approx(0.3, rel=0.03)
    assert [one.posterior.intercept for one in eq] == [0.0, 0.0, 0.0]
    assert [one.runners_up for one in eq] == [(), (), ()]  # of an equation by itself, which says nothing of the sum
    sd = {one.target: dict(zip(one.posterior.names, one.shown_posterior.sd, strict=True)) for one in eq}
    assert sd["dS"]["S*I"] == pytest.approx(sd["dI"]["S*I"], rel=1e-9)
    np.testing.assert_allclose(eq.predict(record).sum(axis=1), 0.0, atol=1e-14)
    # its terms are known from both equations
    with pytest.warns(TermWarning, match=r"give --conserve 'S \+ I \+ R', which does not change"):
        free = found(record, conserve="", dictionary="I, S*I", holdout=0.0)
    tied = found(record, dictionary="I, S*I", holdout=0.0)
    own = dict(zip(free["dI"].posterior.names, free["dI"].shown_posterior.sd, strict=True))
    both = dict(zip(tied["dI"].posterior.names, tied["dI"].shown_posterior.sd, strict=True))
    assert both["S*I"] < 1.02 * own["S*I"]
    assert not [text for text in tied.warnings if "conserve" in text]


def test_weights_and_equations_beside_the_sum() -> None:
    """2 A <-> B, of which A + 2 B stays, and C' = A - C beside it."""
    n, y, out = 240, np.array([1.0, 0.0, 0.0]), []
    for k in range(10 * n):
        if k % 10 == 0:
            out.append(y)
        flow = 0.8 * y[0] ** 2 - 0.1 * y[1]
        y = y + 0.006 * np.array([-2.0 * flow, flow, y[0] - y[2]])
    rng, clean = np.random.default_rng(0), np.array(out).T
    noisy = {name: x + 0.02 * x.std() * rng.standard_normal(n) for name, x in zip("ABC", clean, strict=True)}
    record = bq.Record.from_arrays(noisy, fs=1 / 0.06)
    eq = bq.discover(record, chains=["A", "B", "C"], dictionary="A, B, C, A**2, A*B", conserve="A + 2*B")
    dA, dB, dC = (one.shown_coef for one in eq)
    assert dA.keys() == dB.keys() == {"B", "A**2"}
    assert all(dA[name] == pytest.approx(-2.0 * dB[name], rel=1e-12) for name in dA)
    assert dB["A**2"] == pytest.approx(0.8, rel=0.05)
    assert set(dC) == {"A", "C"}


@pytest.mark.filterwarnings("ignore:give --conserve '2")  # 2 S + 2 I + 3 R stays: what I loses is half of what R gains
def test_a_record_whose_sum_changes_says_so() -> None:
    with pytest.warns(
        BayeqWarning, match=r"contradicts that S \+ I \+ R does not change \(sd 0\.1\d*\): shown without"
    ):
        eq = found(sir(1, lost=0.1), dictionary="I, S*I")
    assert eq.constraints == ()
    assert sum(one.shown_coef.get("I", 0.0) for one in eq) == pytest.approx(-0.1, rel=0.3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"conserve": "S"}, "name at least two states"),
        ({"conserve": "S + I + 1"}, "name at least two states"),
        ({"conserve": "S + 2"}, "name at least two states"),
        ({"conserve": "S*I + R"}, "no state of first order named"),
        ({"conserve": "S + I + + "}, "conserve"),
        ({"conserve": 3}, "conserve"),
        ({"constraints": "dS: S <= 0"}, "no constraints"),
        ({"method": "vb"}, "methods auto and bma"),
        ({"smooth": "none"}, "smooth='auto'"),
        ({"max_terms": 2}, "max_terms"),
        ({"dictionary": "I, S/({K: 0.1..3}+S)"}, "no constants inside terms"),
        ({"dictionary": "I, S*I | S*sqrt(I)"}, "no either-or"),
        ({"constraints": "S + I + R is conserved", "conserve": ""}, "write one =="),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        found(sir(1, n=60), **options)
    assert "\n" not in str(caught.value)


def test_states_of_second_order_are_not_in_a_sum() -> None:
    chains = Roles.parse(["x:v:", "S", "I"]).chains
    assert parse_conserved("2*S - I", chains) == {1: 2.0, 2: -1.0}
    with pytest.raises(UnknownNameError, match=r"conserve .*no state of first order named 'x'; there are: S, I"):
        parse_conserved("x + S", chains)


def test_equations_of_files_with_common_terms_balance_too(tmp_path) -> None:
    for k in range(2):
        bq.write(sir(k, n=120), tmp_path / f"{k}.csv")
    options = {"chains": ["S", "I", "R"], "dictionary": "I, S*I, S*R", "conserve": "S + I + R", "common": True}
    batch = bq.batch(sorted(tmp_path.glob("*.csv")), store=tmp_path / "b.db", **options)
    assert batch.common is not None
    for one in batch:
        assert one.equations.constraints == ("S + I + R is conserved",)
        assert [set(eq.shown) for eq in one.equations] == [set(eq.shown) for eq in batch.common]
        dS, dI, dR = (eq.shown_coef for eq in one.equations)
        assert dS["S*I"] == -dI["S*I"]
        assert dI["I"] == -dR["I"]
    # a common equation without the sum, which the files contradict, leaves them without it too
    for k in range(2):
        bq.write(sir(k, n=120, lost=0.1), tmp_path / f"{k}.csv")
    lost = bq.batch(sorted(tmp_path.glob("*.csv")), store=tmp_path / "b.db", **{**options, "dictionary": "I, S*I"})
    assert [one.status for one in lost] == ["ok", "ok"]
    assert [eq.constraints for eq in (lost.common, lost[0].equations)] == [(), ()]
    with pytest.raises(InputError, match="prior"):
        found(sir(1, n=60), prior=Prior(prior_inclusion=0.5))


def test_through_the_command(tmp_path, capsys) -> None:
    path, saved = tmp_path / "sir.csv", tmp_path / "eq.json"
    record = sir(7)
    columns = np.column_stack([record.time, *(record[name] for name in "SIR")])
    np.savetxt(path, columns, delimiter=",", header="t,S,I,R", comments="")
    ask = ["discover", str(path), "--time", "t", *(word for name in "SIR" for word in ("--chain", name))]
    ask += ["--dictionary", "I, S*I, R", "--conserve", "S + I + R"]
    assert main([*ask, "--json", "--save", str(saved)]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["diagnostics"]["constraints"] == ["S + I + R is conserved"]
    coef = {one["target"]: {t["name"]: t["shown_coef"] for t in one["terms"] if t["shown"]} for one in out["equations"]}
    assert coef["dS"]["S*I"] == -coef["dI"]["S*I"]
    assert coef["dR"]["I"] == -coef["dI"]["I"]
    back = bq.load(saved)
    assert back.to_dict()["equations"] == out["equations"]
    with pytest.raises(InputError, match=r"S . I . R is conserved, which output error does not keep to"):
        back.refine(record)
    assert main([*ask[:-1], "S + W"]) == 2
    assert "conserve 'S + W'" in capsys.readouterr().err


def test_a_search_whose_first_model_cannot_be_fitted_goes_on() -> None:
    """Of this record the rounds first settle on seventeen flows and constants, whose own fit leaves all motion."""
    from studies.conserved import TERMS, epidemic

    record, truth = epidemic(300014)
    eq = bq.discover(record, chains=["S", "I", "R"], dictionary=TERMS, conserve="S + I + R")
    assert {one.target: set(one.included) for one in eq} == {target: set(terms) for target, terms in truth.items()}


def test_a_sum_of_a_reaction_that_does_not_change_is_offered() -> None:
    """A <-> 2 B -> C: 2 A + B + C stays."""
    out, y = [], np.array([2.0, 0.0, 0.0])
    for k in range(6000):
        if k % 10 == 0:
            out.append(y)
        there, back, gone = 0.1 * y[0], 0.2 * y[1] ** 2, 0.15 * y[1]
        y = y + 0.01 * np.array([back - there, 2 * there - 2 * back - gone, gone])
    rng = np.random.default_rng(3)
    noisy = {
        name: x + 0.01 * x.std() * rng.standard_normal(600) for name, x in zip("ABC", np.array(out).T, strict=True)
    }
    with pytest.warns(TermWarning, match=r"give --conserve '2\*A \+ B \+ C', which does not change"):
        bq.discover(bq.Record.from_arrays(noisy, fs=10.0), chains=["A", "B", "C"], dictionary="A, B, C, B**2, A*B")
