"""Terms that are certain and yet make no practical difference.

Where a model is only nearly true, more rows make ever more terms certain: they stand in for what the dictionary does
not hold. A fixed share of variance alone does not tell them from what matters, since the damping of a light structure
explains next to nothing and yet decides how its motion decays. So terms are negligible if both hold: together they
explain less of the target's variance than a small share, and without them, the others estimated anew, free runs are
hardly worse, over ten periods and over a hundred. In shorter records less is certain, and what is certain matters
sooner: there free runs must be all but the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bayeq.choice import LeftOut, given_terms
from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.rows import Rows, rows_of
from bayeq.forecast.windows import typical_period, window_error
from bayeq.infer import Inferred, Setting
from bayeq.inference.path import best_of_each_size, partial_shares
from bayeq.inference.problem import Problem
from bayeq.records import Record
from bayeq.states import Chain, States

__all__ = ["NEGLIGIBLE", "training_rows", "without_negligible"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Share of the target's variance that negligible terms together explain at most.
NEGLIGIBLE = 4e-5

# Terms that explain less than so many times as much may have been kept for the free runs alone.
MATTERS = 3.0

# Free runs over so many periods are hardly worse if their error is at most this share of the states' spread, or at most
# WORSE times that of the whole equation. Of fewer training rows than LONG, if it is larger than that by this share of
# the spread at most.
TOLERANCES = {10.0: 0.1, 100.0: 0.25}
WORSE = 1.5
LONG = 10_000
RISE = 0.003


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
    hardly_worse = _hardly_worse if sum(rows.n for rows in pieces) >= LONG else _all_but_the_same
    for k, one in enumerate(out):
        shares = partial_shares(one.fitted, one.shown.support)
        forced = np.isposinf(one.prior.log_odds(len(shares)))
        if not (np.nan_to_num(shares, nan=np.inf)[~forced] < share).any():
            continue
        errors: dict[float, float] | None = None
        for fewer in _smaller_models(one, share):
            shown = given_terms(one.standard.gram, one.prior, one.shown, fewer)
            if errors is None:
                errors = _errors(setting, out, pieces)
            trial = [*out[:k], replace(one, shown=shown), *out[k + 1 :]]
            if hardly_worse(_errors(setting, trial, pieces), errors):
                names = one.shown.names
                gone = np.flatnonzero(one.shown.support & ~fewer)
                left = tuple(LeftOut(names[j], float(one.shown.pip[j]), float(shares[j]), "negligible") for j in gone)
                undecided: dict[str, tuple[str, ...]] = {}
                for j, models in _exchanged(one, fewer, gone, share).items():
                    posteriors = [given_terms(one.standard.gram, one.prior, one.shown, model) for _, model in models]
                    swapped = [[*out[:k], replace(one, shown=shown), *out[k + 1 :]] for shown in posteriors]
                    as_good = tuple(
                        names[i]
                        for (i, _), other in zip(models, swapped, strict=True)
                        if hardly_worse(_errors(setting, other, pieces), errors)
                    )
                    if as_good:
                        undecided[names[j]] = as_good
                out[k] = replace(trial[k], left_out=left, undecided=undecided)
                break
    return out


def _exchanged(
    inferred: Inferred, model: Bools, gone: NDArray[np.intp], share: float
) -> dict[int, list[tuple[int, Bools]]]:
    """Models that put a negligible term in the place of one that is kept for the free runs alone, by the latter."""
    shares = partial_shares(inferred.fitted, model)
    forced = np.isposinf(inferred.prior.log_odds(len(shares)))
    whole = _unexplained(inferred, model)
    out = {}
    for j in np.flatnonzero(model & ~forced & (np.nan_to_num(shares, nan=np.inf) < share * MATTERS)):
        models = []
        for i in gone:
            other = model.copy()
            other[j], other[i] = False, True
            if _unexplained(inferred, other) - whole < share:
                models.append((int(i), other))
        if models:
            out[int(j)] = models
    return out


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


def _errors(setting: Setting, inferred: Sequence[Inferred], pieces: Sequence[Rows]) -> dict[float, float]:
    """Errors of free runs over so many periods."""
    posteriors = [one.constraints.expand(one.standard.restore(one.shown), one.gram) for one in inferred]
    dynamics = Dynamics.of(setting.chains, setting.inputs, posteriors, [setting.design.terms] * len(inferred))
    period = typical_period(dynamics, pieces)
    parameters = dynamics.means(posteriors)
    return {periods: window_error(dynamics, parameters, pieces, periods * period) for periods in TOLERANCES}


def _hardly_worse(fewer: dict[float, float], whole: dict[float, float]) -> bool:
    """Whether errors are within the tolerances; not where there are none."""
    return all(fewer[p] <= max(tolerance, WORSE * whole[p]) for p, tolerance in TOLERANCES.items())


def _all_but_the_same(fewer: dict[float, float], whole: dict[float, float]) -> bool:
    """Whether errors rise by next to nothing; not where there are none."""
    return all(fewer[p] <= whole[p] + RISE for p in TOLERANCES)
