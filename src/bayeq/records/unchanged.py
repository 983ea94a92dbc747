"""Files that must stay as they are while they are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bayeq.errors import FileFormatError

__all__ = ["FileState", "require_unchanged", "state_of", "unchanged"]

#: Size, and time of change.
FileState = tuple[int, int]


def state_of(path: Path) -> FileState | None:
    """What changes when somebody writes to a file; None where there is none, or it is a pipe or a device."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return (stat.st_size, stat.st_mtime_ns) if path.is_file() else None


def require_unchanged(path: Path, before: FileState | None) -> None:
    """Refuse a file that is not what it was.

    Raises
    ------
    FileFormatError
        It names the file.
    """
    now = state_of(path)
    if now is not None and now != before:  # one that has gone cannot be read, which is said elsewhere
        raise FileFormatError(
            f"{path}: has changed while it was read; start once more, with a copy if it is still being written"
        )


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """Refuse a file that changes within the block, also where the change is what went wrong there.

    Raises
    ------
    FileFormatError
        It names the file.
    """
    before = state_of(path)
    try:
        yield
    except (FileFormatError, OSError):
        require_unchanged(path, before)
        raise
    require_unchanged(path, before)
