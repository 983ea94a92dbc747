"""Commands that are killed (SIGKILL, the whole process group) at random moments, and go on until they end.

Each record is one job: a command is started, killed at a moment drawn from 0 to the time that it takes (to part of it
where it goes on from what it kept), started again and so on, at last left alone; then its result is compared byte by
byte with that of a run that nobody disturbed. After every kill its files are looked at: each is not there yet, or
whole, and a store holds rows of the undisturbed run only.

    python -m studies.kills --first-seed 30000 > docs/tables/reliability_kills.csv
"""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

import bayeq as bq
from studies.resumable import Cell, Outcome, run_study

__all__ = ["JOBS", "Job", "disturbed", "main", "prepare", "undisturbed"]

RECORDS = 10

# Kills of one job, at most: one that comes after its end is none.
KILLS = 5

ROWS = 60_000
FILES = 8

CHANNELS = "--disp x --vel v --acc a --force u --dictionary x,v,x**3,u --smooth none"

# The command with sums kept after every unit of rows, and small units.
BAYEQ = """
import sys
from bayeq.records.formats import text
from bayeq.discovery.streaming import checkpoint
from bayeq.cli.process import run
text.UNIT_ROWS, checkpoint.EVERY = 4000, 0.0
sys.exit(run())
"""

Rows = frozenset[tuple[object, ...]]


@dataclass(frozen=True)
class Job:
    """A command, and the files that it writes.

    Attributes
    ----------
    words : str
        After ``bayeq``.
    written : sequence of str
        Files that are there whole, or not at all.
    store : str
        An SQLite file, if there is one.
    within : float
        Kills come within this part of its time: less than all of it where the command goes on from what it kept, for it
        ends sooner each time.
    """

    words: str
    written: Sequence[str] = ()
    store: str = ""
    within: float = 1.0

    def start(self, folder: Path, first: Callable[[], None] | None = None) -> subprocess.Popen[bytes]:
        """Start it in a process group of its own; `first` is what the process does first."""
        return subprocess.Popen(
            [sys.executable, "-c", BAYEQ, *self.words.split()],
            cwd=folder,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,
            preexec_fn=first,
        )

    def finish(self, folder: Path) -> float:
        """Let it run to its end; the time that it takes [s]."""
        began = time.monotonic()
        process = self.start(folder)
        _, said = process.communicate()
        if process.returncode:
            raise RuntimeError(f"bayeq {self.words}: {process.returncode}: {said.decode(errors='replace')}")
        return time.monotonic() - began

    def kill(self, folder: Path, after: float) -> bool:
        """Start it and kill it with all its processes; whether that was before its end."""
        process = self.start(folder)
        try:
            process.communicate(timeout=after)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
        return process.returncode == -signal.SIGKILL

    def files(self, folder: Path) -> dict[str, bytes]:
        """What it has written so far."""
        return {name: (folder / name).read_bytes() for name in self.written if (folder / name).exists()}

    def rows(self, folder: Path) -> Rows:
        """What its store holds so far, without times.

        Raises
        ------
        RuntimeError
            It is corrupt, or a row is there twice.
        """
        path = folder / self.store
        if not self.store or not path.exists():
            return frozenset()
        with closing(sqlite3.connect(path)) as opened:
            verdict = opened.execute("PRAGMA integrity_check").fetchone()[0]
            if verdict != "ok":
                raise RuntimeError(f"{path}: {verdict}")
            return frozenset(_rows(opened))


def _rows(opened: sqlite3.Connection) -> Iterator[tuple[object, ...]]:
    """Rows of all tables, each once."""
    seen = set()
    for (table,) in opened.execute(
        "SELECT name FROM sqlite_master WHERE type = 'table' AND name != ?", (PASSING,)
    ).fetchall():
        read = opened.execute(f'SELECT * FROM "{table}"')  # names of our own tables
        names = [column[0] for column in read.description]
        for values in read:
            row = (table, *(v for name, v in zip(names, values, strict=True) if name not in UNEQUAL))
            if row in seen:
                raise RuntimeError(f"{table}: a row is there twice: {row}")
            seen.add(row)
            yield row


