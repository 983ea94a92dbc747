"""Kinks that no candidate has: springs with stops, simulated by a solver of another kind."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayeq as bq
from bayeq.equation.verdict import Verdict, with_kinks
from bayeq.likelihood.hinges import Kinks

STIFFNESS, DAMPING, FORCE = 210.0, 0.8, 2.7


def record(spring, seed, noise=0.01, force=lambda u: u):
    """Two thousand rows at 200 Hz of a mass on a spring, under a multisine from 0.3 to 6 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(2000) / 200.0
    w, phase = 2.0 * np.pi * rng.uniform(0.3, 6.0, 24), rng.uniform(0.0, 2.0 * np.pi, 24)

    def given(s):
        return FORCE * np.cos(np.multiply.outer(s, w) + phase).sum(axis=-1) / np.sqrt(12.0)

    def acceleration(s, x, v):
        return force(given(s)) - STIFFNESS * x - spring(x) - DAMPING * v

    x, v = solve_ivp(
        lambda s, y: [y[1], acceleration(s, *y)], (0.0, t[-1]), [0, 0], t_eval=t, rtol=1e-8, max_step=5e-3
    ).y
    channels = {"x": x, "v": v, "a": acceleration(t, x, v), "u": given(t)}
    noisy = {name: one + noise * one.std() * rng.standard_normal(len(t)) for name, one in channels.items()}
    return bq.Record.from_arrays(noisy, time=t)


def found(record, dictionary="oscillator"):
    return bq.discover(record, chains="x:v:a", inputs=["u"], dictionary=dictionary)[0]


def stops(x):
    """Stiffer by two fifths beyond 18 mm on either side."""
    return 0.4 * STIFFNESS * (np.maximum(x - 0.018, 0.0) - np.maximum(-x - 0.018, 0.0))


@pytest.mark.parametrize(
    ("spring", "places"), [(stops, 2), (lambda x: 0.3 * STIFFNESS * np.maximum(x - 0.015, 0.0), 1)]
)
def test_stops_are_named_and_offered_they_are_found(spring, places):
    measured = record(spring, 7400)
    first = found(measured)
    # powers fit the spring to within the noise, with another slope at rest: no term of the dictionary has a kink
    assert {"x**3", "x**5"} & set(first.shown)
    assert first.verdict.kind == "nearly true"
    said = str(first.verdict)
    assert "x has a kink near " in said
    offer = re.search(r"offer (max.*)$", said)[1]
    assert offer.count("max(") == places
    again = found(measured, f"x, v, x**3, x**5, v*abs(v), u, {offer}")
    assert again.verdict.kind == "found"
    assert {"x", "v", "u"} < set(again.shown)
    assert len(again.shown) == 3 + places
    low, high = again.shown_model.ci95[list(again.shown_model.terms).index("x")]
    assert low <= -STIFFNESS <= high
    for one in again.constants:
        assert one.value == pytest.approx(0.018 if places == 2 else 0.015, rel=0.05)


@pytest.mark.parametrize(
    "spring",
    [
        lambda x: 0.0 * x,
        lambda x: STIFFNESS * x * (x / 0.05) ** 2,
        lambda x: STIFFNESS * (0.3 * x * np.abs(x) / 0.05 + 0.4 * x * (x / 0.05) ** 2),
        lambda x: STIFFNESS * (0.2 * x**2 / 0.05 + 0.3 * x * (x / 0.05) ** 4),
    ],
)
def test_springs_that_candidates_fit_have_no_kink(spring):
    eq = found(record(spring, 7401))
    assert eq.verdict.kind == "found"


