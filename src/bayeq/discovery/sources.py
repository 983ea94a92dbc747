"""How records are taken: whole, or, where they are long, some rows at a time."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from bayeq.discovery.question import NotStreamed, Question
from bayeq.equation.equations import Equations
from bayeq.errors import InputError, WarningLog
from bayeq.records import as_records, with_row_numbers
from bayeq.records.stream import RecordStream, Stream, open_streams, streamed_unasked
from bayeq.streaming.checkpoint import Checkpoints, cache_folder
from bayeq.streaming.cluster import Cluster
from bayeq.streaming.partitions import dask_streams, is_dask
from bayeq.streaming.units import Executor, Extent, Threads, of_channels, stretches
from bayeq.streaming.whole import Whole

__all__ = ["answer_of", "extents_of"]

# Longer records in memory are taken in units, as large files are.
MOST_ROWS = 200_000


def answer_of(
    question: Question,
    records: Any,
    t: Any = None,
    stream: bool | None = None,
    client: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> tuple[Equations, WarningLog]:
    """The answer to a question, as `bayeq.discover` takes the records."""
    channels = [*question.roles.measured, *question.roles.inputs]
    executor = Threads() if client is None else Cluster(client)
    if is_dask(records):
        if client is None:
            raise InputError("Dask collections are read by a cluster: give client=, a dask.distributed.Client")
        records = _whole_streams(dask_streams(records, client, channels, t))
    extents = extents_of(records, t, stream, clustered=client is not None)
    if extents is not None:
        extents = of_channels(extents, channels)
        whole = _whole(question, extents, executor, checkpoint)
        try:
            found = question.answer(stretches(extents), whole)
            whole.checkpoints.clear()
        except KeyboardInterrupt as stop:
            if (folder := whole.checkpoints.kept) is not None:
                stop.add_note(f"sums over the rows are kept in {folder}; the same command continues")
            raise
        return found
    measured = with_row_numbers(as_records(records, t))
    long = sum(record.n for record in measured) > MOST_ROWS
    if long and (question.smooth == "auto" or (client is not None and question.smooth == "none")):
        rows = of_channels(_whole_streams(map(RecordStream, measured)), channels)
        try:
            return question.answer(stretches(rows), _whole(question, rows, executor, None))
        except NotStreamed as why:
            some = stretches(rows)
            used, given = sum(record.n for record in some), sum(record.n for record in measured)
            return question.answer(some, because=f"{used:,} of {given:,} rows are used, {len(some)} stretches: {why}")
    return question.answer(measured)


def extents_of(records: Any, t: Any, stream: bool | None, clustered: bool = False) -> tuple[Extent, ...] | None:
    """The rows of files that are read some at a time, on a cluster those of all files; None of records that are taken
    whole."""
    several = isinstance(records, Sequence) and not isinstance(records, (str, bytes))
    items = list(records) if several else [records]
    if items and all(isinstance(one, Extent) for one in items):
        return tuple(items)
    paths = [one for one in items if isinstance(one, (str, os.PathLike))]
    if len(paths) < len(items) or not items or stream is False:
        if stream:
            raise InputError("stream=True is for files and folders; these are data in memory")
        return None
    if not (stream or clustered or streamed_unasked(paths)):
        return None
    if clustered:  # workers have other working directories
        paths = [Path(path).absolute() for path in paths]
    if t is not None and not isinstance(t, str):
        raise InputError("t names the column that is time, of a file")
    return _whole_streams(open_streams(paths, time=t))


def _whole_streams(streams: Iterable[Stream]) -> tuple[Extent, ...]:
    return tuple(Extent(one, 0, one.bounds[-1]) for one in streams)


def _whole(question: Question, extents: tuple[Extent, ...], executor: Executor, folder: Any) -> Whole:
    if question.roles.timed:
        raise NotStreamed("a term uses t, the time, which is not known from row to row of long records; use some rows")
    if question.band is not None or question.tails == "student":
        raise NotStreamed(
            "records that are read some rows at a time are fitted with tails='gauss' and in no band; use some rows"
            " (--rows), or leave these options out"
        )
    place = cache_folder() if folder is None else Path(folder)
    if folder is None:
        place = None if place is None else place / "checkpoints"
    else:
        _require_folder(Path(folder))
    kept = Checkpoints.of(extents, place, asked=folder is not None)
    return Whole(extents, executor, question.step, kept)


def _require_folder(folder: Path) -> None:
    """Make a folder for checkpoints, which somebody counts on."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(
            f"{folder}: no checkpoints can be kept there ({error.strerror or error}); name another folder"
        ) from None
