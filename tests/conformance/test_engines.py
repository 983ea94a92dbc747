"""What every engine must do; a new row of the table inherits it all."""

from __future__ import annotations

import numpy as np
import pytest

from bayeq.inference.engines import ENGINES
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from tests import reference

pytestmark = pytest.mark.parametrize("name", ENGINES.load())


def problem(seed=0, n=300, P=9):
    D, y, truth = reference.random_problem(np.random.default_rng(seed), n=n, P=P, rho=0.6, noise=0.2)
    return D, y, truth


def run(name, D, y, prior=None):
    return ENGINES[name].run(
        Gram.from_data(D, y, [f"f{j}" for j in range(D.shape[1])]), prior or Prior(), **cheap(name)
    )


def cheap(name):
    """Options that make a sampler quick."""
    return {"samples": 600, "burn_in": 100, "seed": 1} if ENGINES[name].random else {}


@pytest.mark.parametrize("seed", range(5))
def test_shapes_ranges_and_consistency(name, seed):
    D, y, _ = problem(seed)
    fit = run(name, D, y)
    assert isinstance(fit, Posterior)
    P, r = D.shape[1], int(fit.support.sum())
    assert fit.names == tuple(f"f{j}" for j in range(P))
    assert fit.pip.shape == fit.coef.shape == fit.support.shape == fit.sd.shape == (P,)
    assert np.all((fit.pip >= 0) & (fit.pip <= 1))
    np.testing.assert_array_equal(fit.support, fit.pip > 0.5)
    assert not fit.coef[~fit.support].any()
    assert fit.covariance.shape == (r, r)
    assert np.all(np.linalg.eigvalsh(fit.covariance) > 0) if r else True
    assert fit.noise_variance > 0
    assert fit.n == len(y)
    assert fit.details.converged or fit.details.rhat is not None


def test_finds_a_clear_law(name):
    rng = np.random.default_rng(1)
    D = rng.normal(size=(500, 6))
    y = D @ [0, 3.0, 0, 0, -2.0, 0] + rng.normal(size=500)
    fit = run(name, D, y)
    assert fit.support[[1, 4]].all()
    assert np.sqrt(fit.noise_variance) == pytest.approx(1.0, rel=0.1)
    assert abs(fit.coef[1] - 3) < 5 * fit.sd[1]


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_the_terms_does_not_matter(name, seed):
    D, y, _ = problem(seed)
    order = np.random.default_rng(seed).permutation(D.shape[1])
    plain, mixed = run(name, D, y), run(name, D[:, order], y)
    np.testing.assert_array_equal(plain.support[order], mixed.support)
    np.testing.assert_allclose(plain.coef[order], mixed.coef, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_signs_of_terms_and_target_are_a_symmetry(name, seed):
    D, y, _ = problem(seed)
    sign = np.where(np.arange(D.shape[1]) % 2, -1.0, 1.0)
    plain, flipped = run(name, D, y), run(name, D * sign, -y)
    np.testing.assert_allclose(plain.pip, flipped.pip, atol=1e-9)
    np.testing.assert_allclose(plain.coef, -sign * flipped.coef, rtol=1e-8, atol=1e-10)


def test_runs_on_any_gram_that_answers_the_protocol(name):
    D, y, _ = problem()
    gram = Gram.from_data(D, y)

    class Lazy:
        """Columns computed when asked for."""

        names, dof, diagonal, Dty, yty = gram.names, gram.dof, gram.diagonal, gram.Dty, gram.yty

        def column(self, j):
            Z = D - D.mean(axis=0)
            return Z.T @ Z[:, j]

    a, b = (ENGINES[name].run(g, Prior(), **cheap(name)) for g in (gram, Lazy()))
    np.testing.assert_allclose(a.coef, b.coef, rtol=1e-8, atol=1e-10)
    np.testing.assert_array_equal(a.support, b.support)


def test_same_input_same_bytes(name):
    D, y, _ = problem()
    a, b = run(name, D, y), run(name, D, y)
    assert a.coef.tobytes() == b.coef.tobytes()
    assert a.covariance.tobytes() == b.covariance.tobytes()


def test_degenerate_problems_end(name):
    rng = np.random.default_rng(0)
    D = rng.normal(size=(30, 4))
    for design, y in [
        (D, np.zeros(30)),
        (D, D[:, 0]),
        (np.column_stack([D, np.ones(30)]), rng.normal(size=30)),
        (np.column_stack([D, D]), D[:, 1] + 0.1 * rng.normal(size=30)),
        (rng.normal(size=(10, 40)), rng.normal(size=10)),
        (D[:3, :1], np.array([1.0, 2.0, 4.0])),
    ]:
        fit = run(name, design, y)
        assert np.all(np.isfinite(fit.coef))
        assert np.all(np.isfinite(fit.covariance))
        assert np.isfinite(fit.noise_variance)


def test_ten_thousand_rows_or_their_gram_make_no_difference(name):
    D, y, _ = problem(n=1000)
    whole = run(name, D, y)
    names = [f"f{j}" for j in range(D.shape[1])]
    parts = Gram.from_data(D[:123], y[:123], names) + Gram.from_data(D[123:], y[123:], names)
    merged = ENGINES[name].run(parts, Prior(), **cheap(name))
    np.testing.assert_array_equal(whole.support, merged.support)
    np.testing.assert_allclose(whole.coef, merged.coef, rtol=1e-6, atol=1e-9)
