from __future__ import annotations

import joblib
import numpy as np
import pandas as pd
import pytest
import sklearn
from scipy.sparse import csr_array
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression
from sklearn.metrics import make_scorer, r2_score
from sklearn.model_selection import GridSearchCV, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from bayeq import RVM, STLSQ, SpikeSlabBMA, SpikeSlabGibbs, SpikeSlabVB
from bayeq.errors import InputError
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


each_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)


@each_estimator
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


@each_estimator
def test_the_covariance_is_that_of_the_included_terms(estimator):
    D, y = problem()
    fit = clone(estimator).fit(D, y)
    included = int(fit.support_.sum())
    assert 2 <= included < 8
    assert fit.covariance_.shape == (included, included)
    np.testing.assert_array_equal(fit.posterior_.sd > 0, fit.support_)
    np.testing.assert_allclose(fit.posterior_.sd[fit.support_] ** 2, np.diagonal(fit.covariance_), rtol=1e-14)
    np.testing.assert_array_equal(fit.coef_ != 0, fit.support_)


# ---- weights


@each_estimator
def test_weights_count_rows(estimator):
    D, y = problem(n=150)
    weights = np.random.default_rng(5).integers(0, 4, len(y))
    weighted = clone(estimator).fit(D, y, sample_weight=weights)
    repeated = clone(estimator).fit(D.repeat(weights, axis=0), y.repeat(weights))
    assert weighted.posterior_.n == repeated.posterior_.n == weights.sum()
    for name in ("coef_", "intercept_", "pip_", "covariance_", "noise_variance_"):
        np.testing.assert_allclose(getattr(weighted, name), getattr(repeated, name), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(
        weighted.predict(D, return_std=True), repeated.predict(D, return_std=True), rtol=1e-7, atol=1e-10
    )


def test_fractional_weights_are_weighted_least_squares():
    # without threshold and ridge STLSQ is least squares, and weights are rows times their square root
    D, y = problem(n=60)
    weights = np.random.default_rng(6).gamma(1.0, size=60)
    fit = STLSQ(threshold=0.0, ridge=0.0).fit(D, y, weights)
    root = np.sqrt(weights)
    design = root[:, None] * np.column_stack([np.ones(60), D])
    expected = np.linalg.lstsq(design, root * y, rcond=None)[0]
    np.testing.assert_allclose([fit.intercept_, *fit.coef_], expected, rtol=1e-9)
    rss = np.sum((root * y - design @ expected) ** 2)
    assert fit.noise_variance_ == pytest.approx(rss / (weights.sum() - 9), rel=1e-9)
    information = np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(fit.covariance_, fit.noise_variance_ * information[1:, 1:], rtol=1e-7, atol=1e-12)
    assert fit.posterior_.intercept_sd == pytest.approx(np.sqrt(fit.noise_variance_ * information[0, 0]), rel=1e-9)


def test_noise_ratios_as_weights():
    # half of the rows have ten times the noise: told apart, the intervals shrink and still hold the truth
    errors, narrower = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        D = rng.normal(size=(200, 5))
        sd = np.where(np.arange(200) < 100, 0.1, 1.0)
        y = D[:, 0] + sd * rng.normal(size=200)
        weights = 1.0 / sd**2
        weights *= len(y) / weights.sum()
        plain, weighted = SpikeSlabVB().fit(D, y), SpikeSlabVB().fit(D, y, weights)
        spread = np.sqrt(weighted.covariance_[0, 0])
        narrower.append(spread / np.sqrt(plain.covariance_[0, 0]))
        errors.append((weighted.coef_[0] - 1.0) / spread)
    # precision of the weighted mean of such rows over that of the plain one: sqrt(mean(1/v) mean(v)) = 5.05
    assert np.mean(narrower) == pytest.approx(1 / 5.05, rel=0.1)
    # 40 standardised errors: their mean square is chi-square/40, sd 0.22
    assert 0.4 < np.mean(np.square(errors)) < 1.7


def test_weights_in_any_container_and_left_as_they_were():
    D, y = problem(n=100)
    weights = np.linspace(0.5, 1.5, 100)
    kept = weights.copy()
    expected = SpikeSlabVB().fit(D, y, weights).coef_
    np.testing.assert_array_equal(weights, kept)
    for same in (weights.tolist(), pd.Series(weights, index=range(7, 107))):
        np.testing.assert_array_equal(SpikeSlabVB().fit(D, y, same).coef_, expected)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (-np.ones(400), "not negative"),
        (np.full(400, np.nan), "finite"),
        (np.zeros(400), "all zero"),
        (np.ones(399), "one weight per row"),
        (np.full(400, 1 / 400), "sums to 1: weights count rows"),
    ],
)
@each_estimator
def test_weights_that_mean_nothing(estimator, weights, message):
    with pytest.raises(InputError, match=message):
        clone(estimator).fit(*problem(), sample_weight=weights)


