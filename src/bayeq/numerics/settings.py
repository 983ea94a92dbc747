"""Constants that may decide an answer: a stage's are the fields of one frozen dataclass, its `settings.py`.

docs/rules.md is written from them (`python -m studies.rules`), and `python -m studies.sensitivity` moves each.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field
from typing import Any, TypeVar

T = TypeVar("T")


def setting(default: T, about: str, rests_on: str = "choice", unit: str = "", cliff: bool = False) -> T:
    """A field of a settings class.

    Parameters
    ----------
    default : number
        The value that is used.
    about : str
        What it decides, and why it is what it is.
    rests_on : str
        Tables of docs/tables and tests, in backquotes, or words that docs/rules.md explains; joined by semicolons.
    unit : str
        A share, a probability or a count where it is empty.
    cliff : bool
        Whether the answer may jump at the value.
    """
    metadata = {"about": about, "rests_on": rests_on, "unit": unit, "cliff": cliff}
    made: T = field(default=default, metadata=metadata)
    return made


@contextmanager
def overridden(settings: Any, **fields: Any) -> Iterator[None]:
    """Other values for a while, in studies and tests.

    Parameters
    ----------
    settings : object
        The instance that a stage reads.
    **fields
        New values, by the names of the fields.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class SpringSettings:
    ...     longest: float = setting(2.0, "Springs do not stretch further.", unit="m")
    >>> spring = SpringSettings()
    >>> with overridden(spring, longest=3.0):
    ...     print(spring.longest)
    3.0
    >>> spring.longest
    2.0
    """
    before = {name: getattr(settings, name) for name in fields}
    try:
        for name, value in fields.items():
            object.__setattr__(settings, name, value)
        yield
    finally:
        for name, value in before.items():
            object.__setattr__(settings, name, value)
