"""Known signs and bounds of coefficients."""
