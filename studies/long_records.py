"""The likelihood of long records about a fit to stretches, against that of all rows in memory.

    python -m studies.long_records [--rows 1000000] [--systems ...] > docs/tables/long_records.csv

Of every coefficient: its difference in standard deviations of the answer in memory, the ratio of both standard
deviations, and the error of both answers in these. Records are simulated at ten times the sampling rate, of which every
tenth sample is kept: a force that is joined by straight lines at the rate itself moves the system 3e-4 less than the
smooth one that its samples show, and a million rows see that. In memory they take some 4 GB and minutes.
"""

from __future__ import annotations

import argparse
import sys
import time as clock
import warnings

import numpy as np

import bayeq as bq
from bayeq.discovery import entry
from bayeq.equation.equations import Equations
from bayeq.numerics.settings import LIKELIHOOD
from studies.overridden import overridden

SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")
SEED = 100_000
FINER = 10
NOISE = 0.05


def draw(system: str, rows: int, seed: int) -> tuple[bq.Record, dict[str, float]]:
    """A record and its true coefficients."""
    fs = 1000.0
    fine = bq.simulate(system, n=FINER * rows, fs=FINER * fs, seed=seed, noise=0.0)
    assert fine.truth is not None
    rng = np.random.default_rng([seed, 1])
    channels = {}
    for name in ("x", "v", "a", "u"):
        values = fine[name][::FINER]
        channels[name] = values + NOISE * values.std() * rng.standard_normal(rows)
    return bq.Record(channels=channels, time=np.arange(rows) / fs), dict(fine.truth.coefficients["a"])


def answer(record: bq.Record, most: int) -> tuple[Equations, float]:
    """The answer where records of more rows than `most` are read in units, and the seconds that it took."""
    entry.MOST_ROWS = most
    began = clock.process_time()
    with warnings.catch_warnings(), overridden(LIKELIHOOD, stretches_above=most):
        warnings.simplefilter("ignore")
        found = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", holdout=0)
    return found, clock.process_time() - began


def main() -> None:
    """Write the table to standard output."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--systems", nargs="+", default=SYSTEMS)
    given = parser.parse_args()
    print(
        "system,rows,term,coef,in_memory,sd,difference_in_sd,sd_ratio,seconds,seconds_in_memory,truth,error_in_sd,"
        "error_in_memory_in_sd"
    )
    for k, system in enumerate(given.systems):
        record, truth = draw(system, given.rows, SEED + k)
        found, seconds = answer(record, 200_000)
        whole, seconds_in_memory = answer(record, 10 * given.rows)
        if found[0].included != whole[0].included:
            print(f"{system}: {found[0].included} instead of {whole[0].included}", file=sys.stderr)
        a, b = (one.table().set_index("term") for one in (found, whole))
        for name in whole[0].included:
            sd, true = b.sd[name], truth[name]
            print(
                f"{system},{given.rows},{name},{a.coef[name]:.9g},{b.coef[name]:.9g},{sd:.3g},"
                f"{(a.coef[name] - b.coef[name]) / sd:.4f},{a.sd[name] / sd:.4f},{seconds:.0f},{seconds_in_memory:.0f},"
                f"{true:.9g},{(a.coef[name] - true) / a.sd[name]:.2f},{(b.coef[name] - true) / sd:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
