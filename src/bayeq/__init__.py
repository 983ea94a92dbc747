"""bayeq: Bayesian equation discovery.

Measured motion in, the governing equation out, with a posterior inclusion probability and an interval on every
term. Public names are loaded where they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

# The public names, by the module that defines them.
_NAMES = {
    "batches.result": "Batch BatchFile",
    "batches.run": "batch",
    "discovery": "discover",
    "equation.equation": "Equation",
    "equation.equations": "Equations",
    "equation.load": "load",
    "equation.quantities": "PhysicalParameters",
    "equation.sensitivity": "PriorSensitivity",
    "equation.schema": "json_schema",
    "equation.size_path": "ParsimonyPath",
    "estimators.regressors": "RVM STLSQ SpikeSlabBMA SpikeSlabGibbs SpikeSlabVB",
    "forecast.score": "Scores",
    "equation.refine.refine": "Refinement",
    "forecast.free_run": "Forecast",
    "inference.gram": "Gram",
    "inference.posterior": "Posterior",
    "inspection.contents": "RecordInfo",
    "inspection.info": "info",
    "inference.prior": "Prior",
    "equation.plan.result": "Plan",
    "records": "Finding Record Truth check_record correct_delay join read remove_offset write",
    "systems": "SYSTEMS System simulate",
}
_HOME = {name: f"bayeq.{module}" for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOME)

if TYPE_CHECKING:  # the same names for type checkers; a test compares the two lists
    # isort: off
    from bayeq.batches.result import Batch as Batch, BatchFile as BatchFile
    from bayeq.batches.run import batch as batch
    from bayeq.discovery import discover as discover
    from bayeq.equation.equation import Equation as Equation
    from bayeq.equation.equations import Equations as Equations
    from bayeq.equation.load import load as load
    from bayeq.equation.quantities import PhysicalParameters as PhysicalParameters
    from bayeq.equation.sensitivity import PriorSensitivity as PriorSensitivity
    from bayeq.equation.schema import json_schema as json_schema
    from bayeq.equation.size_path import ParsimonyPath as ParsimonyPath
    from bayeq.estimators.regressors import RVM as RVM, STLSQ as STLSQ, SpikeSlabBMA as SpikeSlabBMA
    from bayeq.estimators.regressors import SpikeSlabGibbs as SpikeSlabGibbs, SpikeSlabVB as SpikeSlabVB
    from bayeq.forecast.score import Scores as Scores
    from bayeq.equation.refine.refine import Refinement as Refinement
    from bayeq.forecast.free_run import Forecast as Forecast
    from bayeq.inference.gram import Gram as Gram
    from bayeq.inference.posterior import Posterior as Posterior
    from bayeq.inference.prior import Prior as Prior
    from bayeq.inspection.contents import RecordInfo as RecordInfo
    from bayeq.inspection.info import info as info
    from bayeq.equation.plan.result import Plan as Plan
    from bayeq.records import Finding as Finding, Record as Record, Truth as Truth, check_record as check_record
    from bayeq.records import correct_delay as correct_delay, join as join, read as read
    from bayeq.records import remove_offset as remove_offset
    from bayeq.records import write as write
    from bayeq.systems import SYSTEMS as SYSTEMS, System as System, simulate as simulate
    # isort: on

    from bayeq import errors as errors
    from bayeq import figures as figures

    __version__: str
else:  # hidden from type checkers, which would take every misspelt name for a public one

    def __getattr__(name: str) -> Any:
        """PEP 562: import the module of a public name when the name is first used."""
        if name in _HOME:
            value = getattr(import_module(_HOME[name]), name)
        elif name == "__version__":
            from importlib.metadata import version

            value = version("bayeq")
        elif name in ("errors", "figures"):  # modules: bayeq.errors.InputError, bayeq.figures.free_run(eq, record)
            return import_module(f"bayeq.{name}")
        else:
            raise AttributeError(f"module 'bayeq' has no attribute {name!r}")
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__", "errors", "figures"})
