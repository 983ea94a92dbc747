"""Published benchmarks: cells of simulated records, with outcomes stored in an SQLite file as they are computed."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bayeq.arrays import Floats
from bayeq.errors import BayeqError, BayeqWarning, whole_number
from bayeq.expressions import parse
from bayeq.resumable.store import MAX_JOBS, Key, ResultStore, fill
from bayeq.systems import System

# Key of the constant of an equation in a `Law`.
CONSTANT = "1"

#: Most records of a cell; a larger number is taken for a typing mistake.
MOST_RECORDS = 10_000

Cell = tuple[str | float, ...]
Outcome = dict[str, Any]
Measure = Callable[[Cell, int], Outcome]
Law = Mapping[str, float]


class _Outcomes(ResultStore):
    """A file of outcomes, by cell and seed."""

    application, noun = 0x62797163, "a benchmark"  # "byqc"
    schema = (
        "CREATE TABLE results (cell TEXT NOT NULL, seed INTEGER NOT NULL, outcome TEXT NOT NULL,"
        " PRIMARY KEY (cell, seed)) WITHOUT ROWID",
    )
    table, key, again = "results", {"cell": "TEXT", "seed": "INTEGER"}, "IGNORE"

    def missing(self, cells: Sequence[str], seeds: Sequence[int]) -> list[list[Key]]:
        """Keys without an outcome: all cells with the first seed, then all with the next."""
        there = set(self._read("SELECT cell, seed FROM results"))
        return [[(cell, seed)] for seed in seeds for cell in cells if (cell, seed) not in there]

    def outcomes(self, cell: str, seeds: Sequence[int]) -> list[Outcome]:
        """The stored outcomes of a cell, in the order of the seeds."""
        there = dict(self._read("SELECT seed, outcome FROM results WHERE cell = ?", (cell,)))
        return [json.loads(there[seed]) for seed in seeds if seed in there]


class Cells(NamedTuple):
    """The requested cells, and the list of outcomes of each."""

    cells: Sequence[Cell]
    outcomes: Sequence[list[Outcome]]

    def grouped(self, key: Callable[[Cell], Cell]) -> dict[Cell, list[tuple[str, Outcome]]]:
        """Pairs (system, outcome), grouped by a key of their cells; groups without outcomes are absent."""
        out: dict[Cell, list[tuple[str, Outcome]]] = {}
        for cell, outcomes in zip(self.cells, self.outcomes, strict=True):
            for one in outcomes:
                out.setdefault(key(cell), []).append((str(cell[0]), one))
        return out


def run_cells(
    store: str | Path,
    name: str,
    cells: Sequence[Cell],
    measure: Measure,
    *,
    records: int,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Cells:
    """Measure the cells of a benchmark that are missing in an SQLite file, which is created if absent.

    A cell is a tuple of texts and numbers that defines a measurement; its `records` have consecutive seeds. `measure`,
    a function at module level for worker processes, turns cell and seed into an outcome for JSON. `progress` is called
    with (outcomes computed in this run, their total).
    """
    whole_number("seeds", records, 1, MOST_RECORDS)
    whole_number("seed", first_seed, 0)
    whole_number("jobs", jobs, 1, MAX_JOBS)
    seeds = range(first_seed, first_seed + records)
    keys = [json.dumps([name, *cell]) for cell in cells]
    with _Outcomes(store, make=True) as file, threadpool_limits(1):
        fill(file, partial(file.missing, keys, seeds), partial(_work, measure), file.put, jobs, progress=progress)
        return Cells(cells, [file.outcomes(key, seeds) for key in keys])


def _work(measure: Measure, keys: Sequence[Key]) -> list[tuple[str, int, str]]:
    return [(cell, seed, json.dumps(measure(tuple(json.loads(cell)[1:]), seed))) for cell, seed in keys]


@lru_cache(maxsize=1)
def facts() -> Mapping[str, Any]:
    """Equations, initial states and published figures of the systems of both benchmarks, with their sources."""
    return dict(json.loads(files("bayeq.study").joinpath("ode_systems.json").read_text(encoding="utf-8")))


def system_of(name: str, states: Sequence[str], rhs: Sequence[str], initial: Sequence[float], **about: Any) -> System:
    """A first-order system without inputs and noise, given by its equations alone."""
    return System(
        name=name,
        chains=tuple(states),
        rhs=dict(zip(states, rhs, strict=True)),
        terms={f"d{state}": {} for state in states},
        parameters={},
        initial=dict(zip(states, initial, strict=True)),
        noise=0.0,
        **about,
    )


def timed(discover: Callable[[], Any], judge: Callable[[Any], Outcome]) -> Outcome:
    """Outcome of an answer by `judge`, with CPU seconds of `discover`; after an error, its message and the seconds."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BayeqWarning)
        start = time.process_time()
        try:
            answer = discover()
        except (BayeqError, np.linalg.LinAlgError) as error:
            return {"error": f"{type(error).__name__}: {error}", "cpu": time.process_time() - start}
        return {"cpu": time.process_time() - start, **judge(answer)}


