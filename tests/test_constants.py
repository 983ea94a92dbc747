"""Constants inside terms, ``{name}``, and either-or: what is typed, where they are sought, found and printed."""

from __future__ import annotations

import json
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from studies.constants import kinetics

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionaries, build_dictionary
from bayeq.dictionary.ranges import ConstantEstimate, families, grids, located
from bayeq.equation.brief import brief
from bayeq.equation.explain import explanation
from bayeq.equation.written import at_end, constant_units, limit_of, plain_sd
from bayeq.errors import DataWarning, ExpressionError, InputError
from bayeq.expressions import Evaluator, Unknown, parse
from bayeq.likelihood.nodes import derivative
from bayeq.likelihood.spike import Soft
from bayeq.likelihood.unknowns import Tangent, as_one
from bayeq.records import Record

VARIABLES = Variables(("x", "v"), ("u",))
T = np.arange(400) / 50.0
COLUMNS = {"x": 0.2 * np.sin(9.0 * T), "v": 1.8 * np.cos(9.0 * T), "u": np.sin(3.0 * T) + np.cos(1.1 * T), "t": T}
FRICTION = {"x": -100.0, "v": -0.5, "u": 8.0, "tanh(v/{v0})": -3.0}


def motion(right, initial, inputs, n, fs):
    """Exact samples of dy/dt = right(y, u(t))."""
    t = np.arange(n) / fs
    run = solve_ivp(
        lambda at, y: right(at, y, inputs(at)), (0.0, t[-1]), initial, t_eval=t, rtol=1e-9, atol=1e-11, max_step=0.02
    )
    return t, run.y, inputs(t)


def force(t):
    return sum(np.sin(w * t + p) for w, p in ((3.0, 0.3), (7.9, 1.0), (11.3, 2.0), (17.0, 4.0))) / 2.0


def oscillator(added, n=600, fs=100.0, noise=0.01, seed=0, **given):
    """An oscillator with one term more, as it is measured."""

    def right(t, y, u):
        return np.array([y[1], -100.0 * y[0] - 0.5 * y[1] + 8.0 * u + added(y[0], y[1], t)])

    t, (x, v), u = motion(right, [0.05, 0.0], force, n, fs)
    channels = {"x": x, "v": v, "a": right(t, np.array([x, v]), u)[1], "u": u}
    rng = np.random.default_rng(seed)
    noisy = {name: c + noise * c.std() * rng.standard_normal(n) for name, c in channels.items()}
    return Record.from_arrays(noisy, fs=fs, **given)


def friction(v0=0.15, **given):
    return oscillator(lambda x, v, t: -3.0 * np.tanh(v / v0), **given)


def found(record, dictionary, **options):
    return bq.discover(record, **{"chains": "x:v:a", "inputs": ["u"], "dictionary": dictionary, **options})


@pytest.fixture(scope="module")
def record():
    return friction(seed=1, units={"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"})


@pytest.fixture(scope="module")
def answer(record):
    return found(record, "x, v, u, x**3, tanh(v/{v0})")


def ranges(*texts, columns=COLUMNS):
    constants = located(build_dictionary(list(texts), VARIABLES), [columns])
    return {name: (one.low, one.high) for name, one in constants.items()}


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("tanh(v/{c})", 0.2 * np.median(np.abs(np.diff(COLUMNS["v"]))), 1.8),
        ("tanh(v/(2*{c}))", 0.1 * np.median(np.abs(np.diff(COLUMNS["v"]))), 0.9),
        ("exp(-{c}*t)", 1.0 / (3.0 * T[-1]), 1.0 / (0.001 * T[-1])),
        ("max(x - {c}, 0)", COLUMNS["x"].min(), COLUMNS["x"].max()),
        ("max(x + {c}, 0)", -COLUMNS["x"].max(), -COLUMNS["x"].min()),
        # of a negative one it is the same law in another form
        ("max(x - {c}, 0) + min(x + {c}, 0)", 0.0, COLUMNS["x"].max()),
        ("max(x - {c}, 0) - max(-x - {c}, 0)", 0.0, COLUMNS["x"].max()),
        ("where(t > {c}, 1, 0)", 0.0, T[-1]),
        ("abs(v)**{c}*sign(v)", 0.25, 4.0),
        ("sin({c}*t)", math.pi / T[-1], 0.5 * math.pi * 50.0),
        ("sin(2*pi*{c}*t)", 0.5 / T[-1], 12.5),
        ("sin(3*t + {c})", -math.pi, math.pi),
        ("x/({c} + abs(x))", None, 3.0 * np.abs(COLUMNS["x"]).max()),
        ("v/sqrt(v**2 + {c}**2)", None, math.sqrt(3.0) * np.abs(COLUMNS["v"]).max()),
        ("abs(x)**{n: 1..3}/({c}**2 + x**2)", None, math.sqrt(3.0) * np.abs(COLUMNS["x"]).max()),
        ("tanh(v/{c: 0.5..0.7})", 0.5, 0.7),
        ("x*{c: -2 .. 1e1}**2*exp({c}*v)", -2.0, 10.0),
    ],
)
def test_ranges_are_read_by_the_place_of_a_constant(text, low, high):
    got = ranges("u", text)["c"]
    assert got[1] == pytest.approx(high, rel=1e-6)
    assert 0.0 < got[0] < 0.2 * high if low is None else got[0] == pytest.approx(low, rel=1e-6)


