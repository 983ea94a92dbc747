"""`RecordRegression`: the regression that the likelihood of the records makes of one equation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import ConstantEstimate, Forms
from bayeq.expressions import Expression
from bayeq.inference.posterior import Posterior, Projected
from bayeq.likelihood.adequacy import Change, Discrepancy, Octave
from bayeq.likelihood.fit import solved
from bayeq.likelihood.gains import Suspect
from bayeq.likelihood.projection import projected
from bayeq.likelihood.record_fit import RecordFit
from bayeq.numerics.distributions import Shape
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.design import Design
from bayeq.regression.regression import Regression, judged_by
from bayeq.states.kinematic.fit import lowest_level
from bayeq.states.sensors import scaled_with

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
    """The regression of one target by the likelihood of the records."""

    record: RecordFit  # the likelihood
    power: float = 1.0  # that `gram` is raised to

    counts_rows: ClassVar[bool] = False

    @property
    def exact(self) -> float:
        return self.record.nearly.exact[self.k]

    @property
    def factors(self) -> tuple[tuple[str, ...], Floats]:
        """As of `Regression`: other channels of a chain tell of them."""
        found = self.record.calibration
        return tuple(found.gains), found.covariance

    @property
    def suspect(self) -> Suspect | None:
        return self.record.adequacy.suspect([*filter(None, self.chain.measured), *self.motion.roles.inputs])

    @property
    def tau(self) -> float:
        return self.record.nearly.tau[self.k]

    @property
    def constants(self) -> tuple[ConstantEstimate, ...]:
        return self.record.constants(self.k, self.power)

    @property
    def forms(self) -> Forms:
        return self.record.forms

    @property
    def discrepancy(self) -> float | None:
        return float(self.record.kappa[self.k])

    @property
    def through_motion(self) -> bool:
        """As of `Regression`: of a target that is not measured."""
        return self.chain.measured[-1] is None

    def tests(self) -> tuple[Discrepancy | None, Octave | None, Change | None]:
        adequacy = self.record.adequacy
        channels = [name for name in self.chain.measured if name is not None]
        return adequacy.lacks(self.k), adequacy.coloured(channels), adequacy.changing(self.k)

    @property
    def shape(self) -> Shape | None:
        shapes = [self.record.adequacy.shapes[name] for name in self.chain.measured if name is not None]
        return min(shapes, key=lambda one: one.normality) if shapes else None

    def hides_noise(self, name: str) -> bool:
        return name not in self.record.inputs_of_known_noise

    def thinned(self) -> Regression:
        """The same: samples count by their noise."""
        return self

    def raised(self, power: float) -> Regression:
        """The regression with the likelihood raised to a power of at most 1."""
        return replace(self, gram=self.gram.raised(power), power=self.power * power)

    def reported(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """As of `Regression`: of the terms that the record was fitted with by projection."""
        found = replace(found, constant=replace(found.constant, variance=found.noise_variance / found.n))
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
            carried = found.covariance @ found.constant.center[kept]
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
            found, projected=Projected(own, sd, every, moved.share, moved.share * math.sqrt(left.target), left.lines)
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
    return replace(found, constant=replace(found.constant, center=center, mean=mean, variance=variance))


# Half of the step of central differences, as a share of what is changed: their error is about its square.
STEP = 1e-4

# An input of which more than this share of the samples repeats the one before is a command, not a measurement.
REPEATED = 0.1


def calibrated(regression: Regression, posterior: Posterior, basis: Floats) -> Posterior:
    """The posterior, in original units, with the uncertainty of the sensors' calibration in its covariances.

    With another factor of a channel the coefficients that explain the same motion, that of the training rows, are
    others: to first order their change is the regression, on the terms, of what the factor changes of the target and of
    the terms. By `basis`, (r, f), the r coefficients of the support move with those that are free.
    """
    names, known = regression.factors
    kept = np.flatnonzero(posterior.support)
    if not names or not len(kept):
        return posterior
    changes, of_constant = zip(*(_change_by_factor(regression, posterior, basis, name) for name in names), strict=True)
    added = np.transpose(changes) @ known @ np.array(changes)
    constant = float(np.array(of_constant) @ known @ np.array(of_constant))
    covariance = posterior.covariance + added
    own, averaged = posterior.constant, posterior.averaged
    if own.left_out is None:
        # such that the intercept has the variance that it had, and that of its own change
        center = own.center[kept]
        mean = max(posterior.intercept_sd**2 + constant - float(center @ covariance @ center), 0.0)
        own = replace(own, variance=mean)
    if averaged is not None:
        wider = averaged.sd.copy()
        wider[kept] = np.sqrt(wider[kept] ** 2 + posterior.pip[kept] * np.diagonal(added))
        averaged = replace(averaged, sd=wider)
    return replace(posterior, covariance=covariance, constant=own, averaged=averaged)


def _change_by_factor(
    regression: Regression, posterior: Posterior, basis: Floats, channel: str
) -> tuple[Floats, float]:
    """Derivatives of the coefficients (r,) and of the intercept by a factor of a channel."""
    motion = regression.motion
    columns = scaled_with(motion.roles.chains, channel)
    theta = posterior.coef[posterior.support]

    def scaled(name: str, values: Floats, step: float) -> Floats:
        return values * (1.0 + step) if name in columns else values

    target = 1.0 if regression.chain.target in columns else 0.0
    free = basis.shape[1]
    products, moved = np.zeros((free + 1, free + 1)), np.zeros(free + 1)
    for D, by_factor in _columns_and_derivatives(regression, posterior, scaled):
        X = np.column_stack([D @ basis, np.ones(len(D))])
        products += X.T @ X
        moved += X.T @ (target * (D @ theta + posterior.intercept) - by_factor @ theta)
    if posterior.constant.left_out is not None:
        return basis @ solved(products[:free, :free], moved[:free]), 0.0
    change = solved(products, moved)
    return basis @ change[:free], float(change[free])


def inputs_of_hidden_noise(regression: Regression, posterior: Posterior) -> tuple[str, ...]:
    """Inputs in the terms of a posterior whose noise was not given, nor known by the likelihood of the record."""
    motion, terms = regression.motion, regression.design.terms
    used = {name for j in np.flatnonzero(posterior.support) for name in terms[j].names}
    inputs = [name for name in motion.roles.inputs if name in used and name not in motion.sensors.noise]
    inputs = [name for name in inputs if _may_hide_noise([rows.columns[name] for rows in motion.train])]
    return tuple(name for name in inputs if regression.hides_noise(name))


def _may_hide_noise(pieces: Sequence[Floats]) -> bool:
    """Whether white noise of `hidden_noise` could be in a channel: its spectrum is nowhere lower.

    A command that is held, whose samples repeat, has none.
    """
    repeated = sum(int(np.count_nonzero(np.diff(values) == 0.0)) for values in pieces)
    if repeated > REPEATED * sum(map(len, pieces)):
        return False
    levels = [lowest_level(np.arange(len(values), dtype=np.float64), values) for values in pieces if len(values) > 2]
    return not levels or min(levels) > REGRESSION.hidden_noise**2 * float(np.var(np.concatenate(pieces)))


def changes_by_noise(
    regression: Regression, posterior: Posterior, name: str, shares: Sequence[float]
) -> dict[str, tuple[float, ...]]:
    """What noise of an input, as shares of its standard deviation, would have done to coefficients that neglect it.

    Noise adds to the sums of squares of the terms that the input is in. Without that share of them the coefficients
    would be others: of each term of the posterior with the input, the relative error of its coefficient at each share.
    """
    spread = float(np.std(np.concatenate([rows.columns[name] for rows in regression.motion.train])))

    def shifted(column: str, values: Floats, step: float) -> Floats:
        return values + step * spread if column == name else values

    kept = np.flatnonzero(posterior.support)
    products, added = np.zeros((len(kept) + 1,) * 2), np.zeros((len(kept) + 1,) * 2)
    for D, by_noise in _columns_and_derivatives(regression, posterior, shifted):
        X = np.column_stack([D, np.ones(len(D))])
        products += X.T @ X
        added[:-1, :-1] += by_noise.T @ by_noise
    theta = np.append(posterior.coef[kept], posterior.intercept)
    found = {}
    for share in shares:
        free_of_noise = solved(products - share**2 * added, products @ theta)
        found[share] = theta[:-1] / free_of_noise[:-1] - 1.0
    terms = [regression.design.terms[j] for j in kept]
    return {
        term.text: tuple(float(found[share][i]) for share in shares)
        for i, term in enumerate(terms)
        if name in term.names
    }


def _columns_and_derivatives(
    regression: Regression, posterior: Posterior, changed: Callable[[str, Floats, float], Floats]
) -> Iterator[tuple[Floats, Floats]]:
    """Columns (n, r) of the posterior's terms on the training rows of each record, and their derivatives by a change of
    the channels: `changed` gives a column after a step."""
    terms: list[Expression] = [regression.design.terms[j] for j in np.flatnonzero(posterior.support)]

    def evaluated(columns: Mapping[str, Floats], step: float) -> Floats:
        return evaluate_terms(terms, {name: changed(name, values, step) for name, values in columns.items()})

    for rows in regression.motion.train:
        difference = evaluated(rows.columns, STEP) - evaluated(rows.columns, -STEP)
        yield evaluate_terms(terms, rows.columns), difference / (2.0 * STEP)
