"""Channels that somebody computed from others, told from measured ones."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, savgol_filter, sosfiltfilt

import bayeq as bq
from bayeq.errors import BayeqWarning
from bayeq.states import measured_apart, parse_chains


def free_decay(seed=0, n=900, fs=30.0, damping=0.0134):
    """Displacement of a free oscillation x'' = -6.22 x - c x', rounded to whole units as by motion tracking."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) / fs
    omega = np.sqrt(6.22 - damping**2 / 4)
    x = 100 * np.exp(-damping * t / 2) * np.cos(omega * t + rng.uniform(0, 6.28))
    return t, np.round(x + 0.18 * rng.standard_normal(n))


def quietly(rec, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(rec, **options)


def local_smoothing(x, fs, half, order):
    return savgol_filter(x, 2 * half + 1, 3, deriv=order, delta=1 / fs)


def test_local_smoothing_is_seen_through_and_the_law_found():
    t, x = free_decay()
    rec = bq.Record.from_arrays(time=t, x=x, v=local_smoothing(x, 30, 6, 1), a=local_smoothing(x, 30, 10, 2))
    chains, messages = measured_apart([rec], parse_chains(["x:v:a"]), 0.2)
    assert [str(chain) for chain in chains] == ["x:~v:~a"]
    assert len(messages) == 1
    assert messages[0].startswith("v, a: computed from x, not measured")
    eq = quietly(rec, displacement="x", velocity="v", acceleration="a", dictionary=["x", "v", "sign(v)"])
    assert messages[0] in eq.warnings
    assert eq[0].target == "a"
    assert eq[0].included == ("x", "v")
    assert eq.data.estimated == ("v", "a")
    # the truth of `free_decay`, within four standard deviations
    for term, truth in (("x", -6.22), ("v", -0.0134)):
        low, high = eq[0].ci95[[t.text for t in eq[0].terms].index(term)]
        assert abs(eq[0].coef[term] - truth) < (high - low)


def test_differences_too_and_only_what_was_computed():
    rec = bq.simulate("duffing", seed=1)
    v = np.gradient(rec["x"], rec.time)
    mixed = bq.Record.from_arrays(time=rec.time, x=rec["x"], v=v, a=rec["a"], u=rec["u"])
    chains, messages = measured_apart([mixed], parse_chains(["x:v:a"]), 0.2)
    assert [str(chain) for chain in chains] == ["x:~v:a"]
    assert messages[0].startswith("v: computed from x")


@pytest.mark.parametrize("system", ["linear", "duffing", "quadratic", "coulomb"])
@pytest.mark.parametrize("noise", [0.0, 0.001, 0.05, 0.2])
@pytest.mark.parametrize("step", [1, 10])
def test_sensors_are_taken_for_sensors(system, noise, step):
    for seed in range(3):
        rec = bq.simulate(system, n=2000 * step, noise=noise, seed=seed).slice(None, None, step)
        chains = parse_chains(["x:v:a"])
        assert measured_apart([rec], chains, 0.2) == (chains, [])
        unequal = bq.simulate(system, n=2000 * step, noise={"x": 0.05, "v": 0.002, "a": 0.05}, seed=seed)
        assert measured_apart([unequal.slice(None, None, step)], chains, 0.2) == (chains, [])


def test_nothing_is_said_of_what_cannot_be_compared():
    t, x = free_decay(n=300)
    chains = parse_chains(["x:v:"])
    v = local_smoothing(x, 30, 6, 1)
    short = bq.Record.from_arrays(time=t, x=x, v=v)
    assert measured_apart([short], chains) == (chains, [])
    t, x = free_decay()
    v = local_smoothing(x, 30, 6, 1)
    uneven = bq.Record.from_arrays(time=t + 0.004 * np.random.default_rng(0).uniform(-1, 1, len(t)), x=x, v=v)
    assert measured_apart([uneven], chains) == (chains, [])
    other = bq.Record.from_arrays(time=t, x=x, w=v)
    assert measured_apart([other], chains) == (chains, [])


def test_runs_and_files_keep_the_names(tmp_path):
    t, x = free_decay()
    rec = bq.Record.from_arrays(time=t, x=x, v=local_smoothing(x, 30, 6, 1), a=local_smoothing(x, 30, 10, 2))
    eq = quietly(rec, chains="x:v:a", dictionary=["x", "v"])
    eq.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again[0].text == eq[0].text
    assert str(again[0].chain) == "x:~v:~a"
    assert again.simulate(rec, draws=0).nrmse["x"] < 0.03


@pytest.mark.parametrize("rule", ["sums", "trapezoids", "without drift"])
def test_a_running_integral_is_no_second_measurement(rule):
    record = bq.simulate("duffing", n=1200, seed=3, noise=0.02)
    a, step = record["a"], float(record.dt)
    v = np.cumsum(a) * step if rule == "sums" else cumulative_trapezoid(a, dx=step, initial=0.0)
    if rule == "without drift":
        v = sosfiltfilt(butter(2, 0.5, "high", fs=1.0 / step, output="sos"), v)
    chains, messages = measured_apart([record.with_channels({"v": v})], parse_chains(["x:v:a"]), 0.2)
    assert [str(chain) for chain in chains] == ["x:~v:a"]
    assert messages == [
        "v: computed from a, not measured: estimated from the others again (smooth='none': taken as it is)"
    ]
    same, nothing = measured_apart([record], parse_chains(["x:v:a"]), 0.2)
    assert [str(chain) for chain in same] == ["x:v:a"]
    assert nothing == []
    exact = bq.simulate("duffing", n=1200, seed=3, noise=0.0)  # smooth channels are alike, and nothing was computed
    assert measured_apart([exact], parse_chains(["x:v:a"]), 0.2)[1] == []
