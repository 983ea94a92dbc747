"""Hidden states with stated laws: actuators that lag, tanks in a row, Bouc and Wen's hysteresis, and none; and with
laws that are found: that hysteresis from all channels, from displacement alone, on a test machine, and none; a mass at
the end or in the middle of a row that nobody measures; Lorenz's z.

    python -m studies.hidden --first-seed 220000 > docs/tables/hidden.csv

Parameters are drawn; every channel has noise of a share of its standard deviation. Exact is an answer with the true
terms of the measured equation, the hidden state among them, or without it where there is none, and of a law that is
found. Intervals are those of coefficients and of the constants of the law.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from bayeq.arrays import Floats
from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.records import Record
from studies.judge import judged, timed, verdict_lines
from studies.resumable import Outcome, by_noise, run_study

RECORDS, ROWS = 10, 1500
NOISES = (0.01, 0.02)

# Truth of the measured equation, and of the constants of the law.
Drawn = tuple[dict[str, Floats], float, dict[str, dict[str, float]], dict[str, float]]


def _waves(rng: np.random.Generator, lowest: float, highest: float) -> Callable[[Any], Any]:
    """A sum of sines of random frequencies [rad/s] and phases, of standard deviation 1."""
    w, phase = rng.uniform(lowest, highest, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
    return lambda s: np.sin(np.multiply.outer(s, w) + phase).sum(axis=-1) / np.sqrt(6.0)


def _states(rate: Callable[[float, Floats], list[float]], start: list[float], time: Floats) -> Floats:
    return np.asarray(solve_ivp(rate, (0.0, time[-1]), start, t_eval=time, rtol=1e-8, atol=1e-10).y)


def actuator(rng: np.random.Generator, lags: bool = True) -> Drawn:
    """A Duffing oscillator under a force that follows its command with a lag, or at once."""
    time = np.arange(ROWS) * 0.005
    k, c, g, k3 = rng.uniform(50.0, 200.0), rng.uniform(0.5, 3.0), rng.uniform(20.0, 50.0), rng.uniform(50.0, 300.0)
    tau, command = float(np.exp(rng.uniform(np.log(0.02), np.log(0.15)))), _waves(rng, 2.0, 25.0)

    def rate(s: float, y: Floats) -> list[float]:
        force = y[2] if lags else command(s)
        return [y[1], -k * y[0] - c * y[1] - k3 * y[0] ** 3 + g * force, (command(s) - y[2]) / tau]

    x = _states(rate, [0.0, 0.0, 0.0], time)[0]
    truth = {"x": -k, "dx": -c, "x**3": -k3, "f" if lags else "u": g}
    return {"x": x, "u": command(time)}, 200.0, {"ddx": truth}, {"tau": tau} if lags else {}


def tanks(rng: np.random.Generator) -> Drawn:
    """Two tanks that drain by Torricelli's law; a pump fills the upper one, the level of the lower one is measured."""
    time = np.arange(ROWS) * 2.0
    a, b, c = rng.uniform(0.2, 0.4), rng.uniform(0.01, 0.02), rng.uniform(0.04, 0.08)
    waves = _waves(rng, 0.005, 0.06)

    def pump(s: Any) -> Any:
        return 3.0 + waves(s)

    def rate(s: float, y: Floats) -> list[float]:
        upper, lower = np.sqrt(np.abs(y))
        return [pump(s) - a * upper, b * upper - c * lower]

    start = [float((pump(0.0) / a) ** 2), float((b / c * pump(0.0) / a) ** 2)]
    y = _states(rate, start, time)[1]
    return {"y": y, "u": pump(time)}, 0.5, {"dy": {"sqrt(abs(h))": b, "sqrt(y)": -c}}, {"a": a}


def hysteresis(rng: np.random.Generator) -> Drawn:
    """Bouc and Wen's oscillator, its motion measured in full, its restoring force hidden, with a stated law."""
    channels, fs, truth, law = _hysteretic(rng)
    return channels, fs, {"a": {**truth["a"], "r": -1.0}}, law


