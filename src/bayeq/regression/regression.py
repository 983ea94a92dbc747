"""`Regression`: the regression of one equation on its rows, with its Gram, residuals and fits; rows count as data.

`RecordRegression` is the regression of one equation by the likelihood of the records.
"""

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
from bayeq.inference.gram import Gram, grams_from_blocks
from bayeq.inference.posterior import Posterior, Projected
from bayeq.likelihood.adequacy import Change, Discrepancy, Octave
from bayeq.likelihood.channels import Suspect
from bayeq.likelihood.fit import solved
from bayeq.likelihood.hinges import Kinks
from bayeq.likelihood.projection import projected
from bayeq.likelihood.record_fit import RecordFit
from bayeq.numerics.distributions import Shape
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.design import Design
from bayeq.regression.residuals import Fit, Residuals, inspect_residuals, thinned_gram, without_noise
from bayeq.states import Chain, ChainSmoothing, Motion, MotionRows
from bayeq.states.kinematic.fit import lowest_level
from bayeq.states.sensors import scaled_with

# Residuals smaller than this share of the target are rounding of the Gram, and correlated.
ROUNDING = 1e-6

# The noise of a channel is visible if each of the HIGHEST bands, of BANDS of its spectrum, has less than a share FLOOR
# of the power of the strongest; records of LEAST_ROWS rows or fewer are left out.
BANDS, HIGHEST, FLOOR, LEAST_ROWS = 40, 6, 0.1, 400


