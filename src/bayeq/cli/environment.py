"""What the process is given: standard streams, which may be closed, and memory, which may be limited (``ulimit -v``).

Libraries in C end the process where they get no memory, with words of their own, and those that cannot be loaded raise
errors about files: a limit below what any command needs is refused before they are loaded.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from io import TextIOWrapper

from bayeq.errors import BayeqError
from bayeq.posix import address_space

# Exit code of an interrupted command, as shells count it.
INTERRUPTED = 130

# What a discovery takes that compiles its kernels, with one thread: 582 MB, of which 264 MB are in use.
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
