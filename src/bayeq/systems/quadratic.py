"""Oscillator with quadratic viscous damping, ``m*a + c*v + k*x + c2*v*abs(v) = u``."""

from bayeq.systems.system import oscillator

QUADRATIC = oscillator(
    "quadratic",
    "Oscillator with quadratic viscous damping",
    restoring="c2*v*abs(v)",
    terms={"v*abs(v)": "-c2/m"},
    parameters={"c2": 2.0},
)
