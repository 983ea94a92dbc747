"""Numerical methods: minimisation within bounds, cubic splines, Runge-Kutta steps, distributions; and the settings."""