def _found(rng: np.random.Generator, names: Mapping[str, str]) -> Drawn:
    """The same with a law that is found, its scale another: r is the negative of the force; channels by these names."""
    channels, fs, truth, law = _hysteretic(rng)
    target, v = names["a"], names["v"]
    seen = {names.get(name, name): value for name, value in truth["a"].items()}
    own = {v: -60.0, f"abs({v})*r": -law["b"], f"{v}*abs(r)": law["g"]}
    measured = {name: values for name, values in channels.items() if names.get(name, name) == name}
    return measured, fs, {target: {**seen, "r": 1.0}, "dr": own}, {}


def damper(rng: np.random.Generator) -> Drawn:
    """A damper on a test machine, with a spring, and a hysteretic force that is hidden."""
    time = np.arange(ROWS) * 0.01
    k, c, b, g = rng.uniform(3.0, 8.0), rng.uniform(0.3, 1.0), rng.uniform(1.0, 3.0), rng.uniform(0.5, 1.5)
    w, phase = rng.uniform(1.0, 12.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)

    def speed(s: Any) -> Any:
        return 0.5 * (w * np.cos(np.multiply.outer(s, w) + phase)).sum(axis=-1)

    def rate(s: float, y: Floats) -> list[float]:
        v = speed(s)
        return [20.0 * v - b * abs(v) * y[0] - g * v * abs(y[0])]

    x = 0.5 * np.sin(np.multiply.outer(time, w) + phase).sum(axis=-1)
    v, r = speed(time), _states(rate, [0.0], time)[0]
    truth = {"F": {"x": k, "v": c, "r": 1.0}, "dr": {"v": 20.0, "abs(v)*r": -b, "v*abs(r)": -g}}
    return {"x": x, "v": v, "F": k * x + c * v + r}, 100.0, truth, {}


def cubic(rng: np.random.Generator) -> Drawn:
    """An oscillator with a cubic spring and nothing hidden."""
    time = np.arange(ROWS) * 0.01
    k, c, k3, force = rng.uniform(40.0, 80.0), rng.uniform(0.3, 1.0), rng.uniform(5.0, 20.0), _waves(rng, 1.0, 20.0)

    def rate(s: float, y: Floats) -> list[float]:
        x, v = y.tolist()
        return [v, 15.0 * force(s) - c * v - k * x - k3 * x**3]

    x, v = _states(rate, [0.0, 0.0], time)
    a = 15.0 * force(time) - c * v - k * x - k3 * x**3
    truth = {"a": {"x": -k, "v": -c, "x**3": -k3, "u": 15.0}}
    return {"x": x, "v": v, "a": a, "u": force(time)}, 100.0, truth, {}


def masses(rng: np.random.Generator, middle: bool) -> Drawn:
    """Two masses of which the second, or three of which the one in the middle, is not measured; displacements are."""
    time, force = np.arange(ROWS) * 0.01, _waves(rng, 1.0, 18.0)
    k, c, m = rng.uniform(50.0, 150.0, 3), rng.uniform(0.3, 0.8, 3), np.append(1.0, rng.uniform(0.6, 1.4, 2))
    count = 3 if middle else 2

    def rate(s: float, y: Floats) -> list[float]:
        x, v = y[:count], y[count:]
        pull = k[:count] * np.diff(x, prepend=0.0) + c[:count] * np.diff(v, prepend=0.0)
        a = (np.append(pull[1:], 0.0) - pull) / m[:count]
        a[0] += 10.0 * force(s)
        return [*v.tolist(), *a.tolist()]

    y = _states(rate, [0.0] * (2 * count), time)
    first = {"x1": -k[0], "dx1": -c[0], "u": 10.0, "x1-x2": -k[1], "dx1-dx2": -c[1]}
    second = {"x2-x1": -k[1] / m[1], "dx2-dx1": -c[1] / m[1]}
    if not middle:
        return {"x1": y[0], "u": force(time)}, 100.0, {"ddx1": first, "ddx2": second}, {}
    second |= {"x2-x3": -k[2] / m[1], "dx2-dx3": -c[2] / m[1]}
    third = {"x3-x2": -k[2] / m[2], "dx3-dx2": -c[2] / m[2]}
    channels = {"x1": y[0], "x3": y[2], "u": force(time)}
    return channels, 100.0, {"ddx1": first, "ddx3": third, "ddx2": second}, {}


