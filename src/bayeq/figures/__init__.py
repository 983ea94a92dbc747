"""Figures: answers and plain arrays in, matplotlib figures and axes out.

style      style and writing of all figures, and functions that all pictures of an answer share
runs       free runs, one step, phase portrait
terms      probabilities, coefficients, correlation of terms; coefficients over many files
forces     restoring forces
frequency  spectra, frequency response

Pictures of an answer are called as ``bayeq.figures.pip_bars(eq)`` or ``bayeq.figures.free_run(eq, record)``: they take
the equations, a record, and axes to draw on, and return the axes. A new one is a function under `style.picture`, named
here. matplotlib is loaded when one is drawn.
"""

from __future__ import annotations

from bayeq.figures.forces import restoring_force_curve, restoring_force_surface
from bayeq.figures.frequency import frequency_response, spectra
from bayeq.figures.runs import free_run, measured_against_predicted, one_step, phase_portrait
from bayeq.figures.terms import candidate_correlation, coefficient_forest, pip_bars

__all__ = [
    "candidate_correlation",
    "coefficient_forest",
    "free_run",
    "frequency_response",
    "measured_against_predicted",
    "one_step",
    "phase_portrait",
    "pip_bars",
    "restoring_force_curve",
    "restoring_force_surface",
    "spectra",
]
