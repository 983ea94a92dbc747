"""`batch`: one equation per file, or the coefficients of a common one, over many files."""

from __future__ import annotations

import hashlib
import inspect
import json
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from bayeq.batches.result import Batch, BatchFile, Identity, Read, digest, files_of, fixed_terms, question
from bayeq.discovery.entry import discover
from bayeq.equation.to_json import to_saved
from bayeq.errors import (
    BayeqError,
    BayeqWarning,
    InputError,
    UnknownNameError,
    as_path,
    one_line,
    require_kind,
    require_mapping,
)
from bayeq.records import Record, as_records, read
from bayeq.resumable import Progress, silent
from bayeq.resumable.store import MAX_JOBS, Key, ResultStore, fill

#: Stages of a batch: the equation that files have in common, and the files.
COMMON, FILES = "common equation", "files"


def batch(
    files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    store: str | os.PathLike[str] = "batch.db",
    jobs: int = 1,
    common: bool = False,
    read: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Batch:
    """Find the equations of many files; results are stored as they are found, and files are not done twice.

    Parameters
    ----------
    files : path or sequence of paths
        One record each. A folder means all files in it whose suffix is that of a known format, in the order of the
        numbers in their names. The order is that of the table.
    store : path
        SQLite file of the results, made if it is not there. A file that has been done with the same options, the same
        version of bayeq and the same content is not done again; one that was refused is tried again. Results of other
        options stay in it.
    jobs : int
        Worker processes; results do not depend on it.
    common : bool
        Find one equation from all files together first; each file then has the coefficients of its terms, and the
        common coefficients are listed with them. All files are in memory at once.
    read : mapping, optional
        Arguments of `bayeq.read`, such as ``{"units": {"x": "mm"}, "fs": 1000.0}``.
    progress : callable, optional
        Called with (stage, done, total); the stage is "files" while files are done.
    **options
        Those of `discover`: channels, dictionary, method and so on.

    Returns
    -------
    Batch
        Outcome of each file, with a table and a figure of coefficients over files.

    Raises
    ------
    InputError
        Options that cannot be used, no files, a file named twice, a `store` of another kind, or no common equation.
        A file that cannot be used is no error: see `Batch.refused`.
    BayeqError
        A worker process was killed.
    KeyboardInterrupt
        Stopped by the user; what was done is in the store.

    Examples
    --------
    >>> import tempfile
    >>> import bayeq as bq
    >>> folder = Path(tempfile.mkdtemp())
    >>> for k in range(3):
    ...     bq.write(bq.simulate("duffing", n=400, seed=k), folder / f"day{k}.csv")
    >>> found = bq.batch(
    ...     folder, store=folder / "batch.db", chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u", smooth="none"
    ... )
    >>> [one.status for one in found]
    ['ok', 'ok', 'ok']
    >>> list(found.table().term.unique())
    ['x', 'v', 'x**3', 'u']
    """
    if isinstance(files, (str, os.PathLike)):
        files = [files]
    require_kind(files, Sequence, "files", "a path or a list of paths")
    require_kind(common, bool, "common", "True or False")
    arguments = {} if read is None else read
    require_mapping(arguments, "read")
    if progress is not None:
        require_kind(progress, Callable, "progress", "a function of (stage, done, total)")  # type: ignore[arg-type]
    for name in arguments:
        if name not in _ARGUMENTS:
            raise UnknownNameError("argument of bayeq.read", name, _ARGUMENTS, where="read")
    place = as_path(store, "store")
    return run_batch(files_of(files), options, _Reading(dict(arguments)), place, jobs, common, progress)


# Arguments of `bayeq.read` other than the path.
_ARGUMENTS = [name for name in inspect.signature(read).parameters if name != "path"]


@dataclass(frozen=True)
class _Reading:
    """Reads files by `bayeq.read` with fixed arguments; without any, `discover` reads them."""

    arguments: Mapping[str, Any] = field(default_factory=dict)

    def __call__(self, path: Path) -> Any:
        return read(path, **self.arguments) if self.arguments else path


def run_batch(
    paths: Sequence[Path],
    options: Mapping[str, Any],
    read: Read,
    store: Path,
    jobs: int = 1,
    common: bool = False,
    progress: Progress | None = None,
) -> Batch:
    """As `batch`, with a function `read` from a file to the `records` of `discover`; its `repr` identifies it."""
    if not (isinstance(jobs, int) and not isinstance(jobs, bool) and 1 <= jobs <= MAX_JOBS):
        raise InputError(f"jobs is a number of processes, 1 to {MAX_JOBS}, got {jobs!r}")
    step = progress or silent
    question(options)
    if common and options.get("differs"):
        raise InputError(
            "differs: a common equation has no coefficients that differ between files: leave common out, or compare"
            " the files with bayeq discover FILES --differs"
        )
    for path in paths:
        if path.exists() and store.exists() and path.samefile(store):
            raise InputError(f"{path}: is the store of the batch and no record; leave it out")
    with BatchStore(store, make=True) as kept, threadpool_limits(1):
        shared = _common(kept, paths, options, read, step) if common else None
        used = options if shared is None else fixed_terms(options, shared)
        asked = digest(used, read)
        places = {_key(path, asked): path for path in paths}
        left = {key for key, path in places.items() if not kept.done(key, path)}
        if left:
            step(FILES, 0, len(left))

        def missing() -> list[tuple[Key]]:
            return [(key,) for key, path in places.items() if key in left and not kept.done(key, path)]

        def keep(answer: tuple[BatchFile, Identity | None]) -> None:
            key = _key(answer[0].path, asked)
            kept.add(key, *answer)
            left.remove(key)  # a refused file is not tried twice

        work, first = partial(_work, dict(used), read), lambda keys: places[keys[0]]
        done = fill(kept, missing, work, keep, jobs, tasks=first, progress=partial(step, FILES))
        found = tuple(kept.outcome(path, key) for key, path in places.items())
    return Batch(found, shared, done)


class BatchStore(ResultStore):
    """The file of a batch, a row per file and set of options: batches of other options may be kept in the same one."""

    application, noun = 0x62797162, "a store of batches"  # "byqb"
    schema = (
        """CREATE TABLE files (
            path TEXT NOT NULL, options TEXT NOT NULL,
            size INTEGER, mtime INTEGER, sha256 TEXT,
            status TEXT NOT NULL, message TEXT NOT NULL, answer TEXT,
            PRIMARY KEY (path, options)) WITHOUT ROWID""",
        """CREATE TABLE common (
            options TEXT NOT NULL, contents TEXT NOT NULL, answer TEXT NOT NULL,
            PRIMARY KEY (options, contents)) WITHOUT ROWID""",
    )
    table, key, again = "files", {"path": "TEXT", "options": "TEXT"}, "REPLACE"

    def add(self, key: Key, one: BatchFile, identity: Identity | None) -> None:
        """Store the outcome of a file and its identity when read, replacing an earlier row."""
        state = (None, None, None) if identity is None else (identity.size, identity.mtime, identity.sha256)
        answer = None if one.content is None else json.dumps(one.content, allow_nan=False)
        self.put([(*key, *state, one.status, _text(one.message), answer)])

    def done(self, key: Key, path: Path | None = None) -> bool:
        """Whether a file has been done with these options, and is unchanged since.

        `path` defaults to that in the key, which differs from it if the name has bytes that are no characters.
        """
        rows = self._read(f"SELECT size, mtime, sha256 FROM files WHERE {self._is_key} AND status = 'ok'", key)
        return any(Identity(*row).holds(path or Path(key[0])) for row in rows)

    def outcome(self, path: Path, key: Key) -> BatchFile:
        with self._guard():
            ((status, message, answer),) = self._read(
                f"SELECT status, message, answer FROM files WHERE {self._is_key}", key
            )
            return BatchFile(str(path), status, message, answer and json.loads(answer))

    def add_common(self, options: str, contents: str, answer: str) -> None:
        """Store the common equation, as JSON, of the files whose `_contents` hash is `contents`."""
        self._write("INSERT OR REPLACE INTO common VALUES (?, ?, ?)", (options, contents, answer))

    def common(self, options: str, contents: str) -> Mapping[str, Any] | None:
        """The stored common equation of the files whose `_contents` hash is `contents`, or None."""
        with self._guard():
            rows = self._read("SELECT answer FROM common WHERE options = ? AND contents = ?", (options, contents))
            return dict(json.loads(rows[0][0])) if rows else None


def _key(path: str | Path, options: str) -> Key:
    return _text(os.path.abspath(path)), options


def _text(text: str) -> str:
    """Text that SQLite accepts: bytes of a file's name that are no characters are escaped."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _work(options: Mapping[str, Any], read: Read, path: Path) -> tuple[BatchFile, Identity | None]:
    """Find the equations of one file, in a worker or in this process; returns outcome and identity of the file."""
    identity, status, message, answer = None, "ok", "", None
    try:
        identity = Identity.of(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BayeqWarning)  # they are kept in the answer
            # converted to plain JSON here, so that an error is that of this file
            answer = json.loads(json.dumps(to_saved(discover(read(path), **options)), allow_nan=False))
    except OSError as error:
        status, message = "refused", f"{path}: {error.strerror or error}"
    except BayeqError as error:
        status, message = "refused", one_line(error)
    except Exception as error:  # noqa: BLE001 - one file does not stop the others; its row says what went wrong
        status, message = "failed", f"{path}: {type(error).__name__}: {one_line(error)}"
    return BatchFile(str(path), status, message, answer), identity


def _common(
    store: BatchStore, paths: Sequence[Path], options: Mapping[str, Any], read: Read, step: Progress
) -> Mapping[str, Any]:
    """The common equation of all readable files; from the store if the files have not changed."""
    asked = digest(options, read)
    known: dict[Path, Identity] = {}
    for path in paths:
        with suppress(OSError):  # `_sources` meets the error again
            known[path] = Identity.of(path)
    if (found := store.common(asked, _contents(known.values()))) is not None:
        return found  # all were used then, and none has to be read
    sources, used = _sources(paths, known, options, read, step)
    contents = _contents(used)
    if (found := store.common(asked, contents)) is not None:
        return found
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BayeqWarning)
            without_time = {name: value for name, value in options.items() if name not in ("t", "stream")}
            answer = json.dumps(to_saved(discover(sources, **without_time, progress=step)), allow_nan=False)
    except InputError as error:
        raise InputError(f"no common equation: {error}") from None
    store.add_common(asked, contents, answer)
    return dict(json.loads(answer))


def _contents(identities: Iterable[Identity]) -> str:
    """Hash of the contents of files."""
    return hashlib.sha256("".join(one.sha256 for one in identities).encode()).hexdigest()


def _sources(
    paths: Sequence[Path], known: Mapping[Path, Identity], options: Mapping[str, Any], read: Read, step: Progress
) -> tuple[list[Any], list[Identity]]:
    """Records and identities of the readable files; the identity of an unchanged file is taken from `known`."""
    roles = question(options).roles
    sources: list[Any] = []
    used: list[Identity] = []
    why: list[str] = []
    for k, path in enumerate(paths):
        step(COMMON, k, len(paths))
        try:
            identity = known.get(path)
            if identity is None or not identity.holds(path):
                identity = Identity.of(path)
            source = read(path)
            parts = list(source) if isinstance(source, (list, tuple)) else as_records(source, options.get("t"))
            for part in parts:
                for name in (*roles.measured, *roles.inputs) if isinstance(part, Record) else ():
                    _ = part[name]
        except (BayeqError, OSError) as error:
            why.append(one_line(error))  # refused again, with this message, when each file is done
            continue
        sources += parts
        used.append(identity)
    if not sources:
        raise InputError(f"no common equation: none of the {len(paths)} files can be used; the first: {why[0]}")
    return sources, used
