"""Free runs: the integrator, its inputs and steps, bands, blow-ups, initial states and scores."""

from __future__ import annotations

import math
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import bayeq as bq
from bayeq.errors import BayeqWarning, InputError, MissingExtraError, RecordError, UnknownNameError
from bayeq.expressions import Tape, parse
from bayeq.forecast.dynamics import finest_step, normal_draws
from bayeq.inference.posterior import Constant
from bayeq.numerics.rk4 import Drive, free_runs, interpolant
from tests.simulated import FS, coarse


@pytest.fixture(scope="module")
def record():
    return coarse("duffing", 600, 3, {"x": 0.02, "v": 0.02, "a": 0.02})


@pytest.fixture(scope="module")
def found(record):
    return bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", smooth="none")


@pytest.fixture(scope="module")
def lorenz():
    return bq.simulate("lorenz", n=2000, seed=0, noise=0.0)


@pytest.fixture(scope="module")
def flow(lorenz):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(lorenz, chains=["x", "y", "z"], dictionary="polynomial:2", smooth="none")


def law(eq, time, inputs=None):
    """Right-hand side for `solve_ivp`."""
    if inputs is None:
        return lambda t, s: eq.rhs(t, s)
    return lambda t, s: eq.rhs(t, s, inputs(t))


@pytest.mark.parametrize("kind", ["cubic", pytest.param("linear", marks=pytest.mark.slow)])
def test_the_free_run_agrees_with_an_adaptive_integrator(kind, record, found):
    first = {name: float(record[name][100]) for name in "xv"}
    run = found.simulate(record, draws=0, start=100, rows=100, interpolation=kind, initial=first)
    time, u = record.time[100:200], record["u"][100:200]
    # the spline knows what was before and comes after
    between = CubicSpline(record.time, record["u"]) if kind == "cubic" else lambda t: np.interp(t, time, u)
    start = [record["x"][100], record["v"][100]]
    twin = solve_ivp(
        law(found, time, between), time[[0, -1]], start, t_eval=time, rtol=1e-9, atol=1e-12, max_step=1 / FS
    )
    for name, theirs in zip("xv", twin.y, strict=True):
        np.testing.assert_allclose(run.mean[name], theirs, rtol=0, atol=1e-4 * theirs.std())


def test_equations_without_inputs_run_together(lorenz, flow):
    start = [lorenz[name][0] for name in "xyz"]
    run = flow.simulate(lorenz, draws=0, rows=150, initial=dict(zip("xyz", start, strict=True)))
    time = lorenz.time[:150]
    twin = solve_ivp(law(flow, time), time[[0, -1]], start, t_eval=time, rtol=1e-10, atol=1e-10)
    for name, theirs in zip("xyz", twin.y, strict=True):
        np.testing.assert_allclose(run.mean[name], theirs, rtol=0, atol=1e-3 * theirs.std())


def runs(chain, laws, start, time, share=1, enough=()):
    """Free run of x' = ... or x'' = ... as texts, without inputs, in steps of this share of an interval."""
    tape = Tape.compile([parse(text) for text in laws], chain)
    out = np.empty((1, len(time), len(chain)))
    wide = np.full(len(chain), np.inf)
    drive = Drive.over(time, np.empty((len(time), 0, 4)), -wide, wide)
    drive = drive._replace(step=drive.step / share, enough=np.array(enough, dtype=float))
    stopped = np.zeros(1, np.uint32)
    free_runs(tape.program(), drive, np.empty((1, 0)), np.array([start], dtype=float), stopped, out)
    return out[0]


def test_a_linear_oscillator_runs_as_its_solution_says():
    time = np.linspace(0.0, 3.0, 3001)
    damping, omega = 0.5, math.sqrt(40.0 - 0.25)
    exact = np.exp(-damping * time) * (np.cos(omega * time) + damping / omega * np.sin(omega * time))
    np.testing.assert_allclose(runs(["x", "v"], ["v", "-40*x-v"], [1.0, 0.0], time)[:, 0], exact, atol=1e-10)


