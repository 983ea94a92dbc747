"""Mass, damping, stiffness and modal parameters from coefficients."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.equation.brief import brief
from bayeq.equation.physical import own_parameters, physical_parameters, system_parameters
from bayeq.errors import InputError, UnknownNameError
from bayeq.expressions import parse
from bayeq.forecast.dynamics import Law
from bayeq.inference.posterior import Constant, Details, Posterior
from bayeq.states import parse_chain
from tests.draws import draws

TERMS = ("x", "v", "x**3", "u")
DUFFING = {"x": -500.0, "v": -1.0, "x**3": -5e4, "u": 0.5}  # m = 2 kg, c = 2 N s/m, k = 1000 N/m, k3 = 1e5 N/m^3
ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
SI = {"x": "m", "v": "m/s", "a": "m/s^2", "u": "N"}


def posterior(coef, relative=1e-3, correlation=0.0, names=None):
    """A posterior in which all terms are included."""
    names = tuple(names or coef)
    mean = np.array([coef[name] for name in coef])
    sd = relative * np.abs(mean)
    covariance = np.outer(sd, sd) * (correlation + (1 - correlation) * np.eye(len(mean)))
    return Posterior(
        names=names, pip=np.ones(len(mean)), support=np.ones(len(mean), dtype=bool), coef=mean,
        covariance=covariance, constant=Constant(np.zeros(len(mean))), noise_variance=1.0, n=100.0,
        details=Details("vb"),
    )  # fmt: skip


def parameters(
    coef=DUFFING, *, chain="x:v:a", inputs=("u",), units=SI, gains=(), relative=1e-3, correlation=0.0, **options
):
    terms = [parse(name) for name in coef]
    law = Law(parse_chain(chain), terms, posterior(coef, relative, correlation), gains)
    return physical_parameters(law, inputs, units, **options)


def test_parameters_of_the_duffing_oscillator():
    found = parameters(relative=1e-6)
    expected = {"m": 2.0, "c": 2.0, "k": 1000.0, "k3": 1e5, "omega_n": math.sqrt(500.0)}
    expected |= {"f_n": math.sqrt(500.0) / (2 * math.pi), "zeta": 2.0 / (2 * math.sqrt(1000.0 * 2.0))}
    assert {q.symbol for q in found} == set(expected)
    for symbol, value in expected.items():
        assert found[symbol].mean == pytest.approx(value, rel=1e-5)
        assert found[symbol].low < value < found[symbol].high
    units = {"m": "kg", "c": "N*s/m", "k": "N/m", "k3": "N/m^3", "omega_n": "rad/s", "f_n": "Hz", "zeta": ""}
    assert {q.symbol: q.unit for q in found} == units
    assert list(found.table()["symbol"]) == [q.symbol for q in found]
    assert "natural frequency" in str(found)
    assert found.unexplained == ()


@pytest.mark.parametrize("x0", [0.2, -3.0])
def test_about_the_position_of_rest_parameters_are_those_of_motion_from_there(x0):
    # -k xi - k2 xi^2 - k3 xi^3 - (c + d xi) v with xi = x - x0, written in powers of x
    k, k2, k3, c, d = 900.0, 300.0, 2e3, 1.5, 4.0
    xi = np.polynomial.Polynomial([-x0, 1.0])
    spring = -(k * xi + k2 * xi**2 + k3 * xi**3)
    coef = {"x": spring.coef[1], "x**2": spring.coef[2], "x**3": spring.coef[3], "v": -(c - d * x0), "x*v": -d}
    # an intercept without error
    law = Law(
        parse_chain("x:v:a"),
        [parse(name) for name in coef],
        replace(posterior(coef, 1e-9), constant=Constant(np.zeros(5), float(spring.coef[0])), n=1e30),
    )
    found = physical_parameters(law, (), {"x": "m"}, span=(x0 - 0.1, x0 + 0.12))
    expected = {"k/m": k, "k2/m": k2, "k3/m": k3, "c/m": c, "x0": x0, "omega_n": math.sqrt(k)}
    for symbol, value in expected.items():
        assert found[symbol].mean == pytest.approx(value, rel=1e-5)
    assert found["x0"].unit == "m"
    assert found.unexplained == ("x*v",)


@pytest.mark.parametrize(("sign", "rest"), [(-1.0, 0.0), (1.0, math.pi)])
def test_a_pendulum_has_the_stiffness_of_small_motion(sign, rest):
    coef = {"sin(x)": sign * 9.81, "v": -0.1}
    law = Law(parse_chain("x:v:a"), [parse(name) for name in coef], replace(posterior(coef, 1e-6), n=1e30))
    found = physical_parameters(law, (), {"x": "rad"}, span=(rest - 0.5, rest + 0.4))
    assert found["k/m"].mean == pytest.approx(9.81, rel=1e-5)
    assert found["omega_n"].mean == pytest.approx(math.sqrt(9.81), rel=1e-5)
    assert found["x0"].mean == pytest.approx(rest, abs=1e-5)
    assert found.unexplained == ("sin(x)",)


@pytest.mark.parametrize(("pip", "said"), [(1.0, ""), (0.8, ", in doubt")])
def test_a_stiffness_is_in_doubt_if_its_terms_are(pip, said):
    coef = {"x": 0.0, "sin(x)": -9.81, "v": -0.1}
    kept = {"covariance": 1e-12 * np.eye(2), "support": np.array([False, True, True])}
    drawn = replace(posterior(coef, 1e-6), pip=np.array([0.01, pip, 1.0]), **kept)
    law = Law(parse_chain("x:v:a"), [parse(name) for name in coef], drawn)
    found = physical_parameters(law, (), {"x": "rad"}, span=(-0.5, 0.4))
    assert found["k/m"].meaning == f"stiffness per unit of inertia{said}"


@pytest.mark.parametrize(("moment", "span"), [(0.0, (-1200.0, 1900.0)), (3.0, (-300.0, 1500.0))])
def test_a_pendulum_that_turns_over_rests_next_to_zero(moment, span):
    coef = {"sin(pi*x/180)": -900.0, "v": -0.4}
    constant = Constant(np.zeros(2), 900.0 * math.sin(math.radians(moment)))
    drawn = replace(posterior(coef, 1e-6), constant=constant, n=1e30)
    law = Law(parse_chain("x:v:a"), [parse(name) for name in coef], drawn)
    found = physical_parameters(law, (), {"x": "deg"}, span=span)
    assert found["x0"].mean == pytest.approx(math.radians(moment), abs=1e-5)


def test_where_nothing_rests_that_is_said():
    coef = {"x": 5.0, "v": -0.1}
    law = Law(parse_chain("x:v:a"), [parse(name) for name in coef], posterior(coef, 1e-6))
    with pytest.raises(InputError, match=r"no certain position of rest near the record's range of x, 1 to 2"):
        physical_parameters(law, (), {}, span=(1.0, 2.0))


def test_a_stand_off_of_the_displacement_leaves_the_stiffness():
    record = bq.simulate("duffing", n=1000, seed=3)
    truth = 1000.0
    displaced = record.with_channels({"x": record["x"] + 0.2}, {"x": "m"})
    with pytest.warns() as caught:
        eq = bq.discover(displaced, **ROLES, dictionary="x, v, x**2, x**3, x*v, v*abs(v), u")
    assert any("nowhere zero" in str(one.message) and "--remove-offset x" in str(one.message) for one in caught)
    found = eq.physical()
    assert found["k"].low - 10.0 < truth < found["k"].high + 10.0
    assert found["x0"].mean == pytest.approx(0.2, abs=2e-3)
    there = bq.remove_offset(displaced, "x")
    assert there["x"].mean() == pytest.approx(0.0, abs=1e-12)
    assert there.units["x"] == "m"


@pytest.mark.parametrize("dictionary", ["x, v, x**2, x**3, u", pytest.param("oscillator", marks=pytest.mark.slow)])
def test_far_from_zero_nothing_is_made_up(dictionary):
    record = bq.simulate("duffing", n=500, seed=5)
    displaced = record.with_channels({"x": record["x"] + 10.0})
    with pytest.warns():
        eq = bq.discover(displaced, **ROLES, dictionary=dictionary)
    assert eq.verdict.kind == "not determined"
    with pytest.raises(InputError, match=r"cannot be told.*remove_offset"):
        eq.physical()


def test_spreads_are_those_of_the_delta_method():
    relative, correlation = 2e-3, 0.6
    found = parameters(relative=relative, correlation=correlation, draws=100_000)
    mean = np.array(list(DUFFING.values()))
    covariance = posterior(DUFFING, relative, correlation).covariance
    functions = {
        "m": lambda t: 1 / t[3],
        "c": lambda t: -t[1] / t[3],
        "k": lambda t: -t[0] / t[3],
        "k3": lambda t: -t[2] / t[3],
        "omega_n": lambda t: math.sqrt(-t[0]),
        "zeta": lambda t: -t[1] / (2 * math.sqrt(-t[0])),
    }
    for symbol, f in functions.items():
        steps = 1e-6 * np.abs(mean) * np.eye(4)
        gradient = np.array([(f(mean + h) - f(mean - h)) / (2 * h.sum()) for h in steps])
        sd = math.sqrt(gradient @ covariance @ gradient)
        q = found[symbol]
        # of 100,000 draws: standard deviations to 0.3 %, quantiles to 1 % of a standard deviation
        assert q.sd == pytest.approx(sd, rel=0.02)
        assert q.low == pytest.approx(f(mean) - 1.96 * sd, abs=0.05 * sd)
        assert q.high == pytest.approx(f(mean) + 1.96 * sd, abs=0.05 * sd)


@settings(max_examples=draws(25), deadline=None)
@given(
    st.sampled_from([("m", 1.0), ("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254)]),
    st.sampled_from([("m/s", 1.0), ("mm/s", 1e-3)]),
    st.sampled_from([("m/s^2", 1.0), ("g", 9.80665)]),
    st.sampled_from([("N", 1.0), ("kN", 1e3)]),
)
def test_parameters_do_not_depend_on_the_units_of_channels(x, v, a, u):
    sizes = {"x": x[1], "v": v[1], "u": u[1]}
    # a channel's number is the quantity over the size of its unit
    coef = {
        "x": DUFFING["x"] * sizes["x"] / a[1],
        "v": DUFFING["v"] * sizes["v"] / a[1],
        "x**3": DUFFING["x**3"] * sizes["x"] ** 3 / a[1],
        "u": DUFFING["u"] * sizes["u"] / a[1],
    }
    found = parameters(coef, units={"x": x[0], "v": v[0], "a": a[0], "u": u[0]})
    for q, twin in zip(found, parameters(), strict=True):
        assert (q.symbol, q.unit) == (twin.symbol, twin.unit)
        np.testing.assert_allclose([q.mean, q.sd, q.low, q.high], [twin.mean, twin.sd, twin.low, twin.high], rtol=1e-9)


def test_without_a_force_parameters_are_per_unit_of_mass():
    coef = {name: DUFFING[name] for name in ("x", "v", "x**3")}
    found = parameters(coef, inputs=())
    assert [q.symbol for q in found] == ["omega_n", "f_n", "zeta", "c/m", "k/m", "k3/m"]
    assert found["k/m"].mean == pytest.approx(500.0, rel=1e-3)
    assert found["k/m"].unit == "1/s^2"
    known = parameters(coef, inputs=(), mass=2.0)
    assert known["k"].mean == pytest.approx(1000.0, rel=1e-3)
    assert (known["m"].mean, known["m"].sd, known["m"].unit) == (2.0, 0.0, "kg")
    assert known["k"].unit == "N/m"


def test_units_that_are_not_known_are_left_out():
    found = parameters(units={})
    assert found["k"].unit is None
    assert found["k"].mean == pytest.approx(1000.0, rel=1e-3)
    assert parameters(units={"x": "m"})["k"].unit is None
    # an angle: a moment of inertia
    angle = parameters(units={"x": "rad", "v": "rad/s", "a": "rad/s^2", "u": "N*m"})
    assert (angle["m"].unit, angle["k"].unit) == ("kg*m^2", "N*m")


def test_friction_and_other_terms():
    coef = {"x": -500.0, "sign(v)": -0.3, "abs(v)*v": -0.2, "x**2*v": 4.0, "u": 0.5}
    found = parameters(coef)
    assert found["Fc"].mean == pytest.approx(0.6, rel=1e-3)
    assert found["Fc"].unit == "N"
    assert found["c2"].mean == pytest.approx(0.4, rel=1e-3)
    assert found["c2"].unit == "N*s^2/m^2"
    assert found.unexplained == ("x**2*v",)
    assert "also in the equation: x**2*v" in str(found)
    assert "zeta" not in {q.symbol for q in found}  # there is no viscous damping


def test_what_does_not_oscillate_has_no_frequency():
    found = parameters({"x": 500.0, "x**3": -5e4, "v": -1.0, "u": 0.5})
    assert {"omega_n", "f_n", "zeta"} & {q.symbol for q in found} == set()
    assert found["k"].mean == pytest.approx(-1000.0, rel=1e-3)


def test_a_force_against_the_motion_tells_no_mass_and_hides_no_frequency():
    found = parameters({**DUFFING, "u": -0.5})
    assert "m" not in {q.symbol for q in found}
    assert found["omega_n"].mean == pytest.approx(math.sqrt(500.0), rel=1e-3)
    assert found.unexplained == ("u",)


def test_a_load_of_a_drive_without_stiffness_hides_no_mass():
    law = Law(parse_chain("x:v:a"), [parse("v"), parse("u")], posterior({"v": -2.0, "u": 0.5}), ())
    lifted = replace(law.posterior, constant=Constant(np.zeros(2), -9.81, pip=1.0))
    found = physical_parameters(law._replace(posterior=lifted), ("u",), SI, span=(-1.0, 0.0))
    assert found["m"].mean == pytest.approx(2.0, rel=1e-3)
    assert found["c"].mean == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize(
    ("coef", "options", "message"),
    [
        ({"x*v": -1.0, "u": 0.5}, {}, "neither a restoring term"),
        (DUFFING, {"mass": -1.0}, "mass must be positive"),
        (DUFFING, {"mass": math.inf}, "mass must be positive"),
        (DUFFING, {"draws": 10}, "at least 100"),
        (DUFFING, {"draws": 1e4}, "whole number"),
        ({**DUFFING, "u": -0.5}, {"force": "u"}, "not positive with any certainty"),
        (DUFFING, {"force": "w"}, "w"),
        (DUFFING, {"chain": "x"}, "second-order"),
        (DUFFING, {"units": {**SI, "v": "m"}}, "no derivative"),
        ({"x": -1.0}, {"force": "u"}, "u is not in the equation"),
    ],
)
def test_what_cannot_be_told(coef, options, message):
    with pytest.raises(InputError, match=message):
        parameters(coef, **options)


def test_from_a_record():
    record = bq.simulate("duffing", n=2000, seed=3)
    eq = bq.discover(record, chains=["x:v:a"], inputs=["u"])
    found = eq.physical()
    truth = {"m": 1.0, "c": 2.0, "k": 1000.0, "k3": 1e5}
    for symbol, value in truth.items():
        assert abs(found[symbol].mean - value) < 4 * found[symbol].sd
    assert eq.physical(mass=1.0, seed=1)["k"].mean == pytest.approx(-eq[0].coef["x"], rel=1e-3)
    assert eq.physical(target="a")["k"] == found["k"]
    with pytest.raises(UnknownNameError, match="b"):
        eq.physical(target="b")
    with pytest.raises(UnknownNameError, match="parameter"):
        found["q"]


@pytest.mark.filterwarnings("ignore:.*no equation:bayeq.errors.DataWarning")  # the rows are no motion
def test_equations_without_or_with_several_of_second_order():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2))
    flow = bq.Record.from_arrays(x=x[:, 0], dx=-x[:, 0] + 0.01 * x[:, 1], fs=10.0)
    first = bq.discover(flow, chains=["x:dx"], dictionary=["x", "x**2"], smooth="none")
    assert first.physical()["tau[x]"].mean == pytest.approx(1.0, rel=0.01)
    with pytest.raises(InputError, match="second-order"):
        first.physical(target="dx")
    a, b = (-(k**2) * x[:, 0] - 0.1 * x[:, 1] + 0.01 * rng.normal(size=200) for k in (3.0, 4.0))
    two = bq.Record.from_arrays(x=x[:, 0], v=x[:, 1], a=a, y=x[:, 0], w=x[:, 1], b=b, fs=10.0)
    both = bq.discover(two, chains=["x:v:a", "y:w:b"], dictionary=["x", "v"], smooth="none")
    found = both.physical()
    assert found.modes[0].frequency.mean == pytest.approx(3.0 / math.tau, rel=0.01)  # y is a copy of x: one mode
    with pytest.raises(InputError, match="name one of the equations as target: a, b"):
        both.physical(mass=1.0)
    assert both.physical(target="a")["omega_n"].mean == pytest.approx(3.0, rel=0.01)


@pytest.mark.filterwarnings("ignore:.*no equation:bayeq.errors.DataWarning")  # the rows are no motion
@pytest.mark.parametrize(("unit", "mass"), [("N", True), ("", True), ("mm", False), ("deg", False), ("m/s^2", False)])
def test_what_moves_a_base_is_no_force(unit, mass):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(300, 5))
    u, *states = x.T
    a, b = -9.0 * states[0] - 0.1 * states[2] + 2.0 * states[1] + 5.0 * u, 4.0 * states[0] - 16.0 * states[1]
    channels = dict(zip(("x", "y", "v", "w"), states, strict=True)) | {"a": a, "b": b - 0.1 * states[3], "u": u}
    noisy = {name: one + 0.01 * rng.normal(size=300) for name, one in channels.items()}
    record = bq.Record.from_arrays(noisy, fs=10.0, units={"u": unit} if unit else {})
    dictionary = {"a": "x, y, v, u", "b": "x, y, w"}
    asked = {"dictionary": dictionary, "smooth": "none", "noise": {"u": 0.01}}
    both = bq.discover(record, chains=["x:v:a", "y:w:b"], inputs=["u"], **asked)
    assert ("m_1" in {one.symbol for one in both.physical()}) == mass


def test_an_angle_from_the_upright_position_is_no_stand_off():
    n = 1500
    rng, angle, rate, angles = np.random.default_rng(4), math.pi - 1.0, 0.0, []
    for _ in range(n):
        angles.append((angle, rate))
        for _ in range(10):
            rate += 5e-4 * (9.81 * math.sin(angle) - 0.05 * rate)
            angle += 5e-4 * rate
    th, om = np.array(angles).T
    record = bq.Record.from_arrays(th=th + 0.01 * rng.normal(size=n), om=om + 0.01 * rng.normal(size=n), fs=200.0)
    eq = bq.discover(record, chains="th:om:", dictionary="sin(th), om, om*abs(om)")
    assert not any("nowhere zero" in message for message in eq.warnings)
    found = eq.physical()
    assert found["k/m"].low < 9.81 < found["k/m"].high
    assert found["x0"].mean == pytest.approx(math.pi, abs=0.01)


def two_masses():
    """Two masses on springs, the first driven; matrices M, C, K and the record."""
    M, C = np.diag([1.5, 0.8]), np.array([[2.1, -0.9], [-0.9, 0.9]])
    K = np.array([[4800.0, -1800.0], [-1800.0, 1800.0]])
    rng, n, fine, fs = np.random.default_rng(0), 1200, 10, 200.0
    force = np.convolve(rng.standard_normal(n * fine), np.hanning(60), "same") * 20.0
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    b = np.array([0.0, 0.0, 1.0 / 1.5, 0.0])
    # the exact step of a force that is straight between samples: exp of the augmented matrix
    h = 1.0 / (fs * fine)
    whole = np.zeros((6, 6))
    whole[:4, :4], whole[:4, 4], whole[4, 5] = A, b, 1.0
    step = sum(np.linalg.matrix_power(whole * h, k) / math.factorial(k) for k in range(12))
    state, states = np.zeros(4), np.zeros((n * fine, 4))
    for k in range(1, n * fine):
        state = step[:4, :4] @ state + step[:4, 4] * force[k - 1] + step[:4, 5] * (force[k] - force[k - 1]) / h
        states[k] = state
    channels = {"x1": states[:, 0], "x2": states[:, 1], "u": force}
    noisy = {name: x[::fine] + 0.01 * x.std() * rng.standard_normal(n) for name, x in channels.items()}
    return M, C, K, bq.Record.from_arrays(noisy, fs=fs, units={"x1": "m", "x2": "m", "u": "N"})


def test_modes_of_two_masses_against_an_eigenvalue_solver():
    M, C, K, record = two_masses()
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    values, vectors = np.linalg.eig(A)
    order = [k for k in np.argsort(np.abs(values)) if values[k].imag > 0.0]
    eq = bq.discover(record, chains=["x1::", "x2::"], inputs=["u"], dictionary="polynomial:1")
    found = eq.physical()
    for mode, k in zip(found.modes, order, strict=True):
        frequency, ratio = abs(values[k]) / math.tau, -values[k].real / abs(values[k])
        assert abs(mode.frequency.mean - frequency) < 4.0 * mode.frequency.sd
        assert abs(mode.damping_ratio.mean - ratio) < 4.0 * mode.damping_ratio.sd
        shape = (vectors[:2, k] / vectors[np.argmax(np.abs(vectors[:2, k])), k]).real
        np.testing.assert_allclose(list(mode.shape.values()), shape, atol=0.02)
    # 5.07 and 10.6 Hz; of each mass with the other held still they would be 9.0 and 7.5
    assert [round(mode.frequency.mean, 1) for mode in found.modes] == [5.1, 10.6]
    for symbol, value in {"m_1": 1.5, "m_2": 0.8, "k_11": 4800.0, "k_12": -1800.0, "k_22": 1800.0}.items():
        assert abs(found[symbol].mean - value) < 4.0 * found[symbol].sd
    assert (found["m_1"].unit, found["k_12"].unit, found["c_11"].unit) == ("kg", "N/m", "N*s/m")
    told = eq.to_dict()
    assert [one["frequency"] for one in told["modes"]] == pytest.approx([5.07, 10.6], rel=0.01)
    assert {one["name"] for one in told["parameters"]} >= {"f_1", "zeta_2", "m_1", "k_12", "c_22"}


def test_a_stage_without_stiffness_and_a_time_constant():
    found = parameters({"v": -3.2, "sign(v)": -1.2, "u": 0.4})
    assert found["m"].mean == pytest.approx(2.5, rel=1e-3)
    assert found["c"].mean == pytest.approx(8.0, rel=1e-3)
    assert found["Fc"].mean == pytest.approx(3.0, rel=1e-3)
    assert not found.modes
    rng, n = np.random.default_rng(0), 600
    power, temperature = np.repeat(rng.uniform(0.0, 5.0, 12), 50), np.full(n, 20.0)
    for k in range(n - 1):  # the exact step of a held power
        temperature[k + 1] = (
            20.0 + (temperature[k] - 20.0) * math.exp(-1 / 40) + 12.0 * power[k] * (1 - math.exp(-1 / 40))
        )
    record = bq.Record.from_arrays({"T": temperature + 0.05 * rng.normal(size=n), "P": power}, fs=1.0)
    heated = bq.discover(record, chains="T", inputs=["P"], dictionary="polynomial:2").physical()
    assert abs(heated["tau[T]"].mean - 40.0) < 4.0 * heated["tau[T]"].sd
    assert abs(heated["gain[T, P]"].mean - 12.0) < 4.0 * heated["gain[T, P]"].sd


def quarter_car(tyre="w-s", **more):
    """Laws of the wheel and the body of a car on a road s, with a tyre of 4500 /s^2, and the modes of small motion."""
    both = {"w": ("w:dw:ddw", {"w-b": -450.0, "dw-db": -27.5, tyre: -4500.0, **more}), "b": ("b:db:ddb", {})}
    both["b"] = ("b:db:ddb", {"w-b": 62.07, "dw-db": 3.79})
    laws = [
        Law(parse_chain(chain), [parse(name) for name in coef], replace(posterior(coef, 1e-6), n=1e30))
        for chain, coef in both.values()
    ]
    A = np.zeros((4, 4))
    A[:2, 2:], A[2:, 0::2], A[2:, 1::2] = np.eye(2), [[-4950.0, -27.5], [62.07, 3.79]], [[450.0, 27.5], [-62.07, -3.79]]
    values = np.linalg.eigvals(A)
    return laws, sorted((abs(one) / math.tau, -one.real / abs(one)) for one in values if one.imag > 0.0)


@pytest.mark.parametrize("tyre", ["w-s", "w-s**2", "(2*w-s)/2", "sin(w)"])
def test_modes_know_of_states_in_terms_that_hold_an_input_too(tyre):
    laws, expected = quarter_car(tyre)
    found = system_parameters(laws, ["s"], {}, draws=400, seed=0)
    modes = [(mode.frequency.mean, mode.damping_ratio.mean) for mode in found.modes]
    np.testing.assert_allclose(modes, expected, rtol=1e-4)
    assert found.unexplained == (("sin(w)",) if tyre == "sin(w)" else ())
    assert not found.note


@pytest.mark.parametrize("mixed", ["w*s", "(w-s)**3", "t*w", "ddb*cos(w)"])
def test_there_are_no_modes_where_they_depend_on_an_input(mixed):
    laws, _ = quarter_car(**{mixed: -1.0})
    found = system_parameters(laws, ["s"], {}, draws=400, seed=0)
    assert not found.modes
    assert mixed in found.unexplained
    assert str(found).splitlines()[-1].startswith("no modes: ")
    assert mixed in found.note


def test_an_oscillator_on_a_moving_base_has_the_stiffness_of_the_difference():
    found = parameters({"x-w": -500.0, "v": -1.0, "u": 0.5}, inputs=("u", "w"))
    assert found["k"].mean == pytest.approx(1000.0, rel=1e-3)
    assert found["f_n"].mean == pytest.approx(math.sqrt(500.0) / math.tau, rel=1e-3)
    assert found.unexplained == ("x-w",)


def test_a_frequency_names_what_it_leaves_out():
    found = parameters({**DUFFING, "x*w": 3.0}, inputs=("u", "w"))
    assert found["f_n"].meaning == "natural frequency without x*w"
    assert found["k"].meaning == "stiffness"
    assert not found.modes
    assert parameters(without=["r"])["zeta"].meaning == "damping ratio without r"


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_intervals_given_terms_that_are_not_determined_are_not_printed():
    record = bq.simulate("duffing", n=400, seed=1, noise=0.2)
    eq = bq.discover(record, **ROLES, dictionary="x, v, x**3, x**5, u")
    assert eq.verdict.kind == "not determined"
    assert eq[0].printed_over_models[eq[0].posterior.names.index("x")]
    assert eq.physical()["m"].sd > 0.0  # where it is asked for
    assert eq.to_dict()["parameters"] == []
    assert "natural frequency" not in brief(eq)


def test_the_inertia_of_a_shaft_is_none_of_a_mass():
    record = bq.simulate("linear", n=400, seed=2, noise=0.01)
    units = {"x": "deg", "v": "deg/s", "a": "deg/s^2", "u": "N*m"}
    turning = bq.Record.from_arrays({name: record[name] for name in "xvau"}, time=record.time, units=units)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        eq = bq.discover(turning, chains="x:v:a", inputs="u", dictionary="x, v, u")
    meanings = {one.symbol: one.meaning for one in eq.physical()}
    assert meanings["m"] == "moment of inertia"
    by_current = replace(eq, equations=tuple(replace(one, units={**one.units, "u": "mA"}) for one in eq.equations))
    assert {one.symbol for one in by_current.physical()} >= {"k/m", "c/m"}
    assert "m" not in {one.symbol for one in by_current.physical()}


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_where_terms_are_in_doubt_intervals_of_parameters_are_those_over_models():
    names = ("x", "v*abs(v)", "v**3", "u")
    coef = {"x": -500.0, "v*abs(v)": -50.0, "v**3": 8.0, "u": 0.5}
    p = replace(posterior(coef, names=names), pip=np.array([1.0, 1.0, 0.6, 1.0]))
    ends = np.full((4, 2), np.nan)
    ends[1] = -55.0, -20.0  # in other models without v**3
    law = Law(parse_chain("x:v:a"), tuple(parse(name) for name in names), p)
    certain, doubtful = (physical_parameters(one, ["u"], SI) for one in (law, law._replace(over_models=ends)))
    low, high = doubtful["c2"].low, doubtful["c2"].high
    assert (low, high) == pytest.approx((40.0, 110.0), rel=0.04)
    assert (certain["c2"].low, certain["c2"].high) == pytest.approx((100.0, 100.0), rel=0.01)
    for same in ("k", "m", "c3"):
        assert (doubtful[same].low, doubtful[same].high) == pytest.approx((certain[same].low, certain[same].high))
    assert doubtful["c3"].meaning == "cubic damping, in doubt"
    assert doubtful["c2"].meaning == "quadratic damping"


def test_printed_parameters_are_those_of_the_default_draws():
    eq = bq.discover(bq.simulate("duffing", n=800, seed=5), **ROLES)
    assert own_parameters(eq).quantities == eq.physical().quantities


def test_why_there_are_no_parameters_is_said():
    t = np.arange(400) / 50.0
    channels = {"u": np.cos(3.0 * t) + 0.5 * np.cos(7.0 * t), "v": 2.0 * np.sin(3.0 * t) / 3.0 + np.sin(7.0 * t) / 7.0}
    channels |= {"x": 0.1 - 2.0 * np.cos(3.0 * t) / 9.0 - np.cos(7.0 * t) / 49.0, "a": 2.0 * channels["u"]}
    rng = np.random.default_rng(0)
    noisy = {name: c + 0.01 * c.std() * rng.standard_normal(400) for name, c in channels.items()}
    eq = bq.discover(bq.Record.from_arrays(noisy, fs=50.0), **ROLES, dictionary="x, v, u")
    assert eq[0].shown == ("u",)
    assert not own_parameters(eq)
    said = " ".join(brief(eq).split())
    assert "no physical parameters: the equation of a has neither a restoring term (a power of x) nor damping" in said
    assert eq.to_dict()["parameters"] == []
