"""Epidemics whose numbers add up: terms found with the sum known not to change, and without.

    python -m studies.conserved --first-seed 230000 > docs/tables/conserved.csv

dS = -b S I, dI = b S I - g I, dR = g I, 200 daily rows with 5 % of noise; nine candidates in each equation.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from bayeq.discovery import discover
from bayeq.records import Record
from studies.judge import timed, verdict_lines, with_verdict
from studies.resumable import Cell, Outcome, run_study

RECORDS, ROWS, NOISE = 20, 200, 0.05
TERMS = "polynomial:2"


def epidemic(seed: int) -> tuple[Record, dict[str, dict[str, float]]]:
    """A record, and its equations."""
    rng = np.random.default_rng([seed, 1])
    b, g, first = rng.uniform(0.8, 1.5), rng.uniform(0.2, 0.4), rng.uniform(0.005, 0.02)
    time = np.linspace(0.0, 30.0, ROWS)

    def rate(_: float, y: list[float]) -> list[float]:
        return [-b * y[0] * y[1], b * y[0] * y[1] - g * y[1], g * y[1]]

    states = solve_ivp(rate, (0.0, time[-1]), [1.0 - first, first, 0.0], t_eval=time, rtol=1e-9, atol=1e-11).y
    noisy = {name: one + NOISE * one.std() * rng.standard_normal(ROWS) for name, one in zip("SIR", states, strict=True)}
    truth = {"dS": {"S*I": -b}, "dI": {"S*I": b, "I": -g}, "dR": {"I": g}}
    return Record.from_arrays(noisy, time=time), truth


def _measure(conserve: str, seed: int) -> Outcome:
    record, truth = epidemic(seed)
    ask = partial(discover, record, chains=["S", "I", "R"], dictionary=TERMS, conserve=conserve)
    return timed(ask, partial(with_verdict, truth))


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"sum": known or "not known"}, RECORDS, partial(_measure, known)) for known in ("S + I + R", "")]
    run_study("conserved", "A sum of states that does not change.", cells, verdict_lines, arguments)


if __name__ == "__main__":
    main()
