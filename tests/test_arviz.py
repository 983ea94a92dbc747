from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import NotFittedError

import bayeq as bq
from bayeq import SpikeSlabBMA, SpikeSlabGibbs
from bayeq.adapters.arviz import convergence, to_arviz
from bayeq.errors import InputError, MissingExtraError
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram
from tests import reference


def posterior(**options):
    D, y, _ = reference.random_problem(np.random.default_rng(1), n=200, P=5, rho=0.5, noise=0.5)
    return spike_slab_gibbs(Gram.from_data(D, y, list("abcde")), samples=1200, burn_in=200, **options)


def test_rank_rhat_and_effective_sample_sizes():
    pytest.importorskip("arviz")
    fit = posterior()
    table = convergence(fit)
    assert list(table.index) == [*"abcde", "noise_variance"]
    assert table.loc["noise_variance", "rhat"] < 1.02
    # sigma^2 is drawn afresh from its collapsed conditional: nearly independent, 4000 draws
    assert 2500 < table.loc["noise_variance", "ess_bulk"] < 6000
    assert (table.multivariate_rhat == fit.details.rhat).all()
    varying = fit.draws.theta.std(axis=(0, 1)) > 0
    assert table.rhat[:-1].notna().to_numpy().tolist() == varying.tolist()


def test_without_draws_or_without_arviz(monkeypatch):
    with pytest.raises(InputError, match="keep_draws"):
        convergence(posterior(keep_draws=False))
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[arviz\]"):
        convergence(posterior())


def test_the_engine_does_not_import_arviz():
    import subprocess

    code = "import bayeq.inference.gibbs, sys; assert 'arviz' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


# ---- to_arviz

DRAWS = 4000


def problem(n=120):
    """Two columns that stand in for each other, so that models are averaged in earnest."""
    rng = np.random.default_rng(3)
    D = rng.normal(size=(n, 4)) * [1.0, 1.0, 1.0, 1e3]
    D[:, 1] = D[:, 0] + 0.3 * rng.normal(size=n)
    return D, 4.0 + D[:, 0] + 2e-3 * D[:, 3] + rng.normal(size=n)


