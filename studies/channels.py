"""Which channels are needed, and how fast must they be sampled? The paper's oscillators with channels left out.

Simulated at 2 kHz or finer with 5 % noise and a force of pass band min(100 Hz, fs/4), decimated to fs. Beside the
likelihood of the record stand derivatives by central differences and by Savitzky-Golay filters; where the acceleration
alone is measured, integrals by the trapezoidal rule ("differences").

    python -m studies.channels --records 5 --methods likelihood > docs/tables/channels_likelihood.csv
    python -m studies.channels --records 5 > docs/tables/channels.csv
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial

from bayeq.discovery import discover
from bayeq.errors import BayeqError, BayeqWarning
from bayeq.records import Record
from bayeq.states import parse_chains
from bayeq.states.derive import derive_states
from bayeq.study.config import STUDY_SYSTEMS
from bayeq.systems import get_system, simulate
from bayeq.systems.simulate import band_limited_noise
from studies.lines import print_table
from studies.savitzky_golay import smooth_derivative

__all__ = ["CHAINS", "METHODS", "RATES", "draw_record", "measure_cell"]

CHAINS = {
    "x, v, a": "x:v:a",
    "x, a": "x::a",
    "x, v": "x:v:",
    "x": "x::",
    "a": "::a",
    "x, v, a, 10 % of rows dropped": "x:v:a",
}
RATES = (1000.0, 500.0, 200.0, 100.0)
FILTER = "savitzky-golay"
METHODS = ("likelihood", FILTER, "differences")

# Rows of a record, and the rate that the motion is simulated at.
ROWS = 4000
FINEST = 2000.0

DROPPED = 0.1

# Degree of the polynomial that is taken out after an integration by the trapezoidal rule.
DRIFT = 5


def draw_record(system: str, fs: float, seed: int, dropped: bool = False) -> Record:
    """A noisy record of `ROWS` rows at `fs` [Hz], from a finer simulation."""
    known = get_system(system)
    ratio = max(1, round(FINEST / fs))
    rng = np.random.default_rng([seed, round(fs), STUDY_SYSTEMS.index(system)])
    assert known.force is not None
    force = replace(known.force, band=(0.0, min(100.0, fs / 4.0)))
    samples = band_limited_noise(force, ROWS * ratio, fs * ratio, rng)
    fine = simulate(known, fs=fs * ratio, seed=seed, noise=0.05, force=samples)
    record = fine.slice(0, None, ratio)
    if dropped:
        record = record.take(np.sort(rng.choice(ROWS, round((1.0 - DROPPED) * ROWS), replace=False)))
    return record


def _differentiated(record: Record, chain: str, method: str) -> Record:
    """The record with every derivative that is not measured put into a channel of its own."""
    (parsed,) = parse_chains([chain])
    if parsed.lowest > 0:
        return _integrated(record)
    states = derive_states(record, (parsed,), ("u",))
    columns = {name: states[name] for name in (*parsed.names, "u")}
    if method == FILTER:
        assert record.time is not None
        below, channel = [(k, name) for k, name in enumerate(parsed.measured) if name is not None][-1]
        for order, name in enumerate(parsed.names[below + 1 :], 1):
            columns[channel], columns[name] = smooth_derivative(record.time, record[channel], order)
    return Record.from_arrays(columns, time=record.time)


def _integrated(record: Record) -> Record:
    """Velocity and displacement by the trapezoidal rule, a polynomial that follows the drift taken out each time."""
    from scipy.integrate import cumulative_trapezoid

    assert record.time is not None
    columns = {"a": record["a"] - record["a"].mean()}
    for below, name in (("a", "dx"), ("dx", "x")):
        integral = np.asarray(cumulative_trapezoid(columns[below], record.time, initial=0), dtype=np.float64)
        columns[name] = integral - Polynomial.fit(record.time, integral, DRIFT)(record.time)
    return Record.from_arrays({**columns, "u": record["u"]}, time=record.time)


def measure_cell(system: str, channels: str, fs: float, method: str, records: int) -> Mapping[str, object]:
    """A line of the table: exact rate, and errors of the coefficients where the model is exact."""
    chain = CHAINS[channels]
    errors: list[list[float]] = []
    truth: Mapping[str, float] = {}
    for seed in range(records):
        record = draw_record(system, fs, seed, dropped="dropped" in channels)
        assert record.truth is not None
        truth = record.truth.coefficients["a"]
        (parsed,) = parse_chains([chain])
        speed = parsed.names[1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BayeqWarning)
            try:
                if method == "likelihood":
                    eq = discover(record, chains=[chain], inputs=["u"], holdout=0.0)[0]
                else:
                    ready = _differentiated(record, chain, method)
                    full = ":".join(parsed.names)
                    eq = discover(ready, chains=[full], inputs=["u"], smooth="none", holdout=0.0)[0]
            except BayeqError:
                continue
        found = {
            "*".join(speed_free(f, speed) for f in name.split("*")): value for name, value in eq.shown_coef.items()
        }
        if set(found) == set(truth):
            errors.append([found[name] / value - 1.0 for name, value in truth.items()])
    line: dict[str, object] = {
        "system": system,
        "channels": channels,
        "fs": f"{fs:g}",
        "method": method,
        "records": records,
        "exact": len(errors),
    }
    for j in range(4):
        names = list(truth)
        table = np.array(errors)
        line[f"term{j + 1}"] = names[j] if j < len(names) else ""
        known = j < len(names) and len(errors) > 0
        line[f"bias{j + 1}_percent"] = f"{100 * float(np.mean(table[:, j])):.2f}" if known else ""
        line[f"rms{j + 1}_percent"] = f"{100 * float(np.sqrt(np.mean(table[:, j] ** 2))):.2f}" if known else ""
    return line


def speed_free(factor: str, speed: str) -> str:
    """A factor of a term with the velocity under its usual name."""
    return factor.replace(speed, "v")


def _cells(records: int, methods: Sequence[str]) -> Iterator[tuple[str, str, float, str, int]]:
    for system in STUDY_SYSTEMS:
        for channels in CHAINS:
            for fs in RATES:
                for method in methods:
                    if ("dropped" in channels and method == "differences") or (channels == "a" and method == FILTER):
                        continue
                    yield system, channels, fs, method, records


def main(arguments: list[str] | None = None) -> None:
    """Write the table to standard output."""
    import argparse

    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(description="Exact rates and errors with channels left out.")
    parser.add_argument("--records", type=int, default=20, help="records per cell")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--methods", nargs="+", choices=["likelihood", *METHODS], default=METHODS)
    given = parser.parse_args(arguments)
    with Parallel(n_jobs=given.jobs, inner_max_num_threads=1, return_as="generator") as pool:
        print_table(pool(delayed(measure_cell)(*cell) for cell in _cells(given.records, given.methods)))


if __name__ == "__main__":
    main()
