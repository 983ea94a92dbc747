"""Known systems, as data, and their simulation.

A new system is one file that makes a `System`, and a row in the table here, or an entry point ``bayeq.systems`` of
another package; the conformance tests do the rest.
"""

from __future__ import annotations

from bayeq.errors import UnknownNameError
from bayeq.plugins import Table
from bayeq.systems.cart_pole import CART_POLE
from bayeq.systems.coulomb import COULOMB
from bayeq.systems.double_pendulum import DOUBLE_PENDULUM
from bayeq.systems.duffing import DUFFING
from bayeq.systems.linear import LINEAR
from bayeq.systems.lorenz import LORENZ
from bayeq.systems.quadratic import QUADRATIC
from bayeq.systems.simulate import simulate
from bayeq.systems.system import BandLimitedForce, System
from bayeq.systems.vanderpol import VANDERPOL

__all__ = ["SYSTEMS", "BandLimitedForce", "System", "get_system", "simulate"]

_OWN = (LINEAR, DUFFING, QUADRATIC, COULOMB, LORENZ, VANDERPOL, CART_POLE, DOUBLE_PENDULUM)
SYSTEMS = Table("systems", System, {system.name: system for system in _OWN})


def get_system(name: str) -> System:
    """The known system of this name.

    Raises
    ------
    UnknownNameError
        If there is none.

    Examples
    --------
    >>> get_system("lorenz").title
    'Lorenz 63'
    """
    if name not in SYSTEMS and name not in SYSTEMS.load():
        raise UnknownNameError("system", name, SYSTEMS)
    return SYSTEMS[name]