def gibbs():
    return SpikeSlabGibbs(samples=DRAWS // 4 + 100, burn_in=100)


def handed_over(estimator, *args, **options):
    if isinstance(estimator, SpikeSlabBMA):
        options.setdefault("draws", DRAWS)
    return estimator.to_arviz(*args, **options)


each = pytest.mark.parametrize("estimator", [gibbs(), SpikeSlabBMA()], ids=lambda e: type(e).__name__)


@each
def test_groups_dimensions_and_names(estimator):
    pytest.importorskip("arviz")
    D, y = problem()
    frame = pd.DataFrame(D, columns=["x", "v", "x*v", "u"])
    data = handed_over(estimator.fit(frame, y), frame[:7], y[:7])
    chains = 4 if isinstance(estimator, SpikeSlabGibbs) else 1
    posterior = data["posterior"]
    assert set(posterior.data_vars) == {"coef", "inclusion", "intercept", "noise_variance"}
    assert posterior["coef"].dims == posterior["inclusion"].dims == ("chain", "draw", "term")
    assert posterior["intercept"].dims == posterior["noise_variance"].dims == ("chain", "draw")
    assert dict(posterior.sizes) == {"chain": chains, "draw": DRAWS // chains, "term": 4}
    assert posterior["term"].values.tolist() == list(frame.columns)
    np.testing.assert_array_equal(posterior["inclusion"] == 1, posterior["coef"] != 0)
    assert data["posterior_predictive"]["y"].dims == ("chain", "draw", "row")
    assert data["posterior_predictive"].sizes["row"] == 7
    np.testing.assert_array_equal(data["observed_data"]["y"], y[:7])
    # and nothing that was not asked for
    assert sorted(handed_over(estimator)) == ["posterior", "sample_stats"]


@each
def test_the_draws_are_the_posterior(estimator):
    arviz = pytest.importorskip("arviz")
    D, y = problem()
    fit = estimator.fit(D, y)
    data = handed_over(fit)
    posterior = data["posterior"]
    samples = ("chain", "draw")
    # five Monte Carlo standard errors, by the effective sample size where draws are correlated
    size = float(arviz.ess(data, var_names="coef")["coef"].min())
    assert size > 400
    error = 5 * fit.averaged_sd_ / np.sqrt(size)
    assert np.all(np.abs(posterior["coef"].mean(samples) - fit.averaged_coef_) < error)
    # a term that is hardly ever in has too few draws for a standard deviation
    often = fit.pip_ > 0.1
    assert 2 <= often.sum() < 4
    assert np.all((np.abs(posterior["coef"].std(samples) - fit.averaged_sd_) < error)[often])
    assert np.all(np.abs(posterior["inclusion"].mean(samples) - fit.pip_) < 5 * 0.5 / np.sqrt(size))
    assert float(posterior["noise_variance"].mean()) == pytest.approx(fit.noise_variance_, rel=0.02)
    # b0 given theta is mean(y) - mean(D) theta, give or take sigma/sqrt(n)
    rest = posterior["intercept"].values - (y.mean() - posterior["coef"].values @ D.mean(axis=0))
    assert abs(rest.mean()) < 5 * rest.std() / np.sqrt(rest.size)
    assert rest.std() == pytest.approx(np.sqrt(fit.noise_variance_ / len(y)), rel=0.05)
    with np.errstate(invalid="ignore"):
        table = arviz.summary(data, round_to="none")
    assert list(table.index) == [
        *(f"coef[x{j}]" for j in range(4)),
        *(f"inclusion[x{j}]" for j in range(4)),
        "intercept",
        "noise_variance",
    ]
    np.testing.assert_allclose(table["mean"][:4], posterior["coef"].mean(samples), rtol=1e-9)


@each
def test_predictions_have_the_predictive_mean_and_spread(estimator):
    pytest.importorskip("arviz")
    D, y = problem()
    # both terms that matter are certain, the others out: the average over models is the one model of `predict`
    fit = estimator.fit(D[:, [0, 3]], y)
    assert fit.pip_.min() > 0.99
    mean, sd = fit.predict(D[:5, [0, 3]], return_std=True)
    drawn = handed_over(fit, D[:5, [0, 3]])["posterior_predictive"]["y"]
    assert np.all(np.abs(drawn.mean(("chain", "draw")) - mean) < 5 * sd / np.sqrt(DRAWS))
    # the standard error of a standard deviation of DRAWS Gaussian numbers is sd/sqrt(2 DRAWS)
    assert np.all(np.abs(drawn.std(("chain", "draw")) - sd) < 5 * sd / np.sqrt(2 * DRAWS))


@each
def test_the_file_is_read_back(estimator, tmp_path):
    arviz = pytest.importorskip("arviz")
    for package in ("h5netcdf", "h5py"):
        pytest.importorskip(package, reason="ArviZ writes netCDF with both: pip install h5netcdf h5py")
    D, y = problem()
    frame = pd.DataFrame(D, columns=["x", "v", "x*v", "u"])
    data = handed_over(estimator.fit(frame, y), frame[:3], y[:3])
    data.to_netcdf(tmp_path / "draws.nc")
    again = arviz.from_netcdf(tmp_path / "draws.nc")
    assert sorted(again) == sorted(data)
    for group in data:
        assert set(again[group].data_vars) == set(data[group].data_vars)
        for name, values in data[group].data_vars.items():
            np.testing.assert_array_equal(again[group][name], values)
    assert again["posterior"]["term"].values.tolist() == list(frame.columns)


def test_statistics_of_the_draws():
    pytest.importorskip("arviz")
    D, y = problem()
    chains = gibbs().fit(D, y)
    np.testing.assert_array_equal(chains.to_arviz()["sample_stats"]["lp"], chains.draws_.log_posterior)
    np.testing.assert_array_equal(chains.to_arviz()["posterior"]["coef"], chains.draws_.theta)
    fit = SpikeSlabBMA().fit(D, y)
    data = fit.to_arviz(draws=300)
    model = data["sample_stats"]["model"].values[0]
    assert len(set(model)) > 1
    np.testing.assert_array_equal(data["posterior"]["inclusion"][0] == 1, fit.average_.models[model])
    np.testing.assert_array_equal(data["sample_stats"]["lp"][0], np.log(fit.average_.probability[model]))
    np.testing.assert_array_equal(data["posterior"]["coef"][0], fit.sample(300)[0])


@each
def test_same_seed_same_draws(estimator):
    pytest.importorskip("arviz")
    D, y = problem()
    fit = estimator.fit(D, y)
    one, same, other = (handed_over(fit, D[:3], random_state=seed) for seed in (1, 1, 2))
    for group, name in (("posterior", "coef"), ("posterior", "intercept"), ("posterior_predictive", "y")):
        np.testing.assert_array_equal(one[group][name], same[group][name])
    assert not np.any(one["posterior"]["intercept"].values == other["posterior"]["intercept"].values)


@each
def test_one_of_several_targets(estimator):
    pytest.importorskip("arviz")
    D, y = problem()
    Y = np.column_stack([-y, y])
    alone = handed_over(estimator.fit(D, y), D[:3], y[:3])
    fit = estimator.fit(D, Y)
    second = handed_over(fit, D[:3], Y[:3, 1], target=1)
    np.testing.assert_allclose(second["posterior"]["coef"], alone["posterior"]["coef"], rtol=1e-9)
    np.testing.assert_allclose(second["posterior_predictive"]["y"], alone["posterior_predictive"]["y"], rtol=1e-9)
    with pytest.raises(InputError, match="2 targets: say which, target=0 to 1"):
        fit.to_arviz()
    with pytest.raises(InputError, match="no target 2"):
        fit.to_arviz(target=2)
    with pytest.raises(InputError, match="y must be one target"):
        fit.to_arviz(D, Y, target=0)


@each
def test_rows_that_do_not_fit(estimator):
    D, y = problem()
    with pytest.raises(NotFittedError):
        type(estimator)().to_arviz()
    fit = estimator.fit(D, y)
    with pytest.raises(ValueError, match="features"):
        fit.to_arviz(D[:, :3])
    with pytest.raises(InputError, match="as many rows, got 5 and 6"):
        fit.to_arviz(D[:5], y[:6])
    with pytest.raises(InputError, match=r"D must have shape \(n, 4\)"):
        to_arviz(gibbs().fit(D, y).posterior_, D=D[:, :3], rng=np.random.default_rng())
    with pytest.raises(InputError, match="keep_draws"):
        to_arviz(SpikeSlabBMA().fit(D, y).posterior_, rng=np.random.default_rng())


@each
def test_handing_over_needs_arviz(estimator, monkeypatch):
    fit = estimator.fit(*problem())
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[arviz\]"):
        fit.to_arviz()


def test_from_one_point_nought_on_the_groups_are_one_argument(monkeypatch):
    D, y = problem()
    fit = gibbs().fit(D, y)
    calls = []

    def from_dict(data, *, coords, dims):
        calls.append((data, coords, dims))
        return "tree"

    monkeypatch.setitem(sys.modules, "arviz", types.SimpleNamespace(__version__="1.2.0", from_dict=from_dict))
    assert fit.to_arviz(D[:2], y[:2]) == "tree"
    ((groups, coords, dims),) = calls
    assert list(groups) == ["posterior", "sample_stats", "posterior_predictive", "observed_data"]
    assert groups["posterior"]["coef"].shape == (4, DRAWS // 4, 4)
    assert coords == {"term": ["x0", "x1", "x2", "x3"]}
    assert dims["coef"] == ["term"]


# ---- the page


def test_the_block_of_the_page_runs(capsys):
    arviz = pytest.importorskip("arviz")
    page = (Path(__file__).parents[1] / "docs/arviz.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, object] = {}
    # R-hat of a term that never varies is 0/0 to ArviZ
    with np.errstate(invalid="ignore"):
        exec(block, names)  # noqa: S102  the page is ours
    said = capsys.readouterr().out
    assert "coef[x0]" in said
    assert "multivariate_rhat" in said
    # what the page says of the groups
    assert set(names["data"]) == {"posterior", "sample_stats", "posterior_predictive", "observed_data"}
    kind = "InferenceData" if arviz.__version__.startswith("0.") else "DataTree"
    assert type(names["data"]).__name__ == kind


# ---- of the answer


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize("smooth", ["none", "auto"])
def test_draws_of_an_equation(smooth):
    pytest.importorskip("arviz")
    record = bq.simulate("duffing", n=600, seed=1)
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u, v*abs(v)", smooth=smooth)
    data = eq.to_arviz(draws=4000, seed=1)
    coef, inside = data["posterior"]["coef"].values[0], data["posterior"]["inclusion"].values[0] == 1
    assert not coef[~inside].any()
    np.testing.assert_allclose(inside.mean(axis=0), eq[0].posterior.pip, atol=0.03)
    found = eq[0].posterior
    chosen = (inside == found.support).all(axis=1)
    np.testing.assert_array_less(np.abs(coef[chosen].mean(axis=0) - found.coef), 0.1 * found.sd + 1e-300)
    np.testing.assert_allclose(coef[chosen].std(axis=0), found.sd, rtol=0.1)
    model = eq[0].included_model
    drawn = data["posterior"]["intercept"].values[0][chosen]
    np.testing.assert_allclose((drawn.mean(), drawn.std()), (model.intercept, model.intercept_sd), rtol=0.1, atol=0.01)
    same = eq.to_arviz("a", draws=4000, seed=1)
    np.testing.assert_array_equal(same["posterior"]["coef"].values[0], coef)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_draws_that_cannot_be(tmp_path):
    record = bq.simulate("duffing", n=300, seed=1)
    eq = bq.discover(record, chains=["x", "v"], inputs=["u"], dictionary="x, v, u", smooth="none")
    with pytest.raises(InputError, match=r"say which by target= \(dx, dv\)"):
        eq.to_arviz()
    with pytest.raises(InputError, match="no equation named 'a'"):
        eq.to_arviz("a")
    with pytest.raises(InputError, match="draws must be at least 1"):
        eq.to_arviz("dx", draws=0)
    eq.save(tmp_path / "eq.json")
    with pytest.raises(InputError, match="a file of equations does not hold"):
        bq.load(tmp_path / "eq.json").to_arviz("dx")
