"""Tests of the tests: probabilities of what is left of a record, and of equations that predict otherwise."""

from __future__ import annotations

import re
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.special import betainc
from scipy.stats import kstest

import bayeq as bq
from bayeq.equation.brief import brief
from bayeq.equation.build import doubted
from bayeq.equation.selection.alternatives import Alternatives, alternatives_to
from bayeq.equation.selection.excitation import Repeating
from bayeq.equation.verdict import KINDS, Verdict, worst
from bayeq.likelihood.adequacy import Adequacy, Change, Discrepancy, Octave, chance_of, octaves_of, turn_of
from bayeq.likelihood.low_pass import feedback, mean_spectrum, spectrum_of, step_variance
from bayeq.numerics.distributions import incomplete_beta
from bayeq.regression.residuals import Fit, Residuals
from bayeq.states import Roles
from tests.draws import draws

NOTHING = Discrepancy(1e-4, 0.0, np.inf, 0.6, (1.0, 2.0))


def test_chance_of_a_discrepancy_counts_the_memories_that_were_tried():
    # white noise without discrepancy: the likeliest size and memory of one, by the likelihood of its spectrum
    rng, n, draws = np.random.default_rng(11), 512, 20_000
    power = rng.exponential(size=(draws, n // 2 - 1))
    angle = 2.0 * np.pi * np.arange(1, n // 2) / n
    gains = np.zeros(draws)
    for rho in np.linspace(0.02, 0.98, 30):
        spectrum = (1.0 - rho**2) / (1.0 - 2.0 * rho * np.cos(angle) + rho**2)
        more = np.geomspace(1e-3, 10.0, 60)[:, None] * spectrum
        np.maximum(gains, 2.0 * (power @ (more / (1.0 + more)).T - np.log1p(more).sum(axis=1)).max(axis=1), out=gains)
    length = turn_of([rng.normal(size=n)])
    p = np.array([chance_of(gain, length) for gain in gains])
    # at 5 and 1 %: memories near 1 rest on few frequencies, whose ratios of likelihoods are less than chi-square
    assert 0.025 < np.mean(p < 0.05) < 0.055
    assert 0.004 < np.mean(p < 0.01) < 0.012
    assert np.mean([chance_of(gain, 0.0) < 0.01 for gain in gains]) > 0.02


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*arguments, **options)


@pytest.mark.parametrize("tails", [None, 3.0])
def test_the_shape_of_what_is_left_is_that_of_the_noise(tails):
    """Not that of the errors of smoothing, which are larger here than there."""
    clean = bq.simulate("cart_pole", n=800, seed=1, noise=0.0)
    rng = np.random.default_rng(0)
    noise = {name: rng.standard_normal(800) if tails is None else rng.standard_t(tails, 800) for name in "xqu"}
    record = bq.Record.from_arrays(
        {name: clean[name] + 0.01 * clean[name].std() * noise[name] for name in "xqu"}, fs=100.0
    )
    dictionary = "u, dx, sin(q), ddq*cos(q), ddx*cos(q), dq**2*sin(q)"
    found = quietly(record, chains=["x::", "q::"], inputs=["u"], dictionary=dictionary)
    assert all((one.residuals.normality > 0.01) == (tails is None) for one in found)
    assert ("heavy tails" in brief(found)) == (tails is not None)


@settings(max_examples=draws(200), deadline=None)
@given(st.floats(0.5, 5000.0), st.floats(0.5, 5000.0), st.floats(0.0, 1.0))
def test_the_incomplete_beta_function(a, b, x):
    assert incomplete_beta(a, b, x) == pytest.approx(betainc(a, b, x), abs=1e-10)


def test_octaves_of_white_noise_are_uniform():
    rng = np.random.default_rng(0)
    p = []
    for _ in range(60):
        pieces = [3.0 * rng.standard_normal(n) for n in (900, 400)]
        p += [one.p for one in octaves_of("x", pieces, 0.01)]
    assert kstest(p, "uniform").pvalue > 0.01


def test_octaves_of_hum():
    rng = np.random.default_rng(1)
    n, fs = 4000, 500.0
    values = rng.standard_normal(n) + 0.5 * np.sin(2 * np.pi * 50.0 * np.arange(n) / fs)
    found = min(octaves_of("x", [values], 1 / fs), key=lambda one: one.p)
    assert found.low < 50.0 < found.high
    assert found.ratio > 1.5
    assert found.p < 1e-10
    # without that octave the others are white
    rest = octaves_of("x", [values], 1 / fs, {(found.low, found.high)})
    assert (found.low, found.high) not in {(one.low, one.high) for one in rest}
    assert min(one.p for one in rest) > 1e-3


def test_many_tests_reject_at_their_level_together():
    # the least of 20 probabilities of 0.002 is no surprise, of 0.0002 it is
    chance = [Octave("x", 1.0, 2.0, 1.1, p, 0.1) for p in (0.002, *np.linspace(0.05, 1.0, 19))]
    assert Adequacy((NOTHING,), tuple(chance)).coloured(["x"]) is None
    chance[0] = chance[0]._replace(p=0.0002)
    adequacy = Adequacy((NOTHING,), tuple(chance))
    assert adequacy.coloured(["x"]) == chance[0]
    assert adequacy.coloured(["v"]) is None
    assert adequacy.lacks(0) is None
    assert Adequacy((NOTHING._replace(p=1e-9),), tuple(chance)).lacks(0) is not None


def oscillation(change, seed, n=1500, fs=100.0):
    """A driven oscillator whose stiffness changes in proportion to time, 2 % of noise."""
    rng, t = np.random.default_rng(seed), np.arange(n) / fs
    frequencies, phases = rng.uniform(0.3, 4.0, 30), rng.uniform(0.0, 2.0 * np.pi, 30)

    def force(time):
        return np.cos(2.0 * np.pi * frequencies * time + phases).sum()

    def rates(time, state):
        return [state[1], force(time) - 0.8 * state[1] - 150.0 * (1.0 + change * time / t[-1]) * state[0]]

    states = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y
    a = np.array([rates(*pair)[1] for pair in zip(t, states.T, strict=True)])
    clean = {"x": states[0], "v": states[1], "a": a, "u": np.array([force(time) for time in t])}
    noisy = {name: x + 0.02 * x.std() * rng.standard_normal(n) for name, x in clean.items()}
    return bq.Record.from_arrays(noisy, time=t)


def test_a_coefficient_that_changes_is_told_by_how_much():
    terms = ["x", "v", "u", "x**3", "v*abs(v)"]
    (equation,) = quietly(oscillation(0.03, 1), chains="x:v:a", inputs="u", dictionary=terms, holdout=0.0)
    assert equation.shown == ("x", "v", "u")
    assert equation.verdict.kind == "nearly true"
    said = re.fullmatch(
        r"the coefficient of x changes by \+(.*) % over the record \(p < 0.0001\)", equation.verdict.reason
    )
    assert 2.5 < float(said[1]) < 3.5
    (steady,) = quietly(oscillation(0.0, 1), chains="x:v:a", inputs="u", dictionary=terms, holdout=0.0)
    assert steady.verdict.kind == "found"


@pytest.mark.slow
def test_changes_of_constant_coefficients_are_by_chance():
    p = []
    for seed in range(40):
        (equation,) = quietly(oscillation(0.0, seed, 400), chains="x:v:a", inputs="u", dictionary=["x", "v", "u"])
        p += [one.p for one in equation.fit.regression.record.adequacy.changes]
    assert len(p) == 120
    assert kstest(p, "uniform").pvalue > 0.01


def test_verdicts_from_the_worst():
    found = Verdict("found", "R2 1")
    others = Alternatives(0.2, ("v**3",), ("v",))
    lacking = NOTHING._replace(size=0.03, low=0.02, high=0.04, p=1e-9)
    hum = Octave("v", 40.0, 80.0, 4.0, 1e-9, 0.1)
    none = Alternatives(0.0)
    more, less = (Change(0, "the constant", 0.05, share, 1e-9) for share in (0.018, 0.01))
    (chain,) = Roles.parse("x:v:a").chains

    def verdict_of(*doubts, verdict=found, changing=None, exact=1.0, left=None, gains=(), n_eff=100.0, again=None):
        equation = SimpleNamespace(
            verdict=verdict, chain=chain, error_probability=1.0 - exact, error_share=left, unit_gains=gains,
            residuals=Residuals(100, 0.0, n_eff), train=Fit(100, 0.9, 0.3),
        )  # fmt: skip
        return doubted(equation, *doubts, changing, again, as_measured=True)

    assert verdict_of(none, None, None) is found
    cases = [
        (verdict_of(others, lacking, hum), "not determined", "with v**3 and without v"),
        (
            verdict_of(none, lacking, hum, exact=1e-3, left=0.02),
            "nearly true",
            "2 % of a is not explained by these terms; what is",
        ),
        (verdict_of(none, lacking, hum), "nearly true", "3 % of a is not explained by these terms, mostly at"),
        (verdict_of(none, None, hum), "nearly true", "what is left of v is not white noise: 4 times"),
        (
            verdict_of(none, lacking, None, exact=1e-3, left=0.02, changing=more),
            "nearly true",
            "the constant changes by +5 % over the record (p < 0.0001)",
        ),
        (verdict_of(none, None, None, changing=more._replace(relative=-3.0)), "nearly true", "changes its sign"),
        (verdict_of(none, lacking, None, changing=more._replace(relative=-3.0)), "nearly true", "3 % of a is not"),
        (verdict_of(none, lacking, None, left=0.02, changing=less), "nearly true", "2 % of a is not explained"),
        (verdict_of(none, None, None, n_eff=40.2), "nearly true", "100 rows tell as much as 40 independent"),
        (verdict_of(none, None, None, left=0.3), "nearly true", "30 % of a is not explained by these terms"),
        (verdict_of(none, None, None, left=0.1), "found", "R2 1"),
        (
            verdict_of(none, None, None, gains=(1.0, -1.0, 1.0)),
            "not determined",
            "x and v contradict each other in sign",
        ),
        (verdict_of(none, None, None, again=Repeating(2.0, 3, 9)), "not determined", "repeats itself at 2 Hz"),
        (verdict_of(none, None, None, again=Repeating(2.0, 3, 9, True)), "not determined", "alone: a = -157.9*x"),
        (verdict_of(others, lacking, hum, verdict=Verdict("none", "nothing")), "none", "nothing"),
    ]
    for verdict, kind, reason in cases:
        assert verdict.kind == kind
        assert reason in verdict.reason
        assert (verdict.advice != "") == (kind in ("not determined", "nearly true"))
    assert [worst([("a", found), ("b", v)]).kind for v, _, _ in cases] == [kind for _, kind, _ in cases]
    assert KINDS[-1] == "found"


def test_an_equation_that_few_rows_leave_open():
    record = bq.simulate("duffing", n=4000, seed=1).take(np.arange(80))
    few = "x, v, x**2, x**3, x*abs(x), v*abs(v), u"
    eq = quietly(record, chains="x:v:a", inputs=["u"], dictionary=few)
    assert eq.verdict.kind == "not determined"
    whole = quietly(bq.simulate("duffing", n=1500, seed=1), chains="x:v:a", inputs=["u"], dictionary=few)
    assert whole.verdict.kind == "found"
    assert alternatives_to(whole[0].fit, whole[0].shown_posterior, 0.005).probability < 0.01


def test_low_passed_noise_has_the_poles_of_its_filter():
    order, corner, step = 4, 30.0, 0.01
    factors = feedback(order, corner, np.array([step, step]))[0]
    free = np.array([[step ** (j - i) / np.prod(np.arange(1.0, j - i + 1)) if j >= i else 0.0 for j in range(order)]
                     for i in range(order)])  # fmt: skip
    closed = free.copy()
    closed[-1] = factors @ free
    angles = np.pi * (2.0 * np.arange(order) + order + 1.0) / (2.0 * order)
    wanted = np.exp(step * corner * np.exp(1j * angles))
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(closed)), np.sort_complex(wanted), atol=1e-6)


def test_the_spectrum_of_low_passed_noise_is_read():
    order, corner, step, level, noise = 3, 40.0, 0.01, 2.0, 0.05
    factors = feedback(order, corner, np.array([step]))[0]
    free = np.array([[1.0, step, step**2 / 2], [0.0, 1.0, step], [0.0, 0.0, 1.0]])
    closed = free.copy()
    closed[-1] = factors @ free
    rng = np.random.default_rng(0)
    state, values = np.zeros(order), []
    steps = np.sqrt(step_variance(order, corner, step, level)) * rng.standard_normal(20_000)
    for change in steps:
        state = closed @ state
        state[-1] += change
        values.append(state[0])
    samples = np.array(values) + np.sqrt(noise) * rng.standard_normal(len(values))
    found = spectrum_of(mean_spectrum([samples - samples.mean()]), order, step, samples.var())
    # aliasing of the sequence of steps is not in Butterworth's formula
    np.testing.assert_allclose(found, (corner, level, noise), rtol=0.1)
