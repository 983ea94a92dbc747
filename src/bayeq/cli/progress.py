"""How far the work is, on standard error: a bar on a terminal, lines in a pipe, once it takes longer than a second."""

from __future__ import annotations

import sys
import threading
import time as clock
from typing import Any, Self

from bayeq.cli.environment import say

COMPILING = "compiling what runs for the first time after installation: up to a minute ..."

#: Lines about progress begin so.
PROGRESS = "bayeq: progress: "

#: Stages as lines about progress call them; others by their names.
STAGES = {
    "reading": "reading the file",
    "states": "smoothing the motion",
    "dictionary": "evaluating the candidate terms",
    "lags": "learning the lags of channels",
    "likelihood": "learning path and noise of the record",
    "inference": "weighing the terms",
}

# Work that takes longer shows its progress [s].
PATIENCE = 1.0

# A stage that goes on is named again after this time [s].
INTERVAL = 10.0

# Of this many the rate is said.
MANY = 1000


class Progress:
    """What is being done; call it with (stage, done, total).

    A thread watches, for a stage may take minutes without a call. With `verbose` every stage is named at once, and how
    long it took.
    """

    def __init__(self, verbose: bool = False) -> None:
        self.verbose = verbose
        self.stage, self.done, self.total = "", 0, 0
        self.first = 0  # what was done when the stage began, of a run that goes on
        self.began = self.said = clock.monotonic()
        self.named = ""  # the stage that was named last
        self.bar: Any = None
        self.task: Any = None
        self.stop = threading.Event()
        self.lock = threading.Lock()
        self.watch: threading.Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, stage: str, done: int, total: int) -> None:
        with self.lock:
            if self.watch is None:
                self.stop = threading.Event()
                self.watch = threading.Thread(target=self._watch, args=(self.stop,), daemon=True)
                self.watch.start()
            if stage != self.stage:
                self._finish()
                self.stage, self.began, self.first = stage, clock.monotonic(), done
                if self.verbose:
                    say(f"bayeq: {stage} ...")
            self.done, self.total = done, total
            if self.bar is not None:
                self.bar.update(self.task, description=self._described(), completed=done, total=total)

    def close(self) -> None:
        """Take the bar away, and be silent until the next call."""
        self.stop.set()
        if self.watch is not None:
            self.watch.join()
            self.watch = None
        with self.lock:
            self._finish()
            self.stage = self.named = ""
            if self.bar is not None:
                self.bar.stop()
                self.bar = None

    def _finish(self) -> None:
        if self.verbose and self.stage:
            say(f"bayeq: {self.stage}: {clock.monotonic() - self.began:.2g} s")

    def _watch(self, stop: threading.Event) -> None:
        pause = PATIENCE
        while not stop.wait(pause):
            pause = PATIENCE if self.verbose or not _is_terminal() else 0.1
            with self.lock:
                if not stop.is_set():
                    self._show()

    def _show(self) -> None:
        now = clock.monotonic()
        if _is_terminal() and not self.verbose:
            if self.bar is None:
                self._open_bar()
        elif self.stage != self.named or now - self.said >= INTERVAL:
            if self.stage != self.named and self.verbose:
                self.said = now  # it has been named when it began
            else:
                left = self._left(now) if self.total > 1 else ""
                spent = f", {now - self.began:.0f} s" if now - self.began >= 1.0 else ""
                say(f"{PROGRESS}{self._described()}{left}{spent}")
                self.said = now
            self.named = self.stage

    def _described(self) -> str:
        """The stage in words, and how much of it is done."""
        count = f", {self.done:,} of {self.total:,}" if self.total > 1 else ""
        return STAGES.get(self.stage, self.stage) + count

    def _left(self, now: float) -> str:
        """The rate, of rows, and the time that is left."""
        done, spent = self.done - self.first, now - self.began
        if done <= 0 or spent <= 0.0:
            return ""
        rate = f"{done / spent:,.0f} a second, " if self.total >= MANY else ""
        return f" ({rate}{(self.total - self.done) * spent / done:.0f} s left)"

    def _open_bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        self.bar = Bar(*columns, console=Console(stderr=True), transient=True)
        self.bar.start()
        self.task = self.bar.add_task(self._described(), completed=self.done, total=self.total)


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()
