"""The whole SS-VB fit against one least-squares solve, on the paper's dictionary matrix (N=2000, P=36).

    make bench        # or: python -m perf.fit_against_lstsq

Writes perf/results/fit_against_lstsq.csv.
"""

from __future__ import annotations

import csv
import os
import platform
from pathlib import Path

import numpy as np

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.inference.vb import spike_slab_vb
from perf.timing import medians

RESULTS = Path(__file__).parent / "results" / "fit_against_lstsq.csv"
SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")


def main() -> None:
    """Measure and write the table."""
    rows = []
    for system in SYSTEMS:
        record = bq.simulate(system, n=2000, seed=0)
        terms = build_dictionary("oscillator", Variables(("x", "v"), ("u",)))
        D, y = np.ascontiguousarray(evaluate_terms(terms, record.channels)), record["a"]
        standard = bq.Gram.from_data(D, y).standardise().gram
        seconds = medians(
            {
                "lstsq": lambda D=D, y=y: np.linalg.lstsq(D, y, rcond=None),
                "fit": lambda D=D, y=y: bq.SpikeSlabVB().fit(D, y),
                "gram": lambda D=D, y=y: bq.Gram.from_data(D, y),
                "engine": lambda g=standard: spike_slab_vb(g),
                "rvm_fit": lambda D=D, y=y: bq.RVM().fit(D, y),
            }
        )
        rows.append({"system": system, **{f"{k}_us": round(1e6 * v) for k, v in seconds.items()},
                     "fit_over_lstsq": round(seconds["fit"] / seconds["lstsq"], 2)})  # fmt: skip
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.fit_against_lstsq; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of 200 turns\n")
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
