"""Fuzz parsers: ``python -m tests.fuzz TARGET... --runs N``.

With atheris (``pip install atheris``) inputs are guided by the lines that they reach, without by the answers that they
get. Counts and what was found are kept in ``--state``, so that a run goes on from there when it is started again; every
finding is one file in that folder. ``--table`` prints the counts of all targets as a table.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

from tests.fuzz.mutate import pool_of
from tests.fuzz.targets import TARGETS, Target

CORPUS = Path(__file__).parent / "corpus"
EVERY = 500  # executions after which counts are written
SLOW = 5.0  # seconds of one input on the processor


class Watch:
    """Runs one target: counts, and keeps what it finds."""

    def __init__(self, name: str, engine: str, state: Path) -> None:
        self.target, self.name, self.engine, self.state = TARGETS[name], name, engine, state
        state.mkdir(parents=True, exist_ok=True)
        self.path = state / f"{name}.json"
        self.counts: dict[str, int] = {"own": 0, "atheris": 0, "findings": 0}
        if self.path.exists():
            self.counts |= json.loads(self.path.read_text())

    def answer(self, data: bytes) -> str:
        """Run one input, and say in words how it went."""
        current = self.state / f"{self.name}.current"
        if not self.target.own:  # a library may end the process
            current.write_bytes(data)
        began = time.process_time()
        how = "answered"
        try:
            self.target.run(data)
        except Exception as error:  # noqa: BLE001  # this is what is looked for
            how = self._found(data, error)
        if time.process_time() - began > SLOW:
            how = self._found(data, TimeoutError(f"more than {SLOW:g} s"))
        self.counts[self.engine] += 1
        if self.counts[self.engine] % EVERY == 0:
            self.write()
        return how

    def write(self) -> None:
        """Keep the counts."""
        self.path.write_text(json.dumps(self.counts))

    def _found(self, data: bytes, error: Exception) -> str:
        own = [f for f in traceback.extract_tb(error.__traceback__) if "bayeq" in f.filename]
        where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
        how = f"{type(error).__name__} at {where}: {re.sub('[0-9]+', '9', str(error))[:80]}"
        place = self.state / f"{self.name}-{hashlib.sha256(how.encode()).hexdigest()[:10]}"
        if not place.exists():
            place.write_bytes(data)
            place.with_suffix(".txt").write_text(how + "\n\n" + "".join(traceback.format_exception(error)))
            self.counts["findings"] += 1
            print(f"{self.name}: {how}: {place}", file=sys.stderr, flush=True)
        return how


def starts(name: str, target: Target) -> list[bytes]:
    """Valid inputs, and those that something was found with."""
    kept = CORPUS / name
    return target.seeds() + [path.read_bytes() for path in sorted(kept.glob("*"))]


def run_own(name: str, runs: int, state: Path, seconds: float = float("inf")) -> dict[str, int]:
    """Mutate until `runs` inputs were run in all, or for some time."""
    watch = Watch(name, "own", state)
    done, until = watch.counts["own"], time.monotonic() + seconds
    rng = np.random.default_rng([int.from_bytes(name.encode(), "big"), done])
    loop = pool_of(rng, starts(name, watch.target), watch.target.words, watch.answer)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while watch.counts["own"] < runs:
            next(loop)
            if time.monotonic() > until:
                break
    watch.write()
    return watch.counts


def run_atheris(name: str, runs: int, state: Path) -> dict[str, int]:
    """Let atheris look for inputs that reach new lines, until `runs` were run in all; it goes on from its corpus."""
    watch = Watch(name, "atheris", state)
    pool = state / f"{name}.corpus"
    pool.mkdir(exist_ok=True)
    for data in starts(name, watch.target):
        (pool / hashlib.sha256(data).hexdigest()).write_bytes(data)
    words = state / f"{name}.words"
    words.write_text("".join(f'"{"".join(f"{chr(92)}x{b:02x}" for b in word)}"\n' for word in watch.target.words))
    left = runs - watch.counts["atheris"]
    if left > 0:
        options = [f"-runs={left}", f"-dict={words}", "-max_len=20000", "-timeout=60", "-rss_limit_mb=4096"]
        command = [sys.executable, "-m", "tests.fuzz.coverage", name, str(state), str(pool), *options, "-verbosity=0"]
        ended = subprocess.run(command, check=False, env={**os.environ, "PYTHONWARNINGS": "ignore"})
        if ended.returncode:
            print(f"{name}: the fuzzer ended with {ended.returncode}", file=sys.stderr)
    return Watch(name, "atheris", state).counts


def table(state: Path) -> None:
    """Print the counts of all targets."""
    print("# python -m tests.fuzz; python -m tests.fuzz --table")
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow(["target", "parser", "mutations", "coverage_guided", "open_findings", "mended_and_kept"])
    for name, target in TARGETS.items():
        counts = Watch(name, "own", state).counts
        kept = len([*(CORPUS / name).glob("*")])
        parser = "own" if target.own else "library"
        out.writerow([name, parser, counts["own"], counts["atheris"], counts["findings"], kept])


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all by default")
    parser.add_argument("--runs", type=int, help="inputs in all (1,000,000; 100,000 where a library parses)")
    parser.add_argument("--engine", choices=["auto", "own", "atheris"], default="auto")
    parser.add_argument("--state", type=Path, default=Path(".fuzz"), help="folder of counts and findings (.fuzz)")
    parser.add_argument("--table", action="store_true", help="print the counts so far")
    given = parser.parse_args()
    unknown = [name for name in given.targets if name not in TARGETS]
    if unknown:
        parser.error(f"no target {unknown[0]!r}; there are: {', '.join(TARGETS)}")
    state = given.state.resolve()
    if given.table:
        table(state)
        return 0
    guided = given.engine == "atheris" or (given.engine == "auto" and importlib.util.find_spec("atheris") is not None)
    found = 0
    for name in given.targets or TARGETS:
        runs = given.runs or (1_000_000 if TARGETS[name].own else 100_000)
        began = time.monotonic()
        counts = run_atheris(name, runs, state) if guided else run_own(name, runs, state)
        found += counts["findings"]
        print(f"{name}: {counts}, {time.monotonic() - began:.0f} s", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main())
