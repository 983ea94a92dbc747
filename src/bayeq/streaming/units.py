"""Rows of streams that are used, units of them, and ``fold``: the sum of what is computed of every unit.

Sums are taken in the order of the rows, whoever computes them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from bayeq.records import Record, counts_rows, with_row_numbers
from bayeq.records.stream import Stream, units_between
from bayeq.resumable import Progress
from bayeq.states.motion import cut_at
from bayeq.streaming.settings import STREAMING

Of = TypeVar("Of")

#: Rows of each of the stretches that are looked at first.
ROWS_EACH = 5000


@dataclass(frozen=True)
class Extent:
    """Rows `start` to `stop` of a stream."""

    stream: Stream
    start: int
    stop: int

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.stop - self.start

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop` of the stream; without time their numbers are."""
        (record,) = with_row_numbers([self.stream.read(start, stop)])
        if record.time is None or not counts_rows(record):
            return record
        return Record(record.channels, record.time + start, record.units, record.name)

    def cut(self, share: float) -> int:
        """The first row that is held out."""
        return self.start + cut_at(self.n, share)


@dataclass(frozen=True, order=True)
class Unit:
    """Rows that are read together: of which extent, by its number, and which."""

    extent: int
    start: int
    stop: int

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.stop - self.start


def units_of(extents: Sequence[Extent], most: int | None = None) -> list[Unit]:
    """The units of some extents, in order, divided into parts of at most `most` rows if that is given."""
    out = []
    for k, one in enumerate(extents):
        for start, stop in units_between(one.stream.bounds, one.start, one.stop):
            parts = 1 if most is None else -(-(stop - start) // most)
            bounds = np.linspace(start, stop, parts + 1).round().astype(int).tolist()
            out += [Unit(k, a, b) for a, b in pairwise(bounds)]
    return out


def of_channels(extents: Sequence[Extent], channels: Sequence[str]) -> tuple[Extent, ...]:
    """These rows, restricted to the given channels and time; all channels if none is given."""
    if not channels:
        return tuple(extents)
    return tuple(replace(one, stream=one.stream.of(list(channels))) for one in extents)


def stretches(extents: Sequence[Extent]) -> list[Record]:
    """Stretches spread evenly over some extents, all rows of short ones."""
    total = sum(one.n for one in extents)
    out: list[Record] = []
    for one in extents:
        length = min(ROWS_EACH, one.n) if total > STREAMING.stretches * ROWS_EACH else one.n
        if length == one.n:
            out.append(one.read(one.start, one.stop))
            continue
        count = max(1, round(STREAMING.stretches * one.n / total))
        for first in np.linspace(one.start, one.stop - length, count).round().astype(int).tolist():
            record = one.read(first, first + length)
            name = f"{record.name}, rows {first + 1:,} to {first + record.n:,}"
            out.append(Record(record.channels, record.time, record.units, name))
    return out


@dataclass(frozen=True)
class Work(ABC, Generic[Of]):
    """Something that is computed of units of rows, and can be added. It can be sent to other processes."""

    extents: tuple[Extent, ...]

    @property
    def reach(self) -> int:
        """How many rows before and after a unit are read."""
        return 0

    def on(self, extents: Sequence[Extent]) -> Self:
        """The same work on other storage of the same rows."""
        return replace(self, extents=tuple(extents))

    @abstractmethod
    def __call__(self, unit: Unit) -> Of:
        """What is computed of a unit."""


class Executor(Protocol):
    """Who computes."""

    def map(self, work: Work[Of], units: Sequence[Unit]) -> Iterator[tuple[int, Of]]:
        """What is computed of consecutive units, in order: how many of them, and their sum."""
        ...


class Threads:
    """Threads of this process, as many as there are cores; few units are in memory at a time."""

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers

    def map(self, work: Work[Of], units: Sequence[Unit]) -> Iterator[tuple[int, Of]]:
        """One unit after the other."""
        from joblib import cpu_count  # which takes a while to import

        workers = self.workers or cpu_count()
        waiting: deque[Any] = deque()
        with threadpool_limits(1), ThreadPoolExecutor(workers) as pool:
            try:
                for unit in units:
                    waiting.append(pool.submit(work, unit))
                    if len(waiting) > workers:
                        yield 1, waiting.popleft().result()
                while waiting:
                    yield 1, waiting.popleft().result()
            finally:
                for one in waiting:
                    one.cancel()


def fold(
    work: Work[Of],
    units: Sequence[Unit],
    executor: Executor,
    progress: Progress,
    stage: str,
    kept: Any = None,
) -> Of:
    """The sum over units, of at least one, of what `work` computes.

    The executor computes; `progress` is called with (stage, rows done, rows in all). The sum so far is kept in a
    Checkpoint, if one is given, and taken from it.
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
