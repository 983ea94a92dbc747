"""``Cluster``: units of rows summed by the workers of a Dask cluster; ``connected`` finds it by its address.

Each unit is a task, and a further task adds the results of eight consecutive units; the caller adds these sums in
order. The order does not depend on the workers, so that the result does not either, to the last digit.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import sys
import threading
import time as clock
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from importlib.metadata import PackageNotFoundError, version
from operator import add
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit
from weakref import WeakValueDictionary

import numpy as np
from threadpoolctl import threadpool_limits

from bayeq.discovery.streaming.work import Extent, Unit, Work
from bayeq.errors import BayeqError, InputError, RecordError, needing
from bayeq.records import Record
from bayeq.records.columns import Headers, Request
from bayeq.records.formats.protocol import parts_between
from bayeq.records.stream import FileStream

T = TypeVar("T")

# Units whose results the workers add before they are sent.
TOGETHER = 8

# Tasks that wait for each thread of a worker, so that none is idle.
AHEAD = 3

# How long the first worker may take to join, and the last one that has gone to come back [s].
JOIN, COME_BACK = 30.0, 120.0

# Time between checks whether there is a worker [s].
LOOK = 5.0

# How long an address may take to answer [s].
ANSWER = 5.0


class Cluster:
    """Workers of a Dask cluster, by its client; InputError for other objects, or workers with another bayeq version."""

    def __init__(self, client: Any) -> None:
        if not all(hasattr(client, name) for name in ("submit", "compute", "nthreads", "run")):
            raise InputError(
                f"client is a dask.distributed.Client, not {type(client).__name__}: bayeq.discover(...,"
                " client=Client('tcp://host:8786'))"
            )
        if getattr(client, "asynchronous", False):
            raise InputError("client is asynchronous: give a dask.distributed.Client(..., asynchronous=False)")
        self.client = client
        _require_workers(client)

    def map(self, work: Work[T], units: Sequence[Unit]) -> Iterator[tuple[int, T]]:
        """Sums over `TOGETHER` units, in order; only a few units per thread of the workers are submitted at a time."""
        parts: WeakValueDictionary[tuple[int, int], Any] = WeakValueDictionary()
        sent = self._submit(_itself, work.on([_without_rows(one) for one in work.extents]))

        def summed(chunk: Sequence[Unit]) -> tuple[Any, list[Any]]:
            needed: list[Any] = []
            found = []
            for unit in chunk:
                numbers, held = self._parts(work, unit, parts)
                needed += held
                found.append(self._submit(_of_unit, sent, unit, numbers, held))
            return self._submit(reduce, add, found), needed

        chunks = [units[k : k + TOGETHER] for k in range(0, len(units), TOGETHER)]
        waiting: deque[tuple[int, Any, list[Any]]] = deque()
        try:
            for chunk in chunks:
                waiting.append((len(chunk), *summed(chunk)))
                if sum(count for count, _, _ in waiting) > AHEAD * self.threads + TOGETHER:
                    count, future, _ = waiting.popleft()
                    yield count, self._result(future)
            while waiting:
                count, future, _ = waiting.popleft()
                yield count, self._result(future)
        finally:
            for _, future, _ in waiting:
                future.release()

    def unordered(self, function: Callable[[Any], T], tasks: Iterable[Any]) -> Generator[T, None, None]:
        """Results of a function for each task, as they are ready; tasks are submitted as workers become free."""
        waiting: list[Any] = []
        left = iter(tasks)
        try:
            while True:
                while len(waiting) < AHEAD * self.threads and (task := next(left, None)) is not None:
                    waiting.append(self._submit(_on_one_thread, function, task))
                if not waiting:
                    return
                done = self._first(waiting)
                waiting.remove(done)
                yield self._result(done)
        finally:
            for future in waiting:
                future.release()

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Submit a task of its own, even if another has the same arguments (`pure=False`)."""
        return self.client.submit(function, *arguments, pure=False)

    def _sent(self, record: Record) -> Any:
        """Rows in memory as a task's result: unlike data that are scattered, they survive the worker that has them."""
        import dask

        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"}):
            return self._submit(_itself, record)

    def _parts(
        self, work: Work[Any], unit: Unit, known: WeakValueDictionary[tuple[int, int], Any]
    ) -> tuple[list[int], list[Any]]:
        """Numbers of the parts that a unit needs, and the tasks that hold them; none for a file, which workers read."""
        stream = work.extents[unit.extent].stream
        if isinstance(stream, FileStream):
            return [], []
        numbers = parts_between(stream.bounds, unit.start - work.reach, unit.stop + work.reach)
        held = []
        for k in numbers:
            found = known.get((unit.extent, k))
            if found is None:
                if isinstance(stream, DaskStream):
                    found = self.client.compute(stream.partitions[k])
                else:
                    found = self._sent(stream.read(stream.bounds[k], stream.bounds[k + 1]))
                known[unit.extent, k] = found
            held.append(found)
        return numbers, held

    @property
    def threads(self) -> int:
        """Threads of all workers now, at least 1."""
        with _clear_errors():
            return max(1, sum(self.client.nthreads().values()))

    def _first(self, futures: Sequence[Any]) -> Any:
        from distributed import wait

        def look(timeout: float) -> Any:
            with self.client.as_current():
                return next(iter(wait(futures, timeout=timeout, return_when="FIRST_COMPLETED").done))

        return self._patiently(look, lambda: any(one.done() for one in futures))

    def _result(self, future: Any) -> Any:
        return self._patiently(lambda timeout: future.result(timeout=timeout), future.done)

    def _patiently(self, look: Callable[[float], Any], done: Callable[[], bool]) -> Any:
        """Call `look` until it returns; BayeqError if all workers are gone for longer than `COME_BACK`."""
        gone = None
        with _clear_errors():
            while True:
                try:
                    return look(LOOK)
                except TimeoutError:
                    if done():  # done since, or failed with a TimeoutError itself
                        return look(LOOK)
                gone = None if self.client.nthreads() else gone or clock.monotonic()
                if gone is not None and clock.monotonic() - gone > COME_BACK:
                    raise BayeqError(
                        "all workers of the cluster have gone; start some, and the same command goes on from what was"
                        " kept"
                    )