# Columns that differ between runs in two folders: how long it took, and where.
UNEQUAL = ("seconds", "path")

# What a process is working at, which is no result.
PASSING = "claims"

NAMES = " ".join(f"run{k}.csv" for k in range(FILES))

JOBS = {
    "discover --checkpoint": Job(
        f"discover long.csv {CHANNELS} --stream --checkpoint sums --save eq.json", ["eq.json"]
    ),
    "discover --report": Job(
        f"discover run0.csv {CHANNELS} --save eq.json --report page.html", ["eq.json", "page.html"]
    ),
    "study": Job(
        "study table2 --realisations 120 --systems linear,coulomb --algorithms rvm,vb --store study.db",
        store="study.db",
        within=0.4,
    ),
    "batch": Job(
        f"batch {NAMES} {CHANNELS} --jobs 2 --store batch.db --table drift.csv", ["drift.csv"], "batch.db", within=0.6
    ),
    "batch --common": Job(
        f"batch {NAMES} {CHANNELS} --common --store common.db --table drift.csv", ["drift.csv"], "common.db", within=0.6
    ),
}


def prepare(folder: Path) -> None:
    """Write the measured files, the same in every folder, times of change too."""
    for name, n, seed in (("long.csv", ROWS, 1), *((f"run{k}.csv", 800, k) for k in range(FILES))):
        path = folder / name
        path.write_bytes(_content(n, seed))
        os.utime(path, (1e9, 1e9))


@lru_cache(maxsize=16)
def _content(n: int, seed: int) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.csv"
        bq.write(bq.simulate("duffing", n=n, seed=seed), path)
        return path.read_bytes()


@lru_cache(maxsize=16)
def undisturbed(name: str) -> tuple[float, dict[str, bytes], Rows]:
    """Time [s] and results of a run that nobody disturbs."""
    job = JOBS[name]
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        for folder in map(Path, (first, second)):  # the first may compile
            prepare(folder)
            seconds = job.finish(folder)
        return seconds, job.files(folder), job.rows(folder)


def disturbed(name: str, seed: int, kills: int = KILLS) -> Outcome:
    """Kill a job at random moments, let it end, and compare.

    Returns
    -------
    mapping
        ``kills`` that came before the end; ``partial``, how often a file was there that was not whole, or a row that
        is not one of the undisturbed run; ``same``, whether the results are the same at the end.
    """
    job, rng = JOBS[name], np.random.default_rng(seed)
    seconds, files, rows = undisturbed(name)
    hits = wrong = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        prepare(folder)
        for _ in range(kills):
            hits += job.kill(folder, float(rng.uniform(0.0, job.within * seconds)))
            whole = all(content == files[name] for name, content in job.files(folder).items())
            wrong += not (whole and job.rows(folder) <= rows)
        job.finish(folder)
        same = job.files(folder) == files and job.rows(folder) == rows
    return {"kills": hits, "partial": wrong, "same": same}


def _summary(outcomes: Sequence[Outcome]) -> Iterator[dict[str, object]]:
    yield {
        "kills": sum(one["kills"] for one in outcomes),
        "damaged_after_a_kill": sum(one["partial"] for one in outcomes),
        "other_result_at_the_end": sum(not one["same"] for one in outcomes),
    }


def _cell(name: str) -> Cell:
    measure: Callable[[int], Outcome] = partial(disturbed, name)
    return Cell({"command": name}, RECORDS, measure)


def main(arguments: list[str] | None = None) -> None:
    """Write the table; see the module."""
    run_study("kills", "Commands killed at random moments.", [_cell(name) for name in JOBS], _summary, arguments)


if __name__ == "__main__":
    main()
