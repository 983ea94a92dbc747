"""Laws that are only nearly true: which terms are found where the acceleration has a smooth misfit as well?

The misfit is a sum of cosines of random directions in displacement and velocity, of random phases and amplitudes, its
root mean square a share of the force's standard deviation; the Duffing oscillator is that of `studies.adverse_records`.
A certain term has a posterior inclusion probability above 0.99; the mean of the misfit is a constant that the law of
the rest does not have. Of verdicts and of the stated error the table has what the equation says. The error that it is
compared with is what the true terms and a constant leave of the misfit, by least squares on samples without noise: no
record tells a smooth misfit that is like a term from that term. The answer is that of `discover` by default settings.

    python -m studies.nearly_true > docs/tables/nearly_true.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.records import Record
from bayeq.systems import simulate
from studies.adverse import judged_with_verdict
from studies.adverse_records import CHANNELS, FORCE, RATE, SYSTEM, Case
from studies.judge import timed, verdicts
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "main"]

RECORDS, ROWS, FINER, NOISE = 10, 8000, 10, 0.005

# Of the misfit: number of cosines, and standard deviation of their wave numbers per standard deviation of the state.
COSINES, WAVES = 12, 1.2

# Within this factor the stated error is right.
FACTOR = 1.5

# Chains, with the name of the velocity in the terms.
CHAINS = {"x:v:a": "v", "x::a": "dx"}


def draw_record(seed: int, share: float) -> tuple[Record, float]:
    """A record with a misfit of a share of the force; what the terms leave of it, as a share of the acceleration."""
    motion, misfit, noise = (np.random.default_rng([seed, k]) for k in range(3))
    force = Case().force(ROWS * FINER, RATE * FINER, motion)
    moved = partial(simulate, fs=RATE * FINER, noise=0.0, force=force)
    clean = moved(SYSTEM)
    x, v = clean["x"], clean["v"]
    size, phase = misfit.standard_normal(COSINES), misfit.uniform(0.0, 2.0 * np.pi, COSINES)
    along, across = WAVES * misfit.standard_normal((2, COSINES)) / [[x.std()], [v.std()]]
    course = sum(a * np.cos(k * x + q * v + p) for a, k, q, p in zip(size, along, across, phase, strict=True))
    size *= share * FORCE.std / np.std(course)
    waves = zip(*(part.tolist() for part in (size, along, across, phase)), strict=True)
    field = "".join(f"+({a:.6g})*cos(({k:.6g})*x+({q:.6g})*v+({p:.6g}))" for a, k, q, p in waves)
    record = moved(replace(SYSTEM, rhs={"x": "v", "v": SYSTEM.rhs["v"] + field})).slice(None, None, FINER)
    channels = {name: record[name] + NOISE * record[name].std() * noise.standard_normal(ROWS) for name in CHANNELS}
    x, v = record["x"], record["v"]
    course = sum(a * np.cos(k * x + q * v + p) for a, k, q, p in zip(size, along, across, phase, strict=True))
    terms = np.column_stack([x, v, x**3, record["u"], np.ones(ROWS)])
    terms /= np.abs(terms).max(axis=0)
    left = course - terms @ np.linalg.lstsq(terms, course, rcond=None)[0]
    return Record.from_arrays(channels, fs=RATE), float(np.sqrt(np.mean(left**2)) / record["a"].std())


def _judged(chain: str, missing: float, eqs: Equations) -> dict[str, Any]:
    truth = {"x": -400.0, CHAINS[chain]: -1.2, "x**3": -2.5e4, "u": 1.0}
    eq = eqs.equations[0]
    return {**judged_with_verdict({eq.target: truth}, eqs), "stated": (eq.error_share or 0.0) / missing}


def _measure(chain: str, share: float, seed: int) -> Outcome:
    record, missing = draw_record(seed, share)
    ask = partial(discover, record, chains=chain, inputs=["u"], dictionary="oscillator")
    return timed(ask, partial(_judged, chain, missing))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    answered = [outcome for outcome in outcomes if outcome["cpu"] is not None]
    covers = [bool(term[2]) for outcome in answered for term in outcome["terms"].values()]
    stated = [outcome["stated"] for outcome in answered]
    yield {
        "exact": sum(outcome["exact"] for outcome in outcomes),
        "exact_but_for_a_constant": sum(all(text.endswith(": +1") for text in one["wrong"]) for one in outcomes),
        "certain_false_terms": sum(outcome["false"] for outcome in answered),
        **verdicts(outcomes),
        "median_stated_over_true_error": f"{np.median(stated):.2f}" if stated else "",
        "within_factor_1.5": sum(1.0 / FACTOR <= one <= FACTOR for one in stated),
        "intervals": len(covers),
        "coverage_percent": percent(sum(covers), len(covers)),
        "errors": len(outcomes) - len(answered),
        "median_cpu_seconds": f"{np.median([outcome['cpu'] for outcome in answered]):.2f}" if answered else "",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"misfit_percent": f"{100 * share:g}", "chain": chain}, RECORDS, partial(_measure, chain, share))
        for share in (0.003, 0.01, 0.03)
        for chain in CHAINS
    ]
    run_study("nearly_true", "Terms found where the law has a smooth misfit.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
