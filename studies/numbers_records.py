"""Records of many kinds, for a study of the numbers that equations show: each is drawn with its truth.

Every kind is a function of a seed that returns records, the arguments of `bayeq.discover`, and the true coefficients
by target and term, the constant under `CONSTANT`. Parameters are drawn anew for each seed. Motion is integrated at
least ten times more finely than it is sampled: a force that is joined by straight lines at the sampling rate moves a
system less than the smooth one that its samples show.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.records import Record
from bayeq.states import Roles
from bayeq.systems import BandLimitedForce, System, get_system, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.adverse_records import CASES, Case
from studies.adverse_records import draw_record as draw_adverse
from studies.judge import CONSTANT
from studies.servo import TERMS as STAGE_TERMS
from studies.servo import Stage
from studies.servo import draw_record as draw_stage

__all__ = [
    "SETTLING",
    "Drawn",
    "draw_circuit",
    "draw_drive",
    "draw_growth",
    "draw_heater",
    "draw_paper",
    "draw_pendulum",
    "draw_ringdown",
    "draw_second_force",
    "draw_settling",
    "draw_sign_oscillator",
    "draw_stribeck",
]

Floats = NDArray[np.float64]
Rng = np.random.Generator

FINER = 20


class Drawn(NamedTuple):
    """Records, the arguments of `discover` beside them, and the truth."""

    records: Record | list[Record]
    question: dict[str, Any]
    truth: dict[str, dict[str, float]]


def _about(value: float, rng: Rng, low: float = 0.7, high: float = 1.4) -> float:
    """A parameter drawn around a value."""
    return float(value * rng.uniform(low, high))


def _noisy(values: Floats, ratio: float, rng: Rng) -> Floats:
    """With noise of a ratio of their standard deviation."""
    return values + ratio * values.std() * rng.standard_normal(len(values))


def _oscillator(acceleration: str, parameters: Mapping[str, float], x: float = 0.0, v: float = 0.0) -> System:
    """A system of displacement x and velocity v, driven by u."""
    return _system({"x": "v", "v": acceleration}, ("x:v:a",), parameters, {"x": x, "v": v}, ("u",))


def _system(
    rhs: Mapping[str, str],
    chains: tuple[str, ...],
    parameters: Mapping[str, float],
    initial: Mapping[str, float],
    inputs: tuple[str, ...] = (),
) -> System:
    return System(
        name="numbers",
        title="made for this study",
        chains=chains,
        rhs=rhs,
        terms={},
        parameters=parameters,
        initial=initial,
        inputs=inputs,
        n=2,
        fs=1.0,
        noise=0.0,
        citation="made for this study",
    )


def _moved(system: System, force: Floats, fs: float, finer: int = FINER) -> Record:
    """Clean motion under a force that is sampled `finer` times as often as the record, at `fs`."""
    return simulate(system, fs=fs * finer, noise=0.0, force=force).slice(None, None, finer)


def _broadband(sd: float, highest: float, rows: int, fs: float, rng: Rng) -> Floats:
    """A Gaussian force from 0 to a frequency [Hz], for a record of some rows."""
    return band_limited_noise(BandLimitedForce(sd, (0.0, highest)), rows * FINER, fs * FINER, rng)


# --- the systems of the paper ----------------------------------------------------------------------------------------


def draw_paper(seed: int, system: str, chain: str, noise: float, free: bool, all_terms: bool) -> Drawn:
    """A system of the paper of which the channels of a chain are measured, forced or released from a random state."""
    known, finer = get_system(system), FINER
    forced = simulate(known, n=finer * known.n, fs=finer * known.fs, seed=seed, noise=0.0, perturb=0.1)
    assert forced.truth is not None
    rng = np.random.default_rng([seed, 1])
    moved = forced
    if free:
        start = {name: float(forced[name].std() * rng.standard_normal()) for name in known.states}
        moved = simulate(
            replace(known, initial=start),
            fs=finer * known.fs,
            noise=0.0,
            parameters=forced.truth.parameters,
            force=np.zeros(forced.n),
        )
    inputs = () if free else ("u",)
    roles = Roles.parse(chains=chain, inputs=inputs)
    channels = {name: _noisy(moved[name][::finer], noise, rng) for name in roles.channels}
    names = dict(zip(known.states, roles.states, strict=True))
    true = {
        re.sub(r"\b[xv]\b", lambda found: names[found[0]], text): value
        for text, value in forced.truth.coefficients["a"].items()
        if text != "u" or not free
    }
    question = {"chains": chain, "inputs": list(inputs), "dictionary": "oscillator" if all_terms else tuple(true)}
    return Drawn(Record.from_arrays(channels, fs=known.fs), question, {roles.targets[0]: true})


# --- friction --------------------------------------------------------------------------------------------------------


def draw_sign_oscillator(seed: int, sign: str, also: str, noise: float, rows: int = 1500) -> Drawn:
    """An oscillator with sign(v) or sign(x), and perhaps x**3 or v*abs(v), of which x is measured.

    The sign's force is between 2 and 30 % of the acceleration's standard deviation without it, and the other term's
    between 5 and 30 % of the spring's or three times as much of the damper's.
    """
    rng = np.random.default_rng(seed)
    w, z, b = 2 * np.pi * rng.uniform(1.0, 5.0), float(np.exp(rng.uniform(np.log(0.01), np.log(0.1)))), _about(1.0, rng)
    fs = w / (2 * np.pi) * rng.uniform(20.0, 100.0)
    force = _broadband(_about(20.0, rng), _about(3.0 * w / (2 * np.pi), rng), rows, fs, rng)
    true = {"x": -(w**2), "v": -2 * z * w, "u": b}
    linear = _moved(_oscillator("k*x+c*v+b*u", {"k": true["x"], "c": true["v"], "b": b}), force, fs)
    if also:
        spring = also == "x**3"
        share, size = rng.uniform(0.05, 0.3), float(linear["x" if spring else "v"].std())
        # E z^6 = 15 and E z^4 = 3 for Gaussian z
        true[also] = share * true["x"] / size**2 / 15**0.5 if spring else 3 * share * true["v"] / size / 3**0.5
    true[sign] = -float(rng.uniform(0.02, 0.3) * linear["a"].std())
    parameters = {f"p{k}": value for k, value in enumerate(true.values())}
    acceleration = "+".join(f"{name}*{text}" for name, text in zip(parameters, true, strict=True))
    moved = _moved(_oscillator(acceleration, parameters), force, fs)
    record = Record.from_arrays({"x": _noisy(moved["x"], noise, rng), "u": moved["u"]}, fs=fs)
    terms = ("x", "dx", "sign(x)", "sign(dx)", "x**3", "dx*abs(dx)", "u")
    question = {"chains": "x::", "inputs": ["u"], "dictionary": terms}
    return Drawn(record, question, {"ddx": {re.sub(r"\bv\b", "dx", name): value for name, value in true.items()}})


def draw_stribeck(seed: int, noise: float = 0.02, rows: int = 4000, fs: float = 200.0) -> Drawn:
    """An oscillator of about 1.6 Hz with friction that falls as it starts to slide."""
    rng = np.random.default_rng(seed)
    p = {name: _about(value, rng) for name, value in (("k", 100.0), ("c", 0.4), ("b", 8.0), ("f", 2.0), ("s", 3.0))}
    system = _oscillator("b*u-k*x-c*v-sign(v)*(f+s*exp(-(v/0.3)**2))", p)
    moved = _moved(system, _broadband(_about(1.2, rng), 4.0, rows, fs, rng), fs)
    record = Record.from_arrays({name: _noisy(moved[name], noise, rng) for name in ("x", "u")}, fs=fs)
    falling = "sign(dx)*exp(-(dx/0.3)**2)"
    true = {"x": -p["k"], "dx": -p["c"], "sign(dx)": -p["f"], falling: -p["s"], "u": p["b"]}
    return Drawn(record, {"chains": "x::", "inputs": ["u"], "dictionary": tuple(true)}, {"ddx": true})


def draw_pendulum(seed: int, rows: int = 12_000, fs: float = 200.0, lines: int = 4096) -> Drawn:
    """A free pendulum with dry friction from about 1 rad, of which an encoder is read."""
    rng = np.random.default_rng(seed)
    p = {"g": _about(15.8, rng), "c": _about(0.04, rng), "f": _about(0.25, rng)}
    system = _oscillator("-g*sin(x)-c*v-f*sign(v)+0*u", p, x=_about(1.0, rng, 0.85, 1.15))
    angle, step = _moved(system, np.zeros(rows * FINER), fs)["x"], 2 * np.pi / lines
    record = Record.from_arrays({"th": step * np.round(angle / step)}, fs=fs)
    true = {"sin(th)": -p["g"], "dth": -p["c"], "sign(dth)": -p["f"]}
    return Drawn(record, {"chains": "th::", "dictionary": tuple(true)}, {"ddth": true})


def draw_drive(seed: int, rate: float, loop: float) -> Drawn:
    """A servo stage in a closed loop of a rate [Hz], which is recorded at another, with position steps of 1 um."""
    rng = np.random.default_rng([seed, 2])
    friction = float(rng.uniform(5.0, 25.0))
    stage = Stage(
        mass=float(rng.uniform(40.0, 120.0)),
        viscous=float(rng.uniform(100.0, 250.0)),
        uneven=0.0,
        coulomb=friction,
        offset=float(rng.uniform(-2.0, 2.0)),
        cogging=float(rng.uniform(0.0, 0.015)) * 100.0,  # of a force of about 100 N
        encoder=1e-6,
        rate=loop,
        substeps=max(4, round(8000.0 / loop)),
    )
    record = draw_stage(seed, stage).slice(None, None, round(loop / rate))
    m = stage.mass
    true = {"dq": -stage.viscous / m, "sign(dq)": -friction / m, "F": 1.0 / m, CONSTANT: -stage.offset / m}
    return Drawn(record, {"chains": "q::", "inputs": ["F"], "dictionary": STAGE_TERMS}, {"ddq": true})


# --- a circuit -------------------------------------------------------------------------------------------------------

CIRCUIT_FINER, CIRCUIT_BEFORE, CIRCUIT_SD = 64, 1000, 0.06


def draw_circuit(seed: int, noise: float, rows: int = 10_000) -> Drawn:
    """A Duffing circuit under an odd multisine to a third of the sampling rate, 9 samples a period of its resonance.

    The output is read behind a low-pass of first order that changes it by 0.2 % (rms).
    """
    rng = np.random.default_rng(seed)
    w, zeta = 2 * np.pi * _about(41.0, rng), _about(0.03, rng)
    fs, finer = 9 * w / (2 * np.pi), CIRCUIT_FINER
    lines = np.arange(1, rows // 3, 2)
    spectrum = np.zeros(rows * finer // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines))) * rows * finer / np.sqrt(2.0 * len(lines))
    force = np.fft.irfft(spectrum, rows * finer)
    omega = 2 * np.pi * np.arange(len(spectrum)) * fs / rows
    linear = np.fft.irfft(spectrum / (w**2 - omega**2 + 2j * zeta * w * omega), rows * finer)
    gain = CIRCUIT_SD / linear.std()
    cubic = w**2 * rng.uniform(0.07, 0.15) / 15**0.5 / CIRCUIT_SD**2
    system = _oscillator("g*u-k*x-c*v-k3*x**3", {"g": gain, "k": w**2, "c": 2 * zeta * w, "k3": cubic})
    driven = np.concatenate([force[-CIRCUIT_BEFORE * finer :], force])
    y = simulate(system, fs=fs * finer, noise=0.0, force=driven)["x"][CIRCUIT_BEFORE * finer :]
    moved = np.fft.rfft(y)
    moved[0] = 0.0
    lag = 0.002 * np.linalg.norm(moved) / np.linalg.norm(omega * moved)
    seen = np.fft.irfft(moved / (1 + 1j * omega * lag), rows * finer)[::finer] + y.mean()
    record = Record.from_arrays({"y": _noisy(seen, noise, rng), "u": force[::finer]}, fs=fs)
    true = {"y": -(w**2), "dy": -2 * zeta * w, "y**3": -cubic, "u": gain}
    return Drawn(record, {"chains": "y::", "inputs": ["u"], "dictionary": tuple(true)}, {"ddy": true})


# --- first order -----------------------------------------------------------------------------------------------------


def draw_heater(seed: int, lag: float, noise: float = 0.1, rows: int = 800) -> Drawn:
    """A heater that is switched on, sampled once a second behind a sensor of a lag [s]; 0.1 degrees of noise."""
    rng = np.random.default_rng(seed)
    tau, rise, around = rng.uniform(150.0, 220.0), _about(31.0, rng), rng.uniform(15.0, 25.0)
    t = np.arange(rows, dtype=np.float64)
    left = (tau * np.exp(-t / tau) - (lag * np.exp(-t / lag) if lag else 0.0)) / (tau - lag)
    record = Record.from_arrays({"T": around + rise * (1.0 - left) + noise * rng.standard_normal(rows)}, fs=1.0)
    true = {"T": -1.0 / tau, CONSTANT: (around + rise) / tau}
    return Drawn(record, {"chains": ["T"], "dictionary": "polynomial:1"}, {"dT": true})


def _logistic(rate: float, most: float, start: float, rows: int) -> Floats:
    return most / (1.0 + (most / start - 1.0) * np.exp(-rate * np.arange(rows)))


def draw_growth(seed: int, rows: int, noise: float = 0.05) -> Drawn:
    """Logistic growth by day, every count off by 5 % of itself; ten records of 5 to 10 rows where `rows` is 0."""
    rng = np.random.default_rng(seed)
    rate, most = float(rng.uniform(0.3, 1.0)), _about(22.0, rng)
    if rows:
        runs = [_logistic(rate, most, most * rng.uniform(0.02, 0.1), rows)]
    else:
        runs = [_logistic(rate, most, most * rng.uniform(0.02, 1.5), int(rng.integers(5, 11))) for _ in range(10)]
    records = [
        Record.from_arrays({"N": clean * (1.0 + noise * rng.standard_normal(len(clean)))}, fs=1.0) for clean in runs
    ]
    question = {"chains": ["N"], "dictionary": "polynomial:2"}
    return Drawn(records[0] if rows else records, question, {"dN": {"N": rate, "N**2": -rate / most}})


class Settling(NamedTuple):
    """State -> term -> coefficient, the degree of the polynomials, the start, and a time within which all settle."""

    terms: Mapping[str, Mapping[str, float]]
    degree: int
    start: Mapping[str, float]
    longest: float
    ties: Sequence[tuple[tuple[str, str], tuple[str, str], float]] = ()


# Ties are coefficients that are a multiple of others.
SETTLING: Mapping[str, Settling] = {
    "sir": Settling(
        {"S": {"S*I": -1.5}, "I": {"S*I": 1.5, "I": -0.4}},
        2,
        {"S": 0.98, "I": 0.02},
        100.0,
        ((("I", "S*I"), ("S", "S*I"), -1.0),),
    ),
    "schnakenberg": Settling(
        {"x": {CONSTANT: 0.3, "x": -1.0, "x**2*y": 1.0}, "y": {CONSTANT: 1.2, "x**2*y": -1.0}},
        3,
        {"x": 0.4, "y": 2.5},
        100.0,
        ((("y", "x**2*y"), ("x", "x**2*y"), -1.0),),
    ),
    "allee": Settling({"N": {"N": -0.4, "N**2": 0.6, "N**3": -0.1}}, 3, {"N": 1.8}, 100.0),
    "competition": Settling(
        {"x": {"x": 1.0, "x**2": -1.0, "x*y": -0.5}, "y": {"y": 0.7, "y**2": -0.8, "x*y": -0.3}},
        2,
        {"x": 0.05, "y": 0.1},
        200.0,
    ),
    "predator": Settling(
        {"x": {"x": 1.5, "x**2": -0.5, "x*y": -1.0}, "y": {"y": -0.6, "x*y": 0.8}},
        2,
        {"x": 2.0, "y": 0.3},
        200.0,
    ),
}

# Steps of the simulation within the longest time, and how near to rest the last third is.
SETTLING_STEPS, REST = 200_000, 0.01


def draw_settling(seed: int, system: str, noise: float, rows: int) -> Drawn:
    """States that settle, the last third of the rows within 1 % of each state's range about rest."""
    rng = np.random.default_rng(seed)
    known = SETTLING[system]
    true = {
        f"d{state}": {name: _about(value, rng, 0.85, 1.18) for name, value in terms.items()}
        for state, terms in known.terms.items()
    }
    for (to, name), (of, other), factor in known.ties:
        true[f"d{to}"][name] = factor * true[f"d{of}"][other]
    start = {name: _about(value, rng, 0.9, 1.1) for name, value in known.start.items()}
    rhs = {state: "+".join(f"({value!r})*{name}" for name, value in true[f"d{state}"].items()) for state in known.terms}
    fs = SETTLING_STEPS / known.longest
    fine = simulate(_system(rhs, tuple(rhs), {}, start), n=SETTLING_STEPS, fs=fs, noise=0.0)
    moved = np.column_stack([fine[name] for name in rhs])
    moving = np.flatnonzero((np.abs(moved - moved[-1]) > REST * np.ptp(moved, axis=0)).any(axis=1))[-1]
    step = max(1, int(1.5 * moving) // rows)
    channels = {name: _noisy(fine[name][: step * rows : step], noise, rng) for name in rhs}
    question = {"chains": list(rhs), "dictionary": f"polynomial:{known.degree}"}
    return Drawn(Record.from_arrays(channels, fs=fs / step), question, true)


# --- one channel, or one force too few -------------------------------------------------------------------------------


def draw_ringdown(seed: int, zeta: float, noise: float, all_terms: bool, fs: float = 200.0) -> Drawn:
    """An oscillator of about 5 Hz released from rest, of which 1 to 2 s of acceleration are measured."""
    rng = np.random.default_rng(seed)
    w, damping, rows = 2 * np.pi * _about(5.0, rng), _about(zeta, rng), int(fs * rng.uniform(1.0, 2.0))
    system = _oscillator("-k*x-c*v+0*u", {"k": w**2, "c": 2 * damping * w}, x=_about(0.01, rng))
    moved = _moved(system, np.zeros(rows * FINER), fs)
    record = Record.from_arrays({"a": _noisy(moved["a"], noise, rng)}, fs=fs)
    true = {"x": -(w**2), "dx": -2 * damping * w}
    return Drawn(record, {"chains": "::a", "dictionary": "oscillator" if all_terms else tuple(true)}, {"a": true})


MEMORY = 0.998


def _with_slow(share: float, n: int, fs: float, rng: Rng) -> Floats:
    """The force of the adverse records and a second one, of a memory of 0.998 a sample of the record."""
    from scipy.signal import lfilter

    usual = CASES["clean"]
    first = usual.force(n, fs, rng)
    memory = MEMORY ** (1.0 / usual.finer)
    second = lfilter(
        [np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(n), zi=[memory * rng.standard_normal()]
    )[0]
    return np.hstack([first, share * first.std() * second[:, None]])


def draw_second_force(seed: int, slow: bool, share: float, noise: float, rows: int = 4000) -> Drawn:
    """The adverse Duffing with a force that is not measured, of a share (0.1 or 0.3) of the one that is."""
    rng = np.random.default_rng([seed, 3])
    case: Case = CASES[f"second force of {100 * share:g} %"]
    parameters = {name: _about(value, rng) for name, value in case.system.parameters.items()}
    case = replace(case, system=replace(case.system, parameters=parameters), noise=noise)
    if slow:
        case = replace(case, force=partial(_with_slow, share))
    record = draw_adverse(case, rows, seed)
    assert record.truth is not None
    truth = {target: dict(own) for target, own in record.truth.coefficients.items()}
    return Drawn(record, {"chains": "x:v:a", "inputs": ["u"], "dictionary": "oscillator"}, truth)
