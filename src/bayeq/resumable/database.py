"""Results in an SQLite file, written one transaction at a time.

Only processes that run the work write, under SQLite's rollback journal (one file, also on network drives): a kill
at any moment leaves the transactions that were committed, and nothing else.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, ClassVar, Self

from bayeq.errors import FileFormatError, InputError

__all__ = ["Database"]

# How long to wait for another process that is writing [s].
PATIENCE = 60.0


class Database:
    """A file of tables; a subclass names them. Use it in a ``with`` statement.

    Attributes
    ----------
    path : Path
        The file.
    """

    #: In the header of the file, and the version of its tables.
    application: ClassVar[int]
    version: ClassVar[int]
    #: What the file is, in messages, such as "a study".
    noun: ClassVar[str]
    #: Statements that make the tables.
    schema: ClassVar[tuple[str, ...]]

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self._connection = connection

    @classmethod
    def _made(cls, path: str | Path) -> Self:
        """The file, with tables where it was not there before.

        Raises
        ------
        FileFormatError
            It is something else, is damaged, or cannot be written.
        """
        path = Path(path)
        try:
            os.fsencode(path)
            folder, inside = path.is_dir(), path.parent.is_dir()
        except (OSError, ValueError):
            raise FileFormatError(f"{str(path)[:60]!r}: is no name of a file") from None
        if folder:
            raise FileFormatError(f"{path}: is a directory; name a file in it")
        if not inside:
            raise FileFormatError(f"{path}: cannot be written: there is no directory {path.parent}")
        made = cls._connect(path, "rwc")
        try:
            with made._guard():
                if made._scalar("PRAGMA page_count") == 0:
                    made._initialise()
            made._check()
        except BaseException:
            made.close()
            raise
        return made

    @classmethod
    def _existing(cls, path: str | Path, any_thread: bool = False) -> Self:
        """A file that is there; for `any_thread`, where they take turns.

        Raises
        ------
        FileFormatError
            There is no such file, it is something else, or it is damaged.
        """
        path = Path(path)
        if not path.is_file():
            raise FileFormatError(
                f"{path}: {'is a directory' if path.is_dir() else 'no such file'}; expected {cls.noun}"
            )
        # Not read-only: what a killed process left half written has to be rolled back.
        found = cls._connect(path, "rw", any_thread)
        try:
            found._check()
        except BaseException:
            found.close()
            raise
        return found

    @classmethod
    def _connect(cls, path: Path, mode: str, any_thread: bool = False) -> Self:
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

    def _initialise(self) -> None:
        with self._transaction():
            if self._scalar("SELECT count(*) FROM sqlite_master"):
                return  # another process was faster
            self._connection.execute(f"PRAGMA application_id = {self.application}")
            self._connection.execute(f"PRAGMA user_version = {self.version}")
            for statement in self.schema:
                self._connection.execute(statement)

    def _check(self) -> None:
        """Check what the file is."""
        with self._guard():
            if self._scalar("PRAGMA application_id") != self.application:
                raise FileFormatError(
                    f"{self.path}: is not {self.noun} (a database of something else); name another file"
                )
            if (version := self._scalar("PRAGMA user_version")) != self.version:
                raise FileFormatError(
                    f"{self.path}: was written by another version of bayeq (format {version}, not {self.version});"
                    " use that version, or name another file"
                )
            if (verdict := self._scalar("PRAGMA quick_check(1)")) != "ok":
                raise sqlite3.DatabaseError(verdict)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
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
                f"{self.path}: is not {self.noun}, or is damaged ({error}); restore it, or name another file"
            ) from None
