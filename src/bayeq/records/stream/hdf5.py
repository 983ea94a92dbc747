"""Rows of the arrays of an HDF5 file that have one length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns
from bayeq.records.formats import hdf5
from bayeq.records.formats.nested import Channel, read_pieces
from bayeq.records.request import Request
from bayeq.records.stream.rows import grid

__all__ = ["Hdf5Rows"]


@dataclass(frozen=True)
class Hdf5Rows:
    """An HDF5 file: the arrays that `bayeq.read` takes for the same request."""

    path: Path
    request: Request = field(default_factory=Request)

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        """Units of equal length."""
        lengths = [replace(one, values=_length(one)) for one in hdf5.channels(self.path)]
        pieces = read_pieces(lengths, str(self.path), self.request)
        if len(pieces) > 1:
            raise FileFormatError(f"{self.path}: [*] stands for several records; name one of them to stream it")
        return grid(int(pieces[0][1].values[0][0]))

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop`."""
        ((_, data),) = read_pieces(hdf5.channels(self.path), str(self.path), request, rows=slice(start, stop))
        if len(data.values[0]) != stop - start:
            raise FileFormatError(f"{self.path}: has changed while it was read; start once more")
        return data


def _length(channel: Channel) -> Callable[[slice], Any]:
    return lambda rows: np.array([channel.size])
