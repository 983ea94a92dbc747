from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import logsumexp

from bayeq.errors import InputError
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import greedy_model
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm
from bayeq.inference.vb import spike_slab_vb
from tests import reference


def paper_gram(D, y):
    """The Gram in the paper's convention: N, not N - 1, in the likelihood."""
    gram = Gram.from_data(D, y)
    return gram.with_dof(gram.n)


@pytest.mark.parametrize("seed", range(20))
def test_equals_the_printed_equations(seed):
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng)
    w0 = rng.uniform(0.05, 1.0, size=D.shape[1])
    prior = Prior(slab_variance=5.0, prior_inclusion=0.2, noise_shape=0.3, noise_rate=0.7)
    fast = spike_slab_vb(paper_gram(D, y), prior, init=w0)
    # the precision that `init=array` starts from is the optimal one for w0: hand it to the twin
    A = (D.T @ D) * (np.outer(w0, w0) + np.diag(w0 * (1 - w0))) + np.eye(len(w0)) / 5.0
    explained = (w0 * (D.T @ y)) @ np.linalg.solve(A, w0 * (D.T @ y))
    tau = (0.3 + 0.5 * len(y)) / (0.7 + 0.5 * (y @ y - explained))
    w, mu, Sigma, a_q, b_q, trace = reference.vb(D, y, w0, tau, v_s=5.0, p0=0.2, a=0.3, b=0.7)
    np.testing.assert_allclose(fast.details.elbo_trace, trace, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(fast.pip, w, rtol=1e-6, atol=1e-12)
    kept = w > 0.5
    np.testing.assert_array_equal(fast.support, kept)
    np.testing.assert_allclose(fast.coef[kept], mu[kept], rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(fast.covariance, Sigma[np.ix_(kept, kept)], rtol=1e-6, atol=1e-12)
    assert fast.noise_variance == pytest.approx(b_q / a_q, rel=1e-8)


@pytest.mark.parametrize("seed", range(10))
def test_the_paper_start_equals_the_printed_equations_from_gamma_and_tau_1000(seed):
    D, y, _ = reference.random_problem(np.random.default_rng(seed))
    gram = paper_gram(D, y)
    fast = spike_slab_vb(gram, init="rvm")
    w, _, _, _, _, trace = reference.vb(D, y, rvm(gram).pip, 1000.0)
    np.testing.assert_allclose(fast.details.elbo_trace, trace, rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(fast.pip, w, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_greedy_start_is_the_model_that_adding_and_dropping_leads_to(seed):
    D, y, _ = reference.random_problem(np.random.default_rng(seed))
    gram = paper_gram(D, y)
    start = greedy_model(Problem.of(gram, Prior()))
    given = spike_slab_vb(gram, init=start.astype(float))
    greedy = spike_slab_vb(gram, init="greedy")
    np.testing.assert_array_equal(greedy.pip, given.pip)
    assert greedy.details.elbo == given.details.elbo
    with pytest.raises(InputError, match="'search', 'greedy', 'rvm'"):
        spike_slab_vb(gram, init="nothing")


@pytest.mark.parametrize("seed", range(10))
def test_eq_28_is_the_bound_of_eq_16(seed):
    # with a ln b where (28) prints a ln Gamma(b)
    D, y, _ = reference.random_problem(np.random.default_rng(seed))
    options = {"v_s": 4.0, "p0": 0.3, "a": 0.5, "b": 0.4}
    w, mu, Sigma, a_q, b_q, trace = reference.vb(D, y, np.full(D.shape[1], 0.5), 1.0, **options, max_iter=7)
    expected = reference.elbo_by_definition(D, y, w, mu, Sigma, a_q, b_q, **options, N=len(y))
    assert trace[-1] == pytest.approx(expected, rel=1e-10)


def assert_monotone(trace):
    drops = -np.diff(trace)
    assert np.all(drops <= 1e-10 * (1 + np.abs(trace[1:])))


def test_elbo_is_monotone_below_the_evidence_and_the_best_of_its_restarts():
    for seed in range(300):
        rng = np.random.default_rng(seed)
        D, y, _ = reference.random_problem(rng, P=int(rng.integers(2, 8 if seed % 10 else 11)))
        gram = Gram.from_data(D, y)
        P = D.shape[1]
        fit = spike_slab_vb(gram)
        models, logs, evidence, _ = reference.enumerate_models(D, y, N=gram.dof)
        assert fit.details.elbo <= evidence + 1e-9 * (1 + abs(evidence))
        best = models[np.argmax(logs)].astype(float)
        restarts = ["rvm", np.zeros(P), best, rng.uniform(0.01, 0.99, size=P)]
        for k, start in enumerate(restarts):
            other = spike_slab_vb(gram, init=start)
            assert_monotone(other.details.elbo_trace)
            assert other.details.elbo <= evidence + 1e-9 * (1 + abs(evidence))
            if k < 3:
                assert fit.details.elbo >= other.details.elbo - 1e-6  # the tolerance at which an ascent stops
        assert_monotone(fit.details.elbo_trace)


def test_given_models_take_the_place_of_the_rvm_and_reach_its_optimum(monkeypatch):
    problems = [reference.random_problem(np.random.default_rng(seed), n=200, P=12, rho=0.8) for seed in range(30)]
    grams = [Gram.from_data(D, y).standardise().gram for D, y, _ in problems]
    with_rvm = [spike_slab_vb(gram).details.elbo for gram in grams]
    monkeypatch.setattr("bayeq.inference.vb.rvm_gamma", None)  # so that running it fails
    for gram, elbo in zip(grams, with_rvm, strict=True):
        auto = spike_slab_auto(gram)
        assert auto.details.elbo == pytest.approx(elbo, abs=1e-6)
        best = auto.average.models[0]
        assert spike_slab_vb(gram, models=[best]).details.elbo == pytest.approx(elbo, abs=1e-6)


def test_elbo_of_a_fixed_model_is_its_evidence_up_to_a_constant():
    # at binary w the gap between ELBO and ln p(y, z) does not depend on z: VB's best start is the best model
    D, y, _ = reference.random_problem(np.random.default_rng(8), P=6)
    gram = Gram.from_data(D, y)
    gaps = []
    for z in (np.zeros(6), np.array([1.0, 0, 0, 1, 0, 0]), np.ones(6)):
        elbo = spike_slab_vb(gram, init=z, max_iter=1).details.elbo_trace[0]
        gaps.append(elbo - reference.log_evidence(D, y, z, N=gram.dof))
    assert np.ptp(gaps) < 1e-8


def test_a_false_term_of_a_correlated_dictionary_never_leaves():
    # the trap: at w = 1 eta_i = logit(p0) - 1 + VIF_i (1 + t_i^2)/2 + small, so VB alone keeps it; the search does not
    rng = np.random.default_rng(0)
    x = rng.normal(size=400)
    D = np.column_stack([x, x + 0.15 * rng.normal(size=400)])  # variance inflation about 45
    y = 2 * x + 0.1 * rng.normal(size=400)
    gram = Gram.from_data(D, y).standardise().gram
    assert spike_slab_vb(gram, init=np.ones(2)).support.tolist() == [True, True]
    assert spike_slab_vb(gram).support.tolist() == [True, False]


def test_pips_are_near_the_exact_ones_where_columns_are_orthogonal():
    # at orthogonal columns and known noise the posterior factorises and VB is exact up to the noise's spread
    rng = np.random.default_rng(2)
    Q, _ = np.linalg.qr(rng.normal(size=(400, 6)) - 0.0)
    D = Q * 20.0
    D -= D.mean(axis=0)
    y = D @ [0.5, 0.2, 0.12, 0.0, 0.0, 0.15] + rng.normal(size=400)
    y -= y.mean()
    fit = spike_slab_vb(Gram.from_data(D, y))
    exact = reference.enumerate_models(D, y, N=399)[3]
    np.testing.assert_allclose(fit.pip, exact, atol=0.05)


def test_forced_and_forbidden_terms():
    D, y, _ = reference.random_problem(np.random.default_rng(4), P=6)
    p0 = [0.1, 1.0, 0.0, 0.1, 0.1, 0.1]
    fit = spike_slab_vb(Gram.from_data(D, y), Prior(prior_inclusion=p0))
    assert fit.pip[1] == 1.0
    assert fit.pip[2] == 0.0
    assert math.isfinite(fit.details.elbo)


@pytest.mark.parametrize(
    "prior",
    [
        Prior(slab_variance=0.0),
        Prior(slab_variance=math.nan),
        Prior(prior_inclusion=1.5),
        Prior(prior_inclusion=[0.1, 0.2]),
        Prior(noise_shape=-1.0),
        Prior(noise_rate=math.inf),
    ],
)
def test_priors_out_of_range_are_refused(prior):
    D, y, _ = reference.random_problem(np.random.default_rng(0), P=4)
    with pytest.raises(InputError):
        spike_slab_vb(Gram.from_data(D, y), prior)


@pytest.mark.parametrize("init", ["eager", np.ones(3), np.array([0.1, 0.2, 0.3, 1.4])])
def test_wrong_starts_are_refused(init):
    D, y, _ = reference.random_problem(np.random.default_rng(0), P=4)
    with pytest.raises(InputError, match="init"):
        spike_slab_vb(Gram.from_data(D, y), init=init)


def test_wide_and_degenerate_problems():
    rng = np.random.default_rng(1)
    D = rng.normal(size=(20, 60))
    y = 3 * D[:, 7] + 0.01 * rng.normal(size=20)
    fit = spike_slab_vb(Gram.from_data(D, y).standardise().gram)
    assert fit.support[7]
    zero = spike_slab_vb(Gram.from_data(D[:, :3], np.zeros(20)))
    assert not zero.support.any()
    twin = np.column_stack([D[:, 0], D[:, 0]])
    both = spike_slab_vb(Gram.from_data(twin, D[:, 0] + 0.1 * rng.normal(size=20)))
    assert both.support.sum() == 1


def test_exact_evidence_reference_is_normalised():
    # the twin itself: the evidence of N = 1 integrates to one over y
    D = np.array([[0.7]])
    y = np.linspace(-4000, 4000, 2_000_001)
    options = {"v_s": 2.0, "p0": 0.3, "a": 3.0, "b": 3.0}
    total = 0.0
    for z in ([0], [1]):
        at = [reference.log_evidence(D, np.array([v]), z, **options) for v in y[::100_000]]
        scale = 1 + 2.0 * 0.49 * z[0]
        density = -3.5 * np.log(3.0 + 0.5 * y**2 / scale)
        logs = density - density[0] + at[0]
        np.testing.assert_allclose(logs[::100_000], at, rtol=1e-9)
        total += np.exp(logsumexp(logs)) * (y[1] - y[0])
    assert total == pytest.approx(1.0, abs=1e-6)
