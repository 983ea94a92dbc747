"""Equations for other programs: functions of NumPy and JAX, source text of several languages, LaTeX."""
