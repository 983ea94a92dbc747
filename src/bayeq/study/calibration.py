"""Are the probabilities right? Problems drawn from the prior itself, and what model averaging says of them.

If theta, z and sigma^2 are drawn from the prior and y from the model, then of the terms with a posterior inclusion
probability near q a share q must be true, the rank of a true value among posterior draws must be uniform
(simulation-based calibration, Talts et al. 2018), and 95 % intervals must cover in 95 % of the problems: exactly, for
any design. Run as

    python -m bayeq.study.calibration --problems 2000 > docs/tables/calibration.csv
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.gram import Gram
from bayeq.inference import Prior, spike_slab_bma
from bayeq.inference.bma import sample_average
from bayeq.inference.problem import Problem
from bayeq.systems import simulate

__all__ = ["DESIGNS", "Outcome", "calibrate_one", "run_calibration", "summary"]

Floats = NDArray[np.float64]

# A prior that can be drawn from.
PRIOR = Prior(slab_variance=10.0, prior_inclusion=0.1, noise_shape=3.0, noise_rate=3.0)

DESIGNS = ("correlated", "oscillator")
ROWS = (20, 50, 200)
BINS = 10
DRAWS = 99

# Terms of a random correlated design.
TERMS = 10


@dataclass(frozen=True, slots=True)
class Outcome:
    """One problem.

    Attributes
    ----------
    pip, true : (P,) arrays
        Posterior inclusion probability of each term, and whether it was in.
    theta_rank, noise_rank : int
        Rank of the true x'theta at a random row x, and of the true sigma^2, among 99 posterior draws.
    covered : bool
        Whether the central 95 % interval of the draws covers the true x'theta.
    left_out : float
        Mass left out of the averaging.
    """

    pip: Floats
    true: NDArray[np.bool_]
    theta_rank: int
    noise_rank: int
    covered: bool
    left_out: float


def _design(kind: str, rows: int, rng: np.random.Generator) -> Floats:
    """Standardised columns."""
    if kind == "correlated":
        common = rng.uniform(0.0, 0.95)
        D = np.sqrt(1 - common) * rng.normal(size=(rows, TERMS)) + np.sqrt(common) * rng.normal(size=(rows, 1))
    else:
        record = simulate("duffing", n=1000, seed=int(rng.integers(2**31)), noise=0.0)
        chosen = np.sort(rng.choice(1000, size=rows, replace=False))
        states = {name: record[name][chosen] for name in ("x", "v", "u")}
        D = evaluate_terms(build_dictionary("oscillator", Variables(("x", "v"), ("u",))), states)
    return np.asarray((D - D.mean(axis=0)) / D.std(axis=0))


def calibrate_one(kind: str, rows: int, seed: tuple[int, ...]) -> Outcome:
    """Draw one problem from the prior and average over its models."""
    rng = np.random.default_rng(seed)
    D = _design(kind, rows, rng)
    terms = D.shape[1]
    variance = PRIOR.noise_rate / rng.standard_gamma(PRIOR.noise_shape)
    true = np.asarray(rng.random(terms) < 0.1)
    theta = np.where(true, np.sqrt(variance * PRIOR.slab_variance) * rng.standard_normal(terms), 0.0)
    y = 7.0 + D @ theta + np.sqrt(variance) * rng.standard_normal(rows)
    gram = Gram.from_data(D, y)
    fit = spike_slab_bma(gram, PRIOR)
    assert fit.average is not None
    draws, noise, _ = sample_average(Problem.of(gram, PRIOR), fit.average, DRAWS, rng)
    row = rng.standard_normal(terms)
    values, value = draws @ row, float(row @ theta)
    # ties (no term in the draw and none in truth) are broken at random
    ties = int(np.sum(values == value))
    rank = int(np.sum(values < value)) + int(rng.integers(ties + 1))
    low, high = np.sort(values)[[1, DRAWS - 2]]
    return Outcome(
        pip=fit.pip,
        true=true,
        theta_rank=rank,
        noise_rank=int(np.sum(noise < variance)),
        covered=bool(low <= value <= high),
        left_out=fit.average.left_out,
    )


def _chi_square(ranks: NDArray[np.int64], cells: int = 20) -> float:
    """p-value of uniform ranks 0..99."""
    from scipy.stats import chisquare

    return float(chisquare(np.bincount(ranks * cells // (DRAWS + 1), minlength=cells)).pvalue)


def summary(kind: str, rows: int, outcomes: list[Outcome]) -> Mapping[str, object]:
    """One line of the table: ranks, coverage and the reliability of the PIPs."""
    pip = np.concatenate([o.pip for o in outcomes])
    true = np.concatenate([o.true for o in outcomes])
    line: dict[str, object] = {
        "design": kind,
        "rows": rows,
        "problems": len(outcomes),
        "p_theta_ranks": f"{_chi_square(np.array([o.theta_rank for o in outcomes])):.3f}",
        "p_noise_ranks": f"{_chi_square(np.array([o.noise_rank for o in outcomes])):.3f}",
        "coverage": f"{np.mean([o.covered for o in outcomes]):.4f}",
        "most_left_out": f"{max(o.left_out for o in outcomes):.4f}",
    }
    which = np.minimum((pip * BINS).astype(int), BINS - 1)
    for k in range(BINS):
        inside = which == k
        n = int(inside.sum())
        line[f"bin{k}_n"] = n
        line[f"bin{k}_stated"] = f"{pip[inside].mean():.4f}" if n else ""
        line[f"bin{k}_true"] = f"{true[inside].mean():.4f}" if n else ""
    return line


def _batch(kind: str, rows: int, seed: int, start: int, stop: int) -> list[Outcome]:
    number = DESIGNS.index(kind)
    return [calibrate_one(kind, rows, (seed, number, rows, k)) for k in range(start, stop)]


def run_calibration(problems: int, seed: int = 0, jobs: int = 2) -> Iterator[Mapping[str, object]]:
    """Rows of the table, one per design and number of rows, and one per design over all of them."""
    from joblib import Parallel, delayed

    with Parallel(n_jobs=jobs, inner_max_num_threads=1, backend="loky") as pool:
        for kind in DESIGNS:
            everything: list[Outcome] = []
            for rows in ROWS:
                parts = pool(
                    delayed(_batch)(kind, rows, seed, k, min(k + 50, problems)) for k in range(0, problems, 50)
                )
                outcomes = [outcome for part in parts for outcome in part]
                everything += outcomes
                yield summary(kind, rows, outcomes)
            yield summary(kind, 0, everything)


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    parser = argparse.ArgumentParser(description="Calibration of model averaging on problems drawn from its prior.")
    parser.add_argument("--problems", type=int, default=2000, help="problems per design and number of rows")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args(arguments)
    writer = None
    for line in run_calibration(given.problems, given.seed, given.jobs):
        if writer is None:
            writer = csv.DictWriter(sys.stdout, list(line), lineterminator="\n")
            writer.writeheader()
        writer.writerow(line)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
