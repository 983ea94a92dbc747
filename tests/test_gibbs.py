from __future__ import annotations

import math

import numpy as np
import pytest

from bayeq.errors import InputError
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import greedy_start
from bayeq.inference.gibbs import multivariate_rhat, sample_chain, sample_posterior, spike_slab_gibbs
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from tests import reference

BOTH = pytest.mark.parametrize("exchange", [False, True], ids=["paper", "exchange"])


def problem(seed, prior=None, **options):
    D, y, _ = reference.random_problem(np.random.default_rng(seed), **options)
    return D, y, Problem.of(Gram.from_data(D, y), prior or Prior())


@BOTH
@pytest.mark.parametrize("seed", range(5))
def test_pips_equal_enumeration(seed, exchange):
    D, y, _ = problem(seed, n=40, P=7, rho=0.8, noise=2.0)
    gram = Gram.from_data(D, y)
    fit = spike_slab_gibbs(gram, samples=20_000, exchange=exchange, seed=seed)
    exact = reference.enumerate_models(D, y, N=gram.dof)[3]
    # 76,000 samples; 0.02 is some ten standard errors of a mean of correlated draws
    np.testing.assert_allclose(fit.pip, exact, atol=0.02)
    np.testing.assert_allclose(fit.draws.z.mean(axis=(0, 1)), exact, atol=0.02)
    assert fit.details.rhat < 1.02
    assert fit.details.converged


@BOTH
def test_draws_of_theta_and_noise_have_the_exact_moments(exchange):
    D, y, p = problem(1, Prior(noise_shape=3.0, noise_rate=3.0), n=25, P=4, rho=0.7, noise=1.5)
    draws = sample_posterior(p, samples=40_000, burn_in=500, exchange=exchange, seed=5)
    models, logs, total, _ = reference.enumerate_models(D, y, a=3.0, b=3.0, N=p.dof)
    mean, second, noise = np.zeros(4), np.zeros((4, 4)), 0.0
    for z, weight in zip(models, np.exp(logs - total), strict=True):
        A = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / p.slab_variance)
        a = A @ D[:, z].T @ y
        rate = 3.0 + 0.5 * (y @ y - a @ np.linalg.solve(A, a)) if z.any() else 3.0 + 0.5 * y @ y
        variance = rate / (p.h - 1)  # of sigma^2 ~ IG(h, rate)
        mean[z] += weight * a
        second[np.ix_(z, z)] += weight * (np.outer(a, a) + variance * A)
        noise += weight * variance
    theta = draws.theta.reshape(-1, 4)
    np.testing.assert_allclose(theta.mean(axis=0), mean, atol=0.01 * np.sqrt(np.diag(second)).max())
    # flips alone mix slowly between the two correlated columns
    tolerance = 0.02 if exchange else 0.1
    np.testing.assert_allclose(theta.T @ theta / len(theta), second, atol=tolerance * np.abs(second).max())
    assert draws.noise_variance.mean() == pytest.approx(noise, rel=0.02)
    assert np.all((theta == 0) == ~draws.z.reshape(-1, 4))


def slow_twin(D, y, prior, sweeps, rng):
    """Eqs. (33)-(34) as printed: every probability from whole evidences; returns the draws of z."""
    P = D.shape[1]
    z = np.zeros(P, dtype=bool)
    out = np.empty((sweeps, P), dtype=bool)
    for t in range(sweeps):
        for i in range(P):
            logs = []
            for value in (False, True):
                z[i] = value
                logs.append(reference.log_evidence(D, y, z, N=len(y) - 1, **prior))
            z[i] = rng.random() < 1 / (1 + math.exp(logs[0] - logs[1]))
        out[t] = z
    return out


def test_same_random_numbers_same_models_as_the_slow_twin():
    D, y, p = problem(2, n=30, P=5, rho=0.5, noise=2.0)
    sweeps = 300
    expected = slow_twin(D, y, {}, sweeps, Replay(3, p, sweeps))
    z, theta, noise, level, pip = (
        np.empty((sweeps + 1, 5), dtype=bool),
        np.empty((sweeps + 1, 5)),
        *np.empty((2, sweeps + 1)),
        np.zeros(5),
    )
    rng = np.random.Generator(np.random.PCG64(3))
    sample_chain(p, np.zeros(5, dtype=bool), 1.0, 0, False, rng, z, theta, noise, level, pip)
    np.testing.assert_array_equal(z[1:], expected)
    for k in (0, 7, 100):
        full = reference.log_evidence(D, y, z[k], N=len(y) - 1)
        first = reference.log_evidence(D, y, z[0], N=len(y) - 1)
        assert level[k] - level[0] == pytest.approx(full - first, abs=1e-8)


class Replay:
    """The uniform numbers that `sample_chain` spends on indicators, its draws of theta and sigma^2 skipped."""

    def __init__(self, seed, p, sweeps):
        rng = np.random.Generator(np.random.PCG64(seed))
        z, theta = np.empty((sweeps + 1, 5), dtype=bool), np.empty((sweeps + 1, 5))
        noise, level, pip = np.empty(sweeps + 1), np.empty(sweeps + 1), np.zeros(5)
        sample_chain(p, np.zeros(5, dtype=bool), 1.0, 0, False, rng, z, theta, noise, level, pip)
        rng = np.random.Generator(np.random.PCG64(seed))
        self.numbers = []
        for t in range(sweeps):
            if t > 0:
                rng.standard_gamma(p.h)
            rng.standard_normal(int(z[t].sum()))
            self.numbers.extend(rng.random(5))
        self.numbers = iter(self.numbers)

    def random(self):
        return next(self.numbers)


