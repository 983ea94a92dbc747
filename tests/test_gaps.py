"""Gaps in records: bridged where the samples on both sides still fix the motion, else the record is divided."""

from __future__ import annotations

import contextlib
import re

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning
from bayeq.records.repair import split_at_gaps
from bayeq.records.validate import even_times
from bayeq.states.prepare import filled_in, on_grid
from bayeq.systems.system import BandLimitedForce, System

# the input fills the band up to 5 Hz; the strongest lines of x are far slower
SLOW = System(
    name="slow",
    title="a first-order state",
    chains=("x",),
    rhs={"x": "2*u-0.8*x-0.5*x**3"},
    terms={"dx": {"x": "-0.8", "x**3": "-0.5", "u": "2"}},
    parameters={},
    initial={"x": 0.0},
    inputs=("u",),
    force=BandLimitedForce(1.0, (0.0, 5.0)),
    n=2000,
    fs=50.0,
    substeps=4,
    noise=0.02,
    citation="",
)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_gap_of_many_short_periods_of_a_slow_state_is_not_bridged():
    # 6 s without samples: little of the slowest motion, thirty periods of the input
    rec = bq.simulate(SLOW)
    settings = {"chains": "x", "inputs": ["u"], "dictionary": "polynomial:3"}
    gap = bq.discover(rec.take(np.r_[0:700, 1000:2000]), **settings)
    apart = bq.discover([rec.slice(0, 700), rec.slice(1000, 2000)], **settings)
    assert gap[0].coef == apart[0].coef
    for name, true in rec.truth.coefficients["dx"].items():
        assert gap[0].coef[name] == pytest.approx(true, rel=0.02)
    assert any("gaps longer than half a period of u (0.1" in message for message in gap.warnings)


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_noise_does_not_shorten_the_period_and_single_samples_are_bridged(noise):
    rec = bq.simulate(SLOW, noise=noise)
    kept = np.ones(rec.n, dtype=bool)
    kept[5:-5:10] = False  # single samples
    kept[1000:1003] = False  # a step of 0.08 s; the shortest period of x is about 0.25 s
    (whole,), messages = split_at_gaps([rec.take(kept)], ["x"])
    assert whole.n == kept.sum()
    assert messages == []


def test_gaps_are_bridged_where_nothing_else_would_be_left():
    # white noise up to half the sampling rate: no gap of more than one sample is bridged without loss
    rec = bq.Record({"u": np.random.default_rng(0).normal(size=1200)}, np.arange(1200) / 50.0)
    rare = np.arange(1200) % 50 < 46
    pieces, _ = split_at_gaps([rec.take(rare)], ["u"])
    assert [piece.n for piece in pieces] == [46] * 24
    often = np.arange(1200) % 30 < 26
    often[:60] = True  # one piece would be long enough, 950 rows would be lost
    (whole,), messages = split_at_gaps([rec.take(often)], ["u"])
    assert whole.n == often.sum()
    assert messages[0].endswith("bridged; measure without gaps")


def test_a_noisy_input_does_not_overshoot_in_a_gap():
    # a spline through samples with 2 % noise is wrong by half of the standard deviation in such gaps
    rng = np.random.default_rng(1)
    t = np.arange(4000) / 50.0
    u = np.sin(2 * np.pi * 0.3 * t + 0.5 * np.sin(t))
    kept = (np.arange(4000) + 200) % 400 > 70  # gaps of 1.4 s, less than half a period
    kept[[0, -1]] = True
    rec = bq.Record({"x": np.cos(t), "u": u + 0.02 * rng.normal(size=4000)}, t)
    even = on_grid(rec.take(kept), ["x", "u"])
    filled = filled_in(even.time, even["u"])
    np.testing.assert_array_equal(filled[kept], rec["u"][kept])
    assert np.std((filled - u)[~kept]) < 0.05
    np.testing.assert_array_equal(filled_in(t, np.where(kept, 1.0, np.nan)), 1.0)


# --- times that a coarse clock rounded -------------------------------------------------------------------------------


@pytest.mark.parametrize("fs", [800, 400, 441.3, 700])
def test_an_even_grid_rounded_to_a_large_part_of_its_step_is_even(fs):
    time = np.round(np.arange(3000) / fs, 3)  # at 800 Hz the steps are 1, 1, 1, 2 ms
    # a step of twice the shortest may be a missing row
    with pytest.warns(DataWarning, match="taken as even") if fs > 500 else contextlib.nullcontext():
        rec = bq.Record.from_arrays(x=np.sin(9 * time), time=time)
    assert rec.is_uniform()
    assert rec.fs == pytest.approx(fs, rel=1e-5)
    assert np.abs(rec.time - time).max() < 6e-4
    assert bq.check_record(bq.Record({"x": np.sin(9 * time)}, time), ["x::"]) == []


@pytest.mark.parametrize("fs", [800, 400, 700])
def test_missing_rows_are_found_in_rounded_times_too(fs):
    k = np.delete(np.arange(3000), [500, 501, 777, *range(1500, 1700)])
    even = even_times(np.round(k / fs, 3))
    np.testing.assert_array_equal(np.round((even - even[0]) * fs), k)


def test_uneven_times_are_not_taken_for_rounded_ones():
    rng = np.random.default_rng(3)
    k = np.arange(3000)
    jittered = np.sort(k + rng.uniform(-0.3, 0.3, 3000)) / 800
    some = np.sort(rng.choice(k, 2000, replace=False)) / 1000
    one = np.delete(k, 1500) / 1000
    for time in (
        jittered,
        np.round(jittered, 6),
        some,
        one,
        np.cumsum(rng.choice([1, 2], 3000)) / 1000,
        np.array([0.0]),
    ):
        assert even_times(time) is time


def test_a_rate_given_beside_rounded_times_does_not_contradict_them(tmp_path, capsys):
    path = tmp_path / "run.csv"
    rows = (f"{k / 800:.3f},{np.sin(k / 9):.6f},{np.cos(k / 20):.6f}\n" for k in range(2000))
    path.write_text("Time [s],x [mm],F [N]\n" + "".join(rows))
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr()
    assert re.search(r"2000 rows at (800|799\.99\d|800\.00\d) Hz", shown.out)
    assert "missing" not in shown.out
    assert main(["discover", str(path), "--fs", "800", "--chain", "x:", "--input", "F", "--dictionary", "x, F"]) == 0
