"""Ordinary differential equations: one integrator and its derivatives."""