def test_a_sum_that_must_not_be_zero_begins_beyond_what_would_make_it_so():
    low, _ = ranges("1/({a} + x)")["a"]
    assert low > -COLUMNS["x"].min()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tanh(v/v0)", "an unknown constant is written {v0}"),
        ("{c}*v", r"c multiplies {c}\*v: it is its coefficient; leave it out"),
        ("sin(x)/{c}", "it is its coefficient"),
        ("{a}*x + {b}", "as two terms"),
        ("v*(x + {b})", "as two terms"),
        ("exp({a})", "every equation has one beside its terms"),
        ("tanh(v/{a})**{n}*exp(-{b}*x)*max(x-{c},0)", "4 unknown constants; at most 3"),
        ("sin({w}*{k}*x)", "w and k of .* stand for one constant"),
        ("tanh(v/{x})", "x is a channel; braces are for unknown constants"),
        ("tanh(v/{t})", "t is the time"),
        ("tanh(v/{pi})", "pi is a name with a meaning"),
        ("tanh(v/{v0: 1..2}), atan(x/{v0: 2..3})", r"{v0} has two ranges, 1..2 and 2..3"),
        ("tanh(v/{v0}) | tanh(v/{v0})", r"stands on both sides of '\|'"),
        ("tanh(v/{v0}) |", r"a term is missing beside '\|'"),
        ("v, tanh(v/{v0}) | v", "term 'v' was already given"),
        ("tanh(v/{v0}), tanh(v/{v0: 1..2})", "already given"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_line(text, message):
    with pytest.raises((InputError, ExpressionError), match=message) as caught:
        build_dictionary(f"x, u, {text}", VARIABLES)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sqrt({a} - v)", "the record does not tell where {a} may be: give its range, as in {a: 0.01..3}"),
        ("x*exp(-(v/{a})**2*cosh({c}))", "does not tell where {c}"),
        ("1/(1 + {a}*x)", "1\\+{a}\\*x, which divides, is zero in this record"),
        ("tanh(v/{a: -1..1})", "{a}, which divides, is zero"),
        ("x/({K: -0.1..0.1} + x)", "give a range where it is not"),
    ],
)
def test_ranges_that_the_record_does_not_give_are_asked_for(text, message):
    with pytest.raises(InputError, match=message):
        ranges("u", text)


def test_grids():
    terms = build_dictionary(["tanh(v/{a}) + tanh(v/{b})", "sin({w}*t + {p})", "x*exp({a}*x)"], VARIABLES)
    assert families(terms) == [[0, 2], [1]]
    constants = located(terms, [COLUMNS])
    placed = [term.with_unknowns(constants) for term in terms]
    nodes = list(grids([placed[1]], constants, [COLUMNS]))
    w = sorted({one["w"] for one in nodes})
    # closer than the record resolves, on a grid of both phases
    assert max(np.diff(w)) < 2.0 * math.pi / T[-1]
    assert len({one["p"] for one in nodes}) == 2
    assert all(abs(one["p"]) < 1.0 for one in nodes)
    assert len(list(grids([placed[0], placed[2]], constants, [COLUMNS]))) == 13**2
    wide = build_dictionary(["sin({w}*t)*sin({k: 1..1000}*t)"], VARIABLES)
    at = located(wide, [COLUMNS])
    with pytest.raises(InputError, match="give narrower ranges"):
        next(grids([wide[0].with_unknowns(at)], at, [COLUMNS]))


def test_one_constant_of_several_equations():
    variables = Variables(("x", "v", "y", "w"), (), (("x", "v"), ("y", "w")), targets=("a", "b"))
    terms, allowed = build_dictionaries("a: x, tanh(v/{s}); b: y, tanh(v/{s: 1..2})", ("a", "b"), variables)
    assert [term.text for term in terms] == ["x", "tanh(v/{s})", "y"]
    assert allowed.tolist() == [[True, True, False], [False, True, True]]
    assert terms[1].unknowns["s"].low == 1.0
    with pytest.raises(InputError, match=r"equation b: .*in no either-or here"):
        build_dictionaries("a: x, tanh(v/{s}) | sign(v); b: y, sign(v)", ("a", "b"), variables)


def test_a_family_gives_its_term_to_an_either_or():
    terms = build_dictionary("oscillator:1 + tanh(v/{v0}) | sign(v)", VARIABLES)
    assert {term.text for term in terms if term.choice} == {"tanh(v/{v0})", "sign(v)"}
    assert [term.text for term in terms].count("sign(v)") == 1


