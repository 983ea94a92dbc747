"""What the module of a file format offers: `read_columns` or `channels`, `write`, and some rows at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from bayeq.records.columns import Columns, Names, Request, Select
from bayeq.records.formats.nested import Channel
from bayeq.records.record import Record

#: Rows that are read at a time, where the file does not divide them itself.
UNIT_ROWS = 2**18


class Flat(Protocol):
    """The module of a format whose files are one table."""

    def read_columns(self, path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
        """Read the columns of a table that are `chosen`; the others need not be numbers.

        `names` are those of all columns, in order, instead of the file's; a string is split at commas and white space.
        Raises a FileFormatError if the file is not what it should be, of text with the line and the column, and a
        MissingExtraError if the package that reads it is not installed.
        """


class Nested(Protocol):
    """The module of a format whose files hold many arrays, named by their paths."""

    def channels(self, path: Path) -> list[Channel]:
        """List the arrays of a file; errors are those of `Flat`."""


class Writer(Protocol):
    """The module of a format that can be written."""

    def write(self, record: Record, path: Path) -> None:
        """Write a record, replacing the file, so that reading gives the same arrays bit by bit."""


@dataclass(frozen=True)
class FileRows:
    """The rows of a file, of which some are read at a time; small, and can be sent to other processes.

    `request` says which arrays they are, where the file holds many.
    """

    path: Path
    request: Request = field(default_factory=Request)

    @property
    def bounds(self) -> Sequence[int]:
        """First rows of the units that are best read together, from 0, and the number of rows at the end."""
        raise NotImplementedError

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop` of the columns asked for; a FileFormatError if the file is damaged or has changed."""
        raise NotImplementedError


def grid(rows: int, unit: int = UNIT_ROWS) -> tuple[int, ...]:
    """Bounds of units of equal length.

    Examples
    --------
    >>> grid(10, 4)
    (0, 4, 8, 10)
    """
    return (*range(0, rows, unit), rows)


def parts_between(bounds: Sequence[int], start: int, stop: int) -> list[int]:
    """The parts that hold rows `start` to `stop`.

    Examples
    --------
    >>> parts_between((0, 4, 8, 10), 3, 8)
    [0, 1]
    """
    return [k for k, (a, b) in enumerate(pairwise(bounds)) if a < stop and b > start]
