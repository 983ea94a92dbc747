"""Lags of channels: learned, taken out of the samples, in the intervals, saved; and what is refused."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from studies.lags import draw_record

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.brief import brief
from bayeq.errors import InputError, RecordError, UnknownNameError
from bayeq.expressions import parse
from bayeq.likelihood.layout import Candidates
from bayeq.likelihood.linear import linearise
from bayeq.likelihood.start import start_from
from bayeq.regression.design import build_design
from bayeq.states import Lag, Roles, Sensors, corrected, estimate_motion, known_sensors

SD = 0.03
ASKED = {"chains": ["x:v:a"], "inputs": ["u"], "dictionary": ["x", "v", "u", "x**2", "x**3", "v**3", "v*abs(v)"]}


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*arguments, **{**ASKED, **options})


@pytest.fixture(scope="module")
def late():
    """A record whose force is late, its true coefficients and the lag."""
    record, truth, name, lag = draw_record("force", "x:v:a", 0.02, 7)  # late by 2.25 samples
    assert name == "u"
    return record, truth, lag


@pytest.fixture(scope="module")
def answer(late):
    return quietly(late[0], lag_sd={"u": SD})


def test_lag_of_a_force_is_learned(late, answer):
    _, truth, lag = late
    found = answer.data.sensors.lags["u"]
    assert abs(found.value - lag) < 3.0 * found.sd < 1e-3
    assert found.prior_sd == SD
    assert set(answer[0].included) == set(truth)
    for name, low, high in zip(answer[0].posterior.names, *answer[0].ci95.T, strict=True):
        assert name not in ("x", "v", "x**3") or low < truth[name] < high


def test_rows_whose_input_a_lag_has_moved_out_of_the_record_test_nothing():
    record = bq.simulate("duffing", n=1240, seed=1)
    channels = {**{name: record[name][40:] for name in "xva"}, "u": record["u"][:-40]}
    late = bq.Record.from_arrays(channels, time=record.time[40:])
    found = quietly(late, dictionary="x, v, x**3, u", lag_sd={"u": 0.04})
    assert found.data.sensors.lags["u"].value == pytest.approx(0.04, abs=1e-3)
    assert found.scores.rows in (199, 200)  # of 240 held out
    assert max(found.scores.free_run.values()) < 0.1


def test_without_it_the_damping_is_wrong(late, answer):
    record, truth, _ = late
    untold = quietly(record.slice(0, 700), dictionary=list(truth), holdout=0.0)
    damping = [eq.coefficients()["a"]["v"] for eq in (answer, untold)]
    told, untold = (abs(found / truth["v"] - 1.0) for found in damping)
    assert told < 0.03
    assert untold > 0.1


def test_advice_names_the_lag_and_not_a_quarter_of_a_period(late):
    """What a small lag leaves goes with the input's slope, whose correlation peaks a quarter of a period away."""
    suspected = re.search(r"u may be ([\d.]+) s late", quietly(late[0])[0].verdict.advice)
    assert float(suspected[1]) == pytest.approx(late[2], rel=0.1)


@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_lag_of_a_channel_of_the_motion(seed):
    record, truth, name, lag = draw_record("motion", "x:v:a", 0.02, seed)
    few = ["x", "v", "u", "x**2", "x**3", "v*abs(v)"]
    found = quietly(record.slice(0, 800), lag_sd={name: SD}, dictionary=few, holdout=0.0)
    assert abs(found.data.sensors.lags[name].value - lag) < 3.0 * found.data.sensors.lags[name].sd
    assert set(found[0].included) == set(truth)


def test_record_without_a_lag_loses_nothing():
    record, truth, _, _ = draw_record("none", "x:v:a", 0.02, 5)
    record = record.slice(0, 700)
    few = ["x", "v", "u", "x**2", "x**3"]
    asked, plain = (quietly(record, dictionary=few, holdout=0.0, **more) for more in ({"lag_sd": {"u": SD}}, {}))
    assert asked[0].included == plain[0].included
    assert set(plain[0].included) == set(truth)
    assert np.allclose(asked[0].posterior.sd, plain[0].posterior.sd, rtol=0.1)
    assert not plain.data.sensors.lags
    assert "lags" not in plain.to_dict()["data"]


def test_lag_is_printed_saved_and_taken_out_of_other_records(late, answer, tmp_path):
    record, _, lag = late
    line = f"lag of u: {answer.data.sensors.lags['u']} (learned)"
    assert line in str(answer)
    assert line in brief(answer)
    answer.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.data.sensors == answer.data.sensors
    assert str(again) == str(answer)
    forgotten = replace(answer, data=replace(answer.data, sensors=replace(answer.data.sensors, lags={})))
    assert abs(lag) > 0.01
    assert answer.score(record).free_run["x"] < 0.5 * forgotten.score(record).free_run["x"]
    run, other = (eq.simulate(record, draws=0).nrmse["x"] for eq in (answer, forgotten))
    assert run < 0.5 * other
    assert len(answer.predict(record)) == record.n


