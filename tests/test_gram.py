from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayeq.errors import InputError
from bayeq.inference.gram import BLOCK_ROWS, SMALL, Gram, dense, grams_from_blocks, grams_from_data
from bayeq.inference.gram_products import add_products, block_for, shifted_products
from bayeq.inference.posterior import Constant, Details, Posterior
from tests.draws import draws
from tests.reference import centred


def direct(D, y):
    """Centred co-moments in extended precision."""
    D, y = D.astype(np.longdouble), y.astype(np.longdouble)
    Z, t = D - D.mean(axis=0), y - y.mean()
    return Z.T @ Z, Z.T @ t, t @ t


def data(seed, n=200, P=5, offset=0.0):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(n, P)) @ rng.normal(size=(P, P)) + offset
    return D, D[:, 0] * 2 + rng.normal(size=n) + offset


def close(gram, D, y, rtol):
    dd, dy, yy = direct(D, y)
    size = np.sqrt(np.outer(np.diag(dd), np.diag(dd)))
    assert np.max(np.abs(gram.DtD - dd) / size) < rtol
    assert np.max(np.abs(gram.Dty - dy) / np.sqrt(np.diag(dd) * yy)) < rtol
    assert abs(gram.yty - yy) < rtol * yy
    np.testing.assert_allclose(gram.mean, D.mean(axis=0), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("order", ["C", "F"])
def test_equals_the_direct_formula(order):
    D, y = data(0)
    close(Gram.from_data(np.asarray(D, order=order), y), D, y, 1e-14)


@pytest.mark.parametrize("P", [1, 7, SMALL - 1, SMALL + 5])
@pytest.mark.parametrize("n", [1, 2, 15, 16, 101])
def test_narrow_and_wide_products(n, P):
    # narrow ones by our kernel, wide ones by BLAS
    rng = np.random.default_rng(n + P)
    D, y = rng.normal(size=(n, P)), rng.normal(size=n)
    Z, t = centred(D, y)
    gram = Gram.from_data(D, y)
    np.testing.assert_allclose(gram.DtD, Z.T @ Z, atol=1e-11)
    np.testing.assert_allclose(gram.Dty, Z.T @ t, atol=1e-11)
    np.testing.assert_array_equal(gram.DtD, gram.DtD.T)


@pytest.mark.parametrize("n", [1, 3, 255, 256, 257, 1030])
@pytest.mark.parametrize("columns", [1, 3, 4, 37])
def test_products_of_a_block(n, columns):
    rng = np.random.default_rng(n + columns)
    values, block = rng.normal(size=(columns, n)), block_for(columns, n)
    block[:columns, :n] = values
    block[:columns, n:] = np.nan  # beyond the rows
    sums = np.zeros((len(block), len(block)))
    add_products(block, n, sums)
    add_products(block, n, sums)
    filled = np.vstack([values, np.ones(n), np.zeros((len(block) - columns - 1, n))])
    np.testing.assert_allclose(np.tril(sums), np.tril(2.0 * filled @ filled.T), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_products_keep_what_is_not_finite(bad):
    D = np.random.default_rng(0).normal(size=(300, 5))
    D[280, 2] = bad
    _, sums, products = shifted_products(D, D[:, :1])
    wrong = ~np.isfinite(products)
    assert wrong[2].all()
    assert wrong[:, 2].all()
    assert wrong.sum() == 11
    assert np.flatnonzero(~np.isfinite(sums)).tolist() == [2]


@pytest.mark.parametrize("value", [0.1, -3e7, 1e-30])
def test_a_constant_column_has_no_products(value):
    D = np.column_stack([np.full(1000, value), np.arange(1000.0)])
    shift, sums, products = shifted_products(D, D[:, :1])
    assert shift[0] == shift[2] == value
    assert not sums[0]
    assert not products[0].any()
    assert not products[2].any()


def test_many_blocks_equal_one():
    D, y = data(1, n=3 * BLOCK_ROWS + 17, P=3)
    close(Gram.from_data(D, y), D, y, 1e-13)


def test_means_1e8_times_the_standard_deviation():
    D, y = data(2, n=20_000, P=4, offset=1e8)
    # a mean of 1e8 standard deviations is itself stored to 1e-8 of one: what a merge of blocks can keep
    close(Gram.from_data(D[:8000], y[:8000]), D[:8000], y[:8000], 1e-12)
    close(Gram.from_data(D, y), D, y, 1e-8)
    parts = [Gram.from_data(D[i : i + 1000], y[i : i + 1000]) for i in range(0, len(D), 1000)]
    close(sum(parts[1:], parts[0]), D, y, 1e-8)


@settings(max_examples=draws(60), deadline=None)
@given(seed=st.integers(0, 10_000), cuts=st.lists(st.integers(1, 199), min_size=1, max_size=6, unique=True))
def test_merge_order_does_not_matter(seed, cuts):
    D, y = data(seed)
    edges = [0, *sorted(cuts), len(D)]
    parts = [Gram.from_data(D[a:b], y[a:b]) for a, b in pairwise(edges)]
    forward = sum(parts[1:], parts[0])
    backward = sum(parts[-2::-1], parts[-1])
    for gram in (forward, backward):
        assert gram.n == len(D)
        assert gram.dof == len(D) - 1
        close(gram, D, y, 1e-12)


def test_paper_convention_of_degrees_of_freedom_survives_addition():
    D, y = data(3)
    a, b = (Gram.from_data(D[s], y[s]) for s in (slice(0, 80), slice(80, None)))
    assert (a.with_dof(a.n) + b.with_dof(b.n)).dof == len(D)


def test_several_targets_share_one_matrix():
    D, y = data(4)
    first, second = grams_from_blocks([(D, np.column_stack([y, -y]))], ["a", "b", "c", "d", "e"], targets=2)
    assert first.DtD is second.DtD
    np.testing.assert_allclose(second.Dty, -first.Dty)
    np.testing.assert_allclose(first.Dty, Gram.from_data(D, y).Dty)


def test_selection_and_squared_error():
    D, y = data(5)
    gram = Gram.from_data(D, y, list("abcde"))
    theta = np.array([0.5, 0.0, -1.0, 0.0, 2.0])
    best = np.mean(y - D @ theta)
    assert gram.squared_error(theta) == pytest.approx(np.sum((y - D @ theta - best) ** 2), rel=1e-12)
    assert gram.squared_error(theta, 0.3) == pytest.approx(np.sum((y - D @ theta - 0.3) ** 2), rel=1e-12)
    part = gram.select([4, 0, 2])
    assert part.names == ("e", "a", "c")
    close(part, D[:, [4, 0, 2]], y, 1e-13)


def test_standardise_and_restore():
    D, y = data(6, offset=3.0)
    D *= [1e-6, 1e3, 1, 5, 1e9]
    gram = Gram.from_data(D, y)
    standard = gram.standardise(7.0)
    Z = (D - D.mean(axis=0)) / D.std(axis=0)
    close(standard.gram, Z, (y - y.mean()) / 7.0, 1e-12)
    # least squares through the standardised Gram is least squares on the data
    theta = np.linalg.solve(standard.gram.DtD, standard.gram.Dty)
    raw = Posterior(
        names=gram.names, pip=np.ones(5), support=np.ones(5, dtype=bool), coef=theta,
        covariance=np.linalg.inv(standard.gram.DtD), constant=Constant(np.zeros(5)), noise_variance=1.0, n=len(y),
        details=Details("ols"),
    )  # fmt: skip
    back = raw.rescaled(standard)
    design = np.column_stack([np.ones(len(y)), D])
    scale = np.linalg.norm(design, axis=0)
    expected = np.linalg.lstsq(design / scale, y, rcond=None)[0] / scale
    np.testing.assert_allclose(back.coef, expected[1:], rtol=1e-8)
    assert back.intercept == pytest.approx(expected[0], rel=1e-8)
    information = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    np.testing.assert_allclose(back.sd, 7.0 * np.sqrt(np.diag(information))[1:], rtol=1e-7)
    assert back.intercept_sd == pytest.approx(7.0 * np.sqrt(information[0, 0]), rel=1e-7)
    # eqs. (29)-(30)
    rows = D[:3] * 1.5
    np.testing.assert_allclose(back.predict(rows), np.column_stack([np.ones(3), rows]) @ expected, rtol=1e-8)
    full = np.column_stack([np.ones(3), rows])
    np.testing.assert_allclose(
        back.predictive_sd(rows) ** 2,
        49.0 * (1 + np.einsum("ij,jk,ik->i", full, information, full)),
        rtol=1e-6,
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_non_finite_values_are_named(bad):
    D, y = data(7)
    D[3, 1] = bad
    with pytest.raises(InputError, match=r"non-finite.*in b"):
        Gram.from_data(D, y, list("abcde"))


def test_wrong_shapes_and_no_rows():
    with pytest.raises(InputError, match="shape"):
        Gram.from_data(np.ones((3, 2)), np.ones(4))
    with pytest.raises(InputError, match="no rows"):
        Gram.from_data(np.ones((0, 2)), np.ones(0))
    D, y = data(8)
    with pytest.raises(InputError, match="different dictionaries"):
        Gram.from_data(D, y, list("abcde")) + Gram.from_data(D, y, list("abcdf"))


def test_dense_of_any_gram_like():
    D, y = data(9)
    gram = Gram.from_data(D, y)

    class Lazy:
        names = gram.names

        def column(self, j):
            return gram.column(j)

    np.testing.assert_array_equal(dense(Lazy()), gram.DtD)


@pytest.mark.parametrize("P", [3, SMALL + 5])
def test_weight_k_is_the_row_k_times_over(P):
    D, y = data(10, n=BLOCK_ROWS + 300, P=P, offset=5.0)
    weights = np.random.default_rng(0).integers(0, 5, len(y))
    D[weights == 0] = np.nan
    weighted = Gram.from_data(D, y, weights=weights)
    repeated = Gram.from_data(D.repeat(weights, axis=0), y.repeat(weights))
    assert (weighted.n, weighted.dof) == (repeated.n, repeated.dof)
    assert type(weighted.n) is int
    size = np.sqrt(np.outer(repeated.diagonal, repeated.diagonal))
    np.testing.assert_allclose(weighted.DtD / size, repeated.DtD / size, atol=1e-13)
    np.testing.assert_allclose(weighted.Dty / np.sqrt(repeated.diagonal), repeated.Dty / np.sqrt(repeated.diagonal))
    assert weighted.yty == pytest.approx(repeated.yty, rel=1e-13)
    np.testing.assert_allclose(weighted.mean, repeated.mean, rtol=1e-13)
    assert weighted.target_mean == pytest.approx(repeated.target_mean, rel=1e-13)


def test_fractional_weights_equal_the_direct_formula():
    D, y = data(11, offset=1e3)
    weights = np.random.default_rng(1).gamma(0.5, size=len(y))
    gram = Gram.from_data(D, y, weights=weights)
    w, Z, t = weights.astype(np.longdouble), D.astype(np.longdouble), y.astype(np.longdouble)
    Z, t = Z - w @ Z / w.sum(), t - w @ t / w.sum()
    scale = np.sqrt(gram.diagonal)
    np.testing.assert_allclose(
        gram.DtD / np.outer(scale, scale), (w[:, None] * Z).T @ Z / np.outer(scale, scale), 1e-11
    )
    np.testing.assert_allclose(gram.Dty / scale, (w * t) @ Z / scale, 1e-11)
    assert gram.yty == pytest.approx(float(w * t @ t), rel=1e-12)
    assert (gram.n, gram.dof) == (pytest.approx(weights.sum()), pytest.approx(weights.sum() - 1))
    # parts add up, and the way back to the original units keeps the count
    parts = Gram.from_data(D[:70], y[:70], weights=weights[:70]) + Gram.from_data(D[70:], y[70:], weights=weights[70:])
    np.testing.assert_allclose(parts.DtD, gram.DtD, rtol=1e-10)
    assert (parts.n, parts.dof) == (pytest.approx(gram.n), pytest.approx(gram.dof))
    raw = Posterior(
        names=gram.names, pip=np.ones(5), support=np.ones(5, dtype=bool), coef=np.ones(5),
        covariance=np.eye(5), constant=Constant(np.zeros(5)), noise_variance=1.0, n=round(gram.dof) + 1,
        details=Details("ols"),
    )  # fmt: skip
    assert raw.rescaled(gram.standardise()).n == gram.n


def test_a_constant_column_has_no_variance_whatever_the_weights():
    rng = np.random.default_rng(2)
    D = np.column_stack([np.full(2 * BLOCK_ROWS, 0.1), rng.normal(size=2 * BLOCK_ROWS)])
    gram = Gram.from_data(D, D[:, 1], weights=rng.random(len(D)))
    assert gram.DtD[0].tolist() == [0.0, 0.0]
    assert gram.mean[0] == 0.1


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.ones(3), r"one weight per row, shape \(200,\), got shape \(3,\)"),
        (np.ones((200, 2)), "one weight per row"),
        (2.0, "one weight per row"),
        (np.r_[np.ones(150), -1.0, np.ones(49)], r"not negative: weights\[150\] is -1"),
        (np.r_[np.nan, np.ones(199)], r"finite.*weights\[0\] is nan"),
        (np.r_[np.ones(199), np.inf], r"finite.*weights\[199\] is inf"),
        (np.zeros(200), "weights are all zero"),
    ],
)
def test_weights_that_mean_nothing(weights, message):
    with pytest.raises(InputError, match=message):
        Gram.from_data(*data(12), weights=weights)


@pytest.mark.parametrize("weights", [None, np.arange(200) % 3])
def test_grams_of_several_targets(weights):
    D, y = data(13)
    Y = np.column_stack([y, y**2, D[:, 1]])
    grams = grams_from_data(D, Y, list("abcde"), weights)
    assert all(gram.DtD is grams[0].DtD for gram in grams)
    for gram, target in zip(grams, Y.T, strict=True):
        alone = Gram.from_data(D, target, list("abcde"), weights)
        assert (gram.names, gram.n, gram.dof) == (alone.names, alone.n, alone.dof)
        for name in ("DtD", "Dty", "yty", "mean", "target_mean"):
            np.testing.assert_allclose(getattr(gram, name), getattr(alone, name), rtol=1e-12, atol=1e-12)
    with pytest.raises(InputError, match="as many rows"):
        grams_from_data(D, y)
