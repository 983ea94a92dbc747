"""Figures: answers and plain arrays in, matplotlib figures and axes out.

style    the look of all figures, and how they are written
picture  what all pictures of an answer have in common

Pictures of an answer are called as ``bayeq.figures.pip_bars(eq)`` or ``bayeq.figures.free_run(eq, record)``: they take
the equations, a record, and axes to draw on, and return the axes. A new one is a file and a row in `_NAMES`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# The pictures, by the file that draws them. A file has not the name of its picture, which it would hide.
_NAMES = {
    "against": "measured_against_predicted",
    "bars": "pip_bars",
    "candidates": "candidate_correlation",
    "curve": "restoring_force_curve",
    "forest": "coefficient_forest",
    "portrait": "phase_portrait",
    "response": "frequency_response",
    "run": "free_run",
    "spectral": "spectra",
    "step": "one_step",
    "surface": "restoring_force_surface",
}
_HOME = {name: f"bayeq.figures.{module}" for module, name in _NAMES.items()}

__all__ = sorted(_HOME)

if TYPE_CHECKING:  # the same names for type checkers; a test compares the two lists
    from bayeq.figures.against import measured_against_predicted as measured_against_predicted
    from bayeq.figures.bars import pip_bars as pip_bars
    from bayeq.figures.candidates import candidate_correlation as candidate_correlation
    from bayeq.figures.curve import restoring_force_curve as restoring_force_curve
    from bayeq.figures.forest import coefficient_forest as coefficient_forest
    from bayeq.figures.portrait import phase_portrait as phase_portrait
    from bayeq.figures.response import frequency_response as frequency_response
    from bayeq.figures.run import free_run as free_run
    from bayeq.figures.spectral import spectra as spectra
    from bayeq.figures.step import one_step as one_step
    from bayeq.figures.surface import restoring_force_surface as restoring_force_surface
else:

    def __getattr__(name: str) -> Any:
        """PEP 562: import the file of a picture when it is first used."""
        if name not in _HOME:
            raise AttributeError(f"module 'bayeq.figures' has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(_HOME[name]), name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
