"""Whole fits against their peers: time, accuracy and memory side by side, measured in one run.

    python -m perf.compare              # everything: perf/results, the tables of docs/performance.md, the chart
    python -m perf.compare --quick      # the small problems and few seeds, on the screen only
    python -m perf.compare --sizes duffing p200 n200000
    python -m perf.compare --docs       # tables and chart anew from perf/results

On small problems the contestants take turns in one process; on large ones each has a process of its own, with a time
limit.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from statistics import median

from threadpoolctl import threadpool_limits

from perf.accuracy import assess, together
from perf.optimum import count_better, write_counts
from perf.peers import CONTESTANTS, Contestant
from perf.problems import CASES, SYSTEMS, Case, Data
from perf.rows import Row, machine, read_rows, write_rows
from perf.table import plain_table, write_docs
from perf.timing import medians
from perf.worker import Outcome, run_apart

__all__ = ["compare", "measure_case"]

RESULTS = Path(__file__).parent / "results"
TABLE, OPTIMUM = RESULTS / "compare.csv", RESULTS / "optimum.csv"

# A single fit may take so long [s]; on a small case, where only samplers with a process of their own come near, longer.
LIMIT, SMALL_LIMIT = 30.0, 120.0

# Further fits of a contestant to a case are begun as long as this lasts [s].
PATIENCE = 3.0

# Time that turns of one contestant may take in all [s], and how many turns there may be: few numbers, so that many
# contestants take turns with each other.
TURNS = 1.0
ROUNDS = (50, 15, 5)

# Random problems, and oscillators of each system, on which models are compared.
RANDOM_PROBLEMS, OSCILLATORS = 200, 10

QUICK = ("linear", "duffing", "p36")
QUICK_CONTESTANTS = ["vb", "bma", "auto", "gibbs", "rvm", "stlsq", "lstsq", "ard", "lasso", "pysindy-stlsq", "abess"]


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _in_process(case: Case, contestant: Contestant, data: Sequence[Data], patience: float) -> Outcome:
    """Accuracy of a contestant on the problems of a small case, and first times."""
    outcome, p0 = Outcome(), case.prior_inclusion
    try:
        contestant(data[0].D, data[0].y, p0)  # compiles and loads
        began = time.perf_counter()
        for k, problem in enumerate(data):
            start = time.perf_counter()
            if k > 0 and start - began > patience:
                break
            fitted = contestant(problem.D, problem.y, p0)
            outcome.seconds.append(time.perf_counter() - start)
            outcome.answers.append(assess(problem, fitted, p0))
    except Exception as error:  # noqa: BLE001 - a peer that fails must not end the measurement of the others
        outcome.status = f"failed: {type(error).__name__}: {error}"[:120]
    return outcome


def _by_turns(case: Case, contestants: Sequence[Contestant], seeds: int, patience: float) -> dict[str, Outcome]:
    """A small case: everybody in this process; those of about the same speed take turns."""
    data = [case.make(seed) for seed in range(seeds)]
    outcomes = {c.name: _in_process(case, c, data, patience) for c in contestants}
    groups: dict[int, dict[str, Contestant]] = {}
    for contestant in contestants:
        if outcomes[contestant.name].seconds:
            possible = TURNS / median(outcomes[contestant.name].seconds)
            rounds = next((number for number in ROUNDS if number <= possible), 0)
            groups.setdefault(rounds, {})[contestant.name] = contestant
    D, y, p0 = data[0].D, data[0].y, case.prior_inclusion
    for rounds, group in groups.items():
        if rounds:
            fits = {name: (lambda c=contestant: c(D, y, p0)) for name, contestant in group.items()}
            for name, seconds in medians(fits, rounds).items():
                outcomes[name].seconds = [seconds] * rounds
    return outcomes


def _row(case: Case, contestant: Contestant, outcome: Outcome) -> Row:
    row = Row(case.name, case.rows, case.columns, contestant.name, outcome.status)
    if not outcome.answers:
        return row
    return replace(
        row,
        seconds=median(outcome.seconds),
        rounds=len(outcome.seconds),
        problems=len(outcome.answers),
        peak_mb=math.nan if outcome.peak_mb is None else outcome.peak_mb,
        extra_mb=math.nan if outcome.extra_mb is None else outcome.extra_mb,
        **dict(zip(("exact", "false", "missed", "error", "evidence"), astuple(together(outcome.answers)), strict=True)),
    )


def _exceeded(case: Case, contestant: Contestant, earlier: Iterable[Row]) -> str | None:
    """The case that was too much already, and was in no way larger, and the limit that it exceeded."""
    for row in earlier:
        if (
            row.contestant == contestant.name
            and row.status.startswith(">")
            and row.rows <= case.rows
            and row.columns <= case.columns
        ):
            return f"{row.case}: {row.status}"
    return None


def measure_case(
    case: Case,
    contestants: Sequence[Contestant],
    *,
    seeds: int | None = None,
    limit: float = LIMIT,
    patience: float = PATIENCE,
    earlier: Sequence[Row] = (),
) -> list[Row]:
    """All contestants on one case.

    Parameters
    ----------
    case : Case
        The problem.
    contestants : sequence of Contestant
        Who takes part.
    seeds : int, optional
        Problems for the accuracy; by default those of the case.
    limit, patience : float
        Time limit of a single fit on a large case, and of all fits of a contestant but the first together [s].
    earlier : sequence of Row
        Rows measured before: who exceeded the limit on a case that is not larger is not tried again.
    """
    case = replace(case, seeds=seeds or case.seeds)
    there = [c for c in contestants if c.installed and c.takes_part(case)]
    sharing = [] if case.large else [c for c in there if not c.apart]
    outcomes = {} if case.large else _by_turns(case, sharing, case.seeds, patience)
    for contestant in there:
        if contestant.name in outcomes:
            continue
        too_much = _exceeded(case, contestant, earlier)
        if too_much is not None:
            outcomes[contestant.name] = Outcome(status=f"not tried, for {too_much}")
            continue
        start = time.perf_counter()
        longest = limit if case.large else max(limit, SMALL_LIMIT)
        outcomes[contestant.name] = run_apart(case, contestant, longest, patience)
        _say(f"  {contestant.name}: {outcomes[contestant.name].status}, {time.perf_counter() - start:.1f} s in all")
    absent = {c.name: Outcome(status="not installed") for c in contestants if not c.installed and c.takes_part(case)}
    outcomes |= absent
    return [_row(case, c, outcomes[c.name]) for c in contestants if c.name in outcomes]


def compare(
    cases: Sequence[str],
    contestants: Sequence[str],
    *,
    seeds: int | None = None,
    limit: float = LIMIT,
    patience: float = PATIENCE,
) -> list[Row]:
    """All contestants on all cases, with one BLAS thread."""
    rows: list[Row] = []
    # small before large, so that who has exceeded the limit is known
    for case in sorted((CASES[name] for name in cases), key=lambda c: c.rows * c.columns):
        start = time.perf_counter()
        _say(f"{case.name} ({case.title})")
        chosen = [CONTESTANTS[name] for name in contestants]
        with threadpool_limits(1):
            rows += measure_case(case, chosen, seeds=seeds, limit=limit, patience=patience, earlier=rows)
        _say(f"  {time.perf_counter() - start:.0f} s")
    order = list(CASES)
    return sorted(rows, key=lambda row: order.index(row.case))


def _count() -> None:
    start = time.perf_counter()
    _say(f"evidence of models on {RANDOM_PROBLEMS} random problems and {OSCILLATORS} of each of {', '.join(SYSTEMS)}")

    def progress(done: int) -> None:
        if done % 50 == 0:
            _say(f"  {done} problems, {time.perf_counter() - start:.0f} s")

    with threadpool_limits(1):
        counts = count_better(RANDOM_PROBLEMS, OSCILLATORS, progress)
        write_counts(OPTIMUM, ["python -m perf.compare", *machine(1)], counts)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and write tables and chart."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the small problems and few seeds, on the screen only")
    parser.add_argument("--sizes", nargs="+", choices=CASES, metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--contestants", nargs="+", choices=CONTESTANTS, metavar="NAME", help=", ".join(CONTESTANTS))
    parser.add_argument("--limit", type=float, default=LIMIT, help="seconds for a single fit (default %(default)g)")
    parser.add_argument("--output", type=Path, help="CSV to write; by default perf/results for a full run, else none")
    parser.add_argument("--docs", action="store_true", help="measure nothing; tables and chart from perf/results")
    chosen = parser.parse_args(arguments)
    full = not (chosen.quick or chosen.sizes or chosen.contestants)
    if chosen.docs and not TABLE.exists():
        parser.error(f"{TABLE} is not there: measure first, by python -m perf.compare")
    if not chosen.docs:
        cases = chosen.sizes or (QUICK if chosen.quick else tuple(CASES))
        names = chosen.contestants or (QUICK_CONTESTANTS if chosen.quick else tuple(CONTESTANTS))
        start = time.perf_counter()
        rows = compare(cases, names, seeds=3 if chosen.quick else None, limit=chosen.limit)
        with threadpool_limits(1):
            where = machine(1)
        limits = f"a fit may take {chosen.limit:g} s, on small problems {max(chosen.limit, SMALL_LIMIT):g} s"
        remarks = [f"python -m perf.compare; {limits}", *where]
        output = chosen.output or (TABLE if full else None)
        if output:
            write_rows(output, remarks, rows)
        print("\n".join(remarks))
        print(plain_table(rows))
        if full:
            _count()
        _say(f"{time.perf_counter() - start:.0f} s in all")
    if chosen.docs or (full and chosen.output is None):
        from perf.chart import write_chart

        write_docs(*read_rows(TABLE))
        write_chart(read_rows(TABLE)[1])


if __name__ == "__main__":
    main()
