"""The PySINDy plug-in.

Tests named ``test_pysindy_...`` are those of PySINDy 2.1.0's own test_optimizers.py (MIT licence, Copyright (c) 2019
Brian de Silva and others) that hold for any optimizer, with the plug-in in the place of its optimizers.
"""

from __future__ import annotations

import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.utils.validation import check_is_fitted

import bayeq as bq
from bayeq.adapters.pysindy.library import terms_of
from bayeq.adapters.pysindy.series import pieces_of
from bayeq.errors import DataWarning, InputError, MissingExtraError
from tests.draws import draws

ps = pytest.importorskip("pysindy", reason="PySINDy is not installed: pip install 'bayeq[pysindy]'")

from bayeq.adapters.pysindy import KinematicDerivative, SpikeSlabOptimizer  # noqa: E402

# what PySINDy and packages beneath it warn of is not ours
pytestmark = [
    pytest.mark.filterwarnings("default::DeprecationWarning"),
    pytest.mark.filterwarnings("default::PendingDeprecationWarning"),
    pytest.mark.filterwarnings("default::FutureWarning"),
    pytest.mark.filterwarnings("default::UserWarning"),
]

LORENZ = [{"x0", "x1"}, {"x0", "x1", "x0 x2"}, {"x2", "x0 x1"}]


def lorenz(start=(-8.0, 8.0, 27.0), step=0.005, end=8.0, noise=0.0, seed=0):
    t = np.arange(0.0, end, step)
    x = solve_ivp(
        lambda t, z: [10 * (z[1] - z[0]), z[0] * (28 - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]],
        (0, t[-1]),
        start,
        t_eval=t,
        method="LSODA",
        rtol=1e-11,
        atol=1e-11,
    ).y.T
    return t, x + noise * x.std(axis=0) * np.random.default_rng(seed).standard_normal(x.shape)


def terms(model):
    names = np.array(model.get_feature_names())
    return [set(names[row != 0]) for row in model.coefficients()]


@pytest.fixture(scope="module")
def clean():
    return lorenz()


@pytest.fixture(scope="module")
def library(clean):
    t, x = clean
    D = np.asarray(ps.PolynomialLibrary(2).fit_transform(x))
    return D, ps.FiniteDifference(order=4)(x, t)


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("degree", [2, 3])
def test_clean_record_whatever_the_differences(clean, order, degree):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(degree), ps.FiniteDifference(order=order))
    model.fit(x, t)
    assert terms(model) == LORENZ
    # of second order: what their error leaves of the coefficients
    assert model.coefficients()[2][model.coefficients()[2] != 0] == pytest.approx([-8 / 3, 1.0], rel=1e-3)


@pytest.mark.parametrize("method", [KinematicDerivative(), ps.FiniteDifference(order=2)])
def test_noisy_record(method):
    t, x = lorenz(noise=0.01, end=10.0)
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(3), method).fit(x, t)
    assert terms(model) == LORENZ


def test_the_constant_is_a_candidate():
    t = np.arange(0, 40, 0.01)
    x = solve_ivp(
        lambda t, x: [x[1], 0.5 - x[0] - 0.3 * x[1]], (0, 40), [2.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-10
    ).y.T
    with_constant = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2)).fit(x, t)
    assert terms(with_constant) == [{"x1"}, {"1", "x0", "x1"}]
    kept_out = [0.0] + 5 * [0.1]
    without = ps.SINDy(SpikeSlabOptimizer(prior_inclusion=kept_out), ps.PolynomialLibrary(2)).fit(x, t)
    assert "1" not in terms(without)[1]


def test_nothing_is_centred_where_there_is_no_constant():
    rng = np.random.default_rng(0)
    D = 5.0 + rng.normal(size=(400, 3))
    y = 2.0 * D[:, 0] + 0.01 * rng.normal(size=400)
    found = SpikeSlabOptimizer(noise_floor=0.0).fit(D, y)
    expected = D[:, 0] @ y / (D[:, 0] @ D[:, 0])
    assert found.coef_[0] == pytest.approx([expected, 0.0, 0.0], rel=1e-6)
    assert found.posteriors_[0].intercept == 0.0


