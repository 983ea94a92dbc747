"""Compiled functions: `kernel`, and its cache on disk."""

from bayeq.kernels.lazy import Kernel, announce_compiling, kernel

__all__ = ["Kernel", "announce_compiling", "kernel"]
