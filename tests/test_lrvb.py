from __future__ import annotations

import itertools
import math
import warnings

import numpy as np
import pytest
from scipy.special import digamma, expit, logit, polygamma

from bayeq import SpikeSlabVB
from bayeq.errors import ConvergenceWarning, InputError
from bayeq.gram import Gram
from bayeq.inference import lrvb
from bayeq.inference.collapsed.conditional import given_model
from bayeq.inference.collapsed.problem import Columns, Problem
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.lrvb import linear_response
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from tests import reference

# Sweeps on until the ELBO no longer rises: the fixed point to about 1e-7.
EXACTLY = {"tolerance": 1e-13, "max_iter": 100_000}


def random_gram(seed, **options):
    """Few rows, weak signals and narrow slabs: VB's optimum then often leaves terms undecided."""
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, n=int(rng.integers(8, 50)), P=int(rng.integers(2, 7)), noise=1.0)
    P = D.shape[1]
    p0 = rng.uniform(0.1, 0.7, size=P)
    p0[rng.random(P) < 0.1] = 1.0
    p0[rng.random(P) < 0.1] = 0.0
    prior = Prior(10 ** rng.uniform(-1.5, 0.5), p0, noise_shape=0.3, noise_rate=0.7, **options)
    return Gram.from_data(D, y), prior


def undecided(fit):
    return bool(np.any((fit.pip > 0.05) & (fit.pip < 0.95)))


def fits(gram, prior, **options):
    return (spike_slab_vb(gram, prior, covariance=c, **options) for c in ("mean-field", "lrvb"))


def perturbed_mean(gram, prior, w, tau, t):
    """mu at the optimum of VB with t'theta added to the log joint: eqs. (20)-(26) with t, run until nothing moves."""
    G, g, P = gram.DtD, gram.Dty, len(gram.Dty)
    beta = prior.inclusion_beta
    p0 = np.broadcast_to(prior.prior_inclusion, P)
    free = (p0 > 0) & (p0 < 1)
    with np.errstate(divide="ignore"):
        log_odds = logit(p0)
    a_q = prior.noise_shape + 0.5 * gram.dof + 0.5 * P
    w, before = w.copy(), np.inf
    for _ in range(100_000):
        A = G * (np.outer(w, w) + np.diag(w * (1 - w))) + np.eye(P) / prior.slab_variance
        Sigma = np.linalg.inv(tau * A)
        mu = Sigma @ (tau * w * g + t)
        second = np.outer(mu, mu) + Sigma
        tau = a_q / (prior.noise_rate + 0.5 * (gram.yty - 2 * mu @ (w * g) + np.sum(A * second)))
        if beta is not None:
            log_odds[free] = digamma(beta[0] + w[free].sum()) - digamma(beta[1] + (1 - w[free]).sum())
        for i in range(P):
            if free[i]:
                rest = sum(w[j] * G[i, j] * second[i, j] for j in range(P) if j != i)
                w[i] = expit(log_odds[i] - 0.5 * tau * second[i, i] * G[i, i] + tau * (mu[i] * g[i] - rest))
        state = np.concatenate((w, mu, [tau]))
        if np.max(np.abs(state - before)) < 1e-13 * (1 + np.max(np.abs(state))):
            return mu
        before = state
    raise AssertionError("the perturbed ascent does not converge")


def sensitivity(gram, prior, fit, step=2e-4, most=None):
    """d mu/dt of the selected terms by central differences of whole ascents; mu_i moves by `step` of its sd.

    With respect to the t of all of them, or of the first `most`.
    """
    kept = np.flatnonzero(fit.support)
    columns = []
    for i in kept[:most]:
        t = np.zeros(len(fit.pip))
        t[i] = step / fit.sd[i]
        up, down = (perturbed_mean(gram, prior, fit.pip, 1 / fit.noise_variance, s * t) for s in (1, -1))
        columns.append((up - down)[kept] / (2 * t[i]))
    return np.array(columns).T


