"""What one algorithm gave on one realisation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

__all__ = ["METRICS", "Metrics", "Result"]


@dataclass(frozen=True, slots=True)
class Metrics:
    """The errors of section 4.1.

    Attributes
    ----------
    e_theta_scaled : float
        ||S_D (theta_hat - theta)|| / ||S_D theta||, S_D the standard deviations of the training columns.
    e_theta : float
        ||theta_hat - theta|| / ||theta||.
    e_p : float
        ||y* - D* theta_hat|| / ||y*|| on the test rows.
    fdr : float
        False terms among the selected ones; 0 if none is selected.
    exact : bool
        Exactly the true terms are selected.
    superset : bool
        All true terms are selected.
    """

    e_theta_scaled: float
    e_theta: float
    e_p: float
    fdr: float
    exact: bool
    superset: bool

    @property
    def finite(self) -> bool:
        """Whether all of them are finite."""
        return all(math.isfinite(getattr(self, name)) for name in METRICS)


METRICS = tuple(f.name for f in fields(Metrics))


@dataclass(frozen=True, slots=True)
class Result:
    """A row of the store.

    Attributes
    ----------
    system, index, algorithm
        Which realisation, and what ran on it.
    metrics : Metrics or None
        None if it failed.
    seconds : float or None
        Wall time of the algorithm alone, from the Gram to the estimate.
    selected : tuple of str
        The selected terms.
    converged : bool or None
        What the algorithm says of itself.
    extras : mapping
        What else it says, as plain numbers.
    failure : str or None
        Type and message of the exception.
    """

    system: str
    index: int
    algorithm: str
    metrics: Metrics | None = None
    seconds: float | None = None
    selected: tuple[str, ...] = ()
    converged: bool | None = None
    extras: Mapping[str, Any] = field(default_factory=dict)
    failure: str | None = None