@pytest.mark.parametrize(
    ("text", "constant"),
    [
        ("tanh(v/{c})", Unknown("c", 0.01, 3.0, 0.4)),
        ("exp(-{c}*t)", Unknown("c", 0.1, 5.0, 0.7)),
        ("sin({c}*t + 1)", Unknown("c", 1.0, 9.0, 4.0)),
        ("abs(v)**{c}", Unknown("c", 0.25, 4.0, 1.5)),
        ("x/({c} + abs(x))", Unknown("c", 0.01, 1.0, 0.2)),
    ],
)
def test_derivatives_by_constants(text, constant):
    term = parse(text).with_unknowns({"c": constant})
    got = Evaluator(COLUMNS)(derivative(term, "c"))
    step = 1e-6 * constant.value

    def at(value):
        return Evaluator(COLUMNS)(term.with_unknowns({"c": replace(constant, value=value)}))

    slope = (at(constant.value + step) - at(constant.value - step)) / (2.0 * step)
    logarithmic = constant.high >= 10.0 * constant.low
    expected = slope * (constant.value if logarithmic else 1.0)
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_units_follow_the_place():
    units = {"x": "m", "v": "m/s", "u": "N", "t": "s"}
    texts = {
        "tanh(v/{c})": "m/s", "exp(-{c}*t)": "1/s", "sin(2*pi*{c}*t)": "1/s", "max(x - {c}, 0)": "m",
        "v/sqrt(v**2 + {c}**2)": "m/s", "where(t > {c}, 1, 0)": "s", "abs(v)**{c}": None, "max({c}*x - v, 0)": None,
    }  # fmt: skip
    for text, unit in texts.items():
        assert constant_units(build_dictionary([text], VARIABLES), units).get("c") == unit, text


def test_friction_is_found_with_its_constant(answer):
    eq = answer.equations[0]
    (one,) = eq.constants
    assert answer.verdict.kind == "found"
    assert set(eq.shown) == set(FRICTION)
    assert one.name == "v0"
    assert one.ci95[0] < 0.15 < one.ci95[1]
    assert one.ci95[1] - one.ci95[0] < 0.03
    assert one.logarithmic
    for name, value in FRICTION.items():
        j = [term.text for term in eq.terms].index(name)
        assert abs(eq.shown_posterior.coef[j] - value) < 3.5 * eq.shown_posterior.sd[j]
    assert eq.posterior.pip[-1] > 0.99
    assert eq.constant_units == {"v0": "m/s"}
    assert not eq.at_ends
    assert not answer.warnings


def test_every_surface_names_the_constant(answer, tmp_path):
    eq, (one,) = answer.equations[0], answer.equations[0].constants
    for text in (str(answer), brief(answer)):
        line = next(line for line in text.splitlines() if line.strip(" |").startswith("{v0}"))
        assert "m/s" in line
        assert f"{one.value:.2g}" in line
    assert len(brief(answer).splitlines()) <= 16
    assert "{v0}: a constant inside tanh(v/{v0})" in explanation(answer).replace("\n", " ")
    row = answer.table().query("term == '{v0}'").iloc[0]
    assert (row.coef, row.unit, row.ci_low) == (one.value, "m/s", one.ci95[0])
    assert np.isnan(row.pip)
    assert "v_{0}" in answer.to_latex()
    assert "v_{0}" in answer.to_latex("brackets")
    right = answer.to_sympy().rhs
    columns = {"x": 0.1, "v": 0.07, "u": 0.5}
    value = float(right.subs(columns))
    assert value == pytest.approx(float(eq.evaluate(columns)))
    assert answer.rhs(0.0, [0.1, 0.07], [0.5])[1] == pytest.approx(value)
    assert answer.to_callable()(0.0, np.array([0.1, 0.07]), np.array([0.5]))[1] == pytest.approx(value)
    scope = {}
    exec(answer.to_code("python"), scope)  # noqa: S102
    assert scope["rhs"](0.0, [0.1, 0.07], [0.5])[1] == pytest.approx(value)
    for language in ("c", "matlab", "julia"):
        assert "{" not in answer.to_code(language).split("tanh(")[1].split(")")[0]


def test_json_and_a_file_hold_all(answer, record, tmp_path):
    saved = json.loads(json.dumps(answer.to_dict()))["equations"][0]
    assert saved["constants"][0]["unit"] == "m/s"
    assert saved["constants"][0]["terms"] == ["tanh(v/{v0})"]
    assert saved["constants"][0]["logarithmic"]
    assert saved["constants"][0]["value_sd"] == saved["constants"][0]["sd"] * saved["constants"][0]["value"]
    answer.save(tmp_path / "eq.json")
    again = bq.load(tmp_path / "eq.json")
    assert str(again) == str(answer)
    assert again.to_dict()["equations"] == answer.to_dict()["equations"]
    rows = {name: record[name] for name in "xvu"}
    assert np.array_equal(again.equations[0].evaluate(rows), answer.equations[0].evaluate(rows))
    assert str(again.simulate(record)) == str(answer.simulate(record))
    assert np.array_equal(again.predict(record), answer.predict(record))
    assert again.to_code("c") == answer.to_code("c")