@settings(max_examples=draws(12), deadline=None)
@given(powers=st.lists(st.integers(-6, 6), min_size=10, max_size=10), target=st.integers(-6, 6))
def test_units_of_columns_and_target_do_not_matter(library, powers, target):
    D, y = library
    scale, unit = 10.0 ** np.array(powers), 10.0**target
    base, scaled = SpikeSlabOptimizer().fit(D, y), SpikeSlabOptimizer().fit(D * scale, y * unit)
    assert (scaled.ind_ == base.ind_).all()
    np.testing.assert_allclose(scaled.coef_, base.coef_ / scale * unit, rtol=1e-6)


def test_several_trajectories_are_not_joined():
    first, second = lorenz(end=5.0), lorenz((5.0, -6.0, 20.0), end=5.0)
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2)).fit([first[1], second[1]], [first[0], second[0]])
    assert terms(model) == LORENZ
    rows = np.concatenate([first[1], second[1]])
    assert [p.stop - p.start for p in pieces_of(rows, np.zeros(len(rows), bool))] == [1000, 1000]


def test_endpoints_that_were_dropped(clean):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2), ps.FiniteDifference(drop_endpoints=True)).fit(x, t)
    assert terms(model) == LORENZ


def test_rows_in_no_order_are_no_time_series(library):
    D, y = library
    order = np.random.default_rng(0).permutation(len(D))
    assert pieces_of(D[order], np.zeros(len(D), bool)) is None
    names = np.array(ps.PolynomialLibrary(2).fit(np.ones((2, 3))).get_feature_names())
    found = SpikeSlabOptimizer().fit(D[order], y[order])
    assert [set(names[row]) for row in found.ind_] == LORENZ


def test_posterior_of_each_target(library):
    D, y = library
    found = SpikeSlabOptimizer().fit(D, y)
    assert len(found.posteriors_) == 3
    for k, posterior in enumerate(found.posteriors_):
        size = int(found.ind_[k].sum())
        assert posterior.covariance.shape == (size, size)
        assert (posterior.sd[found.ind_[k]] > 0).all()
        assert (found.pip_[k] == posterior.pip).all()
        assert (found.coef_[k][~found.ind_[k]] == 0.0).all()
    assert found.complexity == 7


def test_weights_count_rows():
    rng = np.random.default_rng(3)
    D, w = rng.normal(size=(60, 4)), rng.integers(0, 4, 60)
    y = D @ [1.0, 0.0, -2.0, 0.0] + 0.1 * rng.normal(size=60)
    weighted = SpikeSlabOptimizer(noise_floor=0.0).fit(D, y, sample_weight=w)
    repeated = SpikeSlabOptimizer(noise_floor=0.0).fit(np.repeat(D, w, axis=0), np.repeat(y, w))
    np.testing.assert_allclose(weighted.coef_, repeated.coef_, rtol=1e-7)
    np.testing.assert_allclose(weighted.pip_, repeated.pip_, atol=1e-7)


def test_a_given_floor_keeps_small_terms_out():
    rng = np.random.default_rng(5)
    D = rng.normal(size=(300, 3))
    y = D @ [1.0, 0.001, 0.0]
    assert SpikeSlabOptimizer(noise_floor=0.0).fit(D, y).ind_.tolist() == [[True, True, False]]
    assert SpikeSlabOptimizer(noise_floor=0.05).fit(D, y).ind_.tolist() == [[True, False, False]]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"unbias": True}, "unbias must be False"),
        ({"prior_inclusion": 2.0}, "between 0 and 1"),
        ({"slab_variance": -1.0}, "slab_variance"),
        ({"method": "stlsq"}, "stlsq"),
        ({"noise_floor": -1.0}, "noise_floor"),
        ({"noise_floor": [1.0, 2.0]}, "noise_floor"),
    ],
)
def test_bad_parameters_are_refused_with_the_reason(library, parameters, words):
    with pytest.raises(InputError, match=words):
        SpikeSlabOptimizer(**parameters).fit(*library)


