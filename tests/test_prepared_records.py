"""Records are prepared alike for all that equations do: bad samples, missing ones, gaps, given noise."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import BayeqWarning, ConvergenceWarning, DataWarning, FileFormatError, RecordError
from tests.simulated import coarse

NOISE = {"x": 0.05, "v": 0.05, "a": 0.05}
ROLES = {"chains": ["x:v:a"], "inputs": ["u"], "dictionary": ["x", "v", "x**3", "u"]}
CALLS = ("predict", "score", "simulate", "refine")


def discover(record, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(record, **ROLES, **options)


def quietly(function, *arguments, **options):
    """What a call returns, and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        out = function(*arguments, **options)
    return out, [str(one.message) for one in caught]


def changed(record, **samples):
    """The record with other samples, {row: value} of each channel."""
    channels = {name: record[name].copy() for name in samples}
    for name, rows in samples.items():
        for row, value in rows.items():
            channels[name][row] = value
    return record.with_channels(channels, record.units)


@pytest.fixture(scope="module")
def record():
    return coarse("duffing", 800, 8, NOISE)


@pytest.fixture(scope="module")
def eq(record):
    return discover(record)


@pytest.fixture(scope="module")
def told(record):
    """What is found where the noise of x is given."""
    return discover(record, noise={"x": 0.05 * record["x"].std()})


@pytest.fixture(scope="module")
def told_refined(told, record):
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConvergenceWarning)
        return told.refine(record)


@pytest.fixture(scope="module")
def quiet():
    """A record with little noise, and what is found."""
    record = bq.simulate("duffing", n=600, fs=400, seed=1, noise=0.001)
    return record, discover(record, holdout=0.0)


@pytest.fixture(scope="module")
def refined(eq, record):
    return eq.refine(record)


@pytest.fixture(scope="module")
def spiked(record):
    return changed(record, x={300: record["x"][300] + 100.0 * record["x"].std()})


# --- spikes ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def of_spiked(eq, spiked):
    """What each call returns of the record with a spike, and its warnings."""
    return {call: quietly(getattr(eq, call), spiked) for call in CALLS}


@pytest.mark.parametrize("call", CALLS)
def test_a_spike_is_left_out_and_reported_once(call, of_spiked):
    _, said = of_spiked[call]
    assert said == ["x: 1 sample left out as spike (row 301: 0.12 %); check the sensor"]


def test_what_discover_has_said_is_not_said_again(spiked):
    spiked = spiked.slice(0, 500)
    found = discover(spiked, holdout=0.0)
    assert any("left out as spike" in message for message in found.warnings)
    for call in CALLS:
        assert quietly(getattr(found, call), spiked)[1] == []


def test_a_spike_changes_neither_coefficients_nor_scores(eq, record, spiked, refined, of_spiked):
    # as measured a spike of 100 sd made the free run err by 96 % instead of 5 %, and nothing was refined
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        clean, bad = refined, of_spiked["refine"][0]
        for name, sd in zip(eq[0].included, clean[0].posterior.sd, strict=True):
            assert bad[0].coef[name] == pytest.approx(clean[0].coef[name], abs=0.2 * sd)
        pairs = [eq.score(one, start=0, rows=640) for one in (record, spiked)]
        assert pairs[1].free_run["x"] == pytest.approx(pairs[0].free_run["x"], rel=0.05)
        assert pairs[1].one_step["a"] == pytest.approx(pairs[0].one_step["a"], rel=0.05)
        runs = [eq.simulate(one, draws=0) for one in (record, spiked)]
        assert runs[1].nrmse["x"] == pytest.approx(runs[0].nrmse["x"], rel=0.05)
        assert np.isnan(runs[1].measured["x"][300])
        first, second = (eq.predict(one) for one in (record, spiked))
        np.testing.assert_allclose(second, first, atol=0.05 * record["a"].std())


def test_as_measured_nothing_is_left_out(record, spiked):
    raw = discover(record, smooth="none")
    out, said = quietly(raw.predict, spiked)
    assert said == []
    assert abs(out[300]) > 10.0 * record["a"].std()


def test_a_single_blow_of_an_input_without_measured_motion_is_no_spike(eq, record):
    u = np.zeros(record.n)
    u[100] = 1e3
    blow = bq.Record.from_arrays({"u": u}, time=record.time)
    run, said = quietly(eq.simulate, blow, initial={"x": 0.0, "v": 0.0}, draws=0)
    assert said == []
    assert np.abs(run.mean["x"]).max() > 0.0


# --- missing samples -------------------------------------------------------------------------------------------------

MISSING = {"x": {50: np.nan, 51: np.nan, 400: np.nan}, "u": {120: np.nan, 121: np.nan}, "a": {700: np.nan}}


