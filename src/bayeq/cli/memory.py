"""Memory that the process is limited to, as by ``ulimit -v``.

Libraries in C end the process where they get none, with words of their own, and those that cannot be loaded raise
errors about files: a limit below what any command needs is refused before they are loaded.
"""

from __future__ import annotations

import os

from bayeq.errors import BayeqError

__all__ = ["address_space", "no_memory", "require_address_space"]

# What a discovery takes that compiles its kernels, with one thread: 582 MB, of which 264 MB are in use.
LEAST = 640


def address_space() -> int | None:
    """Most address space that this process may have [MB]; None without a limit, or where the system has none."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft // 2**20


def require_address_space() -> None:
    """Refuse a limit that no command can work with; under others one thread, for each takes its share.

    Raises
    ------
    BayeqError
        It says how much there is and how much is needed.
    """
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
