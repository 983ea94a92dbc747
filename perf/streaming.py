"""Rows per second and memory of records that are read some rows at a time, beside the product of matrices alone.

    python -m perf.streaming FOLDER --rows 1e4 1e5 1e6 1e7 1e8          # adds lines to perf/results/streaming.csv
    python -m perf.streaming FOLDER --rows 1e5 1e6 1e7 --smooth auto

FOLDER keeps the files, 36 bytes a row. `syrk` is the time that BLAS takes for the products of the dictionary's columns
and the target alone (36 + 1, `dsyrk` on blocks of 2,048 rows that are in the cache), in as many processes, measured
before and after each pass over the file in the same process. Every line is a process of its own: `peak_mb` is all of
its memory.
"""

from __future__ import annotations

import argparse
import csv
import json
import resource
import subprocess
import sys
import time as clock
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from scipy.linalg.blas import dsyrk
from threadpoolctl import threadpool_limits

RESULTS = Path(__file__).parent / "results" / "streaming.csv"
CHANNELS = ("x", "v", "a", "u")
COLUMNS, BLOCK = 37, 2048
PIECE = 1_000_000

# Products of blocks that are timed, per process.
PRODUCTS = 5000


def write_file(rows: int, folder: Path) -> Path:
    """A Duffing oscillator of some rows, simulated in pieces of a million."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    import bayeq as bq

    path = folder / f"duffing_{rows:.0e}.parquet"
    if path.exists():
        return path
    part = path.with_suffix(".part")
    writer = None
    for first in range(0, rows, PIECE):
        record = bq.simulate("duffing", n=min(PIECE, rows - first), seed=1 + first // PIECE)
        time = (first + np.arange(record.n)) / 1000.0
        table = pa.table({"t": time, **{name: record[name] for name in CHANNELS}})
        writer = writer or pq.ParquetWriter(part, table.schema, use_dictionary=False)
        writer.write_table(table)
    assert writer is not None
    writer.close()
    part.rename(path)
    return path


def _products(_: int) -> float:
    """Rows per second of the products in this process."""
    rng = np.random.default_rng(0)
    block, total = np.asfortranarray(rng.normal(size=(COLUMNS, BLOCK))), np.zeros((COLUMNS, COLUMNS), order="F")
    with threadpool_limits(1):
        began = clock.perf_counter()
        for _ in range(PRODUCTS):
            dsyrk(1.0, block, beta=1.0, c=total, overwrite_c=1)
        return PRODUCTS * BLOCK / (clock.perf_counter() - began)


def syrk_rate(workers: int) -> float:
    """Rows per second of the products alone, in processes: of one process `dsyrk` lets only one thread work."""
    with ProcessPoolExecutor(workers) as pool:
        list(pool.map(_products, range(workers)))  # starts them
        return sum(pool.map(_products, range(workers)))


def measure(path: Path, smooth: str, workers: int) -> dict[str, object]:
    """One line: a whole `discover` of a file, and of that the passes over its rows."""
    from bayeq.discovery import discover
    from bayeq.discovery.streaming import work as summing

    spent: dict[str, float] = {}
    whole = summing.fold
    summing.by_threads.__defaults__ = (workers,)

    def timed(
        work: object, units: object, executor: object, progress: object, stage: str, kept: object = None
    ) -> object:
        began = clock.perf_counter()
        try:
            return whole(work, units, executor, progress, stage, kept)  # type: ignore[arg-type]
        finally:
            spent[stage] = spent.get(stage, 0.0) + clock.perf_counter() - began

    from bayeq.discovery.streaming import whole as streaming

    streaming.fold = timed  # type: ignore[assignment]
    before = syrk_rate(workers)
    began = clock.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        answer = discover(path, displacement="x", velocity="v", acceleration="a", force="u", smooth=smooth, stream=True)
    seconds = clock.perf_counter() - began
    after = syrk_rate(workers)
    rows, passes = answer.data.n, sum(spent.values())
    syrk = 0.5 * (before + after)
    return {
        "rows": rows,
        "smooth": smooth,
        "workers": workers,
        "seconds": round(seconds, 2),
        "pass_seconds": round(passes, 2),
        "rows_per_second": round(rows / passes),
        "syrk_rows_per_second": round(syrk),
        "ratio": round(rows / passes / syrk, 3),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "terms": " ".join(answer[0].included),
    }


def main() -> None:
    """Measure, each line in a process of its own, and add to the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", type=float, nargs="+", default=[1e6])
    parser.add_argument("--smooth", default="none")
    parser.add_argument("--workers", type=int, nargs="+", default=[2])
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one is not None:
        print(json.dumps(measure(given.one, given.smooth, given.workers[0])))
        return
    for rows in map(int, given.rows):
        path = write_file(rows, given.folder)
        for workers in given.workers:
            command = [sys.executable, "-m", "perf.streaming", str(given.folder), "--one", str(path)]
            done = subprocess.run(
                [*command, "--smooth", given.smooth, "--workers", str(workers)],
                capture_output=True,
                text=True,
                check=True,
            )
            line = json.loads(done.stdout)
            new = not RESULTS.exists()
            with RESULTS.open("a", newline="") as file:
                writer = csv.DictWriter(file, line)
                if new:
                    file.write("# python -m perf.streaming FOLDER; rows per second of the passes over the file\n")
                    writer.writeheader()
                writer.writerow(line)
            print(line, file=sys.stderr)


if __name__ == "__main__":
    main()