@pytest.mark.parametrize("call", CALLS)
def test_missing_samples_are_bridged_and_reported(call, eq, record):
    out, said = quietly(getattr(eq, call), changed(record, **MISSING))
    assert [message.split(" ")[:2] for message in said] == [["x:", "3"], ["a:", "1"], ["u:", "2"]]
    if call == "predict":
        whole = eq.predict(record)
        assert out.shape == whole.shape
        np.testing.assert_allclose(np.delete(out, [119, 120, 121, 122]), np.delete(whole, [119, 120, 121, 122]), atol=6)
    if call == "refine":
        assert out[0].coef["x"] == pytest.approx(-1000.0, rel=0.01)


@pytest.mark.parametrize("timed", [True, False])
def test_predictions_have_a_row_for_each_of_the_record(timed, quiet):
    whole, found = quiet
    if not timed:
        whole = bq.Record.from_arrays({name: whole[name] for name in "xvau"})
        found = discover(whole, holdout=0.0)
    lacking = changed(whole, x={50: np.nan, 51: np.nan})
    out, said = quietly(found.predict, lacking)
    assert said == ["x: 2 samples are missing (rows 51 to 52: 0.33 %); check the acquisition"]
    assert out.shape == (600,)
    np.testing.assert_allclose(np.delete(out, [50, 51]), np.delete(found.predict(whole), [50, 51]), atol=0.5)
    mean, sd = quietly(found.predict, lacking, return_std=True)[0]
    assert np.isfinite(mean).all()
    assert (sd > 0.0).all()


def test_dropped_rows_do_not_move_predictions(eq, record):
    kept = np.delete(np.arange(record.n), [200, 201, 500])
    fewer = record.take(kept)
    np.testing.assert_allclose(eq.predict(fewer), eq.predict(record)[kept], atol=0.1 * record["a"].std())


def test_long_gaps(eq, record):
    gap = changed(record, u=dict.fromkeys(range(300, 340), np.nan))
    refined, said = quietly(eq.refine, gap)
    assert refined.refined.segments == 2
    assert refined.refined.files == ("duffing",)
    assert "first after row 300: taken as 2 pieces" in said[1]
    assert quietly(eq.score, gap)[0].rows == 152  # a fifth of either piece
    assert quietly(eq.score, gap, start=340)[0].rows == 460
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        message = r"u: samples are missing for too long to fill in \(rows 301 to 340 .*start, rows"
        with pytest.raises(RecordError, match=message):
            eq.simulate(gap)
        assert eq.simulate(gap, start=345, draws=0).nrmse["x"] < 0.1
        with pytest.raises(RecordError, match="rows 1 to 10"):
            eq.simulate(gap, start=330)


# --- given noise -----------------------------------------------------------------------------------------------------


def test_given_noise_weighs_channels_of_a_refinement(record, refined, told_refined):
    free, known = refined, told_refined
    assert known.refined.noise_sd["x"] == 0.05 * record["x"].std()
    assert known.refined.noise_sd["v"] == pytest.approx(free.refined.noise_sd["v"], rel=0.01)
    assert known[0].coef["x"] == pytest.approx(free[0].coef["x"], abs=0.5 * free[0].posterior.sd[0])


def test_noise_that_is_given_far_too_small_is_not_believed(record, refined, told):
    sensors = replace(told.data.sensors, noise={"x": 0.01 * record["x"].std()})
    found = replace(told, data=replace(told.data, sensors=sensors))
    with pytest.warns(
        DataWarning, match=r"x: free runs leave [45]\S* times the noise that was given: .*check"
    ) as caught:
        after = found.refine(record)
    assert after.warnings[-1] == str(caught[0].message)
    np.testing.assert_allclose(after[0].posterior.sd, refined[0].posterior.sd, rtol=0.01)


def test_given_noise_reaches_the_states_of_predictions(quiet):
    record, untold = quiet
    noise = {"x": 0.3 * record["x"].std()}
    told = discover(record, noise=noise, holdout=0.0)
    assert told.data.sensors.noise == noise
    moved = [
        np.std(bq.equation.along.rows_of_record(record, roles, "auto", sensors)["x"] - record["x"])
        for roles, sensors in [(told.roles, told.data.sensors), (untold.roles, untold.data.sensors)]
    ]
    assert moved[0] > 1.2 * moved[1]


@pytest.mark.parametrize("noise", [{"x": -1.0}, {"x": "2%"}, {"w": 0.1}, {"x": float("nan")}])
def test_files_with_impossible_noise_are_damaged(noise, record, told, tmp_path):
    told.save(tmp_path / "eq.json")
    assert bq.load(tmp_path / "eq.json").data.sensors.noise == {"x": 0.05 * record["x"].std()}
    content = json.loads((tmp_path / "eq.json").read_text())
    content["data"]["noise"] = noise
    (tmp_path / "bad.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="damaged"):
        bq.load(tmp_path / "bad.json")


def test_loaded_equations_refine_with_the_noise_given(record, told, told_refined, tmp_path):
    told.save(tmp_path / "eq.json")
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConvergenceWarning)
        again = bq.load(tmp_path / "eq.json").refine(record)
    assert again.refined == told_refined.refined
