"""Output error by the likelihood: least squares, recovery, honesty, files."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from studies.refinement import CASES, draw_record, measure_case, measure_record

import bayeq as bq
from bayeq.equation.refine import output_error as fitting
from bayeq.equation.refine import refine as refining
from bayeq.equation.refine.output_error import Known, _excess, output_error
from bayeq.errors import BayeqWarning, ConvergenceWarning, DataWarning, InputError, RecordError
from bayeq.forecast.free_run import typical_period, window_runs
from bayeq.forecast.rows import divided, rows_of
from bayeq.numerics.rk4 import Drive, interpolant, shoot
from bayeq.states import estimate_motion
from tests.data import measured
from tests.simulated import coarse

NOISE = {"x": 0.05, "v": 0.05, "a": 0.05}
TRUTH = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}


def discover(record, **arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(record, **arguments)


def duffing(record, **arguments):
    return discover(
        record,
        **{"chains": ["x:v:a"], "inputs": ["u"], "dictionary": ["x", "v", "x**3", "u"], "smooth": "none", **arguments},
    )


def with_coef(eq, coef):
    """Equations of which the first has other coefficients."""
    return replace(eq, equations=(eq[0].with_posterior(replace(eq[0].posterior, coef=coef)), *eq.equations[1:]))


@pytest.fixture(scope="module")
def record():
    return coarse("duffing", 600, 4, {"x": 0.02, "v": 0.02, "a": 0.02})


@pytest.fixture(scope="module")
def eq(record):
    return duffing(record)


# --- least squares ---------------------------------------------------------------------------------------------------


def test_the_minimum_is_that_of_a_general_solver(eq, record):
    few = record.slice(0, 240)
    dynamics, time = eq.dynamics([False]), few.time
    motion = estimate_motion([few], eq.roles)
    found = output_error(motion, dynamics, dynamics.mean, Known.of(dynamics, eq.known()), ["cubic"])
    assert found.converged
    assert found.excess == 1.0
    wide = np.full(2, 1e6)
    drive = Drive.over(time, interpolant(time, few["u"][:, None], "cubic"), -wide, wide)
    drive = drive._replace(step=1.0 / (8.0 * few.fs))
    sd = np.array(list(found.noise_sd.values()))
    measured = np.column_stack([few[name] for name in found.noise_sd])
    unit = np.append([sd[0], sd[1]], np.sqrt(np.diagonal(found.covariance)))

    def residuals(moved):
        both, values = moved * unit, np.empty((few.n, 3))
        channels = np.arange(3, dtype=np.uint32)
        shoot(dynamics.program(), drive, both[2:], both[:2], channels, values, np.empty((few.n, 3, 6)))
        return ((values - measured) / sd).ravel()

    start = np.concatenate([[few["x"][0], few["v"][0]], found.parameters]) / unit
    twin = least_squares(residuals, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.parameters / unit[2:], twin.x[2:], atol=0.03)
    spread = np.sqrt(np.diagonal(np.linalg.inv(twin.jac.T @ twin.jac)))[2:]
    np.testing.assert_allclose(spread, 1.0, rtol=0.03)


# --- whether the covariance holds -------------------------------------------------------------------------------------


@pytest.mark.parametrize("decaying", [False, True])
def test_independent_noise_passes_and_noise_with_a_memory_does_not(decaying):
    rng = np.random.default_rng(0)
    t = np.arange(800) / 50.0
    size = np.exp(-t / 4.0) if decaying else np.ones(800)  # has its information in its first rows
    J = (size[:, None] * np.column_stack([np.sin(t), np.cos(t), np.sin(0.4 * t)]))[:, None, :]

    def excess(noise):
        return _excess(J, (noise - J[:, 0] @ np.linalg.lstsq(J[:, 0], noise)[0])[:, None])

    independent = [excess(rng.normal(size=800)) for _ in range(500)]
    # at a level of 1 %; the share of 500 has a standard error of 0.45 %
    assert np.mean(np.array(independent) > 0) < 0.025
    correlated = []
    for _ in range(50):
        e = np.zeros(820)
        for i, shock in enumerate(rng.normal(size=819)):
            e[i + 1] = 0.8 * e[i] + shock
        correlated.append(excess(e[20:] * math.sqrt(1 - 0.8**2)))
    assert np.mean(np.array(correlated) > 0) == 1.0
    # (1 + 0.8)/(1 - 0.8) = 9, the ratio of variances of slow averages
    assert np.mean(correlated) == pytest.approx(9.0, rel=0.35)


@pytest.mark.slow  # of the third also below
@pytest.mark.parametrize("case", [3, 4])
def test_of_noise_in_the_force_what_runs_better_is_kept(case):
    # output error takes the force as exact: coefficients of it are worse, and are known to be less sure
    found, _ = draw_record("duffing", CASES[case], 0)
    names = ("x", "v", "a") if case == 3 else ("x",)
    seen = bq.Record.from_arrays({name: found[name] for name in (*names, "u")}, time=found.time)
    eq = discover(seen, chains=[CASES[case].chain], inputs=["u"])
    with pytest.warns(BayeqWarning) as caught:
        after = eq.refine(seen)
    if after is eq:
        assert "free runs over windows of the rows used would err by" in str(caught[0].message)
    else:
        assert any("correlated in time" in str(one.message) for one in caught)
    assert not refining.runs_are_worse(training_windows(eq, seen), training_windows(after, seen))


def test_errors_of_the_runs_themselves_are_no_forces():
    # without noise what is left comes from the interpolated input, correlated and a ten thousandth of the motion
    record = bq.simulate("duffing", n=2000, seed=0, noise=0.0)
    seen = bq.Record.from_arrays(x=record["x"], u=record["u"], time=record.time)
    eq = duffing(seen, chains=["x::"], dictionary=["x", "dx", "x**3", "u"])
    after = eq.refine(seen)
    for name, value in {**TRUTH, "dx": -2.0}.items():
        if name != "v":
            assert after[0].coef[name] == pytest.approx(value, rel=3e-4)
            sd = after[0].posterior.sd[list(after[0].posterior.names).index(name)]
            assert abs(after[0].coef[name] - value) < 4.0 * sd
    assert after.score(seen).free_run["x"] < 0.01 * eq.score(seen).free_run["x"]


# --- recovery --------------------------------------------------------------------------------------------------------


def test_truth_is_recovered_within_its_errors():
    z = []
    for seed in range(4):
        record = coarse("duffing", 500, seed, NOISE)
        eq = duffing(record).refine(record)
        found = eq[0]
        assert eq.refined.converged
        # all that the runs leave is the noise of each channel
        for name, sd in eq.refined.noise_sd.items():
            assert sd == pytest.approx(record.truth.noise_sd[name], rel=0.12)
        sd = dict(zip([t.text for t in found.terms], found.posterior.sd, strict=True))
        z += [(found.coef[name] - value) / sd[name] for name, value in TRUTH.items()]
    # 16 values of which 15 should lie within two standard deviations
    assert np.mean(np.square(z)) < 2.0
    assert np.sum(np.abs(z) > 1.96) <= 3


def test_chaotic_motion_is_followed_in_segments():
    whole = bq.simulate("lorenz", n=1000, seed=0, noise=0.03)
    record = bq.Record.from_arrays({name: whole[name] for name in "xyz"}, time=whole.time)
    eq = discover(record, chains=["x", "y", "z"], dictionary="x, y, z, x*y, x*z", holdout=0.0)
    after = eq.refine(record)
    assert after.refined is not None
    assert after["dy"].coef["x"] == pytest.approx(28.0, rel=0.01)
    for state, error in after.score(record).free_run.items():
        # the equations are those of the likelihood of the record already
        assert error < 1.1 * eq.score(record).free_run[state]


def test_inputs_are_interpolated_as_runs_follow_better():
    # corners between samples, where a spline overshoots
    time = np.arange(400) / 20.0
    u = np.repeat(np.random.default_rng(0).normal(size=100), 4)
    states = solve_ivp(
        lambda t, s: [s[1], -9.0 * s[0] - 0.4 * s[1] + np.interp(t, time, u)], (0, time[-1]), [0.0, 0.0],
        t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.05,
    ).y  # fmt: skip
    record = bq.Record.from_arrays(x=states[0], v=states[1], u=u, time=time)
    eq = discover(record, chains=["x:v:"], inputs=["u"], dictionary=["x", "v", "u"], smooth="none")
    after = eq.refine(record)
    assert after.refined.interpolation == "linear"
    assert after[0].coef["x"] == pytest.approx(-9.0, rel=1e-4)
    # a spline makes forces that there were not
    with pytest.warns(BayeqWarning, match="correlated in time|would err by"):
        eq.refine(record, interpolation="cubic")


def test_free_runs_come_closer_on_unseen_rows():
    # the likelihood of the record is as good before
    assert measure_record("duffing", CASES[0], 1)["after"] < 0.01
    # derivatives by differences have no chance at 10 to 20 samples per period
    naive = measure_record("linear", CASES[2], 0)
    assert naive["after"] < 0.05 * naive["before"]


def test_a_start_that_loses_its_way_is_led_back():
    # free decay over 100 periods: 1 % off in frequency is a period in the end
    time = np.arange(2000) / 100.0
    truth = solve_ivp(lambda t, s: [s[1], -1000.0 * s[0] - 0.2 * s[1]], (0, 20), [1.0, 0.0], t_eval=time, rtol=1e-9)
    rng = np.random.default_rng(0)
    x, v = truth.y
    a = -1000.0 * x - 0.2 * v
    record = bq.Record.from_arrays(
        x=x + 0.01 * rng.normal(size=2000),
        v=v + 0.3 * rng.normal(size=2000),
        a=a + 5 * rng.normal(size=2000),
        time=time,
    )
    eq = discover(record, chains=["x:v:a"], dictionary=["x", "v"], smooth="none")
    assert eq[0].included == ("x", "v")
    wrong = with_coef(eq, eq[0].posterior.coef * [0.98, 1.5])
    assert wrong.score(record).free_run["x"] > 0.5
    found = wrong.refine(record)
    assert found.refined.segments == 1
    assert found[0].coef["x"] == pytest.approx(-1000.0, rel=1e-4)
    assert found[0].coef["v"] == pytest.approx(-0.2, rel=0.05)


def test_several_records_and_dropped_samples():
    pieces = [coarse("duffing", 400, seed, NOISE) for seed in (10, 11)]
    kept = np.flatnonzero(np.random.default_rng(0).random(400) > 0.05)
    kept = np.union1d(kept, [0, 399])
    found = duffing(pieces, smooth="auto")
    eq = with_coef(found, 1.05 * found[0].posterior.coef)
    together = eq.refine(pieces)
    assert together.refined.n == 640
    with pytest.warns(DataWarning, match="gaps longer than half a period of a"):  # as discover says
        gaps = eq.refine([pieces[0], pieces[1].take(kept)])
    # the force in the gaps is that of a spline
    for name, value in together[0].coef.items():
        assert gaps[0].coef[name] == pytest.approx(value, rel=0.02)
        assert value == pytest.approx(TRUTH[name], rel=0.02)


def test_the_likelihood_is_not_replaced_by_what_chance_may_explain():
    """It allows for noise of the force, which drives the motion, and output error does not."""
    record = coarse("duffing", 600, 6, {"x": 0.02, "v": 0.02, "a": 0.02, "u": 0.03})
    found = duffing(record, smooth="auto")
    with pytest.warns(ConvergenceWarning, match="not refined: free runs over windows .* keep the equations"):
        assert found.refine(record) is found
    with pytest.warns(DataWarning, match="correlated in time"):
        assert with_coef(found, 1.05 * found[0].posterior.coef).refine(record).refined is not None


def test_rows_held_out_are_not_used():
    record = coarse("duffing", 600, 5, NOISE)
    eq = duffing(record)
    spoilt = {name: np.where(np.arange(600) < 480, record[name], 0.1 * record[name]) for name in ("x", "v", "a")}
    first, second = eq.refine(record), eq.refine(record.with_channels(spoilt))
    np.testing.assert_array_equal(first[0].posterior.coef, second[0].posterior.coef)
    assert first[0].held_out.nrmse != second[0].held_out.nrmse
    assert first.refined.n == 480
    assert eq.refine(record, holdout=0.0).refined.n == 600


# --- whether runs are better -----------------------------------------------------------------------------------------


def training_windows(eq, record):
    """Free runs over ten periods of the rows that are not held out."""
    dynamics = eq.dynamics()
    motion = estimate_motion([record], eq.roles, eq.smooth, 0.2)
    train, _ = divided(motion, rows_of(motion, "a test"))
    return window_runs(dynamics, train, 10.0 * typical_period(dynamics, train))


def test_runs_over_the_rows_used_do_not_get_worse():
    # 5 % noise on the force: refined coefficients once ran worse over 11 of 12 windows, by half in the median
    found, _ = draw_record("duffing", CASES[3], 11)
    seen = bq.Record.from_arrays({name: found[name] for name in "xvau"}, time=found.time)
    eq = discover(seen, chains=["x:v:a"], inputs=["u"], dictionary="x, v, x**2, x**3, x*v, v*abs(v), u")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        after = eq.refine(seen)
    assert not refining.runs_are_worse(training_windows(eq, seen), training_windows(after, seen))


def test_coefficients_whose_runs_are_worse_are_refused(eq, record, monkeypatch):
    assert eq.refine(record).refined is not None

    def spoilt(motion, dynamics, *more):
        found = output_error(motion, dynamics, *more)
        return replace(found, parameters=1.02 * found.parameters)

    monkeypatch.setattr(refining, "output_error", spoilt)
    message = r"not refined: free runs over windows of the rows used would err by [\d.]+ % instead of [\d.]+ %"
    with pytest.warns(ConvergenceWarning, match=message):
        assert eq.refine(record) is eq


def test_runs_that_are_worse_on_the_rows_held_out_are_reported():
    rng = np.random.default_rng(1)
    t = np.arange(400) / 50.0

    def decay(k):
        w = math.sqrt(k - 0.25)
        x = np.exp(-0.5 * t) * np.cos(w * t)
        v = -0.5 * x - w * np.exp(-0.5 * t) * np.sin(w * t)
        return {"x": x, "v": v, "a": -k * x - v}

    # stiffer from row 400 on, where 80 % of the rows end
    first, second = decay(100.0), decay(110.0)
    both = {name: np.concatenate([first[name], second[name][:100]]) for name in "xva"}
    noisy = {name: values + 0.02 * values.std() * rng.normal(size=500) for name, values in both.items()}
    record = bq.Record.from_arrays(noisy, time=np.arange(500) / 50.0)
    eq = discover(record, chains=["x:v:a"], dictionary=["x", "v"], smooth="none", tolerance=0)
    stiff = with_coef(eq, np.array([-110.0, -1.0]))
    with pytest.warns(ConvergenceWarning, match="over the rows held out err more") as caught:
        after = stiff.refine(record)
    assert after[0].coef["x"] == pytest.approx(-100.0, rel=0.01)
    assert after.warnings[-1] == str(caught[0].message)
    figures = [100.0 * one.score(record).free_run["x"] for one in (after, stiff)]
    assert f"x {figures[0]:.0f} %, v " in after.warnings[-1]
    assert f"before x {figures[1]:.2g} %, v " in after.warnings[-1]
    # with the coefficients of the rows used there is nothing to warn of
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert with_coef(eq, np.array([-100.0, -1.0])).refine(record).refined is not None


# --- what stays, and what is reported --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def refined():
    record = coarse("duffing", 600, 8, NOISE)
    before = discover(record, chains=["x:v:a"], inputs=["u"], smooth="none")
    return record, before, before.refine(record)


def test_selection_stays_and_coefficients_change(refined):
    _, before, after = refined
    assert after[0].included == before[0].included
    np.testing.assert_array_equal(after[0].posterior.pip, before[0].posterior.pip)
    assert after[0].runners_up == before[0].runners_up
    assert after[0].coef != before[0].coef
    assert before.refined is None
    assert "refined by output error: one run of up to 480 rows" in str(after)
    assert "refined" not in str(before)
    assert (after[0].ci95[after[0].posterior.support, 0] < after[0].ci95[after[0].posterior.support, 1]).all()


def test_an_intercept_that_does_not_matter_is_none(refined):
    _, before, after = refined
    assert not before[0].intercept_matters
    assert after[0].posterior.intercept == 0.0
    assert after[0].posterior.intercept_sd < 1e-60
    assert "none" in str(after)
    # the equation that is written is the one that runs
    assert after[0].evaluate({"x": 0.0, "v": 0.0, "u": 0.0}) == 0.0


def test_the_covariance_with_the_intercept_is_kept():
    record = coarse("duffing", 500, 8, NOISE)
    record = record.with_channels({"u": record["u"] - 20.0})  # a constant load that is not recorded
    eq = duffing(record)
    assert eq[0].intercept_matters
    after = eq.refine(record)
    p = after[0].posterior
    assert p.intercept == pytest.approx(20.0, abs=4 * p.intercept_sd)
    whole = after.dynamics().covariance
    assert whole[0, 0] == pytest.approx(p.intercept_sd**2)
    again = after.refine(record)
    np.testing.assert_allclose(again.dynamics().covariance / whole, 1.0, rtol=0.1)
    assert np.all(np.linalg.eigvalsh(whole / np.outer(*[np.sqrt(np.diagonal(whole))] * 2)) > 0)


def test_files_keep_the_refinement(refined, tmp_path):
    record, _, after = refined
    after.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again.refined == after.refined
    assert str(again) == str(after)
    np.testing.assert_array_equal(again[0].posterior.covariance, after[0].posterior.covariance)
    first, second = (eq.simulate(record, draws=5, rows=50) for eq in (after, again))
    np.testing.assert_array_equal(first.low["x"], second.low["x"])
    assert json.loads((tmp_path / "eq.json").read_text())["diagnostics"]["refined"]["segments"] == 1
    # files of earlier versions: with unseen forces, and from before there was any refinement
    content = json.loads((tmp_path / "eq.json").read_text())
    content["diagnostics"]["refined"]["unseen_sd"] = {"a": 0.5}
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert bq.load(tmp_path / "old.json").refined == after.refined
    del content["diagnostics"]["refined"]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert bq.load(tmp_path / "old.json").refined is None


def test_a_refined_equation_does_what_equations_do(refined):
    record, before, after = refined
    assert after.to_sympy().rhs != before.to_sympy().rhs
    assert after.predict(record).shape == (600,)
    assert len(after.table()) == 36
    assert after.to_dict()["diagnostics"]["refined"]["n"] == 480
    assert after[0].train.n == 480
    assert after[0].held_out.n == 120
    assert after[0].residuals.n == 480


def test_what_is_refined_already_hardly_changes(refined):
    record, _, after = refined
    again = after.refine(record)
    change = again[0].posterior.coef - after[0].posterior.coef
    assert np.abs(change[after[0].posterior.support] / after[0].posterior.sd[after[0].posterior.support]).max() < 0.02


def test_a_start_that_follows_nothing_is_returned(eq, record):
    absurd = with_coef(eq, -300.0 * eq[0].posterior.coef)
    with pytest.warns(ConvergenceWarning, match="no free run follows"):
        assert absurd.refine(record) is absurd


def test_a_limit_of_steps_is_reported(eq, record, monkeypatch):
    monkeypatch.setattr("bayeq.equation.refine.output_error.STEP", 0.0)
    with pytest.warns(ConvergenceWarning, match="did not converge"):
        after = eq.refine(record.slice(0, 200), holdout=0.0)
    assert not after.refined.converged
    assert "did not converge" in after.warnings[-1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"holdout": 1.0}, "holdout"),
        ({"interpolation": "zero"}, "cubic, linear, hold"),
    ],
)
def test_bad_arguments(arguments, message, eq, record):
    with pytest.raises(InputError, match=message):
        eq.refine(record, **arguments)


def test_bad_records(eq, record):
    with pytest.raises(InputError, match="Record"):
        eq.refine([])
    with pytest.raises(RecordError, match="time column"):
        eq.refine(bq.Record.from_arrays(dict(record.channels)))
    with pytest.raises(RecordError, match="5 rows are too few"):
        eq.refine(record.slice(0, 5))
    with pytest.raises(InputError, match="channel"):
        eq.refine(bq.Record.from_arrays(x=record["x"], time=record.time))
    p = eq[0].posterior
    nothing = replace(p, support=np.zeros_like(p.support), coef=0.0 * p.coef, covariance=np.empty((0, 0)))
    with pytest.raises(InputError, match="no terms to refine"):
        replace(eq, equations=(eq[0].with_posterior(nothing),)).refine(record)


# --- measured records ------------------------------------------------------------------------------------------------


def test_lynx_and_hare():
    """Rates within 20 % of Carpenter's posterior medians; differences alone are 15 to 20 % off."""
    path = measured("lynx_hare/hudson-bay-lynx-hare.csv")
    data = np.loadtxt(path, delimiter=",", skiprows=3)
    record = bq.Record.from_arrays(time=data[:, 0], L=data[:, 1], H=data[:, 2], name=path.name)
    eq = discover(record, chains=["H", "L"], dictionary="polynomial:2", smooth="none")
    assert (eq["dH"].included, eq["dL"].included) == (("H", "H*L"), ("L", "H*L"))
    found = eq.refine(record)
    published = {("dH", "H"): 0.55, ("dH", "H*L"): -0.028, ("dL", "L"): -0.80, ("dL", "H*L"): 0.024}
    for (target, term), rate in published.items():
        assert found[target].coef[term] == pytest.approx(rate, rel=0.2)
    assert found.simulate(record, draws=0).nrmse["H"] < 0.5 * eq.simulate(record, draws=0).nrmse["H"]