def lorenz(rng: np.random.Generator) -> Drawn:
    """Lorenz's equations, x and y measured; z is the negative of theirs, by which x*z has the coefficient 1."""

    def rate(s: float, y: Floats) -> list[float]:
        return [10.0 * (y[1] - y[0]), 28.0 * y[0] - y[1] + y[0] * y[2], -y[0] * y[1] - 8.0 / 3.0 * y[2]]

    time = np.arange(ROWS) * 0.01
    settled = _states(rate, [*rng.normal(0.0, 5.0, 2).tolist(), -25.0], np.linspace(0.0, 10.0, 1000))[:, -1]
    x, y, _ = _states(rate, settled.tolist(), time)
    truth = {
        "dx": {"x": -10.0, "y": 10.0},
        "dy": {"x": 28.0, "y": -1.0, "x*z": 1.0},
        "dz": {"x*y": -1.0, "z": -8.0 / 3.0},
    }
    return {"x": x, "y": y}, 100.0, truth, {}


def _hysteretic(rng: np.random.Generator) -> Drawn:
    time = np.arange(ROWS) * 0.01
    k, c, b, g = rng.uniform(40.0, 80.0), rng.uniform(0.3, 1.0), rng.uniform(1.0, 3.0), rng.uniform(0.5, 1.5)
    force = _waves(rng, 1.0, 20.0)

    def rate(s: float, y: Floats) -> list[float]:
        x, v, r = y.tolist()
        return [v, 15.0 * force(s) - c * v - k * x - r, 60.0 * v - b * abs(v) * r - g * v * abs(r)]

    x, v, r = _states(rate, [0.0, 0.0, 0.0], time)
    a = 15.0 * force(time) - c * v - k * x - r
    truth = {"x": -k, "v": -c, "u": 15.0}
    return {"x": x, "v": v, "a": a, "u": force(time)}, 100.0, {"a": truth}, {"b": b, "g": g}


OSCILLATOR = {"chains": "x::", "inputs": ["u"], "dictionary": {"ddx": "x, dx, f, u, x**2, x**3, dx*abs(dx), dx**3"}}
TANKS = {"chains": "y", "inputs": ["u"], "dictionary": {"dy": "sqrt(abs(h)), sqrt(y), h, y, u, y**2"}}
HYSTERESIS = {"chains": "x:v:a", "inputs": ["u"], "dictionary": {"a": "x, v, r, u, x**3, v*abs(v), sign(v)"}}
LAG = "df = (u - f)/{tau}"


def _among(chain: str, target: str, v: str, inputs: Sequence[str]) -> dict[str, Any]:
    """A question with a dictionary for the hidden force r."""
    terms = [*inputs] if chain[0] == "=" else ["x", v, *inputs]
    seen = ", ".join([*terms, "r", "x**2", "x**3", f"{v}*abs({v})"])
    own = f"{v}, r, x, abs({v})*r, {v}*abs(r), {v}*r**2, r**3, {v}**3"
    return {"chains": [chain, "~r:"], "inputs": inputs, "dictionary": {target: seen, "dr": own}}


