"""`discover`: from records to equations of motion."""

from bayeq.discovery.entry import discover

__all__ = ["discover"]
