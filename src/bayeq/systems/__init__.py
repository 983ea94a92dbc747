"""Known systems, as data, and their simulation.

A new system is a `System` in `bayeq.systems.known`, or an entry point ``bayeq.systems`` of another package; the
conformance tests do the rest.
"""

from __future__ import annotations

from bayeq.errors import UnknownNameError
from bayeq.plugins import Table
from bayeq.systems.known import KNOWN
from bayeq.systems.simulate import simulate
from bayeq.systems.system import BandLimitedForce, System

__all__ = ["SYSTEMS", "BandLimitedForce", "System", "get_system", "simulate"]

SYSTEMS = Table("systems", System, {system.name: system for system in KNOWN})


def get_system(name: str) -> System:
    """The known system of this name; UnknownNameError if there is none.

    >>> get_system("lorenz").title
    'Lorenz 63'
    """
    if name not in SYSTEMS and name not in SYSTEMS.load():
        raise UnknownNameError("system", name, SYSTEMS)
    return SYSTEMS[name]
