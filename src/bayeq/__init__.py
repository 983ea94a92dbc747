"""bayeq: Bayesian equation discovery.

Measured motion in, the governing equation out, with a posterior inclusion probability and an interval on every
term. Public names are loaded where they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from bayeq.discovery import discover
    from bayeq.equation.equation import Equation
    from bayeq.equation.equations import Equations
    from bayeq.equation.load import load
    from bayeq.equation.physical import PhysicalParameters
    from bayeq.equation.pip_curve import PriorSensitivity
    from bayeq.equation.size_path import ParsimonyPath
    from bayeq.estimators.regressors import RVM, STLSQ, SpikeSlabBMA, SpikeSlabGibbs, SpikeSlabVB
    from bayeq.forecast.results import Refinement, Scores
    from bayeq.forecast.run import Forecast
    from bayeq.gram import Gram
    from bayeq.inference.posterior import Posterior
    from bayeq.inference.prior import Prior
    from bayeq.records import Finding, Record, Truth, check_record, correct_delay, read, remove_offset, write
    from bayeq.systems import SYSTEMS, System, simulate

_HOME = {
    "RVM": "estimators.regressors",
    "STLSQ": "estimators.regressors",
    "SYSTEMS": "systems",
    "Equation": "equation.equation",
    "Equations": "equation.equations",
    "Finding": "records",
    "Forecast": "forecast.run",
    "Gram": "gram",
    "ParsimonyPath": "equation.size_path",
    "PhysicalParameters": "equation.physical",
    "Posterior": "inference.posterior",
    "Prior": "inference.prior",
    "PriorSensitivity": "equation.pip_curve",
    "Record": "records",
    "Refinement": "forecast.results",
    "Scores": "forecast.results",
    "SpikeSlabBMA": "estimators.regressors",
    "SpikeSlabGibbs": "estimators.regressors",
    "SpikeSlabVB": "estimators.regressors",
    "System": "systems",
    "Truth": "records",
    "check_record": "records",
    "correct_delay": "records",
    "discover": "discovery",
    "load": "equation.load",
    "read": "records",
    "remove_offset": "records",
    "simulate": "systems",
    "write": "records",
}

__all__ = [
    "RVM",
    "STLSQ",
    "SYSTEMS",
    "Equation",
    "Equations",
    "Finding",
    "Forecast",
    "Gram",
    "ParsimonyPath",
    "PhysicalParameters",
    "Posterior",
    "Prior",
    "PriorSensitivity",
    "Record",
    "Refinement",
    "Scores",
    "SpikeSlabBMA",
    "SpikeSlabGibbs",
    "SpikeSlabVB",
    "System",
    "Truth",
    "check_record",
    "correct_delay",
    "discover",
    "load",
    "read",
    "remove_offset",
    "simulate",
    "write",
]


def __getattr__(name: str) -> Any:
    """PEP 562: import the module of a public name when the name is first used."""
    if name in _HOME:
        value = getattr(import_module(f"bayeq.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'bayeq' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
