from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from scipy import stats

from bayeq import SpikeSlabBMA
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.bma import _possible, sample_average, spike_slab_bma
from bayeq.inference.collapsed.listing import enumerate_models, search_models
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import log_constant
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import MOVED
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from tests import reference


def problem(seed, prior=None, **options):
    D, y, _ = reference.random_problem(np.random.default_rng(seed), **options)
    return D, y, Problem.of(Gram.from_data(D, y), prior or Prior())


@pytest.mark.parametrize("seed", range(10))
def test_enumeration_by_gray_code_equals_the_reference(seed):
    D, y, p = problem(seed, P=8)
    models, logs, _, exact = reference.enumerate_models(D, y, N=p.dof)
    found = enumerate_models(p)
    order = np.argsort(-logs)[:20]
    np.testing.assert_allclose(found.log_posterior[:20] + log_constant(p), logs[order], rtol=1e-9, atol=1e-8)
    np.testing.assert_array_equal(found.models[0], models[order[0]])
    np.testing.assert_allclose(found.weights @ found.models, exact, atol=1e-9)
    assert found.left_out == 0.0


def test_search_is_within_1e_3_of_enumeration_and_its_bound_holds():
    # the problems of the acceptance criterion: P = 16, correlations up to 0.98
    for seed in range(40):
        _, _, p = problem(seed, P=16)
        full, found = enumerate_models(p), search_models(p)
        error = np.abs(full.weights @ full.models - found.weights @ found.models).max()
        assert error < 1e-3, seed
        reference_mass = np.exp(full.log_posterior - full.log_posterior[0]).sum()
        left = 1.0 - np.exp(found.log_posterior - full.log_posterior[0]).sum() / reference_mass
        assert left <= found.left_out + 1e-9, seed
        assert found.left_out <= 5e-3


def test_no_model_is_found_twice_and_scores_are_right():
    D, y, p = problem(3, P=12)
    found = search_models(p, tolerance=1e-6)
    assert len({model.tobytes() for model in found.models}) == len(found.models)
    assert np.all(np.diff(found.log_posterior) <= 0)
    for k in (0, 5, len(found.models) - 1):
        expected = reference.log_evidence(D, y, found.models[k], N=p.dof)
        assert found.log_posterior[k] + log_constant(p) == pytest.approx(expected, rel=1e-9, abs=1e-7)


@pytest.mark.parametrize("search", [False, True])
def test_averages_are_those_of_the_exact_mixture(search):
    D, y, p = problem(4, Prior(noise_shape=2.0, noise_rate=2.0), n=40, P=6, noise=2.0)
    gram = Gram.from_data(D, y)
    fit = spike_slab_bma(
        gram, Prior(noise_shape=2.0, noise_rate=2.0), enumerate_up_to=0 if search else 14, tolerance=1e-7
    )
    models, logs, total, exact = reference.enumerate_models(D, y, a=2.0, b=2.0, N=p.dof)
    mean, second, noise = np.zeros(6), np.zeros((6, 6)), 0.0
    for z, weight in zip(models, np.exp(logs - total), strict=True):
        A = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / 10.0)
        a = A @ D[:, z].T @ y
        variance = (2.0 + 0.5 * (y @ y - a @ D[:, z].T @ y)) / (p.h - 1)
        mean[z] += weight * a
        second[np.ix_(z, z)] += weight * (np.outer(a, a) + variance * A)
        noise += weight * variance
    np.testing.assert_allclose(fit.pip, exact, atol=1e-5)
    np.testing.assert_allclose(fit.averaged.coef, mean, atol=1e-5)
    covariance = second - np.outer(mean, mean)
    np.testing.assert_allclose(fit.averaged.sd, np.sqrt(np.diag(covariance)), atol=1e-4)
    np.testing.assert_allclose(fit.average.covariance, covariance, atol=1e-4)
    assert fit.noise_variance == pytest.approx(noise, rel=1e-5)
    both = models[:, [1, 3]].all(axis=1)
    together = fit.average.probability @ fit.average.models[:, [1, 3]].all(axis=1)
    assert together == pytest.approx(np.exp(logs[both] - total).sum(), abs=1e-5)


def test_draws_come_from_the_mixture():
    D, y, p = problem(4, n=40, P=6, noise=2.0)
    fit = spike_slab_bma(Gram.from_data(D, y))
    theta, noise, which = sample_average(p, fit.average, 200_000, np.random.default_rng(0))
    np.testing.assert_allclose((theta != 0).mean(axis=0), fit.pip, atol=0.01)
    np.testing.assert_allclose(theta.mean(axis=0), fit.averaged.coef, atol=0.03 * fit.averaged.sd.max())
    np.testing.assert_allclose(np.cov(theta.T), fit.average.covariance, atol=0.08 * fit.averaged.sd.max() ** 2)
    # within the likeliest model sigma^2 is inverse-Gamma(h, s/2)
    best = fit.average.models[0]
    Z = D[:, best]
    s = y @ y + 2e-4 - y @ Z @ np.linalg.solve(Z.T @ Z + np.eye(best.sum()) / 10, Z.T @ y)
    assert stats.kstest(noise[which == 0], stats.invgamma(p.h, scale=s / 2).cdf).pvalue > 1e-3


def test_agrees_with_gibbs_sampling():
    for seed in range(4):
        D, y, _ = reference.random_problem(np.random.default_rng(seed), n=100, P=20, rho=0.7, noise=1.0)
        gram = Gram.from_data(D, y)
        sampled = spike_slab_gibbs(gram, samples=25_000, seed=seed)
        np.testing.assert_allclose(spike_slab_bma(gram).pip, sampled.pip, atol=0.02)


