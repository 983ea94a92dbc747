"""How many examples hypothesis draws for a test that names a number."""

from __future__ import annotations

from hypothesis import settings

__all__ = ["draws"]


def draws(full: int) -> int:
    """The share of them that the profile of `conftest.py` asks for."""
    return max(3, round(full * settings().max_examples / 100))
