"""The likelihood of long records about a fit to stretches, against that of all rows in memory.

    python -m studies.long_records [--rows 1000000] [--systems ...] > docs/tables/long_records.csv

Of every coefficient: its difference in standard deviations of the answer in memory, and the ratio of both standard
deviations. In memory a million rows take some 4 GB and minutes.
"""

from __future__ import annotations

import argparse
import sys
import time as clock
import warnings

import bayeq as bq
from bayeq.discovery import sources
from bayeq.equation.equations import Equations
from bayeq.likelihood import record_fit

SYSTEMS = ("linear", "duffing", "quadratic", "coulomb")
SEED = 60_000


def answer(record: bq.Record, most: int) -> tuple[Equations, float]:
    """The answer where records of more rows than `most` are read in units, and the seconds that it took."""
    sources.MOST_ROWS = record_fit.MOST_ROWS = most  # type: ignore[misc]
    began = clock.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", holdout=0)
    return found, clock.process_time() - began


def main() -> None:
    """Write the table to standard output."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--systems", nargs="+", default=SYSTEMS)
    given = parser.parse_args()
    print("system,rows,term,coef,in_memory,sd,difference_in_sd,sd_ratio,seconds,seconds_in_memory")
    for k, system in enumerate(given.systems):
        record = bq.simulate(system, n=given.rows, seed=SEED + k)
        found, seconds = answer(record, 200_000)
        whole, seconds_in_memory = answer(record, 10 * given.rows)
        if found[0].included != whole[0].included:
            print(f"{system}: {found[0].included} instead of {whole[0].included}", file=sys.stderr)
        a, b = (one.table().set_index("term") for one in (found, whole))
        for name in whole[0].included:
            sd = b.sd[name]
            print(
                f"{system},{given.rows},{name},{a.coef[name]:.9g},{b.coef[name]:.9g},{sd:.3g},"
                f"{(a.coef[name] - b.coef[name]) / sd:.4f},{a.sd[name] / sd:.4f},{seconds:.0f},{seconds_in_memory:.0f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
