"""The performance metrics of the paper's section 4.1."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayeq.errors import InputError
from bayeq.gram import Gram
from bayeq.study.result import Metrics

__all__ = ["measure", "prediction_error", "scaled_weight_error", "selection", "weight_error"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def weight_error(estimate: Floats, truth: Floats) -> float:
    """e_theta = ||theta_hat - theta|| / ||theta||, coefficients of the unscaled dictionary."""
    return float(np.linalg.norm(estimate - truth) / np.linalg.norm(truth))


def scaled_weight_error(estimate: Floats, truth: Floats, scale: Floats) -> float:
    """||S_D (theta_hat - theta)|| / ||S_D theta||; `scale` is the diagonal of S_D."""
    return weight_error(scale * estimate, scale * truth)


def prediction_error(test: Gram, estimate: Floats) -> float:
    """e_p = ||y* - D* theta_hat|| / ||y*||, with the test dictionary unscaled, uncentred and without intercept.

    By algebra on the test Gram: an uncentred moment is the centred one plus n times the product of the means.
    """
    squares = test.yty + test.n * test.target_mean**2
    return math.sqrt(test.squared_error(estimate, intercept=0.0) / squares)


def selection(support: Bools, truth: Bools) -> tuple[float, bool, bool]:
    """False discovery rate (0 for an empty model), exact and superset indicators."""
    chosen = int(np.count_nonzero(support))
    false = int(np.count_nonzero(support & ~truth))
    fdr = false / chosen if chosen else 0.0
    return fdr, bool(np.array_equal(support, truth)), bool(np.all(support[truth]))


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
    true_terms = truth != 0
    if not true_terms.any():
        raise InputError("the dictionary holds no true term: weight errors are not defined")
    fdr, exact, superset = selection(support, true_terms)
    return Metrics(
        e_theta_scaled=scaled_weight_error(coef, truth, train.standard_deviation),
        e_theta=weight_error(coef, truth),
        e_p=prediction_error(test, coef),
        fdr=fdr,
        exact=exact,
        superset=superset,
    )
