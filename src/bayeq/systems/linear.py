"""Linear oscillator, ``m*a + c*v + k*x = u``."""

from bayeq.systems.system import oscillator

__all__ = ["LINEAR"]

LINEAR = oscillator("linear", "Linear oscillator")
