"""Maps in noisy samples: the logistic map, that of Henon, and one that an input drives.

    python -m studies.maps --first-seed 230000 > docs/tables/maps.csv

300 samples; noise is a share of each channel's standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from bayeq.arrays import Floats
from bayeq.discovery import discover
from bayeq.records import Record
from studies.judge import CONSTANT, timed, verdict_lines, with_verdict
from studies.resumable import Outcome, by_noise, run_study

RECORDS, ROWS = 40, 300
NOISES = (0.01, 0.05)

Drawn = tuple[dict[str, Floats], dict[str, float]]


def logistic(rng: np.random.Generator) -> Drawn:
    """x[+1] = r x (1 - x), r from 3.6 to 3.9."""
    r, x = rng.uniform(3.6, 3.9), np.full(ROWS, rng.uniform(0.2, 0.8))
    for k in range(ROWS - 1):
        x[k + 1] = r * x[k] * (1.0 - x[k])
    return {"x": x}, {"x": r, "x**2": -r}


def henon(rng: np.random.Generator) -> Drawn:
    """x[+1] = 1 - 1.4 x**2 + 0.3 x[-1]."""
    x = np.zeros(ROWS + 100)
    x[:2] = rng.uniform(-0.1, 0.1, 2)
    for k in range(1, len(x) - 1):
        x[k + 1] = 1.0 - 1.4 * x[k] ** 2 + 0.3 * x[k - 1]
    return {"x": x[100:]}, {CONSTANT: 1.0, "x**2": -1.4, "x[-1]": 0.3}


def driven(rng: np.random.Generator) -> Drawn:
    """x[+1] = 0.8 x - 0.1 x**3 + 0.5 u under independent samples of u."""
    u, x = rng.standard_normal(ROWS), np.zeros(ROWS)
    for k in range(ROWS - 1):
        x[k + 1] = 0.8 * x[k] - 0.1 * x[k] ** 3 + 0.5 * u[k]
    return {"x": x, "u": u}, {"x": 0.8, "x**3": -0.1, "u": 0.5}


SYSTEMS: dict[str, tuple[Callable[[np.random.Generator], Drawn], dict[str, object]]] = {
    "logistic": (logistic, {"dictionary": "polynomial:3"}),
    "Henon": (henon, {"dictionary": "x, x**2, x**3, x[-1], x*x[-1], x[-1]**2"}),
    "driven": (driven, {"dictionary": "x, x**2, x**3, x[-1], u, u[-1]", "inputs": ["u"]}),
}


def _measure(name: str, noise: float, seed: int) -> Outcome:
    simulated, asked = SYSTEMS[name]
    channels, truth = simulated(np.random.default_rng([seed, 1]))
    rng = np.random.default_rng([seed, 2])
    noisy = {key: one + noise * one.std() * rng.standard_normal(ROWS) for key, one in channels.items()}
    ask = partial(discover, Record.from_arrays(noisy), chains="x", discrete=True, **asked)  # type: ignore[arg-type]
    return timed(ask, partial(with_verdict, {"x[+1]": truth}))


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = by_noise(SYSTEMS, NOISES, RECORDS, _measure)
    run_study("maps", "Maps in noisy samples.", cells, verdict_lines, arguments)


if __name__ == "__main__":
    main()
