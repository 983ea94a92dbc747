"""The double pendulum of Schmidt and Lipson: accelerations that hold each other, from two angles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import bayeq as bq
from examples.page import Example, draw

NAME = "double_pendulum"
FILE = "schmidt_lipson/real_double_pend_h_1.txt"


def run(example: Example, data: Path) -> None:
    """Discover both equations from the angles of one trial, run them, and solve them for the accelerations."""
    with example.block("found"):
        names = ["trial", "t", "p", "q", *(f"theirs{k}" for k in range(6))]
        rec = bq.read(data / "schmidt_lipson/real_double_pend_h_1.txt", names=names)
        rec = rec.take(rec["trial"] == 0)
        gravity = "sin(p), sin(q), cos(p), cos(q), "
        coupling = "dp**2*sin(p-q), dq**2*sin(p-q), ddp*cos(p-q), ddq*cos(p-q), "
        eq = bq.discover(rec, chains=["p::", "q::"], dictionary=gravity + coupling + "dp, dq, sign(dp), sign(dq)")
        print(eq)
    with example.block("rates"):
        print(np.round(eq.rhs(0.0, [0.5, 0.0, -0.5, 0.0]), 2).tolist())
    one, two = eq[0].shown_coef, eq[1].shown_coef
    example.numbers |= {
        **{equation.target: equation.text for equation in eq},
        "ratio of the two A": f"{one['ddq*cos(p-q)'] / one['dq**2*sin(p-q)']:.3f}",
        "ratio of the two C": f"{-two['ddp*cos(p-q)'] / two['dp**2*sin(p-q)']:.3f}",
    }
    example.figure = draw([("free run of the first 200 rows", eq.simulate(rec.take(slice(0, 200))))], "time [s]")
