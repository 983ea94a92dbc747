"""Cascaded tanks: a record that must not be taken as explained, for the upper tank's level is not measured."""

from __future__ import annotations

from pathlib import Path

import bayeq as bq
from examples.page import Example, draw

NAME = "tanks"
FILE = "cascaded_tanks/dataBenchmark.csv"


def run(example: Example, data: Path) -> None:
    """Equations of first and of second order in the one level that is measured."""
    with example.block("found"):
        raw = bq.read(data / "cascaded_tanks/dataBenchmark.csv", fs=0.25)
        rec = bq.Record.from_arrays(time=raw.time, u=raw["uEst"], y=raw["yEst"], name="estimation")
        other = bq.Record.from_arrays(time=raw.time, u=raw["uVal"], y=raw["yVal"], name="validation")
        terms = ["y", "sqrt(y)", "y**2", "u", "u**2", "sqrt(u)", "y*u"]
        eq = bq.discover(rec, chains="y", inputs=["u"], dictionary=terms)
        print(eq)
        run = eq.simulate(other)
        print(run)
    with example.block("second", shown=False):
        terms = ["y", "sqrt(y)", "y**2", "dy", "dy*abs(dy)", "sqrt(y)*dy", "y*dy", "u"]
        second = bq.discover(rec, chains="y::", inputs=["u"], dictionary=terms)
        print(second)

    example.figure = draw(
        [
            (f"estimation record: {eq[0].text}", eq.simulate(rec)),
            ("validation record, the same equation", run),
        ],
        "time [s]",
    )
