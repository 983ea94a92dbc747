"""Are the probabilities right? Problems drawn from the prior itself, and what model averaging says of them.

If theta, z and sigma^2 are drawn from the prior and y from the model, then of the terms with a posterior inclusion
probability near q a share q must be true, the rank of a true value among posterior draws must be uniform, and 95 %
intervals must cover in 95 % of the problems: exactly, for any design. Where the models listed leave out more than 2 %
of the mass, chains take the place of the averaging, as in `spike_slab_auto`. Which of them answers depends on the data
alone, so that all of this holds for the two together. Run as

    python -m studies.calibration --folder docs/tables

which writes calibration.csv, a line per design and number of rows, and calibration_bins.csv, a line per bin of PIP.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayeq.cli.terminal import Progress
from bayeq.dictionary import Variables, build_dictionary, evaluate_terms
from bayeq.equation.equation import Z95
from bayeq.inference.bma import sample_average, spike_slab_bma
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gibbs import spike_slab_gibbs
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Draws, Posterior
from bayeq.inference.prior import Prior
from bayeq.numerics.settings import INFERENCE
from bayeq.systems import simulate
from studies.tally import (
    BINS,
    DRAWS,
    QUANTITIES,
    TAIL,
    Tally,
    bin_of,
    bin_p,
    correlation_time,
    holm,
    joined,
    rank,
    uniform_p,
)

__all__ = ["DESIGNS", "PROBLEMS", "calibrate_one", "pooled", "run_calibration", "tables"]

Floats = NDArray[np.float64]
Line = dict[str, object]

# A prior that can be drawn from.
INCLUSION = 0.1
PRIOR = Prior(slab_variance=10.0, prior_inclusion=INCLUSION, noise_shape=3.0, noise_rate=3.0)

DESIGNS = ("correlated", "oscillator")
ROWS = (20, 50, 200)

# Problems of each design and number of rows: what fills the bins at a cost that can be borne.
PROBLEMS: Mapping[tuple[str, int], int] = {
    ("correlated", 20): 8000,
    ("correlated", 50): 12_000,
    ("correlated", 200): 30_000,
    ("oscillator", 20): 200,
    ("oscillator", 50): 150,
    ("oscillator", 200): 4000,
}
BATCH = 25

# Terms of a random correlated design.
TERMS = 10

# Level of the family of all tests.
LEVEL = 0.01


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


def _spread_out(draws: Draws) -> tuple[Floats, Floats]:
    """theta (199, P) and sigma^2 (199,), far apart in the chains and so nearly independent."""
    chains, samples, terms = draws.theta.shape
    apart = samples * chains // (DRAWS + 1)
    theta, noise = draws.theta[:, apart - 1 :: apart], draws.noise_variance[:, apart - 1 :: apart]
    return theta.reshape(-1, terms)[:DRAWS], noise.reshape(-1)[:DRAWS]


def _posterior(gram: Gram, seed: tuple[int, ...], rng: np.random.Generator) -> tuple[Posterior, Floats, Floats]:
    """What averaging says, or chains where it leaves out too much, and 199 draws of theta and sigma^2."""
    fit = spike_slab_bma(gram, PRIOR)
    assert fit.average is not None
    if fit.average.left_out <= INFERENCE.most_left_out:
        theta, noise, _ = sample_average(Problem.of(gram, PRIOR), fit.average, DRAWS, rng)
    else:
        fit = spike_slab_gibbs(gram, PRIOR, seed=(*seed, 1))
        assert fit.draws is not None
        theta, noise = _spread_out(fit.draws)
    return fit, theta, noise


def _quantities(gram: Gram, row: Floats, chosen: int) -> list[Callable[[Floats, Floats], Floats]]:
    """The `QUANTITIES` of theta (n, P) and sigma^2 (n,)."""

    def likelihood(theta: Floats, noise: Floats) -> Floats:
        rss = gram.yty - 2.0 * theta @ gram.Dty + np.sum(theta @ gram.DtD * theta, axis=1)
        return np.asarray(-0.5 * (gram.dof * np.log(noise) + rss / noise))

    return [lambda t, s: t @ row, lambda t, s: t[:, chosen], lambda t, s: s, likelihood]


def calibrate_one(kind: str, rows: int, seed: tuple[int, ...]) -> Tally:
    """Draw one problem from the prior and hold its posterior against the truth."""
    rng = np.random.default_rng(seed)
    D = _design(kind, rows, rng)
    terms = D.shape[1]
    variance = PRIOR.noise_rate / rng.standard_gamma(PRIOR.noise_shape)
    true = np.asarray(rng.random(terms) < INCLUSION)
    theta = np.where(true, np.sqrt(variance * PRIOR.slab_variance) * rng.standard_normal(terms), 0.0)
    y = 7.0 + D @ theta + np.sqrt(variance) * rng.standard_normal(rows)
    gram = Gram.from_data(D, y)
    fit, draws, noise = _posterior(gram, seed, rng)

    row = rng.standard_normal((terms,))
    quantities = _quantities(gram, row, int(rng.integers(terms)))
    ranks = np.zeros((len(quantities), DRAWS + 1), dtype=np.int64)
    for k, quantity in enumerate(quantities):
        value = float(quantity(theta[None, :], np.array([variance]))[0])
        ranks[k, rank(quantity(draws, noise), value, rng)] = 1
    low, high = np.sort(draws @ row)[[TAIL - 1, DRAWS - TAIL]]

    inside = np.eye(BINS, dtype=np.int64)[bin_of(fit.pip)]
    stated, number = fit.pip @ inside, true @ inside
    error = np.abs(theta - fit.coef)[fit.support]
    return Tally(
        problems=1,
        sampled=int(fit.average is None),
        terms=inside.sum(axis=0),
        stated=stated,
        true=number,
        variance=np.var((draws != 0.0) @ inside, axis=0, ddof=1),
        squared=(number - stated) ** 2,
        ranks=ranks,
        enclosed=int(low <= theta @ row <= high),
        included=int(fit.support.sum()),
        covered=int(np.sum(error <= Z95 * fit.sd[fit.support])),
        most_left_out=0.0 if fit.average is None else fit.average.left_out,
        slowest=0.0 if fit.draws is None else correlation_time(fit.draws.theta @ row),
        rhat=fit.details.rhat or 0.0,
    )


def _batch(kind: str, rows: int, seed: int, start: int, stop: int) -> Tally:
    number = DESIGNS.index(kind)
    return joined([calibrate_one(kind, rows, (seed, number, rows, k)) for k in range(start, stop)])


def run_calibration(
    problems: Mapping[tuple[str, int], int], seed: int = 0, jobs: int = 2
) -> dict[tuple[str, int], Tally]:
    """The tally of each design and number of rows; it does not depend on the number of `jobs`."""
    from joblib import Parallel, delayed

    parts = [
        (*cell, seed, start, min(start + BATCH, number))
        for cell, number in problems.items()
        for start in range(0, number, BATCH)
    ]
    tallies: dict[tuple[str, int], Tally] = {}
    progress, done = Progress(), 0
    with Parallel(n_jobs=jobs, inner_max_num_threads=1, backend="loky", return_as="generator") as pool:
        for (kind, rows, _, start, stop), part in zip(parts, pool(delayed(_batch)(*p) for p in parts), strict=True):
            cell = kind, rows
            tallies[cell] = tallies[cell] + part if cell in tallies else part
            done += stop - start
            progress("realisations", done, sum(problems.values()))
    progress.close()
    return tallies


def _bins(tally: Tally) -> list[Line]:
    """Share of true terms beside the stated probability."""
    lines: list[Line] = []
    for k, p in enumerate(bin_p(tally)):
        n = int(tally.terms[k])
        line: Line = {"bin": f"{k / BINS:.1f}-{(k + 1) / BINS:.1f}", "terms": n}
        if n:
            line |= {
                "stated": f"{tally.stated[k] / n:.5f}",
                "true": f"{tally.true[k] / n:.5f}",
                "se": f"{math.sqrt(tally.variance[k]) / n:.5f}",
                "se_robust": f"{math.sqrt(tally.squared[k]) / n:.5f}",
            }
        lines.append(line if p is None else {**line, "p": p})
    return lines


def _summary(tally: Tally) -> Line:
    """Ranks, coverage, and what the posteriors were made of."""
    inner = tally.ranks[:, TAIL : DRAWS + 1 - TAIL].sum(axis=1) / tally.problems
    return {
        "problems": tally.problems,
        "sampled": tally.sampled,
        **{f"p_{name}": uniform_p(counts) for name, counts in zip(QUANTITIES, tally.ranks, strict=True)},
        "coverage_prediction": f"{inner[0]:.4f}",
        "coverage_noise": f"{inner[2]:.4f}",
        "se_coverage": f"{math.sqrt(0.95 * 0.05 / tally.problems):.4f}",
        "coverage_prediction_ends_in": f"{tally.enclosed / tally.problems:.4f}",
        "included_terms": tally.included,
        "ci95_of_included": f"{tally.covered / max(tally.included, 1):.4f}",
        "most_left_out": f"{tally.most_left_out:.4f}",
        "slowest_chain": f"{tally.slowest:.0f}",
        "largest_rhat": f"{tally.rhat:.3f}",
    }


def tables(tallies: Mapping[tuple[str, int], Tally]) -> tuple[list[Line], list[Line]]:
    """The two tables: a line per cell and per design, and one per bin of each and of all; all tests are one family.

    In the first table `p_least_adjusted` is the smallest of a line's p-values, of bins and ranks, after Holm's
    adjustment for the number of tests in both tables; the last line has that of all of them, and the verdict.
    """
    cells: list[tuple[str, str, Tally]] = []
    for kind in dict.fromkeys(kind for kind, _ in tallies):
        own = {rows: tally for (name, rows), tally in tallies.items() if name == kind}
        cells += [(kind, str(rows), tally) for rows, tally in own.items()]
        cells.append((kind, "all", joined(list(own.values()))))
    first: list[Line] = []
    second: list[Line] = []
    tested: list[tuple[Line, Line, str]] = []
    for kind, rows, tally in cells:
        line: Line = {"design": kind, "rows": rows, **_summary(tally)}
        bins: list[Line] = [{"design": kind, "rows": rows, **each} for each in _bins(tally)]
        tested += [(line, line, f"p_{name}") for name in QUANTITIES]
        tested += [(line, each, "p") for each in bins if "p" in each]
        first.append(line)
        second += bins
    least: dict[int, float] = {}
    adjusted = holm(np.array([line[key] for _, line, key in tested], dtype=np.float64))
    for (cell, line, key), value in zip(tested, adjusted, strict=True):
        line[key] = f"{line[key]:.4g}"
        if key == "p":
            line["p_adjusted"] = f"{value:.4g}"
        least[id(cell)] = min(least.get(id(cell), 1.0), float(value))
    for line in first:
        line["p_least_adjusted"] = f"{least[id(line)]:.4g}"
    whole = _summary(joined(list(tallies.values())))
    last: Line = {key: "" if key.startswith("p_") else value for key, value in whole.items()}
    verdict = f"{'rejected' if adjusted.min() < LEVEL else 'not rejected'} at {100 * LEVEL:g} %"
    last |= {"p_least_adjusted": f"{adjusted.min():.4g}", "tests": len(adjusted), "verdict": verdict}
    return [*first, {"design": "all", "rows": "all", **last}], [*second, *pooled(second)]


def pooled(lines: Sequence[Mapping[str, object]]) -> list[Line]:
    """Bins of all designs and numbers of rows together, from the lines of the single ones as the table prints them.

    Problems are independent: numbers of terms, stated and true ones add up, and so do variances. These lines are no
    tests of their own.
    """
    out: list[Line] = []
    for name in dict.fromkeys(str(line["bin"]) for line in lines):
        own = [line for line in lines if line["bin"] == name and line["rows"] != "all" and int(str(line["terms"]))]
        terms = np.array([int(str(line["terms"])) for line in own])
        out.append({"design": "all", "rows": "all", "bin": name, "terms": int(terms.sum())})
        for key in ("stated", "true", "se", "se_robust") if own else ():
            sums = terms * np.array([float(str(line[key])) for line in own])
            total = math.sqrt(sums @ sums) if key.startswith("se") else sums.sum()
            out[-1][key] = f"{total / terms.sum():.5f}"
    return out


def _write(path: Path, lines: Sequence[Line]) -> None:
    columns = list(dict.fromkeys(name for line in lines for name in line))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)


def main(arguments: list[str] | None = None) -> None:
    """Write the tables, and the verdict to standard output."""
    import argparse

    parser = argparse.ArgumentParser(description="Calibration of model averaging on problems drawn from its prior.")
    parser.add_argument("--folder", type=Path, default=Path("docs/tables"), help="where to write the tables")
    parser.add_argument("--problems", type=int, help="problems per design and number of rows, the same for all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args(arguments)
    problems = {cell: given.problems or number for cell, number in PROBLEMS.items()}
    first, second = tables(run_calibration(problems, given.seed, given.jobs))
    given.folder.mkdir(parents=True, exist_ok=True)
    _write(given.folder / "calibration.csv", first)
    _write(given.folder / "calibration_bins.csv", second)
    last = first[-1]
    sys.stdout.write(f"{last['tests']} tests, least adjusted p {last['p_least_adjusted']}: {last['verdict']}\n")


if __name__ == "__main__":
    main()