def test_a_knee_of_a_static_law_is_named():
    """A damper's curve that is digressive above 0.3 m/s: x and v of a static law are inputs."""
    rng = np.random.default_rng(7403)
    t = np.arange(1500) / 200.0
    v = 0.5 * np.sin(2.0 * np.pi * 1.3 * t) + 0.4 * np.sin(2.0 * np.pi * 0.47 * t + 1.0)
    force = 900.0 * v - 500.0 * (np.maximum(v - 0.3, 0.0) - np.maximum(-v - 0.3, 0.0))
    noisy = {"v": v + 0.003 * rng.standard_normal(1500), "F": force + 3.0 * rng.standard_normal(1500)}
    measured = bq.Record.from_arrays(noisy, time=t)
    terms = ["v", "v**2", "v**3", "v*abs(v)", "v**5", "sign(v)"]
    eq = bq.discover(measured, target="F", inputs=["v"], dictionary=terms, holdout=0.0)[0]
    assert eq.verdict.kind != "found"
    assert re.search("v has a (kink|function that bends) near", str(eq.verdict))


def test_the_kinks_of_a_circuit_among_coupled_states():
    """Chua's circuit (Matsumoto 1984), whose diode has slopes that change at -1 and 1."""

    def rates(_, state):
        x, y, z = state
        diode = -0.714 * x - 0.2145 * (np.abs(x + 1.0) - np.abs(x - 1.0))
        return [15.6 * (y - x - diode), x - y + z, -28.0 * y]

    t = np.arange(1200) * 0.02
    states = solve_ivp(rates, (0.0, t[-1]), [0.7, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y
    noisy = states + 0.005 * states.std(axis=1)[:, None] * np.random.default_rng(7404).standard_normal(states.shape)
    measured = bq.Record.from_arrays(dict(zip("xyz", noisy, strict=True)), time=t)
    kept = {"chains": ["x", "y", "z"], "holdout": 0.0}
    said = str(bq.discover(measured, dictionary="x, y, z, x**3", **kept)[0].verdict)
    offer = re.search(r"x has a .* near -1 and 1, which no candidate has: offer (max.*)$", said)[1]
    eq = bq.discover(measured, dictionary=f"x, y, z, x**3, {offer}", **kept)[0]
    assert eq.verdict.kind == "found"
    assert [round(one.value, 2) for one in eq.constants] == [1.0, 1.0]
    assert {name: round(float(value), 1) for name, value in eq.shown_coef.items()} == {
        "x": 2.2, "y": 15.6, "max(-x-{g},0)": 6.7, "max(x-{h},0)": -6.7
    }  # fmt: skip


def test_a_clearance_between_two_masses_is_one_of_their_difference():
    rng, t = np.random.default_rng(7405), np.arange(1200) / 200.0
    w, phase = 2.0 * np.pi * rng.uniform(0.3, 6.0, 24), rng.uniform(0.0, 2.0 * np.pi, 24)

    def force(s):
        return np.cos(np.multiply.outer(s, w) + phase).sum(axis=-1)

    def accelerations(s, x1, v1, x2, v2):
        d = x1 - x2
        between = 300.0 * d + 200.0 * (np.maximum(d - 0.008, 0.0) - np.maximum(-d - 0.008, 0.0)) + v1 - v2
        return force(s) - between - 250.0 * x1 - 0.8 * v1, (between - 150.0 * x2 - 0.5 * v2) / 0.7

    def rates(s, y):
        a1, a2 = accelerations(s, *y)
        return [y[1], a1, y[3], a2]

    states = solve_ivp(rates, (0.0, t[-1]), [0.0] * 4, t_eval=t, rtol=1e-8, max_step=5e-3).y
    clean = [*states, *accelerations(t, *states), force(t)]
    names = ["x1", "v1", "x2", "v2", "a1", "a2", "u"]
    noisy = {n: one + 0.01 * one.std() * rng.standard_normal(len(t)) for n, one in zip(names, clean, strict=True)}
    measured = bq.Record.from_arrays(noisy, time=t)
    terms = ["x1", "x2", "v1", "v2", "x1-x2", "(x1-x2)**3", "(x1-x2)*abs(x1-x2)", "u"]
    eqs = bq.discover(measured, chains=["x1:v1:a1", "x2:v2:a2"], inputs=["u"], dictionary=terms, holdout=0.0)
    for eq in eqs:
        assert eq.verdict.kind != "found"
        places = re.search(r"x1-x2 has .* near -(\S+) and (\S+), which no candidate has", str(eq.verdict))
        assert [float(place) for place in places.groups()] == pytest.approx([0.008, 0.008], rel=0.05)
        assert "offer max(-(x1-x2)-{g:" in str(eq.verdict)
    offers = {str(eq.verdict).partition("offer ")[2] for eq in eqs}
    assert len(offers) == 1  # a constant has one range


def test_dry_friction_of_a_motor_is_a_jump():
    """Speed of a rotor under a current, by steps of a fiftieth of a sample; powers and kinks had been offered."""
    rng, t = np.random.default_rng(7405), np.arange(50 * 3000) / (50 * 200.0)
    w, phase = 2.0 * np.pi * rng.uniform(0.1, 3.0, 16), rng.uniform(0.0, 2.0 * np.pi, 16)
    current, speed = 2.0 * np.cos(np.outer(t, w) + phase).sum(axis=1) / np.sqrt(8.0), np.zeros(len(t))
    for k in range(len(t) - 1):
        free = speed[k] + (t[1] - t[0]) * (40.0 * current[k] - 0.5 * speed[k])
        speed[k + 1] = np.sign(free) * max(abs(free) - (t[1] - t[0]) * 16.0, 0.0)
    channels = {"speed": speed[::50], "i": current[::50]}
    noisy = {name: one + 0.01 * one.std() * rng.standard_normal(len(one)) for name, one in channels.items()}
    motor = bq.Record.from_arrays(noisy, fs=200.0)
    first = bq.discover(motor, chains="speed", inputs=["i"], dictionary="polynomial:3")
    assert first.verdict.kind != "found"
    assert re.search(r"speed has a jump near 0, which no candidate has: offer sign\(speed\)$", str(first.verdict))
    again = bq.discover(motor, chains="speed", inputs=["i"], dictionary="polynomial:3, sign(speed)")
    assert set(again[0].shown) == {"speed", "i", "sign(speed)"}
    assert again.verdict.kind == "found"


def test_a_dead_zone_of_the_force_is_named():
    """Nothing but u is offered of the force, which acts above 0.8 N only."""
    eq = found(record(lambda x: 0.0 * x, 7402, force=lambda u: np.maximum(u - 0.8, 0.0) + np.minimum(u + 0.8, 0.0)))
    assert eq.verdict.kind != "found"
    assert "u has a kink near" in str(eq.verdict)


def test_words_of_kinks():
    kinks = Kinks("x", 9.0, (-0.03, 0.025), ("max(x-{g:0..1},0)",), alone=True, left=0.1)
    right = Verdict("found", "R2 1")
    assert with_kinks(right, kinks, pulses=True) is right
    assert with_kinks(right, kinks, pulses=False).reason == "x has a kink near -0.03 and 0.025, which no candidate has"
    other = with_kinks(Verdict("not determined", "..", "measure longer"), kinks._replace(alone=False), pulses=False)
    assert other.kind == "not determined"
    assert "x has a function that bends near -0.03 and 0.025, which no candidate has: offer max" in other.advice
    nothing = Verdict("none", "no equation found")
    assert with_kinks(nothing, kinks, pulses=False) is nothing
    assert with_kinks(nothing, kinks._replace(left=0.0), pulses=False).advice.startswith("x has a kink near")
    assert with_kinks(nothing, kinks._replace(left=0.0), pulses=True) is nothing


def test_a_likelihood_that_is_not_finite_offers_no_kinks(monkeypatch):
    def fails(*_):
        raise np.linalg.LinAlgError("the likelihood is not finite")

    measured = record(stops, 7400)
    monkeypatch.setattr("bayeq.likelihood.hinges.beside", fails)
    assert "kink" not in str(found(measured).verdict)
