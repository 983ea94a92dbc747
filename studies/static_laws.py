"""Static laws: are the terms of a damper's force found, with noise in all channels, and do their intervals cover?

A damper on a test machine, 2000 rows at 200 Hz: a multisine displacement x of 0.3 to 3 Hz, its velocity v, and the
force F, of which a part is viscous and a part that of a spring. The rest is tanh or Coulomb friction, or quadratic
damping. Noise is a share of each channel's standard deviation, of x, v and F alike. `offered` is quadratic damping with
tanh offered, which the record does not hold and which stands for v at large constants.

    python -m studies.static_laws --first-seed 171000 > docs/tables/static_laws.csv
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from bayeq.discovery import discover
from bayeq.records import Record
from studies.constants import judged_with_constants, summary
from studies.judge import timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["CASES", "draw_record", "main"]

RECORDS = 10
ROWS, RATE = 2000, 200.0
SINES, LOWEST = 10, 0.3
BESIDE = "x, v, x**2, x**3, v**3, v*abs(v), x*v, sign(v)"
TANH = "tanh(v/{v0})"


class Case(NamedTuple):
    """The term beside ``c*v + k*x``, and what is offered beside the usual candidates."""

    term: str
    offered: str = ""


CASES = {
    "tanh": Case(TANH, TANH),
    "sign": Case("sign(v)"),
    "quadratic": Case("v*abs(v)"),
    "offered": Case("v*abs(v)", TANH),
}


def draw_record(kind: str, noise: float, seed: int) -> tuple[Record, dict[str, float], dict[str, float]]:
    """A noisy record, its true coefficients, and the true constants."""
    term, rng = CASES[kind].term, np.random.default_rng([seed, 1])
    t, number = np.arange(ROWS) / RATE, np.arange(1, SINES + 1)
    omega = 2.0 * np.pi * LOWEST * number * np.exp(0.1 * rng.standard_normal(SINES))
    angle = omega * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, SINES)
    x = np.sin(angle) @ (1.0 / number)
    v = np.cos(angle) @ (omega / number)
    c, k, size, v0 = np.exp([rng.uniform(*np.log(ends)) for ends in ((1, 3), (3, 12), (8, 20), (0.2, 1.5))]).tolist()
    size = 0.1 * size if term == "v*abs(v)" else size
    shape = {TANH: np.tanh(v / v0), "sign(v)": np.sign(v), "v*abs(v)": v * np.abs(v)}[term]
    channels = {"x": x, "v": v, "F": c * v + k * x + size * shape}
    own = np.random.default_rng([seed, 2])
    noisy = {name: one + noise * one.std() * own.standard_normal(ROWS) for name, one in channels.items()}
    return Record.from_arrays(noisy, fs=RATE), {"x": k, "v": c, term: size}, {"v0": v0} if term == TANH else {}


def _measure(kind: str, noise: float, seed: int) -> Outcome:
    record, truth, constants = draw_record(kind, noise, seed)
    dictionary: list[str] = [BESIDE, *filter(None, [CASES[kind].offered])]
    ask = partial(discover, record, target="F", inputs=["x", "v"], dictionary=", ".join(dictionary))
    return timed(ask, partial(judged_with_constants, truth, constants))


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"kind": kind, "noise_percent": f"{100 * noise:g}"}, RECORDS, partial(_measure, kind, noise))
        for kind in CASES
        for noise in (0.01, 0.05)
    ]
    run_study("static_laws", "Static laws: which terms are found, and how well.", cells, summary, arguments)


if __name__ == "__main__":
    main()
