"""The command as a process, in which Ctrl-C at any moment is one line; `bayeq.cli.app.main` leaves signals alone."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

from bayeq.cli.terminal import INTERRUPTED, say
from bayeq.resumable.posix import alarm, on_signal

# Frames of an import have this file name.
IMPORTING = "<frozen importlib._bootstrap>"

# Frames of the packages that compile and load kernels.
COMPILERS = ("numba", "llvmlite")

# An interrupt that has to wait is tried again after this time [s].
PAUSE = 0.02


class _Interrupts:
    """Turns the signal of Ctrl-C into `KeyboardInterrupt`, where that does no harm.

    Within an import it waits for its end: libraries take an interrupted import for one that is missing. So it does
    while a kernel is compiled or loaded: LLVM calls back into Python, goes on where a callback was interrupted, and the
    kernel that it then has crashes. Where Python can raise nothing, in other callbacks from C, it is tried again.
    """

    def __init__(self) -> None:
        self.arrived = False

    def install(self) -> None:
        """Take the place of Python's own handlers; a process that was started to ignore Ctrl-C goes on ignoring it."""
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            return
        signal.signal(signal.SIGINT, self.interrupt)
        on_signal("SIGALRM", self.interrupt)
        sys.unraisablehook = self.not_raised

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """What runs when the signal arrives, or when it is tried again."""
        self.arrived = True
        if _has_to_end(frame) and alarm(PAUSE):
            return
        raise KeyboardInterrupt

    def not_raised(self, error: sys.UnraisableHookArgs) -> None:
        """What Python calls with an exception that it can raise nowhere."""
        if not issubclass(error.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(error)
        else:
            alarm(PAUSE)

    def finish(self) -> None:
        """From here on Ctrl-C ends the process without a word."""
        if signal.getsignal(signal.SIGINT) == self.interrupt:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        alarm(0.0)


def _has_to_end(frame: FrameType | None) -> bool:
    """Whether an import or a compilation is under way."""
    compilers = tuple(
        os.path.dirname(file) + os.sep
        for name in COMPILERS
        if (file := getattr(sys.modules.get(name), "__file__", None))
    )
    while frame is not None:
        if frame.f_code.co_filename == IMPORTING or frame.f_code.co_filename.startswith(compilers):
            return True
        frame = frame.f_back
    return False


def run() -> int:
    """Run the command of this process; returns the exit code."""
    interrupts = _Interrupts()
    try:
        interrupts.install()
        from bayeq.cli.app import main

        return main()
    except BaseException as error:
        # Libraries wrap an interrupt, or fail of what it left behind.
        if not interrupts.arrived and not isinstance(error, KeyboardInterrupt):
            raise
        say("bayeq: interrupted")
        return INTERRUPTED
    finally:
        interrupts.finish()
