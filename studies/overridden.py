"""Other values of settings for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def overridden(settings: Any, **fields: Any) -> Iterator[None]:
    """Other values of some fields of the instance that a stage reads, in studies and tests.

    Examples
    --------
    >>> from bayeq.numerics.settings import RECORDS
    >>> with overridden(RECORDS, longest_gap=0.7):
    ...     print(RECORDS.longest_gap)
    0.7
    >>> RECORDS.longest_gap
    0.5
    """
    before = {name: getattr(settings, name) for name in fields}
    try:
        for name, value in fields.items():
            object.__setattr__(settings, name, value)
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(settings, name, value)
