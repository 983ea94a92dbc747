"""Channels of one chain in units that do not belong together, from the smoother to physical parameters."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import BayeqWarning, InputError
from bayeq.forecast.free_run import typical_period
from bayeq.forecast.rows import Rows
from bayeq.numerics.rk4 import interpolant
from bayeq.states import Roles, estimate_motion, parse_chain, rates
from bayeq.states.sensors import _estimated, of_no_unit, unit_gains

G = 9.80665
CHAIN = parse_chain("x:v:a")
SI = {"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"}
MM_G = {"x": "mm", "v": "m/s", "a": "g", "u": "N"}
NO_FORCE = (("x", 0.02), ("v", 0.02), ("a", 0.02))


@cache
def duffing(noise=0.02):
    return bq.simulate("duffing", n=1000, seed=3, noise=dict(noise) if isinstance(noise, tuple) else noise)


def in_units(x_size=1.0, v_size=1.0, a_size=1.0, /, noise=0.02, **units):
    """A record with channels multiplied by their sizes, and such units stated."""
    record = duffing(noise)
    channels = {"x": record["x"] * x_size, "v": record["v"] * v_size, "a": record["a"] * a_size, "u": record["u"]}
    return bq.Record.from_arrays(channels, time=record.time, units=units)


def si():
    return in_units(**SI)


def mm():
    return in_units(1e3, x="mm", v="m/s", a="m/s^2", u="N")


def mm_g():
    return in_units(1e3, 1.0, 1 / G, **MM_G)


def discover(record, chain="x:v:a", **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(record, chains=chain, inputs=["u"], dictionary=["x", "v", "x**3", "u"], **options)


@cache
def answer(make, chain="x:v:a"):
    """What is found in a record that several tests ask about."""
    return discover(make(), chain)


# --- the factors -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sizes", "units", "gains"),
    [
        ((1e3, 1.0, 1.0), {"x": "mm", "v": "m/s", "a": "m/s^2"}, (1e-3, 1e-3)),
        ((1e3, 1.0, 1 / G), {"x": "mm", "v": "m/s", "a": "g"}, (1e-3, 1e-3 / G)),
        ((180 / math.pi, 1.0, 30 / math.pi), {"x": "deg", "v": "rad/s", "a": "rpm/s"}, (math.pi / 180, 1 / 6)),
        ((1 / 0.0254, 1 / 0.3048, 100.0), {"x": "in", "v": "ft/s", "a": "cm/s^2"}, (1 / 12, 2.54)),
        # the velocity's unit is not stated: as estimated
        ((1e3, 1.0, 1 / G), {"x": "mm", "a": "g"}, (1e-3, 1e-3 / G)),
    ],
)
def test_stated_units_are_taken_exactly(sizes, units, gains):
    np.testing.assert_allclose(unit_gains([in_units(*sizes, **units)], CHAIN), (1.0, *gains), rtol=1e-14)


@pytest.mark.parametrize("size", [1.0, 1e2, 1e3, 1e6])
def test_accelerations_in_g_beside_any_length(size):
    # within 2 % of a power of ten
    found = unit_gains([in_units(size, 1.0, 1 / G)], parse_chain("x:~v:a"))
    np.testing.assert_allclose(found, (1.0, 1.0, 1 / (size * G)), rtol=1e-14)


@pytest.mark.parametrize(
    ("sizes", "gains"),
    [
        ((1.0, 1.0, 1.0), (1.0, 1.0)),
        ((10.0, 1.0, 1.0), (0.1, 0.1)),
        ((1e3, 1.0, 1.0), (1e-3, 1e-3)),
        # 2 % from 1e-4, and from 1e-3: the estimate tells them apart
        ((1e3, 1.0, 1 / G), (1e-3, 1e-3 / G)),
        ((1e2, 1.0, 1 / G), (1e-2, 1e-2 / G)),
        ((1.0, 1.0, 1 / G), (1.0, 1 / G)),
        ((1.0, 180 / math.pi, 180 / math.pi), (180 / math.pi, 180 / math.pi)),
        ((1.0, -1.0, 1.0), (-1.0, 1.0)),
        # calibration and filters are no units
        ((1.0, 1.04, 0.95), (1.0, 1.0)),
    ],
)
def test_units_that_are_not_stated_are_read_from_the_motion(sizes, gains):
    np.testing.assert_allclose(unit_gains([in_units(*sizes)], CHAIN), (1.0, *gains), rtol=1e-14)


def test_a_factor_that_is_no_unit_is_left_as_it_is_found():
    found = unit_gains([in_units(1.0, 1.6, 1.6)], CHAIN)
    np.testing.assert_allclose(found[1:], 1.6, rtol=0.005)
    assert found[1] != 1.6


def test_stated_units_that_the_motion_contradicts_are_not_believed():
    # calibration does not contradict them, a factor of a thousand does
    off = in_units(1.0, 1.05, **SI)
    assert unit_gains([off], CHAIN).tolist() == [1.0, 1.0, 1.0]
    wrong = in_units(1e3, **SI)
    np.testing.assert_allclose(unit_gains([wrong], CHAIN), (1.0, 1e-3, 1e-3), rtol=1e-14)


def test_derivatives_that_are_not_measured_have_the_unit_that_follows():
    assert unit_gains([mm()], parse_chain("x:v:")).tolist() == [1.0, 1e-3, 1e-3]
    assert unit_gains([mm_g()], parse_chain("x::a")).tolist() == pytest.approx([1.0, 1.0, 1e-3 / G])
    assert unit_gains([mm_g()], parse_chain("::a")).tolist() == [1.0, 1.0, 1.0]


def test_nothing_is_read_from_channels_that_do_not_show_one_motion():
    rng = np.random.default_rng(0)
    x, v = rng.normal(size=(2, 2000))
    # proportional to x, not its second derivative
    record = bq.Record.from_arrays(x=x, v=v, a=-9.0 * x, fs=100.0)
    assert unit_gains([record], CHAIN).tolist() == [1.0, 1.0, 1.0]


def test_units_are_read_without_time_and_where_records_agree():
    no_time = bq.Record.from_arrays(dict(mm().channels), units=dict(mm().units))
    assert unit_gains([no_time], CHAIN).tolist() == [1.0, 1e-3, 1e-3]
    # x in mm and in m, depending on the record: what the first rows show
    both = [mm(), in_units(1e3, v="m/s", a="m/s^2")]
    np.testing.assert_allclose(unit_gains(both, CHAIN), (1.0, 1e-3, 1e-3), rtol=1e-14)


def test_only_training_rows_are_looked_at():
    spoiled = in_units(1e3)
    v = spoiled["v"].copy()
    v[700:] = 0.0
    spoiled = spoiled.with_channels({"v": v})
    assert unit_gains([spoiled], CHAIN, [700]).tolist() == [1.0, 1e-3, 1e-3]


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("n", [200, 2000])
def test_the_estimate_is_as_far_off_as_it_says(noise, n):
    errors = []
    for seed in range(5):
        record = bq.simulate("duffing", n=n, seed=seed, noise=noise)
        for below, above, order in (("x", "v", 1), ("v", "a", 1), ("x", "a", 2)):
            found = _estimated([record], [n], below, above, order)
            if found is not None:
                assert abs(math.log(found.gain)) <= found.error
                errors.append(found.error)
    assert len(errors) > 9
    # 2,000 rows tell 1e-3 from 1e-2/g
    assert n < 2000 or noise > 0.05 or np.median(errors) < 0.02


# --- what uses them --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain():
    return answer(si)


@pytest.mark.parametrize("make", [pytest.param(mm, marks=pytest.mark.slow), mm_g])
@pytest.mark.parametrize(
    ("smooth", "stated"),
    [
        ("auto", True),
        ("none", False),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("auto", False), ("none", True))),
    ],
)
def test_free_runs_are_those_of_the_same_motion_in_one_unit(plain, make, smooth, stated):
    record = make()
    record = record if stated else bq.Record.from_arrays(dict(record.channels), time=record.time)
    twin = plain if smooth == "auto" else discover(si(), smooth="none")
    eq = answer(make) if stated and smooth == "auto" else discover(record, smooth=smooth)
    assert eq[0].included == twin[0].included
    assert twin.scores.free_run["x"] < 0.1
    assert eq.scores.free_run == pytest.approx(twin.scores.free_run, rel=1e-3)
    run, same = (one.simulate(record if one is eq else si(), draws=20) for one in (eq, twin))
    for name, size in (("x", 1e3), ("v", 1.0)):
        scale = size * same.mean[name].std()
        np.testing.assert_allclose(run.mean[name], size * same.mean[name], atol=1e-3 * scale)
        np.testing.assert_allclose(run.high[name], size * same.high[name], atol=0.02 * scale)


def test_the_right_hand_side_is_in_the_units_of_the_states(plain):
    eq = answer(mm_g)
    np.testing.assert_allclose(eq.rhs(0.0, [20.0, 0.3], 5.0), plain.rhs(0.0, [0.02, 0.3], 5.0) * [1e3, 1.0], rtol=1e-5)
    assert "units of the channels: dx/dt = 1000 v, dv/dt = 9.80665 a" in str(eq)
    assert "units of the channels" not in str(plain)


def test_the_period_is_that_of_the_motion():
    record = mm()
    eq = answer(mm)
    driven, known = interpolant(record.time, record["u"][:, None], "cubic"), np.ones(record.n, dtype=np.bool_)
    rows = Rows("", record.time, record.channels, {}, {}, known, driven)
    period = typical_period(eq.dynamics(), [rows])
    assert period == pytest.approx(2 * np.pi * duffing()["x"].std() / duffing()["v"].std())


def test_first_order_chains_too():
    rng = np.random.default_rng(1)
    t = np.arange(2000) / 100
    clean = np.cumsum(np.convolve(rng.normal(size=2099), np.hanning(100), "valid")) / 100
    x = clean - clean.mean()
    record = bq.Record.from_arrays(x=1e3 * x, rate=np.gradient(x, t), time=t, units={"x": "mm", "rate": "m/s"})
    assert unit_gains([record], parse_chain("x:rate")).tolist() == [1.0, 1e-3]
    assert rates(parse_chain("x:rate"), (1.0, 1e-3)) == (1000.0,)
    assert rates(parse_chain("x:rate"), ()) == (1.0,)


def test_states_that_are_taken_as_measured_have_their_factors():
    motion = estimate_motion([in_units(1e3, noise=0.0)], Roles((CHAIN,), ("u",)), smooth="none")
    assert motion.smoothing == ()
    assert [gains.tolist() for gains in motion.unit_gains] == [[1.0, 1e-3, 1e-3]]


def test_saved_and_loaded(tmp_path):
    eq = answer(mm_g)
    eq.save(tmp_path / "eq.json")
    loaded = bq.load(tmp_path / "eq.json")
    assert loaded[0].unit_gains == eq[0].unit_gains != (1.0, 1.0, 1.0)
    assert loaded.score(mm_g()) == eq.score(mm_g())
    assert eq.to_dict()["equations"][0]["unit_gains"] == list(eq[0].unit_gains)


# --- physical parameters ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "chain"),
    [
        (mm_g, "x:v:a"),
        *(
            pytest.param(make, chain, marks=pytest.mark.slow)
            for make, chain in ((mm, "x:v:"), (mm_g, "x:~v:a"), (mm, "x:v:a"))
        ),
    ],
)
def test_physical_parameters_are_right_in_stated_units(make, chain):
    found = answer(make, chain).physical()
    twin = answer(si, chain).physical()
    for symbol, true in {"m": 1.0, "c": 2.0, "k": 1000.0, "k3": 1e5}.items():
        assert found[symbol].mean == pytest.approx(twin[symbol].mean, rel=1e-3)
        assert abs(found[symbol].mean - true) < 4 * found[symbol].sd
        assert found[symbol].unit == twin[symbol].unit
    assert found["f_n"].mean == pytest.approx(twin["f_n"].mean, rel=1e-3)


def test_physical_parameters_without_units_are_those_of_the_motion(plain):
    eq = discover(in_units(1e3, 1.0, 1 / G))
    found, twin = eq.physical(), plain.physical()
    for symbol in ("f_n", "zeta"):
        assert found[symbol].mean == pytest.approx(twin[symbol].mean, rel=1e-3)
    # newtons per millimetre, which it cannot know
    assert found["k"].mean == pytest.approx(1e-3 * twin["k"].mean, rel=1e-3)
    assert found["k"].unit is None


def test_a_reversed_velocity_damps(plain):
    eq = discover(in_units(1.0, -1.0, **SI))
    assert eq[0].unit_gains == (1.0, -1.0, 1.0)
    assert eq.physical()["c"].mean == pytest.approx(plain.physical()["c"].mean, rel=0.01)


def test_physical_parameters_are_refused_where_units_contradict_the_motion():
    eq = discover(in_units(1e3, **SI))
    with pytest.raises(InputError, match=r"v in m/s should be 1 times the derivative of x in m, but it is 0.001 times"):
        eq.physical()
    # a file of equations from before these factors were kept: stated units are all that is known
    before = replace(eq, equations=(replace(eq[0], unit_gains=()),))
    assert before.physical()["k"].unit == "N/m"


# --- output error ----------------------------------------------------------------------------------------------------


def test_refined_coefficients_are_those_of_the_same_motion_in_one_unit():
    # every channel is fitted, the acceleration too, which is not the derivative of the velocity's channel by seconds
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        records = [in_units(noise=NO_FORCE, **SI), in_units(1e3, 1.0, 1 / G, noise=NO_FORCE, **MM_G)]
        after = [discover(record, smooth="none").refine(record) for record in records]
    assert all(one.refined is not None for one in after)
    sizes = {"x": 1e-3, "v": 1.0, "x**3": 1e-9, "u": 1.0}
    for name, size in sizes.items():
        assert after[1][0].coef[name] == pytest.approx(after[0][0].coef[name] * size / G, rel=1e-3)
    assert after[1].scores.free_run == pytest.approx(after[0].scores.free_run, rel=1e-3)
    for name, size in (("x", 1e3), ("v", 1.0), ("a", 1 / G)):
        assert after[1].refined.noise_sd[name] == pytest.approx(size * after[0].refined.noise_sd[name], rel=1e-3)
    assert after[1].physical()["k"].mean == pytest.approx(after[0].physical()["k"].mean, rel=1e-3)


def test_clipped_peaks_do_not_change_a_unit():
    record = in_units(1e3, **{**SI, "x": "mm"})
    a = np.clip(record["a"], *np.quantile(record["a"], [0.05, 0.95]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        eq = bq.discover(record.with_channels({"a": a}), chains="x::a", inputs=["u"], dictionary="x, dx, x**3, u")
    assert eq[0].unit_gains == (1.0, 1.0, 0.001)
    assert any("left out as clipped" in str(one.message) for one in caught)
    assert not any("calibration" in str(one.message) for one in caught)
    assert abs(eq.physical()["k"].mean - 1000.0) < 4 * eq.physical()["k"].sd


def test_a_velocity_that_no_unit_makes_the_derivative_is_not_found():
    found = discover(in_units(1.0, 1.2, 1.0, **SI))
    assert found.verdict.kind == "nearly true"
    assert re.match(r"v is 1\.\d+ times what x gives, and no unit differs by that", found.verdict.reason)
    assert of_no_unit(CHAIN, (1.0, 1e-3, 1.0 / G), {}) is None
    assert of_no_unit(CHAIN, (1.0, 39.37, 1.0), {}) is None  # a unit that is not known here
    assert of_no_unit(CHAIN, (1.0, 1.0, 0.8), SI) == ("a", "x", 0.8)
