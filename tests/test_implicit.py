"""Equations that hold each other's highest derivatives: the mass matrix on the tape, discoveries, exports."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from studies.implicit import SYSTEMS, cart_pole, double_pendulum

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionaries
from bayeq.errors import InputError
from bayeq.expressions import Evaluator, Expression, Number, Symbol, Tape, number, parse
from bayeq.expressions.implicit import inverse, multiplied, solved
from bayeq.likelihood.layout import Candidates, Layout
from bayeq.states import Roles

TARGETS = ("a1", "a2")


@pytest.mark.parametrize(
    ("text", "which", "rest"),
    [
        ("a2*cos(p-q)", 1, "cos(p-q)"),
        ("-a1/x", 0, "-1/x"),
        ("sin(p)*(a2*x)", 1, "sin(p)*x"),
        ("a1", 0, "1"),
        ("5*(a2*x/(3+p)-a2*x/(2+p))", 1, "5*(x/(3+p)-x/(2+p))"),
    ],
)
def test_a_highest_derivative_is_taken_out_of_a_product(text: str, which: int, rest: str) -> None:
    part = multiplied(parse(text), TARGETS)
    assert part is not None
    assert (part[0], part[1].text) == (which, rest)


@pytest.mark.parametrize("text", ["a1**2", "sin(a1)", "a1*a2", "a1+x", "x/a1", "a1*x-a1*(x+a1)", "a1*x-a2*x"])
def test_terms_that_are_not_proportional_to_one_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="not proportional"):
        multiplied(parse(text), TARGETS)


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_symbolic_inverse_is_the_inverse(n: int) -> None:
    rng = np.random.default_rng(n)
    A = 0.3 * rng.standard_normal((n, n))
    A[rng.random((n, n)) < 0.3] = 0.0
    nodes = [[Number(0) if A[i, j] == 0.0 else Symbol(f"m{i}{j}") for j in range(n)] for i in range(n)]
    values = {f"m{i}{j}": A[i, j] for i in range(n) for j in range(n)}
    evaluate = Evaluator({"x": np.ones(1), **values})
    found = inverse(nodes)
    computed = np.array([[evaluate(Expression(node))[0] for node in row] for row in found])
    np.testing.assert_allclose(computed, np.linalg.inv(np.eye(n) - A), atol=1e-12)
    b = rng.standard_normal(n)
    names = [f"a{j}" for j in range(n)]
    equations = [
        [(number(b[i]), parse("x")), *((nodes[i][j], parse(names[j])) for j in range(n) if A[i, j] != 0.0)]
        for i in range(n)
    ]
    ends = [evaluate(Expression(node))[0] for node in solved(equations, names)[0]]
    np.testing.assert_allclose(ends, np.linalg.solve(np.eye(n) - A, b), atol=1e-12)


def test_targets_of_the_tape_solve_the_equations() -> None:
    """a1 = 2 x + .5 a2 cos(x), a2 = -y + .3 a1: as a linear system solved by NumPy at a point."""
    roles = Roles.parse(["x:v:a1", "y:w:a2"])
    terms = tuple(parse(text) for text in ("x", "y", "a2*cos(x)", "a1"))
    layout = Layout(roles, terms, (np.ones(3), np.ones(3)))
    chosen = Candidates(np.array([0, 0, 1, 1]), np.array([0, 2, 1, 3]))
    theta = [2.0, 0.5, -1.0, 0.3]
    tape: Tape = layout.tape(chosen)
    x, y = 0.7, -0.4
    states = {"x": x, "v": 0.1, "y": y, "w": 0.2, "d[0]": 0.0, "d[1]": 0.0}
    values = [*(states[name] for name in layout.names), *theta]
    out = tape(values)
    mass = np.array([[1.0, -0.5 * np.cos(x)], [-0.3, 1.0]])
    expected = np.linalg.solve(mass, [2.0 * x, -y])
    first = layout.size
    np.testing.assert_allclose(out[first : first + 2], expected, rtol=1e-12)
    np.testing.assert_allclose(out[first + 2 + 4 : first + 2 + 6], expected, rtol=1e-12)
    np.testing.assert_allclose(out[-4:].reshape(2, 2), np.linalg.inv(mass), rtol=1e-12)


def test_no_equation_has_its_own_highest_derivative() -> None:
    variables = Variables(("x", "v", "y", "w"), (), (("x", "v"), ("y", "w")), targets=TARGETS)
    terms, allowed = build_dictionaries("x, a1*cos(x), a2*cos(x)", TARGETS, variables)
    assert [term.text for term in terms] == ["x", "a1*cos(x)", "a2*cos(x)"]
    assert allowed.tolist() == [[True, False, True], [True, True, False]]
    one = Variables(("x", "v"), (), (("x", "v"),), targets=("a",))
    with pytest.raises(InputError, match="both sides"):
        build_dictionaries("x, a*x", ("a",), one)
    with pytest.raises(InputError, match="only be a factor"):
        build_dictionaries("x, a1**2", TARGETS, variables)


@pytest.fixture(scope="module")
def pendulum() -> tuple[bq.Equations, dict[str, dict[str, float]]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("studies.implicit.ROWS", 800)
        record, truth = double_pendulum(0.01, 7001)
    return bq.discover(record, **SYSTEMS["double pendulum"][1]), truth


def test_a_double_pendulum_is_found_from_its_angles(
    pendulum: tuple[bq.Equations, dict[str, dict[str, float]]],
) -> None:
    """Truth: Lagrange's equations of two point masses, which `studies.implicit` integrates by a solver of its own."""
    eqs, truth = pendulum
    assert eqs.verdict.kind == "found"
    for eq in eqs:
        assert set(eq.shown) == set(truth[eq.target])
        for name, value in truth[eq.target].items():
            low, high = eq.shown_ci95[list(eq.posterior.names).index(name)]
            assert low - (high - low) < value < high + (high - low)


