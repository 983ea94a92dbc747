"""``fold``: the sum of what is computed of every unit of rows, in the order of the rows whoever computes it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from bayeq.streaming.extent import Extent, Unit

__all__ = ["Executor", "Threads", "Work", "fold"]

T = TypeVar("T")
Of = TypeVar("Of", covariant=True)
Progress = Callable[[str, int, int], None]


class Work(Protocol[Of]):
    """Something that is computed of units of rows, and can be added. It can be sent to other processes."""

    @property
    def extents(self) -> Sequence[Extent]:
        """The rows."""
        ...

    @property
    def reach(self) -> int:
        """How many rows before and after a unit are looked at."""
        ...

    def on(self, extents: Sequence[Extent]) -> Work[Of]:
        """The same of the same rows, kept elsewhere."""
        ...

    def __call__(self, unit: Unit) -> Of:
        """What is computed of a unit."""
        ...


class Executor(Protocol):
    """Who computes."""

    def map(self, work: Work[T], units: Sequence[Unit]) -> Iterator[tuple[int, T]]:
        """What is computed of consecutive units, in order: how many of them, and their sum."""
        ...


class Threads:
    """Threads of this process, as many as there are cores; few units are in memory at a time."""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers

    def map(self, work: Work[T], units: Sequence[Unit]) -> Iterator[tuple[int, T]]:
        """One unit after the other."""
        from joblib import cpu_count  # which takes a while to import

        workers = self.workers or cpu_count()
        waiting: deque[Any] = deque()
        left = iter(units)
        with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
            try:
                for unit in left:
                    waiting.append(pool.submit(work, unit))
                    if len(waiting) > workers:
                        yield 1, waiting.popleft().result()
                while waiting:
                    yield 1, waiting.popleft().result()
            finally:
                for one in waiting:
                    one.cancel()


def fold(
    work: Work[T],
    units: Sequence[Unit],
    executor: Executor,
    progress: Progress,
    stage: str,
    kept: Any = None,
) -> T:
    """The sum over units, of at least one.

    Parameters
    ----------
    work : Work
        Computes something of a unit that can be added.
    units : sequence of Unit
        The units, in order.
    executor : Executor
        Who computes.
    progress : callable
        Called with (stage, rows done, rows in all).
    stage : str
        What it is called there.
    kept : Checkpoint, optional
        Where the sum so far is kept, and taken from.
    """
    # One name for both: wherever an interrupt falls, they belong together.
    so_far: tuple[int, Any] = (0, None) if kept is None else kept.load()
    rows = [0, *accumulate(unit.n for unit in units)]
    progress(stage, rows[so_far[0]], rows[-1])
    try:
        for count, part in executor.map(work, units[so_far[0] :]):
            done, total = so_far
            so_far = done + count, part if total is None else total + part
            progress(stage, rows[so_far[0]], rows[-1])
            if kept is not None:
                kept.save(*so_far, last=so_far[0] == len(units))
    except BaseException:
        if kept is not None and so_far[0]:
            kept.save(*so_far, last=True)
        raise
    assert so_far[1] is not None
    return so_far[1]
