"""Slabs of several scales: a weak term is not refused for being small, nor are terms shrunk that cancel each other.

Models are listed, and fitted, with one wide slab. With a mixture of slabs in its place the evidence of a model changes
by the posterior mean of the ratio of both priors, an identity; the mean of the product over the model's terms is taken
as the product of means, which is exact where all but one of these ratios hardly change over the posterior.
"""

from __future__ import annotations

import numpy as np

from bayeq.inference.collapsed.problem import Bools, Floats, Ints, Problem
from bayeq.inference.collapsed.tableau import drifted, flip, renew, swept
from bayeq.kernels import kernel

__all__ = ["SCALES", "SLAB", "gains"]

# A coefficient that is not zero has a prior variance by which its term explains this many times the variance of the
# target: terms may cancel each other. Of 1, 3, 5 and 10, those above 1 found Lorenz's equations most often.
SLAB = 5.0

# Standard deviations of the slabs as shares of that one's, of equal probability: effects of 2.2, 0.2 and 0.02 of the
# target's standard deviation.
SCALES: tuple[float, ...] = (1.0, 0.2 / SLAB**0.5, 0.02 / SLAB**0.5)

# The first of these are of effects larger than any function that a law may lack.
LARGE = 2


@kernel
def _gains(p: Problem, models: Bools, scales: Floats, first: Ints) -> Floats:
    """What the mixture adds to the log evidence of each model, (K,)."""
    out, terms = np.zeros(len(models)), len(p.Dty)
    current = np.zeros(terms, np.bool_)
    T = swept(p, current)
    for k in range(len(models)):
        for j in range(terms):
            if models[k, j] != current[j]:
                flip(p, T, j)
                current[j] = not current[j]
        if drifted(p, T):
            renew(p, T, current)
        noise = 0.5 * max(T.diagonal[terms], p.floor) / max(p.h - 1.0, 0.5)
        for m in range(T.size[0]):
            a = T.term[m]
            mean, variance = T.partial[a], -noise * T.diagonal[a]
            total = 0.0
            for i in range(first[a]):
                excess = 1.0 / scales[i] ** 2 - 1.0
                wider = 1.0 + variance * excess
                total += np.exp(-0.5 * mean * mean * excess / wider) / (scales[i] * np.sqrt(wider))
            out[k] += np.log(total / len(scales))
    return out


def gains(problem: Problem, models: Bools, exact: Bools) -> Floats:
    """What slabs of several scales add to the log evidence of models (K, P) with the wide slab, (K,).

    `exact` (P,) tells which terms are of exact laws; an effect as small as a function that a law may lack is no term's.
    """
    # in the order of their bits, so that few flips lead from one to the next
    order = np.lexsort(np.packbits(models, axis=1).T)
    out = np.empty(len(models))
    out[order] = _gains(problem, models[order], np.array(SCALES), np.where(exact, len(SCALES), LARGE))
    return out
