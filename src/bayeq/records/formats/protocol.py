"""Interfaces of the modules of file formats, and limits on what a damaged or hostile file may claim."""

from __future__ import annotations

import json
import math
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Protocol

from bayeq.errors import FULL, BayeqError, FileFormatError
from bayeq.records.columns import Columns, Names, Request, Select
from bayeq.records.formats.nested import Channel
from bayeq.records.record import Record

#: Rows of a chunk, if the file does not divide them itself.
UNIT_ROWS = 2**18


class Flat(Protocol):
    """The module of a format whose files are one table."""

    def read_columns(self, path: Path, *, names: Names = None, chosen: Select | None = None) -> Columns:
        """Read the columns of a table that are `chosen`; the others need not be numbers.

        `names` replace those in the file, for all columns in order; a string is split at commas and white space.
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
    """A file that is read in chunks of rows, also in other processes; `request` selects from several arrays."""

    path: Path
    request: Request = field(default_factory=Request)

    @property
    def bounds(self) -> Sequence[int]:
        """First rows of the chunks that are best read together, from 0, and the number of rows at the end."""
        raise NotImplementedError

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop` of the columns asked for; a FileFormatError if the file is damaged or has changed."""
        raise NotImplementedError


def grid(rows: int, unit: int = UNIT_ROWS) -> tuple[int, ...]:
    """Bounds of chunks of `unit` rows; the last may be shorter.

    >>> grid(10, 4)
    (0, 4, 8, 10)
    """
    return (*range(0, rows, unit), rows)


def parts_between(bounds: Sequence[int], start: int, stop: int) -> list[int]:
    """Indices of the chunks that hold rows `start` to `stop`.

    >>> parts_between((0, 4, 8, 10), 3, 8)
    [0, 1]
    """
    return [k for k, (a, b) in enumerate(pairwise(bounds)) if a < stop and b > start]


#: A file may unpack to this many times its size ...
MOST_RATIO = 100
#: ... or to this many bytes, whichever is more,
SMALL_BYTES = 64 * 2**20
#: and never to more than this.
MOST_BYTES = 4 * 2**30
#: Maximum number of columns of a table: the width of an Excel sheet.
MOST_COLUMNS = 16_384


def check_claim(where: str, what: str, claimed: int, stored: int) -> None:
    """Raise a FileFormatError for more than 4 GiB, or more than 64 MiB and 100 times the file's size (in bytes)."""
    if claimed > MOST_BYTES:
        raise FileFormatError(f"{where}: {what} takes {in_words(claimed)}; at most {in_words(MOST_BYTES)} are read")
    if claimed > max(SMALL_BYTES, MOST_RATIO * stored):
        raise FileFormatError(
            f"{where}: {what} claims {in_words(claimed)} in a file of {in_words(stored)}; more than {MOST_RATIO} times"
            " the file's size is not read: the file is damaged, or unpack it yourself first"
        )


def check_array(where: str, what: str, shape: Sequence[int], itemsize: int, stored: int) -> None:
    """Raise a FileFormatError for an array whose shape claims far more than the file holds."""
    if any(length < 0 for length in shape):
        raise FileFormatError(f"{where}: {what} has the shape {tuple(shape)}; the file is damaged")
    # as float64, which every channel becomes
    check_claim(where, what, math.prod(int(length) for length in shape) * max(itemsize, 8), stored)


def in_words(size: int) -> str:
    """A number of bytes as text.

    >>> in_words(2_400_000_000), in_words(2048)
    ('2.24 GiB', '2 KiB')
    """
    for unit, factor in (("GiB", 2**30), ("MiB", 2**20), ("KiB", 2**10)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"


def stored_units(text: str | bytes) -> dict[str, str]:
    """Units by name that bayeq wrote into a file as JSON; empty for other JSON."""
    found = json.loads(text)
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}


@contextmanager
def reading(where: str, kind: str) -> Iterator[None]:
    """Turn whatever a library raises on a damaged file into a FileFormatError with the first line of its message.

    The library's warnings are suppressed in the main thread only: all threads share the warning filters, and two that
    change and restore them at the same time may leave warnings of bayeq suppressed.
    """
    try:
        if threading.current_thread() is threading.main_thread():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield
        else:
            yield
    except (BayeqError, FileNotFoundError, PermissionError, IsADirectoryError):
        raise
    except MemoryError:
        raise FileFormatError(f"{where}: not a readable {kind} (it claims more than there is memory)") from None
    except Exception as error:  # third-party parsers raise anything on damaged bytes
        if isinstance(error, OSError) and error.errno in FULL:  # a full disk is no fault of the file
            raise
        lines = [line for line in str(error).splitlines() if line.strip()]
        text = "".join(c for c in lines[0] if c.isprintable())[:120] if lines else ""
        reason = f"{type(error).__name__}: {text}" if text else type(error).__name__
        raise FileFormatError(f"{where}: not a readable {kind} ({reason})") from None
