"""`Regression`: one equation's rows, from which its Gram, residuals and fits come; rows as measured count as data."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.ranges import ConstantEstimate, Forms
from bayeq.expressions import Expression
from bayeq.inference.gram import Gram, grams_from_blocks
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.adequacy import Change, Discrepancy, Octave
from bayeq.likelihood.gains import Suspect
from bayeq.numerics.distributions import Shape
from bayeq.numerics.settings import REGRESSION
from bayeq.regression.design import Design
from bayeq.regression.residuals import Fit, Residuals, inspect_residuals, thinned_gram, without_noise
from bayeq.states import Chain, ChainSmoothing, Motion, MotionRows

# Residuals smaller than this share of the target are rounding of the Gram, and correlated.
ROUNDING = 1e-6

# Noise is seen where the highest parts of the spectrum, of BANDS, have less than a share of the strongest, if records
# are longer than this.
BANDS, HIGHEST, FLOOR, LEAST_ROWS = 40, 6, 0.1, 400


@dataclass(frozen=True, eq=False)
class Regression:
    """The regression of one target on the dictionary; `bayeq.regression.by_likelihood` has that of the likelihood."""

    design: Design  # the dictionary on the motion
    k: int  # number of the chain whose highest derivative is the target
    # statistics that the equation is judged by: of the training rows and of those held out. Where the target was
    # estimated both sides went through the smoother.
    rows: Gram
    held_out: Gram | None
    gram: Gram  # what counts as data

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
        """The rows."""
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
        """Most probable size of what a law lacks that is nearly true, as a share of the target's standard deviation."""
        return 0.0

    @property
    def factors(self) -> tuple[tuple[str, ...], Floats]:
        """Channels whose factors may be off, and the covariance of these: of rows as it was given."""
        known = {name: sd for name, sd in self.motion.sensors.gain_sd.items() if sd}
        return tuple(known), np.diag(np.square(list(known.values())))

    @property
    def suspect(self) -> Suspect | None:
        """A channel that others contradict, or that was filtered; None of rows."""
        return None

    @property
    def constants(self) -> tuple[ConstantEstimate, ...]:
        """Constants inside the candidates, which the likelihood of the records finds."""
        return ()

    @property
    def forms(self) -> Forms:
        """Log posteriors of the members of every either-or, found by the same."""
        return {}

    @property
    def discrepancy(self) -> float | None:
        """Standard deviation of the discrepancy as a share of the target's; None of rows."""
        return None

    @property
    def through_motion(self) -> bool:
        """Whether data tell of the target by the motion alone that it leads to."""
        return False

    def tests(self) -> tuple[Discrepancy | None, Octave | None, Change | None]:
        """A discrepancy that the motion needs, innovations that are not white, a coefficient that changes; none of
        rows."""
        return None, None, None

    @property
    def shape(self) -> Shape | None:
        """The shape of what is left of the channels of the chain; None of rows."""
        return None

    def hides_noise(self, name: str) -> bool:
        """Whether the record does not tell the noise of an input; of rows its highest frequencies do."""
        return not shows_noise([rows.columns[name] for rows in self.motion.train])

    def reported(self, found: Posterior, basis: Floats, limits: Floats | None, free: bool) -> Posterior:
        """A posterior in original units, of all P terms with r in its support, as it is reported.

        Coefficients move with those that are free as `basis`, (r, f), says; limits, (P, 2), are the least and largest,
        and `free` says that none of them changes the posterior.
        """
        return found

    def thinned(self) -> Regression:
        """The regression with rows that count for the effective sample size, where their residuals are correlated."""
        if len(self.design.terms) > REGRESSION.most_terms_to_thin:
            return self
        return replace(self, gram=thinned_gram(self.gram, self._all_residuals))

    def _all_residuals(self, posterior: Posterior) -> Residuals:
        """Correlation of the residuals of all training rows, also where the motion is of some of them only."""
        found, scan = self.residuals(posterior), self.design.scan
        return found if scan is None or not found.correlated else scan(self.k, posterior, found)

    def raised(self, power: float) -> Regression:
        """The regression with the likelihood raised to a power of at most 1."""
        return replace(self, gram=self.gram.raised(power))

    def fit(self, posterior: Posterior) -> Fit:
        """How well a posterior (in original units) gives the target on the training rows."""
        return _fit(self.rows, posterior)

    def held_out_fit(self, posterior: Posterior) -> Fit | None:
        """The same on the rows held out; None where there are none."""
        return None if self.held_out is None else _fit(self.held_out, posterior)

    def noise_variance(self, posterior: Posterior) -> float:
        """Variance of the residual over the training rows."""
        spare = max(self.rows.n - 1.0 - float(posterior.support.sum()), 1.0)
        return self.rows.squared_error(posterior.coef, posterior.intercept) / spare

    def residuals(self, posterior: Posterior, channels: Sequence[str] = ()) -> Residuals:
        """Training residuals, against some channels; those that are rounding of the Gram count as white."""
        train, smoothing = self.motion.train, self.motion.estimated_by(self.k)
        places = [(i, part) for i in range(len(train)) for part in self.motion.smoothed_pieces(i)]
        pieces = [train[i].part(part) for i, part in places]
        found = inspect_residuals(
            [self._residual(posterior, rows, *place) for rows, place in zip(pieces, places, strict=True)],
            {name: [rows.columns[name][_judged(rows, smoothing)] for rows in pieces] for name in channels},
        )
        return found if self.fit(posterior).nrmse > ROUNDING else Residuals(found.n, 0.0, float(found.n))

    def _residual(self, posterior: Posterior, rows: MotionRows, i: int, part: slice) -> Floats:
        """What a posterior leaves of the target in some rows, part of record i: those that equations are judged by."""
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
    """Whether the highest of a channel's frequencies have next to nothing of it: there its noise is seen."""
    levels = [
        [float(band.mean()) for band in np.array_split(np.abs(np.fft.rfft(values - values.mean())[1:]) ** 2, BANDS)]
        for values in pieces
        if len(values) > LEAST_ROWS
    ]
    power = np.sum(levels, axis=0)
    return bool(len(levels) and power[-HIGHEST:].max() < FLOOR * power.max())


def _judged(rows: MotionRows, smoothing: ChainSmoothing | None) -> slice:
    """The rows that an equation is judged by: all, but the ends of an estimated target."""
    return rows.inside if smoothing is None else smoothing.inner(rows.n)


def _filtered(
    D: Floats, terms: Sequence[Expression], states: Sequence[str], smoothing: ChainSmoothing | None
) -> Floats:
    """Columns (n, P) of the terms on the rows of a record, filtered as an estimated target was; else as they are.

    Both sides of an equation then went through the same filter. Terms that are states did: the smoother's gain is in
    them. An input is as measured; a product such as x**3 is that of smoothed states, which follow the motion where it
    is strong, so that its harmonics stand there at full height.
    """
    if smoothing is None:
        return D
    chosen = [j for j, term in enumerate(terms) if term.text not in states]
    out = D.copy()
    out[:, chosen] = smoothing.follow(D[:, chosen])
    return out


def _filtered_gram(design: Design, k: int, pieces: Sequence[MotionRows], kept: bool = False) -> Gram:
    """Statistics of a target that was estimated, its terms filtered like it, without rows that were bridged."""
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