def test_samples_are_moved_to_the_times_they_are_of():
    t = np.arange(400) / 100.0
    u = np.sin(7.0 * (t - 0.023))
    u[100] = np.nan
    record = bq.Record.from_arrays(x=np.cos(t), u=u, fs=100.0, units={"u": "N"})
    moved = corrected(record, Sensors(lags={"u": Lag(0.023, 0.001, 0.03)}))
    known = np.isfinite(moved["u"])
    assert moved.n == record.n
    assert np.flatnonzero(~known).tolist() == [97, 98, 397, 398, 399]
    inside = known & (np.abs(t - 0.98) > 0.4) & (t > 0.4) & (t < 3.6)
    assert np.abs(moved["u"] - np.sin(7.0 * t))[inside].max() < 1e-3
    assert moved["x"] is record["x"] or np.array_equal(moved["x"], record["x"])
    assert moved.units == record.units
    assert np.isfinite(corrected(record, Sensors(lags={"u": Lag(0.023, 0.001, 0.03)}), whole=True)["u"]).all()


@pytest.mark.parametrize("name", ["x", "v", "a", "u"])
def test_what_a_late_channel_sees_changes_as_its_gradient_says(late, name):
    roles = Roles.parse(ASKED["chains"], inputs=ASKED["inputs"])
    sensors = known_sensors({}, {}, roles, [late[0]], lag_sd={name: SD})
    motion = estimate_motion([late[0]], roles, sensors=sensors)
    design = build_design([parse(text) for text in ("x", "v", "u")], motion)
    with np.errstate(all="ignore"):
        task, states = start_from(motion, design.terms, design.train, np.zeros((1, len(design.terms) + 1)), None)
    layout, series, path = task.layout, task.series[0], states[1].paths[0].copy()
    model = Candidates(np.zeros(2, dtype=np.int64), np.array([0, 2]))  # x and u
    theta = np.array([-100.0, 1.0])
    (index,), (lag,) = [i for i, _ in layout.late], layout.lags
    assert layout.channels[index][0] == name
    one = linearise(layout, series, path, model, theta)
    path[:, lag] += 1e-3
    two = linearise(layout, series, path, model, theta)
    by_lag = one.gradient[:, -1 - one.kinds[index], lag]
    assert np.allclose((one.residual - two.residual)[:, index], 1e-3 * by_lag, rtol=1e-6, atol=1e-9)
    rate = np.gradient(motion.train[0].columns[name], 0.01)
    assert name == "a" or np.corrcoef(rate, -by_lag)[0, 1] > 0.9


def test_refusals(late, tmp_path, capsys):
    record = late[0]
    bare = bq.Record.from_arrays({name: record[name] for name in "xvau"})
    for given, options, kind, words in [
        ({"q": SD}, {}, UnknownNameError, "lag_sd: no channel named 'q'"),
        ({"u": "2%"}, {}, InputError, "seconds"),
        ({"u": 0.0}, {}, InputError, "above 0"),
        ({"u": 0.11 * record.n / record.fs}, {}, InputError, "more than a tenth of the longest record"),
        ({"u": SD}, {"smooth": "none"}, InputError, "lags are learned by the likelihood"),
        (dict.fromkeys("xvau", SD), {}, InputError, "only lags against other channels show"),
    ]:
        with pytest.raises(kind, match=words):
            quietly(record, lag_sd=given, **options)
    with pytest.raises(InputError, match="lags are learned by the likelihood"):
        quietly(bare, lag_sd={"u": SD})
    jitter = np.random.default_rng(0).uniform(-0.003, 0.003, record.n)
    uneven = bq.Record.from_arrays({name: record[name] for name in "xvau"}, time=np.arange(record.n) / 100.0 + jitter)
    with pytest.raises(RecordError, match="even steps of time"):
        quietly(uneven, lag_sd={"u": SD})
    bq.write(record, tmp_path / "run.csv")
    run = ["discover", str(tmp_path / "run.csv"), "--chain", "x:v:a", "--input", "u", "--lag-sd", "u=0.03"]
    assert main([*run, "--stream"]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert "lag_sd: lags are learned from a record in memory" in error[-1]


def test_command_line(late, tmp_path, capsys):
    bq.write(late[0].slice(0, 500), tmp_path / "run.csv")
    run = ["discover", str(tmp_path / "run.csv"), "--chain", "x:v:a", "--input", "u", "--dictionary", "x, v, u, x**3"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main([*run, "--lag-sd", "u=0.03", "--json", "--holdout", "0"]) == 0
    lag = json.loads(capsys.readouterr().out)["data"]["lags"]["u"]
    assert abs(lag["value"] - late[2]) < 3.0 * lag["sd"]
    assert lag["prior_sd"] == SD
