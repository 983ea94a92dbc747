"""What output error adds to equations: free runs on unseen rows at 10 to 20 samples per natural period.

Linear and Duffing oscillators simulated at 16 times the sampling rate, with a force whose band ends at a quarter of
that rate and whose spectral density is that of the paper's, then decimated; 5 % noise on the measured motion. For each
record the equation by regression, and the same refined on the same rows, run freely over the last fifth of the rows.

    python -m studies.refinement > docs/tables/refinement.csv
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equation import Z95
from bayeq.equation.equations import Equations
from bayeq.errors import BayeqError, BayeqWarning
from bayeq.records import Record
from bayeq.states import Smooth, parse_chain
from bayeq.systems import get_system, simulate
from studies.lines import print_table

__all__ = ["CASES", "Case", "draw_record", "measure_case", "measure_record"]

SYSTEMS = ("linear", "duffing")

# Samples per natural period of the linear oscillator, between these; rows of a record; steps of the simulation between
# two of them; noise.
PERIOD = (10.0, 20.0)
ROWS = 1000
FINE = 16
NOISE = 0.05

# Share of the rows that is not seen.
UNSEEN = 0.2


@dataclass(frozen=True, slots=True)
class Case:
    """What is measured, and what the regression is given.

    Attributes
    ----------
    chain : str
        Measured motion.
    force_noise : float
        Ratio of the noise of the force.
    smooth : str
        As `discover` takes it; "none" are derivatives by central differences.
    known : bool
        Whether the dictionary holds the true terms only.
    """

    chain: str
    force_noise: float
    smooth: Smooth
    known: bool


CASES = (
    Case("x:v:a", 0.0, "auto", False),
    Case("x::", 0.0, "auto", False),
    Case("x::", 0.0, "none", True),
    Case("x:v:a", NOISE, "auto", False),
    Case("x::", NOISE, "auto", False),
)


def draw_record(system: str, case: Case, seed: int) -> tuple[Record, Mapping[str, float]]:
    """A noisy record with its clean channels as truth, and the true coefficients."""
    rng = np.random.default_rng([seed, SYSTEMS.index(system)])
    known = get_system(system)
    natural = math.sqrt(known.parameters["k"] / known.parameters["m"]) / (2.0 * math.pi)
    fs = float(rng.uniform(*PERIOD)) * natural
    assert known.force is not None
    band = fs / 4.0
    force = replace(known.force, band=(0.0, band), std=known.force.std * math.sqrt(band / known.force.band[1]))
    noise = {"x": NOISE, "v": NOISE, "a": NOISE, "u": case.force_noise}
    fine = simulate(replace(known, force=force), n=ROWS * FINE, fs=fs * FINE, seed=seed, noise=noise)
    assert fine.truth is not None
    return fine.slice(0, None, FINE), fine.truth.coefficients["a"]


def measure_record(system: str, case: Case, seed: int) -> dict[str, float] | None:
    """Errors before and after, and how many true coefficients the refined intervals cover; None without an equation."""
    record, truth = draw_record(system, case, seed)
    chain = parse_chain(case.chain)
    velocity = chain.names[1]
    terms = {velocity if name == "v" else name: value for name, value in truth.items()}
    measured = {name: record[name] for name in chain.measured if name is not None}
    seen = Record.from_arrays({**measured, "u": record["u"]}, time=record.time)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        try:
            before = discover(
                seen,
                chains=[case.chain],
                inputs=["u"],
                smooth=case.smooth,
                holdout=UNSEEN,
                dictionary=list(terms) if case.known else "oscillator",
            )
            start = time.perf_counter()
            after = before.refine(seen, holdout=UNSEEN)
        except BayeqError:
            return None
    seconds = time.perf_counter() - start
    out = {"seconds": seconds, "refined": float(after.refined is not None)}
    for label, eq in (("before", before), ("after", after)):
        out[label] = _free_run_error(eq, record, velocity)
        out[f"{label}_measured"] = eq.score(seen, start=ROWS - int(UNSEEN * ROWS)).free_run["x"]
    found = after[0]
    out["exact"] = float(set(found.shown) == set(terms))
    if out["exact"] and after.refined is not None:
        sd = dict(zip((t.text for t in found.terms), found.shown_posterior.sd, strict=True))
        out["terms"] = len(terms)
        out["covered"] = sum(abs(found.shown_coef[n] - value) <= Z95 * sd[n] for n, value in terms.items())
    return out


def _free_run_error(eq: Equations, record: Record, velocity: str) -> float:
    """Error of the displacement against the clean one, from the clean state, under the force as measured."""
    assert record.truth is not None
    clean = record.truth.clean
    first = ROWS - int(UNSEEN * ROWS)
    initial = {"x": float(clean["x"][first]), velocity: float(clean["v"][first])}
    inputs = Record.from_arrays(u=record["u"], time=record.time)
    run = eq.simulate(inputs, initial=initial, draws=0, start=first).mean["x"]
    error = run - clean["x"][first:]
    return float(np.sqrt(np.mean(error**2)) / clean["x"][first:].std()) if np.isfinite(run).all() else math.inf


def measure_case(system: str, case: Case, lines: list[dict[str, float]], records: int) -> dict[str, object]:
    """A line of the table."""
    before, after = (np.array([line[label] for line in lines]) for label in ("before", "after"))
    both = np.isfinite(before)
    ratio = np.where(both, after / np.where(both, before, 1.0), np.where(np.isfinite(after), 0.0, 1.0))
    terms = sum(line.get("terms", 0.0) for line in lines)
    return {
        "system": system,
        "measured": ", ".join(name for name in parse_chain(case.chain).measured if name),
        "force_noise": case.force_noise,
        "smooth": case.smooth,
        "dictionary": "true terms" if case.known else "oscillator",
        "records": records,
        "equations": len(lines),
        "exact": int(sum(line["exact"] for line in lines)),
        "refined": int(sum(line["refined"] for line in lines)),
        "error_regression": f"{np.median(before):.4g}",
        "error_refined": f"{np.median(after):.4g}",
        "median_ratio": f"{np.median(ratio):.3f}",
        "worse": f"{np.mean(ratio > 1.0):.3f}",
        "measured_error_regression": f"{np.median([line['before_measured'] for line in lines]):.4g}",
        "measured_error_refined": f"{np.median([line['after_measured'] for line in lines]):.4g}",
        "coverage": f"{sum(line.get('covered', 0.0) for line in lines) / terms:.3f}" if terms else "",
        "seconds": f"{np.median([line['seconds'] for line in lines]):.2f}",
    }


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(description="Free runs on unseen rows before and after refine.")
    parser.add_argument("--records", type=int, default=200, help="records per case, half of each system")
    parser.add_argument("--cases", type=int, default=len(CASES), help="how many of the cases, from the first on")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args(arguments)
    per_system = given.records // 2
    with Parallel(n_jobs=given.jobs, inner_max_num_threads=1) as pool:

        def table() -> Iterator[dict[str, object]]:
            for case in CASES[: given.cases]:
                pooled: list[dict[str, float]] = []
                for system in SYSTEMS:
                    found = pool(delayed(measure_record)(system, case, seed) for seed in range(per_system))
                    lines = [line for line in found if line is not None]
                    pooled += lines
                    yield measure_case(system, case, lines, per_system)
                yield measure_case("both", case, pooled, per_system * len(SYSTEMS))

        print_table(table())


if __name__ == "__main__":
    main()