def test_bad_data_are_refused_with_the_reason():
    optimizer = SpikeSlabOptimizer()
    with pytest.raises(InputError, match="need a library"):
        optimizer.fit(np.ones((5, 2)), np.ones(4))
    with pytest.raises(InputError, match="infinite value in row 2"):
        optimizer.fit(np.array([[1.0], [np.inf], [2.0]]), np.ones(3))
    with pytest.raises(InputError, match="usable rows"):
        optimizer.fit(np.array([[1.0], [np.nan]]), np.ones(2))
    with pytest.raises(InputError, match="one weight per row"):
        optimizer.fit(np.ones((5, 2)), np.ones(5), sample_weight=np.ones(3))


def test_nothing_survives_a_refit(library):
    D, y = library
    optimizer = SpikeSlabOptimizer().fit(D, y)
    other = optimizer.fit(D[:, :4], y[:, :1])
    fresh = SpikeSlabOptimizer().fit(D[:, :4], y[:, :1])
    assert vars(other).keys() == vars(fresh).keys()
    assert other.coef_.tobytes() == fresh.coef_.tobytes()
    with pytest.raises(InputError):
        optimizer.fit(np.full((3, 2), np.nan), np.ones(3))
    assert not hasattr(optimizer, "coef_")


def test_scikit_learn_conventions(library):
    D, y = library
    given = {"slab_variance": 50.0, "prior_inclusion": 0.2, "method": "vb", "noise_floor": 0.1}
    optimizer = clone(SpikeSlabOptimizer(**given))
    assert {name: optimizer.get_params()[name] for name in given} == given
    assert optimizer.set_params(method="bma") is optimizer
    assert optimizer.method == "bma"
    search = GridSearchCV(SpikeSlabOptimizer(), {"prior_inclusion": [0.05, 0.2]}, cv=2).fit(D, y)
    assert search.best_score_ > 0.99


def test_grid_search_around_sindy_itself(clean):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2))
    model.set_params(optimizer__prior_inclusion=0.3, differentiation_method=KinematicDerivative())
    assert clone(model).optimizer.prior_inclusion == 0.3
    assert terms(model.fit(x, t)) == LORENZ


def test_ensemble(library):
    np.random.seed(0)  # noqa: NPY002  PySINDy draws from the global generator
    ensemble = ps.EnsembleOptimizer(SpikeSlabOptimizer(), bagging=True, n_models=3)
    ensemble.fit(*library)
    single = SpikeSlabOptimizer().fit(*library)
    assert ((ensemble.coef_ != 0) == single.ind_).all()


# PySINDy's own generic tests


def test_pysindy_fit_and_complexity():
    x = np.linspace(1, 10, 100)[:, None]
    optimizer = SpikeSlabOptimizer()
    with pytest.raises(NotFittedError):
        optimizer.complexity  # noqa: B018
    optimizer.fit(x, 2 * x[:, 0])
    check_is_fitted(optimizer)
    assert optimizer.complexity >= 0
    assert optimizer.coef_.shape == (1, 1)
    wrapped = ps.WrappedOptimizer(SpikeSlabOptimizer(), unbias=False)
    wrapped.fit(x, 2 * x)
    check_is_fitted(wrapped)
    assert wrapped.complexity == 1


def test_pysindy_not_fitted():
    with pytest.raises(NotFittedError):
        SpikeSlabOptimizer().predict(np.ones((1, 3)))


def test_pysindy_supports_multiple_targets():
    from pysindy.utils import supports_multiple_targets

    assert supports_multiple_targets(SpikeSlabOptimizer())


@pytest.mark.parametrize("options", [{"copy_X": False}, {"normalize_columns": True}])
def test_pysindy_alternate_parameters(options):
    x = np.linspace(0, 5, 100)[:, None]
    model = SpikeSlabOptimizer(**options)
    model.fit(x, 2 * x[:, 0])
    model.fit(x, 2 * x[:, 0], sample_weight=x[:, 0])
    check_is_fitted(model)


def test_pysindy_sample_weight():
    x = np.linspace(0, 5, 100)[:, None]
    weights = np.ones(100)
    weights[::2] = 0
    check_is_fitted(SpikeSlabOptimizer().fit(x, x, sample_weight=weights))


def test_pysindy_illegal_unbias():
    x = np.linspace(0, 5, 100)[:, None]
    with pytest.raises(ValueError):
        SpikeSlabOptimizer(unbias=True).fit(x, x)


