"""Do 95 % intervals cover on the paper's oscillators? Not with noisy regressors taken as exact; smoothed they do.

python -m studies.coverage --records 200 --smooth none > docs/tables/coverage.csv
python -m studies.coverage --records 400 --first-seed 50000 > docs/tables/coverage_likelihood.csv
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping

import numpy as np

from bayeq.discovery import discover
from bayeq.errors import BayeqWarning
from bayeq.states import Smooth
from bayeq.study.config import STUDY_SYSTEMS
from bayeq.systems import simulate
from studies.lines import print_table

__all__ = ["coverage"]


def coverage(
    records: int, noise: float | Mapping[str, float] = 0.05, smooth: Smooth = "auto", first_seed: int = 0
) -> Iterator[Mapping[str, object]]:
    """For each system and true term: exact rate, and among exact answers the coverage and the mean ratio to the truth.

    Parameters
    ----------
    records : int
        Nominal records of each system, seeds `first_seed`, `first_seed` + 1 ...
    noise : float or mapping
        Noise ratio of all channels, or of some.
    smooth : "auto" or "none"
        As in `bayeq.discover`.
    first_seed : int
        Of the first record of each system.
    """
    for system in STUDY_SYSTEMS:
        hits: dict[str, list[bool]] = {}
        ratios: dict[str, list[float]] = {}
        exact = 0
        for seed in range(first_seed, first_seed + records):
            record = simulate(system, seed=seed, noise=noise)
            assert record.truth is not None
            truth = record.truth.coefficients["a"]
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", BayeqWarning)
                eq = discover(record, displacement="x", velocity="v", acceleration="a", force="u", smooth=smooth)[0]
            if set(eq.shown) != set(truth):
                continue
            exact += 1
            interval = dict(zip((t.text for t in eq.terms), eq.shown_ci95, strict=True))
            for term, value in truth.items():
                hits.setdefault(term, []).append(bool(interval[term][0] <= value <= interval[term][1]))
                ratios.setdefault(term, []).append(eq.shown_coef[term] / value)
        for term, covered in hits.items():
            yield {
                "system": system,
                "records": records,
                "exact": exact,
                "term": term,
                "coverage": f"{np.mean(covered):.3f}",
                "mean_ratio_to_truth": f"{np.mean(ratios[term]):.4f}",
            }


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    parser = argparse.ArgumentParser(description="Coverage of 95 % intervals on the paper's oscillators.")
    parser.add_argument("--records", type=int, default=200, help="records of each system")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--clean-states", action="store_true", help="noise on the acceleration only")
    parser.add_argument("--smooth", choices=("auto", "none"), default="auto")
    given = parser.parse_args(arguments)
    print_table(coverage(given.records, {"a": 0.05} if given.clean_states else 0.05, given.smooth, given.first_seed))


if __name__ == "__main__":
    main()
