"""Tables of bayeq to which other packages add members, by entry points of the group ``bayeq.NAME``.

Entry points are loaded only when a name is missing in the table, so that other runs do not wait for them.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from textwrap import shorten
from typing import TypeVar

from bayeq.errors import BayeqWarning

Row = TypeVar("Row")


class Table(dict[str, Row]):
    """Members by name, all of type `kind`; `load`, or a look-up of an absent name, adds those of other packages."""

    def __init__(self, name: str, kind: type[Row], own: Mapping[str, Row]) -> None:
        super().__init__(own)
        self._group, self._kind, self._loaded = f"bayeq.{name}", kind, False

    def load(self) -> Table[Row]:
        """The table with the members of other packages; a faulty one is left out, with a warning that names it."""
        from importlib.metadata import entry_points

        for point in () if self._loaded else entry_points(group=self._group):
            try:
                if point.name in self:
                    raise ValueError("bayeq has one of this name")
                member = point.load()
                if not isinstance(member, self._kind):
                    raise TypeError(f"{point.value} is no {self._kind.__name__}")
                self[point.name] = member
            except (Exception, SystemExit) as error:  # noqa: BLE001 - a package may raise anything
                package = point.dist.name if point.dist else point.module
                why = shorten(f"{type(error).__name__}: {error}", 60, placeholder=" ...")
                warnings.warn(
                    f"{package}: {point.name!r} of {self._group} is left out: {why}; check that package",
                    BayeqWarning,
                    stacklevel=3,
                )
        self._loaded = True
        return self

    def __missing__(self, name: str) -> Row:
        if not self._loaded and name in self.load():
            return self[name]
        raise KeyError(name)
