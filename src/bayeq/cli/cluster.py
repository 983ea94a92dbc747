"""``--dask``: work on a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bayeq.cli.options import option

__all__ = ["cluster_client", "dask_option"]


def dask_option(text: str, **settings: Any) -> Callable[[Any], Any]:
    """The option; `text` is its help."""
    return option("--dask", metavar="ADDRESS", help=text, **settings)


@contextmanager
def cluster_client(address: str | None) -> Iterator[Any]:
    """The client of the cluster at an address; None where none is given."""
    if address is None:
        yield None
        return
    from bayeq.streaming.cluster import connected

    with connected(address) as client:
        yield client
