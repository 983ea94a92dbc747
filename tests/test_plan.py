"""Plans of a next measurement: information, limits, ranking, and what is kept for them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.equation.plan.designs import EXCITATIONS, Measured, conditions_of
from bayeq.equation.plan.information import (
    CandidateModel,
    coefficient_gain,
    seconds_to_halve,
    seconds_until,
    unexplained,
)
from bayeq.equation.plan.plan import noise_of_intervals, plan_excitation
from bayeq.errors import DataWarning, InputError
from bayeq.expressions import Evaluator, parse
from bayeq.inference.posterior import Constant, Details, Posterior
from bayeq.states import Chain, parse_chain
from tests.draws import draws

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


@dataclass
class Given:
    """An equation as a plan sees it: models by {term: coefficient}, the likeliest first, and their probabilities."""

    laws: tuple[dict[str, float], ...]
    chances: tuple[float, ...]
    chain: Chain = field(default_factory=lambda: parse_chain("x:v:a"))
    intercept: float = 0.0
    covariance: np.ndarray | None = None
    unit_gains: tuple[float, ...] = ()
    units: dict[str, str] = field(default_factory=dict)

    @property
    def names(self):
        return tuple(dict.fromkeys(name for law in self.laws for name in law))

    @property
    def target(self):
        return self.chain.target

    @property
    def terms(self):
        return tuple(parse(name) for name in self.names)

    @property
    def models(self):
        places = {name: j for j, name in enumerate(self.names)}
        return tuple(
            CandidateModel(chance, tuple(places[name] for name in law), tuple(law.values()), self.intercept)
            for law, chance in zip(self.laws, self.chances, strict=True)
        )

    @property
    def shown_posterior(self):
        p = len(self.names)
        blank = Posterior(
            names=self.names, pip=np.zeros(p), support=np.zeros(p, dtype=np.bool_), coef=np.zeros(p),
            covariance=np.zeros((0, 0)), constant=Constant(np.zeros(p)), noise_variance=1.0, n=100,
            details=Details("bma"),
        )  # fmt: skip
        found = self.models[0].posterior(blank)
        return found if self.covariance is None else replace(found, covariance=self.covariance)


LINEAR = {"x": -400.0, "v": -2.0, "u": 1.0}
CUBIC = {**LINEAR, "x**3": -2e4}
NOISE = 0.5


def conditions(*equations, inputs=("u",), ranges=None, **options):
    states = [name for equation in equations for name in equation.chain.states]
    given = {
        "amplitude": 1.0, "band": (1.0, 10.0), "seconds": 2.0, "fs": 100.0, "given_noise": {}, "limits": {}, **options
    }  # fmt: skip
    measured = Measured(ranges=ranges or {})
    return conditions_of(measured, states, inputs, {e.target: NOISE for e in equations}, **given)


def plan(*equations, odds=100.0, realisations=2, seed=0, inputs=("u",), **options):
    return plan_excitation(
        equations, inputs, conditions(*equations, inputs=inputs, **options), odds=odds, realisations=realisations,
        seed=seed, progress=lambda *_: None,
    )  # fmt: skip


def by_design(found):
    return {(o.design.kind, o.design.band, round(o.amplitudes["u"], 9)): o for o in found.outcomes}


# --- information


def test_what_a_rival_cannot_imitate_is_the_residual_of_least_squares():
    rng = np.random.default_rng(1)
    D, y = rng.normal(size=(60, 3)) * [1.0, 1e4, 1e-3] + [5.0, 0.0, 1.0], rng.normal(size=60)
    with_constant = np.column_stack([np.ones(60), D])
    rest = y - with_constant @ np.linalg.lstsq(with_constant, y, rcond=None)[0]
    assert unexplained(y, D) == pytest.approx(rest @ rest, rel=1e-10)
    # a copy, a constant column and none
    assert unexplained(y, np.column_stack([D, D[:, 0], np.ones(60)])) == pytest.approx(rest @ rest, rel=1e-8)
    assert unexplained(y, D[:, :0]) == pytest.approx(60 * y.var(), rel=1e-12)


@pytest.mark.parametrize(
    ("true", "other"), [(CUBIC, LINEAR), (LINEAR, CUBIC), (CUBIC, {"x": 1, "x*abs(x)": 1, "u": 1})]
)
def test_the_expected_log_bayes_factor_is_the_mean_over_noise(true, other):
    """Of 2000 noisy targets of one motion, both models fitted; the maximised likelihoods by NumPy's lstsq."""
    rng = np.random.default_rng(2)
    n, noise = 300, 0.3
    columns = {"x": rng.normal(size=n), "v": rng.normal(size=n), "u": rng.normal(size=n)}
    cubic = 0.05
    values = columns | {"x**3": columns["x"] ** 3, "x*abs(x)": columns["x"] * np.abs(columns["x"])}
    D = np.column_stack([values[name] for name in true])
    E = np.column_stack([values[name] for name in other])
    y = D @ np.array([cubic if name == "x**3" else 1.0 for name in true])

    def rss(columns, targets):
        full = np.column_stack([np.ones(n), columns])
        rest = targets - full @ np.linalg.lstsq(full, targets, rcond=None)[0]
        return (rest**2).sum(axis=0)

    targets = y[:, None] + noise * rng.normal(size=(n, 2000))
    log_bf = (rss(E, targets) - rss(D, targets)) / (2 * noise**2) + 0.5 * (len(other) - len(true)) * math.log(n)
    expected = unexplained(y, E) / (2 * noise**2) + 0.5 * (len(other) - len(true)) * (math.log(n) - 1)
    assert log_bf.mean() == pytest.approx(expected, abs=4 * log_bf.std() / math.sqrt(2000))


