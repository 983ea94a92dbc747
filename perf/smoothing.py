"""Times of the kinematic smoother: noise levels estimated and states smoothed, from 1,000 to 1,000,000 rows.

Records of the Duffing oscillator with 5 % noise: all three channels, the displacement alone, and all three with a
tenth of the rows dropped at random, where no gain can settle. Beside them the Savitzky-Golay filter, tuned by
generalised cross-validation, that differentiates a displacement twice.

    python -m perf.smoothing

Writes perf/results/smoothing.csv.
"""

from __future__ import annotations

import csv
import os
import platform
from pathlib import Path

import numpy as np
from studies.savitzky_golay import smooth_derivative
from threadpoolctl import threadpool_limits

import bayeq as bq
from bayeq.states.kinematic.fit import fit_kinematic
from bayeq.states.kinematic.smoother import ChainSeries, filtered, smooth_kinematic
from perf.timing import medians

RESULTS = Path(__file__).parent / "results" / "smoothing.csv"
SIZES = (1_000, 4_000, 16_000, 64_000, 256_000, 1_000_000)

# The Savitzky-Golay filters take 10 s for a million rows.
LONGEST_FILTER = 64_000


def series(case: str, n: int) -> ChainSeries:
    """The samples of one line of the table."""
    record = bq.simulate("duffing", n=n, seed=0, noise=0.05)
    whole = ChainSeries(record.time, (record["x"], *(record[c] if case != "x" else None for c in "va")))
    if case != "tenth dropped":
        return whole
    return whole.take(np.flatnonzero(np.random.default_rng(0).random(n) > 0.1))


def measure(case: str, n: int) -> dict[str, object]:
    """One line of the table."""
    samples = series(case, n)
    model = fit_kinematic([samples])
    displacement = samples.channels[0]
    assert displacement is not None
    contestants = {
        "fit": lambda: fit_kinematic([samples]),
        "smooth": lambda: smooth_kinematic(samples, model),
        "likelihood": lambda: filtered(samples, model),
    }
    if case == "x" and n <= LONGEST_FILTER:
        contestants["savitzky_golay"] = lambda: smooth_derivative(samples.times, displacement, 2)
    seconds = medians(contestants, rounds=max(3, min(30, 200_000 // n)))
    line: dict[str, object] = {"channels": case, "rows": samples.n, "order": model.order}
    line |= {f"{name}_ms": round(1e3 * value, 2) for name, value in seconds.items()}
    line["fit_and_smooth_ms"] = round(1e3 * (seconds["fit"] + seconds["smooth"]), 1)
    return line


def main() -> None:
    """Measure and write the table."""
    with threadpool_limits(1):
        rows = [measure(case, n) for case in ("x, v, a", "x", "tenth dropped") for n in SIZES]
    names = list(dict.fromkeys(name for row in rows for name in row))
    RESULTS.parent.mkdir(exist_ok=True)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.smoothing; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of 3 turns or more\n")
        writer = csv.DictWriter(file, names, restval="")
        writer.writeheader()
        writer.writerows(rows)
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
