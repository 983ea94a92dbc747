from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures
from sklearn.utils.estimator_checks import parametrize_with_checks

from bayeq import RVM, STLSQ, SpikeSlabBMA, SpikeSlabGibbs, SpikeSlabVB
from tests import reference

ESTIMATORS = [
    SpikeSlabVB(),
    RVM(),
    SpikeSlabBMA(),
    SpikeSlabGibbs(samples=300, burn_in=50, chains=2),
    STLSQ(standardise=True),
]


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks(ESTIMATORS)
def test_scikit_learn_conventions(estimator, check):
    check(estimator)


def problem(seed=0, n=400):
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, n=n, P=8, rho=0.5)
    y = D @ [0, 2.0, 0, 0, -1.0, 0, 0, 0] + 0.3 * rng.normal(size=n)
    return D, y


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_units_of_the_columns_do_not_matter(estimator):
    D, y = problem()
    scale, offset = 10.0 ** np.arange(-4, 4), 7.0
    plain = clone(estimator).fit(D, y)
    other = clone(estimator).fit(D * scale + offset * scale, y)
    np.testing.assert_array_equal(plain.support_, other.support_)
    np.testing.assert_allclose(plain.pip_, other.pip_, atol=1e-8)
    np.testing.assert_allclose(other.coef_ * scale, plain.coef_, rtol=1e-6, atol=1e-9)
    kept = plain.support_
    np.testing.assert_allclose(other.covariance_ * np.outer(scale[kept], scale[kept]), plain.covariance_, rtol=1e-5)
    np.testing.assert_allclose(other.predict(D * scale + offset * scale), plain.predict(D), rtol=1e-6, atol=1e-8)


def test_attributes_of_the_contract():
    D, y = problem()
    fit = SpikeSlabVB().fit(D, y)
    assert fit.support_.tolist() == [False, True, False, False, True, False, False, False]
    np.testing.assert_array_equal(fit.support_, fit.pip_ > 0.5)
    assert fit.covariance_.shape == (2, 2)
    assert fit.coef_[1] == pytest.approx(2.0, abs=4 * np.sqrt(fit.covariance_[0, 0]))
    assert fit.noise_variance_ == pytest.approx(0.09, rel=0.2)
    assert fit.elbo_ == fit.elbo_trace_[-1]
    assert len(fit.elbo_trace_) == fit.n_iter_
    mean, sd = fit.predict(D, return_std=True)
    np.testing.assert_array_equal(mean, fit.predict(D))
    # eq. (30): the noise, and the coefficients' part on top
    assert np.all(sd > np.sqrt(fit.noise_variance_))
    assert sd.mean() == pytest.approx(0.3, rel=0.15)


def test_prior_and_start_reach_the_engine():
    D, y = problem()
    p0 = np.full(8, 0.1)
    p0[0], p0[1] = 1.0, 0.0
    fit = SpikeSlabVB(prior_inclusion=p0).fit(D, y)
    assert fit.support_[0]
    assert not fit.support_[1]
    assert SpikeSlabVB(init="rvm").fit(D, y).elbo_ <= SpikeSlabVB().fit(D, y).elbo_ + 1e-6
    with pytest.raises(ValueError, match="slab_variance"):
        SpikeSlabVB(slab_variance=-1).fit(D, y)


def test_gibbs_keeps_its_draws_in_original_units():
    D, y = problem()
    fit = SpikeSlabGibbs(samples=600, burn_in=100, random_state=3).fit(D * 1e3, y)
    assert fit.rhat_ < 1.1
    assert fit.draws_.theta.shape == (4, 500, 8)
    np.testing.assert_allclose(fit.draws_.theta.mean(axis=(0, 1)), fit.averaged_coef_, rtol=1e-9, atol=1e-15)
    assert fit.averaged_coef_[1] == pytest.approx(2.0e-3, rel=0.05)
    assert fit.averaged_sd_[1] == pytest.approx(np.sqrt(fit.covariance_[0, 0]), rel=0.1)


def test_stlsq_on_raw_columns():
    D, y = problem()
    raw = STLSQ(threshold=0.5, ridge=0.0, fit_intercept=False).fit(D, y)
    assert raw.intercept_ == 0
    assert raw.support_.tolist() == [False, True, False, False, True, False, False, False]
    with pytest.raises(ValueError, match="fit_intercept"):
        STLSQ(standardise=True, fit_intercept=False).fit(D, y)


def test_frames_and_pipelines():
    D, y = problem()
    frame = pd.DataFrame(D[:, :3], columns=["x", "v", "u"])
    fit = SpikeSlabVB().fit(frame, y)
    assert fit.posterior_.names == ("x", "v", "u")
    assert make_pipeline(PolynomialFeatures(2, include_bias=False), SpikeSlabVB()).fit(D, y).score(D, y) > 0.95
    with pytest.raises(NotFittedError):
        SpikeSlabVB().predict(D)
