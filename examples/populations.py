"""Lynx and hare: 21 rows, differentiated coarsely and then refined."""

from __future__ import annotations

from pathlib import Path

import bayeq as bq
from examples.page import Example, draw

NAME = "populations"
FILE = "lynx_hare/hudson-bay-lynx-hare.csv"

# Posterior medians of B. Carpenter's Stan case study, in the README of the record.
PUBLISHED = {
    ("dHare", "Hare"): 0.55,
    ("dHare", "Hare*Lynx"): -0.028,
    ("dLynx", "Lynx"): -0.80,
    ("dLynx", "Hare*Lynx"): 0.024,
}


def run(example: Example, data: Path) -> None:
    """Discover, refine, and compare the rates with published ones."""
    with example.block("found"):
        rec = bq.read(data / "lynx_hare/hudson-bay-lynx-hare.csv", time="Year")
        eq = bq.discover(rec, chains=["Hare", "Lynx"], dictionary="polynomial:2")
        print(eq)
    with example.block("refined"):
        better = eq.refine(rec)
        for one in (eq, better):
            run = one.simulate(rec, draws=0)
            print(f"{one[0].text};  {one[1].text}")
            print(f"    free run: Hare {100 * run.nrmse['Hare']:.0f} %, Lynx {100 * run.nrmse['Lynx']:.0f} %")

    for (target, term), published in PUBLISHED.items():
        for how, one in (("regression", eq), ("refined", better)):
            rate = one[target].shown_coef[term]
            example.numbers[f"{term} in {target}, {how}"] = (
                f"{rate:.4f}: {100 * (rate / published - 1):+.0f} % from {published}"
            )
    example.figure = draw(
        [("regression", eq.simulate(rec)), ("the same terms, refined", better.simulate(rec))],
        "year",
    )
