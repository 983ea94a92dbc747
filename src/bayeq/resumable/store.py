"""Results in an SQLite file, kept as they are made, so that work that is stopped goes on where it was.

Only processes that run the work write, each time one transaction under SQLite's rollback journal (one file, also on
network drives): a kill at any moment leaves the transactions that were committed, and nothing else. Several processes
may share the work: each claims rows before it computes them (`Claims`).
"""

from __future__ import annotations

import os
import socket
import sqlite3
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ClassVar, Self

from bayeq.errors import FileFormatError, InputError
from bayeq.posix import has_ended

#: Values of the key of a row.
Key = tuple[Any, ...]

# How long to wait for another process that is writing [s].
PATIENCE = 60.0

# A claim ends so long after it was prolonged last, which is done that often [s].
LEASE, BEAT = 60.0, 15.0


class ResultStore:
    """A file of tables, one of them the table of results; a subclass names them. Use it in a ``with`` statement.

    With `make` it is opened for work: made if it is not there, and given a table of claims if it has none yet; with
    `any_thread` threads may use it, which take turns. FileFormatError where there is no such file, it is something
    else, is damaged, or cannot be written.
    """

    #: In the header of the file, and the version of its tables.
    application: ClassVar[int]
    version: ClassVar[int] = 1
    #: What the file is, in messages, such as "a study".
    noun: ClassVar[str]
    #: Statements that make the tables.
    schema: ClassVar[tuple[str, ...]]
    #: The table of results; the columns of its key, which come first, with their types.
    table: ClassVar[str]
    key: ClassVar[dict[str, str]]
    #: What becomes of a row that is there already when it is put again: IGNORE the new one, or REPLACE the old one.
    again: ClassVar[str]

    def __init__(self, path: str | Path, make: bool = False, any_thread: bool = False) -> None:
        self.path = Path(path)
        self._require_place(make)
        try:
            # Not read-only: what a killed process left half written has to be rolled back.
            self._connection = sqlite3.connect(
                f"{self.path.absolute().as_uri()}?mode={'rwc' if make else 'rw'}",
                uri=True,
                timeout=PATIENCE,
                isolation_level=None,
                check_same_thread=not any_thread,
            )
        except sqlite3.Error as error:
            raise FileFormatError(f"{self.path}: {error}") from None
        try:
            if make:
                self._make()
            self._check()
            if make:  # files of earlier versions have no claims
                columns = ", ".join(f"{name} {kind} NOT NULL" for name, kind in self.key.items())
                self._write(
                    f"CREATE TABLE IF NOT EXISTS claims ({columns}, owner TEXT NOT NULL, until REAL NOT NULL,"
                    f" PRIMARY KEY ({', '.join(self.key)})) WITHOUT ROWID"
                )
        except BaseException:
            self.close()
            raise

    def _require_place(self, make: bool) -> None:
        """Refuse what is no file, or cannot become one."""
        path = self.path
        try:
            os.fsencode(path)
            folder, there, inside = path.is_dir(), path.is_file(), path.parent.is_dir()
        except (OSError, ValueError):
            raise FileFormatError(f"{str(path)[:60]!r}: is no name of a file") from None
        if not make and not there:
            raise FileFormatError(f"{path}: {'is a directory' if folder else 'no such file'}; expected {self.noun}")
        if folder:
            raise FileFormatError(f"{path}: is a directory; name a file in it")
        if not inside:
            raise FileFormatError(f"{path}: cannot be written: there is no directory {path.parent}")

    def _make(self) -> None:
        """Make the tables in an empty file."""
        with self._guard():
            if self._one("PRAGMA page_count"):
                return
        with self._transaction():
            if self._one("SELECT count(*) FROM sqlite_master"):
                return  # another process was faster
            self._connection.execute(f"PRAGMA application_id = {self.application}")
            self._connection.execute(f"PRAGMA user_version = {self.version}")
            for statement in self.schema:
                self._connection.execute(statement)

    def _check(self) -> None:
        """Check what the file is."""
        with self._guard():
            if self._one("PRAGMA application_id") != self.application:
                raise FileFormatError(
                    f"{self.path}: is not {self.noun} (a database of something else); name another file"
                )
            if (version := self._one("PRAGMA user_version")) != self.version:
                raise FileFormatError(
                    f"{self.path}: was written by another version of bayeq (format {version}, not {self.version});"
                    " use that version, or name another file"
                )
            if (verdict := self._one("PRAGMA quick_check(1)")) != "ok":
                raise sqlite3.DatabaseError(verdict)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, rows: Iterable[tuple[Any, ...]]) -> None:
        """Write rows of results and drop the claims on them, in one transaction."""
        with self._transaction():
            for row in rows:
                marks = ", ".join("?" * len(row))
                self._connection.execute(f"INSERT OR {self.again} INTO {self.table} VALUES ({marks})", row)
                self._connection.execute(f"DELETE FROM claims WHERE {self._is_key}", row[: len(self.key)])

    def done(self, key: Key) -> bool:
        """Whether there is a result that need not be computed again."""
        return bool(self._read(f"SELECT 1 FROM {self.table} WHERE {self._is_key}", key))

    @property
    def _is_key(self) -> str:
        return " AND ".join(f"{name} = ?" for name in self.key)

    def claim(self, wanted: Sequence[Key], owner: str, until: float, dead: Callable[[str, float], bool]) -> list[Key]:
        """Claim those of some rows that no other process has claimed, in one transaction, until a time [s since 1970].

        `dead` says whether the claim of an owner with such an end counts for nothing.
        """
        free = []
        with self._transaction():
            for key in wanted:
                found = self._connection.execute(f"SELECT owner, until FROM claims WHERE {self._is_key}", key)
                other = found.fetchone()
                if other is None or other[0] == owner or dead(*other):
                    free.append(key)
            self._connection.executemany(
                f"INSERT OR REPLACE INTO claims VALUES ({'?, ' * len(self.key)}?, ?)",
                [(*key, owner, until) for key in free],
            )
        return free

    def prolong(self, owner: str, until: float) -> None:
        """Let the claims of an owner end later."""
        self._write("UPDATE claims SET until = ? WHERE owner = ?", (until, owner))

    def release(self, owner: str) -> None:
        """Drop the claims of an owner."""
        self._write("DELETE FROM claims WHERE owner = ?", (owner,))

    def _one(self, statement: str) -> Any:
        return self._connection.execute(statement).fetchone()[0]

    def _read(self, statement: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with self._guard():
            return self._connection.execute(statement, values).fetchall()

    def _write(self, statement: str, *rows: Sequence[Any]) -> None:
        """Execute a statement with each of some rows of values, in one transaction."""
        with self._transaction():
            for row in rows or [()]:
                self._connection.execute(statement, row)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with self._guard():
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
                f"{self.path}: is not {self.noun}, or is damaged ({error}); restore it, or name another file"
            ) from None


