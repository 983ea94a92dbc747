"""Records in parts: those of a Dask DataFrame, and those that are sent to another process."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayeq.errors import InputError, RecordError
from bayeq.records import Record
from bayeq.records.columns import Headers, Request
from bayeq.records.formats.protocol import parts_between


@dataclass(frozen=True)
class Parts:
    """A record of which some parts are at hand."""

    name: str  # of the record
    bounds: tuple[int, ...]  # first rows of all parts, and the number of rows
    held: Mapping[int, Record] = field(default_factory=dict)  # the parts at hand, by their numbers

    def of(self, channels: Sequence[str]) -> Parts:
        """Itself: what is at hand has the channels that are needed."""
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
    partitions: tuple[Any, ...]  # a Record each
    client: Any  # the cluster

    def of(self, channels: Sequence[str]) -> DaskStream:
        """Itself: the channels were chosen when it was made."""
        del channels
        return self

    def read(self, start: int, stop: int) -> Record:
        """Rows `start` to `stop`: taken by a worker, so that no whole partition comes here."""
        numbers = parts_between(self.bounds, start, stop)
        futures = [self.client.compute(self.partitions[k]) for k in numbers]
        found = self.client.submit(_rows, self.name, self.bounds, numbers, futures, start, stop, pure=False)
        record: Record = found.result()
        return record


def _rows(
    name: str, bounds: tuple[int, ...], numbers: Sequence[int], parts: Sequence[Record], start: int, stop: int
) -> Record:
    return Parts(name, bounds, dict(zip(numbers, parts, strict=True))).read(start, stop)


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
    several = isinstance(data, (list, tuple))
    frames = [_frame(one) for one in (data if several else [data])]
    names = [f"data frame {k + 1}" if len(frames) > 1 else "data frame" for k in range(len(frames))]
    return [_stream(one, name, client, channels, time) for one, name in zip(frames, names, strict=True)]


def _frame(data: Any) -> Any:
    """A Dask DataFrame."""
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
    make = delayed(_record)
    return DaskStream(name, bounds, tuple(make(parts[k], time, tuple(channels)) for k in kept), client)


def _needed(empty: Any, channels: Sequence[str], time: str | None) -> list[Any]:
    """The columns that hold some channels, and time."""
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


def _record(frame: Any, time: str | None, channels: tuple[str, ...]) -> Record:
    """A partition as a record."""
    return Record.from_dataframe(frame, time=time, columns=list(channels) or None)
