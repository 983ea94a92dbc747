"""Slabs of several scales: a weak term is not refused for being small, nor are terms shrunk that cancel each other.

Models are listed, and fitted, with one wide slab. With a mixture of slabs in its place the evidence of a model changes
by the posterior mean of the ratio of both priors, an identity; the mean of the product over the model's terms is taken
as the product of means, which is exact where all but one of these ratios hardly change over the posterior.
"""

from __future__ import annotations

import numpy as np

from bayeq.inference.collapsed.problem import Bools, Floats, Problem
from bayeq.inference.collapsed.tableau import drifted, flip, renew, swept
from bayeq.kernels import kernel

__all__ = ["SCALES", "gains"]

# Standard deviations of the slabs as shares of the wide one's, of equal probability: effects of 2.2, 0.2 and 0.02 of
# the target's standard deviation.
SCALES = (1.0, 0.09, 0.009)


@kernel
def _gains(p: Problem, models: Bools, excess: Floats, log_scales: Floats) -> Floats:
    """What the mixture adds to the log evidence of each model, (K,); `excess` is 1/scale^2 - 1."""
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
            for i in range(len(excess)):
                wider = 1.0 + variance * excess[i]
                total += np.exp(-log_scales[i] - 0.5 * mean * mean * excess[i] / wider) / np.sqrt(wider)
            out[k] += np.log(total / len(excess))
    return out


def gains(problem: Problem, models: Bools) -> Floats:
    """What slabs of several scales add to the log evidence of models (K, P) with the wide slab, (K,)."""
    scales = np.array(SCALES)
    # in the order of their bits, so that few flips lead from one to the next
    order = np.lexsort(np.packbits(models, axis=1).T)
    out = np.empty(len(models))
    out[order] = _gains(problem, models[order], scales**-2.0 - 1.0, np.log(scales))
    return out
