"""Commands of bayeq in processes of their own, and places that cannot be written."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bayeq.cli.terminal import COMPILING, PROGRESS
from tests.uncovered import uncovered

__all__ = ["QUICK", "bayeq", "environment", "heeding", "mounted", "remarks", "start"]

#: A discovery of a second.
QUICK = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, u", "--smooth", "none"]


def environment(**changes):
    """That of this process with some changes; None takes a variable away."""
    merged = {**uncovered(), "OPENBLAS_NUM_THREADS": "1", **changes}
    return {name: str(value) for name, value in merged.items() if value is not None}


def heeding(before=None):
    """What a process does first: interrupts count, also where these tests were started in the background."""

    def first():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if before is not None:
            before()

    return first


def start(*arguments, cwd, before=None, **changes):
    """A command that runs."""
    return subprocess.Popen(
        [sys.executable, "-m", "bayeq", *map(str, arguments)], cwd=cwd, env=environment(**changes), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, preexec_fn=heeding(before),
    )  # fmt: skip


def bayeq(*arguments, cwd, before=None, **changes):
    """Exit code, standard output, and what is said on standard error beside progress and warnings, line by line."""
    process = start(*arguments, cwd=cwd, before=before, **changes)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, remarks(err)


def remarks(err):
    """Lines on standard error that are neither about progress nor about the data."""
    others = (COMPILING, PROGRESS, "bayeq: warning: ")
    return [line for line in err.splitlines() if not line.startswith(others)]


@contextmanager
def mounted(folder, options) -> Iterator[None]:
    """A file system in memory on a folder; for root, whom no permission holds back, the way to one that is full."""
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if sys.platform != "linux" or os.geteuid() or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount")
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
