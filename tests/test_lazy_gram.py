"""Wide dictionaries: D'D is never formed, and the answers are those of the dense Gram."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import InputError
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.collapsed.problem import Problem, fetch, gram_block
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import LEAST_COLUMNS, Gram, LazyGram, dense, grams_of
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb

TRUE = {3: 2.0, 77: -1.5, 400: 1.0}
# so sparse that few models hold the mass: there is nothing to learn here from a long list
SPARSE = Prior(inclusion_beta=(1.0, 5000.0))


def wide(seed=0, n=120, P=600):
    rng = np.random.default_rng(seed)
    D = 3.0 + rng.normal(size=(n, P))
    D[:, 1:] += 0.7 * D[:, :-1]
    y = 5.0 + sum(value * D[:, j] for j, value in TRUE.items()) + 0.5 * rng.normal(size=n)
    return D, y


def both(weights=None):
    D, y = wide()
    lazy = grams_of(D, y[:, None], None, weights)[0]
    assert isinstance(lazy, LazyGram)
    return lazy, Gram.from_data(D, y, weights=weights)


@pytest.mark.parametrize("weights", [None, np.arange(120) % 4 + 0.5])
def test_statistics_are_those_of_the_gram(weights):
    lazy, gram = both(weights)
    for ours, theirs in ((lazy, gram), (lazy.standardise(2.0).gram, gram.standardise(2.0).gram)):
        assert ours.n == theirs.n
        assert ours.dof == theirs.dof
        np.testing.assert_allclose(ours.mean, theirs.mean, atol=1e-10)
        np.testing.assert_allclose(ours.diagonal, theirs.diagonal, rtol=1e-10)
        np.testing.assert_allclose(ours.Dty, theirs.Dty, atol=1e-8)
        assert ours.yty == pytest.approx(theirs.yty, rel=1e-10)
        np.testing.assert_allclose(ours.column(5), theirs.column(5), atol=1e-8)
        np.testing.assert_allclose(dense(ours), theirs.DtD, atol=1e-8)


@pytest.mark.parametrize(
    "engine",
    [
        spike_slab_vb,
        spike_slab_bma,
        lambda gram, prior: spike_slab_gibbs(gram, prior, chains=2, samples=300, burn_in=100),
        spike_slab_auto,
    ],
    ids=["vb", "bma", "gibbs", "auto"],
)
def test_engines_say_the_same(engine):
    lazy, gram = both()
    ours = engine(lazy.standardise().gram, SPARSE).rescaled(lazy.standardise())
    theirs = engine(gram.standardise().gram, SPARSE).rescaled(gram.standardise())
    assert set(np.flatnonzero(ours.support)) == set(TRUE)
    np.testing.assert_allclose(ours.pip, theirs.pip, atol=1e-6)
    np.testing.assert_allclose(ours.coef, theirs.coef, atol=1e-8)
    assert ours.intercept == pytest.approx(theirs.intercept)


def test_few_rows_of_the_product_are_computed():
    lazy, _ = both()
    problem = Problem.of(lazy.standardise().gram, SPARSE)
    assert set(np.flatnonzero(best_models(problem)[0][1])) == set(TRUE)
    used = problem.columns.used[0]
    assert len(TRUE) <= used < 30
    gram_block(problem.columns, np.array([77]))
    assert problem.columns.used[0] == used  # it was there


def test_once_single_rows_have_cost_as_much_the_rest_is_computed_at_once():
    lazy, gram = both()
    columns = Problem.of(lazy, Prior()).columns
    for j in range(255):
        fetch(columns, 2 * j)
    assert columns.used[0] == 255
    fetch(columns, 511)
    assert columns.used[0] == 600
    np.testing.assert_allclose(columns.rows[columns.slot], gram.DtD, atol=1e-8)


def test_all_of_the_product_can_be_asked_for():
    D, y = wide(n=100)
    lazy = grams_of(D, y[:, None])[0]
    problem = Problem.of(lazy, Prior())
    np.testing.assert_allclose(problem.DtD, dense(lazy), atol=1e-8)
    assert problem.columns.used[0] == 600
    # the rows stand in the order in which they were asked for, the block in that of the terms
    other = Problem.of(lazy, Prior()).columns
    fetch(other, 400)
    np.testing.assert_allclose(
        gram_block(other, np.array([3, 400, 77])), dense(lazy)[np.ix_([3, 400, 77], [3, 400, 77])]
    )


@pytest.mark.parametrize("estimator", [bq.SpikeSlabVB, bq.SpikeSlabBMA, bq.SpikeSlabGibbs])
def test_estimators_take_wide_problems(estimator):
    D, y = wide()
    options = {"chains": 2, "samples": 300, "burn_in": 100} if estimator is bq.SpikeSlabGibbs else {}
    fit = estimator(inclusion_beta=SPARSE.inclusion_beta, **options).fit(D, y)
    assert set(np.flatnonzero(fit.support_)) == set(TRUE)
    for j, value in TRUE.items():
        assert fit.coef_[j] == pytest.approx(value, abs=0.25)  # five standard errors
    assert fit.predict(D).shape == (120,)
    both_targets = estimator(inclusion_beta=SPARSE.inclusion_beta, **options).fit(D, np.column_stack([y, -2 * y]))
    np.testing.assert_allclose(both_targets.coef_[0], fit.coef_, atol=1e-8)


def test_rvm_and_stlsq_take_wide_problems():
    D, y = wide(P=LEAST_COLUMNS)
    assert set(TRUE) <= set(np.flatnonzero(bq.RVM().fit(D, y).support_))
    fit = bq.STLSQ(threshold=0.5, ridge=1.0).fit(D, y + 5.0)
    assert np.isfinite(fit.coef_).all()
    assert np.mean(fit.predict(D)) == pytest.approx(np.mean(y) + 5.0)
    assert bq.STLSQ(threshold=0.5, ridge=1.0, fit_intercept=False).fit(D, y).intercept_ == 0.0


def test_narrow_problems_keep_their_gram():
    D, y = wide(n=700)
    assert isinstance(grams_of(D, y[:, None])[0], Gram)
    assert isinstance(grams_of(D[:20, : LEAST_COLUMNS - 1], y[:20, None])[0], Gram)


def test_values_that_are_not_finite_are_named():
    D, y = wide()
    D[3, 8] = np.nan
    with pytest.raises(InputError, match="x8"):
        grams_of(D, y[:, None])
    with pytest.raises(ValueError, match="NaN"):
        bq.SpikeSlabVB().fit(D, y)
