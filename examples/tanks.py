"""Cascaded tanks: nothing is found in the one level that is measured, and Torricelli's law with the hidden one."""

from __future__ import annotations

from pathlib import Path

import bayeq as bq
from examples.page import Example, draw

NAME = "tanks"
FILE = "cascaded_tanks/dataBenchmark.csv"


def run(example: Example, data: Path) -> None:
    """Equations of first and of second order in the one level that is measured."""
    with example.block("level"):
        raw = bq.read(data / "cascaded_tanks/dataBenchmark.csv", fs=0.25)
        rec = bq.Record.from_arrays(time=raw.time, u=raw["uEst"], y=raw["yEst"], name="estimation")
        other = bq.Record.from_arrays(time=raw.time, u=raw["uVal"], y=raw["yVal"], name="validation")
        terms = ["y", "sqrt(y)", "y**2", "u", "u**2", "sqrt(u)", "y*u"]
        eq = bq.discover(rec, chains="y", inputs=["u"], dictionary=terms)
        print(eq.verdict)
        print(f"{eq[0].text}; free run of the other record: y {100 * eq.simulate(other).nrmse['y']:.0f} %")
    with example.block("found", shown=False):
        print(eq)
        run = eq.simulate(other)
        print(run)
    with example.block("second", shown=False):
        terms = ["y", "sqrt(y)", "y**2", "dy", "dy*abs(dy)", "sqrt(y)*dy", "y*dy", "u"]
        second = bq.discover(rec, chains="y::", inputs=["u"], dictionary=terms)
        print(second)

    with example.block("hidden"):
        law = "dh = u - {a: 0.02..10}*sqrt(abs(h))"
        both = bq.discover(
            rec, chains="y", inputs=["u"], dictionary={"dy": "sqrt(abs(h)), sqrt(y)"}, law=law, holdout=0.0
        )
        print(both)
        run = both.simulate(other)
        print(run)

    example.figure = draw(
        [
            (f"estimation record: {both[0].text}", both.simulate(rec)),
            ("validation record, the same equations", run),
        ],
        "time [s]",
    )
