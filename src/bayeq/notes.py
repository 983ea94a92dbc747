"""Warnings collected on the way: given at the end, and kept in the answer."""

from __future__ import annotations

from bayeq.errors import BayeqWarning

__all__ = ["Notes"]


class Notes:
    """Messages and their categories, in order."""

    def __init__(self) -> None:
        self.collected: list[tuple[str, type[BayeqWarning]]] = []

    def warn(self, message: str, category: type[BayeqWarning]) -> None:
        """Add one."""
        self.collected.append((message, category))
