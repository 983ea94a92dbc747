"""The normal distribution."""

from __future__ import annotations

__all__ = ["Z95"]

#: Half-width of a 95 % interval, in standard deviations.
Z95 = 1.959963984540054