def test_what_follows_an_answer_keeps_its_constants(answer, record):
    eq = answer.equations[0]
    assert eq.path().models.shape[1] == len(eq.terms)
    assert "tanh(v/{v0})" in str(eq.sensitivity())
    assert "tanh(v/{v0})" in str(eq.coarsening())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refined = answer.refine(record)
    assert refined.equations[0].constants == eq.constants
    assert answer.physical is not None
    assert "tanh(v/{v0})" in str(answer.plan(realisations=2))


def test_the_value_is_that_of_least_squares_of_a_run():
    n, fs = 200, 100.0
    record = friction(n=n, noise=0.0)
    t = np.arange(n) / fs

    def left(p):
        _, (x, v), _ = motion(
            lambda at, y, u: [y[1], p[0] * y[0] + p[1] * y[1] + p[2] * u + p[3] * np.tanh(y[1] / p[4])],
            [record["x"][0], record["v"][0]], force, n, fs,
        )  # fmt: skip
        return np.concatenate([(x - record["x"]) / record["x"].std(), (v - record["v"]) / record["v"].std()])

    slow = least_squares(left, [-95.0, -0.7, 7.5, -2.5, 0.2], x_scale=[90.0, 1.0, 7.0, 2.0, 0.3]).x
    eq = found(record, "x, v, u, tanh(v/{v0})", holdout=0.0).equations[0]
    assert len(t) == record.n
    assert slow[4] == pytest.approx(0.15, rel=1e-4)
    assert eq.constants[0].value == pytest.approx(slow[4], rel=0.01)
    np.testing.assert_allclose([*eq.shown_posterior.coef[:4]], slow[:4], rtol=0.02)


def test_a_constant_at_the_end_of_its_range_is_said(record):
    with pytest.warns(DataWarning, match="v0 is at the lower end of its range"):
        eqs = found(record.slice(0, 300), "x, v, u, tanh(v/{v0: 0.4..4})", holdout=0.0)
    message = (
        "v0 is at the lower end of its range (0.4 .. 4 m/s): give a wider one, {v0: low..high}, or sign(v) in its place"
    )
    assert eqs.equations[0].at_ends == (message,)
    assert eqs.equations[0].verdict.kind == "not determined"
    assert message in str(eqs).replace("\n", " ")
    assert message in " ".join(brief(eqs).split())
    assert f"a: {message}" in eqs.to_dict()["diagnostics"]["warnings"]


def test_sentences_on_ends():
    one = ConstantEstimate("w", 2.0, 0.1, (1.0, 2.5), 1.0, 9.0, False, ("sin({w}*x)",))
    assert [*at_end(one)] == [
        "the interval of w reaches the lower end of its range (1 .. 9): give a wider one, {w: low..high}, or the term"
        " without it"
    ]
    assert [*at_end(replace(one, ci95=(1.5, 2.5)))] == []
    assert "upper end" in next(at_end(replace(one, value=8.99)))


@pytest.mark.parametrize(
    ("text", "lower", "upper"),
    [
        ("v/sqrt(v**2+{c}**2)", "sign(v) in its place", "v in its place"),
        ("atan({c}*v)", "v in its place", "sign(v) in its place"),
        ("x/({c}+x)", "the term without it", "x in its place"),
        ("exp({c}*x)", "the term without it", "the term without it"),
    ],
)
def test_what_a_term_is_far_beyond_the_ends(text, lower, upper):
    term = parse(text)
    term = term.with_unknowns({"c": replace(term.unknowns["c"], value=1.0, low=0.1, high=10.0)})
    one = ConstantEstimate("c", 1.0, 0.1, (0.8, 1.2), 0.1, 10.0, True, (term.text,))
    assert limit_of(one, [term], "lower") == lower
    assert limit_of(one, [term], "upper") == upper


def test_coarsening_widens_the_interval_of_the_constant(record):
    few, asked = record.slice(0, 250), {"dictionary": "x, v, u, tanh(v/{v0: 0.02..2})", "holdout": 0.0}
    narrow, wide = (found(few, **asked, **more).equations[0].constants[0] for more in ({}, {"coarsen": 0.25}))
    assert wide.sd == pytest.approx(2.0 * narrow.sd, rel=0.1)


def test_either_or_takes_the_true_form_and_says_how_sure(record):
    eqs = found(record.slice(0, 300), "x, v, u, tanh(v/{v0}) | atan(v/{v1}) | sign(v)", holdout=0.0)
    eq = eqs.equations[0]
    assert set(eq.shown) == set(FRICTION)
    (form,) = eq.forms.values()
    assert max(form, key=form.get) == "tanh(v/{v0})"
    assert set(form) == {"tanh(v/{v0})", "atan(v/{v1})", "sign(v)"}
    assert "form: tanh(v/{v0}) 1.000" in str(eqs)
    assert eqs.to_dict()["equations"][0]["forms"]


