"""Forces of many kinds: is an exact law found, whatever the force does between samples, and however little noise?

The paper's oscillators in turn, parameters perturbed by 10 %, 4,000 rows at 1 kHz of motion that is integrated ten
times finer; displacement, velocity, acceleration and force measured with noise of
a share of each channel's standard deviation, log-uniform between the limits given. "straight" is the paper's force,
joined by straight lines between samples; "held" keeps the value of a sample until the next; "blows" are half sines of 4
to 12 ms, "taps" of 1.5 to 4 ms, two a second on average, and a multisine, a sweep and a band-limited force are smooth.

    python -m studies.forces > docs/tables/forces.csv
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.equation.verdict import KINDS
from bayeq.records import Record
from bayeq.systems import BandLimitedForce, get_system, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.judge import judged, rates, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["FORCES", "draw_record", "main"]

Floats = NDArray[np.float64]
Rng = np.random.Generator
Force = Callable[[Floats, Rng], Floats]

OSCILLATORS = ("linear", "duffing", "quadratic", "coulomb")
ROWS, RATE, STD, HIGHEST = 4000, 1000.0, 50.0, 60.0
RECORDS = 40
NOISES = {"0": (0.0, 0.0), "0.05 to 0.7": (5e-4, 7e-3), "1 to 5": (0.01, 0.05)}


def _blows(shortest: float, longest: float, time: Floats, rng: Rng) -> Floats:
    force, at = np.zeros(len(time)), 0.05
    while at < time[-1]:
        width = rng.uniform(shortest, longest)
        inside = (time >= at) & (time < at + width)
        # of the same impulse, whatever the width
        peak = rng.uniform(2.4, 7.2) / width * rng.choice([-1.0, 1.0])
        force[inside] = peak * np.sin(np.pi * (time[inside] - at) / width)
        at += rng.uniform(0.3, 0.7)
    return force


def _multisine(time: Floats, rng: Rng) -> Floats:
    lines = np.arange(1, int(HIGHEST * time[-1] / 2.0)) * 2.0 / time[-1]
    phases = rng.uniform(0.0, 2.0 * np.pi, len(lines))
    waves = (np.cos(2.0 * np.pi * line * time + phase) for line, phase in zip(lines, phases, strict=True))
    return np.asarray(STD * np.sqrt(2.0 / len(lines)) * sum(waves))


def _sweep(time: Floats, rng: Rng) -> Floats:
    turns = time + (HIGHEST - 1.0) * time**2 / (2.0 * time[-1])
    return np.asarray(STD * np.sqrt(2.0) * np.sin(2.0 * np.pi * turns + rng.uniform(0.0, 2.0 * np.pi)))


def _band(time: Floats, rng: Rng) -> Floats:
    band = BandLimitedForce(STD, (0.0, float(rng.uniform(20.0, 100.0))))
    return band_limited_noise(band, len(time), 1.0 / float(time[1]), rng)


def _held(time: Floats, rng: Rng) -> Floats:
    return STD * rng.standard_normal(len(time))


FORCES: Mapping[str, Force | None] = {
    "straight": None,
    "held": _held,
    "blows": partial(_blows, 0.004, 0.012),
    "taps": partial(_blows, 0.0015, 0.004),
    "multisine": _multisine,
    "sweep": _sweep,
    "band": _band,
}


def draw_record(kind: str, noise: tuple[float, float], seed: int) -> tuple[Record, Mapping[str, Mapping[str, float]]]:
    """A record of displacement, velocity, acceleration and force, and the true coefficients."""
    rng, system, force = np.random.default_rng([seed, 5]), get_system(OSCILLATORS[seed % 4]), FORCES[kind]
    finer = 1 if force is None or kind == "held" else 10
    samples = None if force is None else force(np.arange(ROWS * finer) / (RATE * finer), rng)
    clean = simulate(
        replace(system, substeps=10) if kind == "held" else system,
        fs=RATE * finer,
        seed=seed,
        noise=0.0,
        perturb=0.1,
        force=samples,
        interpolation="hold" if kind == "held" else "linear",
    )
    share = float(np.exp(rng.uniform(*np.log(noise)))) if noise[0] > 0.0 else 0.0
    channels = {name: clean[name][::finer] for name in ("x", "v", "a", "u")}
    assert clean.truth is not None
    channels = {name: y + share * y.std() * rng.standard_normal(len(y)) for name, y in channels.items()}
    return Record.from_arrays(channels, fs=RATE), clean.truth.coefficients


def _judged(truth: Mapping[str, Mapping[str, float]], eqs: Equations) -> dict[str, object]:
    return {**judged(eqs, truth), "verdict": eqs.verdict.kind}


def _measure(kind: str, noise: tuple[float, float], seed: int) -> Outcome:
    record, truth = draw_record(kind, noise, seed)
    return timed(partial(discover, record, chains="x:v:a", inputs=["u"]), partial(_judged, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    known = [outcome for outcome in outcomes if outcome["cpu"] is not None]
    verdicts = {kind.replace(" ", "_"): sum(one["verdict"] == kind for one in known) for kind in KINDS}
    wrong = sum(one["verdict"] == "found" and not one["exact"] for one in known)
    yield {**verdicts, "found_and_wrong": wrong, **rates(outcomes)}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"force": kind, "noise_percent": name}, RECORDS, partial(_measure, kind, noise))
        for name, noise in NOISES.items()
        for kind in FORCES
    ]
    run_study("forces", "Exact laws under forces of many kinds.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
