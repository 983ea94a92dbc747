"""What the coefficients of terms that are not included could be, and which of these terms could matter.

A term that explains no more than the noise is not found, however large its coefficient could be: x**3 in a record of
small amplitude. Its bound tells how large. It could matter if the equation with the term, at its bound, predicts
otherwise than without: in the record, or where states and inputs are ten times as large.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayeq.dictionary import evaluate_terms
from bayeq.dictionary.polynomial import degree
from bayeq.inference.collapsed.conditional import noise_given_model
from bayeq.inference.collapsed.problem import all_rows
from bayeq.inference.posterior import Posterior
from bayeq.numerics.normal import Z95
from bayeq.regression.fit import RegressionFit
from bayeq.selection.tolerance import TOLERANCE

__all__ = ["bounds", "undetermined"]

Floats = NDArray[np.float64]

# Amplitudes, over that of the record, at which a term could matter: x**3 of 1 % of the noise, whose bound is ten times
# the true coefficient, does not at twice that amplitude. And rows at which that is judged, at most.
AMPLITUDES, ROWS = (1.0, 10.0), 4000

# With more candidates the other rows of D'D would cost more than the search has.
MOST_TERMS = 2000


def bounds(fit: RegressionFit) -> Floats | None:
    """Below what the size of each coefficient is, with a probability of 95 % or more, were its term added.

    The end of the 95 % interval that is further from zero, of the included terms and this one.

    Returns
    -------
    (P,) array or None
        In original units; NaN for terms that are included, tied to others by equalities, or candidates of other
        equations only. None of very many.
    """
    problem, support, kept = fit.problem, fit.posterior.support, fit.constraints.equalities.kept
    if len(support) > MOST_TERMS:
        return None
    DtD, inside, others = all_rows(problem.columns), np.flatnonzero(support), np.flatnonzero(~support)
    shrink = 1.0 / problem.slab_variance
    A = DtD[np.ix_(inside, inside)] + shrink * np.eye(len(inside))
    carried = np.linalg.solve(A, DtD[np.ix_(inside, others)])
    left = np.diagonal(DtD)[others] + shrink - np.einsum("ij,ij->j", DtD[np.ix_(inside, others)], carried)
    left = np.maximum(left, shrink)
    mean = (problem.Dty[others] - problem.Dty[inside] @ carried) / left
    sd = np.sqrt(noise_given_model(problem, support) / left)
    out = np.full(len(fit.posterior.names), np.nan)
    out[others] = np.abs(mean) + Z95 * sd
    whole = np.full(len(fit.regression.design.terms), np.nan)
    whole[kept] = out * fit.standard.target_scale / fit.standard.scale
    whole[~fit.regression.design.allowed[fit.regression.k]] = np.nan
    return whole


def undetermined(fit: RegressionFit, found: Posterior, bound: Floats | None) -> tuple[str, ...]:
    """Terms that, at their bound, could change predictions by more than a tolerance; the simplest first.

    With such a term the included ones have other coefficients, those that make up for it in the record.

    Parameters
    ----------
    fit : RegressionFit
        Without equalities between coefficients.
    found : Posterior
        In original units, of the included terms.
    bound : (P,) array or None
        From `bounds`.
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
    clock = {*fit.regression.motion.roles.drivers}.difference(fit.regression.motion.roles.inputs)
    for amplitude in AMPLITUDES:
        columns = {name: values if name in clock else amplitude * values for name, values in _some_rows(fit).items()}
        D = evaluate_terms(terms, columns)
        known, added = D[:, : len(inside)], D[:, len(inside) :]
        spread = float(np.std(known @ found.coef[inside])) if len(inside) else 0.0
        spread = max(spread, fit.regression.rows.target_deviation)
        change = added - known @ share - constant
        effect = np.maximum(effect, bound[others] * np.sqrt(np.mean(change**2, axis=0)) / spread)
    found_terms = terms[len(inside) :]
    order = sorted(
        np.flatnonzero(effect > TOLERANCE).tolist(),
        key=lambda k: (found_terms[k].size, degree(found_terms[k]), -effect[k]),
    )
    return tuple(found_terms[k].text for k in order)


def _some_rows(fit: RegressionFit) -> dict[str, Floats]:
    """States and inputs of training rows spread over the records."""
    motion = fit.regression.motion
    names = (*motion.roles.states, *motion.roles.drivers)
    whole = {name: np.concatenate([rows.columns[name] for rows in motion.train]) for name in names}
    step = max(1, len(whole[names[0]]) // ROWS)
    return {name: values[::step] for name, values in whole.items()}
