"""`discover` on simulated and measured records."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
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
from tests.draws import draws

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
TRUE = {"linear": {"x", "v", "u"}, "duffing": {"x", "v", "x**3", "u"}}
TERMS = ["x", "v", "x**2", "x*v", "x**3", "x**2*v", "v*abs(v)", "u"]


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


def test_noise_free_motion_gives_the_law_to_many_digits():
    rec = bq.simulate("duffing", n=500, seed=0, noise=0.0)
    eq = quietly(rec, **OSCILLATOR)[0]
    assert set(eq.included) == TRUE["duffing"]
    for term, value in rec.truth.coefficients["a"].items():
        assert eq.coef[term] == pytest.approx(value, rel=1e-6)


@cache
def in_plain_units(noisy, smooth):
    """A record, and the answer that it must give in other units too."""
    rec = bq.simulate("duffing", n=300, seed=5, noise=0.03 if noisy else {"a": 0.02, "x": 0.005})
    return rec, quietly(rec, **OSCILLATOR, smooth=smooth, dictionary=TERMS)


@settings(max_examples=draws(40), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(exponents=st.lists(st.floats(-9, 9), min_size=4, max_size=4))
def test_units_of_the_channels_do_not_matter(exponents):
    assert_same_in_units(False, exponents, smooth="none")


@settings(max_examples=draws(10), deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(exponents=st.lists(st.integers(-9, 9), min_size=4, max_size=4))
def test_decimal_units_of_smoothed_channels_do_not_matter(exponents):
    # the smoother relates channels to each other, whose units need not belong together: mm beside m/s
    # 2 % from these is an acceleration in g, which the record cannot tell from them and which is the likelier unit
    assume(exponents[2] - exponents[1] not in (-1, -3, -4, -7))
    assert_same_in_units(True, exponents, smooth="auto", pip=1e-2, coef=1e-3)
    assert_same_in_units(False, exponents, smooth="auto")


def assert_same_in_units(noisy, exponents, smooth, pip=1e-6, coef=1e-5):
    record, reference = in_plain_units(noisy, smooth)
    scale = dict(zip("xvau", (10.0**e for e in exponents), strict=True))
    rescaled = bq.Record.from_arrays({name: record[name] * scale[name] for name in "xvau"}, time=record.time)
    eq = quietly(rescaled, **OSCILLATOR, smooth=smooth, dictionary=TERMS)
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


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3, 4))])
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
    estimated = quietly(rec, chains=["x", "y", "z"], dictionary="x, y, z, x*y, x*z, y*z")
    assert estimated.data.estimated == ("dx", "dy", "dz")
    assert estimated[0].coef["x"] == pytest.approx(-10, rel=0.01)
    assert estimated[2].coef["x*y"] == pytest.approx(1, rel=0.01)


def test_several_records_are_used_together():
    parts = [bq.simulate("duffing", n=300, seed=seed) for seed in range(3)]
    eq = quietly(parts, **OSCILLATOR, dictionary=TERMS)
    assert set(eq[0].included) == TRUE["duffing"]
    assert (eq.data.n, eq.data.n_train, eq.data.n_held_out) == (900, 720, 180)


def test_held_out_rows_are_the_last_and_not_used():
    rec = bq.simulate("linear", n=600, seed=0)
    spoiled = rec.with_channels({"a": np.where(np.arange(600) < 450, rec["a"], -rec["a"])})
    for smooth in ("auto", "none"):
        a, b = (quietly(r, **OSCILLATOR, dictionary=TERMS, holdout=0.25, smooth=smooth)[0] for r in (rec, spoiled))
        assert (a.scored is None) == (smooth == "none")
        assert (a.scored or a).coef == (b.scored or b).coef
        assert b.held_out.r2 < 0.5 < a.held_out.r2
    everything = quietly(rec, **OSCILLATOR, dictionary=TERMS, holdout=0.0, smooth="none")
    assert everything[0].held_out is None
    assert everything.data.n_train == 600


def test_the_rvm_as_a_method():
    eq = quietly(bq.simulate("linear", n=500, seed=0), **OSCILLATOR, method="rvm")
    assert eq.method == "rvm"
    assert set(eq[0].included) >= TRUE["linear"]
    np.testing.assert_array_equal(eq[0].posterior.support, eq[0].posterior.pip > 0.5)
    assert eq[0].posterior.details.elbo is None


def test_prior_given_by_the_user():
    rec = bq.simulate("linear", n=400, seed=0)
    p0 = np.full(36, 0.1)
    p0[5] = 1.0
    eq = quietly(rec, **OSCILLATOR, prior=bq.Prior(prior_inclusion=p0, slab_variance=100.0))
    assert "x**3" in eq[0].included
    assert eq[0].posterior.details.slab_variance == 100.0


@pytest.mark.filterwarnings("ignore::bayeq.errors.CorrelatedResidualsWarning")
def test_warnings_in_plain_words():
    rec = bq.simulate("duffing", n=300, seed=1)
    with pytest.warns(TermWarning, match=r"terms left out: abs\(x\*x\) \(a copy of x\*\*2"):
        bq.discover(rec, **OSCILLATOR, dictionary=["x", "v", "x**2", "abs(x*x)", "x**3", "u"])
    messages = quietly(rec.slice(0, 30), **OSCILLATOR, smooth="none").warnings
    assert any("fewer rows than terms" in w for w in messages)
    assert any("none held out" in w for w in messages)
    messages = quietly(rec, **OSCILLATOR, dictionary="x + v + u", smooth="none").warnings
    assert any("x+v+u is one term, with one coefficient: give several with commas" in w for w in messages)
    x = rec["x"]
    twin = rec.with_channels({"w": x + 1e-4 * np.std(x) * np.random.default_rng(0).normal(size=300)})
    # a smoothed x would be told from its twin, which keeps the noise
    messages = quietly(twin, **OSCILLATOR, inputs=["w"], dictionary=["x", "v", "w", "u"], smooth="none").warnings
    (group,) = [w for w in messages if "cannot tell" in w]
    assert "x (PIP" in group
    assert "w (PIP" in group
    messages = quietly(
        twin, **OSCILLATOR, inputs=["w"], dictionary=["x", "v", "w", "u"], method="vb", smooth="none"
    ).warnings
    assert any("cannot tell" in w and ("w instead of x" in w or "x instead of w" in w) for w in messages)


def test_an_equation_that_explains_little_is_warned_of():
    rng = np.random.default_rng(0)
    noise = bq.Record.from_arrays(x=rng.normal(size=300), v=rng.normal(size=300))
    with pytest.warns(
        DataWarning, match=r"v: no equation: the terms explain little on the held-out rows; check channels"
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
        ({**OSCILLATOR, "dictionary": ["x", "q"]}, InputError, "'q'"),
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
    # the tracking's error depends on the position: the law is nearly true
    eq = quietly(rec, **chain)
    assert any("v, a: computed from x, not measured" in w for w in eq.warnings)
    assert eq[0].shown == ("x",)
    assert eq[0].shown_coef["x"] == pytest.approx(-6.222, rel=1e-3)
    assert eq.verdict.kind == "nearly true"
    assert eq[0].target == "a"
    raw = quietly(rec, **chain, smooth="none")
    assert any("which is what the rows count for" in w for w in raw.warnings)


def test_encoder_pendulum_chooses_the_sine():
    # the record's README: A = 64.22 from the authors' parameters
    path = measured("multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat")
    terms = ["th", "th**2", "th**3", "sin(th)", "cos(th)", "w", "w*abs(w)", "sign(w)"]
    # a nearly true model: what it lacks is a function of the states
    eq = quietly(pendulum_record(path)[:1], chains=["th:w:"], dictionary=terms)
    assert "sin(th)" in eq[0].shown
    assert not {"th", "th**2", "th**3", "cos(th)"} & set(eq[0].shown)
    assert eq[0].shown_coef["sin(th)"] == pytest.approx(64.22, rel=0.02)


def test_a_falling_body_is_a_constant():
    # the smoothed acceleration hardly varies: a prior of the constant of its deviation, not of its size, hid it
    right = 0
    for seed in range(4):
        rng, t = np.random.default_rng([seed, 3]), np.arange(120) / 60.0
        record = bq.Record.from_arrays(x=20.0 - 4.905 * t**2 + 0.02 * rng.standard_normal(120), fs=60.0)
        eq = bq.discover(record, chains="x::", dictionary="dx, dx*abs(dx)", holdout=0.0)
        (one,) = eq
        assert one.intercept_matters
        assert one.text.startswith("ddx = -9.")
        low, high = one.printed_intercept_ci95
        right += (low <= -9.81 <= high) and eq.verdict.kind == "found"
    assert right >= 3
