"""Equations written for other programs compute what `rhs` does."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import InputError, MissingExtraError, UnknownNameError

# Every function of terms, also where it bends or jumps, and its arguments are where it is defined.
TERMS = [
    "x", "sign(v)", "abs(x)", "v*abs(v)", "where(x > v, x, v**2)", "floor(3*x)", "ceil(x)", "heaviside(v)", "relu(x)",
    "sigmoid(2*x)", "max(x,v,0.1)", "min(x,v)", "mod(x,0.7)", "atan2(v,x)", "sin(x)", "cos(v)", "tan(x/4)", "asin(x/4)",
    "acos(x/4)", "atan(x)", "exp(x)", "log(4+x)", "sqrt(4+v)", "sinh(x)", "cosh(v)", "tanh(x)", "asinh(x)",
    "acosh(5+v)",
    "atanh(x/4)", "log10(4+x)", "log1p(abs(v))", "cbrt(x)", "erf(x)",
    "pi*x", "e**x", "x**3", "v**-2", "1/(2+x**2)",
    "u", "t", "abs(x)**0.5",
    "x-v/3",
]  # fmt: skip
SYSTEMS = ("linear", "duffing", "quadratic", "coulomb", "vanderpol", "lorenz")


def of(terms, chains, inputs=("u",)):
    """Equations with these terms: those of a small file, with others in their place."""
    rng = np.random.default_rng(0)
    n = 60
    names = [name.lstrip("~") for chain in chains for name in chain.split(":") if name]
    columns = {name: rng.normal(size=n) for name in (*names, *inputs)}
    record = bq.Record.from_arrays(columns, fs=100.0)
    return bq.discover(
        record, chains=chains, inputs=inputs, dictionary=terms, smooth="none", method="stlsq", holdout=0.0
    )


@pytest.fixture(scope="module")
def rich(tmp_path_factory):
    """An equation that shows every function, with coefficients that are not round."""
    return shown(TERMS, ["x:v:a"], ("u",), tmp_path_factory.mktemp("rich"))


def shown(terms, chains, inputs, folder):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eq = of(["x" if "x" in terms else terms[0]], chains, inputs)
    eq.save(folder / "eq.json")
    content = json.loads((folder / "eq.json").read_text())
    rng = np.random.default_rng(1)
    for saved, state in zip(content["equations"], content["posteriors"], strict=True):
        like, saved["undetermined"] = saved["terms"][0], []
        saved["terms"] = []
        for name in terms:
            coef = float(rng.normal())
            saved["terms"].append(
                {**like, "name": name, "coef": coef, "shown_coef": coef, "included": True, "shown": True, "why": None}
            )
        state.update(
            covariance=(0.01 * np.eye(len(terms))).tolist(), center=[0.1] * len(terms), shown=None, full=None,
            optimum=None, average=None, models=[],
        )  # fmt: skip
        checks = content["diagnostics"]["equations"][saved["target"]]
        checks["runners_up"], checks["left_out"] = [], []
    (folder / "eq.json").write_text(json.dumps(content))
    return bq.load(folder / "eq.json")


def points(eq, count=20):
    rng = np.random.default_rng(2)
    return [
        (float(rng.uniform(0, 9)), rng.uniform(-1.9, 1.9, len(eq.states)), rng.uniform(-2, 2, len(eq.inputs)))
        for _ in range(count)
    ]


def python_function(eq):
    scope = {}
    exec(compile(eq.to_python(), "rhs.py", "exec"), scope)  # noqa: S102
    return scope["rhs"]


def c_function(eq, folder):
    gcc = shutil.which("gcc") or pytest.skip("there is no gcc")
    (folder / "rhs.c").write_text(eq.to_code("c"))
    command = [
        gcc,
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-shared",
        "-fPIC",
        "-O1",
        "rhs.c",
        "-o",
        "rhs.so",
        "-lm",
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    library = ctypes.CDLL(str(folder / "rhs.so"))
    double = ctypes.POINTER(ctypes.c_double)

    def rhs(t, y, u):
        out = np.empty(len(y))
        library.rhs(ctypes.c_double(t), *(np.ascontiguousarray(a).ctypes.data_as(double) for a in (y, u, out)))
        return out

    return rhs


def assert_same(function, eq):
    for t, y, u in points(eq):
        np.testing.assert_allclose(function(t, y, u), eq.rhs(t, y, u), rtol=1e-9, atol=1e-11)


def test_python_and_c_compute_every_function(rich, tmp_path):
    assert len(rich[0].shown) == len(TERMS)
    assert_same(python_function(rich), rich)
    assert_same(c_function(rich, tmp_path), rich)


def test_steps_at_zero(tmp_path):
    eq = shown(["sign(x)", "heaviside(x)", "abs(x)", "where(x >= 0, 1+x, v)", "mod(x,2)"], ["x:v:a"], (), tmp_path)
    for x in (-1.0, 0.0, 1.0):
        y = np.array([x, 0.5])
        for function in (python_function(eq), c_function(eq, tmp_path)):
            np.testing.assert_allclose(function(0.0, y, np.empty(0)), eq.rhs(0.0, y), rtol=1e-12)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.filterwarnings("ignore")
def test_every_system(name, tmp_path):
    record, ask = bq.simulate(name, n=300, seed=1), {"smooth": "none"}
    if set("xvau") <= set(record.names):
        terms = ["x", "v", "u", "x**3", "x**2", "v*abs(v)", "sign(v)"]
        found = bq.discover(
            record, displacement="x", velocity="v", acceleration="a", force="u", dictionary=terms, **ask
        )
    else:
        chains = list(record.names)
        found = bq.discover(record, chains=chains, dictionary="polynomial:2", **ask)
    assert_same(python_function(found), found)
    assert_same(c_function(found, tmp_path), found)
    vectors = found.to_callable()
    t, y, u = 0.0, np.random.default_rng(0).normal(size=(len(found.states), 5)), np.ones((len(found.inputs), 5))
    many = vectors(t, y, u)
    assert many.shape == y.shape
    for k in range(5):
        np.testing.assert_allclose(many[:, k], found.rhs(t, y[:, k], u[:, k]), rtol=1e-12)


def test_functions_of_arrays(rich):
    assert_same(rich.to_callable("numpy"), rich)
    one = rich.to_callable()
    np.testing.assert_allclose(one(1.0, [0.5, 0.2], 0.3), rich.rhs(1.0, [0.5, 0.2], 0.3))
    with pytest.raises(InputError, match=r"2 rows of the state are needed \('x', 'v'\), got shape \(3,\)"):
        one(0.0, [1.0, 2.0, 3.0], 0.0)
    with pytest.raises(InputError, match="1 rows of the input"):
        one(0.0, [1.0, 2.0])
    with pytest.raises(UnknownNameError, match="no module named 'torch'"):
        rich.to_callable("torch")


def test_functions_of_jax(rich):
    jax = pytest.importorskip("jax")
    with jax.enable_x64(True):
        function = jax.jit(rich.to_callable("jax"))
        assert_same(function, rich)
        slopes = jax.jacobian(function, argnums=1)(1.0, np.array([0.31, 0.52]), np.array([0.3]))
    assert np.isfinite(slopes).all()
    np.testing.assert_allclose(slopes[0], [0.0, 1.0])


def test_jax_that_is_missing_is_named(rich, monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.setitem(sys.modules, "jax.numpy", None)
    with pytest.raises(MissingExtraError, match=r"bayeq\[jax\]"):
        rich.to_callable("jax")


def test_names_that_are_words_of_a_language(tmp_path):
    eq = shown(["int", "end", "rhs", "θ*int", "fabs_"], ["int:end:dy", "fabs_:θ:pow"], ("rhs",), tmp_path)
    assert_same(python_function(eq), eq)
    assert_same(c_function(eq, tmp_path), eq)
    assert "const double int_ = y[0];" in eq.to_code("c")
    assert "const double u03b8 = y[3];" in eq.to_code("c")
    assert "end_ = y[2]" in eq.to_code("julia")
    assert "end_ = y(2);" in eq.to_code("matlab")
    assert "rhs_ = u(1);" in eq.to_code("matlab")
    for language in ("c", "julia", "matlab", "python"):
        assert eq.to_code(language).isascii()


def test_text_of_julia_and_matlab(tmp_path):
    eq = shown(["x", "sign(v)", "x**2"], ["x:v:a"], (), tmp_path)
    julia, matlab = eq.to_code("julia"), eq.to_code("matlab")
    assert julia.startswith("# dy = f(t, y, u); y: x, v; u: none.")
    assert julia.splitlines()[1:5] == ["function rhs(t, y, u)", "    x = y[1]", "    v = y[2]", "    dy1 = v"]
    assert julia.splitlines()[-2:] == ["    return [dy1, dy2]", "end"]
    assert "(v > 0) ? (1) : (v < 0) ? (-1) : (0)" in julia
    assert "    dy(1) = v;" in matlab
    assert "..." not in matlab
    with pytest.raises(UnknownNameError, match="no language named 'cobol'; there are: c, julia, matlab, python"):
        eq.to_code("cobol")


def test_latex_with_standard_deviations(tmp_path):
    eq = shown(["x", "v", "x-v/3"], ["x:v:a"], (), tmp_path)
    coef = eq[0].coef
    brackets, both = eq.to_latex("brackets"), eq.to_latex("plus-minus", aligned=True)
    assert brackets.startswith(rf"\ddot{{x}} = {coef['x']:.2f}(10)\,x")
    assert rf"\left({coef['v']:.2f} \pm 0.10\right)\,\dot{{x}}" in both
    assert both.startswith("\\begin{aligned}\n\\ddot{x} &= ")
    assert both.endswith("\n\\end{aligned}")
    with pytest.raises(InputError, match="uncertainty must be one of none, brackets, plus-minus, got 'sd'"):
        eq.to_latex("sd")
