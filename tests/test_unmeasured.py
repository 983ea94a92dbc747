"""Coordinates that no channel measures."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import ChainError, InputError, RecordError
from bayeq.states import parse_chain
from bayeq.states.kinematic.chain_smoother import smooth_chain


def test_a_coordinate_that_is_not_measured_is_bounded():
    rec = bq.simulate("linear", seed=1, noise=0.05)
    (states,), smoothing = smooth_chain([rec], parse_chain("::a"))
    assert smoothing.coordinate_sd is not None
    low, high = smoothing.band
    assert 0.3 < low < 3.0 < 60.0 < high  # resonance at 5 Hz, force up to 100 Hz
    clean = rec.truth.clean["x"]
    assert abs(states[:, 0].mean()) < 0.1 * clean.std()
    assert np.corrcoef(states[:, 0], clean)[0, 1] > 0.9
    assert np.corrcoef(states[:, 1], rec.truth.clean["v"])[0, 1] > 0.98


def test_acceleration_and_force_are_enough():
    rec = bq.simulate("linear", seed=1)
    alone = bq.Record.from_arrays({"a": rec["a"], "u": rec["u"]}, time=rec.time)
    found = bq.discover(alone, chains="::a", inputs=["u"], dictionary="x, dx, x**2, x**3, dx*abs(dx), u")
    eq = found[0]
    assert "not measured, estimated by smoothing: x, dx" in str(found)
    assert "free run over" not in str(found)  # there is no state to compare it with
    assert set(eq.included) == {"x", "dx", "u"}
    sd = dict(zip((t.text for t in eq.terms), eq.posterior.sd, strict=True))
    for name, value in {"x": -1000.0, "dx": -2.0, "u": 1.0}.items():
        assert abs(eq.coef[name] - value) < 4 * sd[name]
        assert abs(eq.coef[name] / value - 1.0) < 0.15


def test_what_cannot_be_integrated():
    rec = bq.simulate("linear", n=500, seed=1)
    with pytest.raises(ChainError, match="integrated"):
        bq.discover(rec, chains="::a", inputs=["u"], smooth="none")
    uneven = rec.take(np.sort(np.random.default_rng(0).choice(500, 200, replace=False)))
    odd = bq.Record.from_arrays(
        {name: uneven[name] for name in "au"}, time=uneven.time + 1e-4 * np.random.default_rng(1).random(200)
    )
    with pytest.raises(RecordError, match="record: 'a' cannot be integrated: its steps of time are uneven"):
        bq.discover(odd, chains="::a", inputs=["u"])


def refused(records, inputs=()):
    with pytest.raises(InputError) as error:
        bq.discover(records, chains="::a", dictionary=["x", "dx"], inputs=inputs)
    return str(error.value)


def test_why_it_cannot_be_integrated():
    t = np.arange(2000) / 100.0
    rng = np.random.default_rng(0)
    wave = np.cos(20 * t)
    record = bq.Record({"a": wave + 0.05 * rng.normal(size=2000)}, t, name="run")
    noise = record.with_channels({"a": rng.normal(size=2000)})
    assert refused(noise) == (
        "run: 'a' cannot be integrated: it does not stand out of its noise at any frequency; measure with less"
        " noise, or leave rows at rest out"
    )
    assert refused([record, bq.Record({"a": 1.1 * record["a"]}, 2 * t)]) == (
        "run: 'a' cannot be integrated: records are sampled at different rates; resample them at one rate"
    )
    assert refused([record.slice(k, k + 4) for k in (0, 30)]).endswith(
        "too few for a regression (at least 10); measure more"
    )
    mixed = np.random.default_rng(0).permutation(record["a"])  # rows in no order, which are no time
    assert refused(bq.Record({"a": mixed}, name="run")).endswith("which needs a time column or fs")
    still = record.with_channels({"a": np.where(t < 16.5, 1.0, record["a"]), "u": rng.normal(size=2000)})
    assert refused(still, inputs=["u"]) == (
        "run: training rows of chain '::a' cannot be smoothed: derivative 2 is constant: its noise cannot be estimated"
    )
