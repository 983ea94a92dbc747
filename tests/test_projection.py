"""Coefficients by projection, and records whose law is not quite in the dictionary."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

import bayeq as bq
from bayeq.likelihood.projection import leftover, projected
from bayeq.numerics.distributions import t_quantile


def quietly(*arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*arguments, **options)


def autoregression(rng, n, memory):
    """White noise with memory, of unit variance."""
    first, steps = rng.normal(), np.sqrt(1.0 - memory**2) * rng.normal(size=n - 1)
    return np.append(first, lfilter([1.0], [1.0, -memory], steps, zi=[memory * first])[0])


def test_the_projection_is_the_least_squares_of_terms_and_discrepancy():
    rng = np.random.default_rng(0)
    columns = [rng.normal(size=(n, 3)) for n in (400, 250)]
    theta = np.array([2.0, -1.0, 0.5])
    discrepancies = [0.3 * D[:, 0] + rng.normal(size=len(D)) for D in columns]
    left = leftover(columns, discrepancies, [np.ones(len(D) - 1) for D in columns], 4.0)
    found = projected(left, np.eye(3))
    both = np.concatenate([D @ theta + d for D, d in zip(columns, discrepancies, strict=True)])
    wanted = np.linalg.lstsq(np.concatenate(columns), both, rcond=None)
    np.testing.assert_allclose(theta + found.change, wanted[0], rtol=1e-9)
    assert found.share == pytest.approx(np.sqrt(wanted[1][0] / 650 / 4.0), rel=1e-9)
    # the third coefficient is minus the first
    basis = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    tied = projected(left, basis)
    free = np.linalg.lstsq(np.concatenate(columns) @ basis, np.concatenate(discrepancies), rcond=None)[0]
    np.testing.assert_allclose(tied.change, basis @ free, rtol=1e-9)


def test_samples_count_by_the_time_around_them():
    D, d = np.array([[1.0], [1.0], [1.0]]), np.array([0.0, 1.0, 4.0])
    # the middle of the second sample's time lies between 0.5 and 2.5, that of the third reaches two beyond
    left = leftover([D], [d], [np.array([1.0, 3.0])], 1.0)
    assert projected(left, np.eye(1)).change[0] == pytest.approx((1 * 0.0 + 2 * 1.0 + 3 * 4.0) / 6)


def test_standard_deviations_are_those_of_what_is_left():
    rng, z, n = np.random.default_rng(1), [], 3000
    for _ in range(150):
        columns = np.column_stack([np.sin(0.1 * np.arange(n) + rng.uniform(0, 6)), autoregression(rng, n, 0.98)])
        d = autoregression(rng, n, 0.95)
        found = projected(leftover([columns], [d], [np.ones(n - 1)], 1.0), np.eye(2))
        z.append(found.change / np.sqrt(np.diagonal(found.covariance)))
        assert found.freedom >= 3
    # 300 standardised errors, a t distribution of few tens of degrees of freedom
    assert np.mean(np.square(z)) == pytest.approx(1.1, abs=4 * np.sqrt(2 / 300))


def test_batches_that_are_too_few_tell_no_variance():
    rng = np.random.default_rng(2)
    columns, slow = np.ones((30, 1)), np.cumsum(rng.normal(size=30))
    found = projected(leftover([columns], [slow], [np.ones(29)], 1.0), np.eye(1))
    assert not found.covariance.any()
    assert np.isinf(found.freedom)


def test_half_widths_of_student_s_t():
    freedom = np.array([3.0, 4.0, 7.5, 15.0, 63.0, 1e4])
    np.testing.assert_allclose(t_quantile(freedom), stats.t.ppf(0.975, freedom), rtol=0.01)


def with_a_second_force(seed, share):
    """A Duffing oscillator with a force that nobody measured, of some share of the one that was; 1 % noise.

    Four seconds, for the force is slow, of 50 samples a period.
    """
    rng, n = np.random.default_rng(seed), 4000
    clean = bq.simulate("duffing", n=n, noise=0.0, seed=seed)
    second = share * np.std(clean["u"]) * autoregression(rng, n, 0.998)
    record = bq.simulate("duffing", n=n, noise=0.0, seed=seed, force=np.asarray(clean["u"]) + second)
    channels = {name: np.asarray(record[name]) for name in ("x", "v", "a")} | {"u": np.asarray(clean["u"])}
    noisy = {name: values + 0.01 * values.std() * rng.normal(size=n) for name, values in channels.items()}
    noisy = bq.Record.from_arrays(noisy, fs=1000.0).slice(step=4)
    return noisy, record.truth.coefficients["a"], second.std() / channels["a"].std()


@pytest.mark.statistical(short=1, full=3)
def test_a_force_that_nobody_measured(tmp_path, number):
    inside, known, shares = 0, 0, []
    for seed in range(number):
        record, truth, share = with_a_second_force(seed, 0.3)
        eq = quietly(record, chains=["x:v:a"], inputs=["u"], dictionary=list(truth), noise={"u": "1%"})
        (one,) = eq
        # damping may be too small beside such a force
        assert {"x", "x**3", "u"} <= set(one.shown) <= set(truth)
        ends = {term.text: value for term, value in zip(one.terms, one.shown_ci95, strict=True)}
        inside += sum(ends[name][0] <= truth[name] <= ends[name][1] for name in one.shown)
        known += len(one.shown)
        shares.append(one.error_share / share)
        assert one.verdict.kind in ("nearly true", "not determined")
    # of 12 intervals of 95 % three or more fail once in fifty, of four two or more
    assert inside >= known - (1 + number) // 2
    # some of a slow force is taken for constant or for terms
    assert np.median(shares) == pytest.approx(1.0, abs=0.5)
    own = eq.to_dict()["equations"][0]
    assert own["error_share"] == pytest.approx(one.error_share)
    term = own["terms"][0]
    assert term["likelihood_sd"] < term["shown_sd"]
    assert term["likelihood_ci95"][0] < term["likelihood_coef"] < term["likelihood_ci95"][1]
    eq.save(tmp_path / "eq.json")
    (again,) = bq.load(tmp_path / "eq.json")
    np.testing.assert_allclose(again.shown_ci95, one.shown_ci95, rtol=1e-12)
    np.testing.assert_allclose(again.shown_posterior.projected.coef, one.shown_posterior.projected.coef)
    assert again.error_share == one.error_share


def test_a_sensor_that_lags_leaves_a_time_constant():
    # of a heater of 180 s, through a sensor of 10 s: a discrepancy of long memory was as likely as the law, and dT = 0
    rng, fine = np.random.default_rng(5), 20
    t = np.arange(800 * fine) / fine
    true, seen = 31.0 * (1.0 - np.exp(-t / 180.0)), np.zeros(len(t))
    for k in range(1, len(t)):
        seen[k] = seen[k - 1] + (true[k] - seen[k - 1]) / (10.0 * fine)
    record = bq.Record.from_arrays({"T": 20.0 + seen[::fine] + 0.1 * rng.normal(size=800)}, fs=1.0)
    (one,) = quietly(record, chains=["T"], dictionary="polynomial:1")
    assert one.included == ("T",)
    assert one.shown_coef["T"] == pytest.approx(-1 / 180, rel=0.15)
    assert one.error_share > 0.1


def test_growth_of_few_rows_is_not_shrunk():
    rng = np.random.default_rng(4)
    t, r, K = np.arange(30), 0.5, 22.0
    N = K / (1.0 + 19.0 * np.exp(-r * t))
    record = bq.Record.from_arrays({"N": N + 0.05 * N * rng.normal(size=30)}, fs=1.0)
    (one,) = quietly(record, chains=["N"], dictionary="polynomial:2")
    assert one.included == ("N", "N**2")
    assert one.shown_coef["N"] == pytest.approx(r, rel=0.25)
    assert -one.shown_coef["N"] / one.shown_coef["N**2"] == pytest.approx(K, rel=0.1)


@pytest.mark.slow  # of another one: test_holding
def test_a_pendulum_that_friction_brings_to_rest():
    # 4096 lines: at rest the encoder shows the same count for seconds, and the friction may be anything up to 0.25
    n, fs, fine = 6000, 200.0, 50
    th, w, h, rows = 0.6, 0.0, 1 / fs / fine, np.empty(n)
    for k in range(n):
        rows[k] = th
        for _ in range(fine):
            w += h * (-15.8 * math.sin(th) - 0.04 * w)
            w -= math.copysign(min(abs(w), h * 0.25), w)
            th += h * w
    step = 2.0 * np.pi / 4096
    record = bq.Record.from_arrays({"th": np.round(rows / step) * step}, fs=fs)
    assert (np.diff(record["th"])[-500:] == 0.0).all()
    (one,) = quietly(record, chains=["th::"], dictionary=["sin(th)", "dth", "sign(dth)"], holdout=0.0)
    assert one.shown_coef["sin(th)"] == pytest.approx(-15.8, rel=0.002)
    assert one.shown_coef["sign(dth)"] == pytest.approx(-0.25, rel=0.05)


def test_what_is_known_of_coefficients_goes_with_a_constant():
    record = bq.simulate("duffing", n=800, seed=4)
    record = record.with_channels({"u": record["u"] - 20.0})
    options = {"chains": ["x:v:a"], "inputs": ["u"], "dictionary": ["x", "v", "x**3", "u"], "holdout": 0.0}
    (free,), (given,) = quietly(record, **options), quietly(record, **options, constraints=["u == 1", "v <= 0"])
    assert given.shown_coef["u"] == 1.0
    assert given.shown_coef["v"] <= 0.0
    value, sd = given.shown_model.intercept, given.shown_model.intercept_sd
    assert value == pytest.approx(free.shown_model.intercept, abs=3 * sd)
    assert value == pytest.approx(20.0, abs=4 * sd)
