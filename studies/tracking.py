"""Coverage of a stiffness that falls by 20 % over a record, followed by `partial_fit` with a forgetting factor.

The interval is that of the stiffness at the last row of each block, once five memories have passed (half the record, if
that is sooner). A memory of M rows is a forgetting factor of 1 - 1/M.

    python -m studies.tracking > docs/tables/tracking.csv
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayeq import SpikeSlabVB
from studies.resumable import Cell, Outcome, run_study

__all__ = ["falling_stiffness", "followed", "main"]

Floats = NDArray[np.float64]

# Rows, sampling rate [Hz], damping [1/s], stiffness at the start [1/s^2] and its fall, all over mass.
ROWS, FS, DAMPING, STIFFNESS, FALL = 12_000, 200.0, 2.0, 1000.0, 0.2

# Noise, as a share of the standard deviation of each channel: states and force, and the acceleration.
NOISE, NOISE_ACCELERATION = 0.005, 0.05

BLOCK = 100
MEMORIES = (50, 100, 200, 500, 2000)
RECORDS = 100
Z95 = 1.959964


def falling_stiffness(seed: int, fall: float = FALL) -> tuple[Floats, Floats, Floats]:
    """The dictionary x, v, x**3, u of a noisy record (n, 4), its acceleration (n,) and the true stiffness (n,)."""
    rng = np.random.default_rng(seed)
    k = STIFFNESS * (1.0 - fall * np.arange(ROWS) / ROWS)
    u = 50.0 * rng.normal(size=ROWS)  # held from sample to sample
    state, rows = np.zeros(2), np.empty((ROWS, 2))
    for i in range(ROWS):
        rows[i] = state
        state = _step(state, k[i], u[i], 1.0 / FS)
    x, v = rows.T
    a = u - DAMPING * v - k * x
    x, v, u, a = [
        channel + share * channel.std() * rng.normal(size=ROWS)
        for channel, share in ((x, NOISE), (v, NOISE), (u, NOISE), (a, NOISE_ACCELERATION))
    ]
    return np.column_stack([x, v, x**3, u]), a, k


def _step(state: Floats, k: float, u: float, h: float) -> Floats:
    """A step of the Runge-Kutta method of fourth order."""

    def rate(s: Floats) -> Floats:
        return np.array([s[1], u - DAMPING * s[1] - k * s[0]])

    r1 = rate(state)
    r2 = rate(state + 0.5 * h * r1)
    r3 = rate(state + 0.5 * h * r2)
    r4 = rate(state + h * r3)
    return np.asarray(state + h / 6.0 * (r1 + 2.0 * (r2 + r3) + r4))


def followed(seed: int, forgetting: float, fall: float = FALL) -> tuple[Floats, Floats, Floats, Floats]:
    """Rows, and there the estimate, its standard deviation and the true stiffness."""
    D, a, k = falling_stiffness(seed, fall)
    fit = SpikeSlabVB(slab_variance=1e4, forgetting=forgetting)
    ends = np.arange(BLOCK, ROWS + 1, BLOCK)
    found = np.empty((len(ends), 2))
    for j, end in enumerate(ends):
        fit.partial_fit(D[end - BLOCK : end], a[end - BLOCK : end])
        found[j] = -fit.coef_[0], fit.posterior_.sd[0]
    return ends, found[:, 0], found[:, 1], k[ends - 1]


def measure(seed: int, memory: int, fall: float) -> Outcome:
    """Coverage, error and half-width in one record, the last two in per cent of the stiffness at the start."""
    ends, estimate, sd, k = followed(seed, 1.0 - 1.0 / memory, fall)
    settled = ends >= min(5 * memory, ROWS // 2)
    error, half = (estimate - k)[settled], Z95 * sd[settled]
    return {
        "inside": 100.0 * float(np.mean(np.abs(error) <= half)),
        "lag": 100.0 * float(error.mean()) / STIFFNESS,
        "half": 100.0 * float(half.mean()) / STIFFNESS,
    }


CELLS = [
    Cell({"fall": fall, "memory": memory}, RECORDS, partial(measure, memory=memory, fall=fall))
    for fall in (FALL, 0.0)
    for memory in MEMORIES
]


def _lines(outcomes: Sequence[Outcome]) -> Iterable[Mapping[str, object]]:
    """Means over the records."""
    yield {
        "inside_percent": f"{np.mean([one['inside'] for one in outcomes]):.1f}",
        "mean_error_percent": f"{np.mean([one['lag'] for one in outcomes]):.2f}",
        "half_width_percent": f"{np.mean([one['half'] for one in outcomes]):.2f}",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure what is missing, and print the table."""
    run_study("tracking", "Coverage of a stiffness that changes, by memory.", CELLS, _lines, arguments)


if __name__ == "__main__":
    main()