def _without_rows(extent: Extent) -> Extent:
    """An extent as sent to every worker: rows in memory are left out, and sent in parts to those that need them."""
    if isinstance(extent.stream, FileStream):
        return extent
    return replace(extent, stream=Parts(extent.stream.name, tuple(extent.stream.bounds)))


def _itself(value: T) -> T:
    """Task that returns its argument: if the worker that holds it is lost, another one computes it again."""
    return value


def _of_unit(work: Work[T], unit: Unit, numbers: Sequence[int], held: Sequence[Any]) -> T:
    """Compute the work for a unit, on a worker."""
    extents = list(work.extents)
    own = extents[unit.extent]
    if isinstance(own.stream, Parts):
        extents[unit.extent] = replace(own, stream=own.stream.with_parts(numbers, held))
        work = work.on(extents)
    try:
        return _on_one_thread(work, unit)
    except OSError as error:
        file = error.filename or getattr(getattr(own.stream, "rows", None), "path", own.stream.name)
        reason = os.strerror(error.errno) if error.errno else type(error).__name__
        raise InputError(
            f"{file}: a worker cannot read it ({reason}): put the files where all workers find them by the same path"
        ) from None


class _OneThread:
    """Linear algebra on one thread while any task of this process runs, so that sums are rounded alike."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.users = 0
        self.limits: Any = None

    def __enter__(self) -> None:
        with self.lock:
            if not self.users:
                self.limits = threadpool_limits(1)
            self.users += 1

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.users -= 1
            if not self.users:
                self.limits.restore_original_limits()


_ONE_THREAD = _OneThread()


def _on_one_thread(function: Callable[[Any], T], task: Any) -> T:
    with _ONE_THREAD:
        return function(task)


@contextmanager
def _clear_errors() -> Iterator[None]:
    """Turn Dask's errors about lost workers and schedulers into a BayeqError of one line."""
    from asyncio import CancelledError as Cancelled
    from concurrent.futures import CancelledError

    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    try:
        yield
    except KilledWorker:
        raise BayeqError(
            "several workers died one after the other at the same task (out of memory?): give each more memory or fewer"
            " threads; the same command goes on from what was kept"
        ) from None
    except (CancelledError, Cancelled, CommClosedError):
        raise BayeqError(
            "the scheduler of the cluster has gone or was restarted; start it, and the same command goes on from what"
            " was kept"
        ) from None


