from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.errors import BayeqError, ExpressionError, FileFormatError, InputError

OSCILLATOR = Variables(("x", "v"), ("u",))


def names(specification, variables=OSCILLATOR):
    return [term.text for term in build_dictionary(specification, variables)]


def columns(n=500, seed=0):
    rng = np.random.default_rng(seed)
    return {name: rng.normal(size=n) for name in ("x", "v", "u", "a")}


def test_oscillator_is_eq_31():
    # written out from eq. (31): (x + v)**g expanded for g = 1..6, sgn, abs, x (x) |x|, u
    expected = [
        *("x", "v"),
        *("x**2", "x*v", "v**2"),
        *("x**3", "x**2*v", "x*v**2", "v**3"),
        *("x**4", "x**3*v", "x**2*v**2", "x*v**3", "v**4"),
        *("x**5", "x**4*v", "x**3*v**2", "x**2*v**3", "x*v**4", "v**5"),
        *("x**6", "x**5*v", "x**4*v**2", "x**3*v**3", "x**2*v**4", "x*v**5", "v**6"),
        *("sign(x)", "sign(v)", "abs(x)", "abs(v)"),
        *("x*abs(x)", "x*abs(v)", "v*abs(x)", "v*abs(v)", "u"),
    ]
    assert names("oscillator") == expected
    assert len(expected) == 36


def test_columns_of_eq_31_are_what_they_say():
    c = columns()
    D = evaluate_terms(build_dictionary("oscillator", OSCILLATOR), c)
    x, v, u = c["x"], c["v"], c["u"]
    expected = [x**i * v ** (g - i) for g in range(1, 7) for i in range(g, -1, -1)]
    expected += [np.sign(x), np.sign(v), abs(x), abs(v), x * abs(x), x * abs(v), v * abs(x), v * abs(v), u]
    np.testing.assert_allclose(D, np.column_stack(expected), rtol=1e-12)


def test_polynomials():
    assert len(names("polynomial:2", Variables(("x", "y", "z")))) == 9
    assert names("polynomial:2", Variables(("x",), ("u",))) == ["x", "x**2", "u"]
    assert names("polynomial") == names("polynomial:3")


def test_two_degrees_of_freedom():
    terms = names("oscillator:3", Variables(("x", "v", "y", "w"), ("u",)))
    assert len(terms) == 34 + 4 + 4 + 16 + 1
    assert "x*abs(w)" in terms


def test_terms_from_a_file(tmp_path):
    path = tmp_path / "terms.txt"
    path.write_text("# a pendulum\nsin( x )\n\nv  # viscous\nv*abs(v)\n")
    assert names(str(path)) == ["sin(x)", "v", "v*abs(v)"]
    path.write_text("x\nv\nx**\n")
    with pytest.raises(ExpressionError, match="line 3"):
        names(str(path))
    path.write_text("x\nq\n")
    with pytest.raises(InputError, match=r"line 2.*'q'"):
        names(str(path))
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="not a text file"):
        names(str(path))
    with pytest.raises(FileFormatError, match="no such file"):
        names(str(tmp_path / "missing.txt"))


@pytest.mark.parametrize(
    "specification",
    [
        "oscilator",
        "polynomial:0",
        "polynomial:x",
        "polynomial:99",
        "polynomial:",
        "",
        "x,,v",
        [],
        ["x", "x"],
        ["x", " x"],
    ],
)
def test_wrong_specifications(specification):
    with pytest.raises(InputError):
        names(specification)


def test_too_many_terms():
    with pytest.raises(InputError, match="more than"):
        names("polynomial:12", Variables(tuple("abcdefgh")))


@given(st.text(max_size=40))
def test_any_text_is_a_dictionary_or_an_error(text):
    with contextlib.suppress(BayeqError):
        assert names(text)
