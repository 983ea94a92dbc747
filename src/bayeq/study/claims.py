"""``Claims``: which realisations this process works at, so that several processes on one store do each of them once.

A claim ends after a minute unless its owner prolongs it; that of a process of this machine that is no more ends at
once. Where a claim is lost and a realisation is done twice after all, the second row is dropped: the first is the same.
"""

from __future__ import annotations

import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from bayeq.errors import FileFormatError
from bayeq.study.realise import Task
from bayeq.study.store import Store

__all__ = ["Claims"]

# A claim ends so long after it was prolonged last, which is done that often [s].
LEASE, BEAT = 60.0, 15.0


class Claims:
    """What this process has claimed in a store; a context manager that gives back what is not done at its end.

    Parameters
    ----------
    path : path
        The store.
    """

    def __init__(self, path: Path) -> None:
        self.owner = f"{socket.gethostname()}:{os.getpid()}:{uuid.uuid4().hex[:8]}"
        self._store = Store.open(path, any_thread=True)  # joblib asks for batches in threads of its own
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._beating = threading.Thread(target=self._beat, daemon=True, name="claims")

    def __enter__(self) -> Self:
        self._beating.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._beating.join()
        with self._store, suppress(FileFormatError):  # otherwise they end by themselves
            self._store.release(self.owner)

    def batches(self, tasks: Sequence[Task], size: int) -> Iterator[tuple[Task, ...]]:
        """Claim tasks, some at a time, as they are asked for; what is done or claimed by others is left out."""
        for k in range(0, len(tasks), size):
            if batch := self._claimed(tasks[k : k + size]):
                yield batch

    def _claimed(self, tasks: Sequence[Task]) -> tuple[Task, ...]:
        wanted = [(task.system, task.index, name) for task in tasks for name in task.algorithms]
        with self._lock:
            free = set(self._store.claimed(wanted, self.owner, time.time() + LEASE, _dead))
        out = []
        for task in tasks:
            names = tuple(name for name in task.algorithms if (task.system, task.index, name) in free)
            if names:
                out.append(Task(task.system, task.index, names))
        return tuple(out)

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
    if host != socket.gethostname() or os.name == "nt":
        return False
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # of another user
        return False
    return False
