"""Output error with constraints: equations hold exactly, signs are kept, and what is known makes intervals shorter."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.stats import truncnorm

import bayeq as bq
from bayeq.cli.app import main
from bayeq.equation.refine.output_error import Known, _bounded
from bayeq.errors import BayeqWarning, DataWarning, FileFormatError, InputError
from bayeq.inference.prior import Prior, half_lines
from bayeq.inference.signs import truncated
from bayeq.regression.constraints import parse_constraints
from tests.draws import draws
from tests.simulated import coarse

NOISE = {"x": 0.05, "v": 0.05, "a": 0.05}
TRUTH = {"x": -1000.0, "v": -2.0, "x**3": -1e5, "u": 1.0}
TERMS = list(TRUTH)


def found(record, *constraints, **options):
    options = {"chains": ["x:v:a"], "inputs": ["u"], "dictionary": TERMS, "smooth": "none", **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        return bq.discover(record, constraints=constraints, **options)


@pytest.fixture(scope="module")
def record():
    return coarse("duffing", 600, 8, NOISE)


@pytest.fixture(scope="module")
def free(record):
    return found(record).refine(record)


def undamped(c, seed=1, n=400, fs=20.0):
    """Free motion x'' = -4 x - c v with 2 % noise."""
    rng, t = np.random.default_rng(seed), np.arange(n) / fs
    w, decay = np.sqrt(4.0 - 0.25 * c**2), np.exp(-0.5 * c * t)
    x, v = decay * np.cos(w * t), decay * (-w * np.sin(w * t) - 0.5 * c * np.cos(w * t))
    channels = {"x": x, "v": v, "a": -4.0 * x - c * v}
    noisy = {name: values + 0.02 * values.std() * rng.normal(size=n) for name, values in channels.items()}
    return bq.Record.from_arrays(noisy, time=t)


def signed(record, *constraints):
    forced = Prior(prior_inclusion=1.0)
    return found(record, *constraints, inputs=[], dictionary=["x", "v"], tolerance=0, prior=forced)


# --- equations -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("texts", "left"),
    [
        (["u == 1"], lambda c: c["u"] - 1.0),
        pytest.param(["x**3 == 100*x"], lambda c: c["x**3"] / 100.0 / c["x"] - 1.0, marks=pytest.mark.slow),
        pytest.param(["x == 500*v"], lambda c: c["x"] / 500.0 / c["v"] - 1.0, marks=pytest.mark.slow),
        (["a: x + 500*v == -2000*u"], lambda c: (c["x"] + 500.0 * c["v"]) / 2000.0 / c["u"] + 1.0),
        (["v + 2 == 0", "u == 1"], lambda c: abs(c["v"] + 2.0) + abs(c["u"] - 1.0)),
    ],
)
def test_equations_hold_to_rounding_and_shorten_intervals(texts, left, record, free):
    before = found(record, *texts)
    after = before.refine(record)
    assert after.refined is not None
    assert abs(left(after[0].coef)) < 1e-12
    sd, wider = (dict(zip(TERMS, one[0].shown_posterior.sd, strict=True)) for one in (after, free))
    for name, value in TRUTH.items():
        # right constraints: as near to the truth, of which the runs are surer
        assert abs(after[0].coef[name] - value) < 4.0 * wider[name]
        assert sd[name] <= 1.01 * wider[name]
    assert min(sd[name] / wider[name] for name in TERMS) < 0.95
    # what follows from others moves with them in runs of drawn coefficients too
    draws = after.dynamics().draw(50, np.random.default_rng(0))[:, 1:]
    worst = max(abs(left(dict(zip(TERMS, theta, strict=True)))) for theta in draws)
    assert worst < 1e-6


def test_a_wrong_equation_is_not_kept_for_good(record):
    eq = found(record, "u == 0.8")
    with pytest.warns(BayeqWarning, match="correlated in time|not refined"):
        eq.refine(record)


def test_the_intercept_is_free_beside_constraints():
    record = coarse("duffing", 500, 8, NOISE)
    record = record.with_channels({"u": record["u"] - 20.0})
    after = found(record, "u == 1").refine(record)
    p = after[0].shown_posterior
    assert p.intercept == pytest.approx(20.0, abs=4 * p.intercept_sd)
    assert after[0].coef["u"] == 1.0
    # the covariance that runs are drawn with is that of the fit
    whole = after.dynamics().covariance
    assert whole[0, 0] == pytest.approx(p.intercept_sd**2)
    assert np.all(whole[-1] == 0.0)
    assert np.abs(whole[0, 1:4]).min() > 0.0


def test_equations_of_a_system_may_share_constraints_or_have_their_own():
    record = bq.simulate("lorenz", n=1500, fs=100.0, seed=2, noise=0.01)
    known = ["dx: y == -x", "dz: x*y == 1"]
    eq = found(
        record, *known, chains=["x", "y", "z"], inputs=[], dictionary=["x", "y", "z", "x*z", "x*y"], smooth="auto"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        after = eq.refine(record)
    assert after.refined is not None
    assert after["dx"].coef["y"] == -after["dx"].coef["x"]
    assert after["dz"].coef["x*y"] == 1.0
    assert after["dx"].coef["y"] == pytest.approx(10.0, rel=0.05)


def test_terms_must_go_with_the_constraints(record):
    eq = found(record, "u == 1")
    p = eq[0].posterior
    support = p.support & (np.array(TERMS) != "u")
    short = replace(p, support=support, coef=np.where(support, p.coef, 0.0), covariance=p.covariance[:3, :3])
    with pytest.raises(InputError, match="a: the terms shown do not keep to the constraints"):
        replace(eq, equations=(eq[0].with_posterior(short),)).refine(record)


def test_nothing_left_to_refine(record):
    fixed = ["x == -1000", "v == -2", "x**3 == -100000"]
    eq = found(record, *fixed, prior=Prior(prior_inclusion=[1.0, 1.0, 1.0, 0.0]))
    assert eq[0].shown == ("x", "v", "x**3")
    with pytest.raises(InputError, match="the constraints fix every coefficient"):
        eq.refine(record)


@settings(max_examples=draws(40), deadline=None)
@given(
    numbers=st.lists(st.floats(-5.0, 5.0).filter(lambda x: abs(x) > 1e-3), min_size=4, max_size=4),
    seed=st.integers(0, 2**16),
)
def test_parameters_keep_to_equations_whatever_the_free_ones(record_dynamics, numbers, seed):
    a, b, c, d = (float(f"{number:.6g}") for number in numbers)
    (one,) = parse_constraints([f"x + {a}*v == {b}", f"x**3 == {c}*u + {d}"], record_dynamics.laws[0].terms, ["a"])
    known = Known.of(record_dynamics, [one])
    assert known.basis.shape == (5, 3)
    theta = known.full(np.random.default_rng(seed).normal(size=3))
    x, v, cubic, u = theta[1:]
    assert x + a * v == pytest.approx(b, abs=1e-9 * (abs(a * v) + abs(b) + 1))
    assert cubic == pytest.approx(c * u + d, abs=1e-9 * (abs(c * u) + abs(d) + 1))
    np.testing.assert_allclose(known.start(theta), theta, rtol=1e-12, atol=1e-12)


@pytest.fixture(scope="module")
def record_dynamics(record):
    return found(record).dynamics()


# --- signs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("text", ["v <= 0", "v >= 0"])
def test_a_damping_of_nothing_keeps_its_sign(text, seed):
    record = undamped(0.0, seed)
    loose = signed(record).refine(record)
    after = signed(record, text).refine(record)
    sign = -1.0 if "<" in text else 1.0
    mean, sd = loose[0].coef["v"], loose[0].shown_posterior.sd[1]
    low, high = ((-np.inf, 0.0), (0.0, np.inf))[sign > 0]
    expected = truncnorm((low - mean) / sd, (high - mean) / sd, mean, sd)
    assert after[0].coef["v"] * sign > 0.0
    assert after[0].coef["v"] == pytest.approx(expected.mean(), rel=0.02)
    assert after[0].shown_posterior.sd[1] == pytest.approx(expected.std(), rel=0.02)
    at_bound = after.refined.at_bound
    assert at_bound == (("a: v",) if mean * sign < 0.0 else ())
    assert ("end of the known sign, for a: v" in str(after)) == bool(at_bound)


def test_a_sign_without_doubt_changes_nothing():
    record = undamped(0.05)
    loose, after = signed(record).refine(record), signed(record, "v <= 0").refine(record)
    np.testing.assert_array_equal(after[0].posterior.coef, loose[0].posterior.coef)
    np.testing.assert_allclose(after[0].posterior.covariance, loose[0].posterior.covariance, rtol=1e-12)


def test_a_wrong_sign_is_reported():
    record = undamped(0.05)
    with pytest.warns(DataWarning, match="free runs contradict the known sign of a: v .* check directions") as caught:
        after = signed(record, "v >= 0").refine(record)
    assert after.warnings[-1] == str(caught[0].message)
    assert after[0].coef["v"] > 0.0
    assert after.refined.at_bound == ("a: v",)


def test_truncated_moments_are_those_of_draws():
    rng = np.random.default_rng(3)
    L = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [-0.3, 0.5, 0.7]]) * np.array([[1.0], [1e-3], [1e4]])
    m, V = np.array([0.5, 3e-4, 4e3]), L @ L.T
    draws = m + rng.normal(size=(400_000, 3)) @ L.T
    kept = draws[(draws[:, 0] < 0) & (draws[:, 1] > 0)]
    mean, covariance = truncated(m, V, half_lines(np.array([-1, 1, 0])), 2e6, 1e6)
    sd = kept.std(axis=0)
    np.testing.assert_allclose(mean / sd, kept.mean(axis=0) / sd, atol=0.02)
    np.testing.assert_allclose(covariance / np.outer(sd, sd), np.cov(kept.T) / np.outer(sd, sd), atol=0.02)


@settings(max_examples=draws(100), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 6))
def test_bounded_steps_are_those_of_least_squares(seed, size):
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(size + 3, size))
    r = rng.normal(size=size + 3)
    signs = rng.integers(-1, 2, size)
    phi = signs * np.abs(rng.normal(size=size)) * (rng.random(size) < 0.7)
    low, high = np.where(signs > 0, -phi, -np.inf), np.where(signs < 0, -phi, np.inf)
    change = _bounded(J.T @ J, J.T @ r, phi, half_lines(signs))
    assert (signs * (phi + change) >= 0.0).all()
    twin = lsq_linear(J, r, (low, high), method="trf", tol=1e-14)
    assert np.sum((J @ change - r) ** 2) <= 2.0 * twin.cost + 1e-9


# --- files and the command -------------------------------------------------------------------------------------------


def test_files_keep_constraints_and_bounds(tmp_path):
    record = undamped(0.0, 0)
    eq = signed(record, "v <= 0")
    eq.save(tmp_path / "eq.json")
    again, after = bq.load(tmp_path / "eq.json").refine(record), eq.refine(record)
    assert again[0].coef == after[0].coef
    after.save(tmp_path / "after.json")
    loaded = bq.load(tmp_path / "after.json")
    assert (loaded.constraints, loaded.refined) == (("v <= 0",), after.refined)
    content = json.loads((tmp_path / "after.json").read_text())
    del content["diagnostics"]["refined"]["at_bound"]
    (tmp_path / "old.json").write_text(json.dumps(content))
    assert bq.load(tmp_path / "old.json").refined.at_bound == ()
    content["diagnostics"]["constraints"] = ["w <= 0"]
    (tmp_path / "bad.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"damaged: .*no candidate term named 'w'"):
        bq.load(tmp_path / "bad.json")


def test_through_the_command(record, tmp_path, capsys):
    file, saved = tmp_path / "run.csv", tmp_path / "eq.json"
    columns = np.column_stack([record.time, *(record[name] for name in "xvau")])
    np.savetxt(file, columns, delimiter=",", header="t,x,v,a,u", comments="")
    arguments = ["discover", str(file), "--chain", "x:v:a", "--input", "u", "--dictionary", "x,v,x**3,u"]
    arguments += ["--smooth", "none", "--constraint", "u == 1", "--constraint", "v <= 0", "--refine"]
    assert main([*arguments, "--json", "--save", str(saved)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["diagnostics"]["constraints"] == ["u == 1", "v <= 0"]
    assert content["diagnostics"]["refined"]["at_bound"] == []
    terms = {term["name"]: term for term in content["equations"][0]["terms"]}
    assert (terms["u"]["coef"], terms["u"]["sd"]) == (1.0, 0.0)
    assert terms["x"]["coef"] == pytest.approx(-1000.0, rel=0.01)
    assert bq.load(saved).constraints == ("u == 1", "v <= 0")
