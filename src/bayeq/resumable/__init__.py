"""Long work that can be resumed: results in an SQLite file, worker processes, and progress."""

from collections.abc import Callable

__all__ = ["PROGRESS", "Progress", "silent"]

#: Prefix of progress lines.
PROGRESS = "bayeq: progress: "

#: Progress callback, called with (stage, done, total).
Progress = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Progress callback that shows nothing."""
