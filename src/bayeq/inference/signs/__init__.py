"""Known signs of coefficients."""
