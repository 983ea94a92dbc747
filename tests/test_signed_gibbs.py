"""Sampling where signs are known: its conditionals against their definitions, its posterior against averaging."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, special, stats

from bayeq import SpikeSlabBMA, SpikeSlabGibbs, SpikeSlabVB
from bayeq.errors import InputError
from bayeq.gram import Gram
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gibbs import sample_posterior, spike_slab_gibbs
from bayeq.inference.prior import Prior
from bayeq.inference.signs.gibbs import _rest, _scan_free, _scan_signed, doubled
from bayeq.inference.signs.halfline import draw_beyond, log_ndtr
from bayeq.inference.signs.truncation import signed_scores
from bayeq.inference.vb import spike_slab_vb
from tests import geweke, reference

# p_0 and v_s of the twins
P0, V = 0.3, 5.0


def small(seed, P=None, **options):
    """Few rows, much noise, correlated columns: terms and signs in doubt."""
    rng = np.random.default_rng(seed)
    P = P or int(rng.integers(3, 7))
    D, y, _ = reference.random_problem(rng, **({"n": 12, "rho": 0.8, "noise": 5.0, "active": 0.5} | options), P=P)
    signs = rng.choice([-1, 0, 1], size=P, p=[0.4, 0.2, 0.4])
    signs[:2] = [1, 0]
    return D, y, Prior(V, P0, 2.0, 2.0, signs=signs)


# ---------------------------------------------------------------------------------------------------------- half lines


def test_log_of_the_normal_distribution_function():
    x = np.concatenate([-np.geomspace(1e-3, 1e5, 200), np.linspace(-40.0, 10.0, 201), [0.0]])
    np.testing.assert_allclose([log_ndtr(t) for t in x], special.log_ndtr(x), rtol=1e-11)


@pytest.mark.parametrize("a", [-30.0, -0.5, 0.0, 0.2, 3.0, 1e4])
def test_normals_on_a_half_line(a):
    rng = np.random.default_rng(1)
    excess = np.array([draw_beyond(a, rng) for _ in range(4000)])
    assert (excess >= 0).all()
    # p(x > a + e)/p(x > a) of right draws is uniform; far out e is exponential of rate a to a share 1/a^2
    left = np.exp(-a * excess) if a > 100 else np.exp(special.log_ndtr(-a - excess) - special.log_ndtr(-a))
    assert stats.kstest(left, "uniform").pvalue > 1e-3


# --------------------------------------------------------------------------------------------------------- conditionals


def state(seed):
    """A problem, and somewhere a chain could be."""
    D, y, prior = small(seed, P=6)
    rng = np.random.default_rng(seed + 100)
    active = rng.random(6) < 0.6
    theta = np.where(active, prior.signs * rng.exponential(size=6), 0.0)
    return D, y, prior, doubled(Problem.of(Gram.from_data(D, y), prior)), active, theta, rng


@pytest.mark.parametrize("seed", range(6))
def test_indicators_of_free_terms_given_the_others(seed):
    D, y, prior, p, active, theta, rng = state(seed)
    held = prior.signs != 0

    def log_joint(z):
        # y less what is held, theta of the free terms and sigma^2 integrated out; theta held ~ N(0, sigma^2 v_s)
        rest, free = y - D[:, held] @ theta[held], z & ~held
        A = D[:, free].T @ D[:, free] + np.eye(free.sum()) / V
        b = D[:, free].T @ rest
        s = 2 * 2.0 + rest @ rest - b @ np.linalg.solve(A, b) + theta[held] @ theta[held] / V
        h = 2.0 + 0.5 * (len(y) - 1) + 0.5 * (z & held).sum()
        return -0.5 * np.linalg.slogdet(V * A)[1] - h * math.log(s) + z.sum() * special.logit(P0)

    Dty, T = _rest(p, active, theta)
    z, inclusion = active.copy(), np.zeros(6)
    _scan_free(p, Dty, T, z, rng, inclusion)
    current = active.copy()
    for j in np.flatnonzero(~held):
        inside, outside = current.copy(), current.copy()
        inside[j], outside[j] = True, False
        assert inclusion[j] == pytest.approx(special.expit(log_joint(inside) - log_joint(outside)), rel=1e-8)
        current[j] = z[j]
    np.testing.assert_array_equal(current, z)


@pytest.mark.parametrize("seed", range(6))
def test_terms_of_known_sign_given_the_others(seed):
    D, y, prior, p, active, theta, rng = state(seed)
    variance, free = 20.0, active & (prior.signs == 0)
    noise = stats.multivariate_normal(cov=variance * (np.eye(len(y)) + V * D[:, free] @ D[:, free].T))
    slab = stats.halfnorm(scale=math.sqrt(variance * V))
    _, T = _rest(p, active, theta)
    z, moved, inclusion = active.copy(), theta.copy(), np.zeros(6)
    _scan_signed(p, T, z, moved, variance, rng, inclusion)
    current = theta.copy()
    for j in np.flatnonzero(prior.signs):
        others = np.where(np.arange(6) == j, 0.0, current)
        rest = y - D[:, prior.signs != 0] @ others[prior.signs != 0]

        def ratio(t, j=j, rest=rest):
            return math.exp(noise.logpdf(rest - prior.signs[j] * t * D[:, j]) - noise.logpdf(rest)) * slab.pdf(t)

        odds = P0 / (1 - P0) * integrate.quad(ratio, 0, 40 * math.sqrt(variance), limit=200)[0]
        assert inclusion[j] == pytest.approx(odds / (1 + odds), rel=1e-6)
        current[j] = moved[j]
    assert (moved * prior.signs >= 0).all()
    np.testing.assert_array_equal(moved[prior.signs != 0] != 0, z[prior.signs != 0])
    # and the tableau has followed
    np.testing.assert_allclose(T.partial, _rest(p, z, moved)[1].partial, atol=1e-8 * np.abs(p.Dty).max())
    assert T.diagonal[-1] == pytest.approx(_rest(p, z, moved)[1].diagonal[-1], rel=1e-9)


def test_geweke_joint_distribution():
    signs = [1, -1, 0]
    scores, theta = geweke.scores(True, signs)
    # eleven tests of a t-distribution of 49 degrees of freedom: 4.2 is a family-wise error of one in a thousand
    assert np.max(np.abs(scores)) < 4.2
    assert (theta * signs >= 0).all()


# ------------------------------------------------------------------------------------------------------- the posterior


@pytest.mark.parametrize("exchange", [False, True], ids=["flips", "exchange"])
@pytest.mark.parametrize(("seed", "beta"), [(0, None), (1, None), (2, (1.0, 3.0)), (3, None)])
def test_chains_and_enumeration_agree(seed, beta, exchange):
    D, y, prior = small(seed)
    prior = Prior(V, P0, 2.0, 2.0, beta, signs=prior.signs)
    gram = Gram.from_data(D, y)
    exact, fit = (
        spike_slab_bma(gram, prior),
        spike_slab_gibbs(gram, prior, samples=11_000, exchange=exchange, seed=seed),
    )
    # 40,000 samples; 0.02 is some six standard errors of a mean of correlated draws
    np.testing.assert_allclose(fit.pip, exact.pip, atol=0.02)
    np.testing.assert_allclose(fit.draws.z.mean(axis=(0, 1)), exact.pip, atol=0.02)
    scale = exact.averaged_sd.max()
    np.testing.assert_allclose(fit.averaged_coef, exact.averaged_coef, atol=0.03 * scale)
    np.testing.assert_allclose(fit.averaged_sd, exact.averaged_sd, atol=0.05 * scale)
    assert fit.noise_variance == pytest.approx(exact.noise_variance, rel=0.03)
    assert (fit.draws.theta * prior.signs >= 0).all()
    np.testing.assert_array_equal(fit.draws.theta != 0, fit.draws.z)
    assert fit.rhat < 1.02


def test_a_forced_term_of_the_wrong_sign():
    # 2000 rows are 45 standard deviations on the other side: no draw without the signs is ever right
    rng = np.random.default_rng(0)
    D = rng.normal(size=(2000, 3))
    gram = Gram.from_data(D, 5.0 * D[:, 0] + D[:, 1] + 0.1 * rng.normal(size=2000))
    prior = Prior(prior_inclusion=[1.0, 0.1, 0.1], signs=[-1, 0, 0])
    exact, fit = spike_slab_bma(gram, prior), spike_slab_gibbs(gram, prior, samples=3000)
    np.testing.assert_allclose(fit.pip, exact.pip, atol=2e-3)
    # five standard errors of a mean of 8000 draws, nearly independent
    error = 5 * exact.averaged_sd / math.sqrt(8000)
    np.testing.assert_allclose(fit.averaged_coef, exact.averaged_coef, atol=error.max())
    assert fit.averaged_coef[0] == pytest.approx(exact.averaged_coef[0], abs=error[0])
    assert fit.coef.tobytes() == exact.coef.tobytes()
    theta, noise, _ = sample_average(Problem.of(gram, prior), exact.average, 1000, rng)
    assert (theta[:, 0] < 0).all()
    assert theta[:, 0].mean() == pytest.approx(exact.averaged_coef[0], abs=5 * exact.averaged_sd[0] / math.sqrt(1000))
    assert noise.mean() == pytest.approx(exact.noise_variance, rel=0.01)


def test_chains_are_reproducible_and_say_how_likely_their_models_are():
    D, y, prior = small(5)
    p = Problem.of(Gram.from_data(D, y), prior)
    one, two, other = (sample_posterior(p, samples=300, burn_in=100, chains=2, seed=s) for s in (1, 1, 2))
    assert one.theta.tobytes() == two.theta.tobytes()
    assert one.theta.tobytes() != other.theta.tobytes()
    for k in (0, 50, 199):
        expected = signed_scores(p, one.z[1, [k]], math.inf)[1][0]
        assert one.log_posterior[1, k] == pytest.approx(expected, abs=1e-2)


@pytest.mark.parametrize("seed", range(3))
def test_draws_of_the_average_have_its_moments(seed):
    D, y, prior = small(seed)
    gram = Gram.from_data(D, y)
    fit = spike_slab_bma(gram, prior)
    theta, noise, which = sample_average(Problem.of(gram, prior), fit.average, 20_000, np.random.default_rng(seed))
    assert (theta * prior.signs >= 0).all()
    np.testing.assert_array_equal(theta != 0, fit.average.models[which])
    # five standard errors of independent draws
    np.testing.assert_allclose(
        theta.mean(axis=0), fit.averaged_coef, atol=5 * fit.averaged_sd.max() / math.sqrt(20_000)
    )
    np.testing.assert_allclose(theta.std(axis=0), fit.averaged_sd, atol=0.05 * fit.averaged_sd.max())
    assert noise.mean() == pytest.approx(fit.noise_variance, rel=0.02)


# ---------------------------------------------------------------------------------------------------------- vb and auto


@pytest.mark.parametrize("seed", range(4))
def test_vb_with_signs_is_the_likeliest_model(seed):
    D, y, prior = small(seed)
    gram = Gram.from_data(D, y)
    fit, exact, auto = (engine(gram, prior) for engine in (spike_slab_vb, spike_slab_bma, spike_slab_auto))
    best = exact.average.models[0]
    np.testing.assert_array_equal(fit.support, best)
    np.testing.assert_array_equal(fit.pip, best)
    np.testing.assert_array_equal(auto.optimum, best)
    # ln p(y, z): (34) times 2^k P(signs right), the latter by draws
    z, N, rng = best, gram.dof, np.random.default_rng(seed)
    A = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / V)
    m = A @ D[:, z].T @ y
    rate = 2.0 + 0.5 * (y @ y - m @ D[:, z].T @ y)
    variance = rate / rng.gamma(2.0 + 0.5 * N, size=100_000)
    theta = m + np.sqrt(variance)[:, None] * (rng.normal(size=(100_000, z.sum())) @ np.linalg.cholesky(A).T)
    right = (theta * prior.signs[z] >= 0).all(axis=1)
    known = np.count_nonzero(prior.signs[z])
    expected = reference.log_evidence(D, y, z, v_s=V, p0=P0, a=2.0, b=2.0, N=N) + math.log(2.0**known * right.mean())
    assert fit.elbo == auto.elbo == pytest.approx(expected, abs=0.03)
    np.testing.assert_allclose(fit.coef[z], theta[right].mean(axis=0), atol=0.03 * max(fit.sd.max(), 1e-9))
    assert fit.noise_variance == pytest.approx(variance[right].mean(), rel=0.02)
    with pytest.raises(InputError, match="starts from a search"):
        spike_slab_vb(gram, prior, init="rvm")


def test_auto_samples_where_averaging_leaves_out_too_much(monkeypatch):
    D, y, prior = small(1)
    gram = Gram.from_data(D, y)
    averaged = spike_slab_auto(gram, prior)
    monkeypatch.setattr("bayeq.inference.auto.MOST_LEFT_OUT", -1.0)
    sampled = spike_slab_auto(gram, prior)
    assert sampled.average is None
    assert sampled.rhat < 1.1
    assert sampled.elbo == averaged.elbo
    # 16,000 samples: some six standard errors
    np.testing.assert_allclose(sampled.pip, averaged.pip, atol=0.03)


# ----------------------------------------------------------------------------------------------------------- estimators


def weak(seed=0, n=60):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(n, 4)) + 0.8 * rng.normal(size=(n, 1))
    return D * [1.0, 1e3, 1e-2, 1.0] + 3.0, D @ [1.0, 0.05, -0.05, 0.0] + rng.normal(size=n)


@pytest.mark.parametrize("estimator", [SpikeSlabBMA, SpikeSlabGibbs, SpikeSlabVB])
def test_estimators_keep_to_the_signs(estimator):
    D, y = weak()
    signs, p0 = np.array([0, -1, 1, 0]), [0.1, 1.0, 1.0, 0.1]
    free, fit = estimator(prior_inclusion=p0).fit(D, y), estimator(prior_inclusion=p0, signs=signs).fit(D, y)
    assert (free.coef_ * signs < 0).any()
    assert (fit.coef_ * signs >= 0).all()
    assert (fit.coef_[1:3] != 0).all()
    # half normals vary less than the normals that they are cut from
    assert np.all(np.diagonal(fit.covariance_)[1:3] < np.diagonal(free.covariance_)[1:3])
    mean, sd = fit.predict(D, return_std=True)
    assert np.isfinite(mean).all()
    assert np.all(sd > math.sqrt(fit.noise_variance_))
    with pytest.raises(InputError, match="signs must be"):
        estimator(signs=[1, 0]).fit(D, y)
    if estimator is SpikeSlabBMA:
        assert (fit.sample(500)[0] * signs >= 0).all()
    if estimator is SpikeSlabGibbs:
        assert (fit.draws_.theta * signs >= 0).all()
    # the other way round
    turned = estimator(prior_inclusion=p0, signs=-signs).fit(-D, y)
    np.testing.assert_allclose(turned.coef_, -fit.coef_, rtol=1e-6, atol=1e-12)