def test_weights_through_pipelines_and_cross_validation():
    D, y = problem()
    weights = np.where(np.arange(len(y)) < 200, 1, 0)
    expected = SpikeSlabVB().fit(StandardScaler().fit_transform(D), y, weights)
    pipe = make_pipeline(StandardScaler(), SpikeSlabVB())
    pipe.fit(D, y, spikeslabvb__sample_weight=weights)
    np.testing.assert_array_equal(pipe[-1].coef_, expected.coef_)
    with sklearn.config_context(enable_metadata_routing=True):
        # the dictionary matrix is data, not metadata to ask for
        assert set(SpikeSlabVB().get_metadata_routing().fit.requests) == {"sample_weight"}
        assert set(SpikeSlabVB().get_metadata_routing().predict.requests) == {"return_std"}
        routed = make_pipeline(
            StandardScaler().set_fit_request(sample_weight=False),
            SpikeSlabVB().set_fit_request(sample_weight=True).set_score_request(sample_weight=True),
        )
        np.testing.assert_array_equal(routed.fit(D, y, sample_weight=weights)[-1].coef_, expected.coef_)
        # the default scorer does not know what a pipeline asks for before scikit-learn 1.8
        r2 = make_scorer(r2_score).set_score_request(sample_weight=True)
        scores = cross_validate(routed, D, y, params={"sample_weight": weights + 1}, cv=3, scoring=r2)["test_score"]
        assert scores.min() > 0.9


# ---- several targets


def several(n=300):
    D, y = problem(n=n)
    rng = np.random.default_rng(9)
    return D, np.column_stack([y, 3.0 * D[:, 2] + 5.0 + rng.normal(size=n), D[:, :3].sum(axis=1) + rng.normal(size=n)])


STACKED = {"coef_": 8, "intercept_": None, "pip_": 8, "support_": 8, "noise_variance_": None}
FURTHER = {
    "SpikeSlabVB": ({"elbo_": None}, ["elbo_trace_"]),
    "SpikeSlabGibbs": ({"averaged_coef_": 8, "averaged_sd_": 8, "rhat_": None}, ["draws_"]),
    "SpikeSlabBMA": ({"averaged_coef_": 8, "averaged_sd_": 8}, ["average_"]),
}


