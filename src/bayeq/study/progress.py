"""How far long work is, on standard error."""

from __future__ import annotations

import sys
import time
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
        self.started = self.last = time.monotonic()
        self.done = self.before = self.total = 0
        self._bar: Any = None
        self._task: Any = None

    def begin(self, done: int) -> None:
        """Count from now on, with this number done: what it took to start says nothing of the rest."""
        self.done = self.before = done
        self.started = self.last = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        self.done, self.total = done, total
        if sys.stderr.isatty():
            self._draw()
        elif time.monotonic() - self.last >= LINE_EVERY and done < total:
            self.last = time.monotonic()
            left = (total - done) / self.rate
            print(f"{done} of {total} {self.what}, {self.rate:.3g}/s, {_clock(left)} left", file=sys.stderr, flush=True)

    @property
    def rate(self) -> float:
        """How many per second so far."""
        return max(self.done - self.before, 1) / max(time.monotonic() - self.started, 1e-9)

    def _draw(self) -> None:
        if self._bar is None:
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn(self.what),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]:.3g}/s"),
                TimeRemainingColumn(),
                TextColumn("left"),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("realisations", total=self.total, rate=0.0)
        self._bar.update(self._task, completed=self.done, rate=self.rate)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            self._bar.stop()
            self._bar = None


def _clock(seconds: float) -> str:
    """Hours, minutes and seconds.

    Examples
    --------
    >>> _clock(75.2), _clock(3725)
    ('1:15', '1:02:05')
    """
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
