"""Two workers of a Dask cluster against one, one thread each, on the likelihood of a long record.

    python -m perf.cluster                      # some minutes
    python -m perf.cluster --rows 262144 --turns 3

Both clusters are there all the time and take turns, so that a noisy machine is noisy for both; processor time of the
workers beside the clock tells how noisy it was: idle cores need the same processor time in both. Timed are the passes
over all rows (the stages "likelihood of ... rows"), and the whole of `discover`, of which the search over stretches is
done by the caller alone. Writes perf/results/cluster.csv.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import bayeq as bq

RESULTS = Path(__file__).parent / "results" / "cluster.csv"
OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
LEAST = 1.6


class Stages:
    """Seconds of the passes over all rows; `bayeq.discover` calls it with its progress."""

    def __init__(self) -> None:
        self.seconds, self.rows = 0.0, 0
        self.since, self.stage = time.perf_counter(), ""

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.perf_counter()
        if self.stage == stage and stage.startswith("likelihood of"):
            self.seconds += now - self.since
            if done == total:
                self.rows += total
        self.since, self.stage = now, stage


def processor_time() -> float:
    """Of the process that it is called in [s]."""
    return time.process_time()


def run(client: Any, path: Path) -> dict[str, float]:
    """One run: seconds of the passes, of all, and of the workers' processors."""
    stages, before = Stages(), sum(client.run(processor_time).values())
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = bq.discover(path, **OSCILLATOR, client=client, progress=stages)
    whole = time.perf_counter() - start
    assert found[0].included == ("x", "v", "x**3", "u"), found[0].included
    workers = sum(client.run(processor_time).values()) - before
    return {"pass_seconds": stages.seconds, "pass_rows": stages.rows, "seconds": whole, "processor_seconds": workers}


def local(workers: int) -> Any:
    """A cluster of processes of one thread each."""
    from distributed import LocalCluster

    return LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0")


def measure(path: Path, turns: int, say: Callable[[str], None]) -> dict[int, dict[str, float]]:
    """Medians by the number of workers, after a turn that does not count."""
    from distributed import Client

    taken: dict[int, list[dict[str, float]]] = {1: [], 2: []}
    with local(1) as one, local(2) as two:
        clients = {1: Client(one, set_as_default=False), 2: Client(two, set_as_default=False)}
        for turn in range(turns + 1):
            for count, client in clients.items():
                found = run(client, path)
                say(f"turn {turn}, {count} workers: " + ", ".join(f"{name} {x:.1f}" for name, x in found.items()))
                if turn:
                    taken[count].append(found)
        for client in clients.values():
            client.close()
    return {k: {name: statistics.median(one[name] for one in runs) for name in runs[0]} for k, runs in taken.items()}


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=2**20)
    parser.add_argument("--turns", type=int, default=5)
    given = parser.parse_args()
    began = datetime.now(UTC)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "duffing.parquet"
        bq.write(bq.simulate("duffing", n=given.rows, seed=1), path)
        load = os.getloadavg()[0]
        found = measure(path, given.turns, print)
    with RESULTS.open("w", newline="") as file:
        file.write(
            f"# python -m perf.cluster --rows {given.rows} --turns {given.turns}; {began:%Y-%m-%d %H:%M} UTC, load"
            f" average {load:.1f} at the start and {os.getloadavg()[0]:.1f} at the end; {platform.machine()},"
            f" {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}; medians\n"
        )
        writer = csv.writer(file)
        writer.writerow(["workers", *found[1], "pass_ratio", "ratio"])
        for count, row in found.items():
            ratios = [found[1][name] / row[name] for name in ("pass_seconds", "seconds")]
            writer.writerow([count, *(f"{x:.2f}" for x in row.values()), *(f"{x:.2f}" for x in ratios)])
    ratio = found[1]["pass_seconds"] / found[2]["pass_seconds"]
    print(
        f"two workers are {ratio:.2f} times as fast as one in the passes over all rows (at least {LEAST} on idle cores)"
    )


if __name__ == "__main__":
    main()