def judged(eqs: Any, laws: Sequence[Law]) -> Outcome:
    """Compare an answer with the true laws: coefficients by term of each equation, the constant under `CONSTANT`.

    ``E``, the error of the coefficient matrix in the spectral norm, relative to the true one; ``exact``, whether the
    included terms of all equations are the true ones; ``wrong``, false and missed terms; ``false_found``, number of
    equations with the verdict found that show a false term, or miss a true one above its stated bound; ``covered``,
    number of the ``intervals`` (95 %, of included true terms) that contain the true coefficient.
    """
    verdicts = [eq.verdict.kind for eq in eqs]
    laws = [{parse(name).text: value for name, value in law.items()} for law in laws]
    found = [_coefficients(eq) for eq in eqs]
    names = list(dict.fromkeys(name for law in (*laws, *found) for name in law))
    true, here = (np.array([[law.get(name, 0.0) for name in names] for law in some]) for some in (laws, found))
    out: Outcome = {"verdicts": verdicts, "E": matrix_error(here, true)}
    wrong, false, covers = [], 0, []
    for eq, law, own in zip(eqs, laws, found, strict=True):
        wrong += [f"{eq.target}: +{name}" for name in own if name not in law]
        wrong += [f"{eq.target}: -{name}" for name in law if name not in own]
        false += eq.verdict.kind == "found" and not _right(eq, law)
        intervals = dict(zip((term.text for term in eq.terms), eq.ci95.tolist(), strict=True))
        intervals[CONSTANT] = list(eq.intercept_ci95)
        covers += [intervals[name][0] <= law[name] <= intervals[name][1] for name in own if name in law]
    out |= {"exact": not wrong, "wrong": wrong, "false_found": false}
    return out | {"covered": sum(covers), "intervals": len(covers)}


def matrix_error(found: Floats, true: Floats) -> float:
    """Error of a matrix of coefficients (C, P) in the spectral norm, relative to the true one."""
    return float(np.linalg.norm(found - true, 2) / np.linalg.norm(true, 2))


def _coefficients(eq: Any) -> dict[str, float]:
    found = {eq.terms[j].text: float(eq.posterior.coef[j]) for j in np.flatnonzero(eq.posterior.support)}
    if eq.intercept_matters:
        found[CONSTANT] = eq.shown_model.intercept
    return found


def _right(eq: Any, law: Law) -> bool:
    """Whether no false term is shown, and a true one is missing only below its bound (a constant: in its interval)."""
    shown = set(eq.shown) | ({CONSTANT} if eq.intercept_matters else set())
    limits = np.full(len(eq.terms), np.nan) if eq.bound is None else eq.bound
    bound = dict(zip((term.text for term in eq.terms), np.nan_to_num(limits).tolist(), strict=True))
    low, high = eq.intercept_ci95
    unseen = [abs(law[name]) <= bound.get(name, 0.0) for name in set(law) - shown - {CONSTANT}]
    if CONSTANT in set(law) - shown:
        unseen.append(low <= law[CONSTANT] <= high)
    return shown <= set(law) and all(unseen)


def percent(part: Iterable[bool]) -> str:
    """Share of true values in per cent; empty text for no values.

    >>> percent([True, False, True, True]), percent([])
    ('75.0', '')
    """
    values = list(part)
    return f"{100 * sum(values) / len(values):.1f}" if values else ""


def rates_of_verdicts(outcomes: Sequence[Outcome], covering: Sequence[Outcome]) -> dict[str, object]:
    """Share with all equations found, number with a wrong one, interval coverage (in `covering`) and CPU time."""
    verdicts = [one["verdicts"] for one in outcomes if "verdicts" in one]
    covered, intervals = (sum(one.get(name, 0) for one in covering) for name in ("covered", "intervals"))
    return {
        "found_percent": percent(set(kinds) == {"found"} for kinds in verdicts),
        "found_and_wrong": sum(one.get("false_found", 0) > 0 for one in outcomes) if verdicts else "",
        "coverage_percent": f"{100 * covered / intervals:.1f}" if intervals else "",
        "median_cpu_seconds": f"{np.median([one['cpu'] for one in outcomes]):.2f}",
    }


def wrong_in(outcomes: Sequence[Outcome]) -> str:
    """Errors, false terms and missed terms of the outcomes as one text, each once."""
    texts = (text for one in outcomes for text in [one.get("error", ""), *one.get("wrong", [])])
    return "; ".join(dict.fromkeys(filter(None, texts)))