def test_exports_and_saved_files_solve_for_the_accelerations(
    pendulum: tuple[bq.Equations, dict[str, dict[str, float]]], tmp_path
) -> None:
    eqs, _ = pendulum
    y = np.array([0.5, 1.0, -0.3, 0.2])
    p, dp, q, dq = y.tolist()
    one, two = (eq.shown_coef for eq in eqs)
    mass = np.array([[1.0, -one["ddq*cos(p-q)"] * np.cos(p - q)], [-two["ddp*cos(p-q)"] * np.cos(p - q), 1.0]])
    side = [
        one["sin(p)"] * np.sin(p) + one["dq**2*sin(p-q)"] * dq**2 * np.sin(p - q),
        two["sin(q)"] * np.sin(q) + two["dp**2*sin(p-q)"] * dp**2 * np.sin(p - q),
    ]
    ddp, ddq = np.linalg.solve(mass, side)
    expected = [dp, ddp, dq, ddq]
    np.testing.assert_allclose(eqs.to_callable()(0.0, y), expected, rtol=1e-9)
    np.testing.assert_allclose(eqs.rhs(0.0, y), expected, rtol=1e-9)
    scope: dict[str, object] = {}
    exec(eqs.to_code("python"), scope)  # noqa: S102 - the code is what the test is about
    np.testing.assert_allclose(scope["rhs"](0.0, y.tolist()), expected, rtol=1e-9)  # type: ignore[operator]
    for latex in (eqs.to_latex(), eqs.to_dict()["equations"][0]["latex"], eqs.to_latex("brackets")):
        assert r"\ddot{q} \cos" in latex
        assert r"\dot{q}^{2}" in latex
        assert r"\,-" not in latex
    eqs.save(tmp_path / "found.json")
    again = bq.load(tmp_path / "found.json")
    assert str(again) == str(eqs)
    np.testing.assert_allclose(again.to_callable()(0.0, y), expected, rtol=1e-9)


def test_a_cart_with_a_pole_is_found_under_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.implicit.ROWS", 800)
    record, truth = cart_pole(0.01, 7000)
    eqs = bq.discover(record, **SYSTEMS["cart-pole"][1])
    assert {eq.target: set(eq.shown) for eq in eqs} == {target: set(own) for target, own in truth.items()}


