"""Results of a study in an SQLite file, a row per (system, index, algorithm).

Only processes that run the study write, each batch in one transaction. What a process works at is noted in the table of
claims (`bayeq.study.claims`), so that several share one study.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from bayeq.errors import InputError
from bayeq.resumable.database import Database
from bayeq.study.config import StudyConfig
from bayeq.study.result import METRICS, Metrics, Result

__all__ = ["Key", "Plan", "Store"]

# (system, index, algorithm) of a row.
Key = tuple[str, int, str]

# (system, algorithm) -> how many realisations were asked for.
Plan = dict[tuple[str, str], int]

SCHEMA = (
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
# Not in files of earlier versions, which are read all the same.
CLAIMS = """CREATE TABLE IF NOT EXISTS claims (
    system TEXT NOT NULL, idx INTEGER NOT NULL, algorithm TEXT NOT NULL,
    owner TEXT NOT NULL, until REAL NOT NULL,
    PRIMARY KEY (system, algorithm, idx)) WITHOUT ROWID"""
COLUMNS = ("system", "idx", "algorithm", *METRICS, "seconds", "selected", "converged", "extras", "failure")


class Store(Database):
    """A study's file; use `create` to run a study, `open` to look at one, and either in a ``with`` statement.

    Attributes
    ----------
    path : Path
        The file.
    config : dict
        The study's configuration.
    """

    application, version = 0x62797173, 1  # "byqs"
    noun = "a study"
    schema = SCHEMA

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        super().__init__(path, connection)
        self.config: dict[str, Any] = {}

    @classmethod
    def create(cls, path: str | Path, config: StudyConfig) -> Store:
        """Open the store of a study, a new one if there is no such file.

        Raises
        ------
        InputError
            It holds a study of another configuration; the message names the keys.
        FileFormatError
            The file is not a store, is damaged, or cannot be written.
        """
        store = cls._made(path)
        try:
            store._configure(config)
            with store._guard(), store._transaction():
                store._connection.execute(CLAIMS)
        except BaseException:
            store.close()
            raise
        return store

    def _configure(self, config: StudyConfig) -> None:
        """Write the configuration, if there is none, or compare it with the one that is there."""
        rows = [(key, json.dumps(value)) for key, value in config.to_dict().items()]
        with self._guard(), self._transaction():
            if not self._scalar("SELECT count(*) FROM config"):
                self._connection.executemany("INSERT INTO config VALUES (?, ?)", rows)
        self._load()
        if differences := config.differences(self.config):
            raise InputError(
                f"{self.path}: holds a study of another configuration: {'; '.join(differences)}; repeat that study's"
                " options, or name another store"
            )

    @classmethod
    def open(cls, path: str | Path, any_thread: bool = False) -> Store:
        """Open an existing store; for `any_thread`, where they take turns.

        Raises
        ------
        FileFormatError
            There is no such file, it is not a store, or it is damaged.
        """
        store = cls._existing(path, any_thread)
        try:
            store._load()
        except BaseException:
            store.close()
            raise
        return store

    def _load(self) -> None:
        """Read the configuration."""
        with self._guard():
            stored = self._connection.execute("SELECT key, value FROM config").fetchall()
            if not stored:  # killed before the first commit
                raise sqlite3.DatabaseError("no configuration")
            self.config = {key: json.loads(value) for key, value in stored}

    def plan(self, systems: Sequence[str], algorithms: Sequence[str], realisations: int) -> None:
        """Note what has been asked for: the most realisations of each system and algorithm."""
        with self._guard(), self._transaction():
            self._connection.executemany(
                "INSERT INTO plan VALUES (?, ?, ?) ON CONFLICT (system, algorithm) DO UPDATE"
                " SET realisations = max(realisations, excluded.realisations)",
                [(system, algorithm, realisations) for system in systems for algorithm in algorithms],
            )

    def planned(self) -> Plan:
        """What has been asked for so far."""
        with self._guard():
            rows = self._connection.execute("SELECT system, algorithm, realisations FROM plan").fetchall()
            return {(system, algorithm): int(count) for system, algorithm, count in rows}

    def done(self, system: str) -> dict[int, set[str]]:
        """Index -> the algorithms that have a row."""
        found: dict[int, set[str]] = {}
        with self._guard():
            for index, algorithm in self._connection.execute(
                "SELECT idx, algorithm FROM results WHERE system = ?", (system,)
            ):
                found.setdefault(index, set()).add(algorithm)
        return found

    def add(self, results: Iterable[Result]) -> None:
        """Write rows in one transaction, and drop the claims on them; a row that is there already stays."""
        marks = ", ".join("?" * len(COLUMNS))
        rows = [_row(result) for result in results]
        with self._guard(), self._transaction():
            self._connection.executemany(f"INSERT OR IGNORE INTO results ({', '.join(COLUMNS)}) VALUES ({marks})", rows)
            self._connection.executemany(
                "DELETE FROM claims WHERE system = ? AND idx = ? AND algorithm = ?", [row[:3] for row in rows]
            )

    def claimed(self, wanted: Sequence[Key], owner: str, until: float, dead: Callable[[str, float], bool]) -> list[Key]:
        """Claim those of some rows that are neither there nor claimed by another process, in one transaction.

        Parameters
        ----------
        wanted : sequence of (system, index, algorithm)
            The rows.
        owner : str
            Who claims.
        until : float
            When the claim ends [s since 1970].
        dead : callable
            Whether the claim of an owner with such an end counts for nothing.
        """
        where = "WHERE system = ? AND idx = ? AND algorithm = ?"
        free = []
        with self._guard(), self._transaction():
            for key in wanted:
                if self._connection.execute(f"SELECT 1 FROM results {where}", key).fetchone() is not None:
                    continue
                other = self._connection.execute(f"SELECT owner, until FROM claims {where}", key).fetchone()
                if other is None or other[0] == owner or dead(*other):
                    free.append(key)
            self._connection.executemany(
                "INSERT OR REPLACE INTO claims VALUES (?, ?, ?, ?, ?)", [(*key, owner, until) for key in free]
            )
        return free

    def prolong(self, owner: str, until: float) -> None:
        """Let the claims of an owner end later."""
        with self._guard(), self._transaction():
            self._connection.execute("UPDATE claims SET until = ? WHERE owner = ?", (until, owner))

    def release(self, owner: str) -> None:
        """Drop the claims of an owner."""
        with self._guard(), self._transaction():
            self._connection.execute("DELETE FROM claims WHERE owner = ?", (owner,))

    def results(self) -> Iterator[Result]:
        """All rows, by system, algorithm and index."""
        with self._guard():
            for row in self._connection.execute(
                f"SELECT {', '.join(COLUMNS)} FROM results ORDER BY system, algorithm, idx"
            ):
                yield _result(dict(zip(COLUMNS, row, strict=True)))


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


def _result(row: dict[str, Any]) -> Result:
    metrics = None
    if row["failure"] is None:
        values = {name: float(row[name]) for name in METRICS}
        exact, superset = bool(values.pop("exact")), bool(values.pop("superset"))
        metrics = Metrics(**values, exact=exact, superset=superset)
    return Result(
        system=str(row["system"]),
        index=int(row["idx"]),
        algorithm=str(row["algorithm"]),
        metrics=metrics,
        seconds=None if row["seconds"] is None else float(row["seconds"]),
        selected=tuple(json.loads(row["selected"])),
        converged=None if row["converged"] is None else bool(row["converged"]),
        extras=json.loads(row["extras"]),
        failure=row["failure"],
    )
