"""Numerical methods of their own: minimisation within bounds, cubic splines, Runge-Kutta steps."""
