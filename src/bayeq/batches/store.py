"""Results of batches in an SQLite file, a row per file and set of options."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bayeq.batches.files import Identity
from bayeq.resumable.database import Database

__all__ = ["BatchStore", "Outcome", "Status"]

Status = Literal["ok", "refused", "failed"]

SCHEMA = (
    """CREATE TABLE files (
        path TEXT NOT NULL, options TEXT NOT NULL,
        size INTEGER, mtime INTEGER, sha256 TEXT,
        status TEXT NOT NULL, message TEXT NOT NULL, answer TEXT,
        PRIMARY KEY (path, options)) WITHOUT ROWID""",
    """CREATE TABLE common (
        options TEXT NOT NULL, contents TEXT NOT NULL, answer TEXT NOT NULL,
        PRIMARY KEY (options, contents)) WITHOUT ROWID""",
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a file.

    Attributes
    ----------
    path : Path
        The file.
    identity : Identity or None
        What it was when it was read; None if it could not be.
    status : "ok", "refused" or "failed"
        ``refused``: the file, or what is in it, cannot be used; ``failed``: anything else went wrong.
    message : str
        Why, in a line; empty if all is well.
    answer : mapping or None
        The equations as `Equations.save` writes them.
    """

    path: Path
    identity: Identity | None
    status: Status
    message: str
    answer: Mapping[str, Any] | None


class BatchStore(Database):
    """The file of a batch; use it in a ``with`` statement. Batches of other options may be kept in the same one."""

    application, version = 0x62797162, 1  # "byqb"
    noun = "a store of batches"
    schema = SCHEMA

    @classmethod
    def create(cls, path: str | Path) -> BatchStore:
        """Open a store, a new one if there is no such file.

        Raises
        ------
        FileFormatError
            The file is something else, is damaged, or cannot be written.
        """
        return cls._made(path)

    def add(self, outcome: Outcome, options: str) -> None:
        """Write what became of a file, in place of what was there, in one transaction."""
        identity = outcome.identity
        state = (None, None, None) if identity is None else (identity.size, identity.mtime, identity.sha256)
        answer = None if outcome.answer is None else json.dumps(outcome.answer, allow_nan=False)
        row = (_key(outcome.path), options, *state, outcome.status, _text(outcome.message), answer)
        with self._guard(), self._transaction():
            self._connection.execute("INSERT OR REPLACE INTO files VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)

    def done(self, path: Path, options: str) -> bool:
        """Whether a file has been done with these options, and is unchanged."""
        with self._guard():
            row = self._connection.execute(
                "SELECT size, mtime, sha256 FROM files WHERE path = ? AND options = ? AND status = 'ok'",
                (_key(path), options),
            ).fetchone()
        return row is not None and Identity(*row).holds(path)

    def outcome(self, path: Path, options: str) -> Outcome | None:
        """What became of a file."""
        with self._guard():
            row = self._connection.execute(
                "SELECT size, mtime, sha256, status, message, answer FROM files WHERE path = ? AND options = ?",
                (_key(path), options),
            ).fetchone()
            if row is None:
                return None
            size, mtime, sha256, status, message, answer = row
            identity = None if sha256 is None else Identity(size, mtime, sha256)
            return Outcome(path, identity, status, message, None if answer is None else json.loads(answer))

    def add_common(self, options: str, contents: str, answer: Mapping[str, Any]) -> None:
        """Write the common equation of files of these contents."""
        with self._guard(), self._transaction():
            self._connection.execute(
                "INSERT OR REPLACE INTO common VALUES (?, ?, ?)",
                (options, contents, json.dumps(answer, allow_nan=False)),
            )

    def common(self, options: str, contents: str) -> Mapping[str, Any] | None:
        """The common equation of files of these contents, if it has been found."""
        with self._guard():
            row = self._connection.execute(
                "SELECT answer FROM common WHERE options = ? AND contents = ?", (options, contents)
            ).fetchone()
            return None if row is None else dict(json.loads(row[0]))


def _key(path: Path) -> str:
    return _text(os.path.abspath(path))


def _text(text: str) -> str:
    """Text as SQLite takes it: bytes of a file's name that are no characters are written out."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