def _require_workers(client: Any) -> None:
    """Wait for a worker, and refuse those with another version of bayeq, whose sums might differ."""
    try:
        client.wait_for_workers(1, timeout=JOIN)
    except TimeoutError:
        raise InputError(
            f"no worker has joined the cluster in {JOIN:g} s: start some, `dask worker {client.scheduler.address}`"
        ) from None
    here = version("bayeq")
    try:
        found = client.run(version, "bayeq")
    except PackageNotFoundError:
        raise InputError("a worker of the cluster has no bayeq: install it there, as here") from None
    for address, there in found.items():
        if there != here:
            raise InputError(f"the worker {address} has bayeq {there}, here it is {here}: install the same version")


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The client of a cluster, by the address of its scheduler or its file; an InputError if no scheduler answers."""
    with needing("distributed", "dask", "work on a cluster"):
        from distributed import Client
    found = _in_file(address)
    try:
        _require_answer(found)
        client = Client(found, timeout=ANSWER)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[:1] or [type(error).__name__]
        raise InputError(
            f"{address}: no Dask scheduler answers ({reason[0]}); start one, `dask scheduler`, and give the address"
            " that it prints, such as tcp://host:8786"
        ) from None
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.core")]
    levels = [one.level for one in loggers]
    for one in loggers:  # errors are reported in one line, see `_clear_errors`
        one.setLevel(logging.CRITICAL)
    try:
        yield client
    finally:
        client.close()
        for one, level in zip(loggers, levels, strict=True):
            one.setLevel(level)


def _in_file(address: str) -> str:
    """The address in a scheduler's file, or the address itself."""
    path = Path(address)
    if "://" in address or not (path.is_file() or path.suffix == ".json"):
        return address
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["address"]
    except FileNotFoundError:
        raise InputError(
            f"{address}: no such file; it is written by `dask scheduler --scheduler-file {address}`"
        ) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(
            f"{address}: holds no address of a scheduler; give the file that `dask scheduler --scheduler-file` wrote"
        ) from None
    return str(found)


def _require_answer(address: str) -> None:
    """Raise OSError or ValueError for an address without a scheduler, for which a client would wait."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme not in ("tcp", "tls", "ws", "wss") or not parts.hostname or parts.port is None:
        raise ValueError("it is no address of one")
    with socket.create_connection((parts.hostname, parts.port), timeout=ANSWER) as connection:
        if parts.scheme == "tcp" and not connection.recv(1):  # a scheduler sends first
            raise OSError("somebody else is there")


# --- records in parts: those of a Dask DataFrame, and those that are sent to another process --------------------------


@dataclass(frozen=True)
class Parts:
    """A record with some of its parts in memory."""

    name: str  # of the record
    bounds: tuple[int, ...]  # first rows of all parts, and the number of rows
    held: Mapping[int, Record] = field(default_factory=dict)  # the parts in memory, by number

    def with_parts(self, numbers: Sequence[int], parts: Sequence[Record]) -> Parts:
        """The record with these parts in memory."""
        return replace(self, held=dict(zip(numbers, parts, strict=True)))

    def of(self, channels: Sequence[str]) -> Parts:
        """Itself: its parts have only the channels that are needed."""
        del channels
        return self

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop`; RecordError for a part that has another number of rows than before."""
        numbers = parts_between(self.bounds, start, stop)
        parts = [self.held[k] for k in numbers]
        for k, part in zip(numbers, parts, strict=True):
            if part.n != self.bounds[k + 1] - self.bounds[k]:
                raise RecordError(f"{self.name}, partition {k + 1}: has changed while it was read; start once more")
        record = parts[0]
        if len(parts) > 1:
            channels = {name: np.concatenate([part[name] for part in parts]) for name in record.names}
            times = [part.time for part in parts if part.time is not None]
            time = np.concatenate(times) if len(times) == len(parts) else None
            record = Record(channels, time, record.units, self.name)
        first = self.bounds[numbers[0]]
        return record.take(slice(start - first, stop - first))