def test_dry_friction_beside_another_s_acceleration() -> None:
    """Whether friction holds a body depends on what the other's acceleration does to it."""
    rng, t = np.random.default_rng(3), np.arange(600) * 0.01
    w, phase = rng.uniform(2.0, 15.0, 8), rng.uniform(0.0, 6.0, 8)
    mass = np.linalg.inv([[1.0, -0.4], [-0.5, 1.0]])

    def push(s):
        return 10.0 * np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1) / 2.0

    def rate(s, state):
        x, dx, y, dy = state
        return [dx, dy, *(mass @ [push(s) - 40.0 * x - 3.0 * np.tanh(dx / 1e-3), -90.0 * y - 0.8 * dy])]

    def ordered(s, state):
        dx, dy, ddx, ddy = rate(s, state)
        return [dx, ddx, dy, ddy]

    states = solve_ivp(ordered, (0.0, t[-1]), [0.1, 0.0, 0.1, 0.0], t_eval=t, rtol=1e-6, atol=1e-8, method="LSODA").y
    channels = {"x": states[0], "y": states[2], "u": push(t)}
    noisy = {name: one + 0.005 * one.std() * rng.standard_normal(600) for name, one in channels.items()}
    record = bq.Record.from_arrays(noisy, time=t)
    dictionary = {"ddx": "x, dx, u, sign(dx), ddy", "ddy": "y, dy, u, sign(dy), ddx"}
    eq = bq.discover(record, chains=["x::", "y::"], inputs=["u"], dictionary=dictionary)
    assert set(eq["ddx"].included) == {"x", "u", "sign(dx)", "ddy"}
    assert set(eq["ddy"].included) == {"y", "dy", "ddx"}
    assert eq["ddx"].shown_coef["sign(dx)"] == pytest.approx(-3.0, rel=0.1)


def test_a_constant_beside_another_s_highest_derivative_is_found() -> None:
    """dx = u - 2 x - .8 dy/(K + x**2), dy = -y + .6 dx, with K = 1.5."""
    rng, t = np.random.default_rng(5), np.arange(400) * 0.02
    w, phase = rng.uniform(1.0, 9.0, 6), rng.uniform(0.0, 6.0, 6)

    def push(s):
        return np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1)

    def rate(s, state):
        x, y = state
        near = 0.8 / (1.5 + x**2)
        return np.linalg.solve([[1.0, near], [-0.6, 1.0]], [push(s) - 2.0 * x, -y])

    states = solve_ivp(rate, (0.0, t[-1]), [1.0, 0.5], t_eval=t, rtol=1e-8, atol=1e-10).y
    channels = {"x": states[0], "y": states[1], "u": push(t)}
    noisy = {name: one + 0.002 * one.std() * rng.standard_normal(400) for name, one in channels.items()}
    record = bq.Record.from_arrays(noisy, time=t)
    dictionary = {"dx": "x, u, dy/({K}+x**2)", "dy": "y, dx"}
    eq = bq.discover(record, chains=["x", "y"], inputs=["u"], dictionary=dictionary)
    assert [one.shown for one in eq] == [("x", "u", "dy/({K}+x**2)"), ("y", "dx")]
    low, high = eq.constants[0].ci95
    assert low < 1.5 < high


def test_equations_that_say_the_same_are_not_determined() -> None:
    """Two sensors on one mass: a1 = a2 and a2 = a1, which no motion tells apart from any other pair of equations."""
    once = bq.simulate("duffing", n=600, seed=3)
    rng = np.random.default_rng(0)
    channels = {
        f"{name}{k}": once[name] + 0.01 * once[name].std() * rng.standard_normal(once.n)
        for name in "xva"
        for k in (1, 2)
    }
    record = bq.Record({**channels, "u": once["u"]}, time=once.time)
    question = {"chains": ["x1:v1:a1", "x2:v2:a2"], "inputs": ["u"], "dictionary": "x1, v1, u, a1, a2"}
    with pytest.warns(UserWarning, match="simpler one"):
        eqs = bq.discover(record, **question)
    assert str(eqs.verdict) == "not determined: the equations for a1 and a2 say the same; offer a1 no a2"
