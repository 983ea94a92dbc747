"""`RecordRegression`: the regression that the likelihood of the records makes of one equation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary.ranges import ConstantEstimate, Forms
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.adequacy import Discrepancy, Octave
from bayeq.likelihood.projection import projected
from bayeq.likelihood.record_fit import RecordFit
from bayeq.numerics.normal import Shape
from bayeq.regression.design import Design
from bayeq.regression.regression import Regression, judged_by

# Degrees of freedom of an interval, at least, by Satterthwaite: of few batches a variance is hardly known.
LEAST_FREEDOM = 3.0


def regressions_of(design: Design, record: RecordFit | None) -> list[Regression]:
    """One regression per equation: of the likelihood of the records, or of their rows where there is none."""
    chains = range(len(design.motion.roles.chains))
    if record is None:
        return [Regression.of(design, k) for k in chains]
    return [RecordRegression(design, k, *judged_by(design, k), record.standards[k].source, record) for k in chains]


@dataclass(frozen=True, eq=False)
class RecordRegression(Regression):
    """The regression of one target by the likelihood of the records.

    Attributes
    ----------
    record : RecordFit
        The likelihood.
    power : float
        That `gram` is raised to.
    """

    record: RecordFit
    power: float = 1.0

    counts_rows: ClassVar[bool] = False

    @property
    def exact(self) -> float:
        """As of `Regression`."""
        return self.record.nearly.exact[self.k]

    @property
    def tau(self) -> float:
        """As of `Regression`."""
        return self.record.nearly.tau[self.k]

    @property
    def constants(self) -> tuple[ConstantEstimate, ...]:
        """As of `Regression`."""
        return self.record.constants(self.k, self.power)

    @property
    def forms(self) -> Forms:
        """As of `Regression`."""
        return self.record.forms

    @property
    def discrepancy(self) -> float | None:
        """As of `Regression`."""
        return float(self.record.kappa[self.k])

    @property
    def through_motion(self) -> bool:
        """As of `Regression`: of a target that is not measured."""
        return self.chain.measured[-1] is None

    def tests(self) -> tuple[Discrepancy | None, Octave | None]:
        """As of `Regression`."""
        adequacy = self.record.adequacy
        channels = [name for name in self.chain.measured if name is not None]
        return adequacy.lacks(self.k), adequacy.coloured(channels)

    @property
    def shape(self) -> Shape | None:
        """As of `Regression`."""
        shapes = [self.record.adequacy.shapes[name] for name in self.chain.measured if name is not None]
        return min(shapes, key=lambda one: one.normality) if shapes else None

    def hides_noise(self, name: str) -> bool:
        """As of `Regression`."""
        return name not in self.record.inputs_of_known_noise

    def thinned(self) -> Regression:
        """The same: samples count by their noise."""
        return self

    def raised(self, power: float) -> Regression:
        """The regression with the likelihood raised to a power of at most 1."""
        return replace(self, gram=self.gram.raised(power), power=self.power * power)

    def reported(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """As of `Regression`: of the terms that the record was fitted with by projection."""
        found = replace(found, target_mean_variance=found.noise_variance / found.n)
        block = self.record.block(self.k)
        model = self.record.fitted.model[block]
        if self.record.task.flows is not None and bool((model[:-1] == found.support).all()):
            theta, both = self.record.balanced
            own = np.flatnonzero(model) + block.start
            found = _with_constant(found, theta[own], both[np.ix_(own, own)])
        elif self.power == 1.0 and self.record.projectable(self.k, found.support):
            found = self._projected(found, basis, limits, free)
        return replace(found, noise_variance=self.noise_variance(found))

    def _projected(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """The posterior by projection (`bayeq.likelihood.projection`).

        What is not `free`, coefficients with limits, stays as it is but for the discrepancy, as far as limits allow.
        """
        kept, left = found.support, self.record.leftover(self.k)
        (theta, covariance), r = self.record.own_coefficients(self.k), int(kept.sum())
        with_constant = len(theta) > r
        whole = np.zeros((len(theta), basis.shape[1] + with_constant))
        whole[:r, : basis.shape[1]] = basis
        whole[r:, basis.shape[1] :] = 1.0
        if not free or basis.shape[1] < r:
            carried = found.covariance @ found.center[kept]
            whole_covariance = np.block(
                [[found.covariance, -carried[:, None]], [-carried[None], np.array([[found.intercept_sd**2]])]]
            )
            theta = np.append(found.coef[kept], found.intercept)[: len(theta)]
            covariance = whole_covariance[: len(theta), : len(theta)]
        moved = projected(left, whole)
        change = moved.change
        if limits is not None:
            low, high = np.vstack([limits[kept], np.tile([-np.inf, np.inf], (int(with_constant), 1))]).T
            change = np.where(theta + change < low, low - theta, change)
            change = np.where(theta + change > high, high - theta, change)
        both = covariance + moved.covariance
        added, total = np.diagonal(moved.covariance), np.diagonal(both)
        # Satterthwaite, of a part that is known and one that is estimated
        freedom = moved.freedom * (total / np.maximum(added, 1e-9 * total + np.finfo(float).tiny)) ** 2
        own, sd = np.zeros((2, len(kept)))
        own[kept], sd[kept] = theta[:r], np.sqrt(np.diagonal(covariance))[:r]
        every = np.full(len(kept), np.inf)
        every[kept] = np.maximum(freedom[:r], LEAST_FREEDOM)
        found = replace(
            found,
            freedom=every,
            likelihood_coef=own,
            likelihood_sd=sd,
            error_share=moved.share,
            error_sd=moved.share * math.sqrt(left.target),
            error_lines=left.lines,
        )
        return _with_constant(found, theta + change, both)


def _with_constant(found: Posterior, theta: Floats, both: Floats) -> Posterior:
    """A posterior with coefficients of this covariance, the constant last if it is in the model."""
    kept, r, total = found.support, int(found.support.sum()), np.diagonal(both)
    coef, center = np.zeros((2, len(kept)))
    coef[kept] = theta[:r]
    found = replace(found, coef=coef, covariance=both[:r, :r])
    if len(theta) == r:
        return found
    # about the centre the constant and the other coefficients are independent
    if r:
        unit = np.sqrt(np.where(total[:r] > 0.0, total[:r], 1.0))  # coefficients that are given have no variance
        center[kept] = -np.linalg.lstsq(both[:r, :r] / np.outer(unit, unit), both[:r, r] / unit)[0] / unit
    mean = float(theta[r] + center @ found.coef)
    variance = max(float(both[r, r] - center[kept] @ both[:r, :r] @ center[kept]), 0.0)
    return replace(found, center=center, target_mean=mean, target_mean_variance=variance)