@dataclass(frozen=True)
class DaskStream:
    """A Dask DataFrame; its partitions are read by the workers of a cluster."""

    name: str  # of the record
    bounds: tuple[int, ...]  # first rows of the partitions that have any, and the number of rows
    partitions: tuple[Any, ...]  # delayed objects, a Record each
    client: Any  # the cluster

    def of(self, channels: Sequence[str]) -> DaskStream:
        """Itself: the channels were chosen when it was made."""
        del channels
        return self

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop`: cut out by a worker, so that no whole partition is transferred."""
        numbers = parts_between(self.bounds, start, stop)
        futures = [self.client.compute(self.partitions[k]) for k in numbers]
        empty = Parts(self.name, self.bounds)
        record: Record = self.client.submit(_rows, empty, numbers, futures, start, stop, pure=False).result()
        return record


def _rows(empty: Parts, numbers: Sequence[int], parts: Sequence[Record], start: int, stop: int) -> Record:
    return empty.with_parts(numbers, parts).read(start, stop)


def is_dask(data: Any) -> bool:
    """Whether something is a Dask DataFrame or array, or a mapping or list with one; Dask is not imported for it."""
    if "dask" not in sys.modules:
        return False
    if isinstance(data, Mapping):
        return any(map(is_dask, data.values()))
    if isinstance(data, (list, tuple)):
        return any(map(is_dask, data))
    return type(data).__module__.partition(".")[0] == "dask"


def dask_streams(data: Any, client: Any, channels: Sequence[str], time: Any = None) -> list[DaskStream]:
    """Dask DataFrames, or mappings of names to (n,) Dask arrays, as records whose units are the partitions.

    Only the columns of `channels` and `time` are read. InputError for a Dask array without names, times that
    are dates, or a channel that is not there.
    """
    if time is not None and not isinstance(time, str):
        raise InputError("t names the column that is time, of a Dask DataFrame; put sampling times into a column")
    frames = [_frame(one) for one in (data if isinstance(data, (list, tuple)) else [data])]
    names = [f"data frame {k + 1}" if len(frames) > 1 else "data frame" for k in range(len(frames))]
    return [_stream(one, name, client, channels, time) for one, name in zip(frames, names, strict=True)]


def _frame(data: Any) -> Any:
    import dask.array as da
    import dask.dataframe as dd

    if isinstance(data, Mapping):
        arrays = {str(name): da.asarray(values) for name, values in data.items()}
        shapes = {name: values.shape for name, values in arrays.items()}
        for name, values in arrays.items():
            if values.ndim != 1 or np.isnan(values.shape[0]):
                raise InputError(
                    f"{name}: give Dask arrays of one dimension and of known length (array.compute_chunk_sizes()), not"
                    f" of shape {values.shape}"
                )
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{name} {shape[0]}" for name, shape in shapes.items())
            raise InputError(f"Dask arrays of unequal lengths: {listed}")
        return dd.from_dask_array(da.stack(list(arrays.values()), axis=1).rechunk({1: -1}), columns=list(arrays))
    if hasattr(data, "to_delayed") and hasattr(data, "map_partitions"):
        return data
    raise InputError(
        f"no record can be made of {type(data).__name__}: give a Dask DataFrame, or a mapping of channels to Dask"
        " arrays of one dimension, as in {'x': array[:, 0], 'v': array[:, 1]}"
    )


def _stream(frame: Any, name: str, client: Any, channels: Sequence[str], time: str | None) -> DaskStream:
    from dask.delayed import delayed

    frame = frame[_needed(frame._meta, channels, time)]
    parts = frame.to_delayed()
    lengths = client.gather(client.compute([delayed(len)(part) for part in parts]))
    kept = [k for k, length in enumerate(lengths) if length]
    if not kept:
        raise RecordError(f"{name}: no rows")
    bounds = (0, *np.cumsum([lengths[k] for k in kept]).tolist())
    make = partial(delayed(Record.from_dataframe), time=time, columns=list(channels) or None)
    return DaskStream(name, bounds, tuple(make(parts[k]) for k in kept), client)


def _needed(empty: Any, channels: Sequence[str], time: str | None) -> list[Any]:
    """Columns of the channels and of time; InputError for dates."""
    headers = Headers.of_dataframe(empty, time)
    if time is not None:
        headers.find(time)  # an UnknownNameError here rather than in a worker
    found = Request(list(channels) or None, time=time).rows(headers)
    first = len(headers) - len(empty.columns)  # 1 with an index
    kinds = [empty.index.dtype.kind] * first + [getattr(kind, "kind", "O") for kind in empty.dtypes]
    for k in found:
        if kinds[k] in "mM":
            where = str(empty.index.name) if k < first else str(empty.columns[k - first])
            raise InputError(f"data frame, column {where!r}: holds dates; write the time in seconds")
    return [empty.columns[k - first] for k in found if k >= first]
