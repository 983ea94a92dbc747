"""Bands of free runs know what the equations leave out: its size, its spectrum, and how often samples lie inside."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from studies.adverse_records import CASES, draw_record

import bayeq as bq
from bayeq.equation.applied import apply_to
from bayeq.forecast.free_run import drawn_sines, pushed
from bayeq.likelihood.projection import LINES, lines_of_equal_power
from bayeq.numerics.rk4 import Drive

TERMS = ["x", "v", "x**3", "u"]
HOW = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "dictionary": TERMS}
PUSHED = CASES["second force of 10 %"]


@pytest.fixture(scope="module")
def found():
    return bq.discover(draw_record(PUSHED, 4000, 1), **HOW)


def without(eq):
    """The equations as if nothing were known of what they leave out."""
    p = replace(eq[0].shown_posterior, projected=None)
    return replace(eq, equations=(eq[0].with_posterior(p),))


def inside(run, record, name="x"):
    return float(np.mean((record[name] >= run.low[name]) & (record[name] <= run.high[name])))


def noise_in_band(n, interval, low, high, rng):
    """Normal noise of unit variance with a flat spectrum between two frequencies [Hz]."""
    lines, frequency = np.fft.rfft(rng.standard_normal(n)), np.fft.rfftfreq(n, interval)
    values = np.fft.irfft(np.where((frequency >= low) & (frequency <= high), lines, 0.0), n)
    return values / values.std()


def test_lines_carry_equal_power():
    rng = np.random.default_rng(0)
    pieces = [noise_in_band(n, 0.01, 2.0, 8.0, rng) for n in (20_000, 30_000)]
    middles = (np.arange(LINES) + 0.5) / LINES
    np.testing.assert_allclose(lines_of_equal_power(pieces, 0.01), 2.0 + 6.0 * middles, atol=0.15)
    # a mean of a third of the power, and a sine of as much as the noise
    sine = np.sqrt(2.0) * np.sin(2.0 * np.pi * 20.0 * 0.01 * np.arange(30_000))
    lines = lines_of_equal_power([1.0 + sine + pieces[1]], 0.01)
    assert lines[:4] == (0.0,) * 4
    np.testing.assert_allclose(lines[4:8], 2.0 + 6.0 * (np.arange(4) + 0.5) / 4, atol=0.15)
    np.testing.assert_allclose(lines[8:], 20.0, atol=1e-3)
    assert lines_of_equal_power([np.zeros(100)], 0.01) == ()


def test_forces_have_the_size_and_the_spectrum_of_what_is_left(found):
    lines = tuple((2.0 + 6.0 * (np.arange(LINES) + 0.5) / LINES).tolist())
    own = replace(found[0].shown_posterior.projected, error_sd=3.0, error_lines=lines)
    time = 0.01 * np.arange(2000)
    sines = drawn_sines(own, 2000, np.random.default_rng(1))
    drive = Drive.over(time, np.empty((2000, 0, 4)), *np.array([[-1.0], [1.0]]))
    forces = np.array([pushed(drive, time, [one]).inputs[:, 0, 0] for one in sines])
    # at any time, over the runs: six standard errors
    np.testing.assert_allclose(forces.std(axis=0), 3.0, rtol=0.1)
    assert forces.std() == pytest.approx(3.0, rel=0.02)
    assert abs(forces.mean(axis=0)).max() < 0.3
    assert np.mean(np.abs(forces) < 1.96 * 3.0) == pytest.approx(0.95, abs=0.003)
    power = np.mean(np.abs(np.fft.rfft(forces * np.hanning(2000))) ** 2, axis=0)
    frequency = np.fft.rfftfreq(2000, 0.01)
    shares = [power[(frequency >= low) & (frequency < low + 1.0)].sum() / power.sum() for low in range(10)]
    assert shares[0] + shares[1] + shares[8] + shares[9] < 0.02
    np.testing.assert_allclose(shares[3:7], 1 / 6, rtol=0.1)


def test_bands_hold_the_motion_under_a_force_that_was_not_measured(found):
    # a tenth of the force, up to 15 Hz
    assert found.verdict.kind == "nearly true"
    assert found[0].shown_posterior.projected.error_sd == pytest.approx(2.0, rel=0.1)
    assert found[0].shown_posterior.error_lines[0] < 2.0
    assert 13.0 < found[0].shown_posterior.error_lines[-2] < 16.0
    shares, formerly = [], []
    for seed in (2, 3):
        record = draw_record(PUSHED, 4000, seed).slice(step=2)
        shares.append(inside(found.simulate(record), record))
        formerly.append(inside(without(found).simulate(record), record))
    assert min(shares) > 0.85
    assert 0.9 < np.mean(shares) < 0.99
    assert np.mean(formerly) < 0.7


def test_bands_of_saved_equations_are_the_same(found, tmp_path):
    record = draw_record(PUSHED, 1000, 2)
    run = found.simulate(record, draws=20)
    found.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json").simulate(record, draws=20)
    for name in "xv":
        np.testing.assert_array_equal(again.low[name], run.low[name])
        np.testing.assert_array_equal(again.high[name], run.high[name])
        np.testing.assert_array_equal(again.mean[name], without(found).simulate(record, draws=0).mean[name])
    # files from before have the band of the coefficients
    content = json.loads((tmp_path / "eq.json").read_text())
    del content["equations"][0]["error_sd"], content["equations"][0]["error_lines"]
    (tmp_path / "old.json").write_text(json.dumps(content))
    old = bq.load(tmp_path / "old.json").simulate(record, draws=20)
    np.testing.assert_array_equal(old.low["x"], without(found).simulate(record, draws=20).low["x"])
    assert (run.high["x"] - run.low["x"]).mean() > 2.0 * (old.high["x"] - old.low["x"]).mean()


def test_bands_of_runs_in_blocks(found, monkeypatch):
    record = draw_record(PUSHED, 400, 2)
    run = found.simulate(record, draws=20)
    monkeypatch.setattr("bayeq.forecast.free_run.BLOCK", 20 * 2 * 50)
    parts = found.simulate(record, draws=20)
    # splines differ at the ends of blocks
    np.testing.assert_allclose(parts.low["x"], run.low["x"], rtol=0, atol=1e-4 * record["x"].std())


def test_bands_of_equations_that_leave_nothing_hardly_change():
    noise = {"x": 0.02, "v": 0.02, "a": 0.02}
    eq = bq.discover(bq.simulate("duffing", n=2000, seed=1, noise=noise), **HOW)
    other = bq.simulate("duffing", n=2000, seed=2, noise=noise)
    run, formerly = eq.simulate(other), without(eq).simulate(other)
    width, before = ((one.high["x"] - one.low["x"]).mean() for one in (run, formerly))
    assert 0.9 < width / before < 1.1
    shares = apply_to(eq, [other]).free_run
    assert 0.9 < shares["x"].inside <= 1.0
    assert 0.9 < shares["v"].inside <= 1.0