# Each mass is pulled by its neighbours, the first by the ground and the force too.
FIRST, THIRD = "x1, dx1, u, x1-x2, dx1-dx2, x1**3, (x1-x2)**3", "x3, dx3, x3-x2, dx3-dx2, (x3-x2)**3"
END = {
    "chains": ["x1::", "~x2::"],
    "inputs": ["u"],
    "dictionary": {"ddx1": FIRST, "ddx2": "x2-x1, dx2-dx1, (x2-x1)**3"},
}
MIDDLE = {
    "chains": ["x1::", "x3::", "~x2::"],
    "inputs": ["u"],
    "dictionary": {
        "ddx1": FIRST,
        "ddx3": THIRD,
        "ddx2": "x2-x1, dx2-dx1, x2-x3, dx2-dx3, (x2-x1)**3, (x2-x3)**3",
    },
}
LORENZ = {
    "chains": ["x", "y", "~z:"],
    "dictionary": {
        "dx": "x, y, x*y, x**2, y**2",
        "dy": "x, y, x*z, x*y, x**2, y**2",
        "dz": "x, y, z, x*y, x*z, y*z, x**2, y**2, z**2",
    },
}

FULL, ALONE = {"a": "a", "v": "v"}, {"a": "ddx", "v": "dx"}

SYSTEMS: dict[str, tuple[Callable[[np.random.Generator], Drawn], dict[str, Any]]] = {
    "actuator": (actuator, {**OSCILLATOR, "law": LAG}),
    "no actuator": (partial(actuator, lags=False), {**OSCILLATOR, "law": LAG}),
    "two tanks": (tanks, {**TANKS, "law": "dh = u - {a: 0.05..2}*sqrt(abs(h))"}),
    "hysteresis": (
        hysteresis,
        {**HYSTERESIS, "law": "dr = 60*v - {b: 0.2..20}*abs(v)*r - {g: 0.1..10}*v*abs(r)"},
    ),
    "hysteresis found": (partial(_found, names=FULL), _among("x:v:a", "a", "v", ["u"])),
    "hysteresis found, x and u": (partial(_found, names=ALONE), _among("x::", "ddx", "dx", ["u"])),
    "damper found": (damper, _among("=F", "F", "v", ["x", "v"])),
    "end mass found": (partial(masses, middle=False), END),
    "middle mass found": (partial(masses, middle=True), MIDDLE),
    "Lorenz's z found": (lorenz, LORENZ),
    "none found": (cubic, _among("x:v:a", "a", "v", ["u"])),
}


def _judged(truth: dict[str, dict[str, float]], constants: dict[str, float], eqs: Equations) -> dict[str, object]:
    """Equations against the truth; intervals of constants beside those of coefficients, but for the 1 of a scale."""
    known = {equation.target for equation in eqs}
    found = judged([eqs[target] for target in truth if target in known], {t: truth[t] for t in truth if t in known})
    if missed := truth.keys() - known:
        found |= {"exact": False, "wrong": [*found["wrong"], *(f"{target}: -" for target in missed)]}
    if truth.keys() & {"dr", "dz"}:  # the scale of a hidden state is no estimate
        kept = {name: one for name, one in found["terms"].items() if not name.endswith((" r", " x*z"))}
        found["terms"] = kept
    ends = {one.name: one.ci95 for one in eqs.constants}
    inside = [ends[name][0] <= value <= ends[name][1] for name, value in constants.items() if name in ends]
    return {**found, "verdict": eqs.verdict.kind, "constants": len(inside), "constants_inside": sum(inside)}


def _measure(name: str, noise: float, seed: int) -> Outcome:
    simulated, asked = SYSTEMS[name]
    channels, fs, truth, constants = simulated(np.random.default_rng([seed, 1]))
    rng = np.random.default_rng([seed, 2])
    noisy = {key: one + noise * one.std() * rng.standard_normal(ROWS) for key, one in channels.items()}
    record = Record.from_arrays(noisy, fs=fs)
    return timed(partial(discover, record, **asked), partial(_judged, truth, constants))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    exact = [one for one in outcomes if one["exact"]]
    for line in verdict_lines(outcomes):
        inside = {"constants": "constants", "constants_covering": "constants_inside"}
        yield {**line, **{column: sum(one[name] for one in exact) for column, name in inside.items()}}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = by_noise(SYSTEMS, NOISES, RECORDS, _measure)
    run_study("hidden", "Hidden states with stated laws.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
