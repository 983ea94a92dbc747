"""Other equations that the posterior does not rule out, and whether they predict otherwise than the one shown.

They are compared where the record has been, and wherever its states and inputs could be together, each within its own
values: on a steady sine, of which displacement and velocity are always a quarter of a period apart, equations may agree
along the motion and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.inference.posterior import Posterior
from bayeq.regression.fit import RegressionFit
from bayeq.selection.tolerance import TOLERANCE
from bayeq.states import Motion

__all__ = ["Alternatives", "alternatives_to"]

Floats = NDArray[np.float64]

# Models of less probability than this together are left out, points at which the others are compared, and their seed.
LEAST, POINTS, SEED = 1e-3, 1000, 0


@dataclass(frozen=True)
class Alternatives:
    """Other equations that predict otherwise.

    Attributes
    ----------
    probability : float
        Of all of them together.
    enter, leave : tuple of str
        Terms that the likeliest of them has more, and less, than the equation shown.
    """

    probability: float
    enter: tuple[str, ...] = ()
    leave: tuple[str, ...] = ()


def alternatives_to(fit: RegressionFit, shown: Posterior, tolerance: float = TOLERANCE) -> Alternatives:
    """Models of the posterior whose predictions differ from those of the equation shown by more than a tolerance.

    Parameters
    ----------
    fit : RegressionFit
        With a model average; without one there are no alternatives.
    shown : Posterior
        Of the equation shown, in original units; where it is a projection, of the full model.
    tolerance : float
        Root mean square difference, as a share of the target's standard deviation.
    """
    average = fit.posterior.average
    if average is None:
        return Alternatives(0.0)
    regression = fit.regression
    terms, motion = regression.design.terms, regression.motion
    spread = regression.rows.target_deviation
    columns = [evaluate_terms(terms, points) for points in _points(motion)]
    heavy = np.flatnonzero(average.probability >= LEAST)
    total, found = 0.0, Alternatives(0.0)
    for k in heavy.tolist():
        other = fit.expanded(fit.given(average.models[k]))
        change = np.append(other.coef - shown.coef, other.intercept - shown.intercept)
        if not any(_root_mean_square(D @ change[:-1] + change[-1]) > tolerance * spread for D in columns):
            continue
        total += float(average.probability[k])
        if not found.probability:
            names = np.array([term.text for term in terms])
            enter = tuple(names[other.support & ~shown.support].tolist())
            leave = tuple(names[shown.support & ~other.support].tolist())
            found = Alternatives(total, enter, leave)
    return Alternatives(total, found.enter, found.leave)


def _points(motion: Motion) -> list[dict[str, Floats]]:
    """States and inputs at rows of the record, and each at rows of its own."""
    names = (*motion.roles.states, *motion.roles.drivers)
    whole = {name: np.concatenate([rows.columns[name] for rows in motion.train]) for name in names}
    rng = np.random.default_rng(SEED)
    rows = len(whole[names[0]])
    together = rng.integers(rows, size=POINTS)
    apart = {name: values[rng.integers(rows, size=POINTS)] for name, values in whole.items()}
    return [{name: values[together] for name, values in whole.items()}, apart]


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