@pytest.mark.parametrize(
    "options",
    [
        {"library_ensemble": True, "n_models": 2},
        {"bagging": True, "n_models": 2, "n_subset": 2},
        {"library_ensemble": True, "bagging": True, "n_models": 2, "n_subset": 2},
    ],
)
def test_pysindy_ensemble_optimizer(clean, options):
    _, x = clean
    optimizer = ps.EnsembleOptimizer(SpikeSlabOptimizer(), **options)
    optimizer.fit(x, x)
    assert optimizer.coef_.shape == (3, 3)
    assert len(optimizer.coef_list) == 2


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"bagging": True, "n_models": 0},
        {"bagging": True, "n_subset": 0},
        {"library_ensemble": True, "n_candidates_to_drop": 0},
    ],
)
def test_pysindy_bad_ensemble_params(options):
    with pytest.raises(ValueError):
        ps.EnsembleOptimizer(opt=SpikeSlabOptimizer(), **options)


def test_pysindy_optimizers_verbose(capsys):
    x = np.linspace(0, 2, 10)[:, None]
    SpikeSlabOptimizer(verbose=True).fit(x, x)
    assert capsys.readouterr().out.startswith("target 0: 1 of 1 terms")
    SpikeSlabOptimizer().fit(x, x)
    assert not capsys.readouterr().out


def test_pysindy_complexity_not_fitted():
    rng = np.random.default_rng(0)
    x, optimizer = rng.normal(size=(20, 2)), SpikeSlabOptimizer(method="gibbs")
    with pytest.raises(NotFittedError):
        optimizer.complexity  # noqa: B018
    assert optimizer.fit(x, x).complexity == 2


def test_pysindy_specific_bad_parameters(clean):
    t, x = clean
    for options in ({"noise_floor": [1.0, 1.0]}, {"method": "none"}, {"prior_inclusion": [0.1, 0.1]}):
        with pytest.raises(ValueError):
            ps.SINDy(SpikeSlabOptimizer(**options), ps.PolynomialLibrary(2)).fit(x, t)


def test_pysindy_custom_library():
    x = np.random.default_rng(0).standard_normal((100, 3))
    custom = ps.CustomLibrary(
        [lambda a: a, lambda a, b: a * b, lambda a: a**2],
        [lambda a: a, lambda a, b: f"{a} {b}", lambda a: f"{a}^2"],
    )
    check_is_fitted(ps.SINDy(SpikeSlabOptimizer(), custom).fit(x, t=1))


def test_pysindy_selection():
    rng = np.random.default_rng(1)
    x, wanted = rng.normal(size=(30, 8)), np.array([[1, 1, 1, 0, 0, 0, 0, 0]])
    y = x @ wanted.T
    found = SpikeSlabOptimizer().fit(x + rng.normal(size=x.shape, scale=1e-2), y).coef_
    np.testing.assert_allclose(found, wanted, atol=1e-2)
    np.testing.assert_array_equal(found == 0, wanted == 0)


def test_pysindy_pickle(clean):
    _, x = clean
    y = ps.PolynomialLibrary(degree=2).fit_transform(x)
    optimizer = SpikeSlabOptimizer().fit(y, x)
    again = pickle.loads(pickle.dumps(optimizer))  # noqa: S301
    np.testing.assert_array_equal(again.coef_, optimizer.coef_)
    assert (again.posteriors_[0].pip == optimizer.posteriors_[0].pip).all()


# around the model: search, copies, fields


def test_search_over_parameters_of_the_model(clean):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2))
    grid = {"optimizer__prior_inclusion": [0.05, 0.2], "feature_library__degree": [1, 2]}

    # without times, SINDy.score cannot be called by scikit-learn
    def score(fitted, samples):
        return fitted.score(samples, t=t[1] - t[0])

    search = GridSearchCV(model, grid, scoring=score, cv=TimeSeriesSplit(3)).fit(x, t=t)
    assert search.best_params_["feature_library__degree"] == 2
    assert search.best_score_ > 0.99
    assert terms(search.best_estimator_) == LORENZ


def test_a_fitted_model_is_pickled(clean):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2)).fit(x, t)
    again = pickle.loads(pickle.dumps(model))  # noqa: S301
    np.testing.assert_array_equal(again.predict(x[:5]), model.predict(x[:5]))


