"""Hum and drift: what is found where a record is believed in a band of frequencies only.

Duffing oscillators of the paper, parameters perturbed by 10 %, 4,000 rows at 1 kHz with 2 % noise on all channels, all
rows used, 36 candidates. "hum": a line near 50 Hz, of phases of its own, in all channels, and its third harmonic;
"wandering hum": a random walk of its frequency, of 0.03 Hz in a second; "drift": a random walk in one channel, of half
of its standard deviation and mean 0 (that of a force is a constant of the equation); "constant": a load that is not
recorded; "slow drifts": in every channel a straight line and a sine, of 0.6 periods in the record, of 0.15 of its
standard deviation; "offset of x": of 0.3. The band is 0.5 to 40 Hz; without it for comparison.

    python -m studies.band > docs/tables/band.csv
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.equation.verdict import KINDS
from bayeq.records import Record
from bayeq.systems import simulate
from studies.judge import judged, rates, timed
from studies.resumable import Cell, Outcome, run_study

__all__ = ["TROUBLES", "draw_record", "main"]

TROUBLES = ("none", "hum", "wandering hum", "drift of x", "drift of a", "drift of u", "constant")
TROUBLES += ("slow drifts", "offset of x")
RECORDS, ROWS, NOISE, BAND = 20, 4000, 0.02, (0.5, 40.0)
MAINS, WANDERING = 50.0, 0.03
HUM, THIRD, DRIFT, LOAD, SLOW, OFFSET = 0.5, 0.3, 0.5, 20.0, 0.15, 0.3


def draw_record(trouble: str, seed: int) -> Record:
    """A record with one of the troubles, its truth that of the law."""
    record = simulate("duffing", n=ROWS, seed=seed, noise=NOISE, perturb=0.1)
    assert record.time is not None
    assert record.fs is not None
    rng, channels = np.random.default_rng([seed, TROUBLES.index(trouble)]), dict(record.channels)
    if "hum" in trouble:
        walk = np.cumsum(rng.normal(size=ROWS)) / np.sqrt(record.fs) if trouble == "wandering hum" else np.zeros(ROWS)
        turns = 2.0 * np.pi * np.cumsum(MAINS + rng.uniform(-0.1, 0.1) + WANDERING * walk) / record.fs
        for name, values in channels.items():
            first, third = rng.uniform(0.0, 2.0 * np.pi, 2)
            channels[name] = values + HUM * values.std() * (np.sin(turns + first) + THIRD * np.sin(3.0 * turns + third))
    if trouble.startswith("drift"):
        name, walk = trouble[-1], np.cumsum(rng.normal(size=ROWS))
        channels[name] = channels[name] + DRIFT * channels[name].std() * (walk - walk.mean()) / walk.std()
    if trouble == "slow drifts":
        turn = np.linspace(0.0, 1.0, ROWS)
        for name, values in channels.items():
            slow = np.sin(1.2 * np.pi * turn + rng.uniform(0.0, 2.0 * np.pi)) + rng.normal() * turn
            channels[name] = values + SLOW * values.std() * slow
    if trouble == "offset of x":
        channels["x"] = channels["x"] + OFFSET * channels["x"].std()
    if trouble == "constant":
        channels["u"] = channels["u"] - LOAD
    return record.with_channels(channels, record.units)


def _judged(eqs: Equations, truth: Mapping[str, Mapping[str, float]]) -> dict[str, object]:
    return {**judged(eqs, truth), "verdict": eqs.verdict.kind}


def _measure(trouble: str, band: tuple[float, float] | None, seed: int) -> Outcome:
    record = draw_record(trouble, seed)
    assert record.truth is not None
    truth = {"a": dict(record.truth.coefficients["a"])}
    if trouble == "constant":
        truth["a"]["1"] = LOAD * truth["a"]["u"]
    fit = partial(discover, record, chains=["x:v:a"], inputs=["u"], band=band, holdout=0.0)
    return timed(fit, lambda eqs: _judged(eqs, truth))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    kinds = Counter(outcome.get("verdict") for outcome in outcomes)
    wrong = sum(outcome.get("verdict") == "found" and not outcome["exact"] for outcome in outcomes)
    yield {**{kind.replace(" ", "_"): kinds[kind] for kind in KINDS}, "found_and_wrong": wrong, **rates(outcomes)}


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell({"trouble": trouble, "band": "" if band is None else f"{band[0]:g}:{band[1]:g}"}, records, measure)
        for band, records in ((BAND, RECORDS), (None, RECORDS // 4))
        for trouble in TROUBLES
        for measure in [partial(_measure, trouble, band)]
    ]
    run_study("band", "What is found under hum and drift.", cells, _summary, arguments)


if __name__ == "__main__":
    main()
