"""Duffing oscillator, ``m*a + c*v + k*x + k3*x**3 = u``."""

from bayeq.systems.system import oscillator

DUFFING = oscillator(
    "duffing",
    "Duffing oscillator (cubic stiffness)",
    restoring="k3*x**3",
    terms={"x**3": "-k3/m"},
    parameters={"k3": 1e5},
)
