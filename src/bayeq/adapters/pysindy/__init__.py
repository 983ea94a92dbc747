"""PySINDy: an optimizer, a method of differentiation, and its feature libraries as dictionaries of `discover`.

``from bayeq.adapters.pysindy import KinematicDerivative, SpikeSlabOptimizer``; both need the extra ``pysindy``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bayeq.errors import needing

if TYPE_CHECKING:
    from bayeq.adapters.pysindy.parts import KinematicDerivative, SpikeSlabOptimizer

__all__ = ["KinematicDerivative", "SpikeSlabOptimizer"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with needing("PySINDy", "pysindy", name):
        import_module("pysindy")
    return getattr(import_module(f"{__name__}.parts"), name)
