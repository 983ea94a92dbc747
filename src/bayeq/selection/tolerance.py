"""One declared practical choice: by how much free runs may be worse without a term.

Where a law is only nearly true, terms that it does not have make up for what it lacks, in the channels too: a filter in
the measurement may make thousands of nats of damping that depends on the amplitude, and nothing in a run. Predictions
alone would not do: the damping of a light structure explains next to nothing and yet decides how its motion decays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayeq.forecast.dynamics import Dynamics
from bayeq.forecast.free_run import apart, typical_period, window_runs
from bayeq.forecast.rows import Rows, divided, rows_of
from bayeq.gram import Gram
from bayeq.inference.posterior import Posterior
from bayeq.regression.fit import RegressionFit
from bayeq.states import Motion

__all__ = ["FOLLOWS", "SHORT", "TOLERANCE", "Errors", "FreeRuns", "hardly_worse", "likeliest_instead"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Share of the target's standard deviation, and of the states' spread, below which a difference makes no practical one:
# half of the 1 % to which sensors are usually calibrated: what changes a prediction by less cannot be claimed from what
# they measured. (With 1 % the paper's Coulomb friction, 0.7 to 1.2 % of the acceleration, was left out in 31 of 100
# records.)
TOLERANCE = 0.005

# Lengths of free runs in typical periods (at most half a record): one, which chaotic motion can be followed for too,
# and ten. They count where the full model's run keeps to the record to better than FOLLOWS of the spread: beyond, it is
# out of step, and its error says nothing about the equation.
SHORT, LONG = 1.0, 10.0
FOLLOWS = 0.5

Errors = Mapping[float, float]


class FreeRuns:
    """Errors of free runs of a system over windows of the training rows.

    Parameters
    ----------
    motion : Motion
        With time.
    fits : sequence of RegressionFit
        One per equation.
    """

    def __init__(self, motion: Motion, fits: Sequence[RegressionFit]) -> None:
        self.motion, self.fits = motion, fits

    @cached_property
    def pieces(self) -> list[Rows]:
        """The training rows with their inputs interpolated."""
        return divided(self.motion, rows_of(self.motion, "a free run"))[0]

    def errors(self, posteriors: Sequence[Posterior]) -> Errors:
        """Of one posterior per equation: error as a share of the states' spread, by the length of runs in periods."""
        expanded = [fit.expanded(one) for fit, one in zip(self.fits, posteriors, strict=True)]
        dynamics = Dynamics.on(self.motion, self.fits[0].regression.design.terms, expanded)
        period = typical_period(dynamics, self.pieces)
        return {periods: apart(window_runs(dynamics, self.pieces, periods * period)) for periods in (SHORT, LONG)}


def hardly_worse(fewer: Errors, whole: Errors, tolerance: float) -> bool:
    """Whether errors exceed others by no more than a tolerance; not where these are out of step with the record."""
    compared = [periods for periods in whole if whole[periods] < FOLLOWS]
    return SHORT in compared and all(fewer[periods] <= whole[periods] + tolerance for periods in compared)


def prediction_difference(rows: Gram, one: Posterior, other: Posterior) -> float:
    """Root mean square difference of predictions over the rows of a Gram, as a share of the target's deviation.

    Parameters
    ----------
    rows : Gram
        Of all P terms, in original units.
    one, other : Posterior
        The same.
    """
    change = one.coef - other.coef
    used = np.flatnonzero(change)
    c = change[used]
    offset = one.intercept - other.intercept + float(rows.mean[used] @ c)
    square = max(float(c @ rows.DtD[np.ix_(used, used)] @ c), 0.0) / rows.n + offset**2
    return math.sqrt(square / (rows.yty / rows.n)) if rows.yty > 0.0 else math.inf


def likeliest_instead(
    fit: RegressionFit, k: int, found: Sequence[Posterior], runs: FreeRuns | None, tolerance: float
) -> Posterior | None:
    """The likeliest model of equation k, where the included terms are not what the model average says.

    Collinear terms share their probability, so that none of several forms of damping may reach 0.5, however sure it is
    that there is damping. The average has it. So where the predictions or free runs of the included terms are further
    from its than the tolerance, and those of the likeliest model less so, that is the one to show.

    Parameters
    ----------
    fit : RegressionFit
        Of equation k.
    k : int
        Its number.
    found : sequence of Posterior
        Of every equation given its included terms.
    runs : FreeRuns or None
        Of the system; None without time.
    tolerance : float
        How far from the average they may be.
    """
    included = found[k]
    if included.average is None or included.averaged_coef is None or not len(included.average.models):
        return None
    best = included.average.models[0]
    if bool((best == included.support).all()):
        return None
    likeliest = fit.given(best)
    used = included.averaged_coef != 0.0
    mean = replace(included, support=used, coef=included.averaged_coef, covariance=np.zeros((int(used.sum()),) * 2))
    rows, whole = fit.regression.rows, fit.expanded(mean)
    own, other = (prediction_difference(rows, fit.expanded(one), whole) for one in (included, likeliest))
    if own > tolerance and other < own:
        return likeliest
    if runs is None:
        return None
    errors = runs.errors(_with(found, k, mean))
    if not errors[SHORT] < FOLLOWS or hardly_worse(runs.errors(found), errors, tolerance):
        return None
    instead = runs.errors(_with(found, k, likeliest))
    return likeliest if hardly_worse(instead, runs.errors(found), 0.0) else None


def _with(posteriors: Sequence[Posterior], k: int, one: Posterior) -> list[Posterior]:
    return [one if other == k else former for other, former in enumerate(posteriors)]
