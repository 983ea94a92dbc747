"""Results of a study in an SQLite file, a row per (system, index, algorithm).

Only processes that run the study write, each batch in one transaction under SQLite's rollback journal (one
file, also on network drives): a kill at any moment leaves the batches that were committed, and nothing else. What a
process works at is noted in the table of claims (`bayeq.study.claims`), so that several share one study.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from bayeq.errors import FileFormatError, InputError
from bayeq.study.config import StudyConfig
from bayeq.study.result import METRICS, Metrics, Result

__all__ = ["Key", "Plan", "Store"]

# (system, index, algorithm) of a row.
Key = tuple[str, int, str]

# "byqs" in the header of the file, and the version of the tables.
APPLICATION = 0x62797173
VERSION = 1

# How long to wait for another process that is writing [s].
PATIENCE = 60.0

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


class Store:
    """A study's file; use `create` to run a study, `open` to look at one, and either in a ``with`` statement.

    Attributes
    ----------
    path : Path
        The file.
    config : dict
        The study's configuration.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection
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
        path = Path(path)
        if path.is_dir():
            raise FileFormatError(f"{path}: is a directory; name a file in it")
        if not path.parent.is_dir():
            raise FileFormatError(f"{path}: cannot be written: there is no directory {path.parent}")
        store = cls._connect(path, "rwc")
        try:
            with store._guard():
                if store._scalar("PRAGMA page_count") == 0:
                    store._initialise(config)
            store._load()
            with store._guard(), store._transaction():
                store._connection.execute(CLAIMS)
            if differences := config.differences(store.config):
                raise InputError(
                    f"{path}: holds a study of another configuration: {'; '.join(differences)}; repeat that study's"
                    " options, or name another store"
                )
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def open(cls, path: str | Path, any_thread: bool = False) -> Store:
        """Open an existing store; for `any_thread`, where they take turns.

        Raises
        ------
        FileFormatError
            There is no such file, it is not a store, or it is damaged.
        """
        path = Path(path)
        if not path.is_file():
            raise FileFormatError(f"{path}: {'is a directory' if path.is_dir() else 'no such file'}; expected a study")
        # Not read-only: what a killed study left half written has to be rolled back.
        store = cls._connect(path, "rw", any_thread)
        try:
            store._load()
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def _connect(cls, path: Path, mode: str, any_thread: bool = False) -> Store:
        try:
            connection = sqlite3.connect(
                f"{path.absolute().as_uri()}?mode={mode}",
                uri=True,
                timeout=PATIENCE,
                isolation_level=None,
                check_same_thread=not any_thread,
            )
        except sqlite3.Error as error:
            raise FileFormatError(f"{path}: {error}") from None
        return cls(path, connection)

    def _initialise(self, config: StudyConfig) -> None:
        with self._transaction():
            if self._scalar("SELECT count(*) FROM sqlite_master"):
                return  # another process was faster
            self._connection.execute(f"PRAGMA application_id = {APPLICATION}")
            self._connection.execute(f"PRAGMA user_version = {VERSION}")
            for statement in SCHEMA:
                self._connection.execute(statement)
            rows = [(key, json.dumps(value)) for key, value in config.to_dict().items()]
            self._connection.executemany("INSERT INTO config VALUES (?, ?)", rows)

    def _load(self) -> None:
        """Check what the file is, and read the configuration."""
        with self._guard():
            if self._scalar("PRAGMA application_id") != APPLICATION:
                raise FileFormatError(f"{self.path}: is not a study (a database of something else); name another file")
            if (version := self._scalar("PRAGMA user_version")) != VERSION:
                raise FileFormatError(
                    f"{self.path}: was written by another version of bayeq (format {version}, not {VERSION});"
                    " use that version, or name another file"
                )
            if (verdict := self._scalar("PRAGMA quick_check(1)")) != "ok":
                raise sqlite3.DatabaseError(verdict)
            stored = self._connection.execute("SELECT key, value FROM config").fetchall()
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

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _scalar(self, statement: str) -> Any:
        return self._connection.execute(statement).fetchone()[0]

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """SQLite's complaints as ours."""
        try:
            yield
        except sqlite3.OperationalError as error:  # locked, full, not writable: the file may be fine
            raise FileFormatError(f"{self.path}: {error}") from None
        except (sqlite3.Error, ValueError, TypeError, KeyError) as error:
            if isinstance(error, InputError):
                raise
            raise FileFormatError(
                f"{self.path}: is not a study, or is damaged ({error}); restore it, or name another file"
            ) from None


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
