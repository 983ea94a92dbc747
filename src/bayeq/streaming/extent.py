"""``Extent``: the rows of a stream that are used; units of work; and stretches that are looked at first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bayeq.records import Record, counts_rows, with_row_numbers
from bayeq.records.stream import Stream, units_between
from bayeq.states.motion import cut_at

__all__ = ["Extent", "Unit", "of_channels", "stretches", "units_of"]

#: Stretches that are looked at first, and rows of each.
STRETCHES, ROWS_EACH = 20, 5000


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
    """The units of some extents, in order; where rows take long in parts of at most some number."""
    whole = [
        Unit(k, a, b) for k, one in enumerate(extents) for a, b in units_between(one.stream.bounds, one.start, one.stop)
    ]
    if most is None:
        return whole
    out = []
    for unit in whole:
        bounds = np.linspace(unit.start, unit.stop, -(-unit.n // most) + 1).round().astype(int).tolist()
        out += [Unit(unit.extent, a, b) for a, b in pairwise(bounds)]
    return out


def of_channels(extents: Sequence[Extent], channels: Sequence[str]) -> tuple[Extent, ...]:
    """The same rows of these channels, and of time; of all channels where none is named."""
    if not channels:
        return tuple(extents)
    return tuple(replace(one, stream=one.stream.of(list(channels))) for one in extents)


def _named(record: Record, first: int) -> Record:
    """A stretch under a name that says which rows it is."""
    return Record(
        record.channels, record.time, record.units, f"{record.name}, rows {first + 1:,} to {first + record.n:,}"
    )


def stretches(extents: Sequence[Extent]) -> list[Record]:
    """Stretches spread evenly over some extents, all rows of short ones."""
    total = sum(one.n for one in extents)
    out: list[Record] = []
    for one in extents:
        count = max(1, round(STRETCHES * one.n / total))
        length = min(ROWS_EACH, one.n) if total > STRETCHES * ROWS_EACH else one.n
        count = count if length < one.n else 1
        firsts = np.linspace(one.start, one.stop - length, count).round().astype(int).tolist()
        out.extend(
            _named(one.read(first, first + length), first) if length < one.n else one.read(first, one.stop)
            for first in firsts
        )
    return out
