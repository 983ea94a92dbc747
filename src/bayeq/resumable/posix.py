"""What needs POSIX, and what is done on other systems: no other file asks which system it runs on."""

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
    """Most address space that this process may have [MB]; None without a limit, or where the system has none."""
    if not POSIX:
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft // 2**20


def has_ended(process: int) -> bool:
    """Whether no process of this machine has this number; False elsewhere, where `os.kill` would end it."""
    try:
        if POSIX:
            os.kill(process, 0)
    except (ProcessLookupError, OverflowError):  # a number that no process can have
        return True
    except PermissionError:  # of another user
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
    """Call this at a signal of POSIX: SIGHUP when the terminal is closed, SIGALRM when the time of `alarm` has come."""
    if POSIX:
        signal.signal(signal.Signals[name], handler)


def alarm(seconds: float) -> bool:
    """Set the alarm, or with 0 switch it off; returns whether there is one."""
    if POSIX:
        signal.setitimer(signal.ITIMER_REAL, seconds)
    return POSIX


@contextmanager
def interrupts_later() -> Iterator[None]:
    """Interrupts wait until the end, and processes that are started meanwhile get none."""
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