@settings(max_examples=draws(100), deadline=None)
@given(needed=st.floats(-5, 50), rate=st.floats(0.001, 100), occam=st.integers(-5, 5), fs=st.sampled_from([1.0, 100.0]))
def test_the_time_is_the_one_from_which_on_enough_is_known(needed, rate, occam, fs):
    def value(t):
        return rate * t + 0.5 * occam * (math.log(fs * t) - 1)

    t = seconds_until(needed, rate, occam, fs)
    for later in (1.0, 1.1, 2.0, 100.0):
        if t > 0:
            assert value(later * t) >= needed - 1e-9 * max(1.0, abs(needed))
    if t > 1.001 / fs and not (occam < 0 and t <= -0.5 * occam / rate * 1.001):
        assert value(0.999 * t) < needed


def test_a_model_that_contains_the_true_one_is_told_by_its_size_alone():
    # by hand: (ln n - 1)/2 = ln 100
    assert seconds_until(math.log(100), 0.0, 1, 1000.0) == pytest.approx(math.e * 1e4 / 1000.0)
    assert seconds_until(math.log(100), 0.0, -1, 1000.0) == math.inf
    assert seconds_until(-1.0, 0.0, 0, 1000.0) == 0.0


def test_the_gain_of_coefficients_is_the_log_determinant():
    rng = np.random.default_rng(3)
    D = rng.normal(size=(50, 3)) * [1.0, 1e3, 1e-2] + 2.0
    A = rng.normal(size=(3, 3))
    prior = A @ A.T * np.outer([1.0, 1e-3, 1e2], [1.0, 1e-3, 1e2])
    F = np.cov(D.T) * 49 / 0.2
    gains = coefficient_gain(D, prior, 0.2)
    assert np.log1p(gains).sum() == pytest.approx(np.linalg.slogdet(np.eye(3) + prior @ F)[1], rel=1e-8)
    t = seconds_to_halve(gains, 10.0)
    # after that time the determinant of the covariance is 4**-3 of what it was
    assert np.linalg.slogdet(np.eye(3) + prior @ F * t / 10.0)[1] == pytest.approx(3 * math.log(4), rel=1e-8)
    assert seconds_to_halve(np.zeros(2), 1.0) == math.inf
    assert len(coefficient_gain(D[:, :0], np.zeros((0, 0)), 1.0)) == 0


# --- plans


