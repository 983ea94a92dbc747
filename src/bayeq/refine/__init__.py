"""Output error: coefficients whose free runs are closest to the measured channels."""