@dataclass(frozen=True, eq=False)
class Regression:
    """The regression of one target on the dictionary; `RecordRegression` is that of the likelihood."""

    design: Design  # the dictionary on the motion
    k: int  # number of the chain whose highest derivative is the target
    # statistics that the equation is judged by: of the training rows and of those held out. Where the target was
    # estimated both sides went through the smoother.
    rows: Gram
    held_out: Gram | None
    gram: Gram  # statistics that count as data

    # Whether rows count as data: the likelihood of the records counts samples.
    counts_rows: ClassVar[bool] = True

    @classmethod
    def of(cls, design: Design, k: int) -> Regression:
        """The regression of chain number `k` of the design's motion, every row counting in full."""
        rows, held_out = judged_by(design, k)
        known, motion = design.motion.sensors.noise, design.motion
        inputs = {name for name in motion.roles.inputs if name in known}
        noise = {j: known[name] ** 2 for j, name in enumerate(design.names) if name in inputs}
        return cls(design, k, rows, held_out, without_noise(rows, noise))

    @property
    def motion(self) -> Motion:
        return self.design.motion

    @property
    def chain(self) -> Chain:
        """The coordinate whose highest derivative is the target."""
        return self.motion.roles.chains[self.k]

    @property
    def exact(self) -> float:
        """Probability that the law lacks nothing, or nothing beyond the tolerance; NaN where that is not known."""
        return math.nan

    @property
    def tau(self) -> float:
        """Most probable size of the function that a nearly true law lacks, as a share of the target's deviation."""
        return 0.0

    @property
    def factors(self) -> tuple[tuple[str, ...], Floats]:
        """Channels with uncertain calibration factors, and the covariance of these factors, for rows as given."""
        known = {name: sd for name, sd in self.motion.sensors.gain_sd.items() if sd}
        return tuple(known), np.diag(np.square(list(known.values())))

    @property
    def suspect(self) -> Suspect | None:
        """A channel that others contradict, or that was filtered; None for rows."""
        return None

    @property
    def kinks(self) -> Kinks | None:
        """Kinks that no candidate has, if the law is likelier with them; None for rows."""
        return None

    @property
    def constants(self) -> tuple[ConstantEstimate, ...]:
        """Constants inside the candidates, which the likelihood of the records finds."""
        return ()

    @property
    def forms(self) -> Forms:
        """Log posteriors of the members of every either-or, which the likelihood of the records finds."""
        return {}

    @property
    def discrepancy(self) -> float | None:
        """Standard deviation of the discrepancy as a share of the target's; None for rows."""
        return None

    def tests(self) -> tuple[Discrepancy | None, Octave | None, Change | None]:
        """A discrepancy that is needed, innovations that are not white, a coefficient that changes; None for rows."""
        return None, None, None

    @property
    def shape(self) -> Shape | None:
        """The shape of the innovations of the chain's least normal channel; None for rows."""
        return None

    def hides_noise(self, name: str) -> bool:
        """Whether the record hides the noise of an input, which would show at the input's highest frequencies."""
        return not shows_noise([rows.columns[name] for rows in self.motion.train])

    def reported(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """A posterior in original units as it is reported, here unchanged.

        `basis`, (r, f): derivatives of its coefficients by the free ones; `free`: `limits`, (P, 2), do not change it.
        """
        return found

    def thinned(self) -> Regression:
        """The regression with rows weighted to the effective sample size, where their residuals are correlated."""
        if len(self.design.terms) > REGRESSION.most_terms_to_thin:
            return self
        return replace(self, gram=thinned_gram(self.gram, self._all_residuals))

    def _all_residuals(self, posterior: Posterior) -> Residuals:
        """Diagnostics of the residuals of all training rows, also where the motion has only some of them."""
        found, scan = self.residuals(posterior), self.design.scan
        return found if scan is None or not found.correlated else scan(self.k, posterior, found)

    def raised(self, power: float) -> Regression:
        """The regression with the likelihood raised to a power of at most 1."""
        return replace(self, gram=self.gram.raised(power))

    def fit(self, posterior: Posterior) -> Fit:
        """The fit of a posterior (in original units) to the target on the training rows."""
        return _fit(self.rows, posterior)

    def held_out_fit(self, posterior: Posterior) -> Fit | None:
        """The fit of a posterior on the rows held out; None if there are none."""
        return None if self.held_out is None else _fit(self.held_out, posterior)

    def noise_variance(self, posterior: Posterior) -> float:
        """Variance of the residual over the training rows."""
        spare = max(self.rows.n - 1.0 - float(posterior.support.sum()), 1.0)
        return self.rows.squared_error(posterior.coef, posterior.intercept) / spare

    def residuals(self, posterior: Posterior, channels: Sequence[str] = ()) -> Residuals:
        """Diagnostics of training residuals, against some channels; residuals that are rounding count as white."""
        train, smoothing = self.motion.train, self.motion.estimated_by(self.k)
        places = [(i, part) for i in range(len(train)) for part in self.motion.smoothed_pieces(i)]
        pieces = [train[i].part(part) for i, part in places]
        found = inspect_residuals(
            [self._residual(posterior, rows, *place) for rows, place in zip(pieces, places, strict=True)],
            {name: [rows.columns[name][_judged(rows, smoothing)] for rows in pieces] for name in channels},
        )
        return found if self.fit(posterior).nrmse > ROUNDING else Residuals(found.n, 0.0, float(found.n))

    def _residual(self, posterior: Posterior, rows: MotionRows, i: int, part: slice) -> Floats:
        """Residuals of a posterior in `rows`, a part of record i, without the ends that equations are not judged by."""
        smoothing = self.motion.estimated_by(self.k)
        out: Floats = rows.observed[self.chain.target] - posterior.intercept
        kept = np.flatnonzero(posterior.support)
        if len(kept):
            terms = [self.design.terms[j] for j in kept]
            D = self.design.kept[i][part][:, kept] if self.design.kept else evaluate_terms(terms, rows.columns)
            out = out - _filtered(D, terms, self.motion.roles.states, smoothing) @ posterior.coef[kept]
        return out[_judged(rows, smoothing)]


def judged_by(design: Design, k: int) -> tuple[Gram, Gram | None]:
    """Statistics that an equation is judged by, of the training rows and of those held out."""
    motion = design.motion
    if motion.estimated_by(k) is None:
        return design.train[k], design.held_out[k] if design.held_out else None
    held_out = _filtered_gram(design, k, motion.held_out) if motion.held_out else None
    return _filtered_gram(design, k, motion.train, kept=True), held_out


def shows_noise(pieces: Sequence[Floats]) -> bool:
    """Whether a channel has little power at its highest frequencies, so that its noise is visible there."""
    levels = [
        [float(band.mean()) for band in np.array_split(np.abs(np.fft.rfft(values - values.mean())[1:]) ** 2, BANDS)]
        for values in pieces
        if len(values) > LEAST_ROWS
    ]
    power = np.sum(levels, axis=0)
    return bool(len(levels) and power[-HIGHEST:].max() < FLOOR * power.max())


def _judged(rows: MotionRows, smoothing: ChainSmoothing | None) -> slice:
    """The rows that an equation is judged by: without the ends of an estimated target."""
    return rows.inside if smoothing is None else smoothing.inner(rows.n)


def _filtered(
    D: Floats, terms: Sequence[Expression], states: Sequence[str], smoothing: ChainSmoothing | None
) -> Floats:
    """Columns (n, P) of terms, filtered like the estimated target, except those of states, which are smoothed already.

    Unchanged without `smoothing` (the target is measured). Products of smoothed states still have unsmoothed harmonics.
    """
    if smoothing is None:
        return D
    chosen = [j for j, term in enumerate(terms) if term.text not in states]
    out = D.copy()
    out[:, chosen] = smoothing.follow(D[:, chosen])
    return out


def _filtered_gram(design: Design, k: int, pieces: Sequence[MotionRows], kept: bool = False) -> Gram:
    """Statistics of an estimated target and of terms filtered like it, without rows that were bridged."""
    smoothing, roles = design.motion.estimated_by(k), design.motion.roles
    target = roles.chains[k].target

    def blocks() -> Iterator[tuple[Floats, Floats]]:
        for i, whole in enumerate(pieces):
            for part in design.motion.smoothed_pieces(i) if kept else [slice(None)]:
                rows = whole.part(part)
                D = design.columns(i)[part] if kept else evaluate_terms(design.terms, rows.columns)
                chosen = np.zeros(rows.n, dtype=np.bool_)
                chosen[_judged(rows, smoothing)] = True
                chosen &= rows.known
                yield _filtered(D, design.terms, roles.states, smoothing)[chosen], rows.observed[target][chosen, None]

    return grams_from_blocks(blocks(), design.names)[0]


def _fit(gram: Gram, posterior: Posterior) -> Fit:
    share = gram.squared_error(posterior.coef, posterior.intercept) / gram.yty if gram.yty > 0 else 1.0
    return Fit(n=round(gram.n), r2=1.0 - share, nrmse=math.sqrt(share))


# Least degrees of freedom of an interval, by Satterthwaite: a variance from few batches is hardly known.
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
    power: float = 1.0  # power that the likelihood in `gram` is raised to

    counts_rows: ClassVar[bool] = False

    @property
    def exact(self) -> float:
        return self.record.nearly.exact[self.k]

    @property
    def factors(self) -> tuple[tuple[str, ...], Floats]:
        """Like `Regression.factors`, with factors estimated by the likelihood from the other channels."""
        found = self.record.calibration
        return tuple(found.gains), found.covariance

    @property
    def suspect(self) -> Suspect | None:
        return self.record.adequacy.suspect([*filter(None, self.chain.measured), *self.motion.roles.inputs])

    @property
    def kinks(self) -> Kinks | None:
        return self.record.adequacy.kinks.get(self.k)

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
        """The regression itself: samples are weighted by their noise."""
        return self

    def raised(self, power: float) -> Regression:
        """The regression with the likelihood raised to a power of at most 1."""
        return replace(self, gram=self.gram.raised(power), power=self.power * power)

    def reported(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """Like `Regression.reported`, by projection if the terms are those that the record was fitted with."""
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
        """The posterior by projection (`bayeq.likelihood.projection`), with coefficients within the limits."""
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
        # Satterthwaite's, of the sum of a known and an estimated variance
        freedom = moved.freedom * (total / np.maximum(added, 1e-9 * total + np.finfo(float).tiny)) ** 2
        own, sd = np.zeros((2, len(kept)))
        own[kept], sd[kept] = theta[:r], np.sqrt(np.diagonal(covariance))[:r]
        every = np.full(len(kept), np.inf)
        every[kept] = np.maximum(freedom[:r], LEAST_FREEDOM)
        error_sd = moved.share * math.sqrt(left.target)
        found = replace(found, projected=Projected(own, sd, every, moved.share, error_sd, left.lines))
        return _with_constant(found, theta + change, both)


def _with_constant(found: Posterior, theta: Floats, both: Floats) -> Posterior:
    """A posterior with coefficients `theta` and covariance `both`, the constant last if it is in the model."""
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


# Half of the step of central differences, as a share of the value that changes: their error is about its square.
STEP = 1e-4

# An input of which more than this share of the samples repeats the one before is a command, not a measurement.
REPEATED = 0.1


def calibrated(regression: Regression, posterior: Posterior, basis: Floats) -> Posterior:
    """The posterior, in original units, with the uncertainty of the sensors' calibration in its covariances.

    To first order, a factor changes the coefficients by the regression on the terms of: the target's change, less that
    of the sum of the terms. `basis`, (r, f), are the derivatives of the coefficients by the free ones.
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
        # such that the intercept has its former variance, and that of its own change
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
    """Inputs in the terms of a posterior whose noise was neither given nor visible in the record."""
    motion, terms = regression.motion, regression.design.terms
    used = {name for j in np.flatnonzero(posterior.support) for name in terms[j].names}
    inputs = [name for name in motion.roles.inputs if name in used and name not in motion.sensors.noise]
    inputs = [name for name in inputs if _may_hide_noise([rows.columns[name] for rows in motion.train])]
    return tuple(name for name in inputs if regression.hides_noise(name))


def _may_hide_noise(pieces: Sequence[Floats]) -> bool:
    """Whether a channel could hold white noise of `hidden_noise`: it is not held, as a command, and nowhere weaker."""
    repeated = sum(int(np.count_nonzero(np.diff(values) == 0.0)) for values in pieces)
    if repeated > REPEATED * sum(map(len, pieces)):
        return False
    levels = [lowest_level(np.arange(len(values), dtype=np.float64), values) for values in pieces if len(values) > 2]
    return not levels or min(levels) > REGRESSION.hidden_noise**2 * float(np.var(np.concatenate(pieces)))


def changes_by_noise(
    regression: Regression, posterior: Posterior, name: str, shares: Sequence[float]
) -> dict[str, tuple[float, ...]]:
    """Relative errors of coefficients that neglect noise of an input, at each share of its standard deviation."""
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
    without = [solved(products - share**2 * added, products @ theta)[:-1] for share in shares]
    errors = (theta[:-1] / np.array(without) - 1.0).T
    terms = [regression.design.terms[j] for j in kept]
    return {term.text: tuple(own) for term, own in zip(terms, errors.tolist(), strict=True) if name in term.names}


def _columns_and_derivatives(
    regression: Regression, posterior: Posterior, changed: Callable[[str, Floats, float], Floats]
) -> Iterator[tuple[Floats, Floats]]:
    """Columns (n, r) of the posterior's terms on the training rows of each record, and their derivatives by a change of
    the channels: `changed` returns a channel after a step."""
    terms: list[Expression] = [regression.design.terms[j] for j in np.flatnonzero(posterior.support)]

    def evaluated(columns: Mapping[str, Floats], step: float) -> Floats:
        return evaluate_terms(terms, {name: changed(name, values, step) for name, values in columns.items()})

    for rows in regression.motion.train:
        difference = evaluated(rows.columns, STEP) - evaluated(rows.columns, -STEP)
        yield evaluate_terms(terms, rows.columns), difference / (2.0 * STEP)
