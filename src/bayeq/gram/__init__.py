"""Sufficient statistics of a regression: of rows, of wide data, of a band of frequencies."""

from bayeq.gram.gram import Gram, GramLike, Standardised

__all__ = ["Gram", "GramLike", "Standardised"]
