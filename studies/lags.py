"""Lags of channels: are the terms right where a channel is late, and do the intervals of lag and coefficients cover?

A driven oscillator with a cubic spring, 1500 rows at 100 Hz, 50 samples a period or more, parameters and noise of its
own in each record; noise is a share of each channel's standard deviation. One channel is late or early by 0.5 to 3
samples: the force (`force`) or a channel of the motion (`motion`), or none is (`none`); then the lag of the force is
asked for all the same. `told` is whether ``lag_sd`` was given, 3 samples; records of both are the same.

    python -m studies.lags > docs/tables/lags.csv
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np

from bayeq.discovery import discover
from bayeq.equation.equations import Equations
from bayeq.records import Record
from bayeq.systems import BandLimitedForce, System, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.judge import judged, timed, verdicts
from studies.resumable import Cell, Outcome, percent, run_study

__all__ = ["draw_record", "main"]

RECORDS = 10
ROWS, RATE, FINER, MARGIN = 1500, 100.0, 20, 10
FORCE = BandLimitedForce(8.0, (0.2, 4.0))
TERMS = "x, {v}, u, x**2, x**3, {v}**3, {v}*abs({v}), x*{v}"
LAG_SD = 3.0 / RATE


def draw_record(kind: str, chain: str, noise: float, seed: int) -> tuple[Record, dict[str, float], str, float]:
    """A noisy record, its true coefficients, the channel whose lag is asked for, and that lag [s]."""
    own = crc32(f"{kind} {chain} {noise:g}".encode())  # cells have draws of their own
    rng = np.random.default_rng([seed, own, 1])
    k, m = np.exp(rng.uniform(np.log([60.0, 0.5]), np.log([160.0, 2.0]))).tolist()
    parameters = {"k": k, "m": m, "c": float(rng.uniform(0.3, 1.5)), "q": float(rng.uniform(50.0, 300.0))}
    system = System(
        name="late-oscillator",
        title="Oscillator with a cubic spring",
        chains=("x:v:a",),
        rhs={"x": "v", "v": "m*u-k*x-c*v-q*x**3"},
        terms={"a": {}},
        parameters=parameters,
        initial={"x": 0.0, "v": 0.0},
        inputs=("u",),
        force=FORCE,
        n=(ROWS + 2 * MARGIN) * FINER,
        fs=RATE * FINER,
        noise=0.0,
        citation="made for this study",
    )
    clean = simulate(system, force=band_limited_noise(FORCE, system.n, system.fs, rng)[:, None])
    late = "u" if kind != "motion" else "x" if chain == "x::" else str(rng.choice(["x", "v", "a"]))
    steps = 0 if kind == "none" else round(float(rng.uniform(0.5, 3.0) * rng.choice([-1.0, 1.0])) * FINER)
    errors, channels = np.random.default_rng([seed, own, 2]), {}
    for name in "xvau":
        rows = (np.arange(ROWS) + MARGIN) * FINER - (steps if name == late else 0)
        channels[name] = clean[name][rows] + noise * clean[name].std() * errors.standard_normal(ROWS)
    v = "dx" if chain == "x::" else "v"
    truth = {"x": -k, v: -parameters["c"], "x**3": -parameters["q"], "u": m}
    return Record.from_arrays(channels, fs=RATE), truth, late, steps / (RATE * FINER)


def _judged(truth: Mapping[str, float], late: str, lag: float, eqs: Equations) -> dict[str, Any]:
    found = {**judged(eqs, {eqs.equations[0].target: truth}), "verdict": eqs.verdict.kind, "lag": None}
    if late in eqs.data.sensors.lags:
        one = eqs.data.sensors.lags[late]
        found["lag"] = [one.value - lag, one.sd, abs(one.value - lag) <= 1.96 * one.sd]
    return found


def _measure(kind: str, chain: str, noise: float, told: bool, seed: int) -> Outcome:
    record, truth, late, lag = draw_record(kind, chain, noise, seed)
    dictionary = TERMS.format(v="dx" if chain == "x::" else "v")
    lag_sd = {late: LAG_SD} if told else None
    ask = partial(discover, record, chains=chain, inputs=["u"], dictionary=dictionary, lag_sd=lag_sd)
    return timed(ask, partial(_judged, truth, late, lag))


def _summary(outcomes: Sequence[Outcome]) -> Iterator[Mapping[str, object]]:
    answered = [one for one in outcomes if one["cpu"] is not None]
    exact = [one for one in answered if one["exact"]]
    damping = [bool(term[2]) for one in exact for name, term in one["terms"].items() if name.split()[1] in ("v", "dx")]
    covers = [bool(term[2]) for one in exact for term in one["terms"].values()]
    lags = [bool(one["lag"][2]) for one in answered if one["lag"]]
    yield {
        "exact": len(exact),
        **verdicts(outcomes),
        "lag_covered": sum(lags) if lags else "",
        "damping_covered": sum(damping),
        "intervals": len(covers),
        "coverage_percent": percent(sum(covers), len(covers)),
        "errors": len(outcomes) - len(answered),
        "median_cpu_seconds": f"{np.median([one['cpu'] for one in answered]):.2f}" if answered else "",
    }  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Measure, and write the table to standard output."""
    cells = [
        Cell(
            {"late": kind, "chain": chain, "noise_percent": f"{100 * noise:g}", "told": "yes" if told else "no"},
            RECORDS,
            partial(_measure, kind, chain, noise, told),
        )
        for kind in ("force", "motion", "none")
        for chain in ("x:v:a", "x::")
        for noise in (0.01, 0.03)
        for told in (True, False)
    ]
    run_study("lags", "Channels that are late: are terms, lags and coefficients right?", cells, _summary, arguments)


if __name__ == "__main__":
    main()
