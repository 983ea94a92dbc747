"""How long a command takes to start, as a ratio to the time of importing NumPy, numba and scipy.optimize.

    python -m perf.startup
    python -m perf.startup --first      # also the first `bayeq discover`, with nothing compiled: minutes

Each run is a process of its own, with the byte code of all that it imports in place, as an installation has it. They
take turns, so that a noisy machine is noisy for all of them; processor time (user and system) beside the clock tells
how noisy it was. Writes perf/results/startup.csv.
"""

from __future__ import annotations

import argparse
import csv
import os
import platform
import resource
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results" / "startup.csv"
ROWS = 4000
TURNS = 5

REFERENCE = ("-c", "import numpy, numba, scipy.optimize")

# Largest ratio of each command to the reference, and the exit code that it must have.
COMMANDS = {
    "bayeq --help": (0.5, 0),
    "bayeq discover --help": (0.5, 0),
    "bayeq discover missing.csv --disp x": (0.5, 2),
    "bayeq discover duffing.csv --dips x": (0.5, 2),
    "bayeq discover duffing.csv --disp y": (0.5, 2),
    "bayeq discover duffing.csv --disp x --vel v --acc a --force u": (1.6, 0),
}
FIRST, FIRST_RATIO = list(COMMANDS)[-1], 30.0


def seconds(arguments: tuple[str, ...], folder: Path, code: int, **environment: str) -> tuple[float, float]:
    """Time by the clock and processor time of a Python process.

    Raises
    ------
    RuntimeError
        It ended with another exit code.
    """
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "bytecode"), **environment}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, check=False)
    clock, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != code:
        raise RuntimeError(f"{shlex.join(arguments)}: exit code {done.returncode}: {done.stderr.decode()}")
    return clock, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def medians(
    runs: dict[str, Callable[[], tuple[float, float]]], turns: int, warm: bool
) -> dict[str, tuple[float, float]]:
    """Median clock and processor time of each run over some turns, after one that does not count if `warm`."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for turn in range(turns + warm):
        for name, run in runs.items():
            pair = run()
            if turn >= warm:
                taken[name].append(pair)
    return {
        name: (statistics.median(p[0] for p in pairs), statistics.median(p[1] for p in pairs))
        for name, pairs in taken.items()
    }


def measure(folder: Path, turns: int, first: bool) -> list[dict[str, object]]:
    """A row for each command."""

    def command(text: str, **environment: str) -> tuple[float, float]:
        return seconds(("-m", *shlex.split(text)), folder, COMMANDS[text][1], **environment)

    def first_run() -> tuple[float, float]:
        with tempfile.TemporaryDirectory() as cache:
            return command(FIRST, NUMBA_CACHE_DIR=cache)

    simulation = f"bayeq simulate duffing --n {ROWS} --seed 1 -o duffing.csv"
    seconds(("-m", *shlex.split(simulation)), folder, 0)
    runs: dict[str, Callable[[], tuple[float, float]]] = {"reference": lambda: seconds(REFERENCE, folder, 0)}
    runs |= {text: lambda text=text: command(text) for text in COMMANDS}
    taken = medians(runs, turns, warm=True)
    reference = taken.pop("reference")
    goals = {name: goal for name, (goal, _) in COMMANDS.items()}
    if first:
        name = f"NUMBA_CACHE_DIR=empty {FIRST}"
        taken |= medians({name: first_run}, turns, warm=False)
        goals[name] = FIRST_RATIO
    rows = [("python " + shlex.join(REFERENCE), reference, None)]
    rows += [(name, pair, goals[name]) for name, pair in taken.items()]
    return [
        {
            "command": name,
            "seconds": f"{clock:.3f}",
            "ratio": f"{clock / reference[0]:.2f}",
            "processor_seconds": f"{processor:.3f}",
            "processor_ratio": f"{processor / reference[1]:.2f}",
            "at_most": "" if goal is None else goal,
        }
        for name, (clock, processor), goal in rows
    ]


def main(arguments: list[str] | None = None) -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description="Ratios of start-up times to that of imports.")
    parser.add_argument("--first", action="store_true", help="also with nothing compiled")
    parser.add_argument("--turns", type=int, default=TURNS)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder), given.turns, given.first)
    with RESULTS.open("w", newline="") as file:
        file.write(f"# python -m perf.startup{' --first' * given.first}; {platform.machine()}, {os.cpu_count()} cores,")
        file.write(f" Python {platform.python_version()}, NumPy {np.__version__}; medians of {given.turns} turns\n")
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    print(RESULTS.read_text(), end="")


if __name__ == "__main__":
    main()