def test_terms_that_jump():
    # dx/dt = -sign(x) reaches zero at t = 1 and stays there, to within a step
    time = np.linspace(0.0, 2.0, 201)
    x = runs(["x"], ["-sign(x)"], [1.0], time)[:, 0]
    np.testing.assert_allclose(x, np.maximum(1.0 - time, 0.0), atol=0.011)
    # Coulomb friction: each half swing loses 2 F/k of its height
    time = np.linspace(0.0, 3.0 * math.pi, 30_001)
    x = runs(["x", "v"], ["v", "-x-0.1*sign(v)"], [1.0, 0.0], time)[:, 0]
    np.testing.assert_allclose(x[[10_000, 20_000, 30_000]], [-0.8, 0.6, -0.4], atol=1e-3)


def test_short_steps_are_taken_only_near_jumps():
    time = np.linspace(0.0, 3.0 * math.pi, 301)
    friction = (["x", "v"], ["v", "-x-0.1*sign(v)"], [1.0, 0.0], time)
    short, mixed, coarse = runs(*friction, 16), runs(*friction, 16, [1e-7, 1e-7]), runs(*friction, 2)
    assert np.abs(mixed - short).max() < 1e-5 < 1e-4 < np.abs(coarse - short).max()
    # between jumps the steps are the long ones: twenty intervals of the first half swing
    np.testing.assert_array_equal(mixed[80:100], runs(*friction[:2], mixed[80], time[80:100], 2))
    assert not np.array_equal(mixed[80:100], runs(*friction[:2], mixed[80], time[80:100], 16))


def test_nothing_is_compiled_or_executed_for_an_equation(monkeypatch, record, found):
    found.simulate(record, draws=2, rows=20)
    compiled = len(free_runs.signatures)
    other = replace(found, equations=(replace(found[0], terms=tuple(parse(f"tanh({t})") for t in found[0].terms)),))

    def spy(*_, **__):
        raise AssertionError("text is executed")

    for name in ("exec", "eval", "compile"):
        monkeypatch.setattr(f"builtins.{name}", spy)
    run = other.simulate(record, draws=2, rows=20)
    assert np.isfinite(run.mean["x"]).all()
    assert len(free_runs.signatures) == compiled


def test_the_order_of_convergence_is_four():
    tape = Tape.compile([parse("v"), parse("u-2*v-40*x-9*x**3")], ["x", "v", "u"])
    time = np.linspace(0.0, 5.0, 60)
    inputs = interpolant(time, 30 * np.sin(3 * time)[:, None], "cubic")

    wide = np.full(2, np.inf)
    drive = Drive.over(time, inputs, -wide, wide)

    def run(step):
        out, stopped = np.empty((1, 60, 2)), np.zeros(1, np.uint32)
        start = np.array([[1.0, 0.0]])
        free_runs(tape.program(), drive._replace(step=step), np.empty((1, 0)), start, stopped, out)
        return out[0, :, 0]

    dt = time[1]
    exact = run(dt / 64)
    errors = [np.max(np.abs(run(dt / s) - exact)) for s in (1, 2, 4)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 3.6) & (orders < 4.6)), (errors, orders)


def test_inputs_between_their_samples():
    time = np.array([0.0, 0.5, 0.7, 1.5, 1.6])
    samples = np.array([1.0, -2.0, 0.0, 5.0, 4.0])
    at = np.array([0.1, 0.6, 1.4])
    row = np.searchsorted(time, at) - 1
    twins = {
        "cubic": CubicSpline(time, samples)(at),
        "linear": np.interp(at, time, samples),
        "hold": samples[row],
    }
    for kind, theirs in twins.items():
        p, q, r, s = interpolant(time, samples[:, None], kind)[row, 0].T
        w = (at - time[row]) / (time[row + 1] - time[row])
        np.testing.assert_allclose((1 - w) * p + w * q + w * (1 - w) * (r + w * s), theirs, rtol=1e-12)
    # after the last sample, and where there is but one
    assert interpolant(time, samples[:, None], "cubic")[-1, 0].tolist() == [4.0, 4.0, 0.0, 0.0]
    assert interpolant(time[:1], samples[:1, None], "cubic").tolist() == [[[1.0, 1.0, 0.0, 0.0]]]


