from __future__ import annotations

import numpy as np
import pytest

from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm, rvm_ascent
from tests import reference


def fitted(seed, **options):
    D, y, truth = reference.random_problem(np.random.default_rng(seed), **options)
    gram = Gram.from_data(D, y)
    gamma, T, noise, _, converged = rvm_ascent(Problem.of(gram, Prior()), 10_000)
    assert converged
    kept = gamma > 0
    lam = np.full(len(gamma), np.inf)
    variance = -T.diagonal[:-1]
    lam[kept] = (1 - gamma[kept]) / variance[kept]
    return D, y, gram, gamma, lam / noise, noise, truth


@pytest.mark.parametrize("seed", range(30))
def test_ends_at_a_maximum_of_the_marginal_likelihood(seed):
    # Tipping and Faul: every term is added, re-estimated or deleted until no single change raises ln p(y | alpha, s2)
    D, y, gram, _, alpha, noise, _ = fitted(seed)

    def value(a, s2):
        return reference.rvm_log_marginal(D, y, a, s2, N=gram.dof)

    top = value(alpha, noise)
    for factor in (0.9, 1.1):
        assert value(alpha, noise * factor) <= top + 1e-5
    for j in range(len(alpha)):
        if np.isfinite(alpha[j]):
            changes = [alpha[j] * 0.7, alpha[j] * 1.4, np.inf]
        else:
            changes = np.geomspace(1e-4, 1e6, 23) * np.sum(D[:, j] ** 2) / noise / len(y)
        for change in changes:
            other = alpha.copy()
            other[j] = change
            assert value(other, noise) <= top + 1e-5


@pytest.mark.parametrize("seed", range(10))
def test_posterior_is_the_ridge_posterior_of_its_alphas(seed):
    D, y, gram, gamma, alpha, noise, _ = fitted(seed)
    fit = rvm(gram)
    kept = fit.support
    Sigma = np.linalg.inv(D[:, kept].T @ D[:, kept] / noise + np.diag(alpha[kept]))
    np.testing.assert_allclose(fit.covariance, Sigma, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(fit.coef[kept], Sigma @ D[:, kept].T @ y / noise, rtol=1e-5)
    np.testing.assert_allclose(gamma[kept], 1 - alpha[kept] * np.diag(Sigma), rtol=1e-4, atol=1e-6)
    # the fixed point of the noise: s2 (N - sum gamma) = ||y - D mu||^2 (Tipping 2001, eq. (18))
    residual = y - D @ fit.coef
    assert noise * (gram.dof - gamma.sum()) == pytest.approx(residual @ residual, rel=1e-2)


def test_keeps_the_true_terms_and_adds_false_ones():
    found = false = 0
    for seed in range(60):
        _, _, gram, _, _, _, truth = fitted(seed, n=400, P=10, rho=0.5, noise=0.1)
        support = rvm(gram).support
        found += int(support[truth].sum())
        false += int(support[~truth].sum())
    assert found > 100
    assert false > 20  # the Student-t prior's false discoveries, the paper's motive


def test_least_gamma_takes_weak_terms_out():
    for seed in range(40):
        D, y, gram, gamma, alpha, noise, _ = fitted(seed)
        weak = (gamma > 0) & (gamma <= 0.5)
        if weak.any():
            break
    fit = rvm(gram, least_gamma=0.5)
    np.testing.assert_array_equal(fit.support, gamma > 0.5)
    kept = fit.support
    Sigma = np.linalg.inv(D[:, kept].T @ D[:, kept] / noise + np.diag(alpha[kept]))
    np.testing.assert_allclose(fit.coef[kept], Sigma @ D[:, kept].T @ y / noise, rtol=1e-5)
    assert not fit.coef[~kept].any()
