"""Band regression: shapes of residual spectra, and intervals by propagated noise."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import ChainError, InputError, RecordError
from bayeq.gram.band import added_floor, residual_spectrum, to_band
from bayeq.states import parse_chain
from bayeq.states.kinematic.chain_smoother import smooth_chain


def test_a_floor_is_found_under_a_known_shape():
    shape = 1.0 / (0.01 + np.linspace(0.0, 1.0, 2000) ** 2)
    count, found, absent = np.full(2000, 2.0), [], []
    for seed in range(40):
        # a periodogram's bins are exponential about the density
        noise = np.random.default_rng(seed).exponential(size=2000)
        found.append(added_floor((shape + 2.0) * noise, shape, count))
        absent.append(added_floor(shape * noise, shape, count))
    # Fisher information of a floor f: sum 1/(shape + f)^2. Standard errors 5.6 % of 2, and 0.05 where there is none.
    error, least = (1.0 / np.sqrt(np.sum((shape + f) ** -2.0)) for f in (2.0, 0.0))
    assert np.mean(found) == pytest.approx(2.0, abs=3 * error / np.sqrt(40))
    # the spread of 40 numbers has a standard error of 11 %
    assert np.std(found) == pytest.approx(error, rel=0.35)
    assert max(absent) < 4 * least


def test_a_known_shape_keeps_what_is_narrower_than_the_average():
    rng = np.random.default_rng(4)
    y = rng.normal(size=4000)
    band = to_band(np.empty((4000, 0)), y, 1.0, (0.0, 0.49))
    dip = np.where(np.abs(band.frequency - 0.2) < 0.002, 0.01, 1.0)
    dipped = band.__class__(band.frequency, band.count, band.columns * np.sqrt(dip)[:, None], band.gain, band.kept, 0)
    (plain,) = residual_spectrum([dipped], np.empty(0), 0.0)
    (shaped,) = residual_spectrum([dipped], np.empty(0), 0.0, [dip])
    middle = dip < 1.0
    assert plain[middle].mean() > 0.2  # smeared over 61 bins, of which the dip has 16
    assert shaped[middle].mean() == pytest.approx(0.01, rel=0.4)


@pytest.mark.filterwarnings("ignore::bayeq.errors.AmbiguityWarning")  # x**5 keeps a PIP of 0.09 in 1,500 rows
def test_propagated_intervals_do_not_depend_on_how_often_one_asks():
    rec = bq.simulate("duffing", n=1500, seed=2)
    first, second = (bq.discover(rec, chains="x:v:a", inputs=["u"])[0].posterior.covariance for _ in range(2))
    np.testing.assert_array_equal(first, second)


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
    found = bq.discover(alone, chains="::a", inputs=["u"])
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


def refused(records):
    with pytest.raises(InputError) as error:
        bq.discover(records, chains="::a", dictionary=["x", "dx"])
    return str(error.value)


def test_why_it_cannot_be_integrated():
    t = np.arange(2000) / 100.0
    rng = np.random.default_rng(0)
    wave = np.cos(20 * t)
    record = bq.Record({"a": wave + 0.05 * rng.normal(size=2000)}, t, name="run")
    noise = record.with_channels({"a": rng.normal(size=2000)})
    assert refused(noise) == (
        "run: 'a' cannot be integrated: it does not stand out of its noise at any frequency; measure with less noise"
    )
    assert refused([record, bq.Record({"a": record["a"]}, 2 * t)]) == (
        "run: 'a' cannot be integrated: records are sampled at different rates; resample them at one rate"
    )
    assert refused([record.slice(k, k + 4) for k in (0, 30)]).endswith(
        "too few for a regression (at least 10); measure more"
    )
    mixed = np.random.default_rng(0).permutation(record["a"])  # rows in no order, which are no time
    assert refused(bq.Record({"a": mixed}, name="run")).endswith("which needs a time column or fs")
    still = record.with_channels({"a": np.where(t < 16.5, 1.0, record["a"])})
    assert refused(still) == (
        "run: training rows of chain '::a' cannot be smoothed: derivative 2 is constant: its noise cannot be estimated"
    )


def test_an_adequate_residual_is_that_of_the_noise():
    for seed in range(3):
        eq = bq.discover(bq.simulate("duffing", seed=seed), chains="x:v:a", inputs=["u"], smooth="band")
        # chi-square of some 800 numbers
        assert eq[0].residuals.excess == pytest.approx(1.0, abs=0.15)
        assert f"{eq[0].residuals.excess_text} times the power that the noise of the channels explains" in str(eq)


def test_a_residual_beyond_the_noise_is_warned_of():
    for system, terms in (("linear", ["x", "u"]), ("duffing", ["x", "v", "u"])):
        rec = bq.simulate(system, seed=0)
        with pytest.warns(bq.errors.DataWarning, match="times the power that the noise of the channels explains"):
            eq = bq.discover(rec, chains="x:v:a", inputs=["u"], dictionary=terms, smooth="band")
        assert eq[0].residuals.excess > 2


def test_of_inputs_of_unknown_noise_no_excess_is_told():
    # white to half the sampling rate: nothing tells the force's noise from the force
    rec = bq.simulate("linear", fs=200.0, seed=0, noise=0.05)
    eq = bq.discover(rec, chains="x:v:a", inputs=["u"])
    assert eq[0].residuals.excess is None
    assert "times the power" not in str(eq)