@pytest.mark.parametrize("options", [{}, {"inclusion_beta": (1.0, 2.0)}], ids=["given p_0", "p_0 ~ Beta"])
def test_is_the_sensitivity_of_the_mean_to_a_perturbed_log_joint(options):
    compared = corrected = 0
    for seed in range(100):
        gram, prior = random_gram(seed, **options)
        plain, fit = fits(gram, prior, **EXACTLY)
        if not fit.support.any():
            continue
        expected = sensitivity(gram, prior, fit)
        np.testing.assert_allclose(fit.covariance, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
        compared += 1
        corrected += bool(np.any(np.abs(plain.covariance - expected) > 1e-2 * np.abs(expected).max()))
    # it is no comparison of mean-field with itself
    assert compared >= 60
    assert corrected >= 20


def theta_given_w(gram, prior, fit):
    """Mean and covariance of q(theta), eqs. (20)-(21)."""
    w = fit.pip
    A = gram.DtD * (np.outer(w, w) + np.diag(w * (1 - w))) + np.eye(len(w)) / prior.slab_variance
    return np.linalg.solve(A, w * gram.Dty), np.linalg.inv(A) * fit.noise_variance


def moments_of_theta(mu, Sigma):
    """Covariance under N(mu, Sigma) of the statistics theta_i, then theta_i theta_j for i <= j."""
    P = len(mu)
    pairs = list(itertools.combinations_with_replacement(range(P), 2))
    V = np.zeros((P + len(pairs), P + len(pairs)))
    V[:P, :P] = Sigma
    for a, (i, j) in enumerate(pairs, start=P):
        V[:P, a] = V[a, :P] = mu[i] * Sigma[:, j] + mu[j] * Sigma[:, i]
        for b, (k, m) in enumerate(pairs, start=P):
            V[a, b] = Sigma[i, k] * Sigma[j, m] + Sigma[i, m] * Sigma[j, k]
            V[a, b] += mu[i] * (mu[k] * Sigma[j, m] + mu[m] * Sigma[j, k])
            V[a, b] += mu[j] * (mu[k] * Sigma[i, m] + mu[m] * Sigma[i, k])
    return V, pairs


def by_definition(gram, prior, fit, mu, Sigma):
    """(I - V H)^-1 V over theta, theta theta', 1/sigma^2, ln sigma^2, z and the logarithms of p_0 and 1 - p_0."""
    G, g, P = gram.DtD, gram.Dty, len(gram.Dty)
    w, tau = fit.pip, 1 / fit.noise_variance
    of_theta, pairs = moments_of_theta(mu, Sigma)
    T = len(of_theta)
    free = np.isfinite(prior.log_odds(P))
    size = T + 2 + P + 2
    V = np.zeros((size, size))
    V[:T, :T] = of_theta
    a_q = prior.noise_shape + 0.5 * gram.dof + 0.5 * P
    b_q = a_q / tau
    V[T : T + 2, T : T + 2] = [[a_q / b_q**2, -1 / b_q], [-1 / b_q, polygamma(1, a_q)]]
    V[T + 2 : T + 2 + P, T + 2 : T + 2 + P] = np.diag(w * (1 - w))
    if prior.inclusion_beta is not None:
        a = prior.inclusion_beta[0] + w[free].sum()
        b = prior.inclusion_beta[1] + (1 - w[free]).sum()
        V[-2:, -2:] = np.diag([polygamma(1, a), polygamma(1, b)]) - polygamma(1, a + b)

    def f(m):
        """E_q ln joint as a function of the moments: linear in each of them."""
        theta, second = m[:P], np.empty((P, P))
        for (i, j), value in zip(pairs, m[P:T], strict=True):
            second[i, j] = second[j, i] = value
        precision, log_s2, z = m[T], m[T + 1], m[T + 2 : T + 2 + P]
        Omega = np.outer(z, z)
        np.fill_diagonal(Omega, z)
        misfit = gram.yty - 2 * theta @ (z * g) + np.sum(G * Omega * second)
        value = -0.5 * precision * (misfit + np.trace(second) / prior.slab_variance + 2 * prior.noise_rate)
        value -= (0.5 * gram.dof + 0.5 * P + prior.noise_shape + 1) * log_s2
        if prior.inclusion_beta is not None:
            value += z[free].sum() * m[-2] + (1 - z[free]).sum() * m[-1]
        return value

    second = np.outer(mu, mu) + Sigma
    m = np.concatenate((mu, [second[pair] for pair in pairs], [tau, 0.3], w, [-0.5, -0.9]))
    unit = np.eye(size)
    H = np.zeros((size, size))
    for i, j in itertools.combinations(range(size), 2):
        # a mixed difference of any step is the mixed derivative of a function linear in either
        H[i, j] = H[j, i] = f(m + unit[i] + unit[j]) - f(m + unit[i]) - f(m + unit[j]) + f(m)
    return np.linalg.solve(np.eye(size) - V @ H, V)[:P, :P]


@pytest.mark.parametrize("options", [{}, {"inclusion_beta": (1.0, 2.0)}], ids=["given p_0", "p_0 ~ Beta"])
def test_is_the_definition_over_all_moments(options):
    compared = 0
    for seed in range(100):
        gram, prior = random_gram(seed, **options)
        fit = spike_slab_vb(gram, prior, covariance="lrvb", **EXACTLY)
        if not (fit.support.any() and undecided(fit)):
            continue
        expected = by_definition(gram, prior, fit, *theta_given_w(gram, prior, fit))
        kept = np.ix_(fit.support, fit.support)
        np.testing.assert_allclose(fit.covariance, expected[kept], rtol=1e-5, atol=1e-5 * np.abs(expected).max())
        compared += 1
    assert compared >= 20


def test_adds_to_the_mean_field_covariance_and_changes_nothing_else():
    for seed in range(300):
        gram, prior = random_gram(seed)
        plain, fit = fits(gram, prior)
        np.testing.assert_array_equal(fit.coef, plain.coef)
        np.testing.assert_array_equal(fit.pip, plain.pip)
        assert fit.elbo == plain.elbo
        assert fit.noise_variance == plain.noise_variance
        assert fit.covariance.shape == plain.covariance.shape
        if fit.support.any():
            np.testing.assert_array_equal(fit.covariance, fit.covariance.T)
            assert np.linalg.eigvalsh(fit.covariance)[0] > 0
            scale = np.sqrt(np.outer(np.diagonal(plain.covariance), np.diagonal(plain.covariance)))
            assert np.linalg.eigvalsh((fit.covariance - plain.covariance) / scale)[0] > -1e-12
            assert np.all(fit.sd >= plain.sd)


def test_many_active_terms():
    # 60 terms, none of them decided: the moments of theta theta' alone are 1830
    rng = np.random.default_rng(0)
    D = rng.normal(size=(100, 60))
    y = D @ (0.2 * rng.normal(size=60)) + rng.normal(size=100)
    gram, prior = Gram.from_data(D, y), Prior(slab_variance=0.03, prior_inclusion=0.5)
    plain, fit = fits(gram, prior, init=np.full(60, 0.7), **EXACTLY)
    assert np.sum((fit.pip > 0.05) & (fit.pip < 0.95)) > 30
    expected = sensitivity(gram, prior, fit, most=5)
    np.testing.assert_allclose(fit.covariance[:, :5], expected, rtol=1e-4, atol=1e-4 * expected.max())
    assert np.max(np.diagonal(fit.covariance) / np.diagonal(plain.covariance)) > 1.1


@pytest.mark.parametrize("seed", range(10))
def test_decided_terms_leave_the_mean_field_covariance_which_is_the_exact_one_but_for_its_tails(seed):
    # All terms forced in, the exact posterior of theta is a multivariate t: location A^-1 D'y and covariance
    # s/(2h - 2) A^-1. Mean-field VB has s/(2h) A^-1. The location does not depend on sigma^2, so neither does mu on
    # tau, and linear response has nothing to add: both fall short of the exact covariance by the same 1 - 1/h.
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, n=int(rng.integers(10, 60)), P=4)
    gram, prior = Gram.from_data(D, y), Prior(2.0, 1.0, 0.3, 0.7)
    plain, fit = fits(gram, prior, **EXACTLY)
    np.testing.assert_array_equal(fit.covariance, plain.covariance)
    mean, exact = given_model(Problem.of(gram, prior), np.ones(4, dtype=bool))
    h = prior.noise_shape + 0.5 * gram.dof
    np.testing.assert_allclose(fit.coef, mean, rtol=1e-8)
    np.testing.assert_allclose(fit.covariance, (1 - 1 / h) * exact, rtol=1e-6)
    # and perturbed ascents agree
    np.testing.assert_allclose(fit.covariance, sensitivity(gram, prior, fit), rtol=1e-5, atol=1e-8)