def test_information_on_a_cube_grows_with_the_sixth_power_of_small_amplitudes():
    # at 1 N the cube is 2 % of the spring's force at most, at 0.5 N a quarter of that
    found = by_design(plan(Given((CUBIC, LINEAR), (0.6, 0.4)), amplitude=0.02))
    for kind in EXCITATIONS:
        assert found[kind, (1.0, 10.0), 0.02].rate / found[kind, (1.0, 10.0), 0.01].rate == pytest.approx(64, rel=0.01)


def test_the_rate_is_that_of_the_simulated_motion():
    """Twin by `scipy.integrate.solve_ivp` and `lstsq`, of the best excitation as it is written."""
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicSpline

    found = plan(Given((CUBIC, LINEAR), (0.6, 0.4)), realisations=2, amplitude=1.0)
    force = CubicSpline(found.time, found.inputs["u"])
    best = found.best
    seen = {}
    for name, law in (("cubic", CUBIC), ("linear", LINEAR)):
        k3 = law.get("x**3", 0.0)

        def slope(t, s, k3=k3):
            return [s[1], -400 * s[0] - 2 * s[1] + k3 * s[0] ** 3 + force(t)]

        x, v = solve_ivp(slope, (0, found.time[-1]), [0, 0], t_eval=found.time, rtol=1e-9, atol=1e-12).y
        y = -400 * x - 2 * v + k3 * x**3 + found.inputs["u"]
        other = np.column_stack([np.ones_like(x), x, v, found.inputs["u"], *([] if k3 else [x**3])])
        rest = y - other @ np.linalg.lstsq(other, y, rcond=None)[0]
        seen[name] = rest @ rest / (2 * NOISE**2) / 2.0
    assert seen["linear"] < 1e-12
    # the mean of two realisations whose sd is known: the first is one sd / sqrt(2) off
    separation = best.separations[0]
    assert separation.if_rival == 0.0
    # the cube shows itself; without it, twice (ln n - 1)/2 would be needed of 100:1 and the odds 3:2 against it
    assert separation.by_size == pytest.approx(math.e * 150**2 / 100.0)
    needed = math.log(100 / 1.5) + 0.5 * (math.log(100 * separation.seconds) - 1)
    assert separation.if_leading * separation.seconds == pytest.approx(needed, rel=1e-6)
    assert "if the smaller of nested models is, after 10 min, whatever the excitation" in str(found)
    first = np.array([separation.rate - best.sd / math.sqrt(2), separation.rate + best.sd / math.sqrt(2)])
    assert np.abs(first / seen["cubic"] - 1).min() < 0.01


def test_designs_are_ranked_and_the_closest_rival_counts():
    rivals = ({"x": -400.0, "v": -2.0, "u": 1.0, "x*abs(x)": -1000.0}, LINEAR)
    found = plan(Given((CUBIC, *rivals), (0.6, 0.3, 0.1)), amplitude=20.0)
    rates = [outcome.rate for outcome in found.outcomes]
    assert rates == sorted(rates, reverse=True)
    for outcome in found.outcomes:
        assert outcome.rate == min(one.rate for one in outcome.separations)
        for one in outcome.separations:  # without x**3 is contained: x**3 is true where they differ
            nested = found.rivals[one.rival].name == "without x**3"
            assert one.rate == pytest.approx(one.if_leading if nested else min(one.if_leading, one.if_rival))
            assert (one.by_size is not None) == nested
        assert outcome.seconds == max(one.seconds for one in outcome.separations)
        assert found.closest(outcome).name in ("x*abs(x) instead of x**3", "without x**3")
    assert found.purpose == "models"
    assert [rival.name for rival in found.rivals] == ["x*abs(x) instead of x**3", "without x**3"]
    table = found.table()
    assert list(table["rate"]) == rates
    assert set(table["kind"]) == set(EXCITATIONS)


def test_the_best_excitation_keeps_the_range():
    found = plan(Given((CUBIC, LINEAR), (0.6, 0.4)), amplitude=(1.0, 3.0))
    samples = found.inputs["u"]
    assert samples.min() >= 1.0 - 1e-12
    assert samples.max() <= 3.0 + 1e-12
    assert max(abs(samples - 2.0)) == pytest.approx(found.best.amplitudes["u"])
    assert len(samples) == len(found.time) == 200
    assert "1 .. 3" in str(found)


