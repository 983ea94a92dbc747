"""Standard streams that are closed or cannot be written to."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from io import TextIOWrapper

__all__ = ["INTERRUPTED", "prepare_streams", "say"]

# Exit code of an interrupted command, as shells count it.
INTERRUPTED = 130


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
