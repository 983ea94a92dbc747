"""One contestant on one case in a process of its own, where its memory can be told and its time limited.

    python -m perf.worker CASE CONTESTANT SEEDS LIMIT PATIENCE

prints a line of JSON for every problem that was solved, SEEDS at most. The limit, in seconds, is that of a single fit;
further fits are begun as long as patience, in seconds, lasts.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple, dataclass, field, replace
from importlib import import_module
from pathlib import Path

from perf.accuracy import Accuracy, assess
from perf.peers import CONTESTANTS, Contestant
from perf.problems import CASES, Case, Data, Fitted

__all__ = ["Outcome", "run_apart", "single_threaded"]

# More memory than this ends in a MemoryError.
MOST_BYTES = 12 * 2**30

# The first fit compiles and loads; so many more are timed if they are quick.
ROUNDS = 3

# Rows and columns of the fit that loads what a contestant needs, before memory and time are looked at.
WARM_ROWS, WARM_COLUMNS = 200, 36

STATUS = Path("/proc/self/status")
RESET = Path("/proc/self/clear_refs")
MIB = 2**20


@dataclass(slots=True)
class Outcome:
    """What is known of a contestant on a case.

    Attributes
    ----------
    status : str
        "ok", or why there is no answer.
    seconds : list of float
        Times of single fits to the first problem.
    answers : list of Accuracy
        One for each problem.
    peak_mb, extra_mb : float or None
        Most memory that the process held during the fit, and that above what it held before, the data included [MiB].
    """

    status: str = "ok"
    seconds: list[float] = field(default_factory=list)
    answers: list[Accuracy] = field(default_factory=list)
    peak_mb: float | None = None
    extra_mb: float | None = None


def single_threaded() -> dict[str, str]:
    """Environment of a process in which BLAS, OpenMP and XLA use one thread."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    xla = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    return {**os.environ, **dict.fromkeys(names, "1"), "XLA_FLAGS": xla}


def _held() -> tuple[float, float]:
    """Memory that this process holds, and the most it has held [MiB].

    On Linux from /proc: `ru_maxrss` starts at what the parent process held.
    """
    if not STATUS.exists():
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (MIB if sys.platform == "darwin" else 1024)
        return most, most
    lines = dict(line.split(":", 1) for line in STATUS.read_text().splitlines())
    now, most = (float(lines[key].split()[0]) / 1024 for key in ("VmRSS", "VmHWM"))
    return now, most


@contextmanager
def _within(seconds: float) -> Iterator[None]:
    """End this process if the time runs out, even in compiled code."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _say(**values: object) -> None:
    print(json.dumps(values), flush=True)


def _warm_up(contestant: Contestant, data: Data, p0: float) -> None:
    """Load, and compile, what a contestant needs."""
    if contestant.apart:
        import_module(contestant.package)
    else:
        contestant(data.D[:WARM_ROWS, :WARM_COLUMNS].copy(), data.y[:WARM_ROWS].copy(), p0)


def _solve(case: Case, contestant: Contestant, limit: float, patience: float) -> None:
    """All problems of a case, as long as patience lasts."""
    p0 = case.prior_inclusion

    def fit(data: Data) -> tuple[float, Fitted]:
        with _within(limit):
            start = time.perf_counter()
            fitted = contestant(data.D, data.y, p0)
            return time.perf_counter() - start, fitted

    data = case.make(0)
    _warm_up(contestant, data, p0)
    if os.access(RESET, os.W_OK):
        RESET.write_text("5")  # the most that has been held starts again from here
    before = _held()[0]
    first, fitted = fit(data)
    peak = _held()[1]
    _say(seconds=[first], answer=astuple(assess(data, fitted, p0)), peak_mb=peak, extra_mb=peak - before)
    del fitted
    began = time.perf_counter()

    def patient() -> bool:
        return time.perf_counter() - began + first < patience

    seconds = [fit(data)[0] for _ in range(ROUNDS) if patient()]
    if seconds:
        _say(seconds=seconds)
    for seed in range(1, case.seeds):
        if patient():
            data = case.make(seed)
            _say(answer=astuple(assess(data, fit(data)[1], p0)))


def run_apart(case: Case, contestant: Contestant, limit: float, patience: float) -> Outcome:
    """Run a contestant in a process of its own."""
    numbers = map(str, (case.seeds, limit, patience))
    command = [sys.executable, "-m", "perf.worker", case.name, contestant.name, *numbers]
    done = subprocess.run(command, capture_output=True, text=True, env=single_threaded(), check=False)
    outcome = Outcome()
    for line in done.stdout.splitlines():
        if not line.startswith("{"):
            continue  # some packages print
        said = json.loads(line)
        outcome.seconds = said.get("seconds", outcome.seconds)
        outcome.peak_mb = said.get("peak_mb", outcome.peak_mb)
        outcome.extra_mb = said.get("extra_mb", outcome.extra_mb)
        if "answer" in said:
            outcome.answers.append(Accuracy.of(said["answer"]))
        outcome.status = said.get("status", outcome.status)
    if outcome.answers:
        return outcome
    if done.returncode == -signal.SIGALRM:
        outcome.status = f"> {limit:g} s"
    elif outcome.status == "ok":
        tail = done.stderr.strip().splitlines()
        outcome.status = f"failed: {tail[-1][:120] if tail else f'exit code {done.returncode}'}"
    return outcome


def main() -> None:
    """Run one contestant; called by `run_apart`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("contestant", choices=CONTESTANTS)
    parser.add_argument("seeds", type=int)
    parser.add_argument("limit", type=float)
    parser.add_argument("patience", type=float)
    arguments = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    case = replace(CASES[arguments.case], seeds=arguments.seeds)
    try:
        _solve(case, CONTESTANTS[arguments.contestant], arguments.limit, arguments.patience)
    except MemoryError:
        _say(status=f"> {MOST_BYTES // 2**30} GB")


if __name__ == "__main__":
    main()
