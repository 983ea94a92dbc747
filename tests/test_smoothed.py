"""Smoothed states, and the band that the PySINDy plug-in fits."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.adapters.pysindy.series import Band, band_gram, taper, to_band
from bayeq.errors import DataWarning
from bayeq.records.repair import split_at_gaps
from bayeq.states import Roles, estimate_motion, parse_chains
from bayeq.states.kinematic.chain_smoother import smooth_chain
from bayeq.states.prepare import on_grid

CHAIN = parse_chains(["x:v:a"])
ROLES = Roles(tuple(CHAIN), ("u",))


def white(seed, n=2000, P=3):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, P)) + 1.0, rng


def test_a_whole_band_without_a_taper_is_the_gram_of_the_rows(monkeypatch):
    # Parseval's theorem: sums of products over rows are sums over bins
    monkeypatch.setattr("bayeq.adapters.pysindy.series.taper", lambda n, memory: np.ones(n))
    D, rng = white(0, n=501)
    y = D @ [1.0, -2.0, 0.0] + rng.normal(size=501)
    ours = band_gram([to_band(D, y, 1e9)], [np.ones(251)])
    np.testing.assert_allclose(ours.DtD, D.T @ D, rtol=1e-9)
    np.testing.assert_allclose(ours.Dty, D.T @ y, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal([*ours.mean, ours.target_mean], 0.0)
    assert ours.yty == pytest.approx(y @ y, rel=1e-9)
    assert ours.n == ours.dof == pytest.approx(501)


def test_the_taper_is_smooth_and_whole_in_the_middle():
    window = taper(4000)
    assert window[0] == window[-1] == 0.0
    assert (window[100:-100] == 1.0).all()
    np.testing.assert_allclose(window, window[::-1])


def test_noise_in_states_is_cut_and_derivatives_agree():
    rec = bq.simulate("duffing", n=4000, seed=2, noise=0.05)
    (states,), smoothing = smooth_chain([rec], CHAIN[0])
    for k, name in enumerate(("x", "v")):
        clean = rec.truth.clean[name]
        raw, ours = (np.sqrt(np.mean((z - clean) ** 2)) for z in (rec[name], states[:, k]))
        assert ours < 0.2 * raw  # a prototype: 0.11 to 0.16
    # the smoothed velocity is the derivative of the smoothed displacement
    slope = np.gradient(states[:, 0], rec.time)
    assert np.std((slope - states[:, 1])[5:-5]) < 0.01 * np.std(states[:, 1])
    for k, name in enumerate(("x", "v")):
        assert smoothing.model.noise_sd[k] == pytest.approx(0.05 * rec.truth.clean[name].std(), rel=0.05)
    assert 60.0 < smoothing.band[1] < 300.0  # the force's band is 0-100 Hz
    gain = smoothing.gain(np.array([1.0, 20.0, 400.0]))
    assert gain[0] > 0.999
    assert gain[1] > 0.99
    assert gain[2] < 0.1


@pytest.mark.parametrize("factors", [(1e3, 1.0, 1.0), (1.0, 1.0, 1 / 9.80665), (1.0, -1.0, 1.0), (1.0, 57.3, 57.3)])
def test_units_that_do_not_belong_together_are_put_right_within_the_smoother(factors):
    rec = bq.simulate("duffing", n=2000, seed=2, noise=0.02)
    scaled = rec.with_channels({name: rec[name] * f for name, f in zip("xva", factors, strict=True)})
    (plain,), _ = smooth_chain([rec], CHAIN[0])
    (ours,), smoothing = smooth_chain([scaled], CHAIN[0])
    np.testing.assert_allclose(
        (ours / np.array(factors))[:, :2], plain[:, :2], atol=0.01 * np.abs(plain[:, :2]).max(axis=0).max()
    )
    for k, name in enumerate(("x", "v")):
        assert smoothing.model.noise_sd[k] * abs(smoothing.unit_gains[k]) < 0.03 * scaled[name].std()


def test_rows_held_out_do_not_touch_the_others():
    rec = bq.simulate("duffing", n=2000, seed=2, noise=0.05)
    spoiled = rec.with_channels({"x": np.where(np.arange(2000) < 1500, rec["x"], 0.1 * rec["x"])})
    a, b = (estimate_motion([r], ROLES, share=0.25).records[0] for r in (rec, spoiled))
    for name in ("x", "v", "a"):
        np.testing.assert_array_equal(a.columns[name][:1500], b.columns[name][:1500])
        assert not np.array_equal(a.columns[name][1500:], b.columns[name][1500:])


def test_a_band_counts_real_numbers():
    band = to_band(np.ones((100, 1)), np.ones(100), 0.2)
    assert isinstance(band, Band)
    assert band.frequency[-1] <= 0.2
    assert band.count.sum() == 2 * len(band.count) - 1


@pytest.mark.filterwarnings("ignore:.* samples are missing:bayeq.errors.DataWarning")
def test_dropped_samples_are_put_back_on_their_grid():
    rec = bq.simulate("duffing", n=3000, seed=2, noise=0.03)
    kept = np.sort(np.random.default_rng(0).choice(3000, 2700, replace=False))
    kept[[0, -1]] = 0, 2999
    gappy = rec.take(kept)
    (states,) = estimate_motion([gappy], ROLES).records
    assert states.n == 3000
    assert states.known.sum() == 2700
    missing = np.setdiff1d(np.arange(3000), kept)
    for name in ("x", "v"):
        clean = rec.truth.clean[name]
        assert np.std((states.columns[name] - clean)[missing]) < 0.02 * np.std(clean)
    np.testing.assert_array_equal(states.columns["u"][kept], gappy["u"])
    asked = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "holdout": 0.0}
    eq = bq.discover(gappy.slice(0, 900), **asked, dictionary="x, v, x**3, u, x**2, x*v, v*abs(v)")
    assert set(eq[0].included) == {"x", "v", "x**3", "u"}


def test_a_record_without_a_grid_is_left_as_it_is():
    rec = bq.simulate("duffing", n=500, seed=2)
    times = np.cumsum(np.random.default_rng(0).uniform(0.5e-3, 1.5e-3, 500))
    irregular = bq.Record.from_arrays(dict(rec.channels), time=times)
    assert on_grid(irregular, ["x", "v", "a", "u"]) is irregular
    assert on_grid(rec, ["x", "v", "a", "u"]) is rec


@pytest.mark.parametrize(("fs", "decimals"), [(30.0, 3), (29.97, 3), (120.0, 3), (1000.0 / 3.0, 4), (0.3, 0)])
def test_rounded_times_become_even_again(fs, decimals):
    n = 700
    exact = 12.3 + np.arange(n) / fs
    wave = np.sin(exact * fs / 20)
    rec = bq.Record.from_arrays(time=np.round(exact, decimals), x=wave)
    even = on_grid(rec, ["x"])
    if decimals == 0:
        # whole seconds: not taken for rounded ones
        assert even is rec
        return
    assert even.is_uniform()
    # the mean of n rounding errors, uniform within one unit
    np.testing.assert_allclose(even.time, exact, atol=6 * 10.0**-decimals / np.sqrt(12 * n))
    kept = np.delete(np.arange(n), [5, 6, 100, 333])
    gappy = on_grid(rec.take(kept), ["x"])
    assert gappy.n == n
    np.testing.assert_allclose(gappy.time, exact, atol=8 * 10.0**-decimals / np.sqrt(12 * n))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(gappy["x"])), [5, 6, 100, 333])


def test_times_uneven_by_more_than_their_rounding_stay():
    rng = np.random.default_rng(3)
    jittered = np.round(np.arange(500) / 30.0 + 4e-3 * rng.uniform(-1, 1, 500), 6)
    rec = bq.Record.from_arrays(time=jittered, x=np.sin(jittered))
    assert on_grid(rec, ["x"]) is rec
    # the likelihood takes each step as long as it is
    x = np.sin(9 * jittered) + 0.02 * rng.normal(size=500)
    found = bq.Record.from_arrays(time=jittered, x=x)
    eq = bq.discover(found, chains="x::", dictionary=["x", "dx", "x**3"], holdout=0.0)
    assert eq[0].shown == ("x",)
    assert eq[0].shown_coef["x"] == pytest.approx(-81.0, rel=1e-3)


@pytest.mark.parametrize("written", ["%.6g", "float32", "jitter"])
def test_times_that_are_nearly_even_are_taken_as_even(written):
    exact = 1000.0 + np.arange(900) / 30.0
    if written == "jitter":
        time = exact + 1e-3 * np.random.default_rng(0).uniform(-1, 1, 900)
    else:
        time = (
            exact.astype(np.float32).astype(float)
            if written == "float32"
            else np.array([float(f"{t:.6g}") for t in exact])
        )
    rec = bq.Record.from_arrays(time=time, x=np.sin(exact))
    even = on_grid(rec, ["x"])
    assert even.is_uniform()
    np.testing.assert_allclose(even.time, exact, atol=2e-3)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize("decimals", [None, 3])
def test_a_gap_that_cannot_be_bridged_divides_the_record(decimals):
    # free decay of period 1.57 s with 2.7 s missing
    rng = np.random.default_rng(2)
    t = np.arange(1000) / 30.0
    x = np.cos(4 * t) * np.exp(-0.06 * t) + 0.005 * rng.standard_normal(1000)
    kept = np.r_[0:400, 480:1000]
    time = t if decimals is None else np.round(t, decimals)
    eq = bq.discover(bq.Record.from_arrays(time=time[kept], x=x[kept]), chains="x::")
    assert eq[0].included == ("x", "dx")
    # x'' = -(16 + 0.06^2) x - 0.12 x'
    assert eq[0].coef["x"] == pytest.approx(-16.0036, rel=1e-3)
    assert eq[0].coef["dx"] == pytest.approx(-0.12, rel=0.03)
    (message,) = [m for m in eq.warnings if "gaps" in m]
    assert message.endswith(" s), first after row 400: taken as 2 pieces")
    half_period = float(message.removeprefix("gaps longer than half a period of x (").split()[0])
    assert half_period == pytest.approx(np.pi / 4, rel=0.2)


def test_pieces_between_gaps():
    t = np.arange(600) / 30.0
    rec = bq.Record.from_arrays(time=t, x=np.cos(4 * t), name="r")
    kept = np.r_[0:200, 205:300, 360:380, 440:600]
    pieces, messages = split_at_gaps([rec.take(kept)], ["x"])
    # five rows are bridged; twenty alone are too few
    assert [piece.n for piece in pieces] == [295, 160]
    assert messages[0].endswith("2 pieces; 20 rows unused")
    assert split_at_gaps([rec], ["x"]) == ([rec], [])
    without = bq.Record.from_arrays(x=rec["x"])
    assert split_at_gaps([without], ["x"]) == ([without], [])


@pytest.mark.parametrize("n", [40, 501, 3000])
def test_follow_is_the_gain_at_each_frequency(n):
    smoothing = estimate_motion([bq.simulate("duffing", seed=1)], ROLES).smoothing[0]
    t = np.arange(n) / smoothing.fs
    for f in (0.0, 10.0, 80.0, 200.0):
        wave = np.column_stack([np.cos(2 * np.pi * f * t), np.ones(n)])
        shown = smoothing.follow(wave)
        inner = slice(n // 4, -n // 4)
        expected = smoothing.gain(np.array([f]))[0] if f else 1.0
        np.testing.assert_allclose(shown[inner, 0], expected * wave[inner, 0], atol=0.02)
        np.testing.assert_allclose(shown[:, 1], 1.0)


def test_an_equation_of_displacement_and_force_explains_its_target():
    # against the force as measured it would explain 13 %, and the residuals would follow the force
    few = "x, dx, x**2, x**3, x*dx, dx*abs(dx), u"
    eq = bq.discover(bq.simulate("duffing", n=2000, seed=1), chains="x::", inputs=["u"], dictionary=few)
    assert eq[0].train.r2 > 0.97
    assert eq[0].held_out.r2 > 0.9
    assert eq.warnings == ()
    assert eq.scores.one_step["ddx"] < 0.3


@pytest.mark.parametrize("noise", [*(pytest.param(one, marks=pytest.mark.slow) for one in (0.0, 0.001)), 0.01])
def test_lorenz_from_states_alone(noise):
    rng = np.random.default_rng(1)
    t = 0.01 * np.arange(2000)
    states = [np.array([1.0, 3.0, 20.0])]
    for _ in range(len(t) - 1):
        states.append(_lorenz_step(states[-1], 0.01))
    clean = np.array(states)
    measured = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
    rec = bq.Record.from_arrays(time=t, x=measured[:, 0], y=measured[:, 1], z=measured[:, 2])
    eq = bq.discover(rec.slice(0, 1000), chains=["x", "y", "z"], dictionary="polynomial:2", holdout=0.0)
    assert [set(one.included) for one in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]


def _lorenz_step(s, h):
    """Ten steps of RK4 in h."""

    def rate(s):
        x, y, z = s
        return np.array([10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z])

    h /= 10
    for _ in range(10):
        k1 = rate(s)
        k2 = rate(s + h / 2 * k1)
        k3 = rate(s + h / 2 * k2)
        k4 = rate(s + h * k3)
        s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return s


def test_dropped_rows_of_states_taken_as_measured():
    rec = bq.simulate("duffing", n=800, noise=0.001, seed=3)
    kept = np.delete(np.arange(800), [100, 101, 400, 650])
    few = "x, v, x**2, x**3, v*abs(v), u"
    with pytest.warns(DataWarning, match="samples are missing"):
        eq = bq.discover(rec.take(kept), chains="x:v:a", inputs=["u"], dictionary=few)
    assert set(eq[0].included) == {"x", "v", "x**3", "u"}
    assert eq.scores.free_run["x"] < 0.05