def test_none_in_the_record():
    eqs = found(oscillator(lambda x, v, t: 0.0, n=300), "x, v, u, tanh(v/{v0})", holdout=0.0)
    eq = eqs.equations[0]
    assert set(eq.shown) == {"x", "v", "u"}
    assert eq.shown_constants == ()
    assert eq.constants[0].sd is None
    assert "{v0}" not in "".join(line for line in str(eqs).splitlines() if line.strip(" |").startswith("{"))


@pytest.mark.slow  # other parameters than those of the kinetics below
def test_first_order_kinetics():
    def inflow(t):
        return 0.5 + 0.2 * np.sin(0.9 * t) + 0.15 * np.sin(2.3 * t + 1.0)

    _, (x,), u = motion(lambda t, y, u: [u - 0.9 * y[0] / (0.4 + y[0])], [1.0], inflow, 400, 10.0)
    noisy = x + 0.01 * x.std() * np.random.default_rng(0).standard_normal(400)
    record = Record.from_arrays({"x": noisy, "u": u}, fs=10.0)
    eq = found(record, "x, x**2, u, x/({K} + x)", chains="x", noise={"u": 0.0}, holdout=0.0).equations[0]
    assert set(eq.shown) == {"u", "x/({K}+x)"}
    assert eq.constants[0].ci95[0] < 0.4 < eq.constants[0].ci95[1]


@pytest.mark.parametrize(
    ("added", "term", "place"),
    [
        (lambda x, v, t: -9.0 * (np.asarray(t) > 3.02), "where(t > {t0}, 1, 0)", 3.02),
        pytest.param(
            lambda x, v, t: -6.0 * (np.asarray(x) > 0.02), "where(x > {t0}, 1, 0)", 0.02, marks=pytest.mark.slow
        ),
    ],
)
def test_a_term_that_jumps_at_an_unknown_place_is_found(added, term, place):
    eq = found(oscillator(added), f"x, v, u, {term}", holdout=0.0).equations[0]
    assert set(eq.shown) == {"x", "v", "u", parse(term, ["x", "v", "u", "t"]).text}
    assert eq.constants[0].value == pytest.approx(place, abs=0.02)


def test_other_terms_that_stand_for_a_function_do_not_hide_its_constant():
    """A Ricker map that grows to its rest, where a cubic does nearly as well: that was found with a PIP of 1."""
    x = np.full(60, 0.05)
    for k in range(59):
        x[k + 1] = x[k] * math.exp(1.2 - 0.4 * x[k])
    noisy = x + 0.02 * x.std() * np.random.default_rng(1).standard_normal(60)
    eq = found(Record({"x": noisy}), "x, x**2, x**3, x*exp(-{b}*x)", chains="x", inputs=[], discrete=True).equations[0]
    assert set(eq.shown) == {"x*exp(-{b}*x)"}
    assert eq.constants[0].value == pytest.approx(0.4, abs=0.01)


def test_terms_are_judged_with_the_constant_free():
    """Given the value of {K} that a false constant asks for, this had a PIP of 0.82."""
    record, truth, parameters = kinetics(0.05, 300003)
    eq = found(record, "x, x**2, x**3, u, x/({K}+x)", chains="x", noise={"u": 0.0}).equations[0]
    assert set(eq.shown) == set(truth)
    assert eq.constants[0].ci95[0] < parameters["K"] < eq.constants[0].ci95[1]


def test_the_evidence_of_a_model_has_its_constants_integrated_out(answer):
    """Constants are coefficients of what the terms change by, with their range as prior, of models of these terms."""
    eq = answer.equations[0]
    record = eq.fit.regression.record
    task = record.task
    soft = Soft.of(task, record.fitted)
    (constant,) = soft.constants
    assert constant.name == "v0"
    tau, A = (0.01,), soft.whole.information
    slope = soft.whole.slope  # about zero: the fit's coefficients are part of the deviation
    direct, log_odds = [], np.where(np.isfinite(task.log_odds), task.log_odds, 0.0)
    found = dict(zip(map(bytes, soft.models(tau).models), soft.models(tau).log_posterior, strict=True))
    models = [np.frombuffer(key, dtype=np.bool_) for key in list(found)[:20]]
    models = [model for model in models if model[constant.of[1]]]
    assert len(models) > 3
    for model in models:
        slabs = np.zeros(len(soft.about))
        slabs[soft.visible[model]] = task.precision[model] ** -0.5
        slabs[constant.column] = math.log(constant_range(eq)) / math.sqrt(12.0)
        S = np.hstack([np.diag(slabs)[:, slabs > 0], tau[0] * soft.spreads[0]])
        root = np.linalg.cholesky(np.eye(S.shape[1]) + S.T @ A @ S)
        w = np.linalg.solve(root, S.T @ slope)
        direct.append(0.5 * w @ w - np.log(np.diagonal(root)).sum() + log_odds[model].sum())
    listed = [found[model.tobytes()] for model in models]
    np.testing.assert_allclose(np.subtract(listed, listed[0]), np.subtract(direct, direct[0]), atol=0.02)


