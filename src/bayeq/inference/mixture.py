"""Intervals of coefficients over models: quantiles of a mixture (Hoeting, Madigan, Raftery and Volinsky 1999)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bayeq.arrays import Floats
from bayeq.kernels import kernel

# Probability below a 95 % interval, and above it.
TAIL = 0.025

# The quantiles of a mixture are looked for within this many standard deviations of every component: beyond are 1e-19.
REACH = 9.0


@kernel
def _quantiles(weight: Floats, mean: Floats, sd: Floats, probability: Floats) -> Floats:
    """Of mixtures of normal distributions, a row (K,) each, by bisection to rounding; NaN where nothing is asked.

    Weights of a row sum to 1. A component of weight 0 is none, one of sd 0 is a point.
    """
    out = np.full(len(probability), np.nan)
    for j in range(len(probability)):
        if not 0.0 < probability[j] < 1.0:
            continue
        low, high = np.inf, -np.inf
        for k in range(weight.shape[1]):
            if weight[j, k] > 0.0:
                low = min(low, mean[j, k] - REACH * sd[j, k])
                high = max(high, mean[j, k] + REACH * sd[j, k])
        while True:
            middle = 0.5 * low + 0.5 * high
            if not low < middle < high:
                break
            below = 0.0
            for k in range(weight.shape[1]):
                if weight[j, k] == 0.0:
                    continue
                away = middle - mean[j, k]
                if sd[j, k] > 0.0:
                    below += weight[j, k] * 0.5 * math.erfc(-away / sd[j, k] / math.sqrt(2.0))
                elif away >= 0.0:
                    below += weight[j, k]
            if below >= probability[j]:
                high = middle
            else:
                low = middle
        out[j] = high
    return out


@dataclass(frozen=True, slots=True)
class Mixture:
    """The posterior of each of P coefficients over models: 0, or if its term is in, a mixture of K normal ones.

    Examples
    --------
    >>> one = Mixture(*np.array([[[0.5, 0.5]], [[1.0, 3.0]], [[0.1, 0.1]]]), pip=np.array([0.9]))
    >>> one.given_in().round(2), one.overall().round(2)
    (array([[0.84, 3.16]]), array([[0.  , 3.16]]))
    """

    weight: Floats  # (P, K), probability of each model given that the term is in; rows sum to 1
    mean: Floats  # (P, K), of the coefficient given the model
    sd: Floats  # (P, K); 0 is a point
    pip: Floats  # (P,), probability that the term is in

    def given_in(self) -> Floats:
        """95 % interval of each coefficient over the models that hold its term, (P, 2)."""
        tail = np.where(self.pip > 0.0, TAIL, np.nan)
        return np.nan_to_num(np.column_stack([self._quantiles(tail), self._quantiles(1.0 - tail)]))

    def overall(self) -> Floats:
        """95 % interval of each coefficient over all models, 0 in those without its term, (P, 2)."""
        return np.column_stack([self._with_zero(TAIL), self._with_zero(1.0 - TAIL)])

    def _with_zero(self, probability: float) -> Floats:
        """Quantiles of the mixture with the probability 1 - PIP of exactly 0."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            below = self._quantiles(probability / self.pip)
            above = self._quantiles((probability - (1.0 - self.pip)) / self.pip)
        return np.where(below < 0.0, below, np.where(above > 0.0, above, 0.0))

    def _quantiles(self, probability: Floats) -> Floats:
        return _quantiles(self.weight, self.mean, self.sd, probability)
