"""How far long work is, on standard error."""

from __future__ import annotations

import sys
import time
from datetime import timedelta
from typing import Any

__all__ = ["StudyProgress"]

# Lines where there is no terminal: one in this many seconds.
LINE_EVERY = 10.0


class StudyProgress:
    """A bar with rate and time left on a terminal, elsewhere a plain line now and then.

    Parameters
    ----------
    what : str
        What is counted.
    """

    def __init__(self, what: str = "realisations") -> None:
        self.what = what
        self._bar: Any = None
        self.begin(0)

    def begin(self, done: int) -> None:
        """Count from now on, with this number done: what it took to start says nothing of the rest."""
        self.done = self.before = done
        self.started = self.last = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        self.done = done
        rate = max(done - self.before, 1) / max(time.monotonic() - self.started, 1e-9)
        if sys.stderr.isatty():
            if self._bar is None:
                self._open(total)
            self._bar.update(self._bar.task_ids[0], completed=done, total=total, rate=rate)
        elif time.monotonic() - self.last >= LINE_EVERY and done < total:
            self.last = time.monotonic()
            left = timedelta(seconds=round((total - done) / rate))
            print(f"{done} of {total} {self.what}, {rate:.3g}/s, {left} left", file=sys.stderr, flush=True)

    def _open(self, total: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

        columns = (BarColumn(), MofNCompleteColumn(), "{task.fields[rate]:.3g}/s", TimeRemainingColumn(), "left")
        self._bar = Progress("{task.description}", *columns, console=Console(stderr=True), transient=True)
        self._bar.start()
        self._bar.add_task(self.what, total=total, rate=0.0)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None
