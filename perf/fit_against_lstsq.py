"""Whole fits against one least-squares solve, on the paper's dictionary matrix (N=2000, P=36).

With one BLAS thread and with as many as there are cores: `lstsq` is the slower for two threads on a matrix this small.

    make bench        # or: python -m perf.fit_against_lstsq

Writes perf/results/fit_against_lstsq.csv.
"""

from __future__ import annotations

import csv
import os
import platform
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import bayeq as bq
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.inference.vb import spike_slab_vb
from perf.timing import medians

RESULTS = Path(__file__).parent / "results" / "fit_against_lstsq.csv"
SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")


def measure(system: str, threads: int) -> dict[str, object]:
    """One line of the table."""
    record = bq.simulate(system, n=2000, seed=0)
    terms = build_dictionary("oscillator", Variables(("x", "v"), ("u",)))
    D, y = np.ascontiguousarray(evaluate_terms(terms, record.channels)), np.array(record["a"])
    standard = bq.Gram.from_data(D, y).standardise().gram
    contestants = {
        "lstsq": lambda: np.linalg.lstsq(D, y, rcond=None),
        "fit": lambda: bq.SpikeSlabVB().fit(D, y),
        "gram": lambda: bq.Gram.from_data(D, y),
        "engine": lambda: spike_slab_vb(standard),
        "rvm_fit": lambda: bq.RVM().fit(D, y),
        "bma_fit": lambda: bq.SpikeSlabBMA().fit(D, y),
        "gibbs_2000_fit": lambda: bq.SpikeSlabGibbs(chains=1, samples=2000, burn_in=200).fit(D, y),
    }
    with threadpool_limits(threads):
        seconds = medians(contestants, rounds=20, calls=10)
    line: dict[str, object] = {"system": system, "blas_threads": threads}
    line |= {f"{name}_us": round(1e6 * value) for name, value in seconds.items()}
    line |= {f"{name}_over_lstsq": round(seconds[name] / seconds["lstsq"], 2) for name in ("fit", "bma_fit")}
    return line


def main() -> None:
    """Measure and write the table."""
    rows = [measure(system, threads) for threads in (1, os.cpu_count() or 1) for system in SYSTEMS]
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.fit_against_lstsq; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of 20 turns of 10 calls\n")
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