def test_of_equal_columns_the_first_counts():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2))
    D = np.column_stack([x[:, 0], -3.0 * x[:, 0], x[:, 1], x[:, 0]])
    found = SpikeSlabOptimizer().fit(D, 2.0 * x[:, 0])
    assert found.ind_.tolist() == [[True, False, False, False]]
    forced = SpikeSlabOptimizer(prior_inclusion=[0.1, 1.0, 0.1, 0.1]).fit(D, 2.0 * x[:, 0])
    assert forced.coef_[0] == pytest.approx([0.0, -2 / 3, 0.0, 0.0], rel=1e-3)


def test_an_input_that_never_changes(clean):
    t, x = clean
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(2)).fit(x, t, u=np.ones((len(x), 2)))
    assert terms(model) == LORENZ


def heat(noise):
    """u_t = 0.1 u_xx on 6.4 m, three waves that decay."""
    x, t = np.arange(64) * 0.1, np.linspace(0, 4, 81)
    k = 2 * np.pi / 6.4 * np.arange(1, 4)
    waves = np.array([1.0, 0.6, 0.4])[:, None, None] * np.sin(k[:, None, None] * x[:, None] + k[:, None, None] ** 2)
    u = (waves * np.exp(-0.1 * k[:, None, None] ** 2 * t)).sum(axis=0)
    return x, t, (u + noise * u.std() * np.random.default_rng(0).standard_normal(u.shape))[..., None]


def test_partial_differential_equation():
    x, t, u = heat(0.0)
    library = ps.PDELibrary(ps.PolynomialLibrary(2, include_bias=False), derivative_order=2, spatial_grid=x)
    rate = ps.FiniteDifference(axis=-2)._differentiate(u, t)
    floor = 0.01 * rate.std() * np.sqrt(rate.size / 10)
    model = ps.SINDy(SpikeSlabOptimizer(noise_floor=floor), library).fit(u, t=t)
    assert terms(model) == [{"x0_11"}]
    assert model.coefficients().max() == pytest.approx(0.1, rel=0.02)


def test_weak_form():
    x, t, u = heat(0.01)
    np.random.seed(0)  # noqa: NPY002  the subdomains are drawn from the global generator
    library = ps.WeakPDELibrary(
        ps.PolynomialLibrary(2, include_bias=False),
        derivative_order=2,
        spatiotemporal_grid=np.stack(np.meshgrid(x, t, indexing="ij"), axis=-1),
        K=200,
    )
    model = ps.SINDy(SpikeSlabOptimizer(), library).fit(u, t=t)
    assert terms(model) == [{"x0_11"}]
    assert model.coefficients().max() == pytest.approx(0.1, rel=0.05)


def test_bins_beyond_the_pass_band_are_no_evidence_of_little_noise():
    """12 s of predator and prey at 1 % noise: the kinematic smoother leaves nothing of noise in two thirds of the bins.

    Counted as whole rows they made five wrong terms certain.
    """
    from studies.pysindy_plugin import SYSTEMS, draw_motion

    t, x = draw_motion("lotka-volterra", 0.01, 10_002)
    model = ps.SINDy(SpikeSlabOptimizer(), ps.PolynomialLibrary(3), KinematicDerivative()).fit(x, t)
    assert terms(model) == list(SYSTEMS["lotka-volterra"].terms)
    assert model.optimizer.posteriors_[1].n < 40


# the derivative


def test_kinematic_derivative_smooths_and_differentiates():
    t = np.sort(np.random.default_rng(0).uniform(0, 10, 800))
    x = np.column_stack([np.sin(t), np.cos(2 * t)])
    noisy = x + 0.02 * np.random.default_rng(1).normal(size=x.shape)
    noisy[100, 0] = np.nan
    method = KinematicDerivative()
    rates = method(noisy, t)
    inner = slice(40, -40)
    assert np.std(rates[inner] - np.column_stack([np.cos(t), -2 * np.sin(2 * t)])[inner], axis=0).max() < 0.05
    assert np.std(method.smoothed_x_ - x, axis=0).max() < 0.01
    assert method.noise_sd_ == pytest.approx([0.02, 0.02], rel=0.2)


