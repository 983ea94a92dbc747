"""Terms that are certain and yet make no practical difference.

Where a model is only nearly true, more rows make ever more terms certain: they stand in for what the dictionary does
not hold. A fixed share of variance alone does not tell them from what matters, since the damping of a light structure
explains next to nothing and yet decides how its motion decays. So terms are negligible if both hold: together they
explain less of the target's variance than a small share, and without them, the others estimated anew, free runs are
hardly worse, over ten periods and over a hundred. In shorter records less is certain, and what is certain matters
sooner: there free runs must be all but the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.rows import Rows, rows_of
from bayeq.forecast.windows import apart, typical_period, window_runs
from bayeq.inference.collapsed.path import best_of_each_size, partial_shares
from bayeq.inference.collapsed.problem import Problem
from bayeq.records import Record
from bayeq.regression.fit import Inferred, Setting
from bayeq.selection.limits import LeftOut, given_terms
from bayeq.states import Chain, States

__all__ = ["NEGLIGIBLE", "training_rows", "without_negligible"]

Floats = NDArray[np.float64]
_Windows = list[tuple[Floats, Floats]]
Bools = NDArray[np.bool_]

# Share of the target's variance that negligible terms together explain at most.
NEGLIGIBLE = 4e-5

# Terms that explain less than so many times as much may have been kept for the free runs alone.
MATTERS = 3.0

# Free runs over so many periods are hardly worse if their error is at most this share of the states' spread, or at most
# WORSE times that of the whole equation. Of fewer training rows than LONG, if they keep to those of the whole equation
# within this share of the spread; terms may explain more then, so many times as much.
TOLERANCES = {10.0: 0.1, 100.0: 0.25}
WORSE = 1.5
LONG = 10_000
SAME = 0.005
SHORT = 1.5


def training_rows(
    records: Sequence[Record], states: Sequence[States], chains: Sequence[Chain], inputs: Sequence[str], share: float
) -> list[Rows]:
    """The rows of each record that are not held out; none where a record has no time."""
    if any(record.time is None for record in records):
        return []
    out = []
    for record, found in zip(records, states, strict=True):
        rows = rows_of(record, found, chains, inputs, "a free run")
        out.append(rows.part(slice(0, rows.n - int(share * rows.n))))
    return out


def without_negligible(
    setting: Setting, inferred: Sequence[Inferred], pieces: Sequence[Rows], share: float
) -> list[Inferred]:
    """The same, negligible terms left out of what is shown, equation by equation.

    Parameters
    ----------
    setting : Setting
        All equations.
    inferred : sequence of Inferred
        One per equation, without constraints.
    pieces : sequence of Rows
        Training rows, from `training_rows`; nothing is left out where there are none.
    share : float
        Of the variance.
    """
    out = list(inferred)
    if not pieces:
        return out
    if sum(rows.n for rows in pieces) < LONG:
        share *= SHORT
    for k, one in enumerate(out):
        if not (_small(one, one.shown.support, share)).any():
            continue
        runs = _Runs(setting, out, k, pieces)
        fewer = next((model for model in _smaller_models(one, share) if runs.hardly_worse(model)), None)
        if fewer is not None:
            out[k] = _with_less(one, fewer, share, runs)
    return out


class _Runs:
    """Free runs of all equations, one of them given other terms, against those of the whole equations."""

    def __init__(self, setting: Setting, inferred: Sequence[Inferred], k: int, pieces: Sequence[Rows]) -> None:
        self.setting, self.inferred, self.k, self.pieces = setting, inferred, k, pieces
        self.long = sum(rows.n for rows in pieces) >= LONG

    def given(self, model: Bools) -> Inferred:
        """The equation with the terms of a model."""
        one = self.inferred[self.k]
        return replace(one, shown=given_terms(one.standard.gram, one.prior, one.shown, model))

    @cached_property
    def whole(self) -> dict[float, _Windows]:
        """Runs of the whole equations and what they are to follow, by their length in periods."""
        return _window_runs(self.setting, self.inferred, self.pieces)

    def hardly_worse(self, model: Bools) -> bool:
        """Whether runs are within the tolerances; not where there are none."""
        others = list(self.inferred)
        others[self.k] = self.given(model)
        fewer = _window_runs(self.setting, others, self.pieces)
        return all(self._within(fewer[p], self.whole[p], tolerance) for p, tolerance in TOLERANCES.items())

    def _within(self, fewer: _Windows, whole: _Windows, tolerance: float) -> bool:
        if self.long:
            return apart(fewer) <= max(tolerance, WORSE * apart(whole))
        return apart((one, other) for (one, _), (other, _) in zip(fewer, whole, strict=True)) <= SAME


def _with_less(inferred: Inferred, model: Bools, share: float, runs: _Runs) -> Inferred:
    """The equation given a smaller model; what was left out, and what of it could stand for a term that is kept."""
    found, shares = inferred.shown, partial_shares(inferred.fitted, inferred.shown.support)
    gone = np.flatnonzero(found.support & ~model)
    left = tuple(LeftOut(found.names[i], float(found.pip[i]), float(shares[i]), "negligible") for i in gone)
    # a term that explains so little was kept for the free runs alone, and another may do as well
    undecided = {}
    for j in np.flatnonzero(_small(inferred, model, MATTERS * share)):
        others = [i for i in gone if _as_good(inferred, model, int(j), int(i), share, runs)]
        if others:
            undecided[found.names[j]] = tuple(found.names[i] for i in others)
    return replace(runs.given(model), left_out=left, undecided=undecided)


def _as_good(inferred: Inferred, model: Bools, leaves: int, enters: int, share: float, runs: _Runs) -> bool:
    """Whether fit and free runs are hardly worse with one term in the place of another."""
    other = model.copy()
    other[leaves], other[enters] = False, True
    if _unexplained(inferred, other) - _unexplained(inferred, model) >= share:
        return False
    return runs.hardly_worse(other)


def _small(inferred: Inferred, model: Bools, share: float) -> Bools:
    """Terms of a model that explain less than a share of the variance, forced ones not among them."""
    shares = partial_shares(inferred.fitted, model)
    forced = np.isposinf(inferred.prior.log_odds(len(shares)))
    small: Bools = model & ~forced & (np.nan_to_num(shares, nan=np.inf) < share)
    return small


def _smaller_models(inferred: Inferred, share: float) -> list[Bools]:
    """The best model of each size among the terms shown that explains nearly as much, the smallest first."""
    problem = Problem.of(inferred.standard.gram, inferred.prior)
    support = inferred.shown.support
    inside = problem._replace(log_odds=np.where(support, problem.log_odds, -math.inf))
    whole = _unexplained(inferred, support)
    found = [model for model, _ in best_of_each_size(inside, int(support.sum()), [support])]
    return [model for model in found[:-1] if _unexplained(inferred, model) - whole < share]


def _unexplained(inferred: Inferred, active: Bools) -> float:
    """Share of the target's variance that least squares on some terms leaves."""
    gram, kept = inferred.fitted, np.flatnonzero(active)
    if not len(kept):
        return 1.0
    scale = 1.0 / np.sqrt(np.diagonal(gram.DtD)[kept])
    correlation = gram.DtD[np.ix_(kept, kept)] * np.outer(scale, scale)
    projected = np.linalg.lstsq(correlation, gram.Dty[kept] * scale)[0]
    return 1.0 - float(projected @ (gram.Dty[kept] * scale)) / gram.yty


def _window_runs(setting: Setting, inferred: Sequence[Inferred], pieces: Sequence[Rows]) -> dict[float, _Windows]:
    """Free runs over so many periods."""
    posteriors = [one.constraints.expand(one.shown.rescaled(one.standard), one.gram) for one in inferred]
    dynamics = Dynamics.of(setting.chains, setting.inputs, posteriors, [setting.design.terms] * len(inferred))
    period = typical_period(dynamics, pieces)
    parameters = dynamics.means(posteriors)
    return {periods: window_runs(dynamics, parameters, pieces, periods * period) for periods in TOLERANCES}
