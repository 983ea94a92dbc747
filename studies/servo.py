"""A servo stage in closed loop, of which the encoder and the commanded force are recorded: mass and friction.

37 kg, viscous friction of 96.5 N s/m on average, 13 more where dq > 0 than where dq < 0 (6.5 of abs(dq)), Coulomb
friction of 12 N, an offset of 1.5 N, cogging of 0.3 N with a period of 16 mm. PD control (8 Hz, damping 0.7, the
derivative of the encoder behind a lag of 100 Hz) follows a reference of accelerations of +-1 m/s^2 between 0 and 0.2
m, from a phase of its period that is drawn, as is the cogging's. 2 kHz, 20 s, encoder steps of 4 um; the force is
held between samples and measured with a noise of sd 0.05 N. Terms given: dq, sign(dq), abs(dq), F; all rows used.
Success: the mass within 1 %, viscous and Coulomb friction within 4 %, from the coefficients' ratios to that of the
force.

    python -m studies.servo > docs/tables/servo.csv
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.records import Record
from studies.judge import timed
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["TERMS", "Stage", "draw_record", "main"]

RECORDS = 10

MASS, VISCOUS, UNEVEN, COULOMB, OFFSET = 37.0, 96.5, 6.5, 12.0, 1.5
COGGING, PITCH = 0.3, 0.016

RATE, SECONDS = 2000.0, 20.0
# Steps of Runge and Kutta's method per sample.
SUBSTEPS = 4

STROKE, ACCELERATION = 0.2, 1.0
BANDWIDTH, DAMPING, LAG = 2 * math.pi * 8.0, 0.7, 2 * math.pi * 100.0
ENCODER, FORCE_NOISE = 4e-6, 0.05

TERMS = ("dq", "sign(dq)", "abs(dq)", "F")

# What is judged, and how far it may be off.
LIMITS = {"mass": 0.01, "viscous": 0.04, "coulomb": 0.04}


@dataclass(frozen=True)
class Stage:
    """A stage, its encoder's step [m], and the rate of its loop with steps of integration per sample; SI units."""

    mass: float = MASS
    viscous: float = VISCOUS
    uneven: float = UNEVEN
    coulomb: float = COULOMB
    offset: float = OFFSET
    cogging: float = COGGING
    encoder: float = ENCODER
    rate: float = RATE
    substeps: int = SUBSTEPS


SERVO = Stage()


def reference(time: float) -> tuple[float, float]:
    """Position and velocity that are asked for: there and back, each half of a stroke under constant acceleration."""
    half = math.sqrt(STROKE / ACCELERATION)
    stroke, since = divmod(time, 2 * half)
    late = max(since - half, 0.0)
    way = ACCELERATION * (since**2 / 2 - late**2)
    speed = ACCELERATION * (since - 2 * late)
    return (way, speed) if stroke % 2 == 0 else (STROKE - way, -speed)


def _acceleration(q: float, dq: float, stage: Stage, force: float, phase: float) -> float:
    friction = stage.viscous * dq + stage.uneven * abs(dq) + math.copysign(stage.coulomb, dq) + stage.offset
    return (force - friction - stage.cogging * math.sin(2 * math.pi * q / PITCH + phase)) / stage.mass


def _step(q: float, dq: float, acceleration: Callable[[float, float], float], h: float) -> tuple[float, float]:
    """One step of Runge and Kutta's method."""
    a1 = acceleration(q, dq)
    v2 = dq + h / 2 * a1
    a2 = acceleration(q + h / 2 * dq, v2)
    v3 = dq + h / 2 * a2
    a3 = acceleration(q + h / 2 * v2, v3)
    v4 = dq + h * a3
    a4 = acceleration(q + h * v3, v4)
    return q + h / 6 * (dq + 2 * v2 + 2 * v3 + v4), dq + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def draw_record(seed: int, stage: Stage = SERVO) -> Record:
    """Encoder q [m] and measured force F [N]."""
    rng = np.random.default_rng(seed)
    n, dt = round(SECONDS * stage.rate), 1.0 / stage.rate
    start, phase = rng.uniform(0.0, 4 * math.sqrt(STROKE / ACCELERATION)), rng.uniform(0.0, 2 * math.pi)
    stiffness, damper = stage.mass * BANDWIDTH**2, 2 * DAMPING * stage.mass * BANDWIDTH
    forget = math.exp(-LAG * dt)
    q, dq = reference(start)
    seen, speed = round(q / stage.encoder) * stage.encoder, dq
    encoder, force = np.empty(n), np.empty(n)
    for k in range(n):
        previous, seen = seen, round(q / stage.encoder) * stage.encoder
        if k:
            speed = forget * speed + (1 - forget) * (seen - previous) / dt
        asked, asked_speed = reference(start + k * dt)
        held = stiffness * (asked - seen) + damper * (asked_speed - speed)
        encoder[k], force[k] = seen, held
        law = partial(_acceleration, stage=stage, force=held, phase=phase)
        for _ in range(stage.substeps):
            q, dq = _step(q, dq, law, dt / stage.substeps)
    measured = force + FORCE_NOISE * rng.standard_normal(n)
    return Record.from_arrays({"q": encoder, "F": measured}, fs=stage.rate)


def _errors(eqs: Equations) -> dict[str, float | None]:
    """Relative errors of what is judged; None where a term is missing."""
    coef = eqs[0].coef
    gain, viscous, coulomb = (coef.get(name) for name in ("F", "dq", "sign(dq)"))
    return {
        "mass": None if gain is None else 1.0 / (gain * MASS) - 1.0,
        "viscous": None if gain is None or viscous is None else -viscous / (gain * VISCOUS) - 1.0,
        "coulomb": None if gain is None or coulomb is None else -coulomb / (gain * COULOMB) - 1.0,
    }


def _measure(seed: int) -> Outcome:
    record = draw_record(seed)
    fit = partial(discover, record, chains=["q::"], inputs=["F"], dictionary=TERMS, holdout=0.0)
    return timed(fit, lambda eqs: {"errors": _errors(eqs), "included": list(eqs[0].included)})


def within(outcome: Outcome, name: str) -> bool:
    """Whether something judged is as near to the truth as it should be."""
    error = outcome.get("errors", {}).get(name)
    return error is not None and abs(error) <= LIMITS[name]


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    n, good = len(outcomes), sum(all(within(outcome, name) for name in LIMITS) for outcome in outcomes)
    line: dict[str, object] = {"all_within": good, "all_within_percent": percent(good, n)}
    for name, limit in LIMITS.items():
        known = [outcome.get("errors", {}).get(name) for outcome in outcomes]
        errors = np.array([error for error in known if error is not None])
        line[f"{name}_within_{100 * limit:g}_percent"] = sum(within(outcome, name) for outcome in outcomes)
        line[f"{name}_mean_error_percent"] = f"{100 * errors.mean():.2f}" if len(errors) else ""
        line[f"{name}_worst_error_percent"] = f"{100 * np.abs(errors).max():.2f}" if len(errors) else ""
    cpu = [outcome["cpu"] for outcome in outcomes if outcome["cpu"] is not None]
    yield {**line, "errors": n - len(cpu), "median_cpu_seconds": f"{np.median(cpu):.2f}" if cpu else ""}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"method": "auto"}, RECORDS, _measure)]
    run_study("servo", "Mass and friction of a servo stage in closed loop.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
