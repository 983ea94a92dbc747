"""A Duffing circuit under a multisine, of which the output alone is measured, with an offset of the meter.

y'' = w0^2 (G u - y - 7 y^3) - 2 zeta w0 y', w0 = 2 pi 41 Hz, zeta = 0.03; u: an odd random-phase multisine up to 130
Hz of sd 1, continuous in time; G such that sd(y) = 0.06. 20,000 rows at 400 Hz from the steady motion, all used. The
meter adds 2.5e-3 to y, which makes true terms of y**2 and of the constant, and noise of 1e-3 sd(y); the force is
known without noise. Given the true terms: is the ratio of the cubic to the linear coefficient within 1.5 %? Given the
36 of the default: are the true ones included, and is a free run over another record off by less than twice the
meter's noise?

    python -m studies.circuit > docs/tables/circuit.csv
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.errors import BayeqWarning
from bayeq.records import Record
from studies.judge import timed
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "main"]

Floats = NDArray[np.float64]

RECORDS = 10

OMEGA, ZETA, CUBIC = 2 * math.pi * 41.0, 0.03, 7.0
SPREAD, OFFSET, NOISE = 0.06, 2.5e-3, 1e-3

ROWS, RATE = 20_000, 400.0
HIGHEST = 130.0

# Samples of the force between two of the record, the half steps of Runge and Kutta's method among them.
FINER = 32

# Rows before the record, in which the motion becomes steady.
BEFORE = 2000

GAIN = 0.023

TRUE_TERMS = ("y", "dy", "y**2", "y**3", "u")
LIMIT = 0.015

# Seeds of the records that free runs are judged on.
OTHERS = 1_000_000


def multisine(seed: int) -> Floats:
    """A period of the force, of as many rows as the record, sampled `FINER` times a row."""
    rng = np.random.default_rng(seed)
    lines = np.arange(1, int(HIGHEST * ROWS / RATE) + 1, 2)
    spectrum = np.zeros(ROWS * FINER // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * math.pi * rng.random(len(lines))) * ROWS * FINER / math.sqrt(2.0 * len(lines))
    return np.fft.irfft(spectrum, ROWS * FINER)


def _motion(force: Floats, gain: float) -> Floats:
    """Output over one period of the force that has become steady, (ROWS,)."""
    h, y, dy = 2.0 / (RATE * FINER), 0.0, 0.0
    before = BEFORE * FINER
    drive = (OMEGA**2 * gain * np.concatenate([force[-before:], force, force[:1]])).tolist()
    stiffness, damping, cubic = OMEGA**2, 2 * ZETA * OMEGA, CUBIC * OMEGA**2
    out = np.empty(BEFORE + ROWS)
    for k in range(0, len(drive) - 1, 2):
        if k % FINER == 0:
            out[k // FINER] = y
        first, middle, last = drive[k], drive[k + 1], drive[k + 2]
        a1 = first - stiffness * y - cubic * y * y * y - damping * dy
        y2, v2 = y + h / 2 * dy, dy + h / 2 * a1
        a2 = middle - stiffness * y2 - cubic * y2 * y2 * y2 - damping * v2
        y3, v3 = y + h / 2 * v2, dy + h / 2 * a2
        a3 = middle - stiffness * y3 - cubic * y3 * y3 * y3 - damping * v3
        y4, v4 = y + h * v3, dy + h * a3
        a4 = last - stiffness * y4 - cubic * y4 * y4 * y4 - damping * v4
        y, dy = y + h / 6 * (dy + 2 * v2 + 2 * v3 + v4), dy + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return out[BEFORE:]


@cache
def gain() -> float:
    """The gain G of which the output's standard deviation is `SPREAD`, by the secant method on one force."""
    force = multisine(0)
    lower, upper = GAIN, 1.05 * GAIN
    below, above = (float(_motion(force, g).std()) for g in (lower, upper))
    return lower + (SPREAD - below) * (upper - lower) / (above - below)


def draw_record(seed: int) -> Record:
    """Measured output y and the force u."""
    force = multisine(seed)
    y = _motion(force, gain())
    measured = y + OFFSET + NOISE * y.std() * np.random.default_rng([seed, ROWS]).standard_normal(ROWS)
    return Record.from_arrays({"y": measured, "u": force[::FINER]}, fs=RATE)


def _given_terms(eqs: Equations) -> dict[str, object]:
    coef = eqs[0].coef
    known = "y" in coef and "y**3" in coef
    ratio = coef["y**3"] / coef["y"] / CUBIC - 1.0 if known else None
    return {"ratio": ratio, "included": list(eqs[0].included)}


def _all_terms(eqs: Equations, seed: int) -> dict[str, object]:
    other = draw_record(OTHERS + seed)
    run = eqs.simulate(other, draws=0)
    error = float(np.sqrt(np.mean((run.mean["y"] - other["y"]) ** 2)))
    return {
        "included": list(eqs[0].included),
        "constant": bool(eqs[0].intercept_matters),
        "free_run": error / (NOISE * SPREAD),
    }


def _measure(given: bool, seed: int) -> Outcome:
    record = draw_record(seed)
    terms = TRUE_TERMS if given else "oscillator"
    fit = partial(discover, record, chains=["y::"], inputs=["u"], dictionary=terms, holdout=0.0)

    def judge(eqs: Equations) -> dict[str, object]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BayeqWarning)
            return _given_terms(eqs) if given else _all_terms(eqs, seed)

    return timed(fit, judge)


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    n = len(outcomes)
    ratios = np.array([outcome["ratio"] for outcome in outcomes if outcome.get("ratio") is not None])
    runs = np.array([outcome["free_run"] for outcome in outcomes if "free_run" in outcome])
    near, below = int(np.sum(np.abs(ratios) <= LIMIT)), int(np.sum(runs < 2.0))
    superset = sum(set(TRUE_TERMS) <= set(outcome.get("included", ())) for outcome in outcomes)
    exact = sum(set(TRUE_TERMS) == set(outcome.get("included", ())) for outcome in outcomes)
    cpu = [outcome["cpu"] for outcome in outcomes if outcome["cpu"] is not None]
    yield {
        "true_included": superset,
        "true_included_percent": percent(superset, n),
        "exact": exact,
        "ratio_within_1.5_percent": near if len(ratios) else "",
        "ratio_mean_error_percent": f"{100 * ratios.mean():.2f}" if len(ratios) else "",
        "ratio_worst_error_percent": f"{100 * np.abs(ratios).max():.2f}" if len(ratios) else "",
        "free_run_below_twice_noise": below if len(runs) else "",
        "free_run_median_over_noise": f"{np.median(runs):.2f}" if len(runs) else "",
        "errors": n - len(cpu),
        "median_cpu_seconds": f"{np.median(cpu):.2f}" if cpu else "",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"terms": "true" if given else "all 36", "method": "auto"}, RECORDS, partial(_measure, given))
        for given in (True, False)
    ]
    run_study("circuit", "The cubic of a Duffing circuit from its output.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
