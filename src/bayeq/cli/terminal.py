"""Standard streams, limits of memory, and the progress of long work."""

from __future__ import annotations

import os
import sys
import threading
import time as clock
from contextlib import AbstractContextManager, suppress
from io import TextIOWrapper
from typing import Any

from bayeq.errors import BayeqError, in_digits
from bayeq.resumable import PROGRESS
from bayeq.resumable.posix import address_space

# Exit code of an interrupted command, as shells count it.
INTERRUPTED = 130

# Smallest address space [MB]: a discovery that compiles its kernels takes 582 with one thread (264 in use).
LEAST = 640


def prepare_streams() -> None:
    """Make the standard streams safe to write to: every character, and streams that the caller has closed.

    Closed ones are opened on the null device, in the order of their file descriptors: otherwise the next file that is
    opened takes the place of the stream and receives what is printed. Standard output is opened for reading, so that
    a result that nobody receives is an error (`io.UnsupportedOperation`).
    """
    for name, mode in (("stdin", "r"), ("stdout", "r"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a name that the terminal's encoding lacks is no reason to fail
            stream.reconfigure(errors="backslashreplace")


def say(text: str) -> None:
    """Print a line on standard error; the work goes on if that fails."""
    with suppress(OSError):
        print(text, file=sys.stderr)


def require_address_space() -> None:
    """Raise BayeqError if the address space is limited below `LEAST`; under any limit use one thread (less memory)."""
    most = address_space()
    if most is None:
        return
    if most < LEAST:
        raise BayeqError(
            f"not enough memory: this process is limited to {most} MB of address space, and needs {LEAST} MB; raise"
            f" the limit (ulimit -v {LEAST * 1024})"
        )
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def no_memory() -> str:
    """Message for a lack of memory, which names the limit of the address space if there is one."""
    most = address_space()
    if most is None:
        return "not enough memory; use fewer samples or fewer terms"
    return (
        f"not enough memory: this process is limited to {most} MB of address space; raise the limit (ulimit -v), or use"
        " fewer samples or fewer terms"
    )


COMPILING = "compiling what runs for the first time after installation: up to a minute ..."

#: Text of stages in progress lines; other stages are printed by name.
STAGES = {
    "reading": "reading the file",
    "states": "smoothing the motion",
    "dictionary": "evaluating the candidate terms",
    "sensors": "learning lags and factors of channels",
    "likelihood": "learning path and noise of the record",
    "inference": "weighing the terms",
}

# Work that takes longer shows its progress [s].
PATIENCE = 1.0

# A stage that lasts longer is printed again after this time [s].
INTERVAL = 10.0

# From this total on the rate is printed.
MANY = 1000


class Progress(AbstractContextManager["Progress"]):
    """Progress display: called with (stage, done, total), refreshed by a thread; `verbose` prints each stage."""

    def __init__(self, verbose: bool = False) -> None:
        self.verbose = verbose
        self.stage, self.done, self.total = "", 0, 0
        self.first = 0  # `done` at the start of the stage, above 0 if a run is resumed
        self.began = self.said = clock.monotonic()
        self.named = ""  # the stage that was named last
        self.bar: Any = None
        self.stop = threading.Event()
        self.lock = threading.Lock()
        self.watch: threading.Thread | None = None

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
                self.bar.update(self.bar.task_ids[0], description=self._described(), completed=done, total=total)

    def close(self) -> None:
        """Remove the progress bar, and print nothing until the next call."""
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
            say(f"bayeq: {self.stage}: {in_digits(clock.monotonic() - self.began)} s")

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
                from rich.console import Console
                from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
                from rich.progress import Progress as Bar

                columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
                self.bar = Bar(*columns, console=Console(stderr=True), transient=True)
                self.bar.start()
                self.bar.add_task(self._described(), completed=self.done, total=self.total)
        elif self.stage != self.named or now - self.said >= INTERVAL:
            if self.stage == self.named or not self.verbose:  # verbose: printed at its start
                done, spent, left = self.done - self.first, now - self.began, ""
                if self.total > 1 and done > 0 and spent > 0.0:
                    rate = f"{done / spent:,.0f} a second, " if self.total >= MANY else ""
                    left = f" ({rate}{(self.total - self.done) * spent / done:.0f} s left)"
                since = f", {spent:.0f} s" if spent >= 1.0 else ""
                say(f"{PROGRESS}{self._described()}{left}{since}")
            self.said, self.named = now, self.stage

    def _described(self) -> str:
        count = f", {self.done:,} of {self.total:,}" if self.total > 1 else ""
        return STAGES.get(self.stage, self.stage) + count


def _is_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()
