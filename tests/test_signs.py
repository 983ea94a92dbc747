"""Known signs of coefficients: orthants, weights of models and truncated moments, against slow twins."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats
from studies.overridden import overridden

from bayeq import SpikeSlabBMA
from bayeq.errors import DataWarning, InputError
from bayeq.inference.auto import spike_slab_auto
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.engines import ENGINES
from bayeq.inference.gram import Gram
from bayeq.inference.prior import SIGNED, Prior
from bayeq.inference.signs import Orthants
from bayeq.numerics.settings import INFERENCE
from tests import reference

# ------------------------------------------------------------------------------------------------------------ orthants


@pytest.mark.parametrize("k", [2, 3, 5])
@pytest.mark.parametrize("h", [2.0, 40.0])
def test_orthants_are_those_of_scipy(k, h):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        A = rng.normal(size=(k, k + 1))
        V, s = A @ A.T, 3.0
        m = (rng.normal(size=k) + 0.5) * np.sqrt(np.diagonal(V))
        found = float(np.exp(Orthants(m[None], V[None], np.array([s]), h).log_probability[0]))
        scale = V * s / (2 * h)
        expected = stats.multivariate_t.cdf(m, np.zeros(k), scale, df=2 * h, maxpts=20_000 * k, random_state=0)
        assert found == pytest.approx(float(expected), abs=2e-3)


@pytest.mark.parametrize(("h", "t"), [(h, t) for h in (3.0, 500.0) for t in (3.0, -0.5, -8.0, -30.0)])
def test_one_truncated_student_t_in_closed_form(h, t):
    # theta = sqrt(s/2h) (t + T), T a Student t; partial moments of T beyond a = -t by integrating its density by parts
    nu, a, s = 2 * h, -t, 2.0
    beyond = stats.t.sf(a, nu)
    first = stats.t.pdf(a, nu) * (nu + a * a) / (nu - 1) / beyond
    second = nu * ((nu - 1) / (nu - 2) * stats.t.sf(a * math.sqrt((nu - 2) / nu), nu - 2) / beyond - 1)
    scale = math.sqrt(s / nu)
    orthant = Orthants(np.array([[scale * t]]), np.ones((1, 1, 1)), np.array([s]), h)
    assert orthant.log_probability[0] == pytest.approx(math.log(beyond), abs=2e-3)
    mean, covariance, _ = orthant.moments()
    assert mean[0, 0] == pytest.approx(scale * (t + first), rel=1e-2)
    # with few degrees of freedom rare large values make up much of the variance
    assert covariance[0, 0, 0] == pytest.approx(scale**2 * (second - first**2), rel=8e-2 if h < 10 else 1e-3)


@pytest.mark.parametrize("far", [0.0, -8.0, -25.0])
@pytest.mark.parametrize("correlation", [-0.9, 0.3, 0.95])
def test_two_coefficients_far_out_by_quadrature(far, correlation):
    # the first is t, and given it the second is t with a degree of freedom more
    h, s = 14.0, 28.0
    nu, m = 2 * h, np.array([1.0, far])
    V = np.array([[1.0, correlation], [correlation, 1.0]])
    x = np.linspace(0.0, 200.0, 100_001)
    rest = (1 - correlation**2) * (nu + (x - m[0]) ** 2) / (nu + 1)
    density = stats.t.pdf(x, nu, m[0], 1.0)
    expected = integrate.simpson(density * stats.t.cdf((m[1] + correlation * (x - m[0])) / np.sqrt(rest), nu + 1), x=x)
    found = Orthants(m[None], V[None], np.array([s]), h).log_probability[0]
    assert found == pytest.approx(math.log(expected), abs=2e-2)


# --------------------------------------------------------------------------------------------------------- enumeration


def by_sampling(D, y, prior, draws, rng):
    """PIPs, mean and covariance of theta and mean of sigma^2 by draws of every model, those of wrong signs rejected."""
    v, a, b = prior.slab_variance, prior.noise_shape, prior.noise_rate
    N, P = len(y) - 1, D.shape[1]
    models, logs, _, _ = reference.enumerate_models(D, y, v_s=v, p0=prior.prior_inclusion, a=a, b=b, N=N)
    weight, first, second, noise = np.zeros(len(models)), np.zeros((len(models), P)), [], np.zeros(len(models))
    for k, z in enumerate(models):
        V = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / v)
        m = V @ D[:, z].T @ y
        s = 2 * b + y @ y - m @ D[:, z].T @ y
        variance = 0.5 * s / rng.gamma(a + 0.5 * N, size=draws)
        theta = np.zeros((draws, P))
        theta[:, z] = m + np.sqrt(variance)[:, None] * (rng.normal(size=(draws, z.sum())) @ np.linalg.cholesky(V).T)
        right = (prior.signs * theta >= 0).all(axis=1)
        assert right.sum() > 100 or math.exp(logs[k] - logs.max()) < 0.1  # enough of a model that matters
        weight[k] = math.exp(logs[k] - logs.max()) * 2.0 ** np.count_nonzero(z & (prior.signs != 0)) * right.mean()
        kept = theta[right] if right.any() else np.zeros((1, P))
        first[k], noise[k] = kept.mean(axis=0), variance[right].mean() if right.any() else 0.0
        second.append(kept.T @ kept / len(kept))
    weight /= weight.sum()
    mean = weight @ first
    covariance = np.tensordot(weight, second, 1) - np.outer(mean, mean)
    return weight @ models, mean, covariance, weight @ noise, dict(zip(map(bytes, models), first, strict=True))


@pytest.mark.parametrize("seed", range(4))
def test_signs_against_draws_of_every_model(seed):
    rng = np.random.default_rng(seed)
    P = int(rng.integers(3, 6))
    D, y, _ = reference.random_problem(rng, n=12, P=P, rho=0.8, noise=5.0, active=0.5)
    prior = Prior(5.0, 0.3, 2.0, 2.0, signs=rng.choice([-1, 0, 1], size=P, p=[0.4, 0.2, 0.4]))
    pip, mean, covariance, noise, given_model = by_sampling(D, y, prior, 60_000, rng)
    scale = np.sqrt(np.diagonal(covariance)).max()
    for most in (14, 0):
        fit = spike_slab_bma(Gram.from_data(D, y), prior, enumerate_up_to=most, tolerance=1e-4)
        np.testing.assert_allclose(fit.pip, pip, atol=5e-3)
        np.testing.assert_allclose(fit.averaged.coef, mean, atol=0.02 * scale)
        np.testing.assert_allclose(fit.averaged.sd, np.sqrt(np.diagonal(covariance)), atol=0.02 * scale)
        listed = np.ix_(fit.average.terms, fit.average.terms)
        np.testing.assert_allclose(fit.average.covariance, covariance[listed], atol=0.03 * scale**2)
        assert fit.noise_variance == pytest.approx(noise, rel=0.01)
        np.testing.assert_allclose(fit.coef, given_model[bytes(fit.support)], atol=0.03 * scale)
        assert (fit.coef * prior.signs >= 0).all()


def assert_as_enumerated(D, y, signs, fit):
    models, weight = reference.signed_models(D, y, signs)
    listed = {bytes(model) for model in fit.average.models}
    outside = sum(w for model, w in zip(models, weight, strict=True) if bytes(model) not in listed)
    assert outside <= fit.average.left_out + 1e-5 <= 5.1e-3  # less than 2^8 models 12 nats behind
    np.testing.assert_allclose(fit.pip, weight @ models, atol=3e-3)


@pytest.mark.parametrize("most", [0, 14])
@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 10))])
def test_models_are_those_of_an_enumeration(seed, most):
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, n=60, P=8, rho=0.8, noise=float(rng.choice([0.3, 1.0, 3.0])), active=0.4)
    signs = np.zeros(8, dtype=int)
    known = int(rng.integers(1, 5))
    signs[rng.choice(8, known, replace=False)] = rng.choice([-1, 1], known)
    fit = spike_slab_bma(Gram.from_data(D, y), Prior(signs=signs), enumerate_up_to=most)
    assert_as_enumerated(D, y, signs, fit)


@pytest.mark.parametrize("seed", range(4))
def test_the_mass_moves_to_models_that_are_hopeless_without_the_sign(seed):
    # y = -x + 2 x**3: without x**3 the coefficient of x is positive, and with x >= 0 the models of x**3 without x win
    rng = np.random.default_rng(seed)
    x = rng.normal(size=300)
    columns = [x, x**3, x**5, x * np.abs(x), np.sign(x), *rng.normal(size=(3, 300))]
    D = np.column_stack([(c - c.mean()) / c.std() for c in columns])
    y = 2 * D[:, 1] - D[:, 0] + 0.1 * rng.normal(size=300)
    y -= y.mean()
    signs = np.array([1, 0, 0, -1, 0, 0, 0, 0])
    fit, free = (spike_slab_bma(Gram.from_data(D, y), Prior(signs=s), enumerate_up_to=0) for s in (signs, None))
    assert "x0" in fit.details.contradicted
    assert not (free.average.models == fit.average.models[0]).all(axis=1).any()
    assert_as_enumerated(D, y, signs, fit)


# -------------------------------------------------------------------------------------------------- agree or contradict


def agreeing(seed, P=6, n=400):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(n, P)) + 0.5 * rng.normal(size=(n, 1))
    theta = np.zeros(P)
    theta[:3] = [1.0, -2.0, 0.05]
    return Gram.from_data(D, D @ theta + 0.5 * rng.normal(size=n)), np.sign(theta) * [1, 1, 0, 0, 0, 0]


def test_signs_that_the_data_leave_no_doubt_of_change_nothing():
    gram, signs = agreeing(0)
    free, known = spike_slab_bma(gram), spike_slab_bma(gram, Prior(signs=signs))
    # terms 0 and 1 are in every model: the factor of 2 of each is common to all
    np.testing.assert_allclose(known.pip, free.pip, atol=1e-12)
    assert known.coef.tobytes() == free.coef.tobytes()
    assert known.covariance.tobytes() == free.covariance.tobytes()
    np.testing.assert_allclose(known.averaged.sd, free.averaged.sd, rtol=1e-9)
    assert known.noise_variance == pytest.approx(free.noise_variance, rel=1e-9)
    assert known.details.contradicted == ()
    assert spike_slab_bma(gram, Prior(signs=np.zeros(6))).pip.tobytes() == free.pip.tobytes()


def test_odds_of_a_single_term_in_closed_form():
    rng = np.random.default_rng(4)
    D = rng.normal(size=(30, 1))
    D = (D - D.mean()) / D.std()
    gram = Gram.from_data(D, 0.2 * D[:, 0] + rng.normal(size=30))
    free = spike_slab_bma(gram).pip[0]
    A = 30 + 1 / 10
    m, s = gram.Dty[0] / A, gram.yty + 2e-4 - gram.Dty[0] ** 2 / A
    dof = 29 + 2e-4
    for sign in (1, -1):
        right = stats.t.cdf(sign * m / math.sqrt(s / A / dof), dof)
        pip = spike_slab_bma(gram, Prior(signs=[sign])).pip[0]
        assert pip / (1 - pip) == pytest.approx(free / (1 - free) * 2 * right, rel=1e-9)


@pytest.mark.parametrize("P", [8, 18])
def test_a_sign_that_the_data_contradict_takes_the_term_out(P):
    rng = np.random.default_rng(P)
    D = rng.normal(size=(300, P)) + 0.7 * rng.normal(size=(300, 1))
    gram = Gram.from_data(D, D[:, 0] - D[:, 1] + 0.3 * D[:, 2] + 0.5 * rng.normal(size=300))
    signs, p0 = np.zeros(P), np.full(P, 0.1)
    signs[:2], p0[0] = -1, 0.0  # the sign of the second is right
    wrong = spike_slab_bma(gram, Prior(signs=signs), tolerance=1e-4)
    signs[0] = 0
    without = spike_slab_bma(gram, Prior(prior_inclusion=p0, signs=signs), tolerance=1e-4)
    assert (wrong.details.contradicted, without.details.contradicted) == (("x0",), ())
    assert wrong.pip[0] < 1e-3
    np.testing.assert_allclose(wrong.pip, without.pip, atol=2e-3)
    np.testing.assert_allclose(wrong.coef, without.coef, rtol=1e-6)
    assert wrong.average.left_out < 1.1e-4


def test_a_forced_term_keeps_to_its_side_however_wrong():
    # 45 standard deviations on the other side
    rng = np.random.default_rng(0)
    D = rng.normal(size=(2000, 3))
    gram = Gram.from_data(D, 5.0 * D[:, 0] + D[:, 1] + 0.1 * rng.normal(size=2000))
    prior = Prior(prior_inclusion=[1.0, 0.1, 0.1], signs=[-1, 0, 0])
    fit = spike_slab_bma(gram, prior)
    assert fit.pip[0] == pytest.approx(1.0)
    # half normal at its edge: the mean is sd/45, with the 45 sd that the least-squares value is off
    assert -5e-3 < fit.coef[0] < 0.0
    without = spike_slab_bma(gram, Prior(prior_inclusion=[0.0, 0.1, 0.1]))
    np.testing.assert_allclose(fit.coef[1:], without.coef[1:], rtol=1e-3)
    assert fit.noise_variance == pytest.approx(without.noise_variance, rel=1e-2)
    with pytest.raises(InputError, match="too improbable to draw"):
        sample_average(Problem.of(gram, prior), fit.average, 10, rng, prior.limits)


def test_degenerate_problems_end():
    rng = np.random.default_rng(0)
    D = rng.normal(size=(30, 4))
    for design, y in [
        (D, np.zeros(30)),
        (D, D[:, 0]),
        (np.column_stack([D, np.ones(30)]), rng.normal(size=30)),
        (np.column_stack([D, D]), D[:, 1] + 0.1 * rng.normal(size=30)),
        (rng.normal(size=(10, 15)), rng.normal(size=10)),
        (D[:3, :1], np.array([1.0, 2.0, 4.0])),
    ]:
        signs = np.resize([-1, 1, 0], design.shape[1])
        fit = spike_slab_bma(Gram.from_data(design, y), Prior(signs=signs))
        assert np.isfinite(fit.pip).all()
        assert np.isfinite(fit.covariance).all()
        assert np.isfinite(fit.averaged.sd).all()
        assert (fit.coef * signs >= 0).all()
        np.testing.assert_array_equal(fit.support, fit.pip > 0.5)


def test_turned_columns_and_their_order_are_symmetries():
    rng = np.random.default_rng(3)
    D, y, _ = reference.random_problem(rng, n=40, P=5, rho=0.7, noise=2.0, active=0.5)
    signs, order = np.array([1, -1, 0, 1, 0]), np.array([3, 0, 4, 1, 2])
    plain = spike_slab_bma(Gram.from_data(D, y), Prior(signs=signs))
    turned = spike_slab_bma(Gram.from_data(-D, y), Prior(signs=-signs))
    mixed = spike_slab_bma(Gram.from_data(D[:, order], y), Prior(signs=signs[order]))
    np.testing.assert_allclose(turned.pip, plain.pip, atol=1e-9)
    np.testing.assert_allclose(turned.coef, -plain.coef, atol=1e-9)
    np.testing.assert_allclose(mixed.pip, plain.pip[order], atol=3e-3)
    again = spike_slab_bma(Gram.from_data(D, y), Prior(signs=signs))
    assert again.averaged.sd.tobytes() == plain.averaged.sd.tobytes()


def test_draws_of_the_average_have_its_moments():
    rng = np.random.default_rng(0)
    D, y, _ = reference.random_problem(rng, n=12, P=4, rho=0.8, noise=5.0, active=0.5)
    gram, prior = Gram.from_data(D, y), Prior(5.0, 0.3, 2.0, 2.0, signs=[1, 0, -1, 1])
    fit = spike_slab_bma(gram, prior)
    theta, noise, which = sample_average(Problem.of(gram, prior), fit.average, 20_000, rng, prior.limits)
    assert (theta * prior.signs >= 0).all()
    np.testing.assert_array_equal(theta != 0, fit.average.models[which])
    # five standard errors of independent draws
    np.testing.assert_allclose(
        theta.mean(axis=0), fit.averaged.coef, atol=5 * fit.averaged.sd.max() / math.sqrt(20_000)
    )
    np.testing.assert_allclose(theta.std(axis=0), fit.averaged.sd, atol=0.05 * fit.averaged.sd.max())
    assert noise.mean() == pytest.approx(fit.noise_variance, rel=0.02)


# ------------------------------------------------------------------------------------------------ engines and estimator


def test_who_takes_signs():
    gram, signs = agreeing(0)
    prior = Prior(signs=signs)
    for name in set(ENGINES) - set(SIGNED):
        with pytest.raises(
            InputError, match=f"method '{name}' takes no signs of coefficients; choose one of: auto, bma"
        ):
            ENGINES[name].run(gram, prior)
    for bad in ([1, -1], np.full(6, 2), np.full(6, 0.5), 1):
        with pytest.raises(InputError, match="signs must be"):
            spike_slab_bma(gram, Prior(signs=bad))


def test_auto_with_signs_is_model_averaging_alone():
    gram, signs = agreeing(0)
    prior = Prior(signs=signs)
    with overridden(INFERENCE, most_left_out=-1.0):  # the sampler is not an alternative
        auto, bma = spike_slab_auto(gram, prior), spike_slab_bma(gram, prior)
    details = auto.details
    assert (details.method, details.elbo, details.optimum, len(details.elbo_trace)) == ("auto", None, None, 0)
    np.testing.assert_array_equal(auto.pip, bma.pip)
    np.testing.assert_array_equal(auto.covariance, bma.covariance)


def test_the_estimator_keeps_to_the_signs():
    rng = np.random.default_rng(0)
    D = rng.normal(size=(60, 4)) + 0.8 * rng.normal(size=(60, 1))
    y = D @ [1.0, 0.05, -0.05, 0.0] + rng.normal(size=60)
    D = D * [1.0, 1e3, 1e-2, 1.0] + 3.0
    signs, p0 = np.array([0, -1, 1, 0]), [0.1, 1.0, 1.0, 0.1]
    free, fit = SpikeSlabBMA(prior_inclusion=p0).fit(D, y), SpikeSlabBMA(prior_inclusion=p0, signs=signs).fit(D, y)
    assert (free.coef_ * signs < 0).any()
    assert (fit.coef_ * signs >= 0).all()
    assert (fit.coef_[1:3] != 0).all()
    # half normals vary less than the normals that they are cut from
    assert np.all(np.diagonal(fit.covariance_)[1:3] < np.diagonal(free.covariance_)[1:3])
    assert (fit.sample(500)[0] * signs >= 0).all()
    turned = SpikeSlabBMA(prior_inclusion=p0, signs=-signs).fit(-D, y)
    np.testing.assert_allclose(turned.coef_, -fit.coef_, rtol=1e-6, atol=1e-12)
    with pytest.warns(DataWarning, match="the data contradict the known sign of x0 "):
        SpikeSlabBMA(signs=[-1, 0, 0, 0]).fit(D, y)
