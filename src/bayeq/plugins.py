"""Members that other packages add to a table of bayeq, by entry points of the group ``bayeq.NAME``.

Packages are looked for when a name is asked for that the table lacks, so that nobody else waits for them.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TypeVar

from bayeq.errors import BayeqWarning

__all__ = ["Table"]

Row = TypeVar("Row")

# What is shown of the error of a faulty package.
SHOWN = 60


class Table(dict[str, Row]):
    """Members by name; `load` adds those of other packages, and so does asking for a name that is not there.

    Parameters
    ----------
    name : str
        Of the table, as in its group of entry points: "engines", "families", "formats" or "systems".
    kind : type
        What every member is.
    own : mapping
        The members that bayeq brings.
    """

    def __init__(self, name: str, kind: type[Row], own: Mapping[str, Row]) -> None:
        super().__init__(own)
        self._name, self._kind, self._loaded = name, kind, False

    def load(self) -> Table[Row]:
        """The table with the members of other packages; a faulty one is left out, with a warning that names it."""
        if not self._loaded:
            from importlib.metadata import entry_points

            self._loaded = True
            for point in entry_points(group=f"bayeq.{self._name}"):
                fault = "bayeq has one of this name" if point.name in self else ""
                try:
                    member = None if fault else point.load()
                    if not fault and not isinstance(member, self._kind):
                        fault = f"{point.value} is no {self._kind.__name__}"
                except (Exception, SystemExit) as error:  # noqa: BLE001 - a package may raise anything
                    fault = f"{type(error).__name__}: {' '.join(str(error).split())}"
                if not fault:
                    self[point.name] = member  # type: ignore[assignment]  # the kind was checked
                    continue
                package = point.dist.name if point.dist else point.module
                what = f"{package}: {point.name!r} of bayeq.{self._name} is left out"
                short = fault if len(fault) <= SHOWN else f"{fault[: SHOWN - 3]}..."
                warnings.warn(f"{what}: {short}", BayeqWarning, stacklevel=3)
        return self

    def __missing__(self, name: str) -> Row:
        if not self._loaded and name in self.load():
            return self[name]
        raise KeyError(name)
