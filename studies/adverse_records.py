"""Adverse records of a Duffing oscillator: a simulator of the clean motion, and what spoils it or its samples.

Unit mass, k = 400, c = 1.2, k3 = 2.5e4, from rest, Gaussian force of sd 20 up to 15 Hz, 500 Hz, 2 % noise on x, v, a
and u. Each line of the study changes one thing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from bayeq.dictionary import Variables, build_dictionary
from bayeq.records import Record
from bayeq.systems import BandLimitedForce, System, simulate
from bayeq.systems.simulate import band_limited_noise

__all__ = ["CASES", "CHANNELS", "Case", "draw_record"]

Floats = NDArray[np.float64]
Rng = np.random.Generator
Spoil = Callable[[Record, Rng], Mapping[str, Floats]]

ROWS, RATE, FINER = 4000, 500.0, 10
FORCE = BandLimitedForce(20.0, (0.0, 15.0))
WHITE = BandLimitedForce(20.0, (0.0, RATE))
NOISE = 0.02
CHANNELS = ("x", "v", "a", "u")
RESONANCE = 4.7  # of the motion, which the cubic spring stiffens

SYSTEM = System(
    name="adverse-duffing",
    title="Duffing oscillator under adverse measurement",
    chains=("x:v:a",),
    rhs={"x": "v", "v": "u-c*v-k*x-k3*x**3"},
    terms={"a": {"x": "-k", "v": "-c", "x**3": "-k3", "u": "1"}},
    parameters={"k": 400.0, "c": 1.2, "k3": 2.5e4},
    initial={"x": 0.0, "v": 0.0},
    inputs=("u",),
    force=FORCE,
    n=ROWS,
    fs=RATE,
    noise=NOISE,
    citation="made for this study",
)


def _with(change: str, **terms: str) -> System:
    """The system with something added to its acceleration, and w among its inputs if that is in it."""
    inputs = ("u", "w") if "w" in change else ("u",)
    rhs = {"x": "v", "v": SYSTEM.rhs["v"] + change}
    return replace(SYSTEM, rhs=rhs, inputs=inputs, terms={"a": {**SYSTEM.terms["a"], **terms}})


# Rows in which free motion decays to 1e-5 of itself.
STEADY = 10_000

# --- forces ----------------------------------------------------------------------------------------------------------


def _force(band: BandLimitedForce, n: int, fs: float, rng: Rng) -> Floats:
    return band_limited_noise(band, n, fs, rng)[:, None]


def _usual(n: int, fs: float, rng: Rng) -> Floats:
    return _force(FORCE, n, fs, rng)


def _sine(n: int, fs: float, rng: Rng) -> Floats:
    """A steady sine somewhere between 3 and 6 Hz."""
    frequency, phase = rng.uniform(3.0, 6.0), rng.uniform(0.0, 2.0 * np.pi)
    return FORCE.std * np.sqrt(2.0) * np.sin(2.0 * np.pi * frequency * np.arange(n) / fs + phase)[:, None]


def _with_second(share: float, n: int, fs: float, rng: Rng) -> Floats:
    """The force, and a second one of a share of its size."""
    second = replace(FORCE, std=share * FORCE.std)
    return np.hstack([_usual(n, fs, rng), _force(second, n, fs, rng)])


def _with_ramp(end: float, n: int, fs: float, rng: Rng) -> Floats:
    """The force, and what rises from 0 to `end` over the record."""
    return np.hstack([_usual(n, fs, rng), np.linspace(0.0, end, n)[:, None]])


# --- what spoils samples ---------------------------------------------------------------------------------------------


def _nothing(record: Record, rng: Rng) -> Mapping[str, Floats]:
    return {}


def _spike(channel: str, record: Record, rng: Rng) -> Mapping[str, Floats]:
    """One sample off by 100 sd, somewhere in the inner nine tenths."""
    values = record[channel].copy()
    row = int(rng.integers(record.n // 20, record.n - record.n // 20))
    values[row] += rng.choice([-1.0, 1.0]) * 100.0 * values.std()
    return {channel: values}


def _outliers(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """0.5 % of the samples of each channel times ten."""
    return {name: np.where(rng.random(record.n) < 0.005, 10.0, 1.0) * record[name] for name in CHANNELS}


def _clipped(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """The motion's channels cut at 80 % of their peak."""
    peaks = {name: 0.8 * float(np.abs(record[name]).max()) for name in ("x", "v", "a")}
    return {name: np.clip(record[name], -peak, peak) for name, peak in peaks.items()}