def test_the_same_seed_gives_the_same_plan():
    given = Given((CUBIC, LINEAR), (0.6, 0.4))
    first, again, other = (plan(given, seed=seed, seconds=1.0).to_dict() for seed in (3, 3, 4))
    assert first == again
    assert first != other


def test_limits_are_kept_and_reached():
    given = Given((CUBIC, LINEAR), (0.6, 0.4))
    free = by_design(plan(given, amplitude=50.0))
    found = plan(given, amplitude=50.0, limits={"x": 0.02, "v": 1.0}, realisations=2)
    assert max(outcome.peaks["x"] for outcome in free.values()) > 0.02
    assert any(outcome.limited for outcome in found.outcomes)
    for outcome in found.outcomes:
        assert outcome.peaks["x"] <= 0.02
        assert outcome.peaks["v"] <= 1.0
        if outcome.limited:  # the mean of two realisations of which one is at a limit, in steps of a thousandth
            assert max(outcome.peaks["x"] / 0.02, outcome.peaks["v"]) > 0.6
    assert "|x| at most 0.02" in str(found)
    with pytest.raises(InputError, match="no excitation keeps the motion within the limits"):
        plan(given, amplitude=50.0, limits={"x": 1e-9})


def test_rivals_beyond_the_odds_leave_the_coefficients_to_plan_for():
    covariance = np.diag([4.0, 0.01, 1e-4, 1e6])
    given = Given((CUBIC, LINEAR), (0.995, 0.005), covariance=covariance)
    found = plan(given)
    assert (found.purpose, found.decided.name, found.rivals) == ("coefficients", "without x**3", ())
    assert "no rival is within odds of 100:1" in str(found)
    assert all(outcome.separations == () for outcome in found.outcomes)
    assert found.best.rate > 0
    assert plan(given, odds=1000.0).purpose == "models"
    alone = plan(Given((LINEAR,), (1.0,), covariance=covariance[:3, :3]))
    assert (alone.purpose, alone.decided) == ("coefficients", None)
    assert "no other model is known" in str(alone)


def test_a_rival_that_runs_away_is_told_by_the_motion_of_the_other():
    away = {"x": 4e4, "v": 0.0, "u": 1.0}
    found = plan(Given((CUBIC, away), (0.6, 0.4)), ranges={"x": (-0.01, 0.01), "v": (-0.1, 0.1)})
    (separation,) = found.best.separations
    assert separation.if_rival is None
    assert separation.rate == pytest.approx(separation.if_leading)
    assert math.isfinite(separation.seconds)


def test_motion_starts_at_the_equilibrium_of_the_middle():
    given = Given((LINEAR, CUBIC), (0.6, 0.4), intercept=8.0)
    peaks = plan(given, amplitude=1e-3, ranges={"x": (0.0, 0.1), "v": (-1.0, 1.0)}).best.peaks
    assert peaks["x"] == pytest.approx(8.0 / 400, rel=1e-2)  # 8 = 400 x
    assert peaks["v"] < 1e-3
    # not where the record never was: then coordinates start in the middle of their range
    peaks = plan(given, amplitude=1e-3, ranges={"x": (0.5, 0.7), "v": (-1.0, 1.0)}).best.peaks
    assert peaks["x"] == pytest.approx(0.6, rel=1e-2)


