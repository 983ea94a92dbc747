"""Checkpoints: intermediate sums over rows in files, from which a killed run is resumed.

A file holds the number of units done and the sum over them, as a NumPy archive of plain arrays: nothing in it is code.
"""

from __future__ import annotations

import hashlib
import json
import os
import time as clock
import warnings
import zipfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, is_dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayeq.discovery.streaming.work import Extent, Folded, Lagged, OfRows
from bayeq.errors import BayeqWarning
from bayeq.inference.gram import Moments
from bayeq.likelihood.block import Block
from bayeq.likelihood.fit import Quadratic
from bayeq.records.io import replacing
from bayeq.records.stream import FileStream

# Shortest time between two writes of a sum [s].
EVERY = 10.0

# Version of the summed quantities: sums of another version are not resumed.
SUMS = 3

# Types that a file may contain.
KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (OfRows, Folded, Moments, Block, Quadratic, Lagged)}


def cache_folder() -> Path | None:
    """The user's folder for checkpoints; None without a home directory."""
    try:
        given = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    except RuntimeError:
        return None
    return Path(given) / "bayeq" / "checkpoints"


@dataclass(eq=False)
class Checkpoint:
    """Checkpoint of one sum."""

    path: Path
    every: bool = False  # whether the last sum, or that of a run that is stopped, is kept however short the run was
    failed: Callable[[OSError], None] = lambda error: None  # called with the error if it cannot be written
    saved: float = field(default_factory=clock.monotonic)  # time of the last write

    def load(self) -> tuple[int, Any]:
        """The number of units done, and their sum; (0, None) without a file, or if it is damaged."""
        try:
            with self.path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                about = json.loads(bytes(file["about"]).decode())
                return int(about["done"]), _rebuilt(about["sum"], file)
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return 0, None

    def save(self, done: int, total: Any, last: bool) -> None:
        """Write a sum if `EVERY` has passed, or the last one of a long run; if that fails, the earlier file stays."""
        now = clock.monotonic()
        if now - self.saved < EVERY and not (last and (self.every or self.path.exists())):
            return
        arrays: dict[str, Any] = {}
        about = {"done": done, "sum": _taken_apart(total, arrays)}
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with replacing(self.path) as part, part.open("wb") as file:
                np.savez(file, about=np.frombuffer(json.dumps(about).encode(), dtype=np.uint8), **arrays)
        except OSError as error:  # the run goes on without
            self.failed(error)
        self.saved = now


@dataclass(eq=False)
class Checkpoints:
    """The checkpoints of one run."""

    folder: Path | None  # where they are kept; None keeps nothing
    about: str = ""  # identifies the run: version, files, their sizes and times of change, rows
    asked: bool = False  # whether the user named the folder: then the first sum that cannot be kept gives a warning
    used: list[Checkpoint] = field(default_factory=list)
    warned: bool = False

    @classmethod
    def of(cls, extents: Sequence[Extent], folder: Path | None, asked: bool = False) -> Checkpoints:
        """Checkpoints for rows of files; those for records in memory write nothing."""
        about = []
        for one in extents:
            path = getattr(one.stream.rows, "path", None) if isinstance(one.stream, FileStream) else None
            if not isinstance(path, Path):
                return cls(None)
            stat = path.stat()
            about.append((str(path.resolve()), stat.st_size, stat.st_mtime_ns, one.start, one.stop, repr(one.stream)))
        return cls(folder, repr((version("bayeq"), SUMS, about)), asked)

    def of_stage(self, stage: str, about: object) -> Checkpoint | None:
        """Checkpoint of the sum of a stage, identified by `about`; None without a folder."""
        if self.folder is None:
            return None
        key = hashlib.sha256(f"{self.about}|{stage}|{about!r}".encode()).hexdigest()[:32]
        found = Checkpoint(self.folder / f"{key}.npz", every=self.asked, failed=self._warn)
        self.used.append(found)
        return found

    def _warn(self, error: OSError) -> None:
        """Warn, once and only if the user named the folder, that sums cannot be written."""
        if self.asked and not self.warned:
            self.warned = True
            warnings.warn(
                f"{error.filename or self.folder}: {error.strerror or error}: sums are not kept, the run goes on"
                " without; make room or give another folder",
                BayeqWarning,
                stacklevel=2,
            )

    @property
    def kept(self) -> Path | None:
        """The folder, if a sum of this run is in it."""
        return self.folder if any(one.path.is_file() for one in self.used) else None

    def clear(self) -> None:
        """Remove the checkpoints of a completed run."""
        for one in self.used:
            with suppress(OSError):
                one.path.unlink(missing_ok=True)
        self.used.clear()


def _taken_apart(value: Any, arrays: dict[str, Any]) -> Any:
    """A sum as JSON data, with its arrays moved to `arrays`."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {one.name: _taken_apart(getattr(value, one.name), arrays) for one in fields(value)}
        return {"kind": type(value).__name__, "parts": parts}
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    return value.item() if isinstance(value, np.generic) else value


def _rebuilt(node: Any, arrays: Any) -> Any:
    if node is None or isinstance(node, (int, float)):
        return node
    if "kind" in node:
        return KINDS[node["kind"]](**{name: _rebuilt(part, arrays) for name, part in node["parts"].items()})
    return arrays[node["array"]]