def _stuck(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """The acceleration keeps its value for 5 % of the rows."""
    values, length = record["a"].copy(), record.n // 20
    first = int(rng.integers(record.n // 20, record.n - 2 * length))
    values[first : first + length] = values[first]
    return {"a": values}


def _drifting(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """The displacement drifts by half of its sd over the record."""
    return {"x": record["x"] + 0.5 * record["x"].std() * np.linspace(0.0, 1.0, record.n)}


def _quantised(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """8 bits over the range of each channel."""
    steps = {name: 2.0 * float(np.abs(record[name]).max()) / 255.0 for name in CHANNELS}
    return {name: step * np.round(record[name] / step) for name, step in steps.items()}


def _gain(record: Record, rng: Rng) -> Mapping[str, Floats]:
    return {"v": 1.03 * record["v"]}


def _delayed(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """The force arrives a sample late."""
    return {"u": np.append(record["u"][0], record["u"][:-1])}


# --- other noise, on the clean channels ------------------------------------------------------------------------------


def _noisy(noise: Callable[[int, Rng], Floats], record: Record, rng: Rng) -> Mapping[str, Floats]:
    """Noise of unit variance, as large as the usual one, on the clean channels."""
    assert record.truth is not None
    clean, sd = record.truth.clean, record.truth.noise_sd
    return {name: clean[name] + sd[name] * noise(record.n, rng) for name in CHANNELS}


def _student(n: int, rng: Rng) -> Floats:
    return rng.standard_t(3, n) / np.sqrt(3.0)


def _pink(n: int, rng: Rng) -> Floats:
    """Density 1/f."""
    lines = np.fft.rfft(rng.standard_normal(n))
    lines[1:] /= np.sqrt(np.arange(1, len(lines)))
    lines[0] = 0.0
    values = np.fft.irfft(lines, n)
    return np.asarray(values / values.std())


def _resonant(n: int, rng: Rng) -> Floats:
    """Half an octave about the resonance."""
    values = band_limited_noise(BandLimitedForce(1.0, (0.84 * RESONANCE, 1.19 * RESONANCE)), n, RATE, rng)
    return np.asarray(values / values.std())


def _humming(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """50 Hz of 2 % in all channels, besides the noise."""
    assert record.truth is not None
    sd, phase = record.truth.noise_sd, rng.uniform(0.0, 2.0 * np.pi)
    hum = np.sqrt(2.0) * np.sin(2.0 * np.pi * 50.0 * np.arange(record.n) / RATE + phase)
    return {name: record[name] + sd[name] * hum for name in CHANNELS}


def _jittered(record: Record, rng: Rng) -> Mapping[str, Floats]:
    """Samples are taken off their stamps by 0.1 of a step (sd)."""
    assert record.truth is not None
    clean, sd, rows = record.truth.clean, record.truth.noise_sd, np.arange(record.n)
    taken = rows + 0.1 * rng.standard_normal(record.n)
    return {name: CubicSpline(rows, clean[name])(taken) + sd[name] * rng.standard_normal(record.n) for name in CHANNELS}


# --- the lines -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A kind of record.

    Attributes
    ----------
    spoil : callable
        From a measured record and random numbers to the channels that are changed.
    system : System
        What moves; an input w is not measured.
    force : callable
        Clean inputs (n, inputs) from a number of rows, a rate and random numbers.
    rows : tuple of int
        Lengths of records that are measured.
    on_request : tuple of int
        Further lengths, measured only when asked for.
    noise : float
        Ratio on every channel.
    without : tuple of str
        Terms that the dictionary lacks.
    finer : int
        Steps of the simulation per sample; 1 where the force is a straight line between its samples.
    before : int
        Rows of motion before the record, in which it becomes steady.
    """

    spoil: Spoil = _nothing
    system: System = SYSTEM
    force: Callable[[int, float, Rng], Floats] = _usual
    rows: tuple[int, ...] = (ROWS,)
    on_request: tuple[int, ...] = ()
    noise: float = NOISE
    without: tuple[str, ...] = field(default=())
    finer: int = FINER
    before: int = 0

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms offered."""
        terms = build_dictionary("oscillator", Variables(("x", "v"), ("u",)))
        return tuple(term.text for term in terms if term.text not in self.without)


CASES: Mapping[str, Case] = {
    "clean": Case(),
    "spike in x": Case(partial(_spike, "x")),
    "spike in u": Case(partial(_spike, "u")),
    "spike in a": Case(partial(_spike, "a")),
    "0.5 % of samples times 10": Case(_outliers),
    "clipped at 80 %": Case(_clipped),
    "stuck a": Case(_stuck),
    "t3 noise": Case(partial(_noisy, _student)),
    "1/f noise": Case(partial(_noisy, _pink)),
    "noise at the resonance": Case(partial(_noisy, _resonant)),
    "hum": Case(_humming),
    "8 bit": Case(_quantised),
    "jitter": Case(_jittered),
    "gain of v": Case(_gain),
    "delay of u": Case(_delayed),
    "drift of x": Case(_drifting),
    "stiffness drifts": Case(system=_with("-k*w*x"), force=partial(_with_ramp, 0.05)),
    "second force of 10 %": Case(system=_with("+w"), force=partial(_with_second, 0.1), on_request=(70_000, 1_000_000)),
    "second force of 30 %": Case(system=_with("+w"), force=partial(_with_second, 0.3), on_request=(70_000, 1_000_000)),
    "white force": Case(force=partial(_force, WHITE), finer=1),
    "steady sine": Case(force=_sine, before=STEADY),
    "low amplitude": Case(force=partial(_force, replace(FORCE, std=1.0))),
    "few rows": Case(rows=(60, 100, 200)),
    "no x**3 offered": Case(without=("x**3",)),
    "tanh friction": Case(system=_with("-5*tanh(v/0.2)", **{"sign(v)": "-5"})),
    "weak x**3": Case(
        system=replace(SYSTEM, parameters={**SYSTEM.parameters, "k3": 250.0}), noise=0.05, rows=(20_000,)
    ),
}


def draw_record(case: Case, rows: int, seed: int) -> Record:
    """A record of a case: channels x, v, a and u, and the truth of their clean motion."""
    motion, spoiling = (np.random.default_rng(stream) for stream in np.random.SeedSequence([seed, rows]).spawn(2))
    inputs = case.force((case.before + rows) * case.finer, RATE * case.finer, motion)
    noise = dict.fromkeys(CHANNELS, case.noise)
    fine = simulate(case.system, fs=RATE * case.finer, seed=seed, noise=noise, force=inputs)
    record = fine.slice(case.before * case.finer, None, case.finer)
    channels = {**{name: record[name] for name in CHANNELS}, **case.spoil(record, spoiling)}
    return Record(channels, np.arange(rows) / RATE, name=case.system.name, truth=record.truth)
