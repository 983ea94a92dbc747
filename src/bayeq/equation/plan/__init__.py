"""Plans the excitation of the next measurement, to discriminate between models or to learn the coefficients."""
