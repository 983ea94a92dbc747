"""`discover` on simulated and measured records."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.errors import (
    ChainError,
    DataWarning,
    InputError,
    RecordError,
    TermWarning,
    UnknownNameError,
)
from bayeq.regression.residuals import inspect_residuals
from tests.data import measured, pendulum_record

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
TRUE = {
    "linear": {"x", "v", "u"},
    "duffing": {"x", "v", "x**3", "u"},
    "quadratic": {"x", "v", "v*abs(v)", "u"},
    "coulomb": {"x", "v", "sign(v)", "u"},
}


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


@pytest.mark.parametrize(("system", "least"), [("linear", 23), ("duffing", 21), ("quadratic", 23), ("coulomb", 23)])
def test_the_paper_s_oscillators_at_five_per_cent_noise(system, least):
    # nominal parameters, seeds 0..24. Of seeds 0..49 all are exact but 2 of the Duffing oscillator; at rates of 0.99
    # and 0.96 other draws of the noise would fall below these limits with probabilities of 0.002 and 0.004. Without
    # smoothing the rates are 0.75 to 0.9 for the nonlinear ones (docs/reproduction.md).
    exact = sum(
        set(quietly(bq.simulate(system, seed=seed), **OSCILLATOR)[0].included) == TRUE[system] for seed in range(25)
    )
    assert exact >= least


@pytest.mark.parametrize(("noise", "seeds"), [(0.05, 40), (0.01, 30), (0.001, 30)])
def test_clean_states_at_any_noise_of_the_acceleration(noise, seeds):
    # All of 80 seeds are exact; at a rate of 0.995 two misses are exceeded with a probability of 0.001 in 40 draws and
    # less in 30. With v_s fixed at 10 the rate is 0.9 at 1 % noise and 0.58 at 0.1 %, where 28 of 30 are never reached.
    exact, ratios, hits = 0, [], []
    for seed in range(seeds):
        rec = bq.simulate("duffing", seed=seed, noise={"a": noise})
        eq = quietly(rec, **OSCILLATOR)[0]
        exact += set(eq.included) == TRUE["duffing"]
        ratios.append(eq.noise_sd / rec.truth.noise_sd["a"])
        ci = dict(zip([t.text for t in eq.terms], eq.ci95, strict=True))
        hits += [ci[t][0] <= value <= ci[t][1] for t, value in rec.truth.coefficients["a"].items()]
        hits.append(eq.intercept_ci95[0] <= 0 <= eq.intercept_ci95[1])
    assert exact >= seeds - 2
    assert np.all(np.abs(np.array(ratios) - 1) < 0.05)
    # 95 % of the intervals, and 3.5 standard deviations of a binomial: a probability of 0.001
    assert abs(np.mean(hits) - 0.95) < 3.5 * np.sqrt(0.95 * 0.05 / len(hits))


def test_noise_free_motion_gives_the_law_to_many_digits():
    rec = bq.simulate("duffing", seed=0, noise=0.0)
    eq = quietly(rec, **OSCILLATOR)[0]
    assert set(eq.included) == TRUE["duffing"]
    for term, value in rec.truth.coefficients["a"].items():
        assert eq.coef[term] == pytest.approx(value, rel=1e-6)


DUFFING = bq.simulate("duffing", n=1500, seed=5, noise={"a": 0.02, "x": 0.005})
NOISY = bq.simulate("duffing", n=1500, seed=5, noise=0.03)
REFERENCE = {smooth: quietly(DUFFING, **OSCILLATOR, smooth=smooth) for smooth in ("auto", "none")}
NOISY_REFERENCE = quietly(NOISY, **OSCILLATOR)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(exponents=st.lists(st.floats(-9, 9), min_size=4, max_size=4))
def test_units_of_the_channels_do_not_matter(exponents):
    assert_same_in_units(DUFFING, exponents, REFERENCE["none"], smooth="none")


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(exponents=st.lists(st.integers(-9, 9), min_size=4, max_size=4))
def test_decimal_units_of_smoothed_channels_do_not_matter(exponents):
    # the smoother relates channels to each other, whose units need not belong together: mm beside m/s
    assert_same_in_units(NOISY, exponents, NOISY_REFERENCE, smooth="auto", pip=1e-2, coef=1e-3)
    assert_same_in_units(DUFFING, exponents, REFERENCE["auto"], smooth="auto")


def assert_same_in_units(record, exponents, reference, smooth, pip=1e-6, coef=1e-5):
    scale = dict(zip("xvau", (10.0**e for e in exponents), strict=True))
    rescaled = bq.Record.from_arrays({name: record[name] * scale[name] for name in "xvau"}, time=record.time)
    eq = quietly(rescaled, **OSCILLATOR, smooth=smooth)
    assert eq[0].included == reference[0].included
    np.testing.assert_allclose(eq[0].posterior.pip, reference[0].posterior.pip, atol=pip)
    for term, value in reference[0].coef.items():
        unit = eval_unit(term, scale)
        assert eq[0].coef[term] == pytest.approx(value * scale["a"] / unit, rel=coef)


def eval_unit(term, scale):
    """The unit of a product of powers of channels."""
    out = 1.0
    for factor in term.split("*abs")[0].replace("**", "^").split("*"):
        name, _, power = factor.partition("^")
        out *= scale[name] ** int(power or 1)
    return out


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_rounding_is_not_fitted(seed):
    rec = bq.simulate("lorenz", seed=seed, noise=0.0, perturb=0.1)
    full = bq.Record.from_arrays({**rec.channels, **{k: v for k, v in rec.truth.clean.items() if k[0] == "d"}}, fs=100)
    eq = quietly(full, chains=["x:dx", "y:dy", "z:dz"], dictionary="polynomial:2")
    assert [set(e.included) for e in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]


def test_first_order_systems_and_several_targets():
    # clean states, derivatives given: the estimation of derivatives from noisy states is not at stake here
    rec = bq.simulate("lorenz", seed=0, noise=0.0)
    full = bq.Record.from_arrays({**rec.channels, **{k: v for k, v in rec.truth.clean.items() if k[0] == "d"}}, fs=100)
    eq = quietly(full, chains=["x:dx", "y:dy", "z:dz"], dictionary="polynomial:2")
    assert [set(e.included) for e in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]
    assert eq.states == ("x", "y", "z")
    np.testing.assert_allclose(eq.rhs(0.0, [1.0, 2.0, 3.0]), [10.0, 23.0, -6.0], rtol=1e-5)
    estimated = quietly(rec, chains=["x", "y", "z"], dictionary="polynomial:2")
    assert estimated.data.estimated == ("dx", "dy", "dz")
    assert estimated[0].coef["x"] == pytest.approx(-10, rel=0.01)
    assert estimated[2].coef["x*y"] == pytest.approx(1, rel=0.01)


def test_several_records_are_used_together():
    parts = [bq.simulate("duffing", n=1000, seed=seed) for seed in range(3)]
    eq = quietly(parts, **OSCILLATOR)
    assert set(eq[0].included) == TRUE["duffing"]
    assert (eq.data.n, eq.data.n_train, eq.data.n_held_out) == (3000, 2400, 600)


def test_held_out_rows_are_the_last_and_not_used():
    rec = bq.simulate("linear", n=1000, seed=0)
    spoiled = rec.with_channels({"a": np.where(np.arange(1000) < 750, rec["a"], 0.0)})
    a, b = (quietly(r, **OSCILLATOR, holdout=0.25)[0] for r in (rec, spoiled))
    assert a.coef == b.coef
    assert b.held_out.r2 < 0.5 < a.held_out.r2
    everything = quietly(rec, **OSCILLATOR, holdout=0.0)
    assert everything[0].held_out is None
    assert everything.data.n_train == 1000


def test_the_rvm_as_a_method():
    eq = quietly(bq.simulate("linear", seed=0), **OSCILLATOR, method="rvm")
    assert eq.method == "rvm"
    assert set(eq[0].included) >= TRUE["linear"]
    np.testing.assert_array_equal(eq[0].posterior.support, eq[0].posterior.pip > 0.5)
    assert eq[0].posterior.elbo is None


def test_prior_given_by_the_user():
    rec = bq.simulate("linear", seed=0)
    p0 = np.full(36, 0.1)
    p0[5] = 1.0
    eq = quietly(rec, **OSCILLATOR, prior=bq.Prior(prior_inclusion=p0, slab_variance=100.0))
    assert "x**3" in eq[0].included
    assert eq[0].posterior.slab_variance == 100.0


def test_warnings_in_plain_words():
    rec = bq.simulate("duffing", n=300, seed=1)
    with pytest.warns(TermWarning, match=r"terms left out: abs\(x\*x\) \(a copy of x\*\*2"):
        bq.discover(rec, **OSCILLATOR, dictionary=["x", "v", "x**2", "abs(x*x)", "u"])
    messages = quietly(rec.slice(0, 30), **OSCILLATOR).warnings
    assert any("fewer rows than terms" in w for w in messages)
    assert any("none held out" in w for w in messages)
    x = rec["x"]
    twin = rec.with_channels({"w": x + 1e-4 * np.std(x) * np.random.default_rng(0).normal(size=300)})
    # a smoothed x would be told from its twin, which keeps the noise
    messages = quietly(twin, **OSCILLATOR, inputs=["w"], dictionary=["x", "v", "w", "u"], smooth="none").warnings
    (group,) = [w for w in messages if "hardly tell apart" in w]
    assert "x (PIP" in group
    assert "w (PIP" in group
    messages = quietly(
        twin, **OSCILLATOR, inputs=["w"], dictionary=["x", "v", "w", "u"], method="vb", smooth="none"
    ).warnings
    assert any("hardly tell apart" in w and ("w instead of x" in w or "x instead of w" in w) for w in messages)


def test_an_equation_that_explains_little_is_warned_of():
    rng = np.random.default_rng(0)
    noise = bq.Record.from_arrays(x=rng.normal(size=300), v=rng.normal(size=300))
    with pytest.warns(
        DataWarning, match=r"no equation found: the terms explain little of v on the held-out rows \(R2 "
    ):
        bq.discover(noise, chains="x:v", dictionary="polynomial:2")


def test_residual_diagnostics():
    rng = np.random.default_rng(0)
    white = rng.normal(size=5000)
    assert not inspect_residuals([white]).correlated
    ar = np.zeros(20_000)
    for k in range(1, len(ar)):
        ar[k] = 0.8 * ar[k - 1] + rng.normal()
    found = inspect_residuals([ar[:9000], ar[9000:]])
    assert found.correlated
    assert found.lag1 == pytest.approx(0.8, abs=0.02)
    # n (1 - r)/(1 + r) for an autoregression of order one
    assert found.n_eff == pytest.approx(20_000 / 9, rel=0.15)
    direct = ar - ar.mean()
    assert inspect_residuals([ar]).lag1 == pytest.approx(direct[1:] @ direct[:-1] / (direct @ direct), rel=1e-9)
    assert inspect_residuals([np.zeros(10)]).n_eff == 10


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({}, ChainError, "no coordinate"),
        ({"displacement": "y"}, UnknownNameError, "'y'"),
        ({"chains": "x:v:a", "velocity": "v"}, ChainError, "not both"),
        ({**OSCILLATOR, "method": "gibs"}, UnknownNameError, "method"),
        ({**OSCILLATOR, "holdout": 1.0}, InputError, "holdout"),
        ({**OSCILLATOR, "inputs": ["u"]}, InputError, "twice"),
        ({**OSCILLATOR, "dictionary": ["x", "t"]}, InputError, "'t'"),
    ],
)
def test_wrong_arguments(options, error, match):
    with pytest.raises(error, match=match):
        bq.discover(bq.simulate("linear", n=100), **options)


def test_nothing_to_work_on():
    with pytest.raises(InputError, match="Record"):
        bq.discover([], chains="x")
    with pytest.raises(InputError, match="Record"):
        bq.discover([np.ones(3)], chains="x")
    with pytest.raises(RecordError, match="too few"):
        quietly(bq.Record.from_arrays(x=[1.0, 2.0], v=[1.0, 3.0]), chains="x:v", dictionary="polynomial:1")


# Measured records -------------------------------------------------------------------------------------------------


def test_air_track_oscillator():
    # (2 pi / period)^2 of x from its zero crossings is 6.222; the record's README: a rough fit gives -0.012 v
    rec = bq.read(measured("schmidt_lipson/real_linear_a_1.txt"))
    chain = {"displacement": "x", "velocity": "v", "acceleration": "a"}
    eq = quietly(rec, **chain)
    assert any("v, a: computed from x, not measured" in w for w in eq.warnings)
    assert eq[0].shown == ("x", "v")
    assert eq[0].shown_coef["x"] == pytest.approx(-6.222, rel=1e-3)
    assert eq[0].shown_coef["v"] == pytest.approx(-0.012, rel=0.25)
    assert eq[0].target == "a"
    raw = quietly(rec, **chain, smooth="none")
    assert any("which is what the rows count for" in w for w in raw.warnings)


def test_encoder_pendulum_chooses_the_sine():
    # the record's README: A = 64.22 from the authors' parameters
    path = measured("multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat")
    terms = ["th", "th**2", "th**3", "sin(th)", "cos(th)", "w", "w*abs(w)", "sign(w)"]
    eq = quietly(pendulum_record(path), chains=["th:w:"], dictionary=terms)
    assert "sin(th)" in eq[0].shown
    assert not {"th", "th**2", "th**3", "cos(th)"} & set(eq[0].shown)
    assert eq[0].shown_coef["sin(th)"] == pytest.approx(64.22, rel=0.02)
