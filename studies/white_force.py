"""A force that is white up to half the sampling rate: does noise on it spoil the coefficients and their intervals?

The Duffing oscillator, 5 % noise on displacement, velocity, acceleration and force, all 36 terms, all rows used.
Between its samples the force is a straight line.

    python -m studies.white_force > docs/tables/white_force.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from bayeq.discovery import discover
from bayeq.records import Record
from bayeq.systems import simulate
from studies.judge import coefficient_lines, judged, rates, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["draw_record", "main"]

ROWS = (4000, 20_000)
RECORDS = 40
FORCE = 50.0
NOISE = 0.05


def draw_record(rows: int, seed: int) -> Record:
    """A noisy record under white force."""
    force = FORCE * np.random.default_rng([seed, rows]).standard_normal(rows)
    return simulate("duffing", seed=seed, noise=NOISE, force=force)


def _measure(rows: int, seed: int) -> Outcome:
    record = draw_record(rows, seed)
    assert record.truth is not None
    truth = record.truth.coefficients
    fit = partial(
        discover,
        record,
        displacement="x",
        velocity="v",
        acceleration="a",
        force="u",
        holdout=0.0,
    )
    return timed(fit, lambda eqs: judged(eqs, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    cpu = rates(outcomes)["median_cpu_seconds"]
    for line in coefficient_lines(outcomes):
        yield {**line, "median_cpu_seconds": cpu}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [Cell({"rows": rows, "method": "auto"}, RECORDS, partial(_measure, rows)) for rows in ROWS]
    run_study(
        "white_force", "Coverage under a force that is white up to half the sampling rate.", cells, _summary, arguments
    )


if __name__ == "__main__":
    main()
