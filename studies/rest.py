"""Rows at rest of free vibrations (`bayeq.states.rest`): how much motion is left out with them?

    python -m studies.rest > docs/tables/rest.csv

Records of 2 to 20 s at 100 to 5000 Hz, of 2 to 12 Hz with a damping ratio of 0.1 to 16 %; noise of 0.1 to 10 % of the
standard deviation, white or averaged over five samples. Some are held before they are released, and friction holds some
once they are small. Others grow.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator

import numpy as np

from bayeq.arrays import Floats
from bayeq.states.rest import moving_rows

RECORDS, SEED = 400, 1
KINDS = {"ring-down": "", "stops": "stops", "held": "held", "held, stops": "held stops", "grows": "grows"}


def draw(kind: str, rng: np.random.Generator) -> tuple[Floats, float, int]:
    """A free vibration (n,) without noise, the standard deviation of its noise, and the row of its release."""
    fs, w, seconds = (
        rng.choice([100.0, 200.0, 1000.0, 5000.0]),
        2.0 * np.pi * rng.uniform(2.0, 12.0),
        rng.uniform(2, 20),
    )
    n, zeta, noise = int(min(seconds * fs, 40_000)), 10.0 ** rng.uniform(-3.0, -0.8), 10.0 ** rng.uniform(-3.0, -1.0)
    release = int(rng.uniform(0.02, 0.3) * n) if "held" in kind else 0
    s, wd = np.maximum(np.arange(n) - release, 0) / fs, w * np.sqrt(1.0 - zeta**2)
    rate = zeta * w * (1.0 if "grows" in kind else -1.0)
    x = np.exp(rate * np.minimum(s, 60.0 / abs(rate))) * (
        np.cos(wd * s) + zeta / np.sqrt(1.0 - zeta**2) * np.sin(wd * s)
    )
    x /= np.abs(x).max()
    if "stops" in kind:
        turns = np.flatnonzero((np.diff(x[:-1]) * np.diff(x[1:]) <= 0.0) & (np.abs(x[1:-1]) < rng.uniform(0.02, 0.1)))
        turns = turns[turns > release + 1]
        if len(turns):
            x[turns[0] + 1 :] = x[turns[0] + 1]
    return x, noise * float(x.std()), release


def lines() -> Iterator[list[object]]:
    yield [
        "kind", "records", "shortened_at_end_percent", "motion_over_noise_left_out_99_percent",
        "shortened_at_start_percent", "rows_after_release_left_out_99_percent", "motion_over_noise_there_99_percent",
        "still_held_at_start_percent",
    ]  # fmt: skip
    rng = np.random.default_rng(SEED)
    for name, kind in KINDS.items():
        found = []
        for _ in range(RECORDS):
            x, sd, release = draw(kind, rng)
            noise = rng.standard_normal(len(x) + 4)
            if rng.random() < 0.3:
                noise = np.convolve(noise, np.full(5, 5**-0.5), mode="same")
            first, stop = moving_rows((x + sd * noise[4:])[:, None])
            at_end = x[stop:] - x[-len(x) // 10 :].mean()
            early = x[release:first] - x[release]
            found.append(
                (
                    stop < len(x),
                    np.sqrt(np.mean(at_end**2)) / sd if len(at_end) else 0.0,
                    first > 0,
                    max(first - release, 0) if first else 0,
                    np.abs(early).max() / sd if first > release else 0.0,
                    first < release,
                )
            )
        columns = np.array(found, dtype=np.float64).T
        shares, most = 100.0 * columns.mean(axis=1), np.quantile(columns, 0.99, axis=1)
        yield [
            name, RECORDS, f"{shares[0]:.1f}", f"{most[1]:.2f}", f"{shares[2]:.1f}", f"{most[3]:.0f}", f"{most[4]:.1f}",
            f"{shares[5]:.1f}",
        ]  # fmt: skip


def main() -> None:
    print("# python -m studies.rest")
    csv.writer(sys.stdout, lineterminator="\n").writerows(lines())


if __name__ == "__main__":
    main()
