"""Checks before inference: what is wrong with a record is found and named, and a clean record passes."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning, InputError, RecordError, UnknownNameError
from bayeq.numerics.distributions import t_quantile
from bayeq.records.consistency import Frames, _weak_derivative, relate, uniform_frames
from bayeq.records.findings import check_messages, clipped_levels
from tests.data import measured

OSCILLATORS = ("linear", "duffing", "quadratic", "coulomb")
CHAIN = ["x:v:a"]


def simulated(system="duffing", seed=0, noise=0.05, **options):
    return bq.simulate(system, seed=[seed, 11], noise=noise, perturb=0.1, **options)


def late(record, channel, samples, seed=0):
    """A record one of whose channels lags behind, its noise as ever."""
    clean = CubicSpline(record.time, record.truth.clean[channel])(record.time - samples * record.dt)
    noise = record.truth.noise_sd[channel] * np.random.default_rng(seed).normal(size=record.n)
    return record.with_channels({channel: clean + noise}, {channel: record.units[channel]})


def kinds(record, chains=CHAIN, inputs=("u",)):
    return [(f.kind, f.channels[0]) for f in bq.check_record(record, chains, inputs)]


# --- clean records ---------------------------------------------------------------------------------------------------


@pytest.mark.statistical(short=3, full=5)
def test_clean_records_pass(number):
    # of 6700 checks of clean records (the four oscillators of 200 to 4000 rows, Lorenz; 0 to 10 % noise) none alarmed;
    # here up to 66 records, those of oscillators with three chains each
    for seed in range(number):
        for system in OSCILLATORS:
            for noise in (0.0, 0.05, 0.1):
                record = simulated(system, seed, noise, n=(4000, 1000, 300)[seed % 3])
                for chain in ("x:v:a", "x::a", "x:v:"):
                    assert bq.check_record(record, [chain], ["u"]) == []
    for seed in range(6):
        record = bq.simulate("lorenz", seed=seed, noise=0.1 * (seed % 3) / 2, perturb=0.1)
        rng = np.random.default_rng(seed)
        flow = {k: v + 0.05 * v.std() * rng.normal(size=record.n) for k, v in record.truth.clean.items() if k[0] == "d"}
        both = bq.Record({**record.channels, **flow}, record.time)
        assert bq.check_record(both, ["x", "y", "z"]) == []
        assert bq.check_record(both, ["x:dx", "y:dy", "z:dz"]) == []


def test_records_too_short_without_time_or_with_gaps_are_not_compared():
    record = simulated()
    reverse = record.with_channels({"v": -record["v"]})
    assert kinds(reverse) == [("sign", "v")]
    assert kinds(reverse.slice(0, 100)) == []
    assert kinds(bq.Record(reverse.channels)) == []
    assert kinds(reverse.take(np.sort(np.random.default_rng(0).choice(4000, 2000, replace=False)))) == []
    gap = reverse.with_channels({"v": np.where(np.arange(4000) == 77, np.nan, reverse["v"])})
    assert kinds(gap) == []
    jitter = np.sort(record.time + np.random.default_rng(0).uniform(-4e-4, 4e-4, 4000))
    assert kinds(bq.Record(reverse.channels, jitter)) == []
    with pytest.raises(UnknownNameError, match="'w'"):
        bq.check_record(record, ["x:w:a"])


def test_times_that_are_rounded_are_even():
    record = simulated(n=1000)
    rounded = bq.Record(record.with_channels({"v": -record["v"]}).channels, np.round(record.time / 0.03, 3) * 0.03)
    assert not rounded.is_uniform()
    assert kinds(rounded) == [("sign", "v")]


# --- channels against each other -------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_weak_derivative_is_the_derivative_of_the_windowed_motion(order):
    # a polynomial times the window, integrated by parts: both sides by quadrature
    t = np.arange(4000) / 4000
    p, d = np.sin(23 * t + 1), 23.0**order * np.sin(23 * t + 1 + order * np.pi / 2)
    frames = Frames(np.array([0, 1000]), 2048, 1 / 4000, t)
    left, right = _weak_derivative(d, frames, 0), _weak_derivative(p, frames, order)
    np.testing.assert_allclose(right[:, :40], left[:, :40], atol=1e-5 * np.abs(left).max())


@pytest.mark.parametrize("channel", ["x", "v", "a"])
@pytest.mark.parametrize("samples", [0.5, 1.0, 5.0, -2.0])
def test_a_delay_is_found_and_measured(channel, samples):
    # 50 seeds each found 90 to 100 % of half a sample and all of one and more, to 0.04 samples
    found = 0
    for seed, system in enumerate(OSCILLATORS):
        record = late(simulated(system, seed), channel, samples)
        findings = bq.check_record(record, CHAIN, ["u"])
        if findings:
            (finding,) = findings
            assert (finding.kind, finding.channels[0]) == ("delay", channel)
            assert finding.value == pytest.approx(samples * 1e-3, abs=2e-4)
            assert f"bayeq.correct_delay(record, '{channel}'" in finding.message
            found += 1
    assert found >= (4 if abs(samples) >= 1 else 3)


def test_delays_between_two_channels_blame_the_derivative():
    record = late(simulated(seed=3), "x", 2.0)
    (finding,) = bq.check_record(record, ["x:v:"], ["u"])
    assert finding.channels == ("v", "x")
    assert finding.value == pytest.approx(-2e-3, abs=2e-4)
    assert finding.message.startswith("v is ahead of dx/dt by 2")
    (finding,) = bq.check_record(record, ["x::a"], ["u"])
    assert finding.message.startswith("a is ahead of d2x/dt2 by 2")


@pytest.mark.parametrize("digits", [3, 5, 12])
@pytest.mark.parametrize("fs", [400.0, 330.0])
def test_interpolated_samples_are_noticed(digits, fs):
    rng = np.random.default_rng(1)
    coarse = np.arange(501) / 50
    t = np.arange(0.0, 10.0, 1.0 / fs)
    x = np.cumsum(rng.normal(size=501))
    made = bq.Record({"x": np.round(np.interp(t, coarse, x), digits), "u": np.sin(t)}, t)
    (finding,) = bq.check_record(made, ["x::"], ["u"])
    assert (finding.kind, finding.value) == ("interpolated", pytest.approx(fs / 50, rel=1e-3))
    assert "it was interpolated from 50 Hz; give the samples as measured" in finding.message


def test_a_force_may_go_straight_between_its_values():
    t = np.arange(4000) / 400
    u = np.interp(t, np.arange(501) / 50, np.random.default_rng(1).normal(size=501))
    (finding,) = bq.check_record(bq.Record({"x": np.sin(t), "u": u}, t), ["x::"], ["u"])
    assert finding.message.endswith("if it was interpolated from 50 Hz, give the samples as measured")


def test_samples_that_are_left_out_are_not_lost_ones():
    record = bq.simulate("duffing", n=1500, noise=0.01, seed=2)
    x, most = record["x"], np.quantile(np.abs(record["x"]), 0.97)
    clipped = bq.Record.from_arrays({"x": np.clip(x, -most, most), "u": record["u"]}, time=record.time)
    with pytest.warns(DataWarning) as said:
        bq.discover(clipped, chains="x::", inputs="u", dictionary="x, dx, x**3, u")
    messages = " ".join(str(one.message) for one in said)
    assert "left out" in messages
    assert "missing" not in messages
    rows = np.delete(np.arange(1500), [300, 700])
    lost = bq.Record.from_arrays({name: record[name][rows] for name in "xu"}, time=record.time[rows])
    with pytest.warns(DataWarning, match="2 samples are missing"):
        bq.discover(lost, chains="x::", inputs="u", dictionary="x, dx, x**3, u")


def test_triangles_levels_holds_and_smooth_motion_are_not_interpolated():
    t = np.arange(4000) / 400
    slow = np.sin(2.0 * t) + 0.3 * np.sin(5.1 * t)
    for x in (
        np.abs((t * 5) % 2 - 1),  # a triangle
        np.round(slow, 2),
        np.round(slow, 3),
        slow,
        np.repeat(np.random.default_rng(0).normal(size=500), 8),
        np.where(np.arange(4000) % 40 == 0, 1.0, 0.0),
        np.interp(t, np.sort(np.random.default_rng(0).uniform(0, 10, 300)), np.random.default_rng(1).normal(size=300)),
    ):
        found = bq.check_record(bq.Record({"x": x}, t), ["x::"])
        assert "interpolated" not in {finding.kind for finding in found}


@pytest.mark.parametrize("channel", ["x", "v", "a"])
def test_a_wrong_sign_is_named(channel):
    for seed, system in enumerate(OSCILLATORS):
        record = simulated(system, seed)
        (finding,) = bq.check_record(record.with_channels({channel: -record[channel]}), CHAIN, ["u"])
        assert (finding.kind, finding.channels[0], finding.value) == ("sign", channel, -1.0)
    what = {"x": "the integral of v", "v": "dx/dt", "a": "d2x/dt2"}[channel]
    assert finding.message == f"{channel} has the opposite sign of {what}: reverse it (--scale {channel}=-1)"


@pytest.mark.parametrize("channel", ["x", "v", "a"])
@pytest.mark.parametrize(
    ("gain", "hint"),
    [
        (1.1, "calibration"),
        (1.04, "calibration"),
        (0.9, "calibration"),
        (9.80665, "g and m/s^2"),
        (1 / 9.80665, "g and m/s^2"),
        (1e3, "milli-units"),
        (1e-3, "milli-units"),
        (2 * np.pi, "cycles and radians"),
        (180 / np.pi, "radians and degrees"),
    ],
)
def test_a_wrong_gain_is_named_and_known_factors_recognised(channel, gain, hint):
    for seed, system in enumerate(OSCILLATORS[:2]):
        record = simulated(system, seed)
        (finding,) = bq.check_record(record.with_channels({channel: gain * record[channel]}), CHAIN, ["u"])
        assert (finding.kind, finding.channels[0]) == ("gain", channel)
        assert finding.value == pytest.approx(gain, rel=0.01)
        assert hint in finding.message


def test_gains_that_the_units_state_are_no_mistake():
    record = simulated()
    mm = bq.Record(
        {**record.channels, "x": 1e3 * record["x"], "a": record["a"] / 9.80665}, record.time,
        units={"x": "mm", "v": "m/s", "a": "g"},
    )  # fmt: skip
    assert bq.check_record(mm, CHAIN, ["u"]) == []
    undeclared = bq.Record(mm.channels, mm.time, units={"x": "mm", "v": "mm/s", "a": "g"})
    (finding,) = bq.check_record(undeclared, CHAIN, ["u"])
    assert finding.channels[0] == "v"
    assert "v is 0.001 times dx/dt" in finding.message
    unknown = bq.Record(mm.channels, mm.time, units={"x": "mm", "a": "g"})  # the units of x and a agree
    assert [one.channels[0] for one in bq.check_record(unknown, CHAIN, ["u"])] == ["v"]
    force = bq.Record(record.channels, record.time, units={"x": "m", "v": "N"})
    assert bq.check_record(force, CHAIN, ["u"]) == []


@pytest.mark.parametrize("channel", ["v", "a"])
def test_offsets_and_drifts_are_measured(channel):
    # 50 seeds each: half of 1 % of the standard deviation is found, 2 % always
    for seed, system in enumerate(OSCILLATORS):
        record = simulated(system, seed)
        spread = record[channel].std()
        ramp = np.linspace(-1.0, 1.0, record.n)
        (finding,) = bq.check_record(record.with_channels({channel: record[channel] + 0.05 * spread}), CHAIN, ["u"])
        assert (finding.kind, finding.channels[0]) == ("offset", channel)
        assert finding.value == pytest.approx(0.05 * spread, rel=0.15)
        drifting = record.with_channels({channel: record[channel] + 0.05 * spread * (1 + ramp)})
        offset, drift = bq.check_record(drifting, CHAIN, ["u"])
        assert (offset.kind, drift.kind) == ("offset", "drift")
        assert drift.value * record.time[-1] == pytest.approx(0.1 * spread, rel=0.15)
        right = bq.remove_offset(drifting, channel, offset.value, drift=drift.value)
        assert bq.check_record(right, CHAIN, ["u"]) == []
        np.testing.assert_allclose(right[channel], record[channel], atol=0.01 * spread)


def test_an_offset_is_measured_beside_a_wrong_sign_and_gain():
    record = simulated("linear", 5)
    wrong = record.with_channels({"v": 0.2 * record["v"].std() - 3.0 * record["v"]})
    found = {f.kind: f for f in bq.check_record(wrong, ["x:v:"], ["u"])}
    assert set(found) == {"sign", "gain", "offset"}
    assert found["offset"].value == pytest.approx(0.2 * record["v"].std(), rel=0.1)


def shaft(seed, noise, n=4000):
    """A shaft that runs up to 6 turns per second, with a ripple in every turn: its angle and its speed."""
    t = np.arange(n) / 100
    rng = np.random.default_rng(seed)
    mean, angle = 40 * (1 - np.exp(-t / 10)), 40 * (t - 10 * (1 - np.exp(-t / 10)))
    ripple = 0.05 * np.sin(angle) + 0.3 * np.sin(7 * t)
    slope = 0.05 * np.cos(angle) * mean + 2.1 * np.cos(7 * t)
    return bq.Record(
        {"x": angle + ripple + noise * rng.normal(size=n), "v": mean + slope + noise * rng.normal(size=n)}, t
    )


def test_an_angle_of_many_turns_and_its_speed():
    for noise in (1e-3, 0.01, 0.1, 0.3):
        for seed in range(5):
            record = shaft(seed, noise)
            assert np.ptp(record["x"]) > 180 * 2 * np.pi
            assert bq.check_record(record, ["x:v:"]) == []
    # what is wrong is still found
    record = shaft(0, 0.01)
    spread = record["v"].std()
    for offset in (-0.05, 0.05):
        (finding,) = bq.check_record(record.with_channels({"v": record["v"] + offset * spread}), ["x:v:"])
        assert finding.kind == "offset"
        assert finding.value == pytest.approx(offset * spread, rel=0.02)
    assert ("gain", "v") in kinds(record.with_channels({"v": 1.1 * record["v"]}), ["x:v:"], ())
    assert kinds(record.with_channels({"v": -record["v"]}), ["x:v:"], ()) == [("sign", "v")]
    turns = np.round(record["x"] / (2 * np.pi) * 4096) / 4096
    assert bq.check_record(bq.Record({"x": 2 * np.pi * turns, "v": record["v"]}, record.time), ["x:v:"]) == []


def test_even_motion_leaves_nothing_to_compare():
    t = np.arange(8000) / 20
    assert bq.check_record(bq.Record({"x": 5 * t + 0.025 * t**2, "v": 5 + 0.05 * t}, t), ["x:v:"]) == []


def test_units_of_the_channels_do_not_matter():
    record = simulated("quadratic", 5)
    wrong = late(record, "v", 1.5).with_channels({"a": 0.05 * record["a"].std() - record["a"]})
    plain = bq.check_record(wrong, CHAIN, ["u"])
    assert {f.kind for f in plain} == {"sign", "delay", "offset"}
    for scale in (1e-120, 1e140):
        scaled = bq.Record({name: scale * wrong[name] for name in wrong.names}, wrong.time)
        found = bq.check_record(scaled, CHAIN, ["u"])
        assert [f.kind for f in found] == [f.kind for f in plain]
        for one, other in zip(found, plain, strict=True):
            assert one.value == pytest.approx(other.value * (scale if other.kind == "offset" else 1.0), rel=1e-6)


def test_channels_that_are_mixed_up():
    for seed, system in enumerate(OSCILLATORS):
        record = simulated(system, seed)
        swapped = record.with_channels({"v": record["a"], "a": record["v"]})
        (finding,) = bq.check_record(swapped, CHAIN, ["u"])
        assert (finding.kind, finding.channels) == ("inconsistent", ("v", "x"))
        assert "check which channel is which" in finding.message


def test_a_relation_is_unsure_by_what_it_says():
    errors = []
    for seed in range(25):
        record = late(simulated("linear", seed), "v", 1.0, seed)
        link = relate(record["x"], record["v"], 1, uniform_frames(record.time))
        errors.append([(link.delay - 1e-3) / link.delay_error, np.log(link.gain) / link.gain_error])
    # standard errors err upwards: those of the delay about by half
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (spread > 0.4).all()
    assert (spread < 1.6).all()


def test_student_s_quantile():
    from scipy.stats import norm, t

    for freedom in (6, 10, 30):
        assert t_quantile(freedom, 4.0) == pytest.approx(t.isf(norm.sf(4.0), freedom), rel=0.05)


# --- samples ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channel", ["x", "v"])
def test_clipping_is_found(channel):
    for seed, system in enumerate(OSCILLATORS):
        record = simulated(system, seed)
        limit = 0.9 * np.abs(record[channel]).max()
        clipped = record.with_channels({channel: np.clip(record[channel], -limit, limit)})
        findings = [f for f in bq.check_record(clipped, CHAIN, ["u"]) if f.kind == "clipping"]
        assert findings
        for finding in findings:
            assert abs(finding.value) == pytest.approx(limit)
            assert finding.channels == (channel,)
        # rounded to 12 bits of its range it is still clipped, and without clipping it is not
        step = np.ptp(record[channel]) / 4096
        rounded = clipped.with_channels({channel: np.round(clipped[channel] / step) * step})
        assert ("clipping", channel) in kinds(rounded)
        assert kinds(record.with_channels({channel: np.round(record[channel] / step) * step})) == []


def resonant(n=8000):
    """Noise through a resonance of 25 samples a period."""
    rng, values = np.random.default_rng(5), np.zeros(n)
    push = rng.normal(size=n)
    for k in range(2, n):
        values[k] = 1.92 * values[k - 1] - 0.985 * values[k - 2] + push[k]
    return values


def test_a_code_of_missing_samples_is_no_limit():
    record = simulated(seed=3, noise=0.01)
    x = record["x"].copy()
    x[::9] = -999.0
    assert clipped_levels(x) == []
    x[::9] = -1.05 * np.abs(record["x"]).max()
    assert [one.which for one in clipped_levels(x)] == ["least"]


def test_single_clipped_samples_are_found_and_coarse_levels_are_not_clipped():
    values = resonant()
    limit = np.sort(np.abs(values))[-5]
    for step in (0.0, limit / 2**11):
        few = np.clip(np.round(values / step) * step if step else values, -limit, limit)
        found = clipped_levels(few)
        assert sum(one.samples for one in found) >= 5
        assert {abs(one.level) for one in found} == {limit}
        # at one end alone
        (top,) = clipped_levels(np.minimum(few, np.sort(few)[-8]))
        assert top.which == "greatest"
    waves = [np.sin(2 * np.pi * f * np.arange(8000) / 400) for f in (5.0, 5.013, 10.0, 0.5)]
    for whole in (values, *waves, *(wave + 1e-3 * values / values.std() for wave in waves)):
        for level in (0.0, 1e-4, 1e-3, 1 / 128, 1 / 30):
            size = level * np.abs(whole).max()
            assert clipped_levels(np.round(whole / size) * size if size else whole) == []


def test_what_stands_still_on_purpose_is_not_clipped_nor_lost():
    t = np.arange(2000) / 100
    square = np.where(np.sin(t) > 0, 1.0, -1.0)
    sine = np.round(np.sin(2 * np.pi * t), 2)  # an encoder of 200 steps, 20 periods of exactly 100 rows
    tap = np.where((t > 5) & (t < 5.1), np.sin(np.pi * (t - 5) / 0.1), 0.0)
    held = np.repeat(np.random.default_rng(0).normal(size=200), 10)
    record = bq.Record({"square": square, "sine": sine, "tap": tap, "held": held}, t)
    assert bq.check_record(record, [], ["square", "sine", "tap", "held"]) == []


@pytest.mark.parametrize(("step", "jitter"), [(0.0, 0.0), (2 * np.pi / 4096, 0.0), (2 * np.pi / 4096, 0.02)])
def test_what_is_held_before_its_release_is_not_clipped(step, jitter):
    # a pendulum held at its greatest angle for a tenth of the record; the encoder flickers at times
    t = np.arange(2000) / 100
    after = np.maximum(t - 2.0, 0.0)
    angle = 1.2 * np.exp(-0.05 * after) * np.cos(3 * after)
    if step:
        angle = np.round(angle / step - 0.3 - (np.random.default_rng(0).random(2000) < jitter)) * step
    for x in (angle, -angle, angle[::-1]):
        assert bq.check_record(bq.Record({"x": x}, t), ["x::"]) == []
    # and in a range that is too narrow it is clipped, whatever it began with
    forced = angle + 0.9 * np.sin(7 * t) * (t > 2)
    (finding,) = bq.check_record(bq.Record({"x": np.minimum(forced, 0.8 * forced.max())}, t), ["x::"])
    assert finding.kind == "clipping"


def test_samples_that_repeat_the_last_one():
    record = simulated()
    rng = np.random.default_rng(0)
    values = record["v"].copy()
    rows = np.sort(rng.choice(np.arange(10, 3990), 20, replace=False))
    values[rows] = values[rows - 1]
    (finding,) = bq.check_record(record.with_channels({"v": values}), CHAIN, ["u"])
    assert (finding.kind, finding.channels) == ("repeated", ("v",))
    assert 5 <= finding.value <= 20
    first = int(finding.message.split("first in row ")[1].split(":")[0])
    assert first - 1 in rows
    assert values[first - 1] == values[first - 2]


def test_steps_of_time_that_are_missing():
    record = simulated()
    kept = np.ones(4000, dtype=bool)
    kept[[100, 101, 2000]] = False
    (finding,) = bq.check_record(record.take(kept), CHAIN, ["u"])
    assert (finding.kind, finding.value) == ("dropped", 3.0)
    assert "2 of 3996 steps are multiples of 0.001 s, first after row 100" in finding.message
    # the rest is still compared
    reverse = record.with_channels({"v": -record["v"]}).take(kept)
    assert kinds(reverse) == [("dropped", "x"), ("sign", "v")]


# --- repairs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [0.37, -2.6, 3.0, 0.0])
def test_a_corrected_delay_is_gone(samples):
    record = late(simulated("linear", 1, noise=0.0), "v", samples)
    right = bq.correct_delay(record, "v", samples * 1e-3)
    assert right.units == record.units
    lost = int(np.ceil(abs(samples)))
    assert right.n == 4000 - lost
    rows = slice(0, 4000 - lost) if samples >= 0 else slice(lost, 4000)
    np.testing.assert_array_equal(right["x"], record["x"][rows])
    clean = record.truth.clean["v"][rows]
    # within 32 rows of an end the motion is continued by its mirror image
    np.testing.assert_allclose(right["v"][40:-40], clean[40:-40], atol=2e-4 * clean.std())
    np.testing.assert_allclose(right["v"], clean, atol=0.05 * clean.std())
    assert right.truth is not None


def test_the_estimate_corrects_the_delay():
    record = late(simulated("duffing", 4), "a", 2.4)
    (finding,) = bq.check_record(record, CHAIN, ["u"])
    assert bq.check_record(bq.correct_delay(record, "a", finding.value), CHAIN, ["u"]) == []


def test_what_cannot_be_repaired():
    record = simulated(n=300)
    with pytest.raises(UnknownNameError, match="'w'"):
        bq.correct_delay(record, "w", 0.1)
    with pytest.raises(RecordError, match="longer than the record"):
        bq.correct_delay(record, "v", 1.0)
    with pytest.raises(RecordError, match="even steps"):
        bq.correct_delay(record.take(np.arange(300) != 7), "v", 0.01)
    with pytest.raises(RecordError, match="even steps"):
        bq.correct_delay(bq.Record(record.channels), "v", 0.01)
    with pytest.raises(RecordError, match="NaN"):
        bq.correct_delay(record.with_channels({"v": np.full(300, np.nan)}), "v", 0.01)
    with pytest.raises(InputError, match="a delay must be a finite number"):
        bq.correct_delay(record, "v", float("nan"))
    with pytest.raises(InputError, match="an offset must be a finite number"):
        bq.remove_offset(record, "v", float("inf"))
    with pytest.raises(InputError, match="no channel named 'much'"):
        bq.remove_offset(record, "v", "much")
    with pytest.raises(RecordError, match="no time"):
        bq.remove_offset(bq.Record(record.channels), "v", 0.0, drift=1.0)


# --- in discover -----------------------------------------------------------------------------------------------------


def test_discover_warns_of_what_it_finds():
    record = simulated("linear", 2)
    wrong = record.with_channels({"v": 0.1 * record["v"].std() - record["v"]})
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        eq = bq.discover(wrong, chains=CHAIN, inputs=["u"], dictionary=["x", "v", "u"], smooth="none")
    messages = [str(w.message) for w in given if w.category is DataWarning]
    assert messages[:2] == [f.message for f in bq.check_record(wrong, CHAIN, ["u"])]
    assert [m.split()[0] for m in messages[:2]] == ["v", "v"]
    assert set(messages) <= set(eq.warnings)
    # the free run takes the sign into account: dx/dt = -v
    assert eq[0].unit_gains == (1.0, -1.0, 1.0)
    assert eq.verdict.kind == "not determined"
    assert "x and v contradict each other in sign" in eq.verdict.reason
    assert eq.scores.free_run["x"] < 0.2


def test_many_records_are_told_of_once():
    records = [simulated("linear", seed, n=1000).renamed(f"run{seed}") for seed in range(4)]
    wrong = [r.with_channels({"v": -r["v"]}) if k else r for k, r in enumerate(records)]
    (message,) = check_messages(wrong, [("x", "v", "a")], ["u"])
    assert message == "run1: v has the opposite sign of dx/dt: reverse it (--scale v=-1) (and 2 more records alike)"


def test_the_command_warns_and_goes_on(tmp_path, capsys):
    record = simulated("linear", 2)
    file = tmp_path / "wrong.csv"
    bq.write(record.with_channels({"a": record["a"] / 9.80665}), file)
    assert main(["discover", str(file), "--chain", "x:v:a", "--input", "u", "--smooth", "none"]) == 0
    err = capsys.readouterr().err
    assert "bayeq: warning: a is 0.1021 times d2x/dt2: that is about the factor between g and m/s^2" in err


# --- measured records ------------------------------------------------------------------------------------------------


def test_measured_records():
    # v and a of the air track were derived from x by filters: consistent, and no false alarm
    assert bq.check_record(bq.read(measured("schmidt_lipson/real_linear_a_1.txt")), CHAIN) == []
    # the filter of the double oscillator has taken a tenth to a fifth of its velocities
    double = bq.read(measured("schmidt_lipson/real_double_linear_h_1.txt"))
    found = bq.check_record(double, ["x1:v1:", "x2:v2:"])
    assert [(f.kind, f.channels[0]) for f in found] == [("gain", "v1"), ("gain", "v2")]
    # nothing at low frequencies and more than a quarter at the higher mode
    mode = np.exp(-2j * np.pi * 1.7 * double.time) * np.hanning(double.n)
    lost = abs(mode @ double["v1"]) / (2 * np.pi * 1.7 * abs(mode @ double["x1"]))
    assert lost < found[0].value < 1
