"""Numerical methods of their own: minimisation within bounds, cubic splines, one integrator of differential equations."""