def constant_range(eq):
    """Largest over least value of a scale."""
    return eq.constants[0].high / eq.constants[0].low


def test_a_gap_and_a_constant_of_two_terms():
    record = oscillator(lambda x, v, t: -60.0 * (max(x - 0.03, 0.0) if np.ndim(x) == 0 else np.maximum(x - 0.03, 0.0)))
    eq = found(record, "x, v, u, max(x - {g: 0..0.1}, 0), v*max(x - {g}, 0)", holdout=0.0).equations[0]
    assert "max(x-{g},0)" in eq.shown
    assert "v*max(x-{g},0)" not in eq.shown
    assert eq.constants[0].value == pytest.approx(0.03, abs=0.003)


def test_several_records_and_a_dictionary_by_its_equation():
    records = [friction(n=200, seed=1), friction(n=200, seed=2)]
    eqs = found(records, {"a": ["x", "v", "u", "tanh(v/{v0})"]}, holdout=0.0)
    assert set(eqs.equations[0].shown) == set(FRICTION)
    assert eqs.equations[0].constants[0].value == pytest.approx(0.15, abs=0.02)


def test_constraints_name_terms_with_constants(record):
    record = record.slice(0, 200)
    eqs = found(record, "x, v, u, tanh(v/{v0})", constraints="a: tanh(v/{v0}) <= 0", holdout=0.0)
    assert set(eqs.equations[0].shown) == set(FRICTION)
    with pytest.raises(InputError, match=r"\{v0\} is a constant inside a term: write its range there"):
        found(record, "x, v, u, tanh(v/{v0})", constraints="{v0} == 0.1")


@pytest.mark.parametrize(
    ("dictionary", "options", "message"),
    [
        ("x, v, u, tanh(v/{v0})", {"smooth": "none"}, "found by the likelihood of the record: use smooth='auto'"),
        ("x, v, u, v | sign(v)", {"smooth": "none"}, "already given"),
        ("x, u, v | sign(v)", {"smooth": "none"}, "either-or, are found by the likelihood"),
        ("x, v, u, abs(x)**{n}*log({c} - v)", {}, "does not tell where {c}"),
    ],
)
def test_refusals(record, dictionary, options, message):
    with pytest.raises(InputError, match=message) as caught:
        found(record, dictionary, **options)
    assert "\n" not in str(caught.value)


def test_rows_without_time_ask_for_it(record):
    order = np.random.default_rng(0).permutation(record.n)
    rows = bq.Record({name: values[order] for name, values in record.channels.items()})
    with pytest.raises(InputError, match=r"give time \(of rows in any order fs=1\), or write a number"):
        bq.discover(rows, target="u", inputs=["x", "v"], dictionary="x, v, tanh(v/{v0})")


def test_files_read_in_pieces_refuse_in_one_line(record, tmp_path):
    bq.write(record, tmp_path / "r.csv")
    with pytest.raises(InputError, match="constants inside terms need the record in memory: choose some rows"):
        found(str(tmp_path / "r.csv"), "x, v, u, tanh(v/{v0})", stream=True)


def test_a_batch_has_a_line_for_each_constant(tmp_path):
    for k, v0 in enumerate((0.1, 0.2)):
        bq.write(friction(v0, n=250, seed=k), tmp_path / f"r{k}.csv")
    options = {"chains": "x:v:a", "inputs": ["u"], "dictionary": "x, v, u, tanh(v/{v0: 0.02..2})", "holdout": 0.0}
    batch = bq.batch(sorted(map(str, tmp_path.glob("r*.csv"))), store=tmp_path / "b.db", jobs=1, **options)
    rows = batch.table().query("term == '{v0}'")
    np.testing.assert_allclose(rows.coef, [0.1, 0.2], rtol=0.15)
    assert "{v0}" in str(batch)


def test_a_constant_of_two_equations_is_one_number() -> None:
    """By the information folded onto one number: with F that repeats it, (F' A F)^-1 and its mean."""
    rng = np.random.default_rng(8)
    root = rng.standard_normal((6, 6))
    covariance, theta = root @ root.T, rng.standard_normal(6)
    change = parse("x")
    tangents = [Tangent("K", 0, change), Tangent("g", 0, change), Tangent("K", 1, change)]
    fold = np.zeros((6, 5))
    fold[np.arange(6), [0, 1, 2, 3, 4, 3]] = 1.0
    information = np.linalg.inv(covariance)
    folded = np.linalg.inv(fold.T @ information @ fold)
    mean = folded @ fold.T @ information @ theta
    found, joint, first = as_one(tangents, theta, covariance)
    assert first == {"K": 3, "g": 4}
    np.testing.assert_allclose(found, fold @ mean, rtol=1e-9)
    np.testing.assert_allclose(joint, fold @ folded @ fold.T, rtol=1e-9, atol=1e-12)


