"""Likelihood of records by a state-space model: states follow the equations, each with a random discrepancy."""
