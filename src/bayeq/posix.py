"""What needs POSIX, and what is done on other systems: no other file asks which system it runs on."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = [
    "KILLED",
    "address_space",
    "alarm",
    "has_ended",
    "interrupts_later",
    "of_this_user",
    "on_alarm",
    "reuse_address",
    "signal_group",
]

POSIX = os.name == "posix"

#: The signal of a process that is ended at once.
KILLED = signal.SIGKILL if POSIX else signal.SIGTERM


def address_space() -> int | None:
    """Most address space that this process may have [MB]; None without a limit, or where the system has none."""
    if not POSIX:
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft // 2**20
