"""How good an answer is, where the truth is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

import bayeq as bq
from bayeq.inference.collapsed.path import model_log_posterior
from bayeq.inference.collapsed.problem import Problem
from perf.problems import Data, Fitted

__all__ = ["Accuracy", "assess", "evidence_over", "together"]

# Beyond so many terms an answer is dense, and its evidence is left out: it costs their cube.
DENSE = 1000


@dataclass(frozen=True, slots=True)
class Accuracy:
    """An answer against the truth.

    Attributes
    ----------
    exact : float
        1 if exactly the true terms are selected; over several problems their share.
    false, missed : float
        Selected terms that are not true, and true ones that are not selected.
    error : float
        Euclidean distance of the coefficients from the true ones relative to these, each times the standard deviation
        of its column.
    evidence : float
        ln p(y, z) of the selected terms less that of the true ones [nats]; nan for a dense answer.
    """

    exact: float
    false: float
    missed: float
    error: float
    evidence: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """From the values in the order of the attributes."""
        return cls(*map(float, values))


def evidence_over(data: Data, chosen: NDArray[np.bool_], other: NDArray[np.bool_], prior: bq.Prior) -> float:
    """ln p(y, z) of one set of terms less that of another, eq. (34) and the prior of z [nats].

    Terms that are in neither cancel, so that only the columns of the two are looked at.
    """
    union = np.flatnonzero(chosen | other)
    if len(union) > DENSE:
        return math.nan
    if not len(union):
        return 0.0
    problem = Problem.of(bq.Gram.from_data(data.D[:, union], data.y).standardise().gram, prior)
    return float(model_log_posterior(problem, chosen[union]) - model_log_posterior(problem, other[union]))


def assess(data: Data, fitted: Fitted, prior_inclusion: float) -> Accuracy:
    """Compare an answer with the truth."""
    chosen, true = np.asarray(fitted.support, dtype=np.bool_), data.true
    scale = data.D.std(axis=0)
    off = float(np.linalg.norm(scale * (fitted.coef - data.coef)) / np.linalg.norm(scale * data.coef))
    return Accuracy(
        exact=float(np.array_equal(chosen, true)),
        false=float(np.count_nonzero(chosen & ~true)),
        missed=float(np.count_nonzero(true & ~chosen)),
        error=off,
        evidence=evidence_over(data, chosen, true, bq.Prior(prior_inclusion=prior_inclusion)),
    )


def together(answers: Sequence[Accuracy]) -> Accuracy:
    """Several problems of a kind: means of the counts, medians of the rest."""
    columns = np.array([[a.exact, a.false, a.missed, a.error, a.evidence] for a in answers])
    return Accuracy.of([*columns[:, :3].mean(axis=0), *np.median(columns[:, 3:], axis=0)])