@pytest.mark.parametrize("weights", [None, np.arange(300) % 3])
@each_estimator
def test_several_targets_are_as_many_fits(estimator, weights):
    D, Y = several()
    fit = clone(estimator).fit(D, Y, weights)
    alone = [clone(estimator).fit(D, y, weights) for y in Y.T]
    stacked, listed = FURTHER.get(type(estimator).__name__, ({}, []))
    for name, columns in (STACKED | stacked).items():
        value = getattr(fit, name)
        assert isinstance(value, np.ndarray)
        assert value.shape == ((3,) if columns is None else (3, columns))
        np.testing.assert_allclose(value, [getattr(one, name) for one in alone], rtol=1e-9, atol=1e-12)
    assert fit.support_.dtype == bool
    for name in ["covariance_", *listed]:
        assert isinstance(getattr(fit, name), list)
        assert len(getattr(fit, name)) == 3
    for k, one in enumerate(alone):
        np.testing.assert_allclose(fit.covariance_[k], one.covariance_, rtol=1e-7, atol=1e-14)
        assert fit.posteriors_[k].n == one.posterior_.n
    assert fit.n_iter_ == max(one.n_iter_ for one in alone)
    mean, sd = fit.predict(D[:50], return_std=True)
    assert mean.shape == sd.shape == (50, 3)
    np.testing.assert_array_equal(mean, fit.predict(D[:50]))
    for k, one in enumerate(alone):
        np.testing.assert_allclose((mean[:, k], sd[:, k]), one.predict(D[:50], return_std=True), rtol=1e-7, atol=1e-9)
    assert fit.score(D, Y) == pytest.approx(np.mean([one.score(D, y) for one, y in zip(alone, Y.T, strict=True)]))


def test_one_target_as_a_column_has_the_shapes_of_linear_regression():
    D, y = problem()
    fit, ols = SpikeSlabVB().fit(D, y[:, None]), LinearRegression().fit(D, y[:, None])
    for name in ("coef_", "intercept_"):
        assert getattr(fit, name).shape == getattr(ols, name).shape
    assert fit.predict(D).shape == ols.predict(D).shape == (400, 1)
    flat = SpikeSlabVB().fit(D, y)
    np.testing.assert_array_equal(fit.coef_, flat.coef_[None])
    np.testing.assert_array_equal(fit.posterior_.coef, flat.coef_)
    np.testing.assert_array_equal(SpikeSlabVB().fit(D, csr_array(y[:, None])).coef_, fit.coef_)


def test_the_posterior_of_several_targets_is_none_of_them():
    D, Y = several()
    fit = SpikeSlabVB().fit(D, Y)
    assert [posterior.names for posterior in fit.posteriors_] == [tuple(f"x{j}" for j in range(8))] * 3
    with pytest.raises(InputError, match="this one has 3: take one of posteriors_"):
        fit.posterior_  # noqa: B018
    # tools that go through the attributes must be able to
    assert not hasattr(fit, "posterior_")
    assert "SpikeSlabVB" in fit._repr_html_()
    with pytest.raises(NotFittedError):
        SpikeSlabVB().posterior_  # noqa: B018
    assert fit.fit(D, Y[:, 0]).posterior_ is fit.posteriors_[0]


# ---- frames, pipelines, searches, files


@each_estimator
def test_names_of_frames_are_kept(estimator):
    D, Y = several()
    names = [f"v**{k}" for k in range(8)]
    frame, targets = pd.DataFrame(D, columns=names), pd.DataFrame(Y, columns=["a", "b", "c"])
    fit = clone(estimator).fit(frame, targets["a"])
    assert fit.feature_names_in_.tolist() == names
    assert fit.posterior_.names == tuple(names)
    np.testing.assert_array_equal(fit.coef_, clone(estimator).fit(D, Y[:, 0]).coef_)
    with pytest.raises(ValueError, match="feature names"):
        fit.predict(frame[names[::-1]])
    assert all(p.names == tuple(names) for p in fit.fit(frame, targets).posteriors_)
    # and forgotten where there are none
    assert fit.fit(D, Y[:, 0]).posterior_.names == tuple(f"x{j}" for j in range(8))
    assert not hasattr(fit, "feature_names_in_")


def test_in_a_pipeline_behind_a_scaler():
    D, y = problem()
    scale = 10.0 ** np.arange(-4, 4)
    frame = pd.DataFrame(D * scale + 7.0, columns=list("abcdefgh"))
    pipe = make_pipeline(StandardScaler().set_output(transform="pandas"), SpikeSlabVB()).fit(frame, y)
    alone = SpikeSlabVB().fit(frame, y)
    assert pipe[-1].posterior_.names == tuple("abcdefgh")
    np.testing.assert_array_equal(pipe[-1].support_, alone.support_)
    np.testing.assert_allclose(
        pipe.predict(frame, return_std=True), alone.predict(frame, return_std=True), rtol=1e-6, atol=1e-9
    )