def test_a_force_up_to_near_half_the_sampling_rate_is_interpolated():
    # 90 and 120 Hz at 400 Hz: a spline misses it by several per cent
    time, w = np.arange(400) / 400.0, 0.5

    def force(t):
        return np.sin(2 * np.pi * 120 * t + 0.3) + 0.5 * np.cos(2 * np.pi * 90 * t)

    missed = {}
    for kind in ("cubic", "band-limited"):
        p, q, r, s = interpolant(time, force(time)[:, None], kind)[:-1, 0].T
        between = (1 - w) * p + w * q + w * (1 - w) * (r + w * s)
        missed[kind] = np.abs(between - force(time[:-1] + w / 400.0))[40:-40].max()
    assert missed["band-limited"] < 0.01 < 0.05 < missed["cubic"]
    # uneven steps: a spline
    uneven = time + 1e-4 * np.sin(time)
    uneven[200:] += 1e-3
    both = [interpolant(uneven, force(time)[:, None], kind) for kind in ("cubic", "band-limited")]
    np.testing.assert_array_equal(*both)


def test_steps_follow_the_sampling(record, found):
    def step(rec):
        d = found.dynamics()
        states = np.column_stack([rec["x"], rec["v"]])
        wide = np.full(2, np.inf)
        return finest_step(d, d.mean, states, Drive.over(rec.time, np.zeros((rec.n, 1, 4)), -wide, wide))

    assert step(record) < 0.3 / FS
    fast = bq.simulate("duffing", seed=0, noise=0.0)
    assert step(fast) == pytest.approx(1e-3)


def test_the_same_seed_gives_the_same_bands(record, found):
    first, again = (found.simulate(record, draws=20, seed=5, rows=100) for _ in range(2))
    other = found.simulate(record, draws=20, seed=6, rows=100)
    for name in "xv":
        assert first.low[name].tobytes() == again.low[name].tobytes()
        assert first.high[name].tobytes() == again.high[name].tobytes()
        assert first.mean[name].tobytes() == other.mean[name].tobytes()
        assert not np.array_equal(first.low[name], other.low[name])
    without = found.simulate(record, draws=0, rows=100)
    assert without.draws == 0
    assert not without.low
    assert not without.high


