"""Unions of families and terms, terms left out, and one dictionary per equation."""

from __future__ import annotations

import contextlib
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bayeq as bq
from bayeq.dictionary import FAMILIES, Variables, build_dictionaries, build_dictionary, of_equations, written
from bayeq.errors import BayeqError, InputError


def quietly(records, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(records, **options)


OSCILLATOR = Variables(("x", "v"), ("u",), (("x", "v"),))
ROW = Variables(("x1", "v1", "x2", "v2", "x3", "v3"), ("u",), (("x1", "v1"), ("x2", "v2"), ("x3", "v3")))
TARGETS = ("a1", "a2", "a3")


def names(specification, variables=OSCILLATOR):
    return [term.text for term in build_dictionary(specification, variables)]


POLYNOMIAL = ["x", "v", "x**2", "x*v", "v**2", "u"]


@pytest.mark.parametrize(
    ("specification", "expected"),
    [
        ("polynomial:2 + sign(v)*x**2 - x*v", ["x", "v", "x**2", "v**2", "u", "sign(v)*x**2"]),
        ("-x*v + polynomial:2", ["x", "v", "x**2", "v**2", "u"]),
        ("polynomial:2 + x", POLYNOMIAL),
        # a sign of a number or of a power divides nothing, nor does one in brackets
        ("polynomial:1 + 1e-3*sin(x - v) + x**-1 + (-x*v) - u", ["x", "v", "0.001*sin(x-v)", "x**-1", "-x*v"]),
        ("polynomial:1 + fourier:2", ["x", "v", "u", "sin(x)", "cos(x)", "sin(2*x)", "cos(2*x)"]),
        ("polynomial:2 - polynomial:1", ["x**2", "x*v", "v**2"]),
        ("polynomial:2, sin(x), - u", ["x", "v", "x**2", "x*v", "v**2", "sin(x)"]),
        (["polynomial:2", "sin(x)", "-u"], ["x", "v", "x**2", "x*v", "v**2", "sin(x)"]),
        (["polynomial:1 - u", "(x-v)**3"], ["x", "v", "(x-v)**3"]),
        # no family: a term is a term
        ("x + v", ["x+v"]),
        ("x - v, -v", ["x-v", "-v"]),
        (["x+v", "-x"], ["x+v", "-x"]),
    ],
)
def test_unions(specification, expected):
    assert names(specification) == expected


@pytest.mark.parametrize(
    ("specification", "message"),
    [
        ("polynomial:2 - v**7", "no term named 'v\\*\\*7'.*nothing to leave out"),
        ("polynomial:2 - polynomial:2", "no terms are left"),
        ("polynomial:2 + sin(x", "missing '\\)' at column 6"),
        ("polynomial:2 + ", "missing|empty"),
        ("polynomial:2 + q", "no channel named 'q'"),
        ("polynomial:x + x", "whole number from 1 to 20"),
        ("neighbours:2", "takes nothing after a colon"),
        ("neighbours", "two coordinates or more"),
        ("oscilator + x", "did you mean the dictionary 'oscillator'"),
    ],
)
def test_what_is_wrong_with_a_union_is_said_in_a_line(specification, message):
    with pytest.raises(InputError, match=message) as caught:
        names(specification)
    assert "\n" not in str(caught.value)


@given(st.text(alphabet="xvu+-*() 12,:;e.", max_size=15).map(lambda text: f"polynomial:2 {text}"))
def test_any_union_is_a_dictionary_or_an_error(text):
    with contextlib.suppress(BayeqError):
        found = names(text)
        assert found
        assert len(set(found)) == len(found)


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_gives_distinct_terms(name):
    terms = names(name, ROW)
    assert len(set(terms)) == len(terms)
    assert "u" in terms


def test_fourier_is_of_the_coordinates():
    assert names("fourier:2", ROW)[:4] == ["sin(x1)", "cos(x1)", "sin(2*x1)", "cos(2*x1)"]
    assert len(names("fourier:3", ROW)) == 3 * 3 * 2 + 1


def test_neighbours_are_those_of_each_mass():
    terms, allowed = build_dictionaries("neighbours", TARGETS, ROW)
    own = [{term.text for term, kept in zip(terms, row, strict=True) if kept} for row in allowed]
    first = {"x1", "x2-x1", "v1", "v2-v1"}
    assert own[0] == {*first, *(f"({t})**3" if "-" in t else f"{t}**3" for t in first), "u"}
    assert {"x2-x1", "x3-x2", "x2"} < own[1]
    assert not {"x1", "x3"} & own[1]
    # the row as a whole
    assert {term.text for term in build_dictionary("neighbours", ROW)} == set.union(*own)


def test_a_dictionary_per_equation():
    given = {"a1": "x1, v1, u", "a2": ["polynomial:1", "x2**3", "-u"], "a3": "neighbours"}
    terms, allowed = build_dictionaries(given, TARGETS, ROW)
    assert allowed.sum(axis=1).tolist() == [3, 7, 9]
    text = "a1: x1, v1, u; a2: polynomial:1 + x2**3 - u; a3: neighbours"
    again, same = build_dictionaries(text, TARGETS, ROW)
    assert again == terms
    np.testing.assert_array_equal(same, allowed)
    assert of_equations(written(given), TARGETS).keys() == given.keys()
    assert of_equations("oscillator:3", TARGETS) is None


@pytest.mark.parametrize(
    ("specification", "message"),
    [
        ("a1: x1", "none is given for equation a2, a3"),
        ("a1: x1; a4: x2", "no equation named 'a4'"),
        ("a1: x1; a1: x2; a2: x1; a3: x1", "equation a1 has two"),
        ("x1; x2", "';' at column 3 is not allowed"),
        ("a1: x1; x2", "write the target of its equation in front"),
        ({"a1": "x1", "a2": "x2", "a3": "q"}, "equation a3: .*'q'"),
    ],
)
def test_what_is_wrong_with_dictionaries_per_equation(specification, message):
    with pytest.raises(InputError, match=message):
        build_dictionaries(specification, TARGETS, ROW)


@pytest.fixture(scope="module")
def row():
    """Two masses between walls, the second spring cubic, the force on the first."""
    time = np.arange(0.0, 14.0, 0.02)
    rng = np.random.default_rng(0)
    phases = rng.uniform(0, 2 * np.pi, 5)
    u = np.sin(np.outer(time, [1.7, 3.1, 4.4, 5.9, 7.3]) + phases).sum(axis=1)

    def slope(state, force):
        x1, v1, x2, v2 = state
        between = 30.0 * (x2 - x1) + 60.0 * (x2 - x1) ** 3
        return np.array([v1, -20.0 * x1 - 0.4 * v1 + between + 3.0 * force, v2, -between - 10.0 * x2 - 0.5 * v2])

    states = np.zeros((len(time), 4))
    for n in range(len(time) - 1):
        h, middle = 0.02, 0.5 * (u[n] + u[n + 1])
        k1 = slope(states[n], u[n])
        k2 = slope(states[n] + 0.5 * h * k1, middle)
        k3 = slope(states[n] + 0.5 * h * k2, middle)
        k4 = slope(states[n] + h * k3, u[n + 1])
        states[n + 1] = states[n] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    rates = np.array([slope(s, f) for s, f in zip(states, u, strict=True)])
    clean = {"x1": states[:, 0], "v1": states[:, 1], "a1": rates[:, 1]}
    clean |= {"x2": states[:, 2], "v2": states[:, 3], "a2": rates[:, 3]}
    noisy = {name: values + 0.01 * values.std() * rng.normal(size=len(time)) for name, values in clean.items()}
    return bq.Record.from_arrays({**noisy, "u": u}, time=time)


TWO = {"chains": ["x1:v1:a1", "x2:v2:a2"], "inputs": ["u"]}


@pytest.mark.parametrize(
    "options", [{}, {"method": "stlsq", "smooth": "none"}, pytest.param({"method": "vb"}, marks=pytest.mark.slow)]
)
def test_each_equation_has_its_own_terms(row, options):
    dictionary = {"a1": "neighbours", "a2": "x2, v2, x2**3, x2-x1, (x2-x1)**3, v2-v1"}
    eq = quietly(row, **TWO, dictionary=dictionary, **options)
    assert eq.dictionary == "a1: neighbours; a2: x2, v2, x2**3, x2-x1, (x2-x1)**3, v2-v1"
    first, second = eq
    assert {"x1", "u", "x2-x1", "(x2-x1)**3"} <= set(first.shown)
    assert {"x2", "x2-x1", "(x2-x1)**3"} <= set(second.shown)
    # x2 alone is no candidate of the first equation, u none of the second
    assert "x2" not in first.included
    assert "u" not in second.included
    pip = dict(zip(second.posterior.names, second.posterior.pip, strict=True))
    assert pip["u"] == 0.0
    assert pip["x1"] == 0.0
    assert "u" not in second.undetermined
    assert not any(runner.enters in ("u", "x1") for runner in second.runners_up)


def test_what_is_known_of_coefficients_goes_with_it(row):
    dictionary = "a1: neighbours; a2: x2, v2, x2-x1, (x2-x1)**3"
    eq = quietly(row, **TWO, dictionary=dictionary, constraints=["a1: u == 3", "a2: v2 == 0.05*x2"])
    assert eq["a1"].coef["u"] == pytest.approx(3.0)
    assert eq["a2"].coef["v2"] == pytest.approx(0.05 * eq["a2"].coef["x2"])
    with pytest.raises(InputError, match="u is no candidate of a2"):
        quietly(row, **TWO, dictionary=dictionary, constraints=["a2: u == 3"])