def pair(seed, n=50, rho=0.6):
    """A sure term, a partner correlated with it that is 0 to 3 standard errors large, and a bystander."""
    rng = np.random.default_rng(seed)
    weak = rng.uniform(0, 3) / math.sqrt(n * (1 - rho**2))
    D = rng.normal(size=(n, 3))
    D[:, 1] = rho * D[:, 0] + math.sqrt(1 - rho**2) * D[:, 1]
    D = (D - D.mean(axis=0)) / D.std(axis=0)
    y = 2 * D[:, 0] + weak * D[:, 1] + rng.normal(size=n)
    return Gram.from_data(D, y - y.mean())


def gibbs_against(slab_variance, samples):
    """sd of the sure term as shares of Gibbs's, mean-field and by linear response, in 25 problems.

    The first 25 in which the PIP of the partner is between 0.2 and 0.8 by Gibbs.
    """
    prior = Prior(slab_variance=slab_variance, prior_inclusion=0.5)
    rows, seeds = [], itertools.count()
    while len(rows) < 25:
        seed = next(seeds)
        gram = pair(seed)
        gibbs = spike_slab_gibbs(gram, prior, samples=samples, burn_in=500, seed=seed, keep_draws=False)
        if 0.2 < gibbs.pip[1] < 0.8:
            rows.append([fit.sd[0] / gibbs.averaged_sd[0] for fit in fits(gram, prior)])
    return np.array(rows).T