def test_a_measured_oscillator_whose_channels_are_correlated():
    # tracking errors with a memory: intervals of independent noise would be half as wide as they should be
    path = measured("schmidt_lipson/real_linear_a_1.txt")
    whole = bq.read(path)
    record = bq.Record.from_arrays({name: whole[name] for name in "xva"}, time=whole.time)
    eq = discover(record, chains=["x:v:a"], dictionary=["x", "v", "sign(v)"], tolerance=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        after = eq.refine(record)
    assert not refining.runs_are_worse(training_windows(eq, record), training_windows(after, record))
    # (2 pi / period)^2 from the zero crossings of x
    assert after[0].coef["x"] == pytest.approx(-6.222, rel=2e-3)


# --- the study -------------------------------------------------------------------------------------------------------


def test_records_of_the_study():
    record, truth = draw_record("duffing", CASES[0], 3)
    natural = math.sqrt(1000.0) / (2 * math.pi)
    assert 10.0 <= record.fs / natural <= 20.0
    assert record.n == 1000
    assert truth == {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
    spectrum = np.abs(np.fft.rfft(record["u"])) ** 2
    above = np.fft.rfftfreq(1000, 1 / record.fs) > 1.02 * record.fs / 4
    assert spectrum[above].sum() < 1e-3 * spectrum.sum()
    assert record["x"].std() > 0
    assert record.truth.noise_sd["u"] == 0.0


def test_lines_of_the_study():
    def line(before, after, **more):
        shared = {"before_measured": 0.1, "after_measured": 0.1, "exact": 1.0, "refined": 1.0, "seconds": 1.0}
        return {**shared, "before": before, "after": after, "terms": 4, "covered": 3, **more}

    lines = [line(0.2, 0.1), line(0.2, 0.1), line(0.2, 0.4), line(math.inf, 0.1), line(0.2, 0.2, refined=0.0)]
    table = measure_case("both", CASES[0], lines, 6)
    assert (table["records"], table["equations"], table["refined"]) == (6, 5, 4)
    assert table["median_ratio"] == "0.500"
    assert table["worse"] == "0.200"
    assert table["error_regression"] == "0.2"
    assert table["coverage"] == "0.750"


def test_coefficients_are_averaged_over_courses_of_the_inputs(monkeypatch):
    def of_course(motion, dynamics, parameters, known, kind):
        value, log = {"cubic": (1.0, -10.0), "linear": (9.0, -60.0), "band-limited": (2.0, -10.0 + math.log(3.0))}[kind]
        empty = np.zeros(0)
        return fitting.OutputError(
            np.array([value]), np.array([[0.01]]), empty, 1.0, empty, False, {}, {}, kind, True, log
        )

    monkeypatch.setattr(fitting, "_of_course", of_course)
    found = output_error(None, None, np.zeros(1), None, ["cubic", "linear", "band-limited"])
    assert found.interpolation == "band-limited"
    assert found.parameters[0] == pytest.approx(0.25 * 1.0 + 0.75 * 2.0)
    assert found.covariance[0, 0] == pytest.approx(0.01 + 0.25 * 0.75 * 1.0)
