"""Noise in proportion to the reading: variances of single samples that follow what is measured."""

import json

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import minimize

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import InputError
from bayeq.likelihood.unequal import proportion_of

STATES = ("x", "y", "z")


def measured(system, share, seed, constant=0.0):
    """Noise of a share of every reading, and a constant one of a share of the channel's deviation."""
    clean, rng = bq.simulate(system, n=1000, noise=0.0, seed=seed), np.random.default_rng(seed)
    channels = {}
    for name in clean.names:
        size = np.hypot(share * clean[name], constant * clean[name].std())
        channels[name] = clean[name] + size * rng.standard_normal(clean.n)
    return bq.Record.from_arrays(channels, time=clean.time), clean.truth.coefficients


def lorenz(record, noise):
    return bq.discover(record, chains=list(STATES), dictionary="x, y, z, x*y, x*z", holdout=0.0, noise=noise)


@pytest.mark.parametrize("constant", [0.0, 0.02, 0.3])
def test_variances_are_the_likeliest(constant):
    rng = np.random.default_rng(4)
    readings = np.square(np.sin(np.linspace(0.0, 60.0, 6000))) + 1e-9
    squares = (0.1**2 * readings + constant**2) * rng.standard_normal(6000) ** 2
    spread, variance = proportion_of(squares, readings)

    def loss(logs):
        sd = np.sqrt(np.exp(logs[0]) + np.exp(logs[1]) * readings)
        return -stats.norm.logpdf(np.sqrt(squares), scale=sd).sum()

    best = minimize(loss, np.log([constant**2 + 1e-9, 0.01]), method="Nelder-Mead", options={"maxiter": 4000})
    own = -stats.norm.logpdf(np.sqrt(squares), scale=np.sqrt(variance * spread)).sum()
    assert own < best.fun + 0.01
    assert variance == pytest.approx(0.1**2 * readings.mean() + constant**2, rel=0.1)


def test_intervals_are_shorter_and_hold_the_truth():
    record, truth = measured("lorenz", 0.1, 5000)
    plain, told = lorenz(record, None), lorenz(record, dict.fromkeys(STATES, "% of reading"))
    shorter = []
    for before, eq, law in zip(plain, told, truth.values(), strict=True):
        assert set(eq.included) == set(law)
        assert eq.verdict.kind == "found"
        table, first = eq.table().set_index("term"), before.table().set_index("term")
        for term, value in law.items():
            assert abs(table.coef[term] - value) < 4.0 * table.sd[term]
            shorter.append(table.sd[term] / first.sd[term])
    assert max(shorter) < 1.0
    assert np.median(shorter) < 0.6


def test_noise_that_is_not_in_proportion_costs_nothing():
    record, _ = measured("lorenz", 0.0, 5001, constant=0.1)
    plain, told = lorenz(record, None), lorenz(record, dict.fromkeys(STATES, "% of reading"))
    for before, eq in zip(plain, told, strict=True):
        assert eq.included == before.included
        for term, value in before.coef.items():
            if term in before.included:
                assert eq.coef[term] == pytest.approx(value, rel=0.05)


@pytest.mark.filterwarnings("ignore:u. 1 sample left out as spike")
def test_a_force_and_its_motion():
    record, truth = measured("duffing", 0.05, 7)
    noise = {"u": "5% of reading", "x": "% of reading"}
    record = record.slice(0, 2000)
    asked = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "holdout": 0.0}
    eqs = bq.discover(record, **asked, noise=noise, dictionary="x, v, x**2, x**3, x*v, v*abs(v), u")
    assert set(eqs[0].included) == set(truth["a"])
    assert eqs.data.sensors.of_reading == {"u": 0.05, "x": 0.0}
    assert eqs.data.sensors.noise["u"] == pytest.approx(0.05 * np.sqrt(np.mean(record["u"] ** 2)), rel=0.01)
    text = str(eqs)
    assert "noise of u: in proportion to the reading, 5 %" in text
    assert "noise of x: in proportion to the reading, learned" in text


def test_on_the_command_line_and_saved(tmp_path, capsys):
    record, _ = measured("vanderpol", 0.1, 3)
    bq.write(record, tmp_path / "r.csv")
    words = ["discover", str(tmp_path / "r.csv"), "--chain", "x", "--chain", "y", "--dictionary", "x, y, x**3, x**2*y"]
    noise = ["--noise", "x=10% of reading", "--noise", "y=% of reading"]
    assert main([*words, *noise, "--json", "--save", str(tmp_path / "eq.json")]) == 0
    data = json.loads(capsys.readouterr().out)["data"]
    assert data["of_reading"] == {"x": 0.1, "y": 0.0}
    again = bq.load(tmp_path / "eq.json")
    assert again.data.sensors.of_reading == {"x": 0.1, "y": 0.0}
    assert json.loads(json.dumps(again.to_dict()["data"])) == data


@pytest.mark.parametrize("amount", ["5% of readings", "five % of reading", "-1% of reading", "5% of reading twice"])
def test_what_is_no_share_is_refused(amount):
    record, _ = measured("vanderpol", 0.1, 3)
    with pytest.raises(InputError, match="of reading"):
        bq.discover(record, chains=["x", "y"], dictionary="polynomial:3", noise={"x": amount})


def test_more_noise_than_reading_is_refused():
    record, _ = measured("vanderpol", 0.1, 3)
    with pytest.raises(InputError, match="less than 100 %"):
        bq.discover(record, chains=["x", "y"], dictionary="polynomial:3", noise={"x": "120% of reading"})
