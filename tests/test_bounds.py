"""Bounds of coefficients: boxes, weights of models and moments against slow twins, and all through `discover`."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import BayeqWarning, InputError, UnknownNameError
from bayeq.expressions import parse
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior, half_lines
from bayeq.inference.signs import Orthants, truncated
from bayeq.regression.constraints import parse_constraints
from tests import reference
from tests.draws import draws

TERMS = [parse(text) for text in ("x", "v", "x**3", "u")]
NONE = [-math.inf, math.inf]


# ------------------------------------------------------------------------------------------------------------- parsing


def limits(*texts: str, targets: tuple[str, ...] = ("a",)) -> list[list[list[float]]]:
    return [one.limits.tolist() for one in parse_constraints(texts, TERMS, targets)]


def test_the_colon_of_a_range_names_no_equation() -> None:
    terms = [*TERMS, parse("tanh(v/{v0: 0.1..3})")]
    for text in ("a: tanh(v/{v0: 0.1..3}) <= 0", "tanh(v/{v0: 0.1..3}) <= 0"):
        [own] = parse_constraints([text], terms, ("a",))
        assert own.limits[-1].tolist() == [-math.inf, 0.0]


def test_bounds_are_read() -> None:
    [own] = limits("0 <= x**3 <= 5", "v >= -3", "2 >= 2*u > -4")
    assert own == [NONE, [-3.0, math.inf], [0.0, 5.0], [-2.0, 1.0]]
    assert limits("-3 <= b: v <= -1", "a: x <= 7", targets=("a", "b")) == [
        [[-math.inf, 7.0], NONE, NONE, NONE],
        [NONE, [-3.0, -1.0], NONE, NONE],
    ]
    # several statements about a coefficient narrow it, and a sign is a bound of 0
    assert limits("v <= 0", "-2 <= v <= 9", "-1 <= v") == [[NONE, [-1.0, 0.0], NONE, NONE]]


@settings(max_examples=draws(100), deadline=None)
@given(
    low=st.floats(-1e6, 1e6),
    width=st.floats(1e-3, 1e6),
    factor=st.floats(0.01, 100.0),
    down=st.booleans(),
    minus=st.booleans(),
)
def test_what_is_written_is_what_is_read(low: float, width: float, factor: float, down: bool, minus: bool) -> None:
    high = low + width
    first, last, relation = (high, low, ">=") if down else (low, high, "<=")
    sign = -1.0 if minus else 1.0
    [own] = limits(f"{first!r} {relation} a: {sign * factor!r}*x {relation} {last!r}")
    expected = sorted([sign * low / factor, sign * high / factor])
    assert own[0] == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert own[1:] == [NONE] * 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("5 <= x <= 0", "x would be at least 5 and at most 0: correct one"),
        ("5 <= x <= 5", "write 'x == 5'"),
        ("0 <= x <= nan", "no candidate term named 'nan'"),
        ("x <= 1e400", "too large"),
        ("x <= 1/0", "not finite"),
        ("0 <= x**2 <= 5", r"no candidate term named 'x\*\*2'"),
        ("0 <= x + v <= 5", "bounds one coefficient by numbers"),
        ("0 <= x >= 5", "write one =="),
        ("0 <= x <= 5 <= 6", "write one =="),
        ("0 <= b: x <= 5", "no equation named 'b'"),
        ("0 <= a: <= 5", "write one =="),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        limits(text)
    assert "\n" not in str(caught.value)
    assert "constraint" in str(caught.value)


def test_bounds_pass_to_the_term_that_decides_and_must_agree_with_equalities() -> None:
    [found] = parse_constraints(["x == 2 - 4*v", "0 <= x <= 6", "v >= -0.5"], TERMS, ["a"])
    prior = found.prior(Prior(), unit=np.array([10.0, 1.0, 1.0]))
    np.testing.assert_allclose(np.asarray(prior.bounds)[0], [-5.0, 5.0])
    with pytest.raises(InputError, match="one says that x is 3, another that it is between 0 and 2"):
        limits("x == 3", "0 <= x <= 2")
    with pytest.raises(InputError, match="at least 2 and at most 1"):
        limits("x == v", "x >= 2", "v <= 1")


def test_a_term_whose_bounds_exclude_zero_is_in() -> None:
    [found] = parse_constraints(["1 <= x <= 2", "-1 <= v <= 2", "u <= -3"], TERMS, ["a"])
    assert found.forced.tolist() == [True, False, False, True]
    np.testing.assert_array_equal(found.prior(Prior()).prior_inclusion, [1.0, 0.1, 0.1, 1.0])
    # but a candidate of other equations only stays out
    np.testing.assert_array_equal(
        found.prior(Prior(prior_inclusion=[0.0, 0.1, 0.1, 0.1])).prior_inclusion, [0, 0.1, 0.1, 1]
    )


# --------------------------------------------------------------------------------------------------------------- boxes


@pytest.mark.parametrize(
    ("h", "m", "width"), [(h, m, w) for h in (3.0, 500.0) for m, w in [(0.5, 1.0), (-4.0, 0.3), (2.0, 40.0)]]
)
def test_one_coefficient_in_a_box_by_quadrature(h: float, m: float, width: float) -> None:
    s = 2.0
    scale = math.sqrt(s / (2 * h))
    t, edges = np.linspace(0.0, width, 200_001), stats.t(2 * h, m * scale, scale)
    density = edges.pdf(t * scale)
    weight = density / density.sum()
    box = Orthants(np.array([[m * scale]]), np.ones((1, 1, 1)), np.array([s]), h, np.array([[width * scale]]))
    expected = edges.cdf(width * scale) - edges.cdf(0.0)
    assert box.log_probability[0] == pytest.approx(math.log(expected), abs=5e-3)
    mean, covariance, _ = box.moments()
    first = weight @ (t * scale)
    assert 0.0 < mean[0, 0] < width * scale
    assert mean[0, 0] == pytest.approx(first, rel=1e-2)
    assert covariance[0, 0, 0] == pytest.approx(weight @ (t * scale - first) ** 2, rel=3e-2)


def test_truncated_moments_are_those_of_draws() -> None:
    rng = np.random.default_rng(3)
    L = np.array([[1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [-0.3, 0.5, 0.7]]) * np.array([[1.0], [1e-3], [1e4]])
    m, V = np.array([0.5, 3e-4, 4e3]), L @ L.T
    drawn = m + rng.normal(size=(600_000, 3)) @ L.T
    ends = np.array([[-0.5, 0.2], [5e-4, 2e-3], NONE])
    kept = drawn[((drawn > ends[:, 0]) & (drawn < ends[:, 1])).all(axis=1)]
    mean, covariance = truncated(m, V, ends, 2e6, 1e6)
    sd = kept.std(axis=0)
    np.testing.assert_allclose(mean / sd, kept.mean(axis=0) / sd, atol=0.02)
    np.testing.assert_allclose(covariance / np.outer(sd, sd), np.cov(kept.T) / np.outer(sd, sd), atol=0.02)


@pytest.mark.parametrize("far", [1e-9, 1e-3, 1.0, 1e3])
def test_narrow_and_wide_boxes_far_out_are_kept_to(far: float) -> None:
    for side in (-1.0, 1.0):
        ends = side * np.array([30.0, 30.0 + side * side * far])
        ends = np.array([[ends.min(), ends.max()], NONE])
        mean, covariance = truncated(np.zeros(2), np.array([[1.0, 0.5], [0.5, 1.0]]), ends, 2e6, 1e6)
        assert ends[0, 0] <= mean[0] <= ends[0, 1]
        assert np.isfinite(covariance).all()
        assert mean[1] == pytest.approx(0.5 * mean[0], rel=1e-6)


# --------------------------------------------------------------------------------------------------- averages of models


def by_sampling(D, y, prior, count, rng):
    """PIPs, mean and sd of theta by draws of every model, those beyond the bounds rejected."""
    v, a, b, N, P = prior.slab_variance, prior.noise_shape, prior.noise_rate, len(y) - 1, D.shape[1]
    ends = np.asarray(prior.bounds)
    share = stats.norm.cdf(ends[:, 1] / math.sqrt(v)) - stats.norm.cdf(ends[:, 0] / math.sqrt(v))
    p0 = np.broadcast_to(prior.prior_inclusion, P)
    models, logs, _, _ = reference.enumerate_models(D, y, v_s=v, p0=0.5, a=a, b=b, N=N)
    with np.errstate(divide="ignore"):
        logs = logs + np.where(models, np.log(p0), np.log(1.0 - p0)).sum(axis=1)
    weight, first, second = np.zeros(len(models)), np.zeros((len(models), P)), np.zeros((len(models), P))
    for k, z in enumerate(models):
        if logs[k] == -math.inf:
            continue
        V = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / v)
        m = V @ D[:, z].T @ y
        variance = 0.5 * (2 * b + y @ y - m @ D[:, z].T @ y) / rng.gamma(a + 0.5 * N, size=count)
        theta = np.zeros((count, P))
        theta[:, z] = m + np.sqrt(variance)[:, None] * (rng.normal(size=(count, z.sum())) @ np.linalg.cholesky(V).T)
        inside = ((theta >= ends[:, 0]) & (theta <= ends[:, 1]) | ~z).all(axis=1)
        weight[k] = math.exp(logs[k] - logs.max()) * inside.mean() / share[z].prod()
        kept = theta[inside] if inside.any() else np.zeros((1, P))
        first[k], second[k] = kept.mean(axis=0), (kept**2).mean(axis=0)
    weight /= weight.sum()
    mean = weight @ first
    return weight @ models, mean, np.sqrt(weight @ second - mean**2)


@pytest.mark.parametrize("seed", range(4))
def test_averages_against_draws_of_every_model(seed: int) -> None:
    rng = np.random.default_rng(seed)
    D, y, _ = reference.random_problem(rng, n=14, P=4, rho=0.6, noise=1.0, active=0.5)
    gram = Gram.from_data(D, y)
    free = spike_slab_bma(gram, Prior(5.0, 0.3, 2.0, 2.0))
    spread = np.maximum(np.abs(free.averaged.coef), 0.3)
    ends = np.column_stack([free.averaged.coef - spread, free.averaged.coef + 0.2 * spread])
    ends[0, 0], ends[1, 1] = -math.inf, math.inf  # one-sided; the third may exclude 0
    ends[3] = [-0.4, 0.3]
    forced = (ends[:, 0] > 0.0) | (ends[:, 1] < 0.0)
    prior = Prior(5.0, np.where(forced, 1.0, 0.3), 2.0, 2.0, bounds=ends)
    pip, mean, sd = by_sampling(D, y, prior, 100_000, rng)
    for most in (14, 0):
        fit = spike_slab_bma(gram, prior, enumerate_up_to=most, tolerance=1e-4)
        np.testing.assert_allclose(fit.pip, pip, atol=1e-2)
        np.testing.assert_allclose(fit.averaged.coef, mean, atol=0.02 * sd.max())
        np.testing.assert_allclose(fit.averaged.sd, sd, atol=0.03 * sd.max())
        inside = (fit.coef >= ends[:, 0]) & (fit.coef <= ends[:, 1])
        assert (inside | ~fit.support).all()
    theta, _, _ = sample_average(Problem.of(gram, prior), fit.average, 500, rng, prior.limits)
    assert ((theta >= ends[:, 0]) & (theta <= ends[:, 1]) | (theta == 0.0)).all()


def test_half_lines_are_signs_to_the_last_bit_and_wide_bounds_are_none() -> None:
    rng = np.random.default_rng(2)
    D, y, _ = reference.random_problem(rng, n=40, P=6, rho=0.7, noise=2.0, active=0.5)
    gram, signs = Gram.from_data(D, y), np.array([1, -1, 0, 1, 0, -1])
    one, two = (spike_slab_bma(gram, prior) for prior in (Prior(signs=signs), Prior(bounds=half_lines(signs))))
    assert one.pip.tobytes() == two.pip.tobytes()
    assert one.covariance.tobytes() == two.covariance.tobytes()
    free, wide = spike_slab_bma(gram), spike_slab_bma(gram, Prior(bounds=np.full((6, 2), 1e6) * [-1.0, 1.0]))
    np.testing.assert_allclose(wide.pip, free.pip, atol=1e-12)
    assert wide.coef.tobytes() == free.coef.tobytes()
    with pytest.raises(InputError, match="bounds must be a lower and a higher number for each of the 6 terms"):
        spike_slab_bma(gram, Prior(bounds=[[0.0, 1.0]]))


# --------------------------------------------------------------------------------------------------- through `discover`

ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
CHANNELS = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, x**3, u, x**2"]


@pytest.fixture(scope="module")
def record() -> bq.Record:
    return bq.simulate("duffing", n=600, seed=1, noise=0.05)


def found(record: bq.Record, *constraints: str, **options) -> bq.Equation:
    ask = {**ROLES, "dictionary": "x, v, x**3, u, x**2", **options}
    return bq.discover(record, constraints=constraints, **ask)[0]


@pytest.mark.parametrize("smooth", ["auto", "none"])
def test_bounds_that_hold_change_nothing_and_those_in_doubt_cut(record: bq.Record, smooth: str) -> None:
    free, wide = found(record, smooth=smooth), found(record, "-1e7 <= x**3 <= 0", "u <= 9", smooth=smooth)
    assert wide.shown == free.shown
    np.testing.assert_allclose(wide.shown_posterior.coef, free.shown_posterior.coef, rtol=1e-9)
    np.testing.assert_allclose(wide.shown_posterior.sd, free.shown_posterior.sd, rtol=1e-9)
    # the law behind the record: -1000 x - 2 v - 1e5 x**3 + u; a bound a standard deviation from what is found
    names = list(free.posterior.names)
    j = names.index("x**3")
    mean, sd = free.shown_posterior.coef[j], free.shown_posterior.sd[j]
    end = mean + sd
    cut = found(record, f"a: x**3 >= {float(end)!r}", smooth=smooth)
    assert set(cut.shown) == set(free.shown)
    assert cut.shown_coef["x**3"] > end
    assert cut.printed_ci95[j, 0] == end
    assert cut.shown_posterior.sd[j] < 0.7 * sd
    if smooth == "none":  # the likelihood adds the uncertainty of the projection
        twin = stats.truncnorm(1.0, np.inf, mean, sd)
        assert cut.shown_coef["x**3"] == pytest.approx(twin.mean(), abs=0.15 * sd)
        assert cut.shown_posterior.sd[j] == pytest.approx(twin.std(), rel=0.1)
    # what trades with it moves along
    assert cut.shown_coef["x"] < free.shown_coef["x"]


@pytest.mark.parametrize("smooth", ["auto", "none"])
def test_a_record_that_contradicts_a_bound_says_by_how_much(record: bq.Record, smooth: str) -> None:
    pattern = r"a: the record contradicts x\*\*3 >= -2e\+04 by [5-9]\.\d sd \(free: -.*e\+0\d\): check"
    with pytest.warns(BayeqWarning, match=pattern):
        eq = found(record, "-2e4 <= x**3 <= 0", "x**2 == 0", smooth=smooth)
    assert -2e4 <= eq.coef["x**3"] < -1.5e4
    assert eq.verdict.kind == "not determined"
    assert re.fullmatch(r"the record contradicts x\*\*3 >= -2e\+04 by [5-9]\.\d sd", eq.verdict.reason)
    assert eq.ci95[list(eq.posterior.names).index("x**3"), 0] == -2e4


def test_a_term_that_bounds_force_in_is_in_whatever_the_record_says(record: bq.Record) -> None:
    with pytest.warns(BayeqWarning, match="contradicts x..2 >= 1000 by"):
        eq = found(record, "1e3 <= x**2 <= 2e3")
    assert eq.posterior.pip[list(eq.posterior.names).index("x**2")] == 1.0
    assert 1e3 <= eq.shown_coef["x**2"] <= 2e3
    for engine in ("vb", "gibbs"):
        with pytest.raises(InputError, match=f"'{engine}' takes no bounds of coefficients; choose one of: auto, bma"):
            found(record, "u <= 2", method=engine)


def test_equations_of_a_system_have_their_own_bounds() -> None:
    rec = bq.simulate("lorenz", n=1500, seed=0, noise=0.01)
    with pytest.warns(BayeqWarning, match=r"^dx: the record contradicts y <= 9 by [0-9.e+]+ sd \(free: (9\.9|10)"):
        eq = bq.discover(
            rec, chains=["x", "y", "z"], dictionary="polynomial:2", constraints=["0 <= dx: y <= 9", "20 <= dy: x <= 40"]
        )
    assert 8.5 < eq["dx"].coef["y"] <= 9.0
    assert eq["dy"].coef["x"] == pytest.approx(28.0, abs=1.0)
    assert {"x", "y", "x*z"} == set(eq["dy"].shown)
    with pytest.raises(UnknownNameError, match="no equation named 'dw'"):
        bq.discover(rec, chains=["x", "y", "z"], dictionary="polynomial:2", constraints=["0 <= dw: y <= 9"])


@pytest.mark.parametrize("text", ["dx: x*z >= 0", "0 <= dx: x*z <= 5", "dx: x*z ~ 1 +- 0.1"])
def test_what_is_said_of_a_term_that_only_another_equation_has_is_refused(text: str) -> None:
    record = bq.simulate("lorenz", n=100, seed=1, noise=0.01)
    dictionary = {"dx": ["x", "y"], "dy": ["x", "y", "x*z"], "dz": ["z", "x*y"]}
    with pytest.raises(InputError, match=r"x\*z is no candidate of dx: add it there, or drop the constraint"):
        bq.discover(record, chains=["x", "y", "z"], dictionary=dictionary, constraints=[text])


def test_refined_coefficients_keep_to_their_bounds(record: bq.Record) -> None:
    ask = {**ROLES, "dictionary": "x, v, x**3, u", "smooth": "none"}
    eq = bq.discover(record, constraints=["-2.5 <= v <= -2.2"], **ask)
    after = eq.refine(record)
    assert after.refined is not None
    assert -2.5 <= after[0].coef["v"] <= -2.2
    low, high = after[0].ci95[list(after[0].posterior.names).index("v")]
    assert -2.5 <= low < high <= -2.2


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_through_the_command(tmp_path, capsys) -> None:
    path, saved = tmp_path / "duffing.csv", tmp_path / "eq.json"
    assert main(["simulate", "duffing", "-o", str(path), "--n", "600", "--seed", "1", "--noise", "0.05"]) == 0
    capsys.readouterr()
    given = ["--constraint", "-9.5e4 <= a: x**3 <= 0"]
    assert main(["discover", str(path), *CHANNELS, *given, "--json", "--save", str(saved)]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["diagnostics"]["constraints"] == given[1:]
    term = next(one for one in out["equations"][0]["terms"] if one["name"] == "x**3")
    assert -9.5e4 == term["ci95"][0] < term["coef"] < term["ci95"][1] <= 0.0
    assert term["printed_ci95"][0] >= -9.5e4
    back = bq.load(saved)
    assert back[0].ci95.tolist() == [one["ci95"] for one in out["equations"][0]["terms"]]
    assert back.to_dict()["equations"][0]["terms"] == out["equations"][0]["terms"]
    back.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == saved.read_text()
    for bad in ("5 <= x <= 0", "0 <= w <= 1", "0 <= x <= nan"):
        assert main(["discover", str(path), *CHANNELS, "--constraint", bad]) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith("bayeq: error: constraint")
        assert captured.err.count("\n") == 1
