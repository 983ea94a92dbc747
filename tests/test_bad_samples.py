"""Spikes, stuck and clipped stretches and missing samples: found and left out, and nothing else is."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import DataWarning, RecordError
from bayeq.numerics.settings import STATES
from bayeq.states import Roles
from bayeq.states.bad_samples import find_bad_samples, without_bad_samples
from bayeq.states.prepare import missing_messages, without_empty_rows

OSCILLATOR = Roles.parse("x:v:a", None, None, None, None, ["u"])


def roles(chains, inputs=()):
    return Roles.parse(chains, None, None, None, None, list(inputs))


def found(record, which=OSCILLATOR):
    """{channel: {kind: rows}} of one record."""
    (channels,) = find_bad_samples([record], which)
    return {name: {kind: np.flatnonzero(rows).tolist() for kind, rows in bad.items()} for name, bad in channels.items()}


@pytest.fixture(scope="module")
def duffing():
    return bq.simulate("duffing", n=2000, seed=11, noise=0.02)


def changed(record, name, rows, values):
    samples = record[name].copy()
    samples[rows] = values
    return record.with_channels({name: samples})


# --- what is bad -----------------------------------------------------------------------------------------------------


# Small ones within and near the end, a large one near the begin, in every channel one; all are for make slow.
SPIKES = [(name, row, size) for name in "xvau" for row in (15, 1234, 1984) for size in (2.0, 100.0)]
SOME = {("x", 1234, 2.0), ("v", 1984, 2.0), ("a", 15, 100.0), ("a", 1234, 2.0), ("u", 1984, 2.0), ("u", 15, 100.0)}


@pytest.mark.parametrize(
    ("name", "row", "size"), [pytest.param(*one, marks=[pytest.mark.slow] * (one not in SOME)) for one in SPIKES]
)
def test_one_spike_is_found_in_every_channel(duffing, name, size, row):
    spoiled = changed(duffing, name, row, duffing[name][row] + size * duffing[name].std())
    assert found(spoiled) == {name: {"spikes": [row]}}


@pytest.mark.parametrize("chain", ["x::", ":v:", "::a", "x::a", "x:v:"])
def test_spikes_are_found_in_chains_of_fewer_channels(duffing, chain):
    name = chain.replace(":", "")[-1]
    rows = [700, 1600, 1602]
    spoiled = changed(duffing, name, rows, 3.0 * duffing[name].std() * np.array([1.0, -1.5, 2.0]))
    assert found(spoiled, roles(chain)) == {name: {"spikes": rows}}


def test_spikes_in_all_channels_are_found_and_good_samples_stay(duffing):
    rng = np.random.default_rng(5)
    hit = {name: rng.random(duffing.n) < 0.005 for name in duffing.names}
    spoiled = duffing.with_channels({name: np.where(rows, 10.0, 1.0) * duffing[name] for name, rows in hit.items()})
    for name, kinds in found(spoiled).items():
        assert set(kinds) == {"spikes"}
        assert set(kinds["spikes"]) <= set(np.flatnonzero(hit[name]))
        # ten times next to nothing is next to nothing
        large = np.abs(spoiled[name] - duffing[name]) > 2 * STATES.spike * duffing.truth.noise_sd[name]
        assert len(set(kinds["spikes"]) & set(np.flatnonzero(large))) >= 0.8 * large.sum()


def test_units_that_do_not_belong_together_hide_no_spike(duffing):
    mixed = duffing.with_channels({"x": 1e3 * duffing["x"], "a": duffing["a"] / 9.80665}, {"x": "mm", "a": "g"})
    bare = bq.Record(mixed.channels, mixed.time)
    for record in (mixed, bare):
        assert found(changed(record, "x", 900, 100.0 * record["x"].std())) == {"x": {"spikes": [900]}}


@pytest.mark.parametrize(("name", "chain"), [("a", "x:v:a"), ("x", "x:v:a"), ("a", "::a"), ("u", "x:v:a")])
def test_a_stuck_stretch_is_found(duffing, name, chain):
    rows = np.arange(1500, 1700)
    stuck = changed(duffing, name, rows, duffing[name][1500])
    assert found(stuck, roles(chain, ["u"])) == {name: {"stuck": rows.tolist()}}


@pytest.mark.parametrize("name", ["x", "v", "a", "u"])
def test_a_clipped_channel_is_found(duffing, name):
    peak = 0.7 * np.abs(duffing[name]).max()
    clipped = duffing.with_channels({name: np.clip(duffing[name], -peak, peak)})
    assert found(clipped) == {name: {"clipped": np.flatnonzero(np.abs(duffing[name]) >= peak).tolist()}}


@pytest.mark.parametrize("chain", ["x:v:a", "x::", "::a"])
@pytest.mark.parametrize("shape", ["square", "trapezoid", "limited"])
def test_a_force_at_the_limit_of_its_actuator_is_kept_and_one_beyond_its_sensor_is_not(shape, chain):
    t = np.arange(3000) / 1000.0
    force = {
        "square": 50.0 * np.tanh(np.sin(14.0 * t) / 0.03),
        "trapezoid": 50.0 * np.clip(3.0 * np.sin(14.0 * t + 0.2), -1.0, 1.0),
        "limited": bq.simulate("duffing", n=3000, seed=3, noise=0.0)["u"],
    }[shape]
    limit = 0.4 * np.abs(force).max() if shape == "limited" else np.inf
    noise = {"x": 0.02, "v": 0.02, "a": 0.02, "u": 0.0}
    for sensor in (False, True):
        if sensor and (shape != "limited" or chain == "::a"):
            continue
        record = bq.simulate(
            "duffing", n=3000, seed=3, noise=noise, force=force if sensor else np.clip(force, -limit, limit)
        )
        seen = record.with_channels({"u": np.clip(record["u"], -limit, limit)})
        assert np.mean(np.abs(seen["u"]) >= 0.999 * np.abs(seen["u"]).max()) > 0.1
        marked = np.flatnonzero(np.abs(force) >= limit).tolist()
        assert found(seen, roles(chain, ["u"])) == ({"u": {"clipped": marked}} if sensor else {})


def test_an_input_is_shut_at_zero_and_a_state_is_clipped_there(duffing):
    valve = duffing.with_channels({"u": np.maximum(duffing["u"], 0.0)})
    assert found(valve) == {}
    assert bq.check_record(valve, ["x:v:a"], ["u"]) == []
    states = duffing.with_channels({"x": np.maximum(duffing["x"], 0.0)})
    assert found(states)["x"]["clipped"] == np.flatnonzero(duffing["x"] <= 0.0).tolist()


def test_messages_name_channel_rows_and_share(duffing):
    rows = [120, 1033, 1511, 1800]
    spoiled = changed(duffing, "x", rows, 1.0)
    (record,), messages = without_bad_samples([spoiled], OSCILLATOR)
    assert messages == ["x: 4 samples left out as spikes (rows 121, 1034, 1512, ...: 0.2 %); check the sensor"]
    assert np.flatnonzero(np.isnan(record["x"])).tolist() == rows
    assert record.units == spoiled.units
    for name in ("v", "a", "u"):
        np.testing.assert_array_equal(record[name], duffing[name])
    both, messages = without_bad_samples([duffing, spoiled], OSCILLATOR)
    assert both[0] is duffing
    assert messages[0].startswith("duffing: x: 4 samples")


# --- what is not bad -------------------------------------------------------------------------------------------------


def good_records(seed):
    """(record, roles) with Gaussian noise: what a few systems do, and forces that are not smooth."""
    rng = np.random.default_rng([seed, 77])
    for system in ("duffing", "coulomb"):
        yield bq.simulate(system, n=8000, seed=seed, noise=0.02), OSCILLATOR
    for system in ("lorenz", "vanderpol"):
        record = bq.simulate(system, n=8000, seed=seed, noise=0.02)
        yield record, roles(list(record.names))
    white = 50.0 * rng.standard_normal(8000)
    yield bq.simulate("duffing", seed=seed, noise=0.05, force=white), OSCILLATOR


@pytest.mark.statistical(short=1, full=3)
def test_of_gaussian_noise_at_most_one_sample_in_1e5_is_left_out(number):
    left_out = samples = 0
    for seed in range(number):
        for record, which in good_records(seed + 1):
            (channels,) = find_bad_samples([record], which)
            left_out += sum(int(np.any(list(bad.values()), axis=0).sum()) for bad in channels.values())
            samples += record.n * len(record.names)
    assert samples >= 1.3e5 * number
    assert left_out <= 1e-5 * samples


def held(rng, n, rows, levels):
    return np.repeat(rng.choice(levels, n // rows + 1), rows)[:n]


FORCES = {
    "switched": lambda rng, n: held(rng, n, 10, [-50.0, 50.0]),
    "every sample switched": lambda rng, n: held(rng, n, 1, [-50.0, 50.0]),
    "stairs": lambda rng, n: held(rng, n, 100, np.linspace(-60.0, 60.0, 9)),
    "a step": lambda rng, n: np.where(np.arange(n) > 500, 60.0, 0.0),
    "a burst": lambda rng, n: np.where((np.arange(n) // 800) % 2 == 1, 60.0 * np.sin(0.1 * np.arange(n)), 0.0),
    "blows of one sample": lambda rng, n: np.where(np.isin(np.arange(n), rng.integers(50, n, 8)), 3000.0, 0.0),
    "blows of four samples": lambda rng, n: 3000.0 * np.isin(np.arange(n) // 4, rng.integers(50, n // 4, 8)),
}


# Every force once, of systems and levels of noise in turns; all of both are for make slow.
CASES = [(name, system, noise) for name in FORCES for system in ("duffing", "coulomb") for noise in (0.002, 0.02)]
ALTERNATING = {(name, *(("duffing", 0.002) if k % 2 else ("coulomb", 0.02))) for k, name in enumerate(FORCES)}


@pytest.mark.parametrize(
    ("name", "system", "noise"),
    [pytest.param(*case, marks=[pytest.mark.slow] * (case not in ALTERNATING)) for case in CASES],
)
def test_forces_that_jump_are_no_bad_samples(name, system, noise):
    force = FORCES[name](np.random.default_rng(8), 2000)
    # a command is known without noise
    record = bq.simulate(system, seed=4, noise={"x": noise, "v": noise, "a": noise}, force=force)
    assert found(record) == {}


# Every chain and every system, in turns; all of both are for make slow.
@pytest.mark.parametrize(
    ("system", "chain"),
    [
        *(("linear", "x:v:a"), ("linear", "::a"), ("coulomb", "x:v:a"), ("coulomb", "x::")),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("linear", "x::"), ("coulomb", "::a"))),
    ],
)
def test_free_decays_and_rest_are_no_bad_samples(system, chain):
    known = replace(bq.SYSTEMS[system], initial={"x": 0.1, "v": 0.0})
    decay = bq.simulate(known, seed=2, noise=0.01, fs=500.0, force=np.zeros(3000))
    rest = bq.Record({name: np.append(np.zeros(150), decay[name]) for name in "xva"}, np.arange(3150) / 500.0)
    for record in (decay, rest):
        assert found(record, roles(chain)) == {}
        steps = {name: np.ptp(record[name]) / 256 for name in "xva"}
        coarse = {name: step * np.round(record[name] / step) for name, step in steps.items()}
        assert found(bq.Record(coarse, record.time), roles(chain)) == {}


def test_a_channel_without_samples_has_no_bad_ones(duffing):
    assert found(changed(duffing, "u", slice(None), np.nan)) == {}


def test_short_records_and_rows_without_time_are_left_alone(duffing):
    spoiled = changed(duffing, "x", 20, 1.0)
    assert found(spoiled.slice(0, 39)) == {}
    assert found(bq.Record(spoiled.channels)) == {}


# --- discovery -------------------------------------------------------------------------------------------------------


FEW = {"chains": "x:v:a", "inputs": ["u"], "dictionary": "x, v, x**3, u, x**2, x*v, v*abs(v), sign(v)"}


@pytest.fixture(scope="module")
def short(duffing):
    return duffing.slice(0, 1000)


@pytest.fixture(scope="module")
def clean(short):
    return bq.discover(short, **FEW)


@pytest.mark.parametrize("name", ["x", pytest.param("u", marks=pytest.mark.slow)])
def test_a_spike_does_not_spoil_the_equation(short, clean, name):
    spoiled = changed(short, name, 700, 100.0 * short[name].std())
    with pytest.warns(DataWarning, match=f"{name}: 1 sample left out as spike"):
        eqs = bq.discover(spoiled, **FEW)
    assert eqs[0].included == clean[0].included == ("x", "v", "x**3", "u")
    for term in clean[0].included:
        assert eqs[0].coef[term] == pytest.approx(clean[0].coef[term], rel=0.01)
    assert any("row 701" in message for message in eqs.warnings)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_missing_samples_are_bridged_and_reported(duffing, short):
    rng = np.random.default_rng(2)
    gaps = {name: np.where(rng.random(short.n) < 0.02, np.nan, short[name]) for name in short.names}
    record = short.with_channels(gaps)
    eqs = bq.discover(record, **FEW)
    count = int(np.isnan(record["v"]).sum())
    assert any(message.startswith(f"v: {count} samples are missing (rows") for message in eqs.warnings)
    assert eqs[0].included == ("x", "v", "x**3", "u")
    for term, value in duffing.truth.coefficients["a"].items():
        assert eqs[0].coef[term] == pytest.approx(value, rel=0.1)
    with pytest.raises(RecordError, match="NaN"):
        bq.discover(record, chains="x:v:a", inputs=["u"], smooth="none")


def test_rows_with_missing_samples_are_left_out_where_there_is_no_time(duffing):
    order = np.random.default_rng(0).permutation(duffing.n)  # rows in order would be taken for time
    record = bq.Record({name: duffing[name][order] for name in duffing.names})
    record = changed(record, "v", [3, 9], np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the noise of u, too
        eqs = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u")
    assert any("v: 2 samples are missing (rows 4, 10" in message for message in eqs.warnings)
    assert eqs.data.n == duffing.n - 2


def test_stretches_that_tell_nothing_become_gaps_of_time(duffing):
    quiet = duffing.with_channels({"u": np.where(np.arange(2000) // 50 == 20, np.nan, duffing["u"])})
    (record,) = without_empty_rows([quiet], OSCILLATOR)
    assert record.n == 1950
    (single,) = without_empty_rows([changed(duffing, "u", 5, np.nan)], OSCILLATOR)
    assert single.n == 2000
    none = duffing.with_channels({name: np.where(np.arange(2000) // 50 == 20, np.nan, duffing[name]) for name in "xva"})
    assert without_empty_rows([none], OSCILLATOR)[0].n == 1950
    assert missing_messages([duffing], OSCILLATOR) == []


def test_ten_usable_rows_are_needed(duffing):
    few = duffing.slice(0, 60).with_channels({"a": np.where(np.arange(60) < 51, np.nan, duffing["a"][:60])})
    with pytest.raises(RecordError, match="9 rows of 60 with a sample of every channel"):
        bq.discover(few, chains="x:v:a", inputs=["u"])
    with pytest.raises(RecordError, match="9 rows: too few"):
        bq.discover(duffing.slice(0, 9), chains="x:v:a", inputs=["u"])


def test_channels_that_are_never_known_in_neighbouring_rows():
    record = bq.simulate("duffing", n=600, seed=11, noise=0.02)
    every_other = np.where(np.arange(600) % 2, np.nan, record["u"])
    assert found(record.with_channels({"u": every_other})) == {}  # and NumPy has nothing to warn of
