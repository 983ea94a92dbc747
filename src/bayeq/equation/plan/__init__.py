"""Which excitation of a next measurement tells the most: between models that are undecided, or of coefficients."""
