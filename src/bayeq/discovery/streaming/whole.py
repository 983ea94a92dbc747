"""``Whole``: all rows of long records, whose statistics replace those of the stretches that are fitted first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from bayeq.arrays import Bools
from bayeq.discovery.streaming.checkpoint import Checkpoints
from bayeq.discovery.streaming.work import (
    BLOCK_ROWS,
    AsMeasured,
    ByLikelihood,
    Executor,
    Extent,
    LaggedResiduals,
    Of,
    Unit,
    Work,
    fold,
    units_of,
)
from bayeq.errors import DataWarning, RecordError, WarningLog, some_of
from bayeq.expressions import Expression
from bayeq.inference.gram import from_moments
from bayeq.inference.posterior import Posterior
from bayeq.likelihood.block import Block, Curvature, curvature, relearned
from bayeq.likelihood.record_fit import RecordFit
from bayeq.numerics.distributions import memory_of
from bayeq.numerics.settings import STREAMING
from bayeq.regression.design import Design, usable_terms
from bayeq.regression.residuals import Residuals
from bayeq.resumable import Progress
from bayeq.states import Motion
from bayeq.states.bad_samples import Learned

# Evenly spread units that are fitted first, so that the likelihood of all rows is expanded near its maximum.
SPREAD = 16

# Most passes over all rows until levels and included terms have converged.
PASSES = 3


@dataclass(frozen=True, eq=False)
class Whole:
    """All rows of long records."""

    extents: tuple[Extent, ...]  # the rows of each record
    executor: Executor  # threads or a cluster
    progress: Progress  # called with (stage, rows done, rows in all)
    checkpoints: Checkpoints  # of the sums over units
    learned: Learned = field(default_factory=Learned)  # models of channels from the stretches, to find bad samples

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(one.stream.name for one in self.extents)

    @property
    def n(self) -> int:
        return sum(one.n for one in self.extents)

    def counts(self, share: float) -> tuple[int, int]:
        """Number of training rows, and of held-out rows."""
        used = sum(one.cut(share) - one.start for one in self.extents)
        return used, self.n - used

    def design(self, motion: Motion, terms: Sequence[Expression], allowed: Bools, share: float) -> Design:
        """The design on the motion of stretches, with moments of all rows, of which a `share` is held out."""
        roles, terms = motion.roles, tuple(terms)
        work = AsMeasured(self.extents, roles, terms, share)
        names, targets = tuple(term.text for term in terms), len(roles.targets)
        found = self._fold(work, units_of(self.extents), "rows", (names, roles, share))
        if found.train.moments is None:
            raise RecordError("no row can be used for training: each has a missing sample")
        train = from_moments(found.train.moments, names, targets)
        held = () if found.held_out.moments is None else from_moments(found.held_out.moments, names, targets)
        whole = Design(motion, terms, train, held, (), (), allowed)
        whole = usable_terms(whole, found.train.bad + found.held_out.bad, self.n)
        return replace(whole, scan=partial(self.residuals, work, whole))

    def record(self, former: RecordFit, motion: Motion, log: WarningLog) -> RecordFit:
        """The likelihood of all rows, expanded about the fit to stretches, with levels of noise from all rows too."""
        units = units_of(self.extents, BLOCK_ROWS)
        self.progress("likelihood beside the fit", 0, self.n)
        found, curve = former, curvature(former.task, former.fitted.state)
        if len(units) > 2 * SPREAD:
            some = [units[k] for k in np.linspace(0, len(units) - 1, SPREAD).round().astype(int).tolist()]
            found, _, _ = self._about(found, curve, motion, some, "likelihood of some rows")
        for _ in range(PASSES):
            before = found
            found, block, moved = self._about(before, curve, motion, units, "likelihood of all rows")
            if moved < STREAMING.near and (found.posterior.support == before.posterior.support).all():
                break
        self._warn(block, motion, log)
        return found

    def _about(
        self, at: RecordFit, curve: Curvature, motion: Motion, units: Sequence[Unit], stage: str
    ) -> tuple[RecordFit, Block, float]:
        """The fit to some units, expanded about the fit `at`; their block, and how far the levels moved."""
        task, state = at.task, at.fitted.state
        work = ByLikelihood.of(self.extents, motion, task, state, self.learned)
        levels = (*state.levels.free.tolist(), *task.layout.corners)
        about = (motion.roles, state.chosen.term.tolist(), state.theta.tolist(), levels)
        block = self._fold(work, units, stage, about)
        if not block.samples:  # no usable samples
            return at.of_more(task, state, block.quadratic, block), block, 0.0
        task, state, quadratic, moved = relearned(task, state, block, curve)
        return at.of_more(task, state, quadratic, block), block, moved

    def _warn(self, block: Block, motion: Motion, log: WarningLog) -> None:
        """Warn about rows that could not be used, and samples that are missing or were left out as bad."""
        if block.lost:
            log.warn(
                f"{block.lost:,} of {self.n:,} rows could not be used: look at them, or leave them out (--rows)",
                DataWarning,
            )
        for counts, what in zip(block.absent.tolist(), ("are missing", "were left out as bad"), strict=True):
            pairs = zip(motion.roles.channels, counts, strict=False)
            listed = [f"{count:,} of {name}" for name, count in pairs if count]
            if listed:
                log.warn(
                    f"of all {self.n:,} rows these samples {what}: {some_of(listed, 40)}; check the sensors",
                    DataWarning,
                )

    def residuals(self, work: AsMeasured, design: Design, k: int, posterior: Posterior, found: Residuals) -> Residuals:
        """Residual statistics of the stretches, with lag-1 correlation and effective number of all training rows."""
        kept = np.flatnonzero(posterior.support)
        gram = design.train[k]
        mean = gram.target_mean - float(gram.mean[kept] @ posterior.coef[kept])
        terms = tuple(design.terms[int(j)] for j in kept)
        target = design.motion.roles.targets[k]
        each = LaggedResiduals(work.extents, work.roles, terms, work.share, target, posterior.coef[kept], mean)
        about = (work.roles, design.names, posterior.coef.tolist(), k, work.share)
        lagged = self._fold(each, units_of(self.extents), "residuals", about)
        lag1, n_eff = memory_of(lagged.products, lagged.n)
        return replace(found, n=lagged.n, lag1=lag1, n_eff=n_eff, discrepancy=None)

    def _fold(self, work: Work[Of], units: Sequence[Unit], stage: str, about: object) -> Of:
        return fold(work, units, self.executor, self.progress, stage, self.checkpoints.of_stage(stage, (about, units)))
