"""Known relations between coefficients: equalities on the Gram, signs in the prior, and both through `discover`."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.dictionary import Variables, build_dictionary
from bayeq.errors import ExpressionError, InputError, UnknownNameError
from bayeq.expressions import parse
from bayeq.inference.bma import spike_slab_bma
from bayeq.inference.engines import ENGINES
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior, signs_of
from bayeq.regression.constraints import parse_constraints
from bayeq.regression.equalities import Equalities
from tests.draws import draws

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
TERMS = tuple(parse(text) for text in ("x", "v", "x*v", "x**3", "abs(x)/v", "u"))
NAMES = tuple(term.text for term in TERMS)


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **OSCILLATOR, **options)


def solved(*texts, terms=TERMS):
    (found,) = parse_constraints(texts, terms, ["a"])
    return found


# ---------------------------------------------------------------------------------------------------------------- text


@pytest.mark.parametrize(
    ("text", "slopes", "value"),
    [
        ("x == 2*v", {"x": 1, "v": -2}, 0),
        ("x + 2*v == 3", {"x": 1, "v": 2}, 3),
        ("u == 1", {"u": 1}, 1),
        (" 1 == u ", {"u": 1}, 1),
        ("-(x - v)/4 == x*v*2", {"x": -0.25, "v": 0.25, "x*v": -2}, 0),
        ("3*v*x == x*x*x", {"x*v": 3, "x**3": -1}, 0),
        ("2**3*x**2*x - 1e-1 == 0", {"x**3": 8}, 0.1),
        ("v**-1*abs(x) == u/-2", {"abs(x)/v": 1, "u": 0.5}, 0),
        ("2*(x + 3*(v - 1)) == 0", {"x": 2, "v": 6}, 6),
    ],
)
def test_an_equation_is_read_as_the_linear_one_that_it_is(text, slopes, value):
    equalities = solved(text).equalities
    row = np.array([slopes.get(name, 0.0) for name in NAMES])
    theta = equalities._values(np.random.default_rng(0).normal(size=(50, len(equalities.kept))))
    np.testing.assert_allclose(theta @ row, value, atol=1e-12)
    assert len(equalities.kept) == len(NAMES) - 1
    # the left-most term goes
    assert NAMES[equalities.eliminated[0]] == next(iter(slopes))


@settings(max_examples=draws(100), deadline=None)
@given(
    rows=st.lists(
        st.tuples(*[st.integers(-3, 3) for _ in NAMES], st.floats(-5, 5).map(lambda q: round(q, 3))),
        min_size=1,
        max_size=5,
    )
)
def test_all_equations_hold_or_they_are_refused(rows):
    R, q = np.array([row[:-1] for row in rows], dtype=float), np.array([row[-1] for row in rows])
    texts = [
        f"{' + '.join(f'{r:g}*({name})' for r, name in zip(row, NAMES, strict=True))} == {float(value)!r}"
        for row, value in zip(R, q, strict=True)
    ]
    rank = np.linalg.matrix_rank(R)
    if np.linalg.matrix_rank(np.column_stack([R, q]), tol=1e-9) > rank:
        with pytest.raises(InputError, match="contradicts"):
            solved(*texts)
        return
    equalities = solved(*texts).equalities
    assert len(equalities.eliminated) == rank
    theta = equalities._values(np.random.default_rng(0).normal(size=(5, len(equalities.kept))))
    np.testing.assert_allclose(theta @ R.T, np.broadcast_to(q, (5, len(q))), atol=1e-9)


def test_signs_are_read():
    assert signs_of(solved("v <= 0", "0 < x**3", "-u >= 0", "v < 0").limits).tolist() == [0, -1, 0, 1, 0, -1]


def test_a_constraint_may_concern_one_equation():
    first, second = parse_constraints(["a: v <= 0", "x == 1", "b: u==0.5"], TERMS, ["a", "b"])
    assert signs_of(first.limits).tolist() == [0, -1, 0, 0, 0, 0]
    assert not np.isfinite(second.limits).any()
    assert [NAMES[j] for j in first.equalities.eliminated] == ["x"]
    assert [NAMES[j] for j in second.equalities.eliminated] == ["x", "u"]


def test_the_biggest_term_that_is_a_candidate_is_meant():
    terms = [parse(text) for text in ("x", "v", "x*v", "2*x", "v-x")]
    found = solved("v - x == 1", "2*x == 4*x", terms=terms).equalities
    assert [terms[j].text for j in found.eliminated] == ["2*x", "v-x"]
    np.testing.assert_array_equal(found.slopes, [[4.0, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("w == 1", "no candidate term named 'w'; there are: x, v"),
        ("x*u == 1", r"no candidate term named 'x\*u'"),
        ("x*(v + u) == 1", "no candidate term named"),
        ("u = 1", "write one ==, <=, >= or ~"),
        ("u != 1", "write one ==, <=, >= or ~"),
        ("u", "write one ==, <=, >= or ~"),
        ("0 <= v >= 1", "write one ==, <=, >= or ~"),
        ("0 == v <= 1", "write one ==, <=, >= or ~"),
        ("0 <= v <= 1 <= 2", "write one ==, <=, >= or ~"),
        ("== 1", "write one ==, <=, >= or ~"),
        ("x == ", "write one ==, <=, >= or ~"),
        ("v <= x", "bounds one coefficient by numbers"),
        ("0 <= v + x <= 1", "bounds one coefficient by numbers"),
        ("1 >= 0", "bounds one coefficient by numbers"),
        ("b: v <= 0", "no equation named 'b'"),
        ("0 == 1", "contradicts"),
        ("x - x == 1", "contradicts"),
        ("x == 1/0", "not finite"),
        ("__import__('os') == 1", "not allowed"),
        ("x.real == 1", "no attributes"),
        (1.0, "is text"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(text, message):
    with pytest.raises(InputError, match=message) as caught:
        parse_constraints([text], TERMS, ["a"])
    assert "\n" not in str(caught.value)
    assert "constraint" in str(caught.value)


def test_types_of_errors():
    with pytest.raises(UnknownNameError):
        solved("w == 1")
    with pytest.raises(ExpressionError):
        solved("x * * 2 == 1")


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["u == 1", "u == 2"], "'u == 2': contradicts"),
        (["x == v", "v == u", "u == x + 1"], "contradicts"),
        (["v <= 0", "v >= 0"], "both signs"),
        (["v >= 0", "x == -2*v", "x >= 0"], "both signs"),
        (["x == 3", "x <= 0"], "one says that x is 3, another"),
        (["x == v + u", "x >= 0"], "write another term first"),
        ([f"{name} == 1" for name in NAMES], "nothing is left to find"),
    ],
)
def test_contradictions(texts, message):
    with pytest.raises(InputError, match=message):
        solved(*texts)


def test_a_term_that_was_left_out_is_told_from_one_that_never_was():
    with pytest.raises(InputError, match="term x was left out of the dictionary: constant on the data"):
        parse_constraints(["2*x == v"], TERMS[1:], ["a"], {"x": "constant on the data"})


def test_what_follows_from_the_others_is_not_a_second_equation():
    found = solved("x == 2*v", "4*v == 2*x", "0.1*x + 0.2*x == 0.3*x", "1 == 1").equalities
    assert len(found.eliminated) == 1


def test_a_sign_passes_to_the_term_that_decides_it():
    found = solved("x == -2*v", "x >= 0", "u == 1", "u >= 0")
    names = [NAMES[j] for j in found.equalities.kept]
    prior = found.prior(Prior(prior_inclusion=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    assert dict(zip(names, signs_of(prior.bounds), strict=True)) == {"v": -1, "x*v": 0, "x**3": 0, "abs(x)/v": 0}
    np.testing.assert_array_equal(prior.prior_inclusion, [0.2, 0.3, 0.4, 0.5])


# ---------------------------------------------------------------------------------------------------------- equalities


def regression(seed, n=80, P=6):
    rng = np.random.default_rng(seed)
    D = rng.normal(size=(n, P)) * 10.0 ** rng.uniform(-3, 3, size=P) + rng.normal(size=P)
    return D, D @ (rng.normal(size=P) / D.std(axis=0)) + 0.3 * rng.normal(size=n) + 5.0


@pytest.mark.parametrize("seed", range(5))
def test_the_reduced_gram_is_that_of_explicitly_combined_columns(seed):
    D, y = regression(seed)
    constraints = solved("x + 2*v == 3", "u == -0.5", "x**3 == 4*x - x*v")
    e = constraints.equalities
    columns = D[:, e.kept] + D[:, e.eliminated] @ e.slopes
    target = y - D[:, e.eliminated] @ e.offsets
    expected = Gram.from_data(columns, target, [NAMES[j] for j in e.kept])
    # in parts, as several records are
    found = constraints.equalities.reduce(Gram.from_data(D[:30], y[:30], NAMES) + Gram.from_data(D[30:], y[30:], NAMES))
    assert found.names == expected.names
    scale = np.sqrt(expected.diagonal)
    np.testing.assert_allclose(found.DtD / np.outer(scale, scale), expected.DtD / np.outer(scale, scale), atol=1e-9)
    np.testing.assert_allclose(found.Dty / scale, expected.Dty / scale, atol=1e-9 * math.sqrt(expected.yty))
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-9)
    assert (found.yty, found.target_mean) == pytest.approx((expected.yty, expected.target_mean), rel=1e-9)
    assert (found.n, found.dof) == (expected.n, expected.dof)


@pytest.mark.parametrize("method", ENGINES)
def test_the_posterior_is_that_of_a_fit_to_combined_columns(method):
    rec = bq.simulate("duffing", n=1200, seed=3)
    options = {"method": method, "holdout": 0.25, "smooth": "none"}
    terms = ["x", "v", "x**2", "x**3", "x*abs(x)", "u"]
    eq = quietly(rec, dictionary=terms, constraints=["x*abs(x) == 10*x**3 - 3*v", "u == 1"], **options)[0]
    # the same by hand: u to the left-hand side, each of the two columns with its share of x*abs(x)
    moved = rec.with_channels({"a": rec["a"] - rec["u"]})
    by_hand = quietly(moved, dictionary=["x", "v-3*x*abs(x)", "x**2", "x**3+10*x*abs(x)"], **options)[0]
    p, q = eq.posterior, by_hand.posterior
    np.testing.assert_allclose(p.pip[:4], q.pip, atol=1e-7)
    np.testing.assert_allclose(p.coef[:4], q.coef, rtol=1e-6)
    np.testing.assert_allclose(p.sd[:4], q.sd, rtol=1e-6)
    assert p.coef[4] == pytest.approx(10 * p.coef[3] - 3 * p.coef[1], rel=1e-12)
    assert (p.coef[5], p.sd[5], p.pip[5]) == (1.0, 0.0, 1.0)
    assert (p.intercept, p.intercept_sd) == pytest.approx((q.intercept, q.intercept_sd), rel=1e-6, abs=1e-9)
    assert p.noise_variance == pytest.approx(q.noise_variance, rel=1e-6)
    assert eq.held_out.nrmse * rec["a"][900:].std() == pytest.approx(
        by_hand.held_out.nrmse * moved["a"][900:].std(), rel=1e-6
    )
    mean, sd = eq.predict({name: rec[name] for name in "xvu"}, return_std=True)
    other, other_sd = by_hand.predict({name: rec[name] for name in "xv"}, return_std=True)
    np.testing.assert_allclose(mean, other + rec["u"], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(sd, other_sd, rtol=1e-6)


def test_values_are_in_original_units_and_records_are_joined():
    parts = [bq.simulate("duffing", n=400, seed=seed) for seed in range(2)]
    few = ["x", "v", "x**2", "x**3", "x*v", "v*abs(v)", "u"]
    eq = quietly(parts, constraints="u == 1", dictionary=few, holdout=0.0)
    scale = {"x": 1e3, "v": 1e-2, "a": 1e4, "u": 1e-3}
    rescaled = [
        bq.Record.from_arrays({name: rec[name] * scale[name] for name in "xvau"}, time=rec.time) for rec in parts
    ]
    other = quietly(rescaled, constraints="u == 1e7", dictionary=few, holdout=0.0)
    assert eq[0].included == other[0].included == ("x", "v", "x**3", "u")
    assert eq[0].coef["u"] == 1.0
    assert other[0].coef["x"] * 1e3 / 1e4 == pytest.approx(eq[0].coef["x"], rel=1e-5)
    np.testing.assert_allclose(eq[0].posterior.pip, other[0].posterior.pip, atol=1e-6)
    # what is known sharpens the rest, or leaves it: standard deviations by propagated noise err by some per cent
    true = [few.index(name) for name in ("x", "v", "x**3")]
    free = quietly(parts, dictionary=few, holdout=0.0)
    assert (eq[0].posterior.sd[true] < 1.01 * free[0].posterior.sd[true]).all()


def test_an_eliminated_term_is_in_where_one_that_it_follows_from_is():
    rng = np.random.default_rng(1)
    v = rng.normal(size=60)
    D = np.column_stack([rng.normal(size=60), v, v + 0.1 * rng.normal(size=60), rng.normal(size=60)])
    gram = Gram.from_data(D, v + 0.7 * rng.normal(size=60), ("x", "v", "w", "u"))
    terms = [parse(name) for name in gram.names]
    constraints = solved("x == 0.5*v + 0.25*w", "u == 0", terms=terms)
    reduced = constraints.equalities.reduce(gram)
    inner = spike_slab_bma(reduced)
    outer = constraints.equalities.expand(inner, gram)
    either = inner.average.probability @ inner.average.models.any(axis=1)
    assert 0.9 < max(inner.pip) + 0.3 < either + 0.3  # v and w stand in for each other
    np.testing.assert_allclose(outer.pip, [either, *inner.pip, 0.0])
    T = np.array([[0.5, 0.25], [1.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(outer.average.terms, [0, 1, 2])
    np.testing.assert_allclose(outer.average.covariance, T @ inner.average.covariance @ T.T)
    np.testing.assert_allclose(outer.averaged.sd[:3], np.sqrt(np.diagonal(outer.average.covariance)))
    np.testing.assert_allclose(outer.averaged.coef, np.append(T @ inner.averaged.coef, 0.0))
    np.testing.assert_allclose(
        outer.covariance,
        T[outer.support[:3]][:, inner.support] @ inner.covariance @ T[outer.support[:3]][:, inner.support].T,
    )
    together = outer.average.probability @ outer.average.models[:, [0, 1]].all(axis=1)
    assert together == pytest.approx(inner.pip[0])
    # draws of a chain tell the same
    sampled = constraints.equalities.expand(spike_slab_gibbs(reduced, samples=4000, burn_in=500), gram)
    np.testing.assert_allclose(sampled.draws.theta[..., 0], sampled.draws.theta @ [0, 0.5, 0.25, 0], rtol=1e-12)
    np.testing.assert_array_equal(sampled.draws.z[..., 0], sampled.draws.z[..., 1:3].any(axis=-1))
    np.testing.assert_allclose(sampled.pip, outer.pip, atol=0.02)
    np.testing.assert_allclose(sampled.averaged.sd, outer.averaged.sd, rtol=0.05, atol=1e-12)
    # without draws the spread is bounded
    bare = constraints.equalities.expand(spike_slab_gibbs(reduced, samples=4000, burn_in=500, keep_draws=False), gram)
    assert bare.averaged.sd[0] >= sampled.averaged.sd[0]
    assert bare.pip[0] == max(bare.pip[1:3])


def test_columns_that_cancel_are_columns_of_zeros():
    rng = np.random.default_rng(0)
    x, v = rng.normal(size=(2, 100))
    gram = Gram.from_data(np.column_stack([x, 3e5 * x + 1e-12 * v, v]), x + v, ("x", "v", "u"))
    equalities = solved("x == -3e5*v", terms=[parse(t) for t in "xvu"]).equalities
    reduced = equalities.reduce(gram)
    assert not reduced.DtD[0].any()
    assert reduced.Dty[0] == 0.0
    assert Equalities.solving(("x", "v"), []).reduce(gram) is gram


# ---------------------------------------------------------------------------------------------- discover, command line


def test_an_undecided_coefficient_keeps_to_its_sign():
    rec = bq.simulate("linear", n=300, seed=2)
    terms = build_dictionary("x, v, x*abs(x), u", Variables(("x", "v"), ("u",)))
    for text, sign in (("x*abs(x) >= 0", 1), ("x*abs(x) <= 0", -1)):
        prior = Prior(prior_inclusion=[0.1, 0.1, 1.0, 0.1])
        eq = quietly(rec, dictionary=[t.text for t in terms], constraints=text, prior=prior)[0]
        assert sign * eq.coef["x*abs(x)"] > 0


def test_what_hangs_on_an_answer_works_with_constraints(tmp_path):
    rec = bq.simulate("duffing", n=400, seed=1)
    terms = ["x", "v", "x**2", "x**3", "x**5", "v*abs(v)", "u"]
    eq = quietly(rec, dictionary=terms, constraints=["x**5 == 2*x**3", "u == 1", "x**3 <= 0"])
    assert eq.constraints == ("x**5 == 2*x**3", "u == 1", "x**3 <= 0")
    assert "constraints: x**5 == 2*x**3; u == 1; x**3 <= 0" in str(eq)
    assert set(eq[0].included) == {"x", "v", "x**3", "x**5", "u"}
    eq.save(tmp_path / "eq.json")
    back = bq.load(tmp_path / "eq.json")
    assert back.to_dict()["equations"][0]["terms"] == eq.to_dict()["equations"][0]["terms"]
    assert back.to_dict()["diagnostics"] == eq.to_dict()["diagnostics"]
    assert back.constraints == eq.constraints
    np.testing.assert_array_equal(back[0].posterior.covariance, eq[0].posterior.covariance)
    np.testing.assert_allclose(back.predict(rec, return_std=True), eq.predict(rec, return_std=True), rtol=1e-4)
    curve = eq[0].sensitivity(slab_variances=[10.0], prior_inclusions=[0.2]).prior_inclusion
    used = dict(zip(curve.names, curve.pip[curve.current], strict=True))
    assert used == pytest.approx({name: eq[0].posterior.pip[terms.index(name)] for name in used}, abs=1e-9)
    path = eq[0].path()
    assert path.is_chosen.any()
    assert "x**5" not in path.names
    known = ["x**5 == 2*x**3", "u == 1", "x**3 <= 0"]
    fewer = quietly(rec, dictionary=terms, constraints=known, max_terms=2, holdout=0.0)[0]
    assert "u" in fewer.shown
    assert len(set(fewer.shown) - {"u", "x**5"}) == 2  # the limit counts what is left to find
    assert "constraints" not in quietly(rec, dictionary=terms, smooth="none").to_dict()["diagnostics"]
    for engine in set(ENGINES) - {"auto", "bma"}:
        with pytest.raises(
            InputError, match=f"method '{engine}' takes no signs of coefficients; choose one of: auto, bma"
        ):
            quietly(rec, method=engine, constraints="v <= 0")


def test_a_sign_that_the_data_leave_no_doubt_of_changes_nothing():
    rec = bq.simulate("duffing", n=600, seed=1)
    few = "x, v, x**2, x**3, x*v, v*abs(v), u"
    asked = {"dictionary": few, "holdout": 0.0}
    known, free = (quietly(rec, **asked, constraints=constraints)[0] for constraints in (["u >= 0"], []))
    assert known.shown == free.shown
    np.testing.assert_array_equal(known.shown_posterior.coef, free.shown_posterior.coef)
    np.testing.assert_array_equal(known.shown_posterior.sd, free.shown_posterior.sd)


def test_a_sign_that_the_data_contradict_is_reported():
    rec = bq.simulate("duffing", n=600, seed=1)
    few = {"dictionary": "x, v, x**3, u"}
    eq = quietly(rec, **few, constraints=["x <= 0", "v >= 0", "u <= 0"])
    (message,) = [message for message in eq.warnings if "contradict" in message]
    assert message.startswith("a: the data contradict the known sign of v, u: check")
    assert not {"v", "u"} & set(eq[0].included)
    assert not any("contradict" in said for said in quietly(rec, **few, constraints=["x <= 0", "v <= 0"]).warnings)


def test_runners_up_know_the_signs():
    rec = bq.simulate("linear", n=300, seed=2)
    terms = ["x", "v", "x*abs(x)", "v*abs(v)", "u"]
    known, free = (
        quietly(rec, dictionary=terms, constraints=constraints, smooth="none")[0]
        for constraints in (["x*abs(x) >= 0", "v*abs(v) <= 0"], ["u >= 0"])
    )
    average, shown = known.posterior.average, known.posterior.support
    probability = {bytes(model): p for model, p in zip(average.models, average.probability, strict=True)}
    assert len(known.runners_up) > 1
    assert known.runners_up[0].log_odds == max(r.log_odds for r in known.runners_up)
    for r in known.runners_up:
        other = shown.copy()
        for name in {r.leaves, r.enters} - {None}:
            other[terms.index(name)] ^= True
        assert math.exp(r.log_odds) == pytest.approx(probability[bytes(other)] / probability[bytes(shown)], rel=1e-3)
    assert [r.log_odds for r in known.runners_up] != pytest.approx([r.log_odds for r in free.runners_up], abs=0.1)


def test_equations_of_a_system_share_constraints_or_have_their_own():
    rec = bq.simulate("lorenz", seed=0, noise=0.0)
    full = bq.Record.from_arrays({**rec.channels, **{k: v for k, v in rec.truth.clean.items() if k[0] == "d"}}, fs=100)
    eq = bq.discover(
        full,
        chains=["x:dx", "y:dy", "z:dz"],
        dictionary="polynomial:2",
        constraints=["dx: x + y == 0", "dy: y <= 0", "x**2 == 0"],
    )
    assert [set(e.included) for e in eq] == [{"x", "y"}, {"x", "y", "x*z"}, {"z", "x*y"}]
    assert eq["dx"].coef["x"] == -eq["dx"].coef["y"]
    assert eq["dy"].coef["y"] == pytest.approx(-1.0, rel=1e-4)


@pytest.fixture(scope="module")
def duffing(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "duffing.csv"
    assert main(["simulate", "duffing", "-o", str(path), "--n", "1500", "--seed", "1"]) == 0
    return path


CHANNELS = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_through_the_command(duffing, tmp_path, capsys):
    given = ["--constraint", "v <= 0", "--constraint", "u == 1"]
    few = ["--dictionary", "x, v, x**2, x**3, x*v, v*abs(v), u"]
    saved = tmp_path / "eq.json"
    assert main(["discover", str(duffing), *CHANNELS, *few, *given, "--json", "--save", str(saved)]) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["diagnostics"]["constraints"] == ["v <= 0", "u == 1"]
    terms = {t["name"]: t for t in out["equations"][0]["terms"]}
    assert {name for name, t in terms.items() if t["included"]} == {"x", "v", "x**3", "u"}
    assert (terms["u"]["coef"], terms["u"]["sd"], terms["u"]["pip"]) == (1.0, 0.0, 1.0)
    low, high = terms["v"]["ci95"]
    assert low < -2.0 < high < 0.0  # the law behind the record: -1000 x - 2 v - 1e5 x**3 + u
    assert bq.load(saved).constraints == ("v <= 0", "u == 1")
    assert main(["show", str(saved)]) == 0
    assert "\nconstraints: v <= 0; u == 1" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--constraint", "w <= 0"],
        ["--constraint", "v <= x"],
        ["--constraint", "v = 0"],
        ["--constraint", "b: v <= 0"],
        ["--constraint", "0 == 1"],
        ["--constraint", "u == 1", "--constraint", "u == 2"],
        ["--constraint", "v <= 0", "--constraint", "v >= 0"],
        ["--constraint", "v <= 0", "--method", "vb"],
        ["--constraint", "open('x') == 1"],
        ["--constraint", ""],
    ],
)
def test_wrong_text_ends_in_one_line(duffing, arguments, capsys):
    assert main(["discover", str(duffing), *CHANNELS, *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("bayeq: error: ")
    assert captured.err.count("\n") == 1


def test_a_law_that_a_contradicted_sign_makes_wrong_is_not_found():
    """Without v the terms left free make up for the damping: no other test speaks against them."""
    rec = bq.simulate("duffing", n=2000, seed=3)
    eq = quietly(rec, dictionary="x, v, x**2, x**3, u", constraints=["v >= 0"])
    assert (eq.verdict.kind, eq.verdict.reason) == ("not determined", "the record contradicts the known sign of v")
    assert quietly(rec, dictionary="x, v, x**2, x**3, u", constraints=["v <= 0"]).verdict.kind == "found"


@pytest.mark.parametrize("term", ["x2-x1", "(x2-x1)**3", "tanh(x2-x1)"])
def test_channels_in_two_units_of_one_quantity_are_not_subtracted(term):
    rng = np.random.default_rng(1)
    channels = {name: rng.standard_normal(200) for name in ("x1", "x2", "u")}
    record = bq.Record.from_arrays(channels, fs=10.0, units={"x1": "m", "x2": "mm"})
    asked = {"chains": ["x1::", "x2::"], "inputs": ["u"], "dictionary": f"x1, {term}, u"}
    with pytest.raises(InputError, match=r"x2 is in mm, x1 in m; give both in one unit, .* --units x2='0.001 m'"):
        bq.discover(record, **asked)