def test_grid_search_over_the_prior():
    D, y = problem(n=120)
    grid = {"slab_variance": [1e-4, 10.0], "prior_inclusion": [1e-6, 0.1, np.full(8, 0.2)]}
    search = GridSearchCV(SpikeSlabVB(), grid, cv=3).fit(D, y)
    assert len(search.cv_results_["params"]) == 6
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()
    # a slab that shrinks everything to nothing predicts worse
    assert search.best_params_["slab_variance"] == 10.0
    assert search.best_estimator_.support_.tolist() == [False, True, False, False, True, False, False, False]
    inside = GridSearchCV(make_pipeline(StandardScaler(), SpikeSlabVB()), {"spikeslabvb__slab_variance": [1.0, 10.0]})
    assert inside.fit(D, y).score(D, y) > 0.9


@pytest.mark.parametrize("columns", [1, 3])
@each_estimator
def test_files_and_clones(estimator, columns, tmp_path):
    D, Y = several(n=100)
    Y = Y[:, 0] if columns == 1 else Y
    fit = clone(estimator).fit(D, Y)
    joblib.dump(fit, tmp_path / "fit.joblib")
    again = joblib.load(tmp_path / "fit.joblib")
    assert vars(again).keys() == vars(fit).keys()
    for one, other in zip(fit.predict(D, return_std=True), again.predict(D, return_std=True), strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.posteriors_[0].names == fit.posteriors_[0].names
    if isinstance(fit, SpikeSlabBMA):
        for one, other in zip(fit.sample(20, 1), again.sample(20, 1), strict=True):
            np.testing.assert_array_equal(one, other)
    # a clone has the parameters and nothing that was fitted
    assert set(vars(clone(fit))) == set(fit.get_params())


def test_what_is_sampled_is_what_was_fitted():
    D, y = problem(n=100)
    p0 = np.full(8, 0.3)
    fit = SpikeSlabBMA(prior_inclusion=p0, slab_variance=5.0).fit(D, y)
    theta, noise = fit.sample(50, 7)
    # neither new parameters nor an array written to matter before the next fit ...
    fit.set_params(slab_variance=1e-3, noise_rate=1e3)
    p0[:] = 0.9
    np.testing.assert_array_equal(fit.sample(50, 7)[0], theta)
    # ... nor does a fit that fails
    with pytest.raises(InputError, match="slab_variance"):
        fit.set_params(slab_variance=-1.0).fit(D[:, :4], y)
    np.testing.assert_array_equal(fit.sample(50, 7)[1], noise)
    # the next fit leaves nothing of the last
    D, Y = several(n=80)
    fresh = SpikeSlabBMA().fit(D[:, :5], Y)
    fit.set_params(**SpikeSlabBMA().get_params()).fit(D[:, :5], Y)
    for one, other in zip(fit.sample(30, 2), fresh.sample(30, 2), strict=True):
        np.testing.assert_array_equal(one, other)
    assert fit.sample(30)[0].shape == (30, 3, 5)
    assert fit.sample(30)[1].shape == (30, 3)


def test_samples_of_several_targets_average_to_each():
    D, Y = several(n=80)
    fit = SpikeSlabBMA().fit(D, Y)
    theta, noise = fit.sample(4000, 3)
    # five standard errors of a mean of 4000 independent draws
    assert np.all(np.abs(theta.mean(axis=0) - fit.averaged_coef_) < 5 * fit.averaged_sd_ / np.sqrt(4000) + 1e-12)
    np.testing.assert_allclose(noise.mean(axis=0), fit.noise_variance_, rtol=0.02)


# ---- rows that come in blocks


FITTED = ("coef_", "intercept_", "pip_", "covariance_", "noise_variance_", "n_effective_")


@each_estimator
def test_blocks_are_one_fit(estimator):
    D, y = problem(n=150)
    whole, blocks = clone(estimator).fit(D, y), clone(estimator)
    for part in (slice(0, 40), slice(40, 41), slice(41, 150)):
        blocks.partial_fit(D[part], y[part])
    assert blocks.n_effective_ == 150
    for name in FITTED:
        np.testing.assert_allclose(getattr(blocks, name), getattr(whole, name), rtol=1e-7, atol=1e-12)
    # a fit can be gone on with, and begins afresh itself
    again = clone(estimator).fit(D[:40], y[:40]).partial_fit(D[40:], y[40:])
    np.testing.assert_allclose(again.coef_, whole.coef_, rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(again.fit(D, y).coef_, whole.coef_)


@each_estimator
def test_forgetting_is_weights_that_fall(estimator):
    D, y = problem(n=150)
    blocks = clone(estimator).set_params(forgetting=0.97)
    for part in (slice(0, 60), slice(60, 61), slice(61, 150)):
        blocks.partial_fit(D[part], y[part])
    weights = 0.97 ** np.arange(149, -1, -1)
    whole = clone(estimator).fit(D, y, sample_weight=weights)
    for name in FITTED:
        np.testing.assert_allclose(getattr(blocks, name), getattr(whole, name), rtol=1e-6, atol=1e-12)
    assert blocks.n_effective_ == pytest.approx(weights.sum())
    assert blocks.n_effective_ == pytest.approx(1 / 0.03, rel=0.02)


def test_blocks_with_weights_and_several_targets():
    D, y = problem(n=120)
    Y, weights = np.column_stack([y, -y + D[:, 0]]), np.random.default_rng(2).uniform(0.0, 2.0, 120)
    blocks = SpikeSlabVB(forgetting=0.99)
    for part in (slice(0, 50), slice(50, 120)):
        blocks.partial_fit(D[part], Y[part], sample_weight=weights[part])
    whole = SpikeSlabVB().fit(D, Y, sample_weight=weights * 0.99 ** np.arange(119, -1, -1))
    np.testing.assert_allclose(blocks.coef_, whole.coef_, rtol=1e-7, atol=1e-12)
    with pytest.raises(InputError, match=r"y has shape \(n,\), that of the rows before was \(n, 2\)"):
        blocks.partial_fit(D, y)


def test_a_change_is_followed():
    rng = np.random.default_rng(3)
    D = rng.normal(size=(3000, 3))
    y = D[:, 0] * np.repeat([1.0, 2.0], 1500) + 0.1 * rng.normal(size=3000)
    follows, remembers = SpikeSlabVB(forgetting=0.99), SpikeSlabVB()
    for k in range(0, 3000, 100):
        for fit in (follows, remembers):
            fit.partial_fit(D[k : k + 100], y[k : k + 100])
    assert follows.coef_[0] == pytest.approx(2.0, abs=0.05)
    assert remembers.coef_[0] == pytest.approx(1.5, abs=0.05)


def test_blocks_keep_the_names_of_the_first():
    D, y = problem(n=60)
    frame = pd.DataFrame(D, columns=list("abcdefgh"))
    fit = SpikeSlabVB().partial_fit(frame[:30], y[:30]).partial_fit(frame[30:], y[30:])
    assert fit.posterior_.names == tuple("abcdefgh")


@pytest.mark.parametrize("forgetting", [0.0, 1.01, -1.0, np.nan, "0.9", None])
def test_forgetting_is_a_share(forgetting):
    D, y = problem(n=30)
    with pytest.raises(InputError, match="0 < forgetting <= 1"):
        SpikeSlabVB(forgetting=forgetting).partial_fit(D, y)


def test_blocks_that_cannot_be_fitted():
    D, y = problem(n=30)
    with pytest.raises(InputError, match="count 1 times"):
        SpikeSlabVB().partial_fit(D[:1], y[:1])
    wide = np.random.default_rng(0).normal(size=(20, 600))
    fit = STLSQ(standardise=True, ridge=1.0).fit(wide, wide[:, 0])
    with pytest.raises(InputError, match="begin with partial_fit"):
        fit.partial_fit(wide, wide[:, 0])
