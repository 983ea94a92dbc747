"""Which files a batch has, and whether one is still what it was."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from bayeq.errors import FileFormatError, InputError, as_path
from bayeq.records.formats import suffixes
from bayeq.records.formats.excel import without_sheet
from bayeq.records.stream import in_order

__all__ = ["Identity", "files_of"]


@dataclass(frozen=True, slots=True)
class Identity:
    """What a file was when it was read.

    Attributes
    ----------
    size : int
        In bytes.
    mtime : int
        Time of its last change [ns].
    sha256 : str
        Of its content.
    """

    size: int
    mtime: int
    sha256: str

    @classmethod
    def of(cls, path: Path) -> Self:
        """That of a file as it is now.

        Raises
        ------
        OSError
            It cannot be read.
        """
        with without_sheet(path)[0].open("rb") as file:
            state = os.fstat(file.fileno())
            return cls(state.st_size, state.st_mtime_ns, hashlib.file_digest(file, "sha256").hexdigest())

    def holds(self, path: Path) -> bool:
        """Whether a file is unchanged: its size and time are, or else its content is."""
        try:
            state = without_sheet(path)[0].stat()
            if state.st_size != self.size:
                return False
            return state.st_mtime_ns == self.mtime or Identity.of(path).sha256 == self.sha256
        except OSError:
            return False


def files_of(sources: Sequence[str | os.PathLike[str]]) -> tuple[Path, ...]:
    """The files, and those of each folder whose suffix is that of a known format, in the order of their numbers.

    Raises
    ------
    FileFormatError
        A folder without such files.
    InputError
        No files, or one that is named twice.
    """
    out = [path for source in sources for path in _files(as_path(source, "each of the files"))]
    if not out:
        raise InputError("no files are given: name files or folders")
    seen: set[str] = set()
    for path in out:
        place = os.path.realpath(path)
        if place in seen:
            raise InputError(f"{path}: named twice; leave one of them out")
        seen.add(place)
    return tuple(out)


def _files(path: Path) -> list[Path]:
    """A file, or those of a folder."""
    try:
        os.fsencode(path)
        if not path.is_dir():
            return [path]
    except (OSError, ValueError):
        raise InputError(f"{str(path)[:60]!r}: is no name of a file") from None
    known = suffixes()
    found = [one for one in path.iterdir() if one.is_file() and one.suffix.lower() in known]
    if not found:
        raise FileFormatError(f"{path}: the folder has no file of a known format ({', '.join(known)})")
    return sorted(found, key=in_order)
