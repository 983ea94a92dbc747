"""What an algorithm gives on a realisation: the performance metrics of the paper's section 4.1."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.gram import Gram

__all__ = ["METRICS", "Metrics", "Result", "measure", "prediction_error"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


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


def prediction_error(test: Gram, estimate: Floats) -> float:
    """e_p = ||y* - D* theta_hat|| / ||y*||, with the test dictionary unscaled, uncentred and without intercept.

    By algebra on the test Gram: an uncentred moment is the centred one plus n times the product of the means.
    """
    squares = test.yty + test.n * test.target_mean**2
    return math.sqrt(test.squared_error(estimate, intercept=0.0) / squares)


def measure(train: Gram, test: Gram, truth: Floats, support: Bools, coef: Floats) -> Metrics:
    """All metrics of an estimate.

    Parameters
    ----------
    train, test : Gram
        Statistics of the training and of the test rows, in original units.
    truth : (P,) array
        True coefficients, not all zero.
    support : (P,) bool array
        Selected terms.
    coef : (P,) array
        Estimated coefficients in original units.

    Raises
    ------
    InputError
        No true term in the dictionary.
    """
    true = truth != 0
    if not true.any():
        raise InputError("the dictionary holds no true term: weight errors are not defined")
    scale, chosen = train.standard_deviation, int(np.count_nonzero(support))
    return Metrics(
        e_theta_scaled=_relative_error(scale * coef, scale * truth),
        e_theta=_relative_error(coef, truth),
        e_p=prediction_error(test, coef),
        fdr=int(np.count_nonzero(support & ~true)) / chosen if chosen else 0.0,
        exact=bool(np.array_equal(support, true)),
        superset=bool(np.all(support[true])),
    )


def _relative_error(estimate: Floats, truth: Floats) -> float:
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))
