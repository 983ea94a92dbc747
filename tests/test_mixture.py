"""Intervals over models: quantiles of the mixture, and which interval is printed."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.intervals import unlike
from bayeq.equation.text import MARK, OVER_MODELS
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.slab import exact_posterior
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Mixture, ModelAverage
from bayeq.inference.prior import Prior
from bayeq.regression.fit import mixture_of
from tests import reference

pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")

RIVALS = {"chains": ["x:dx"], "inputs": ["r", "z"], "dictionary": ["x", "r", "z"], "smooth": "none", "holdout": 0.0}


def rivals(seed, n=100):
    """dx = x + 2 z + noise, and r nearly a copy of x: with r in place of x the coefficient of z is 2 - 0.4."""
    x, z, apart, noise = np.random.default_rng(seed).normal(size=(4, n))
    return bq.Record.from_arrays(x=x, r=x + 0.4 * z + 0.1 * apart, z=z, dx=x + 2.0 * z + noise)


@pytest.fixture(scope="module")
def doubtful():
    return bq.discover(rivals(0), **RIVALS)


# Quantiles ------------------------------------------------------------------------------------------------------------


@settings(deadline=None)  # the first call compiles
@example(pip=2.2e-309, parts=[(1.0, 0.0, 1.0)])  # the quotient overflows
@given(
    pip=st.floats(0.0, 1.0),
    parts=st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(-3, 3), st.floats(0.01, 2.0)), min_size=1, max_size=6),
)
def test_intervals_are_those_of_the_distribution_function(pip, parts):
    weight, mean, sd = np.array(parts).T
    weight = weight / weight.sum()
    mixture = Mixture(weight[None], mean[None], sd[None], np.array([pip]))
    if pip > 0.0:
        for bound, probability in zip(mixture.given_in()[0], (0.025, 0.975), strict=True):
            assert weight @ stats.norm.cdf(bound, mean, sd) == pytest.approx(probability, abs=1e-9)
    low, high = mixture.overall()[0]
    for bound, probability in ((low, 0.025), (high, 0.975)):
        below = pip * (weight @ stats.norm.cdf(bound, mean, sd))
        # a quantile is where the distribution function passes the probability, or jumps over it
        least, most = below + (1.0 - pip) * (bound > 0.0), below + (1.0 - pip) * (bound >= 0.0)
        assert least - 1e-9 <= probability <= most + 1e-9


def test_one_model_has_the_interval_of_a_normal_distribution_and_a_point_is_its_own():
    mixture = Mixture(
        np.ones((3, 1)), np.array([[2.0], [7.0], [1.0]]), np.array([[0.5], [0.0], [1.0]]), np.array([1, 1, 0.0])
    )
    expected = np.array([stats.norm.interval(0.95, 2.0, 0.5), (7.0, 7.0), (0.0, 0.0)])
    np.testing.assert_allclose(mixture.given_in(), expected, rtol=1e-12)
    np.testing.assert_allclose(mixture.overall(), expected, rtol=1e-12)


@pytest.mark.parametrize("seed", [5, 14, 15])  # of problems with terms in doubt
def test_intervals_agree_with_draws_from_the_mixture(seed):
    D, y, _ = reference.random_problem(np.random.default_rng(seed), n=60, P=6, noise=2.0)
    gram = Gram.from_data(D, y)
    problem, fit = Problem.of(gram, Prior()), spike_slab_bma(gram)
    models = fit.average.models
    found = [exact_posterior(problem, model) for model in models]
    mean, sd = np.array([coef for coef, _ in found]).T, np.zeros(models.T.shape)
    for k, (_, covariance) in enumerate(found):
        sd[models[k], k] = np.sqrt(np.diagonal(covariance))
    weight = models.T * fit.average.probability
    mixture = Mixture(weight / weight.sum(axis=1, keepdims=True), mean, sd, fit.pip)
    # sigma^2 is drawn too: Student t of 60 degrees of freedom, whose tails of 2.5 % have 2.6 % here
    theta, _, _ = sample_average(problem, fit.average, 200_000, np.random.default_rng(0))
    undecided = (fit.pip > 0.1) & (fit.pip < 0.9)
    assert undecided.any()
    for j in range(6):
        low, high = mixture.overall()[j]
        assert np.mean(theta[:, j] < low) == pytest.approx(0.025, abs=2e-3) if low else np.mean(theta[:, j] < 0) < 0.027
        assert (
            np.mean(theta[:, j] > high) == pytest.approx(0.025, abs=2e-3) if high else np.mean(theta[:, j] > 0) < 0.027
        )
        inside = theta[theta[:, j] != 0.0, j]
        low, high = mixture.given_in()[j]
        within = 4.0 * np.sqrt(0.025 / len(inside)) + 2e-3
        assert np.mean(inside < low) == pytest.approx(0.025, abs=within)
        assert np.mean(inside > high) == pytest.approx(0.025, abs=within)


# Which interval is printed --------------------------------------------------------------------------------------------


def test_printed_intervals_cover_where_models_are_in_doubt_and_the_conditional_do_not():
    covered, width = [], []
    for seed in range(120):
        equation = bq.discover(rivals(seed), **RIVALS)[0]
        conditional, printed = equation.shown_ci95[2], equation.printed_ci95[2]
        width.append([np.ptp(conditional), np.ptp(printed)])
        covered.append([low < 2.0 < high for low, high in (conditional, printed)])
    given, over = np.mean(covered, axis=0)
    assert 0.90 <= over <= 0.98
    assert given < 0.75
    assert np.mean(width, axis=0) @ (-1.5, 1.0) > 0.0


def test_where_one_model_holds_the_mass_intervals_are_the_conditional_ones():
    x, z, noise = np.random.default_rng(0).normal(size=(3, 2000))
    record = bq.Record.from_arrays(x=x, z=z, dx=x + 2.0 * z + 0.1 * noise)
    equation = bq.discover(record, chains=["x:dx"], inputs=["z"], dictionary=["x", "z", "x**3"], smooth="none")[0]
    assert equation.included == ("x", "z")
    assert equation.fit.posterior.average.probability[0] > 0.98
    np.testing.assert_array_equal(equation.printed_ci95, equation.ci95)
    assert not equation.printed_over_models.any()
    np.testing.assert_allclose(equation.averaged_ci95[:2], equation.ci95[:2], atol=0.02 * np.ptp(equation.ci95[0]))
    np.testing.assert_array_equal(equation.averaged_ci95[2], [0.0, 0.0])


@pytest.mark.parametrize("smooth", ["none", "auto"])
def test_intervals_over_models_are_those_of_the_answer_where_models_are_certain(smooth):
    record = bq.simulate("linear", n=1000, seed=2, noise={"x": 0.1, "v": 0.1, "a": 0.02})
    options = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": smooth}
    equation = bq.discover(record, dictionary="x, v, x**3, u", **options)[0]
    assert equation.shown == ("x", "v", "u")
    kept, sd = equation.shown_posterior.support, equation.shown_posterior.sd
    found, expected = equation.over_models.given_in[kept], equation.shown_ci95[kept]
    assert (np.abs(found - expected) < 0.3 * sd[kept][:, None]).all()
    assert not equation.printed_over_models.any()
    if equation.shown_posterior.constant.left_out is None:
        within = 0.3 * equation.shown_posterior.intercept_sd
        np.testing.assert_allclose(equation.over_models.intercept, equation.intercept_ci95, atol=within)
    assert equation.printed_intercept_ci95 == equation.intercept_ci95


def test_the_intercept_knows_the_doubt_too():
    # with r = x + 0.5 + noise in place of x the intercept is 1 - 0.5
    options = {"chains": ["x:dx"], "inputs": ["r"], "dictionary": ["x", "r"], "smooth": "none", "holdout": 0.0}
    covered = []
    for seed in range(100):
        x, apart, noise = np.random.default_rng(seed).normal(size=(3, 100))
        record = bq.Record.from_arrays(x=x, r=x + 0.5 + 0.1 * apart, dx=1.0 + x + noise)
        equation = bq.discover(record, **options)[0]
        covered.append([low < 1.0 < high for low, high in (equation.intercept_ci95, equation.printed_intercept_ci95)])
    given, over = np.mean(covered, axis=0)
    assert 0.90 <= over <= 0.99
    assert given < 0.75


def test_without_models_or_draws_the_moments_make_a_normal_distribution(doubtful):
    fit, reported = doubtful[0].fit, doubtful[0].posterior
    mixture = mixture_of(replace(fit, posterior=replace(fit.posterior, average=None)), reported)
    inside = reported.averaged.coef / reported.pip
    np.testing.assert_allclose(mixture.given_in()[:3].mean(axis=1), inside, rtol=1e-6)
    square = reported.pip * (mixture.mean[:3, 0] ** 2 + mixture.sd[:3, 0] ** 2)
    np.testing.assert_allclose(np.sqrt(square - reported.averaged.coef**2), reported.averaged.sd, rtol=1e-6)


def test_refined_coefficients_have_intervals_of_their_own(tmp_path):
    record = bq.simulate("duffing", n=600, seed=1, noise={"x": 0.02, "v": 0.02, "a": 0.02})
    options = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "smooth": "none"}
    refined = bq.discover(record, dictionary="x, v, x**3, x**5, u", **options).refine(record)
    assert refined.refined is not None
    np.testing.assert_array_equal(refined[0].printed_ci95, refined[0].shown_ci95)
    assert refined[0].printed_intercept_ci95 == refined[0].intercept_ci95
    refined.save(tmp_path / "eq.json")
    assert str(bq.load(tmp_path / "eq.json")) == str(refined)


def test_a_fifth_of_the_width_makes_another_interval():
    width_ten = np.array([[0.0, 10.0]] * 4)
    other = np.array([[0.0, 11.9], [0.0, 12.1], [-2.1, 7.9], [-1.1, 11.1]])
    np.testing.assert_array_equal(unlike(other, width_ten), [False, True, True, True])


def test_averaged_intervals_hold_zero_where_the_term_may_be_out(doubtful):
    equation = doubtful[0]
    p, averaged = equation.posterior, equation.averaged_ci95
    undecided = (p.pip > 0.05) & (p.pip < 0.95)
    assert undecided.any()
    assert ((averaged[undecided, 0] <= 0.0) & (averaged[undecided, 1] >= 0.0)).all()
    spread = 3.0 * p.averaged.sd
    assert (np.abs(averaged - p.averaged.coef[:, None]).max(axis=1) <= spread + 1e-12).all()


def test_draws_of_a_sampler_give_the_same_intervals(doubtful):
    sampled = bq.discover(rivals(0), method="gibbs", **RIVALS)[0]
    listed = doubtful[0]
    within = 0.05 * np.ptp(listed.printed_ci95[2])
    np.testing.assert_allclose(sampled.averaged_ci95[2], listed.averaged_ci95[2], atol=within)
    np.testing.assert_allclose(sampled.printed_ci95[2], listed.printed_ci95[2], atol=within)


def test_methods_without_models_print_the_conditional():
    for method in ("vb", "stlsq"):
        equation = bq.discover(rivals(0), method=method, **RIVALS)[0]
        assert equation.averaged_ci95 is None
        np.testing.assert_array_equal(equation.printed_ci95, equation.shown_ci95)
        assert equation.table()[["averaged_ci_low", "averaged_ci_high"]].isna().all(axis=None)


def test_terms_left_out_for_simplicity_are_in_no_model_of_the_interval():
    x, z, noise = np.random.default_rng(1).normal(size=(3, 400))
    z = z + x
    record = bq.Record.from_arrays(x=x, z=z, dx=x + z + 0.5 * noise)
    options = {"chains": ["x:dx"], "inputs": ["z"], "dictionary": ["x", "z", "x**3"], "smooth": "none"}
    equation = bq.discover(record, max_terms=1, **options)[0]
    assert (equation.included, equation.shown) == (("x", "z"), ("z",))
    # with x the coefficient of z is 1; without, 1.5
    assert 1.3 < equation.shown_coef["z"] < 1.7
    np.testing.assert_array_equal(equation.printed_ci95[1], equation.shown_ci95[1])
    assert equation.averaged_ci95[1, 0] < 1.0 < equation.averaged_ci95[1, 1] < 1.3


def test_equalities_and_signs_keep_their_meaning():
    tied = bq.discover(rivals(0), constraints=["r == 0.5*x"], **RIVALS)[0]
    np.testing.assert_allclose(tied.averaged_ci95[1], 0.5 * tied.averaged_ci95[0], rtol=1e-9)
    fixed = bq.discover(rivals(0), constraints=["x == 1"], **RIVALS)[0]
    np.testing.assert_array_equal(fixed.averaged_ci95[0], [1.0, 1.0])
    positive = bq.discover(rivals(0), constraints=["r >= 0"], **RIVALS)[0]
    assert positive.averaged_ci95.shape == (3, 2)
    assert np.isfinite(positive.averaged_ci95).all()


# Text, files, command -------------------------------------------------------------------------------------------------


def interval_of(text, term):
    (line,) = (line for line in text.splitlines() if line.startswith(f"| {term} "))
    return line.split("|")[4].strip()


def test_loaded_equations_keep_them(doubtful, tmp_path):
    doubtful.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert str(again) == str(doubtful)
    assert again.to_dict() == doubtful.to_dict()
    np.testing.assert_array_equal(again[0].averaged_ci95, doubtful[0].averaged_ci95)
    np.testing.assert_array_equal(again[0].printed_over_models, doubtful[0].printed_over_models)
    content = json.loads((tmp_path / "eq.json").read_text())
    for term in content["equations"][0]["terms"]:
        del term["printed_ci95"], term["printed_over_models"]
    del content["equations"][0]["intercept_printed_ci95"]
    (tmp_path / "earlier.json").write_text(json.dumps(content))
    earlier = bq.load(tmp_path / "earlier.json")[0]
    np.testing.assert_array_equal(earlier.printed_ci95, earlier.shown_ci95)


def test_the_command_prints_either(doubtful, tmp_path, capsys):
    bq.write(rivals(0), tmp_path / "run.csv")
    command = ["discover", str(tmp_path / "run.csv"), "--chain", "x:dx", "--input", "r", "--input", "z"]
    command += ["--dictionary", "x, r, z", "--smooth", "none", "--holdout", "0", "--fs", "1"]
    assert main([*command, "--verbose"]) == 0
    over = capsys.readouterr().out
    assert interval_of(over, "z").endswith(f" {MARK}")
    assert over.count(f"{MARK} {OVER_MODELS}") == 1
    assert main([*command, "--conditional"]) == 0
    given = capsys.readouterr().out
    assert MARK + " " + OVER_MODELS not in given
    low, high = map(float, interval_of(given, "z").split(" .. "))
    widest = [float(bound) for bound in interval_of(over, "z").removesuffix(MARK).split(" .. ")]
    assert widest[1] - widest[0] > 1.2 * (high - low)
    assert main([*command, "--json"]) == 0
    term = json.loads(capsys.readouterr().out)["equations"][0]["terms"][2]
    assert term["printed_over_models"]
    np.testing.assert_allclose(term["shown_ci95"], [low, high], rtol=1e-2)
    np.testing.assert_allclose(term["printed_ci95"], widest, rtol=1e-2)
    assert term["averaged_ci95"] != term["averaged_coef"]


def test_odds_are_those_of_the_listed_models_and_bounded_by_the_mass_left_out():
    models = np.array([[1, 0, 0], [1, 1, 0]], dtype=bool)
    average = ModelAverage(models, np.array([0.8, 0.2]), 0.004, np.arange(2), np.eye(2))
    others = {np.array(m, dtype=bool).tobytes(): 3.0 for m in ([1, 1, 0], [0, 0, 1])}
    assert average.log_odds(models[0], others) == pytest.approx([np.log(0.25), np.log(0.004 / 0.8)])
    # of a model that is not listed itself nothing is known but what is given
    assert average.log_odds(np.array([0, 1, 1], dtype=bool), others) == [3.0, 3.0]
    # models with nothing left out: the others are as improbable as was said
    assert replace(average, left_out=0.0).log_odds(models[0], others) == pytest.approx([np.log(0.25), 3.0])