def test_several_equations_and_inputs():
    one = Given(({"x1": -400.0, "v1": -2.0, "u1": 1.0, "x2": 50.0},), (1.0,), chain=parse_chain("x1:v1:a1"))
    two = Given(
        ({"x2": -900.0, "v2": -2.0, "u2": 1.0}, {"x2": -900.0, "v2": -2.0, "u2": 1.0, "x1": 60.0}), (0.7, 0.3),
        chain=parse_chain("x2:v2:a2"),
    )  # fmt: skip
    found = plan(one, two, inputs=("u1", "u2"), amplitude={"u1": 1.0, "u2": 2.0})
    assert [(rival.target, rival.name) for rival in found.rivals] == [("a2", "with x1 added")]
    assert found.best.separations[0].if_leading == 0.0
    assert found.best.separations[0].if_rival > 0
    assert set(found.inputs) == {"u1", "u2"}
    assert abs(np.corrcoef(*found.inputs.values())[0, 1]) < 0.9  # of realisations of their own
    assert "a2: x2, v2, u2 from the closest rival (with x1 added)" in str(found)
    assert {"amplitude_u1", "amplitude_u2"} <= set(found.table())
    figure = found.plot()
    assert len(figure.axes) == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"amplitude": -1.0}, "amplitude of u must be a positive number"),
        ({"amplitude": (2.0, 1.0)}, "amplitude of u: 2 to 1 is no range"),
        ({"amplitude": {"w": 1.0}}, "no input named 'w'"),
        ({"amplitude": None}, "the range of u is not known from the record: give amplitude"),
        ({"band": (5.0, 2.0)}, "the lower one first"),
        ({"band": (1.0, 80.0)}, "beyond half the sampling rate"),
        ({"band": None}, "the band of the input is not known"),
        ({"band": (2.05, 2.1)}, "no spectral line of 2 s"),
        ({"fs": None}, "the sampling rate is not known from the record: give fs"),
        ({"fs": math.nan}, "fs must be a positive number"),
        ({"seconds": None}, "the length of the record is not known"),
        ({"seconds": 0.05}, "at least 16 are needed"),
        ({"given_noise": {"x": 1.0}}, "no target named 'x'"),
        ({"given_noise": {"a": 0.0}}, "noise of a must be a positive number"),
        ({"limits": {"y": 1.0}}, "no state named 'y'"),
        ({"limits": {"x": -1.0}}, "limit of x must be a positive number"),
        ({"odds": 1.0}, "odds must be a number above 1"),
        ({"realisations": 1}, "realisations must be at least 2"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(InputError, match=message):
        plan(Given((CUBIC, LINEAR), (0.6, 0.4)), **options)


# --- what is kept with equations


def record(n=1000, seed=1, noise=0.2):
    return bq.simulate("duffing", n=n, seed=seed, noise=noise)


CANDIDATES = ["x", "v", "x**3", "u", "x*abs(x)", "v*abs(v)"]
ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}


@pytest.fixture(scope="module")
def found():
    return bq.discover(record(), **ROLES, dictionary=CANDIDATES, smooth="none")


def test_the_record_is_remembered(found):
    measured = found.data.measured
    rec = record()
    assert (measured.fs, measured.seconds) == (pytest.approx(1000.0), pytest.approx(1.0))
    assert set(measured.ranges) == {"x", "v", "a", "u"}
    assert measured.ranges["u"] == (rec["u"].min(), rec["u"].max())
    low, high = measured.bands["u"]
    power = np.abs(np.fft.rfft(rec["u"])) ** 2
    share, lowest, highest = np.cumsum(power[1:]) / power[1:].sum(), round(low), round(high)  # lines are 1 Hz apart
    assert share[highest - 1] >= 0.95 > share[highest - 2]
    assert share[lowest - 1] >= 0.005


def test_models_have_the_coefficients_of_their_own_regression():
    """By `lstsq` on the rows used, for a record with little noise."""
    rec = record(noise=0.02)
    eq = bq.discover(rec, **ROLES, dictionary=CANDIDATES, smooth="none", method="bma")[0]
    rows = slice(0, 800)
    columns = {name: rec[name][rows] for name in "xvau"}
    models = eq.models
    assert sum(model.probability for model in models) <= 1 + 1e-12
    assert [model.probability for model in models] == sorted((m.probability for m in models), reverse=True)
    for model in models[:3]:
        terms = [eq.terms[j] for j in model.members]
        D = np.column_stack([np.ones(800), *(Evaluator(columns)(term) for term in terms)])
        fitted = np.linalg.lstsq(D, columns["a"], rcond=None)[0]
        # the prior draws a little to zero what the record hardly tells
        different = D @ (np.array([model.intercept, *model.coef]) - fitted)
        assert different.std() < 1e-3 * columns["a"].std()
        assert abs(different.mean()) < 1e-3 * columns["a"].std()


