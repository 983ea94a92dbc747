"""Statistically certain but practically negligible terms.

Where a model is only nearly true, more rows make ever more terms certain: they compensate for what the dictionary does
not hold. A fixed share of variance alone does not separate them from what matters, since the damping of a light
structure explains next to nothing and yet decides how its motion decays. So terms are negligible if both hold: together
they explain less of the target's variance than a small share, and without them, the others estimated again, free runs
are hardly worse, over ten periods and over a hundred. In shorter records less is certain, and what is certain matters
sooner: there free runs must be all but the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.rows import Rows, divided, rows_of
from bayeq.forecast.windows import apart, typical_period, window_runs
from bayeq.inference.collapsed.path import best_of_each_size, partial_shares
from bayeq.inference.posterior import Posterior
from bayeq.regression.fit import RegressionFit
from bayeq.states import Motion

__all__ = ["NEGLIGIBLE", "FreeRuns", "less_negligible", "undecided_forms"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Windows = list[tuple[Floats, Floats]]

# Share of the target's variance that negligible terms together explain at most.
NEGLIGIBLE = 4e-5

# Terms that explain less than this multiple of it may have been kept for the free runs alone.
MATTERS = 3.0

# Free runs over a number of periods are hardly worse if their error is at most this share of the states' spread, or at
# most WORSE times that of the whole equation. Of fewer training rows than LONG, if they keep to those of the whole
# equation within SAME of the spread; terms may then explain SHORT times as much.
TOLERANCES = {10.0: 0.1, 100.0: 0.25}
WORSE = 1.5
LONG = 10_000
SAME = 0.005
SHORT = 1.5


class FreeRuns:
    """Free runs of a system over windows of the training rows.

    Parameters
    ----------
    motion : Motion
        With time.
    fits : sequence of RegressionFit
        One per equation.
    """

    def __init__(self, motion: Motion, fits: Sequence[RegressionFit]) -> None:
        self.motion, self.fits = motion, fits
        self.rows = sum(rows.n for rows in motion.train)
        self.long = self.rows >= LONG

    @cached_property
    def noise(self) -> float:
        """Least noise of a coordinate as a share of its spread, where the likelihood of the record has found it.

        Runs that differ by more differ visibly.
        """
        record = self.fits[0].regression.record
        return math.inf if record is None else record.least_noise

    @cached_property
    def pieces(self) -> list[Rows]:
        """The training rows with their inputs interpolated."""
        return divided(self.motion, rows_of(self.motion, "a free run"))[0]

    def of(self, shown: Sequence[Posterior]) -> dict[float, Windows]:
        """Runs and what they are to follow, by their length in periods; one posterior per equation."""
        posteriors = [fit.expanded(one) for fit, one in zip(self.fits, shown, strict=True)]
        dynamics = Dynamics.on(self.motion, self.fits[0].regression.design.terms, posteriors)
        period = typical_period(dynamics, self.pieces)
        return {periods: window_runs(dynamics, self.pieces, periods * period) for periods in TOLERANCES}

    def hardly_worse(self, fewer: dict[float, Windows], whole: dict[float, Windows]) -> bool:
        """Whether runs are within the tolerances; not where there are none."""
        return all(self._within(fewer[p], whole[p], tolerance) for p, tolerance in TOLERANCES.items())

    def _within(self, fewer: Windows, whole: Windows, tolerance: float) -> bool:
        moved = apart((one, other) for (one, _), (other, _) in zip(fewer, whole, strict=True))
        if self.long:
            return apart(fewer) <= max(tolerance, WORSE * apart(whole)) and moved <= self.noise
        return moved <= SAME


def less_negligible(
    fit: RegressionFit, k: int, shown: Sequence[Posterior], share: float, runs: FreeRuns
) -> Bools | None:
    """The terms of equation k without the negligible ones among them; None where none is.

    Parameters
    ----------
    fit : RegressionFit
        Of equation k.
    k : int
        Its number.
    shown : sequence of Posterior
        Of each equation, given the terms shown so far.
    share : float
        Of the target's variance that negligible terms together explain at most.
    runs : FreeRuns
        Of the system.
    """
    share = _scaled(share, runs)
    if not _small(fit, shown[k].support, share).any():
        return None
    whole = runs.of(shown)
    for model in _smaller_models(fit, shown[k].support, share):
        if runs.hardly_worse(runs.of(_with(shown, k, fit.given(model))), whole):
            return model
    return None


def undecided_forms(
    fit: RegressionFit, k: int, shown: Sequence[Posterior], model: Bools, share: float, runs: FreeRuns
) -> dict[str, tuple[str, ...]]:
    """Terms of a smaller model of equation k, each with terms left out that could take its place.

    A term that explains so little was kept for the free runs alone, and another may do as well: fit and free runs are
    hardly worse with the other one.
    """
    share = _scaled(share, runs)
    names, gone = fit.posterior.names, np.flatnonzero(shown[k].support & ~model)
    whole = runs.of(shown)
    out = {}
    for j in np.flatnonzero(_small(fit, model, MATTERS * share)):
        others = []
        for i in gone:
            swapped = model.copy()
            swapped[j], swapped[i] = False, True
            if _unexplained(fit, swapped) - _unexplained(fit, model) < share and runs.hardly_worse(
                runs.of(_with(shown, k, fit.given(swapped))), whole
            ):
                others.append(names[i])
        if others:
            out[names[j]] = tuple(others)
    return out


def _scaled(share: float, runs: FreeRuns) -> float:
    return share if runs.long else share * SHORT


def _with(shown: Sequence[Posterior], k: int, posterior: Posterior) -> list[Posterior]:
    return [posterior if other == k else one for other, one in enumerate(shown)]


def _small(fit: RegressionFit, model: Bools, share: float) -> Bools:
    """Terms of a model that explain less than a share of the variance, forced ones not among them."""
    shares = partial_shares(fit.rows, model)
    forced = np.isposinf(fit.problem.log_odds)
    small: Bools = model & ~forced & (np.nan_to_num(shares, nan=np.inf) < share)
    return small


def _smaller_models(fit: RegressionFit, support: Bools, share: float) -> list[Bools]:
    """The best model of each size among the terms shown that explains nearly as much, the smallest first."""
    inside = fit.problem._replace(log_odds=np.where(support, fit.problem.log_odds, -math.inf))
    whole = _unexplained(fit, support)
    found = [model for model, _ in best_of_each_size(inside, int(support.sum()), [support], fit.prior.known_signs)]
    return [model for model in found[:-1] if _unexplained(fit, model) - whole < share]


def _unexplained(fit: RegressionFit, active: Bools) -> float:
    """Share of the target's variance that least squares on some terms leaves."""
    gram, kept = fit.rows, np.flatnonzero(active)
    if not len(kept):
        return 1.0
    scale = 1.0 / np.sqrt(np.diagonal(gram.DtD)[kept])
    correlation = gram.DtD[np.ix_(kept, kept)] * np.outer(scale, scale)
    projected = np.linalg.lstsq(correlation, gram.Dty[kept] * scale)[0]
    return 1.0 - float(projected @ (gram.Dty[kept] * scale)) / gram.yty