def test_is_nearer_to_gibbs_than_mean_field_where_a_narrow_slab_leaves_terms_undecided():
    # 4 chains of 4500 samples know a standard deviation to about 1 %
    mean_field, response = gibbs_against(slab_variance=0.1, samples=5000)
    nearer = np.abs(np.log(response)) < np.abs(np.log(mean_field))
    assert nearer.sum() >= 22
    assert np.median(mean_field) < 0.95
    assert 0.97 < np.median(response) < 1.03


def test_is_blind_where_a_wide_slab_decides_terms():
    # the paper's v_s = 10: VB decides what the posterior leaves open, and nothing near its optimum says so
    mean_field, response = gibbs_against(slab_variance=10.0, samples=2000)
    assert np.median(mean_field) < 0.95
    assert np.median(response / mean_field) < 1.01


def test_an_ascent_that_stopped_short_of_a_maximum_is_told_and_bounded(monkeypatch):
    rng = np.random.default_rng(1)
    x = rng.normal(size=40)
    D = np.column_stack([x, x + 0.01 * rng.normal(size=40)])
    gram = Gram.from_data(D, x + 0.3 * rng.normal(size=40))
    init = np.array([0.6, 0.6])
    plain = spike_slab_vb(gram, init=init, max_iter=1)
    added = []
    for least in (1e-2, 1e-3):
        monkeypatch.setattr(lrvb, "LEAST_CURVATURE", least)
        with pytest.warns(ConvergenceWarning, match="maximum"):
            added.append(spike_slab_vb(gram, init=init, max_iter=1, covariance="lrvb").covariance - plain.covariance)
    # a direction that counts as having the least curvature adds in inverse proportion to it
    assert np.max(added[1]) == pytest.approx(10 * np.max(added[0]), rel=1e-2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        spike_slab_vb(gram, init=init, covariance="lrvb")


def test_computes_the_columns_that_are_not_there_yet():
    gram, prior = pair(1), Prior(slab_variance=0.1, prior_inclusion=0.5)
    fit = spike_slab_vb(gram, prior)
    assert undecided(fit)
    mean, sigma = theta_given_w(gram, prior, fit)
    problem = Problem.of(gram, prior)
    # any D with this Gram will do: a square root of it
    root = np.linalg.cholesky(gram.DtD).T.copy()
    none_yet = Columns(np.diagonal(gram.DtD).copy(), np.empty((3, 3)), np.full(3, -1), np.zeros(1, np.int64), root)
    whole, lazy = (
        linear_response(p, fit.pip, mean, sigma, np.arange(3), 1 / fit.noise_variance)
        for p in (problem, problem._replace(columns=none_yet))
    )
    np.testing.assert_allclose(lazy, whole, rtol=1e-9)


def test_the_estimator_gives_it_in_original_units():
    rng = np.random.default_rng(5)
    D = rng.normal(size=(40, 4))
    y = D @ [1.0, 0.25, 0.0, 0.2] + rng.normal(size=40)
    options = {"slab_variance": 0.1, "prior_inclusion": 0.5, "covariance": "lrvb"}
    plain = SpikeSlabVB(slab_variance=0.1, prior_inclusion=0.5).fit(D, y)
    fit = SpikeSlabVB(**options).fit(D, y)
    scaled = SpikeSlabVB(**options).fit(1e3 * D, y)
    assert np.max(np.diagonal(fit.covariance_) / np.diagonal(plain.covariance_)) > 1.01
    np.testing.assert_array_equal(scaled.support_, fit.support_)
    np.testing.assert_allclose(1e3 * scaled.posterior_.sd, fit.posterior_.sd, rtol=1e-8)
    np.testing.assert_allclose(1e6 * scaled.covariance_, fit.covariance_, rtol=1e-8)
    assert fit.get_params()["covariance"] == "lrvb"


def test_an_unknown_covariance_is_refused():
    gram, prior = random_gram(0)
    with pytest.raises(InputError, match=r"covariance must be .*'LRVB'"):
        spike_slab_vb(gram, prior, covariance="LRVB")
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="covariance"):
        SpikeSlabVB(covariance="laplace").fit(rng.normal(size=(20, 2)), rng.normal(size=20))
