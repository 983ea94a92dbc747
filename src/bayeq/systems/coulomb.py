"""Oscillator with Coulomb friction, ``m*a + c*v + k*x + cF*sign(v) = u``."""

from bayeq.systems.system import oscillator

COULOMB = oscillator(
    "coulomb",
    "Oscillator with Coulomb friction",
    restoring="cF*sign(v)",
    terms={"sign(v)": "-cF/m"},
    parameters={"cF": 1.0},
)