def test_forced_and_forbidden_terms():
    D, y, _ = reference.random_problem(np.random.default_rng(1), P=18)
    p0 = np.full(18, 0.1)
    p0[3], p0[4] = 1.0, 0.0
    for enumerate_up_to in (0, 16):
        fit = spike_slab_bma(Gram.from_data(D, y), Prior(prior_inclusion=p0), enumerate_up_to=enumerate_up_to)
        assert fit.pip[3] == pytest.approx(1.0)
        assert fit.pip[4] == 0.0


def test_room_used_up_is_said(monkeypatch):
    monkeypatch.setattr("bayeq.inference.collapsed.listing.MOST_MODELS", 1000)
    D, y, _ = reference.random_problem(np.random.default_rng(0), n=25, P=40, rho=0.9, noise=3.0)
    fit = spike_slab_bma(Gram.from_data(D, y))
    assert not fit.details.converged
    assert fit.average.left_out > 5e-3


def test_terms_beside_a_posterior_too_wide_to_list_are_settled(monkeypatch):
    monkeypatch.setattr("bayeq.inference.collapsed.listing.MOST_MODELS", 1000)
    D, y, _ = reference.random_problem(np.random.default_rng(0), n=25, P=40, rho=0.9, noise=3.0)
    D = np.block([[D, np.zeros((25, 1))], [np.zeros((25, 40)), np.ones((25, 1))]])
    gram = Gram.from_data(D, np.append(y, np.full(25, 9 * y.std())))
    for revise in (None, lambda found: found):
        fit = spike_slab_bma(gram, revise=revise)
        assert not fit.details.converged
        assert fit.details.unsettled
        assert gram.names[-1] not in fit.details.unsettled
        assert fit.pip[-1] > 0.999


def test_covariances_that_rounding_spoilt_are_possible_again():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 3)) * np.array([1e12, 1.0, 1e-6, 1.0, 1.0, 0.0])[:, None]
    right = root @ root.T
    spoilt = right + 1e-3 * np.sqrt(np.outer(np.diagonal(right), np.diagonal(right))) * rng.normal(size=(6, 6))
    spoilt = 0.5 * (spoilt + spoilt.T)
    sd = np.sqrt(np.diagonal(right))[:5]
    assert np.linalg.eigvalsh(spoilt[:5, :5] / np.outer(sd, sd)).min() < -1e-5
    found = _possible(spoilt)
    assert np.linalg.eigvalsh(found[:5, :5] / np.outer(sd, sd)).min() > -1e-12
    np.testing.assert_allclose(found[:5, :5] / np.outer(sd, sd), right[:5, :5] / np.outer(sd, sd), atol=0.01)
    kept = right[:5, :5] + np.diag(np.diagonal(right[:5, :5]))
    assert _possible(kept) is kept


def test_groups_of_columns_that_stand_in_for_each_other():
    rng = np.random.default_rng(0)
    x = rng.normal(size=300)
    D = np.column_stack(
        [x, x + 0.03 * rng.normal(size=300), x + 0.03 * rng.normal(size=300), rng.normal(size=(300, 2))]
    )
    fit = SpikeSlabBMA().fit(D, x + 0.5 * rng.normal(size=300))
    ((members, some),) = fit.average_.credible_groups()
    assert set(members) == {0, 1, 2}
    assert some > 0.999
    assert fit.pip_[:3].sum() == pytest.approx(1.2, abs=0.2)  # now and then two of them are in
    separate = SpikeSlabBMA().fit(rng.normal(size=(300, 4)), rng.normal(size=300))
    assert separate.average_.credible_groups() == []


def test_draws_of_the_estimator_are_in_original_units():
    D, y, _ = reference.random_problem(np.random.default_rng(7), n=200, P=5, noise=0.5)
    fit = SpikeSlabBMA().fit(D * 1e3, y)
    theta, noise = fit.sample(4000, random_state=1)
    np.testing.assert_allclose(theta.mean(axis=0), fit.averaged_coef_, atol=0.1 * fit.averaged_sd_.max())
    assert noise.mean() == pytest.approx(fit.noise_variance_, rel=0.02)
    assert fit.sample(5, random_state=1)[0].tobytes() == fit.sample(5, random_state=1)[0].tobytes()


def test_auto_says_which_number_came_from_where():
    D, y, _ = reference.random_problem(np.random.default_rng(2), n=150, P=9)
    gram = Gram.from_data(D, y)
    auto, vb, bma = spike_slab_auto(gram), spike_slab_vb(gram), spike_slab_bma(gram)
    assert auto.details.elbo == vb.details.elbo
    np.testing.assert_array_equal(auto.details.optimum, vb.support)
    np.testing.assert_array_equal(auto.pip, bma.pip)
    np.testing.assert_array_equal(auto.averaged.sd, bma.averaged.sd)


def test_fields_of_version_0_2_are_read_with_a_warning():
    fit = spike_slab_bma(Gram.from_data(*reference.random_problem(np.random.default_rng(0), P=4)[:2]))
    for name, place in MOVED.items():
        part, own = place.split(".")
        with pytest.warns(DeprecationWarning, match=rf"posterior\.{name} is posterior\.{part}\.{own} now"):
            value = getattr(fit, name)
        np.testing.assert_equal(value, getattr(getattr(fit, part), own, None))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        fit.nothing  # noqa: B018
    assert len(fields(fit)) == 12
