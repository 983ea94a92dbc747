"""Results in an SQLite file, stored as they are computed, so that stopped work can be resumed; and `fill`.

Only the processes that call `fill` write, not their workers, each time one transaction under SQLite's rollback journal
(one file, also on network drives): a kill at any moment leaves the committed transactions, and nothing else. Several
processes may share the work: each claims rows before it computes them (`Claims`). Missing results are computed by
worker processes: Ctrl-C stops quietly, and a kill leaves no workers.
"""

from __future__ import annotations

import os
import signal
import socket
import sqlite3
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from bayeq.errors import BayeqError, FileFormatError, InputError
from bayeq.resumable.posix import POSIX, has_ended, interrupts_later

#: Values of the key of a row.
Key = tuple[Any, ...]

# How long to wait for another process that is writing [s].
PATIENCE = 60.0

# A claim expires LEASE after its last renewal, and is renewed every BEAT [s].
LEASE, BEAT = 60.0, 15.0


class ResultStore:
    """An SQLite file with a table of results; a subclass defines the tables. Use it in a ``with`` statement.

    `make` opens it for work: the file is created if absent, and gets a table of claims if it has none. `any_thread`
    permits use from several threads, one at a time. FileFormatError if the file is absent, of another kind, damaged, or
    cannot be written.
    """

    #: Application id in the header of the file, and the version of its tables.
    application: ClassVar[int]
    version: ClassVar[int] = 1
    #: What the file is, in messages, such as "a study".
    noun: ClassVar[str]
    #: Statements that make the tables.
    schema: ClassVar[tuple[str, ...]]
    #: The table of results; the columns of its key, which come first, with their types.
    table: ClassVar[str]
    key: ClassVar[dict[str, str]]
    #: How `put` treats a row whose key exists already: IGNORE the new row, or REPLACE the old one.
    again: ClassVar[str]

    def __init__(self, path: str | Path, make: bool = False, any_thread: bool = False) -> None:
        self.path = Path(path)
        self._require_place(make)
        with self._guard():
            # Not read-only: what a killed process left half written has to be rolled back.
            self._connection = sqlite3.connect(
                f"{self.path.absolute().as_uri()}?mode={'rwc' if make else 'rw'}",
                uri=True,
                timeout=PATIENCE,
                isolation_level=None,
                check_same_thread=not any_thread,
            )
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
        """Raise FileFormatError for a path that is no file, or where a file cannot be created."""
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
        """Whether the result of this key is stored, and need not be computed again."""
        return bool(self._read(f"SELECT 1 FROM {self.table} WHERE {self._is_key}", key))

    @property
    def _is_key(self) -> str:
        return " AND ".join(f"{name} = ?" for name in self.key)

    def _one(self, statement: str) -> Any:
        return self._connection.execute(statement).fetchone()[0]

    def _read(self, statement: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        with self._guard():
            return self._connection.execute(statement, values).fetchall()

    def _write(self, statement: str, *rows: Sequence[Any]) -> None:
        """Execute a statement with each row of values (or once without values), in one transaction."""
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
        """Turn errors of SQLite, and of damaged contents, into FileFormatError."""
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
    """Claims of this process on rows, so that several processes on one store compute each row once.

    A claim expires after a minute unless a thread of its owner renews it, and at once if its owner was a process of
    this machine that has ended. If a claim is lost and a row is computed twice, both results are the same. The context
    manager drops the remaining claims at its end. It opens the store a second time, for use by threads.
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
        with self._store, suppress(FileFormatError):  # otherwise they expire
            self._store._write("DELETE FROM claims WHERE owner = ?", (self.owner,))

    def free(self, wanted: Sequence[Key]) -> tuple[Key, ...]:
        """Claim rows in one transaction; returns those that are neither claimed by others nor done."""
        store, free = self._store, []
        with self._lock:
            with store._transaction():
                for key in wanted:
                    found = store._connection.execute(f"SELECT owner, until FROM claims WHERE {store._is_key}", key)
                    other = found.fetchone()
                    if other is None or other[0] == self.owner or _dead(*other):
                        free.append(key)
                store._connection.executemany(
                    f"INSERT OR REPLACE INTO claims VALUES ({'?, ' * len(store.key)}?, ?)",
                    [(*key, self.owner, time.time() + LEASE) for key in free],
                )
            # another process may have done a row before it was claimed here
            return tuple(key for key in free if not store.done(key))

    def _beat(self) -> None:
        while not self._stop.wait(BEAT):
            with suppress(FileFormatError), self._lock:  # the next renewal will do
                self._store._write("UPDATE claims SET until = ? WHERE owner = ?", (time.time() + LEASE, self.owner))


def _dead(owner: str, until: float) -> bool:
    """Whether a claim has expired, or its process on this machine has ended."""
    if until < time.time():
        return True
    host, process, _ = owner.rsplit(":", 2)
    return host == socket.gethostname() and has_ended(int(process))


# --- what a store lacks, computed by worker processes -----------------------------------------------------------------

Task = TypeVar("Task")
Answer = TypeVar("Answer")

# Tasks dispatched for each worker at a time.
AHEAD = 3

# How often a worker looks whether its parent is alive [s].
WATCH = 0.5

# Pause before missing rows are checked again when other processes have claimed all of them [s].
LOOK = 0.5

# Most worker processes; a larger number is taken for a typing mistake.
MAX_JOBS = 512


def fill(
    store: ResultStore,
    missing: Callable[[], Sequence[Sequence[Key]]],
    work: Callable[[Any], Answer],
    keep: Callable[[Answer], object],
    jobs: int = 1,
    size: int = 1,
    tasks: Callable[[Sequence[Key]], Any] = tuple,
    count: Callable[[Answer], int] = lambda answer: 1,
    cluster: Any = None,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Compute the results that a store lacks; returns the number of groups done.

    `missing` returns the keys still missing, in groups that are computed together, and is called until there are none.
    `tasks` turns the keys of `size` groups into a task, `work` a task into its answer, `keep` puts an answer into the
    store as it is ready, and `count` gives the number of groups in it. The work is done by `jobs` processes (1: this
    process) or by the workers of a `cluster`. A result depends on its key alone, whatever the workers, batches and
    kills; several processes may fill a store. `progress` is called with (groups done in this call, their total).
    """
    done = 0
    with Claims(store) as claims:
        while groups := missing():
            before, total = done, done + len(groups)
            batches = ([key for group in groups[k : k + size] for key in group] for k in range(0, len(groups), size))
            todo = (tasks(free) for batch in batches if (free := claims.free(batch)))
            answers = (
                compute(work, todo, min(jobs, -(-len(groups) // size)), store.path)
                if cluster is None
                else cluster.unordered(work, todo)
            )
            with closing(answers):
                for answer in answers:
                    done += count(answer)
                    keep(answer)
                    if progress is not None:
                        progress(done, total)
            if done == before:  # others have claimed all of it
                time.sleep(LOOK)
    return done


def compute(
    work: Callable[[Task], Answer], tasks: Iterable[Task], jobs: int, store: Path
) -> Generator[Answer, None, None]:
    """The answer to each task, as it is ready; with one job in this process. BayeqError where a worker was killed."""
    if jobs == 1:
        for task in tasks:
            yield work(task)
        return
    from joblib import Parallel, delayed, parallel_config

    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(
            n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch=AHEAD * jobs, max_nbytes=None
        )
    hook = threading.excepthook
    threading.excepthook = partial(_thread_failed, hook)
    try:
        with _born_quiet():
            answers = parallel(delayed(_in_worker)(work, task, os.getpid()) for task in tasks)
        try:
            for answer in answers:  # noqa: UP028 - `yield from` would close it before the warning is silenced
                yield answer
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "generator was not exhausted": it is meant not to be
                answers.close()
    except BrokenProcessPool:
        raise BayeqError(
            f"a worker process was killed (out of memory?); what was done is in {store}: the same command continues,"
            " fewer jobs need less memory"
        ) from None
    finally:
        threading.excepthook = hook


def _in_worker(work: Callable[[Task], Answer], task: Task, parent: int) -> Answer:
    _stop_with(parent)
    return work(task)


def _thread_failed(hook: Callable[[threading.ExceptHookArgs], object], failure: threading.ExceptHookArgs) -> None:
    """Report an exception in a thread, unless it is the KeyError of loky's manager thread after a stop."""
    name = failure.thread.name if failure.thread is not None else ""
    if not (name.startswith("ExecutorManager") and issubclass(failure.exc_type, KeyError)):
        hook(failure)


@contextmanager
def _born_quiet() -> Iterator[None]:
    """Processes started within leave Ctrl-C to the parent, and their resource tracker does not warn after a stop."""
    from multiprocessing.resource_tracker import ensure_running

    warned = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (warned, "ignore:resource_tracker")))
    try:
        if POSIX:
            ensure_running()  # before the block: in Python 3.11 it unblocks interrupts at its end
        with interrupts_later():
            yield
    finally:
        if warned is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = warned


@lru_cache(maxsize=1)
def _stop_with(parent: int) -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes, in this worker; end it soon after its parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=look, daemon=True, name="watch-parent").start()
