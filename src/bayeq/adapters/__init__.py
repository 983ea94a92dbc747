"""Bridges to other packages, each an optional extra."""