def test_a_bend_is_sought_on_a_fine_grid():
    (term,) = build_dictionary(["max(x - {g}, 0)"], VARIABLES)
    constants = located([term], [COLUMNS])
    places = [values["g"] for values in grids([term], constants, [COLUMNS])]
    assert len(places) == 100
    (smooth,) = build_dictionary(["tanh(v/{s})"], VARIABLES)
    assert len(list(grids([smooth], located([smooth], [COLUMNS]), [COLUMNS]))) == 13
    several = build_dictionary(["max(x - {g}, 0)", "min(x + {g}, 0)*abs(v - {h})"], VARIABLES)
    assert len(list(grids(several, located(several, [COLUMNS]), [COLUMNS]))) == 50**2


@pytest.mark.filterwarnings("ignore::bayeq.errors.TermWarning")
def test_a_power_is_no_copy_of_another_term():
    record = oscillator(lambda x, v, t: -2.0 * np.sign(v) * np.abs(v) ** 2.6, n=500)
    eq = found(record, "x, v, u, v*abs(v), v**3, sign(v)*abs(v)**{p}", holdout=0.0).equations[0]
    assert set(eq.shown) == {"x", "v", "u", "sign(v)*abs(v)**{p}"}
    (power,) = eq.constants
    assert power.value == pytest.approx(2.6, abs=4.0 * power.sd)
    assert power.sd < 0.2


@pytest.mark.parametrize("bend", [4.0, 1.5])
def test_a_family_stands_for_its_series(bend):
    record = oscillator(lambda x, v, t: -40.0 / bend * (np.exp(bend * x) - 1.0), n=500)
    answer = found(record, "x, v, u, x**2, x**3, x**4, x**5, x**2*v, exp({q}*x)", holdout=0.0)
    eq = answer.equations[0]
    if bend > 2.0:  # the series is far from it
        assert set(eq.shown) == {"x", "v", "u", "exp({q}*x)"}
        assert eq.constants[0].value == pytest.approx(bend, abs=4.0 * plain_sd(eq.constants[0]))
        assert not eq.forms
    else:  # nobody can tell, and this is said
        (found_forms,) = eq.forms.values()
        assert any("exp" in name for name in found_forms)
        assert any("x**2" in name for name in found_forms)
        assert "form undecided: " in brief(answer)


def test_a_power_does_not_depend_on_units():
    """In millimetres the derivative by the power is nearly the term itself: steps went the wrong way."""
    record = oscillator(lambda x, v, t: -2.0 * np.sign(v) * np.abs(v) ** 2.7, n=500)
    large = Record.from_arrays({name: 1000.0 * record[name] for name in "xvau"}, fs=100.0)
    powers = [found(one, "x, v, u, sign(v)*abs(v)**{p}", holdout=0.0)[0].constants[0] for one in (record, large)]
    assert powers[0].value == pytest.approx(2.7, abs=4.0 * powers[0].sd)
    assert powers[1].value == pytest.approx(powers[0].value, abs=0.1 * powers[0].sd)


@pytest.mark.parametrize("half", [1.5, 1.9])
def test_a_saturation_is_found_beside_a_straight_line(half):
    """Of values far above its constant, a line and a constant say nearly as much: the term itself must be tried."""
    t, (c,), u = motion(
        lambda _, y, u: u - 1.26 * y / (half + y), [3.0], lambda t: 1.3 + 0.6 * force(0.3 * t), 400, 66.0
    )
    rng = np.random.default_rng(5)
    noisy = {"c": c + 0.01 * c.std() * rng.standard_normal(400), "u": u + 0.01 * u.std() * rng.standard_normal(400)}
    eq = found(Record.from_arrays(noisy, time=t), "c, u, c/({K}+c)", chains="c", holdout=0.0)[0]
    assert set(eq.shown) == {"u", "c/({K}+c)"}
    assert eq.constants[0].value == pytest.approx(half, abs=4.0 * plain_sd(eq.constants[0]))


@pytest.mark.parametrize("seed", [1, 2])
def test_of_two_forms_of_a_clearance_the_one_without_a_constant_is_taken(seed):
    """max(x + h, 0) = x + h + max(-x - h, 0): with negative gaps, another stiffness and a force the law is the same."""
    record = oscillator(
        lambda x, v, t: 300.0 * np.maximum(-x - 0.07, 0.0) - 150.0 * np.maximum(x - 0.05, 0.0), n=1000, seed=seed
    )
    candidates = "x, v, u, x**3, sign(v), v*abs(v), max(x-{g},0), max(-x-{h},0)"
    eq = found(record, candidates, holdout=0.0)[0]
    assert set(eq.shown) == {"x", "v", "u", "max(x-{g},0)", "max(-x-{h},0)"}
    assert not eq.intercept_matters
    for constant, true in zip(eq.constants, (0.05, 0.07), strict=True):
        assert constant.value == pytest.approx(true, abs=4.0 * plain_sd(constant))


