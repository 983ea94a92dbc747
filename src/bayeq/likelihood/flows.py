"""Conserved sums of states: terms are flows between two of them, with opposite coefficients in two equations.

A fit has a coefficient in each equation, whose sums are tied to zero (`Stated`); models are selected from flows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.inference.posterior import ModelAverage, Posterior
from bayeq.likelihood.layout import Stated

# A sum of coefficients is zero to this share of the prior's standard deviation of its first one, in fits: what is
# selected, and the coefficients that are reported, are of flows and balance exactly.
TIED = 1e-4


@dataclass(frozen=True, eq=False)
class Flows:
    """Flows, term by term of every pair of the states of a sum, and the coefficients of other equations.

    Attributes
    ----------
    weights : mapping of int to float
        Factor of each state in the sum, by the number of its equation.
    chains, width : int
        C equations of P + 1 candidates, the constant among them.
    """

    weights: Mapping[int, float]
    chains: int
    width: int

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Equations that flows lead from and to."""
        return list(itertools.combinations(sorted(self.weights), 2))

    @cached_property
    def matrix(self) -> Floats:
        """What each of M flows adds to every coefficient, (C (P + 1), M)."""
        columns = np.zeros((self.chains, len(self.pairs)))
        for k, (a, b) in enumerate(self.pairs):
            columns[a, k], columns[b, k] = -1.0 / self.weights[a], 1.0 / self.weights[b]
        others = np.delete(np.eye(self.chains), sorted(self.weights), axis=1)
        return np.asarray(np.kron(np.hstack([columns, others]), np.eye(self.width)), dtype=np.float64)

    def ties(self, precision: Floats) -> tuple[Stated, ...]:
        """The weighted sums of the coefficients of each term, and of the constants, are zero."""
        own, first = precision.reshape(self.chains, self.width), min(self.weights)
        sd = TIED * abs(self.weights[first]) / np.sqrt(own[first])
        return tuple(
            Stated(tuple((c, j, w) for c, w in self.weights.items()), 0.0, float(sd[j])) for j in range(self.width)
        )

    def wide(self, model: Bools) -> Bools:
        """The coefficients (C (P + 1),) of flows (M,)."""
        out: Bools = self.matrix.astype(np.bool_) @ model
        return out

    def narrow(self, model: Bools) -> Bools:
        """Flows (M,) that the coefficients of a model can be made of; one alone is of none."""
        inside = model.reshape(self.chains, self.width)
        out = np.zeros((len(self.pairs), self.width), dtype=np.bool_)
        for j in range(self.width):
            for pair in itertools.pairwise(c for c in sorted(self.weights) if inside[c, j]):
                out[self.pairs.index(pair), j] = True
        return np.append(out.ravel(), np.delete(inside, sorted(self.weights), axis=0).ravel())

    def precision(self, precision: Floats) -> Floats:
        """1/variance of the prior of each flow, (M,), from that of the coefficients."""
        return np.asarray((self.matrix**2).T @ precision)

    def log_odds(self, log_odds: Floats) -> Floats:
        """Of each flow, (M,): the smallest of its coefficients."""
        return np.where(self.matrix.T != 0.0, log_odds, np.inf).min(axis=1)

    def log_share(self, stated: tuple[Stated, ...], precision: Floats, model: Bools) -> float:
        """ln of the share of the prior of a model's coefficients that ties leave."""
        out = 0.0
        for parts, _, sd in stated:
            inside = [(c * self.width + j, w) for c, j, w in parts if model[c * self.width + j]]
            if inside:
                out -= 0.5 * math.log1p(sum(w**2 / precision[k] for k, w in inside) / sd**2)
        return out

    def paired(self, found: Posterior, precision: Floats) -> Posterior:
        """A posterior of flows as one of coefficients, both in units of their priors."""
        average = found.average
        assert average is not None
        assert found.averaged_coef is not None
        units = self.matrix * np.sqrt(precision)[:, None] / np.sqrt(self.precision(precision))
        models, which = np.unique(average.models @ self.matrix.T.astype(np.bool_), axis=0, return_inverse=True)
        probability: Floats = np.bincount(which.ravel(), weights=average.probability).astype(np.float64)
        order = np.argsort(-probability, kind="stable")
        models, probability = models[order], probability[order]
        pip = np.minimum(probability @ models, 1.0)
        support = pip > 0.5
        if not (self.wide(self.narrow(support)) == support).all():
            support = models[0]
        terms = np.flatnonzero(models.any(axis=0))
        spread = units[:, average.terms] @ average.covariance @ units[:, average.terms].T
        coef = units @ found.averaged_coef
        return replace(
            found,
            names=tuple(map(str, range(len(pip)))),
            pip=pip,
            support=support,
            coef=np.where(support, coef, 0.0),
            covariance=spread[np.ix_(support, support)],
            center=np.zeros(len(pip)),
            averaged_coef=coef,
            averaged_sd=np.sqrt(np.maximum(np.diagonal(spread), 0.0)),
            average=ModelAverage(models, probability, average.left_out, terms, spread[np.ix_(terms, terms)]),
        )
