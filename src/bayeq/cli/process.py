"""The command as a process, in which Ctrl-C prints one line at any moment; `bayeq.cli.app.main` sets no handler."""

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

    During an import the interrupt is delayed, because libraries take an interrupted import for a missing package. It is
    delayed too while a kernel is compiled or loaded: LLVM calls back into Python, ignores that a callback was
    interrupted, and makes a kernel that crashes. In other callbacks from C, where Python cannot raise, it is repeated.
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
        """Signal handler: of Ctrl-C, and of the alarm that repeats a delayed interrupt."""
        self.arrived = True
        if _has_to_end(frame) and alarm(PAUSE):
            return
        raise KeyboardInterrupt

    def not_raised(self, error: sys.UnraisableHookArgs) -> None:
        """Hook for exceptions that Python cannot raise: an interrupt is repeated later, others are reported."""
        if not issubclass(error.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(error)
        else:
            alarm(PAUSE)

    def finish(self) -> None:
        """Restore the default handler: from here on Ctrl-C ends the process silently."""
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
        # Libraries wrap an interrupt in their own exception, or fail as a consequence of it.
        if not interrupts.arrived and not isinstance(error, KeyboardInterrupt):
            raise
        say("bayeq: interrupted")
        return INTERRUPTED
    finally:
        interrupts.finish()
