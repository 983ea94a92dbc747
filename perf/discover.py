"""Processor time of `discover`, of this program over that of another checkout, on records of several kinds.

    python -m perf.discover --against OTHER/src

Each program answers in a process of its own, on one thread, its kernels compiled by an answer that is not counted. They
take turns, so that a noisy machine is noisy for both. Writes perf/results/discover.csv: medians of five [s], and the
ratio of the medians. Records are those of the studies, drawn by this program for both.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).parent / "results" / "discover.csv"
OWN = Path(__file__).parents[1] / "src"
TURNS = 5

Question = tuple[Any, dict[str, Any]]


def _paper(system: str, chain: str) -> Question:
    import bayeq as bq

    return bq.simulate(system, n=4000, seed=1), {"chains": [chain], "inputs": ["u"]}


def _lorenz() -> Question:
    import bayeq as bq

    clean = bq.simulate("lorenz", n=1000, noise=0.0, seed=1)
    states = np.column_stack([clean[name] for name in "xyz"])
    noisy = states + 0.2 * states.std() * np.random.default_rng(1).standard_normal(states.shape)
    record = bq.Record.from_arrays(dict(zip("xyz", noisy.T, strict=True)), time=clean.time)
    return record, {"chains": ["x", "y", "z"], "dictionary": "polynomial:2"}


def _servo() -> Question:
    from studies import servo

    return servo.draw_record(1), {"chains": ["q::"], "inputs": ["F"], "dictionary": ["dq", "sign(dq)", "abs(dq)", "F"]}


def _circuit() -> Question:
    from studies import circuit

    return circuit.draw_record(1), {"chains": ["y::"], "inputs": ["u"], "dictionary": ["y", "dy", "y**2", "y**3", "u"]}


def _coupled() -> Question:
    from studies import coupled

    import bayeq as bq

    system, chains, terms = coupled.CASES["three masses, displacements"]
    full, inputs = coupled.draw_record(system, 1), list(system.inputs)
    measured = [name for chain in chains for name in chain.split(":") if name]
    record = bq.Record.from_arrays({name: full[name] for name in (*measured, *inputs)}, time=full.time)
    return record, {"chains": chains, "inputs": inputs, "dictionary": terms}


PROBLEMS: dict[str, Callable[[], Question]] = {
    f"{system} {chain}": (lambda system=system, chain=chain: _paper(system, chain))  # type: ignore[misc]
    for chain in ("x:v:a", "x::")
    for system in ("linear", "duffing", "quadratic", "coulomb")
} | {"Lorenz, 20 % of noise": _lorenz, "coupled": _coupled, "servo stage": _servo, "circuit": _circuit}


def answer(drawn: Path) -> float:
    """Processor time of an answer [s], after one that is not counted."""
    import bayeq as bq

    warnings.simplefilter("ignore")
    with np.load(drawn) as arrays:
        question = json.loads(str(arrays["question"]))
        channels = {name: arrays[name] for name in arrays if name not in ("question", "time")}
        records = bq.Record.from_arrays(channels, time=arrays["time"])
    bq.discover(records, **question)
    start = time.process_time()
    bq.discover(records, **question)
    return time.process_time() - start


def draw(problem: str, place: Path) -> None:
    """Write a record, and what is asked of it."""
    record, question = PROBLEMS[problem]()
    np.savez(place, question=json.dumps(question), time=record.time, **record.channels)


def measured(drawn: Path, source: Path) -> float:
    """The same by the program of a folder, in a process of its own."""
    paths = [str(source), str(OWN.parent)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "perf.discover", "--one", str(drawn)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(prog="python -m perf.discover", description="Processor time of discover.")
    parser.add_argument("--against", type=Path, help="folder of another program's sources")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.one:
        print(answer(given.one))
        return
    if given.against is None:
        parser.error("--against is missing: there is nothing to compare with")
    lines = []
    for problem in PROBLEMS:
        with tempfile.TemporaryDirectory() as folder:
            drawn = Path(folder) / "record.npz"
            draw(problem, drawn)
            pairs = [(measured(drawn, OWN), measured(drawn, given.against)) for _ in range(given.turns)]
        own, other = (statistics.median(times) for times in zip(*pairs, strict=True))
        lines.append(
            {"problem": problem, "own_s": f"{own:.2f}", "other_s": f"{other:.2f}", "ratio": f"{own / other:.2f}"}
        )
        print(*lines[-1].values(), sep="  ", flush=True)
    with RESULTS.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# python -m perf.discover --against OTHER/src; {platform.machine()}, medians of {given.turns}\n")
        writer = csv.DictWriter(file, list(lines[0]))
        writer.writeheader()
        writer.writerows(lines)


if __name__ == "__main__":
    main()
