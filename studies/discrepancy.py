"""Models that are only nearly true: long Duffing records with something small that no term of the dictionary holds.

100,000 samples at 1 kHz with one of three discrepancies: a hysteretic force (Bouc-Wen) of 0.1 % of the acceleration's
variance, a stiffness that drifts by 0.1 % from beginning to end, or a sensor that lags by 0.2 ms behind the others.

    python -m studies.discrepancy > docs/tables/discrepancy.csv
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayeq.discovery import discover
from bayeq.errors import BayeqWarning
from bayeq.records import Record
from bayeq.systems import System, get_system, simulate
from studies.lines import print_table

__all__ = ["DISCREPANCIES", "NOISE", "draw_record", "measure_cell"]

DISCREPANCIES = ("none", "bouc-wen", "drift", "lag of a", "lag of u", "lag of x")
NOISE = (0.05, 0.005)
ROWS = 100_000
TRUE = {"x", "v", "x**3", "u"}

# Share of the acceleration's variance that the hysteretic force has, drift of the stiffness, and lag [s].
SHARE = 1e-3
DRIFT = 1e-3
LAG = 2e-4

# Displacement at which the hysteretic force yields [m], about half the standard deviation of the motion.
YIELD = 0.05


def _bouc_wen(share: float) -> System:
    """z' = v - (|v| z |z| + v z^2)/(2 yield^2)-like hysteresis of exponent 2, times a stiffness, added to the force."""
    known = get_system("duffing")
    loop = f"v-0.5*(abs(v)*z*abs(z)+v*z**2)/{YIELD**2}"
    return replace(
        known,
        chains=(*known.chains, "z"),
        rhs={"x": "v", "v": "(u-c*v-k*x-k3*x**3-kz*z)/m", "z": loop},
        terms={**known.terms, "dz": {}},
        parameters={**known.parameters, "kz": share},
        initial={**known.initial, "z": 0.0},
    )


def _drift() -> System:
    known = get_system("duffing")
    return replace(
        known,
        chains=(*known.chains, "s"),
        rhs={"x": "v", "v": "(u-c*v-k*(1+drift*s)*x-k3*x**3)/m", "s": "rate"},
        terms={**known.terms, "ds": {}},
        parameters={**known.parameters, "drift": DRIFT, "rate": known.fs / ROWS},
        initial={**known.initial, "s": 0.0},
    )


def draw_record(discrepancy: str, noise: float, seed: int, rows: int = ROWS) -> Record:
    """A noisy record, channels x, v, a, u."""
    known = get_system("duffing")
    ratios = dict.fromkeys(("x", "v", "a", "u"), noise)
    if discrepancy == "bouc-wen":
        # the force is small, so that its share grows with the square of its factor
        trial = simulate(_bouc_wen(1.0), n=rows, seed=seed, noise=0.0)
        assert trial.truth is not None
        clean = trial.truth.clean
        stiffness = np.sqrt(SHARE * np.var(clean["a"]) / np.var(clean["z"]))
        record = simulate(_bouc_wen(float(stiffness)), n=rows, seed=seed, noise=ratios)
    elif discrepancy == "drift":
        record = simulate(_drift(), n=rows, seed=seed, noise=ratios)
    elif discrepancy.startswith("lag of "):
        return _lagged(discrepancy.removeprefix("lag of "), noise, seed, rows)
    else:
        record = simulate(known, n=rows, seed=seed, noise=ratios)
    return Record.from_arrays({name: record[name] for name in ratios}, time=record.time)


def _lagged(channel: str, noise: float, seed: int, rows: int) -> Record:
    """Simulated at steps of the lag, so that every channel is taken at its own time."""
    known = get_system("duffing")
    ratio = round(1.0 / (known.fs * LAG))
    fine = simulate(known, n=(rows + 1) * ratio, fs=known.fs * ratio, seed=seed, noise=noise)
    first = {name: ratio - (name == channel) for name in ("x", "v", "a", "u")}
    columns = {name: fine[name][start::ratio][:rows] for name, start in first.items()}
    return Record.from_arrays(columns, time=np.arange(rows) / known.fs)


def measure_record(discrepancy: str, noise: float, seed: int, rows: int = ROWS) -> tuple[bool, Sequence[str], float]:
    """Whether exactly the true terms are found, which ones are, and the largest relative error of a coefficient."""
    record = draw_record(discrepancy, noise, seed, rows)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        eq = discover(record, displacement="x", velocity="v", acceleration="a", force="u")[0]
    truth = {"x": -1e3, "v": -2.0, "x**3": -1e5, "u": 1.0}
    error = max(abs(eq.shown_coef.get(name, 0.0) / value - 1.0) for name, value in truth.items())
    return set(eq.shown) == TRUE, eq.shown, error


def measure_cell(discrepancy: str, noise: float, seeds: int, jobs: int = 1) -> Mapping[str, object]:
    """A line of the table."""
    from joblib import Parallel, delayed

    found = Parallel(n_jobs=jobs)(delayed(measure_record)(discrepancy, noise, seed) for seed in range(seeds))
    others: dict[str, int] = {}
    for exact, included, _ in found:
        if not exact:
            wrong = " ".join(sorted(TRUE.symmetric_difference(included)))
            others[wrong] = others.get(wrong, 0) + 1
    return {
        "discrepancy": discrepancy,
        "noise": noise,
        "records": seeds,
        "exact": sum(exact for exact, _, _ in found),
        "median_worst_error": f"{np.median([error for _, _, error in found]):.4f}",
        "otherwise": "; ".join(f"{number} x {wrong}" for wrong, number in others.items()),
    }


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    parser = argparse.ArgumentParser(description="Duffing records with small discrepancies.")
    parser.add_argument("--records", type=int, default=20, help="records per cell")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args(arguments)
    cells = ((discrepancy, noise) for noise in NOISE for discrepancy in DISCREPANCIES)
    print_table(measure_cell(*cell, given.records, given.jobs) for cell in cells)


if __name__ == "__main__":
    main()