def test_kinematic_derivative_refuses_what_it_cannot_do():
    with pytest.raises(InputError, match="weak form"):
        KinematicDerivative()(np.zeros((3, 4, 2)), 0.1)
    with pytest.raises(InputError, match="coordinate 0 cannot be differentiated"):
        KinematicDerivative()(np.arange(3.0)[:, None], 0.1)
    with pytest.raises(InputError, match="noise_sd"):
        KinematicDerivative(noise_sd=-1.0)(np.ones((50, 1)), 0.1)


# libraries as dictionaries


def test_libraries_as_terms():
    assert terms_of(ps.PolynomialLibrary(2), ["x", "v"]) == ["x", "v", "x**2", "x*v", "v**2"]
    assert terms_of(ps.FourierLibrary(2), ["x"]) == ["sin(1*x)", "cos(1*x)", "sin(2*x)", "cos(2*x)"]
    custom = ps.CustomLibrary(
        [lambda a: np.tanh(a), lambda a, b: a * b], [lambda a: f"tanh({a})", lambda a, b: f"{a} {b}"]
    )
    assert terms_of(custom, ["x", "v"]) == ["tanh(x)", "tanh(v)", "x*v"]
    both = ps.PolynomialLibrary(1) + ps.FourierLibrary(1)
    assert terms_of(both, ["q"]) == ["q", "sin(1*q)", "cos(1*q)"]


def test_libraries_that_are_no_terms():
    nameless = ps.CustomLibrary([lambda a: np.tanh(a)])
    with pytest.raises(InputError, match="is no term"):
        terms_of(nameless, ["x"])
    wrong = ps.CustomLibrary([lambda a: np.tanh(a)], [lambda a: f"sin({a})"])
    with pytest.raises(InputError, match="does not have the values"):
        terms_of(wrong, ["x"])


def test_discover_takes_a_library():
    record = bq.simulate("duffing", n=1500, seed=1)
    roles = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
    found = bq.discover(record, **roles, dictionary=ps.PolynomialLibrary(3))
    assert found[0].included == ("x", "v", "u", "x**3")


def test_without_pysindy(monkeypatch):
    import sys

    import bayeq.adapters.pysindy as plug_in

    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[pysindy\]"):
        plug_in.SpikeSlabOptimizer  # noqa: B018
    with pytest.raises(AttributeError, match="nothing"):
        plug_in.nothing  # noqa: B018


# the page


def test_every_block_of_the_page_runs(capsys):
    page = (Path(__file__).parents[1] / "docs/pysindy.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == 4
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)  # noqa: S102  the page is ours
    said = capsys.readouterr().out
    assert said.count("(x0)' = -") == 2
    assert terms(names["model"]) == LORENZ
    assert terms(names["field"]) == [{"x0_11"}]


# ---- what is odd, and said


def test_a_coordinate_that_does_not_change():
    t = np.arange(400) / 50
    smoother = KinematicDerivative()
    rates = smoother(np.column_stack([np.sin(t), np.full(400, 3.0)]), t)
    assert np.abs(rates[10:-10, 0] - np.cos(t)[10:-10]).max() < 0.01
    assert (rates[:, 1] == 0.0).all()
    assert (smoother.smoothed_x_[:, 1] == 3.0).all()
    assert smoother.noise_sd_[1] == 0.0


def test_missing_samples_are_filled_in():
    t = np.arange(400) / 50
    x = np.column_stack([np.sin(t), np.cos(t)])
    x[100:103] = np.nan
    smoother = KinematicDerivative()
    rates = smoother(x, t)
    model = ps.SINDy(SpikeSlabOptimizer()).fit(smoother.smoothed_x_, t, x_dot=rates)
    assert terms(model) == [{"x1"}, {"x0"}]


def test_an_equation_without_terms_is_warned_of():
    rng = np.random.default_rng(0)
    D, noise = rng.normal(size=(200, 3)), rng.normal(size=200)
    with pytest.warns(DataWarning, match="no term is included in the equation of target 1, counted from 0"):
        SpikeSlabOptimizer().fit(D, np.column_stack([D[:, 0], noise]))


def test_a_feature_is_named_by_its_channels():
    library = ps.CustomLibrary([lambda x: np.sqrt(x)])
    with pytest.raises(InputError, match=r"feature 'f0\(pos\)'.*expression 'f0\(pos\)'"):
        terms_of(library, ["pos"])
