"""Two coupled masses of Schmidt and Lipson: a law whose parts check each other."""

from __future__ import annotations

from pathlib import Path

import bayeq as bq
from examples.page import Example, draw

NAME = "coupled"
FILE = "schmidt_lipson/real_double_linear_h_1.txt"


def run(example: Example, data: Path) -> None:
    """Discover both equations and read masses and springs from them."""
    with example.block("found"):
        rec = bq.read(data / "schmidt_lipson/real_double_linear_h_1.txt")
        eq = bq.discover(rec, chains=["x1:v1:", "x2:v2:"], dictionary="polynomial:1")
        print(eq)
    with example.block("springs"):
        one, two = eq[0].shown_coef, eq[1].shown_coef
        print(f"mass 1 / mass 2 from the coupling: {two['x1'] / one['x2']:.3f}")
        outer = -(one["x1"] + one["x2"]), -(two["x2"] + two["x1"])
        ratio = outer[0] / outer[1] * two["x1"] / one["x2"]
        print(f"outer springs: {outer[0]:.2f} per mass 1, {outer[1]:.2f} per mass 2, ratio of stiffness {ratio:.2f}")
    with example.block("runs", shown=False):
        wider = bq.discover(rec, chains=["x1:v1:", "x2:v2:"], dictionary="polynomial:2")
        print(f"verdict: {wider.verdict}")
        print(f"{wider[0].text};  {wider[1].text}")
        for name, found in (("polynomial:1", eq), ("polynomial:2", wider)):
            nrmse = found.simulate(rec, draws=0).nrmse
            print(f"{name}: free run of the whole record: x1 {100 * nrmse['x1']:.1f} %, x2 {100 * nrmse['x2']:.1f} %")
    example.figure = draw([(f"{eq[0].text};  {eq[1].text}", eq.simulate(rec))], "time [s]")
