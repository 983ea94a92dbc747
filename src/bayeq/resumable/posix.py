"""Functions that need POSIX, with replacements on other systems; no other module checks the system."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # it takes time to load
    from asyncio.subprocess import Process

POSIX = os.name == "posix"

#: The signal that ends a process at once.
KILL = signal.SIGKILL if POSIX else signal.SIGTERM


def address_space() -> int | None:
    """Limit of the address space of this process [MB]; None without a limit, and on systems without POSIX."""
    if not POSIX:
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft // 2**20


def has_ended(process: int) -> bool:
    """Whether no process of this machine has this id; False without POSIX, where `os.kill` would end it."""
    try:
        if POSIX:
            os.kill(process, 0)
    except (ProcessLookupError, OverflowError):  # a number that no process can have
        return True
    except PermissionError:  # it runs, but belongs to another user
        pass
    return False


def is_of_this_user(path: Path) -> bool:
    """Whether a file belongs to this user; False where files have no such owner."""
    return POSIX and path.lstat().st_uid == os.getuid()


def signal_group(process: Process, number: signal.Signals) -> None:
    """Send a signal to a process that leads a group, and to all of the group; elsewhere end the process."""
    if POSIX:
        os.killpg(process.pid, number)
    else:
        process.terminate()


def on_signal(name: str, handler: Callable[..., Any]) -> None:
    """Install the handler of a POSIX signal: SIGHUP (the terminal is closed), SIGALRM (the time of `alarm` is over)."""
    if POSIX:
        signal.signal(signal.Signals[name], handler)


def alarm(seconds: float) -> bool:
    """Send SIGALRM after this time, or with 0 cancel it; returns whether the system has alarms (POSIX)."""
    if POSIX:
        signal.setitimer(signal.ITIMER_REAL, seconds)
    return POSIX


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Hold Ctrl-C back until the end (without POSIX, ignore it); processes started meanwhile inherit this."""
    if POSIX:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN) if main else None
    try:
        yield
    finally:
        if main:
            signal.signal(signal.SIGINT, handler)
