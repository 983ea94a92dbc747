"""Linear oscillator, ``m*a + c*v + k*x = u``."""

from bayeq.systems.system import oscillator

LINEAR = oscillator("linear", "Linear oscillator")
