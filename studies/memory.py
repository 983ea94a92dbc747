"""How long may a discrepancy remember? Fits with several bounds, as a share of the motion's own time.

A discrepancy that remembers long relaxes by itself, as a law does: a heater behind a lagging sensor then needs no law.
One that forgets soon leaves a slow force that nobody measured to false terms. Records of `studies.numbers_records`,
and Lorenz's system with noise of a share of the pooled standard deviation.

    python -m studies.memory > docs/tables/memory.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

import bayeq as bq
from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.numerics.settings import LIKELIHOOD
from studies import numbers_records as kinds
from studies.adverse import judged_with_verdict
from studies.judge import timed
from studies.overridden import overridden
from studies.resumable import Cell, Outcome, run_study

__all__ = ["main"]

RECORDS = 5

# Longest memory over the motion's own time; the last one hardly bounds it.
SHARES = (0.1, 0.2, 0.4, 0.5, 1.0, 100.0)


def _lorenz(seed: int, noise: float) -> kinds.Drawn:
    clean = bq.simulate("lorenz", n=1000, noise=0.0, seed=seed)
    assert clean.truth is not None
    states = np.column_stack([clean[name] for name in "xyz"])
    samples = states + noise * states.std() * np.random.default_rng(seed).standard_normal(states.shape)
    record = bq.Record.from_arrays(dict(zip("xyz", samples.T, strict=True)), time=clean.time)
    truth = {target: dict(own) for target, own in clean.truth.coefficients.items()}
    return kinds.Drawn(record, {"chains": ["x", "y", "z"], "dictionary": "polynomial:2"}, truth)


def _judged(truth: Mapping[str, Mapping[str, float]], eqs: Equations) -> dict[str, Any]:
    """The usual judgement, and the error of the first true coefficient as a share of it."""
    (target, own), *_ = truth.items()
    name, value = next(iter(own.items()))
    shown = next(eq.shown_coef for eq in eqs if eq.target == target)
    return {**judged_with_verdict(truth, eqs), "error": abs(shown.get(name, 0.0) / value - 1.0)}


def _measure(share: float, draw: partial[kinds.Drawn], seed: int) -> Outcome:
    records, question, truth = draw(seed)
    with overridden(LIKELIHOOD, memory_share=share):
        return timed(partial(discover, records, **question), partial(_judged, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    answered = [one for one in outcomes if one["cpu"] is not None]
    yield {
        "exact": sum(one["exact"] for one in outcomes),
        "certain_false_terms": sum(one["false"] for one in answered),
        "found": sum(one["verdict"] == "found" for one in answered),
        "median_error_percent": f"{100 * np.median([one['error'] for one in answered]):.2g}" if answered else "",
        "median_cpu_seconds": f"{np.median([one['cpu'] for one in answered]):.2f}" if answered else "",
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    draws = {f"heater, lag {lag} s": partial(kinds.draw_heater, lag=float(lag)) for lag in (5, 10, 20)}
    for share in (0.1, 0.3):
        line = f"second force of {share:.0%}, memory .998".replace("%", " %")
        draws[line] = partial(kinds.draw_second_force, slow=True, share=share, noise=0.05)
    draws |= {f"Lorenz, noise {noise:.0%}".replace("%", " %"): partial(_lorenz, noise=noise) for noise in (0.3, 0.4)}
    draws["drive, 250 Hz"] = partial(kinds.draw_drive, rate=250.0, loop=250.0)
    cells = [
        Cell({"record": line, "share_of_own_time": share}, RECORDS, partial(_measure, share, draw))
        for line, draw in draws.items()
        for share in SHARES
    ]
    run_study("memory", "How long a discrepancy may remember.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
