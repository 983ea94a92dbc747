"""The command as a process: Ctrl-C at any moment is one line; streams may be closed, and memory limited.

`bayeq.cli.app.main` may be called by other programs, whose handling of signals is theirs; `run` is the process.
Libraries in C end the process where they get no memory (``ulimit -v``), with words of their own, and those that cannot
be loaded raise errors about files: a limit below what any command needs is refused before they are loaded.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from io import TextIOWrapper
from types import FrameType

from bayeq.errors import BayeqError
from bayeq.posix import address_space, alarm, on_signal

# Exit code of an interrupted command, as shells count it.
INTERRUPTED = 130

# What a discovery takes that compiles its kernels, with one thread: 582 MB, of which 264 MB are in use.
LEAST = 640

# Frames of an import have this file name.
IMPORTING = "<frozen importlib._bootstrap>"

# Frames of the packages that compile and load kernels.
COMPILERS = ("numba", "llvmlite")

# An interrupt that has to wait is tried again after this time [s].
PAUSE = 0.02


def prepare_streams() -> None:
    """Make the standard streams safe to write to: every character, and streams that the caller has closed.

    Closed ones are opened on the null device, in the order of their file descriptors: otherwise the next file that is
    opened takes the place of the stream and receives what is printed. Standard output is opened for reading, so that
    a result that nobody receives is an error (`io.UnsupportedOperation`).
    """
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # a name that the terminal's encoding lacks is no reason to fail
            stream.reconfigure(errors="backslashreplace")


def say(text: str) -> None:
    """Print a line on standard error, if it can be written to: the work goes on without."""
    with suppress(OSError):
        print(text, file=sys.stderr)


def require_address_space() -> None:
    """Refuse a limit that no command can work with (BayeqError); under others use one thread: each takes its share."""
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
    """What to say where memory has run out."""
    most = address_space()
    if most is None:
        return "not enough memory; use fewer samples or fewer terms"
    return (
        f"not enough memory: this process is limited to {most} MB of address space; raise the limit (ulimit -v), or use"
        " fewer samples or fewer terms"
    )


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
