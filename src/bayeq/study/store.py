"""Results of a study: the paper's performance metrics, and an SQLite file with a row per (system, index, algorithm)."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError
from bayeq.gram import Gram
from bayeq.resumable.store import ResultStore
from bayeq.study.config import StudyConfig

# (system, algorithm) -> how many realisations were asked for.
Plan = dict[tuple[str, str], int]


@dataclass(frozen=True, slots=True)
class Metrics:
    """The errors of section 4.1."""

    # ||S_D (theta_hat - theta)|| / ||S_D theta||, S_D the standard deviations of the training columns
    e_theta_scaled: float
    e_theta: float  # ||theta_hat - theta|| / ||theta||
    e_p: float  # ||y* - D* theta_hat|| / ||y*|| on the test rows
    fdr: float  # false terms among the selected ones; 0 if none is selected
    exact: bool  # exactly the true terms are selected
    superset: bool  # all true terms are selected

    @property
    def finite(self) -> bool:
        """Whether all of them are finite."""
        return all(math.isfinite(getattr(self, name)) for name in METRICS)


METRICS = tuple(f.name for f in fields(Metrics))


@dataclass(frozen=True, slots=True)
class Result:
    """A row of the store."""

    # which realisation, and what ran on it
    system: str
    index: int
    algorithm: str
    metrics: Metrics | None = None  # None if it failed
    seconds: float | None = None  # wall time of the algorithm alone, from the Gram to the estimate
    selected: tuple[str, ...] = ()  # the selected terms
    converged: bool | None = None  # what the algorithm says of itself
    extras: Mapping[str, Any] = field(default_factory=dict)  # what else it says, as plain numbers
    failure: str | None = None  # type and message of the exception


def prediction_error(test: Gram, estimate: Floats) -> float:
    """e_p = ||y* - D* theta_hat|| / ||y*||, with the test dictionary unscaled, uncentred and without intercept.

    By algebra on the test Gram: an uncentred moment is the centred one plus n times the product of the means.
    """
    squares = test.yty + test.n * test.target_mean**2
    return math.sqrt(test.squared_error(estimate, intercept=0.0) / squares)


def measure(train: Gram, test: Gram, truth: Floats, support: Bools, coef: Floats) -> Metrics:
    """All metrics of an estimate.

    All is in original units: statistics of the training and the test rows, true and estimated coefficients (P,).
    InputError without a true term in the dictionary.
    """
    true = truth != 0
    if not true.any():
        raise InputError("the dictionary holds no true term: weight errors are not defined")
    scale, chosen = train.standard_deviation, int(np.count_nonzero(support))
    return Metrics(
        e_theta_scaled=_relative_error(scale * coef, scale * truth),
        e_theta=_relative_error(coef, truth),
        e_p=prediction_error(test, coef),
        fdr=int(np.count_nonzero(support & ~true)) / chosen if chosen else 0.0,
        exact=bool(np.array_equal(support, true)),
        superset=bool(np.all(support[true])),
    )


def _relative_error(estimate: Floats, truth: Floats) -> float:
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))


# --- the file --------------------------------------------------------------------------------------------------------


COLUMNS = ("system", "idx", "algorithm", *METRICS, "seconds", "selected", "converged", "extras", "failure")


class Store(ResultStore):
    """A study's file; use it in a ``with`` statement.

    With a configuration, to run that study, in a new file if there is none; without it the file is only looked at.
    `config` is then the configuration in the file, a dict.

    InputError for a file with a study of another configuration, the message names the keys; otherwise as `ResultStore`.
    """

    application, noun = 0x62797173, "a study"  # "byqs"
    schema = (
        "CREATE TABLE config (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
        """CREATE TABLE plan (
            system TEXT NOT NULL, algorithm TEXT NOT NULL, realisations INTEGER NOT NULL,
            PRIMARY KEY (system, algorithm)) WITHOUT ROWID""",
        f"""CREATE TABLE results (
            system TEXT NOT NULL, idx INTEGER NOT NULL, algorithm TEXT NOT NULL,
            {", ".join(f"{name} REAL" for name in METRICS)},
            seconds REAL, selected TEXT NOT NULL, converged INTEGER, extras TEXT NOT NULL, failure TEXT,
            PRIMARY KEY (system, algorithm, idx)) WITHOUT ROWID""",
    )
    table, key, again = "results", {"system": "TEXT", "idx": "INTEGER", "algorithm": "TEXT"}, "IGNORE"

    def __init__(self, path: str | Path, config: StudyConfig | None = None, any_thread: bool = False) -> None:
        super().__init__(path, config is not None, any_thread)
        try:
            if config is not None:
                rows = [(key, json.dumps(value)) for key, value in asdict(config).items()]
                with self._transaction():
                    if not self._one("SELECT count(*) FROM config"):
                        self._connection.executemany("INSERT INTO config VALUES (?, ?)", rows)
            with self._guard():
                stored = self._read("SELECT key, value FROM config")
                if not stored:  # killed before the first commit
                    raise sqlite3.DatabaseError("no configuration")
                self.config: dict[str, Any] = {key: json.loads(value) for key, value in stored}
            if config is not None and (differences := config.differences(self.config)):
                raise InputError(
                    f"{self.path}: holds a study of another configuration: {'; '.join(differences)}; repeat that"
                    " study's options, or name another store"
                )
        except BaseException:
            self.close()
            raise

    def plan(self, systems: Sequence[str], algorithms: Sequence[str], realisations: int) -> None:
        """Note what has been asked for: the most realisations of each system and algorithm."""
        self._write(
            "INSERT INTO plan VALUES (?, ?, ?) ON CONFLICT (system, algorithm) DO UPDATE"
            " SET realisations = max(realisations, excluded.realisations)",
            *((system, algorithm, realisations) for system in systems for algorithm in algorithms),
        )

    def planned(self) -> Plan:
        """What has been asked for so far."""
        rows = self._read("SELECT system, algorithm, realisations FROM plan")
        return {(system, algorithm): int(count) for system, algorithm, count in rows}

    def missing(
        self, systems: Sequence[str], algorithms: Sequence[str], realisations: int
    ) -> list[list[tuple[str, int, str]]]:
        """The keys that have no row, those of a realisation together, the systems side by side."""
        there = set(self._read("SELECT system, idx, algorithm FROM results"))
        groups = (
            [key for name in algorithms if (key := (system, index, name)) not in there]
            for index in range(realisations)
            for system in systems
        )
        return [group for group in groups if group]

    def add(self, results: Iterable[Result]) -> None:
        """Write rows in one transaction; one that is there already stays."""
        self.put(_row(result) for result in results)

    def results(self) -> Iterator[Result]:
        """All rows, by system, algorithm and index."""
        with self._guard():
            for row in self._connection.execute(
                f"SELECT {', '.join(COLUMNS)} FROM results ORDER BY system, algorithm, idx"
            ):
                yield _result(row)


def _row(result: Result) -> tuple[Any, ...]:
    m = result.metrics
    return (
        result.system,
        result.index,
        result.algorithm,
        *([None] * len(METRICS) if m is None else [float(getattr(m, name)) for name in METRICS]),
        result.seconds,
        json.dumps(list(result.selected)),
        result.converged,
        json.dumps(dict(result.extras), sort_keys=True),
        result.failure,
    )


def _result(row: tuple[Any, ...]) -> Result:
    system, index, algorithm, *values, seconds, selected, converged, extras, failure = row
    metrics = None
    if failure is None:
        errors = dict(zip(METRICS, map(float, values), strict=True))
        exact, superset = bool(errors.pop("exact")), bool(errors.pop("superset"))
        metrics = Metrics(**errors, exact=exact, superset=superset)
    return Result(
        system=str(system),
        index=int(index),
        algorithm=str(algorithm),
        metrics=metrics,
        seconds=None if seconds is None else float(seconds),
        selected=tuple(json.loads(selected)),
        converged=None if converged is None else bool(converged),
        extras=json.loads(extras),
        failure=failure,
    )
