"""Rows of a NumPy array on disk, mapped into memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.errors import FileFormatError
from bayeq.records.columns import Columns, Headers
from bayeq.records.formats.limits import reading
from bayeq.records.formats.npy import columns_of
from bayeq.records.request import Request
from bayeq.records.stream.rows import grid

__all__ = ["NpyRows"]


@dataclass(frozen=True)
class NpyRows:
    """A NumPy array."""

    path: Path

    def _columns(self) -> tuple[list[str], list[np.ndarray[Any, Any]]]:
        """Headers and columns, of which nothing is read yet."""
        where = str(self.path)
        with reading(where, ".npy file"):
            array = np.lib.format.open_memmap(self.path, mode="r")
        return columns_of(array, where)

    @cached_property
    def bounds(self) -> tuple[int, ...]:
        """Units of equal length."""
        return grid(len(self._columns()[1][0]))

    def read(self, start: int, stop: int, request: Request) -> Columns:
        """Rows `start` to `stop`."""
        texts, columns = self._columns()
        if len(columns[0]) != self.bounds[-1]:
            raise FileFormatError(f"{self.path}: has changed while it was read; start once more")
        headers = Headers.parse(texts, str(self.path))
        values: Callable[[int], Any] = lambda i: np.array(columns[i][start:stop])  # noqa: E731
        return Columns.build(headers, values, request.rows)