@pytest.mark.parametrize("block", [None, 400])
def test_bands_are_order_statistics_of_single_runs(block, monkeypatch, record, found):
    if block is not None:
        monkeypatch.setattr("bayeq.forecast.free_run.BLOCK", block)
    first = {name: float(record[name][50]) for name in "xv"}
    run = found.simulate(record, draws=41, seed=2, start=50, rows=80, initial=first)
    drawn = found.dynamics().draw(41, np.random.default_rng(2))
    runs = []
    for theta in drawn:
        # an equation whose posterior mean is the draw
        p = found[0].posterior
        coef = p.coef.copy()
        coef[p.support] = theta[1:]
        one = replace(p, coef=coef, constant=replace(p.constant, mean=theta[0] + float(p.constant.center @ coef)))
        single = replace(found, equations=(found[0].with_posterior(one),))
        runs.append(single.simulate(record, draws=0, start=50, rows=80, initial=first).mean["x"])
    ordered = np.sort(runs, axis=0)
    # of 41 draws the second and the last but one: 2.5 % of 40 steps from one to the next
    np.testing.assert_allclose(run.low["x"], ordered[1], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(run.high["x"], ordered[39], rtol=1e-7, atol=1e-12)


def test_draws_have_the_moments_of_the_posterior(found):
    p = found[0].posterior
    drawn = found.dynamics().draw(200_000, np.random.default_rng(0))
    assert drawn[:, 0].std() == pytest.approx(p.intercept_sd, rel=0.01)
    np.testing.assert_allclose(drawn[:, 1:].std(axis=0), p.sd[p.support], rtol=0.01)
    # standard error of a mean of 200,000
    np.testing.assert_allclose(
        drawn.mean(axis=0), found.dynamics().mean, atol=5e-3 * drawn.std(axis=0).max(), rtol=1e-4
    )
    # the intercept plus center'theta is the mean of the target, which is independent of the coefficients
    level = drawn[:, 0] + drawn[:, 1:] @ p.constant.center[p.support]
    assert level.std() == pytest.approx(math.sqrt(p.noise_variance / p.n), rel=0.01)
    assert np.abs(np.corrcoef(level, drawn[:, 1:].T)[0, 1:]).max() < 0.01


def test_draws_of_what_is_not_determined_are_refused():
    with pytest.raises(InputError, match="covariance of coefficients is not finite"):
        normal_draws(np.zeros(2), np.array([[1.0, np.nan], [np.nan, 1.0]]), 10, np.random.default_rng(1))


def test_draws_of_badly_scaled_and_singular_covariances():
    sd = np.array([1e-9, 1.0, 1e9, 0.0])
    correlation = np.array([[1.0, 0.9, 0.0, 0.0], [0.9, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    drawn = normal_draws(np.zeros(4), correlation * np.outer(sd, sd), 50_000, np.random.default_rng(1))
    np.testing.assert_allclose(drawn.std(axis=0), sd, rtol=0.02)
    assert np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1] == pytest.approx(0.9, abs=0.01)


# --- blow-ups --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def explosive():
    """dx/dt = x**2, which reaches infinity at 1/x(0)."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 400)
    record = bq.Record.from_arrays(x=x, dx=x**2 + 0.01 * rng.normal(size=400), fs=100.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)  # the rows are no motion, which free runs tell
        eq = bq.discover(record, chains=["x:dx"], dictionary="polynomial:3", smooth="none")
    assert eq[0].included == ("x**2",)
    return eq, record


def test_a_run_that_blows_up_is_reported_and_stops(explosive):
    eq, record = explosive
    with np.errstate(all="raise"):
        run = eq.simulate(record, initial={"x": 1.0}, draws=50)
    assert run.blew_up_at == pytest.approx(1.0, abs=0.1)
    assert run.blown == 50
    reached = record.time < run.blew_up_at
    np.testing.assert_allclose(run.mean["x"][record.time < 0.7], 1 / (1 - record.time[record.time < 0.7]), rtol=0.05)
    assert np.isnan(run.mean["x"][~reached]).all()
    assert run.low["x"][-1] == -math.inf
    assert run.high["x"][-1] == math.inf
    assert run.nrmse["x"] == math.inf
    assert "blew up at" in str(run)
    assert run.plot().axes


def test_some_draws_may_blow_up(explosive):
    eq, _ = explosive
    # from zero it is the intercept, positive or negative, that decides; the run is long enough for either
    long = bq.Record.from_arrays(x=np.zeros(40_000), fs=2.0)
    run = eq.simulate(long, initial={"x": 0.0}, draws=100, seed=3)
    assert 2 < run.blown < 98
    assert run.high["x"][-1] == math.inf
    # a run that blew up may be anywhere
    assert run.low["x"][-1] == -math.inf
    assert np.isfinite(run.low["x"][:10]).all()


def test_no_range_is_needed_for_a_run_to_stop(explosive):
    eq, _ = explosive
    empty = bq.Record.from_arrays(q=np.zeros(300), fs=100.0)
    run = eq.simulate(empty, initial={"x": 2.0}, draws=3)
    assert run.blew_up_at == pytest.approx(0.5, abs=0.1)
    assert not run.nrmse


# --- initial states, rows, arguments ---------------------------------------------------------------------------------


def test_a_new_input_with_an_initial_state_of_its_own(found):
    time = np.arange(200) / FS
    u = 30 * np.sin(20 * time)
    run = found.simulate(bq.Record.from_arrays(u=u, time=time), initial={"x": 0.01, "v": -0.5}, draws=10)
    between = CubicSpline(time, u)
    twin = solve_ivp(law(found, time, between), time[[0, -1]], [0.01, -0.5], t_eval=time, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.mean["x"], twin.y[0], rtol=0, atol=1e-4 * twin.y[0].std())
    assert not run.nrmse
    assert not run.measured


def test_some_states_may_be_given_and_others_taken(record, found):
    run = found.simulate(record, initial={"v": 0.0}, draws=0, start=7, rows=5)
    assert run.mean["x"][0] == record["x"][7]
    assert run.mean["v"][0] == 0.0
    assert run.time.tolist() == record.time[7:12].tolist()


def test_estimated_states_are_taken_as_discover_estimates_them(record):
    shown = bq.Record.from_arrays(x=record["x"], u=record["u"], time=record.time)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = bq.discover(shown, chains=["x::"], inputs=["u"], dictionary=["x", "dx", "x**3", "u"], smooth="none")
    run = eq.simulate(shown, draws=0, start=20, rows=50)
    # looked for from the difference quotient
    read = np.gradient(record["x"], record.time)
    assert run.mean["dx"][0] == pytest.approx(read[20], abs=0.25 * read.std())
    assert list(run.nrmse) == ["x"]


def test_a_run_starts_where_it_follows_the_first_period_best():
    # exact equation and force, noisy states: the error at the start stays for good in a light oscillation
    rec = bq.simulate("linear", n=1500, noise={"x": 0.1, "v": 0.1}, seed=4)
    eq = bq.discover(rec, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "u"], smooth="none")
    truth = rec.truth.coefficients["a"]
    p = eq[0].posterior
    exact = replace(p, coef=np.array([truth[name] for name in p.names]), constant=Constant(np.zeros(3)))
    eq = replace(eq, equations=(eq[0].with_posterior(exact),))
    clean = rec.truth.clean["x"]
    read = {name: float(rec[name][0]) for name in "xv"}
    as_read, fitted = (eq.simulate(rec, draws=0, initial=first).mean["x"] - clean for first in (read, None))
    assert np.std(fitted) < 0.3 * np.std(as_read)
    assert np.std(fitted) < 0.02 * np.std(clean)


def test_a_start_that_cannot_be_fitted_is_the_one_read_off(record, found):
    # two rows, and a law that leaves every range at once
    short = record.slice(0, 2)
    run = found.simulate(short, draws=0, start=0, rows=2)
    assert run.mean["x"][0] == short["x"][0]


def test_samples_that_were_dropped_do_not_change_the_run(record, found):
    kept = np.flatnonzero(np.random.default_rng(0).random(record.n) > 0.1)
    run = found.simulate(record.take(kept), initial={"x": 0.0, "v": 0.0}, draws=0)
    # the force is what it was, but for its gaps
    whole = found.simulate(record, initial={"x": 0.0, "v": 0.0}, draws=0)
    difference = run.mean["x"] - whole.mean["x"][kept]
    assert np.sqrt(np.mean(difference**2)) < 0.15 * whole.mean["x"].std()
    assert len(run.time) == len(kept)


def test_errors_are_normalised_by_the_channel(record, found):
    run = found.simulate(record, draws=0)
    for name in "xv":
        error = run.mean[name] - record[name]
        assert run.nrmse[name] == pytest.approx(math.sqrt(np.mean(error**2)) / record[name].std())
    assert run.nrmse["x"] < 0.2
    assert "normalised RMS error" in str(run)


def test_missing_samples_are_not_judged(record, found):
    gaps = record["x"].copy()
    gaps[40:60] = np.nan
    run = found.simulate(record.with_channels({"x": gaps}), initial={"x": 0.0, "v": 0.0}, draws=0)
    assert math.isfinite(run.nrmse["x"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": 600}, "600 rows"),
        ({"start": -1}, "at least 0"),
        ({"rows": 1}, "at least 2"),
        ({"start": 599}, "2 rows or more"),
        ({"start": 500, "rows": 101}, "at most the 600"),
        ({"draws": -1}, "draws must be at least 0"),
        ({"draws": 1.5}, "whole number"),
        ({"initial": {"x": math.nan}}, "finite"),
        ({"interpolation": "spline"}, "cubic, linear, hold"),
    ],
)
def test_bad_arguments(arguments, message, record, found):
    with pytest.raises(InputError, match=message):
        found.simulate(record, **arguments)


def test_bad_records(record, found):
    with pytest.raises(UnknownNameError, match="state named 'w'"):
        found.simulate(record, initial={"w": 1.0})
    with pytest.raises(InputError, match="initial 'v' is not measured: give initial="):
        found.simulate(bq.Record.from_arrays(x=record["x"], u=record["u"], time=record.time))
    with pytest.raises(UnknownNameError, match="'u'"):
        found.simulate(bq.Record.from_arrays(x=record["x"], v=record["v"], time=record.time))
    with pytest.raises(RecordError, match="time column"):
        found.simulate(bq.Record.from_arrays(dict(record.channels)))
    force = record["u"].copy()
    force[5] = np.nan
    with pytest.raises(RecordError, match="NaN"):
        found.simulate(record.with_channels({"u": force}))


# --- scores and figures ----------------------------------------------------------------------------------------------


def test_scores_are_of_the_rows_held_out(record, found):
    scores = found.score(record)
    assert scores.rows == 120
    # the same rows and the same error as the fit's own judgement
    assert scores.one_step["a"] == pytest.approx(found[0].held_out.nrmse, rel=1e-6)
    assert scores.free_run == found.simulate(record, draws=0, start=480).nrmse
    assert found.score(record, start=10, rows=90).rows == 90
    assert "one step: a" in str(scores)


def test_scores_without_held_out_rows(record):
    eq = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", smooth="none", holdout=0.0)
    assert eq.scores is None
    assert eq.score(record) == eq.score(record, start=480)


def test_figure(record, found):
    run = found.simulate(record, draws=20)
    axes = run.plot().axes
    assert [ax.get_ylabel() for ax in axes] == ["x [m]", "residual", "v [m/s]", "residual"]
    assert axes[3].get_xlabel() == "time [s]"
    np.testing.assert_allclose(axes[1].lines[-1].get_ydata(), run.measured["x"] - run.mean["x"])
    # band, measured, run
    assert len(axes[0].collections) == 1
    assert len(axes[0].lines) == 2
    assert len(found.simulate(record, draws=0).plot().axes[0].collections) == 0


@pytest.mark.parametrize(("band", "top"), [(0.5, 1.15), (8.0, 1.15 * 8.0), (1000.0, 1.15 * 20.0)])
def test_the_panel_of_residuals_holds_the_band_unless_it_is_very_wide(band, top):
    time, size = np.arange(50.0), np.ones(50)
    low, high, measured = {"x": -band * size}, {"x": band * size}, {"x": (-1.0) ** time}
    run = bq.Forecast(time, {"x": 0.0 * size}, low, high, 1, 0, None, {}, measured, {})
    assert run.plot().axes[1].get_ylim() == pytest.approx((-top, top))


def test_figure_without_matplotlib(monkeypatch, record, found):
    run = found.simulate(record, draws=0, rows=10)
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[plot\]"):
        run.plot()


def test_the_speed_promised(found):
    # 1,000 steps per millisecond (perf/forecast.py measures 3,000); a tenth of it on a busy machine
    import time

    record = bq.simulate("duffing", n=100_000, seed=0)
    found.simulate(record, initial={"x": 0.0, "v": 0.0}, draws=0, rows=100)
    begin = time.perf_counter()
    found.simulate(record, initial={"x": 0.0, "v": 0.0}, draws=0)
    assert time.perf_counter() - begin < 1.0


def test_states_go_by_their_names(record, found):
    with pytest.raises(InputError, match=r"initial: states go by their names, initial="):
        found.simulate(record, initial=[0.0, 0.0])
    with pytest.raises(InputError, match=r"predict needs a Record .*, not str"):
        found.predict("run.csv")


def test_a_run_of_dry_friction_is_as_exact_as_its_law():
    """Against the exact solution of x'' = -x - c sign(x'): half circles about c and -c until it comes to rest."""
    c, t = 0.02, np.arange(600) * 0.1
    half, within = np.divmod(t, np.pi)
    x = (-1.0) ** half * ((1.0 - c - 2.0 * c * half) * np.cos(within) + c)
    v = -((-1.0) ** half) * (1.0 - c - 2.0 * c * half) * np.sin(within)
    record = bq.Record.from_arrays({"x": x, "v": v, "a": -x - c * np.sign(v)}, time=t)
    eq = bq.discover(record, chains="x:v:a", dictionary="x, sign(v)", smooth="none")
    run = eq.simulate(record, draws=0).mean["x"][:450]
    law = eq[0].shown_coef
    assert law["sign(v)"] == pytest.approx(-c, rel=1e-3)
    assert np.sqrt(np.mean((run - x[:450]) ** 2)) < 2e-4


def test_bands_count_the_noise_of_the_force_where_the_record_is_a_measurement():
    """By the coefficients alone they held the true motion at half of the rows."""

    def measured(seed, n=1200):
        clean = bq.simulate("duffing", n=n, fs=200.0, seed=seed, noise=0.0)
        rng = np.random.default_rng(seed)
        noisy = {name: clean[name] + 0.05 * clean[name].std() * rng.normal(size=clean.n) for name in "xvau"}
        return clean, bq.Record.from_arrays(noisy, time=clean.time)

    _, record = measured(31, 6000)
    eqs = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=["x", "v", "x**3", "u"])
    held = []
    for seed in range(32, 35):
        clean, record = measured(seed)
        run = eqs.simulate(record)
        held.append(np.mean((clean["x"] > run.low["x"]) & (clean["x"] < run.high["x"])))
        planned = eqs.simulate(
            bq.Record.from_arrays({"u": record["u"]}, time=clean.time),
            initial={"x": run.mean["x"][0], "v": run.mean["v"][0]},
        )
        assert np.mean(planned.high["x"] - planned.low["x"]) < 0.7 * np.mean(run.high["x"] - run.low["x"])
    assert np.mean(held) > 0.85
