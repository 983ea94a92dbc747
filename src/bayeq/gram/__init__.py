"""Sufficient statistics of a regression: of rows, of wide data."""

from bayeq.gram.gram import Gram, GramLike, Standardised

__all__ = ["Gram", "GramLike", "Standardised"]
