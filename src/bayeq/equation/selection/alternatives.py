"""Alternative models that the posterior does not rule out, and terms that the record does not determine.

Models are compared at rows of the record, and at points that combine states and inputs from different rows: in a steady
sine, where displacement and velocity are always a quarter of a period apart, models may agree along the motion and
nowhere else.

A term that explains no more than the noise is not found, however large its coefficient could be: x**3 in a record of
small amplitude. Its bound limits the coefficient. The term could matter if adding it at its bound changes predictions:
in the record, or where states and inputs are ten times as large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.families import degree
from bayeq.expressions import Expression
from bayeq.expressions.parse import EARLIER
from bayeq.forecast.dynamics import normal_draws
from bayeq.inference.collapsed.path import DEPENDENT
from bayeq.inference.collapsed.slab import noise_given_model
from bayeq.inference.posterior import Posterior
from bayeq.numerics.distributions import Z95
from bayeq.numerics.settings import SELECTION
from bayeq.regression.fit import RegressionFit
from bayeq.states import Chain, Motion

# Models of less probability are left out; number of points at which the others are compared, and their random seed.
LEAST, POINTS, SEED = 1e-3, 1000, 0

# Amplitudes, over that of the record, at which a term is tried (twice is too small: x**3 of 1 % of the noise, whose
# bound is ten times the true coefficient, would not matter there); most rows at which it is tried.
AMPLITUDES, ROWS = (1.0, 10.0), 4000

# With more candidates there are no bounds: the missing rows of D'D would cost more than the search did.
MOST_TERMS = 2000

# Roots are the same if they differ by less than this many standard errors, which DRAWS draws of the coefficients give.
ERRORS, DRAWS = 3.0, 200


@dataclass(frozen=True)
class Alternatives:
    """Models whose predictions differ from those of the equation shown."""

    probability: float  # their total probability
    enter: tuple[str, ...] = ()  # terms that the likeliest of them adds to the equation shown
    leave: tuple[str, ...] = ()  # terms of the equation shown that it lacks


def alternatives_to(fit: RegressionFit, shown: Posterior, tolerance: float, exact: bool = True) -> Alternatives:
    """Models of the posterior whose predictions differ from those of the equation shown by more than a tolerance.

    If the law is `exact`, also models with other damping, which explains next to nothing, and yet decides how motion
    decays. `shown` is in original units and, where it is a projection, of the full model. `tolerance` is a root mean
    square difference, as a share of the target's standard deviation.
    """
    average = fit.posterior.average
    if average is None:
        return Alternatives(0.0)
    regression = fit.regression
    terms, motion = regression.design.terms, regression.motion
    spread = regression.rows.target_deviation
    points = _points(motion, terms)
    columns, odd = [evaluate_terms(terms, some) for some in points], _odd(fit, points[0])
    total, likeliest = 0.0, None
    for k in np.flatnonzero(average.probability >= LEAST).tolist():
        other = fit.expanded(fit.given(average.models[k]))
        change = np.append(other.coef - shown.coef, other.intercept - shown.intercept)
        differs = any(_root_mean_square(D @ change[:-1] + change[-1]) > tolerance * spread for D in columns)
        damped = sorted(_root_mean_square(odd @ one.coef) for one in (other, shown))
        otherwise = damped[0] > 0.0 and _root_mean_square(odd @ change[:-1]) > SELECTION.damping * damped[1]
        if not differs and not (exact and otherwise):
            continue
        total += float(average.probability[k])
        likeliest = other.support if likeliest is None else likeliest
    if likeliest is None:
        return Alternatives(0.0)
    enter, leave = (compress(terms, some) for some in (likeliest & ~shown.support, shown.support & ~likeliest))
    return Alternatives(total, tuple(term.text for term in enter), tuple(term.text for term in leave))


def _odd(fit: RegressionFit, points: dict[str, Floats]) -> Floats:
    """The part of each term that is odd in the velocities of oscillators, (rows, P); zero for other equations."""
    terms, roles = fit.regression.design.terms, fit.regression.motion.roles
    if fit.regression.chain.order < 2 or roles.discrete:
        return np.zeros((1, len(terms)))
    back = {chain.states[-1] for chain in roles.chains if chain.order > 1}
    turned = {name: -values if name in back else values for name, values in points.items()}
    with np.errstate(all="ignore"):
        return np.nan_to_num(0.5 * (evaluate_terms(terms, points) - evaluate_terms(terms, turned)))


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _samples(motion: Motion, terms: Sequence[Expression]) -> dict[str, Floats]:
    """States and inputs of all training rows, and targets that occur in terms."""
    held = [name for name in motion.roles.targets if any(name in term.names for term in terms)]
    names = (*motion.roles.states, *motion.roles.drivers, *held)
    return {name: np.concatenate([rows.columns[name] for rows in motion.train]) for name in names}


def _points(motion: Motion, terms: Sequence[Expression]) -> list[dict[str, Floats]]:
    """States and inputs at random rows of the record, and at points with each channel from a random row of its own."""
    whole, rng = _samples(motion, terms), np.random.default_rng(SEED)
    rows = len(next(iter(whole.values())))
    together = rng.integers(rows, size=POINTS)
    apart = {name: values[rng.integers(rows, size=POINTS)] for name, values in whole.items()}
    return [{name: values[together] for name, values in whole.items()}, apart]


def bounds(fit: RegressionFit) -> Floats | None:
    """Upper bounds (P,) on the magnitude of each coefficient if its term were added, with 95 % probability or more.

    NaN for terms that are included or depend on these, are tied to others by equalities, or are candidates of other
    equations only. None for more than `MOST_TERMS` candidates.
    """
    problem, support, kept = fit.problem, fit.posterior.support, fit.constraints.equalities.kept
    if len(support) > MOST_TERMS:
        return None
    DtD, inside, others = problem.DtD, np.flatnonzero(support), np.flatnonzero(~support)
    shrink = 1.0 / problem.slab_variance
    A = DtD[np.ix_(inside, inside)] + shrink * np.eye(len(inside))
    carried = np.linalg.solve(A, DtD[np.ix_(inside, others)])
    left = np.diagonal(DtD)[others] + shrink - np.einsum("ij,ij->j", DtD[np.ix_(inside, others)], carried)
    dependent = left - shrink < DEPENDENT * np.diagonal(DtD)[others]  # on the included terms
    left = np.maximum(left, shrink)
    mean = (problem.Dty[others] - problem.Dty[inside] @ carried) / left
    sd = np.sqrt(noise_given_model(problem, support) / left)
    out = np.full(len(fit.posterior.names), np.nan)
    out[others] = np.where(dependent, np.nan, np.abs(mean) + Z95 * sd)
    whole = np.full(len(fit.regression.design.terms), np.nan)
    whole[kept] = out * fit.standard.target_scale / fit.standard.scale
    whole[~fit.regression.design.allowed[fit.regression.k]] = np.nan
    return whole


@np.errstate(all="ignore")  # exp(x) at ten times a large x is infinite, and changes predictions
def undetermined(fit: RegressionFit, found: Posterior, bound: Floats | None) -> tuple[str, ...]:
    """Terms that, at their bound, could change predictions by more than a tolerance; the simplest first.

    With such a term the included ones have other coefficients, which compensate for it in the record.
    """
    if bound is None or len(fit.constraints.equalities.eliminated):
        return ()
    gram, inside = fit.regression.gram, np.flatnonzero(found.support)
    others = np.flatnonzero(np.isfinite(bound))
    terms = [fit.regression.design.terms[j] for j in (*inside, *others)]
    unit = 1.0 / np.sqrt(np.diagonal(gram.DtD))
    scaled = gram.DtD * unit[:, None] * unit
    share = np.linalg.lstsq(scaled[np.ix_(inside, inside)], scaled[np.ix_(inside, others)], rcond=1e-12)[0]
    share = share * unit[inside][:, None] / unit[others]
    constant = gram.mean[others] - gram.mean[inside] @ share
    effect = np.zeros(len(others))
    roles, whole = fit.regression.motion.roles, _samples(fit.regression.motion, terms)
    step = max(1, len(next(iter(whole.values()))) // ROWS)
    some = {name: values[::step] for name, values in whole.items()}
    for amplitude in AMPLITUDES:
        columns = some | {name: amplitude * some[name] for name in (*roles.states, *roles.inputs)}  # but not the time
        D = evaluate_terms(terms, columns)
        known, added = D[:, : len(inside)], D[:, len(inside) :]
        spread = float(np.std(known @ found.coef[inside])) if len(inside) else 0.0
        spread = max(spread, fit.regression.rows.target_deviation)
        change = added - known @ share - constant
        effect = np.maximum(effect, bound[others] * np.sqrt(np.mean(change**2, axis=0)) / spread)
    found_terms = terms[len(inside) :]
    order = sorted(
        np.flatnonzero(effect > SELECTION.tolerance).tolist(),
        key=lambda k: (found_terms[k].size, degree(found_terms[k]), -effect[k]),
    )
    return tuple(found_terms[k].text for k in order)


def common_root(chain: Chain, terms: Sequence[Expression], shown: Posterior) -> complex | None:
    """A root p of a linear map A(z) x = B(z) u that is one of B as well, within its error; None if there is none.

    ``(1 - p/z)`` on both sides leaves the motion as it is: an equation with fewer earlier samples has the same. Noise
    of a white input acts as a moving average of the residual, and such a factor makes it white (Ljung, System
    Identification, 1999, section 4.2): it then has a high probability. A root at zero is a delay.
    """
    inside = list(compress(terms, shown.support))
    if not chain.discrete or not all(term.text in term.names for term in inside):
        return None
    names = [term.text for term in inside]
    parts = [(one["name"], int(one["back"])) if (one := EARLIER.fullmatch(name)) else (name, 0) for name in names]
    own = chain.target.removesuffix("[+1]")
    channels = [own, *dict.fromkeys(name for name, _ in parts if name != own)]

    def roots(coef: Floats) -> list[Any]:
        """Roots of the polynomial of each channel, in z."""
        out = []
        for channel in channels:
            there = {back: c for (name, back), c in zip(parts, coef.tolist(), strict=True) if name == channel}
            polynomial = [there.get(back, 0.0) for back in range(max(there, default=-1) + 1)]
            out.append(np.roots([1.0, *(-c for c in polynomial)] if channel == own else np.trim_zeros(polynomial, "f")))
        return out

    coef = shown.coef[shown.support]
    poles, *others = roots(coef)
    if not others or not all(map(len, others)):
        return None
    drawn = [roots(one) for one in normal_draws(coef, shown.covariance, DRAWS, np.random.default_rng(0))]
    for pole in poles[np.abs(poles) > 0.0]:
        zeros = [_nearest(one, pole) for one in others]
        apart = pole - np.array(zeros)
        others_apart = np.array(
            [
                [_nearest(own, pole) - _nearest(z, zero) for z, zero in zip(rest, zeros, strict=True)]
                for own, *rest in drawn
            ]
        )
        if (np.abs(apart) < ERRORS * np.sqrt(np.mean(np.abs(others_apart - apart) ** 2, axis=0))).all():
            return complex(pole)
    return None


def _nearest(roots: Any, to: complex) -> complex:
    return complex(roots[np.abs(roots - to).argmin()]) if len(roots) else complex(np.inf)
