"""What residuals say about an equation: memory, shape, and channels that they follow."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kurtosis, skew

import bayeq as bq
from bayeq.errors import CorrelatedResidualsWarning
from bayeq.regression.residuals import Driver, inspect_residuals

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": "none"}


def autoregression(rng, n, *coefficients):
    return lfilter([1.0], [1.0, *(-c for c in coefficients)], rng.normal(size=n + 500))[500:]


# --- shape -----------------------------------------------------------------------------------------------------------


def test_moments_are_those_of_scipy():
    rng = np.random.default_rng(0)
    e = rng.exponential(size=900)
    found = inspect_residuals([e[:300], e[300:]])
    assert found.skewness == pytest.approx(skew(e), rel=1e-10)
    assert found.kurtosis == pytest.approx(kurtosis(e), rel=1e-10)
    assert found.normality < 1e-20


@pytest.mark.parametrize("coefficients", [(), (0.8,), (1.6, -0.9)])
def test_gaussian_residuals_are_rarely_called_other_however_correlated(coefficients):
    p = [
        inspect_residuals([autoregression(np.random.default_rng(k), 3000, *coefficients)]).normality for k in range(300)
    ]
    # 5 % of 300 are 15, with a standard deviation of 3.8
    assert 4 <= np.sum(np.array(p) < 0.05) <= 28
    assert np.min(p) > 1e-5
    assert np.median(p) > 0.3


@pytest.mark.parametrize("shape", ["uniform", "laplace", "exponential"])
def test_other_shapes_are_seen(shape):
    for seed in range(20):
        noise = getattr(np.random.default_rng(seed), shape)(size=1000)
        assert inspect_residuals([lfilter([1.0], [1.0, -0.4], noise)]).normality < 1e-4


# --- channels --------------------------------------------------------------------------------------------------------


def naive(e, z, lag):
    """Cross-correlation of e(t) and z(t - lag) in one piece, about the means."""
    e, z = e - e.mean(), z - z.mean()
    pairs = zip(e[lag:], z[: len(z) - lag], strict=True) if lag >= 0 else zip(e[:lag], z[-lag:], strict=True)
    return sum(a * b for a, b in pairs) / np.sqrt(e @ e * (z @ z))


def test_the_strongest_cross_correlation_is_found():
    rng = np.random.default_rng(1)
    z, w = autoregression(rng, 400, 0.5), rng.normal(size=400)
    e = rng.normal(size=400) + 0.6 * np.roll(z, -7)
    driver = inspect_residuals([e], {"w": [w], "z": [z]}).driver
    assert (driver.name, driver.lag) == ("z", -7)
    values = {lag: naive(e, z, lag) for lag in range(-100, 101)}
    assert driver.correlation == pytest.approx(values[-7], rel=1e-9)
    assert max(values, key=lambda lag: abs(values[lag])) == -7
    assert str(driver) == f"z 7 rows after (correlation {driver.correlation:.2f})"
    assert str(Driver("u", 0, -0.5, 0.1)) == "u (correlation -0.50)"


def test_pieces_are_not_joined():
    rng = np.random.default_rng(2)
    e, z = rng.normal(size=(2, 600))
    driver = inspect_residuals([e[:200], e[200:]], {"z": [z[:200], z[200:]]}).driver
    e0, z0 = e - e.mean(), z - z.mean()
    k = driver.lag
    pairs = [
        (a[max(k, 0) : len(a) + min(k, 0)], b[max(-k, 0) : len(b) - max(k, 0)])
        for a, b in ((e0[:200], z0[:200]), (e0[200:], z0[200:]))
    ]
    assert driver.correlation == pytest.approx(sum(a @ b for a, b in pairs) / np.sqrt(e0 @ e0 * (z0 @ z0)), rel=1e-9)


@pytest.mark.parametrize(("own", "other"), [((), ()), ((0.9,), (0.9,)), ((0.7,), (1.9, -0.95)), ((1.8, -0.9),) * 2])
def test_unrelated_channels_are_not_followed(own, other):
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        e, z, w = autoregression(rng, 1000, *own), autoregression(rng, 1000, *other), rng.normal(size=1000)
        found = inspect_residuals([e], {"z": [z], "w": [w]})
        assert not found.driven
        p.append(found.driver.p_value)
    # a bound of the probability: 5 % of 200 would be 10, 1 % be 2
    assert np.sum(np.array(p) < 0.05) <= 20
    assert np.sum(np.array(p) < 0.01) <= 7


def test_degenerate_residuals():
    assert inspect_residuals([np.zeros(10)], {"u": [np.arange(10.0)]}).driver is None
    assert inspect_residuals([np.arange(10.0)], {"u": [np.ones(10)]}).driver is None
    short = inspect_residuals([np.array([1.0, -1.0])], {"u": [np.array([0.5, 2.0])]})
    assert short.n == 2
    assert not short.driven


# --- in the answer ---------------------------------------------------------------------------------------------------


def test_an_adequate_equation_is_not_warned_of_and_states_its_residuals(tmp_path):
    for system in ("linear", "duffing", "quadratic", "coulomb"):
        for seed in range(2):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                eq = bq.discover(bq.simulate(system, n=2000, seed=seed), **OSCILLATOR)
            assert not eq[0].residuals.driven
            assert not any("misses dynamics" in w for w in eq.warnings)
    out = eq.to_dict()["diagnostics"]["equations"]["a"]["residuals"]
    assert {"n", "lag1", "n_eff", "correlated"} <= set(out)  # as they have been
    assert set(out) >= {"skewness", "kurtosis", "normality", "driver", "driven"}
    assert set(out["driver"]) == {"name", "lag", "correlation", "p_value"}
    assert out["driver"]["name"] in ("x", "v", "u")
    assert "residuals: follow no input or state at any lag" in str(eq)
    eq.save(tmp_path / "eq.json")
    assert bq.load(tmp_path / "eq.json")[0].residuals == eq[0].residuals
    # files of earlier versions do not hold them
    saved = json.loads((tmp_path / "eq.json").read_text())
    for name in ("skewness", "kurtosis", "normality", "driver", "driven"):
        del saved["diagnostics"]["equations"]["a"]["residuals"][name]
    (tmp_path / "old.json").write_text(json.dumps(saved))
    assert bq.load(tmp_path / "old.json")[0].residuals.driver is None


def test_missing_dynamics_are_named():
    # the force acts through an actuator that takes 3 ms: the dictionary has only the force of the moment
    record = bq.simulate("linear", seed=1)
    lagging = lfilter([1 - np.exp(-1 / 3)], [1, -np.exp(-1 / 3)], record["u"])
    told = bq.simulate("linear", seed=1, force=lagging)
    slow = told.with_channels({"u": record["u"]})
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        eq = bq.discover(slow, **OSCILLATOR, dictionary=["x", "v", "u"])
    (told_of,) = [w for w in given if "the residuals follow" in str(w.message)]
    assert told_of.category is CorrelatedResidualsWarning
    assert str(told_of.message).startswith("a: the residuals follow u")
    assert str(told_of.message) in eq.warnings
    assert eq[0].residuals.driven
    assert eq[0].residuals.driver.name == "u"
    assert f"residuals: follow {eq[0].residuals.driver} (p < 0.0001)" in str(eq)