def test_intervals_follow_a_bent_likelihood():
    """F = A (exp(b x) - 1) with much noise: mostly A b is known, and A grows where b falls."""
    rng = np.random.default_rng(5602)
    t = np.arange(120) / 50.0
    x = np.sin(2 * np.pi * 0.7 * t) + 0.6 * np.sin(2 * np.pi * 1.9 * t + 1.0)
    F = 2.0 * (np.exp(0.3 * x) - 1.0)
    F += 0.5 * F.std() * rng.standard_normal(len(t))
    record = bq.Record.from_arrays({"x": x, "F": F}, time=t)
    asked = {"target": "F", "inputs": ["x"], "noise": {"x": 0.0}, "holdout": 0.0}
    eq = bq.discover(record, dictionary="exp({b: 0.02..3}*x)-1", **asked)[0]

    b = np.geomspace(0.02, 3.0, 2000)
    columns = np.exp(b[:, None] * x) - 1.0
    square = (F**2).sum() - (columns @ F) ** 2 / (columns**2).sum(axis=1)  # least over A
    likely = b[0.5 * len(t) * np.log(square / square.min()) < 0.5 * 1.96**2]
    (constant,) = eq.constants
    assert constant.ci95 == pytest.approx((likely[0], likely[-1]), rel=0.03)
    # where b is at its lower end A is 2.7 times that at the estimate, which the tangent there does not see
    A = (columns @ F) / (columns**2).sum(axis=1)
    assert eq.shown_model.ci95[0, 1] > A[b >= likely[0]][0] > 2.5 * eq.shown_model.coef[0]


def test_what_a_stated_law_leaves_open_is_in_the_intervals():
    """A hidden force, df = (u - f - kb v)/tau, and k, c, b of the motion: of five numbers the record fixes four."""
    rng, t = np.random.default_rng(5610), np.arange(400) / 50.0
    phases = rng.uniform(0.0, 2.0 * np.pi, 12)

    def u(s):
        return np.sin(2.0 * np.pi * np.multiply.outer(s, np.linspace(0.2, 3.5, 12)) + phases).sum(axis=-1)

    def rates(s, y):
        return [y[1], -90.0 * y[0] - 1.5 * y[1] + 5.0 * y[2], (u(s) - y[2] - 0.3 * y[1]) / 0.12]

    x, v, _ = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y
    channels = {name: one + 0.01 * one.std() * rng.standard_normal(len(t)) for name, one in (("x", x), ("v", v))}
    record = bq.Record.from_arrays({**channels, "u": u(t)}, time=t)
    law = "df = (u - f - {kb: 0.02..3}*v)/{tau: 0.01..1}"
    with pytest.warns(DataWarning, match="the interval of kb reaches the upper end of its range"):
        eqs = bq.discover(record, chains="x:v:", inputs=["u"], dictionary="x, v, f", law=law, holdout=0.0)
    ends = dict(zip([term.text for term in eqs[0].terms], eqs[0].shown_model.ci95, strict=True))
    for name, true in {"x": -90.0, "v": -1.5, "f": 5.0}.items():
        assert ends[name][0] < true < ends[name][1]
    assert ends["x"][1] - ends["x"][0] > 20.0
    constants = {one.name: one.ci95 for one in eqs[1].constants}
    assert constants["tau"][0] < 0.12 < constants["tau"][1]
    assert constants["kb"][0] < 0.3 < constants["kb"][1]


def test_a_term_that_is_not_finite_where_it_is_likeliest():
    """A decay into noise: a power of negative samples is finite at the first value, but not at the likeliest."""
    t = np.linspace(0.0, 10.0, 100)
    x = 0.8 * np.exp(-0.7 * t) + 0.01 * np.random.default_rng(939502).standard_normal(100)
    record = bq.Record.from_arrays({"x": x}, time=t)
    with pytest.raises(InputError, match=r"term x\*\*\{a\}: not finite.* at a = .*: write abs\(\)"):
        bq.discover(record, chains="x", dictionary="x, x**{a: 0.5..3}")


def test_two_values_that_are_as_likely_are_told():
    """dc = -0.8 c + 3 exp(-t/2.2): the two rates may be exchanged, with another size of the drive."""
    t = np.arange(200) / 20.0
    c = solve_ivp(lambda s, y: -0.8 * y + 3.0 * np.exp(-s / 2.2), (0.0, t[-1]), [0.1], t_eval=t, rtol=1e-9).y[0]
    noisy = c + 0.02 * c.std() * np.random.default_rng(939210).standard_normal(len(t))
    record = bq.Record.from_arrays({"c": noisy}, time=t)
    answer = bq.discover(record, chains="c", dictionary="c, c**2, exp(-t/{tau})", holdout=0.0)
    assert answer.verdict.kind == "not determined"
    other = float(answer.verdict.reason.partition("tau = ")[2])
    found = sorted([other, answer.constants[0].value])
    assert found == pytest.approx([1.0 / 0.8, 2.2], rel=0.06)