def test_exchange_carries_chains_between_twins():
    # two nearly equal columns of which one is needed: single flips must pass through a model with both or neither,
    # which this prior makes rare
    rng = np.random.default_rng(0)
    x = rng.normal(size=200)
    D = np.column_stack([x, x + 0.05 * rng.normal(size=200), rng.normal(size=200)])
    gram = Gram.from_data(D, x + 0.025 * D[:, 1] + 1.0 * rng.normal(size=200)).standardise().gram
    prior = Prior(prior_inclusion=1e-7)
    flips = []
    for exchange in (False, True):
        fit = spike_slab_gibbs(gram, prior, exchange=exchange, samples=3000, burn_in=500)
        flips.append(np.abs(np.diff(fit.draws.z[:, :, 0].astype(int), axis=1)).sum())
    assert flips[0] < 10
    assert flips[1] > 200
    assert fit.pip[:2].sum() == pytest.approx(1.0, abs=1e-3)
    assert fit.pip[:2].min() > 0.05


def test_start_activates_what_lowers_the_error_most():
    D, y, p = problem(4, n=80, P=6, rho=0.4)
    for size in range(4):
        active = greedy_start(p, size)
        assert active.sum() == size
    best = [np.linalg.lstsq(D[:, [j]], y, rcond=None)[1][0] for j in range(6)]
    assert greedy_start(p, 1)[int(np.argmin(best))]


def test_chains_are_reproducible_and_independent():
    _, _, p = problem(5, P=6)
    a, b, c = (sample_posterior(p, samples=200, burn_in=50, seed=s) for s in (1, 1, 2))
    assert a.theta.tobytes() == b.theta.tobytes()
    assert a.theta.tobytes() != c.theta.tobytes()
    assert a.theta[0].tobytes() != a.theta[1].tobytes()
    fewer = sample_posterior(p, samples=200, burn_in=50, seed=1, chains=2)
    assert fewer.theta.tobytes() == a.theta[:2].tobytes()


def test_forced_and_forbidden_terms_stay():
    D, y, _ = reference.random_problem(np.random.default_rng(4), P=5)
    fit = spike_slab_gibbs(
        Gram.from_data(D, y), Prior(prior_inclusion=[0.1, 1.0, 0.0, 0.1, 0.1]), samples=300, burn_in=50
    )
    assert fit.draws.z[..., 1].all()
    assert not fit.draws.z[..., 2].any()
    assert fit.pip[1] == 1
    assert fit.pip[2] == 0


@pytest.mark.parametrize("options", [{"chains": 0}, {"samples": 10, "burn_in": 10}, {"burn_in": -1}])
def test_lengths_out_of_range(options):
    _, _, p = problem(0)
    with pytest.raises(InputError, match="chains"):
        sample_posterior(p, **options)


# R-hat ----------------------------------------------------------------------------------------------------------------


def rhat_by_definition(theta):
    """Brooks and Gelman (1998), section 4.1: the largest eigenvalue of W^-1 B/n, general eigensolver."""
    m, n, _ = theta.shape
    W = np.mean([np.cov(chain, rowvar=False) for chain in theta], axis=0)
    B_n = np.cov(theta.mean(axis=1), rowvar=False)
    top = np.linalg.eigvals(np.linalg.solve(W, B_n)).real.max()
    return math.sqrt((n - 1) / n + (m + 1) / m * top)


def test_rhat_equals_its_definition():
    rng = np.random.default_rng(0)
    theta = rng.normal(size=(4, 500, 3)) @ rng.normal(size=(3, 3)) + 0.3 * rng.normal(size=(4, 1, 3))
    assert multivariate_rhat(theta) == pytest.approx(rhat_by_definition(theta), rel=1e-9)
    # units do not matter, nor do terms that are never in
    wide = np.concatenate([theta * [1e-9, 1.0, 1e9], np.zeros((4, 500, 2))], axis=2)
    assert multivariate_rhat(wide) == pytest.approx(rhat_by_definition(theta), rel=1e-6)


def test_rhat_of_chains_that_agree_that_differ_and_that_stand_still():
    rng = np.random.default_rng(1)
    assert multivariate_rhat(rng.normal(size=(4, 4000, 2))) < 1.01
    apart = rng.normal(size=(4, 1000, 2)) + np.arange(4)[:, None, None]
    assert multivariate_rhat(apart) > 1.5
    assert multivariate_rhat(np.zeros((4, 10, 2))) == 1.0
    assert multivariate_rhat(np.ones((4, 10, 2))) == 1.0
    still = np.ones((2, 10, 1))
    still[1] = 2.0
    assert math.isinf(multivariate_rhat(still))
    assert multivariate_rhat(rng.normal(size=(1, 10, 2))) == 1.0
