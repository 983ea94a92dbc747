"""Selects the terms that an equation shows; posterior inclusion probabilities stay as they are."""
