"""``bayeq app`` in a process, for tests and pictures of the page."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

__all__ = ["running_app"]


@contextmanager
def running_app(*arguments, cwd, **environment):
    """The process of the app, and its address.

    Unless it has ended before, it is interrupted as by Ctrl-C, and has to end well and have said nothing of errors.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "bayeq", "app", "--no-browser", *map(str, arguments)],
        cwd=cwd, env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        yield process, process.stdout.readline().strip()
        if process.poll() is None:
            process.send_signal(signal.SIGINT if os.name == "posix" else signal.SIGTERM)
            _, said = process.communicate(timeout=20)
            assert (process.returncode, said) == (0, ""), f"{process.returncode}: {said}"
    finally:
        if process.poll() is None:  # after a test that has failed: it takes its child and its folder along
            process.terminate()
        process.communicate(timeout=20)
