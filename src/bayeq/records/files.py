"""Files that are written whole or not at all, and files that must stay as they are while they are read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bayeq.errors import FileFormatError

#: Size, and time of change.
FileState = tuple[int, int]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to; what is written there takes the place of `path` at the end, if nothing went wrong.

    An interrupted write leaves what was there before. What is not a regular file (a pipe, a device) is written
    directly. An OSError that names `path` says that the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> target = Path(tempfile.mkdtemp()) / "a.txt"
    >>> with replacing(target) as part:
    ...     _ = part.write_text("all of it")
    >>> target.read_text()
    'all of it'
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve() if path.is_symlink() else path
    part = target.with_name(f".{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield part
        os.replace(part, target)
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):  # where nothing can be written, nothing can be removed: that is reported already
            part.unlink()


def state_of(path: Path) -> FileState | None:
    """What changes when somebody writes to a file; None where there is none, or it is a pipe or a device."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return (stat.st_size, stat.st_mtime_ns) if path.is_file() else None


def require_unchanged(path: Path, before: FileState | None) -> None:
    """Refuse a file that is not what it was, naming it."""
    now = state_of(path)
    if now is not None and now != before:  # one that has gone cannot be read, which is said elsewhere
        raise FileFormatError(
            f"{path}: has changed while it was read; start once more, with a copy if it is still being written"
        )


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """Refuse a file that changes within the block, also where the change is what went wrong there."""
    before = state_of(path)
    try:
        yield
    except (FileFormatError, OSError):
        require_unchanged(path, before)
        raise
    require_unchanged(path, before)
