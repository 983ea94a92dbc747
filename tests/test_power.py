"""The power of a likelihood whose innovations are correlated."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

import bayeq as bq
from bayeq.likelihood.adequacy import excess_of
from bayeq.likelihood.fit import marginal
from bayeq.numerics.settings import LIKELIHOOD
from tests.statistical.limits import fewest


def test_scores_of_independent_samples_have_no_excess():
    rng, beyond = np.random.default_rng(0), 0
    for _ in range(400):
        excess, error = excess_of([rng.standard_normal((n, 4)) / np.sqrt(1300.0) for n in (900, 400)])
        assert 0.6 < excess < 1.6
        beyond += excess > 1.0 + LIKELIHOOD.correlated_by * error
    # one-sided 3 standard errors: 0.13 % of a normal distribution, and lags are added while the sum grows
    assert beyond <= 8


@pytest.mark.parametrize("memory", [pytest.param(0.5, marks=pytest.mark.slow), 0.9, 0.97])
def test_the_excess_of_autoregressive_scores(memory):
    rng, n, found = np.random.default_rng(1), 6000, []
    for _ in range(30):
        noise = rng.standard_normal((n, 3)) * np.sqrt(1.0 - memory**2)
        scores = lfilter([1.0], [1.0, -memory], noise, axis=0, zi=memory * rng.standard_normal((1, 3)))[0]
        found.append(excess_of([scores / np.sqrt(n)])[0])
    # variance of a mean: (1 + rho)/(1 - rho) times that of independent samples
    assert np.mean(found) == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.1)


def narrow(n, low, high, fs, rng):
    """Unit noise between two frequencies."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    frequency = np.fft.rfftfreq(n, 1.0 / fs)
    spectrum[(frequency < low) | (frequency > high)] = 0.0
    values = np.fft.irfft(spectrum, n)
    return values / values.std()


def quietly(record):
    few = "x, v, u, x**2, x*v, v**2, x**3, x**2*v, x*v**2, v**3, v*abs(v)"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=few, holdout=0.0)[0]


@pytest.mark.statistical(short=2, full=3)
def test_narrow_noise_widens_intervals_until_they_hold(number):
    truth, covered, total = {"x": -1000.0, "v": -2.0, "u": 1.0}, 0, 0
    for seed in range(number):
        clean, rng = bq.simulate("linear", n=2000, seed=seed, noise=0.0), np.random.default_rng([seed, 9])
        noisy = {name: y + 0.02 * y.std() * narrow(2000, 4.2, 6.0, clean.fs, rng) for name, y in clean.channels.items()}
        eq = quietly(bq.Record.from_arrays(noisy, fs=clean.fs))
        record = eq.fit.regression.record
        assert record.fitted.power < 0.2
        assert eq.verdict.kind != "found"
        assert set(eq.included) == set(truth)  # without the power x**3 and x*v**2 are certain in the second record
        for term, value in truth.items():
            low, high = eq.shown_ci95[[one.text for one in eq.terms].index(term)]
            covered, total = covered + (low <= value <= high), total + 1
    assert total == 3 * number
    assert covered >= fewest(total, 0.95)


def test_scores_are_the_derivatives_of_the_likelihood():
    record = bq.simulate("linear", n=600, seed=3, noise=0.05)
    found = quietly(record).fit.regression.record
    assert found.fitted.power == 1.0
    task, state = found.task, found.fitted.state
    precision = task.precision[task.number(state.chosen)]
    there = marginal(task.linearised(state), state, state.levels, precision)
    (filtered,) = there.filtered
    # at any deviation the sum of the samples' scores is the slope of the quadratic likelihood
    for delta in (np.zeros_like(there.delta), 3.0 * there.delta + 0.1):
        slope = filtered.product[1:, 0] - filtered.product[1:, 1:] @ delta
        scores = np.einsum("tk,tki->ti", *filtered.standardised(delta))
        np.testing.assert_allclose(scores.sum(axis=0), slope, rtol=1e-8, atol=1e-6 * abs(slope).max())
