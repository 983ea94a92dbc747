"""``connected``: the client of a Dask cluster, by an address that a user types."""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from bayeq.errors import InputError, MissingExtraError

__all__ = ["connected"]

# How long an address may take to answer [s].
ANSWER = 5.0


@contextmanager
def connected(address: str) -> Iterator[Any]:
    """The client of a cluster.

    Parameters
    ----------
    address : str
        Of its scheduler, tcp://host:8786, or the file that it wrote (``dask scheduler --scheduler-file``).

    Raises
    ------
    InputError
        Nobody answers.
    MissingExtraError
        Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "dask", "work on a cluster") from None
    found = _in_file(address)
    try:
        _require_answer(found)
        client = Client(found, timeout=ANSWER)
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[:1] or [type(error).__name__]
        raise InputError(
            f"{address}: no Dask scheduler answers ({reason[0]}); start one, `dask scheduler`, and give the address"
            " that it prints, such as tcp://host:8786"
        ) from None
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client", "distributed.core")]
    levels = [one.level for one in loggers]
    for one in loggers:  # what goes wrong is said in one line, see `bayeq.streaming.cluster`
        one.setLevel(logging.CRITICAL)
    try:
        yield client
    finally:
        client.close()
        for one, level in zip(loggers, levels, strict=True):
            one.setLevel(level)


def _in_file(address: str) -> str:
    """The address in a scheduler's file, or the address itself."""
    path = Path(address)
    if "://" in address or not (path.is_file() or path.suffix == ".json"):
        return address
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["address"]
    except FileNotFoundError:
        raise InputError(
            f"{address}: no such file; it is written by `dask scheduler --scheduler-file {address}`"
        ) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(
            f"{address}: holds no address of a scheduler; give the file that `dask scheduler --scheduler-file` wrote"
        ) from None
    return str(found)


def _require_answer(address: str) -> None:
    """Refuse an address where nobody is, or somebody else: a client would wait for them."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme not in ("tcp", "tls", "ws", "wss") or not parts.hostname or parts.port is None:
        raise ValueError("it is no address of one")
    with socket.create_connection((parts.hostname, parts.port), timeout=ANSWER) as connection:
        if parts.scheme == "tcp" and not connection.recv(1):  # where a scheduler speaks first
            raise OSError("somebody else is there")
