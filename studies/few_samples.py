"""Coarsely sampled records: 4 to 12 samples in a period of the highest frequency of the force.

    python -m studies.few_samples --first-seed 440000 > docs/tables/few_samples.csv

Oscillators, linear and with a cubic spring, parameters drawn; a force of 20 lines up to 1.2 to 2 times the natural
frequency, 1,000 rows of the steady motion. Displacement and acceleration have 0.3 % of noise, and the force has as much
or none. The motion is integrated to a relative error of 1e-9, so that nothing but the samples is coarse. Exact is an
answer with the true terms; intervals are those of exact answers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from bayeq.arrays import Floats
from bayeq.discovery import discover
from bayeq.records import Record
from studies.judge import coefficient_lines, timed, verdict_lines, with_verdict
from studies.resumable import Cell, Outcome, run_study

RECORDS, ROWS, NOISE, LINES = 16, 1000, 0.003, 20
SAMPLES = (4, 5, 6, 8, 12)


def draw_record(samples: int, exact_force: bool, seed: int) -> tuple[Record, dict[str, dict[str, float]]]:
    """A record with so many samples per period, and the truth; every second one has a cubic spring."""
    rng = np.random.default_rng([seed, 1])
    natural, damping = 10.0 ** rng.uniform(0.0, 1.0), rng.uniform(0.02, 0.1)
    k = (2.0 * math.pi * natural) ** 2
    c, k3 = 2.0 * damping * math.sqrt(k), k * rng.uniform(0.3, 3.0) * (seed % 2)
    highest = natural * rng.uniform(1.2, 2.0)
    w = 2.0 * math.pi * np.linspace(0.2 * natural, highest, LINES) * rng.uniform(0.97, 1.0, LINES)
    size, phase = 0.1 * k * rng.uniform(0.5, 1.0, LINES), rng.uniform(0.0, 2.0 * math.pi, LINES)

    def force(t: float | Floats) -> Floats:
        return np.asarray(np.sin(np.multiply.outer(t, w) + phase) @ size)

    def rate(t: float, y: Floats) -> list[float]:
        x, v = y.tolist()
        return [v, float(force(t)) - c * v - k * x - k3 * x**3]

    time = np.arange(ROWS) / (samples * highest)
    settled = -3.0 / (damping * 2.0 * math.pi * natural)
    x, v = solve_ivp(rate, (settled, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-10).y
    channels = {"x": x, "a": force(time) - c * v - k * x - k3 * x**3, "u": force(time)}
    draw = np.random.default_rng([seed, 2])
    noisy = {name: one + NOISE * one.std() * draw.standard_normal(ROWS) for name, one in channels.items()}
    truth = {"x": -k, "dx": -c, "u": 1.0} | ({"x**3": -k3} if k3 else {})
    return Record.from_arrays(noisy | ({"u": channels["u"]} if exact_force else {}), time=time), {"a": truth}


def _measure(samples: int, exact_force: bool, seed: int) -> Outcome:
    record, truth = draw_record(samples, exact_force, seed)
    return timed(partial(discover, record, chains="x::a", inputs=["u"]), partial(with_verdict, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    together = coefficient_lines(outcomes)[0]
    for line in verdict_lines(outcomes):
        yield {**line, "rms_error_over_sd": together["rms_error_over_sd"]}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"samples_per_period": n, "force": "exact" if exact else "noisy"}, RECORDS, partial(_measure, n, exact))
        for exact in (False, True)
        for n in SAMPLES
    ]
    run_study("few_samples", "Records with few samples per period.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