@pytest.mark.parametrize(("method", "several"), [("vb", True), ("gibbs", True), ("rvm", False), ("stlsq", False)])
def test_every_engine_leaves_models(method, several):
    eq = bq.discover(record(400), **ROLES, dictionary=CANDIDATES, smooth="none", method=method)[0]
    assert (len(eq.models) > 1) == several
    assert sum(model.probability for model in eq.models) == pytest.approx(1.0, abs=0.1)
    chosen = next(m for m in eq.models if tuple(np.flatnonzero(eq.posterior.support)) == m.members)
    np.testing.assert_allclose(chosen.coef, list(eq.coef.values()), rtol=0.05 if several else 1e-9)


def test_saved_equations_give_the_same_plan(found, tmp_path):
    found.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert again[0].models == found[0].models
    assert again.data.measured == found.data.measured
    assert again.plan(realisations=2, seconds=0.5).to_dict() == found.plan(realisations=2, seconds=0.5).to_dict()
    again.save(tmp_path / "twice.json")
    assert bq.load(tmp_path / "twice.json")[0].models == found[0].models


def test_a_file_without_models_says_what_to_do(found):
    bare = replace(found, equations=tuple(replace(e, models=()) for e in found.equations))
    with pytest.raises(InputError, match="find and save them again"):
        bare.plan()


def test_nothing_to_excite():
    eq = bq.discover(bq.simulate("vanderpol", n=300, seed=0), chains=["x", "y"], dictionary="x, y", smooth="none")
    with pytest.raises(InputError, match="the equations have no input: there is nothing to excite"):
        eq.plan()


def test_amplitudes_of_one_sign_keep_it():
    given = Given((CUBIC, LINEAR), (0.6, 0.4))
    assert plan(given, amplitude=None, ranges={"u": (-0.1, 4.0)}).inputs["u"].min() >= -0.1
    even = plan(given, amplitude=None, ranges={"u": (-3.0, 4.0)})
    assert even.offsets == {"u": 0.0}
    assert even.outcomes[0].amplitudes["u"] == pytest.approx(3.0)


def test_a_plan_for_equations_that_were_not_found_warns(found):
    bad = replace(found, equations=tuple(replace(e, verdict=replace(e.verdict, kind="none")) for e in found.equations))
    with pytest.warns(DataWarning, match="equations that were not found"):
        bad.plan(realisations=2, seconds=0.1)


def test_the_noise_of_a_target_is_that_of_the_intervals(found):
    shown = found[0].shown_posterior
    assert noise_of_intervals(found[0]) == pytest.approx(found[0].noise_sd, rel=0.01)  # rows of white noise
    wider = replace(found[0], shown_posterior=replace(shown, covariance=4.0 * shown.covariance))
    assert noise_of_intervals(wider) == pytest.approx(2.0 * noise_of_intervals(found[0]))
    # without shares of the terms the residuals tell, by their effective number
    quarter = replace(found[0], share=None, residuals=replace(found[0].residuals, n_eff=found[0].residuals.n / 4))
    noise = replace(found, equations=(quarter,)).plan(realisations=2, seconds=0.1).conditions["noise"]["a"]
    assert noise == pytest.approx(2 * found[0].noise_sd)


def test_precise_displacements_tell_coefficients_that_a_noisy_acceleration_does_not():
    clean, rng = bq.simulate("duffing", n=1000, fs=200.0, seed=3, noise=0.0), np.random.default_rng(4)
    shares = {"x": 0.002, "v": 0.05, "a": 0.1, "u": 0.002}
    noise = {name: share * clean[name].std() for name, share in shares.items()}
    channels = {name: clean[name] + sd * rng.normal(size=clean.n) for name, sd in noise.items()}
    eq = bq.discover(
        bq.Record.from_arrays(channels, time=clean.time),
        chains="x:v:a",
        inputs=["u"],
        dictionary=["x", "v", "x**3", "u"],
    )
    assert noise_of_intervals(eq[0]) < 0.2 * noise["a"]
    plan = eq.plan(realisations=2)
    assert plan.best.seconds == pytest.approx(plan.conditions["seconds"])  # the whole of it, which is more than enough