class Claims:
    """The rows that this process works at, so that several processes on one store do each of them once.

    A claim ends after a minute unless its owner prolongs it, which a thread does; that of a process of this machine
    that is no more ends at once. Where a claim is lost and a row is computed twice after all, both are the same. As a
    context manager it gives back at its end what is not done. The store is opened once more, for threads.
    """

    def __init__(self, store: ResultStore) -> None:
        self.owner = f"{socket.gethostname()}:{os.getpid()}:{uuid.uuid4().hex[:8]}"
        self._store = type(store)(store.path, any_thread=True)  # joblib asks for tasks in threads of its own
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._beating = threading.Thread(target=self._beat, daemon=True, name="claims")

    def __enter__(self) -> Self:
        self._beating.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._beating.join()
        with self._store, suppress(FileFormatError):  # otherwise they end by themselves
            self._store.release(self.owner)

    def free(self, wanted: Sequence[Key]) -> tuple[Key, ...]:
        """Claim rows: those that are done or claimed by others are left out."""
        with self._lock:
            claimed = self._store.claim(wanted, self.owner, time.time() + LEASE, _dead)
            # another process may have done it before it was claimed here
            return tuple(key for key in claimed if not self._store.done(key))

    def _beat(self) -> None:
        """Prolong the claims now and then."""
        while not self._stop.wait(BEAT):
            with suppress(FileFormatError), self._lock:  # the next time will do
                self._store.prolong(self.owner, time.time() + LEASE)


def _dead(owner: str, until: float) -> bool:
    """Whether a claim has ended, or its process on this machine."""
    if until < time.time():
        return True
    host, process, _ = owner.rsplit(":", 2)
    return host == socket.gethostname() and has_ended(int(process))
