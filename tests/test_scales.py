"""Slabs of several scales against the sum over all scales of all terms, written out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import logsumexp

from bayeq.gram import Gram
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.prior import Prior
from bayeq.likelihood.scales import SCALES, gains

# As many rows as make the noise's variance of 1 known.
ROWS = 1e9


def gaussian_evidence(A, b, variances):
    """ln of the integral of exp(b't - t'At/2) over t ~ N(0, diag(variances))."""
    H = A + np.diag(1.0 / variances)
    return 0.5 * (b @ np.linalg.solve(H, b) - np.linalg.slogdet(H)[1] - np.log(variances).sum())


def by_all_scales(A, b):
    """What a mixture of slabs adds to the evidence of one: a sum over the scales of each term."""
    values = [gaussian_evidence(A, b, np.square(scales)) for scales in itertools.product(SCALES, repeat=len(b))]
    return logsumexp(values) - len(b) * np.log(len(SCALES)) - gaussian_evidence(A, b, np.ones(len(b)))


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.95])
@pytest.mark.parametrize("weak", [0.0, 0.004, 0.02, 0.1])
def test_is_the_sum_over_scales(weak, correlation):
    # a strong term, a weak one that is correlated with it, and another
    C = np.array([[1.0, correlation, 0.0], [correlation, 1.0, 0.2], [0.0, 0.2, 1.0]])
    A = 4000.0 / 0.05**2 * C
    truth = np.array([0.8, weak, -0.3])
    b = A @ truth + np.linalg.cholesky(A) @ np.random.default_rng(1).normal(size=3)
    gram = Gram(("x", "y", "z"), ROWS, np.zeros(3), 0.0, A, b, float(b @ np.linalg.solve(A, b)) + ROWS, ROWS)
    models = np.array([[1, 1, 1], [1, 0, 1], [0, 1, 0], [0, 0, 0]], dtype=bool)
    problem = Problem.of(gram, Prior(slab_variance=1.0))
    found = gains(problem, models, np.ones(3, dtype=bool))
    for one, model in zip(found, models, strict=True):
        inside = np.flatnonzero(model)
        assert one == pytest.approx(by_all_scales(A[np.ix_(inside, inside)], b[inside]), abs=0.05)


def test_a_weak_term_gains_what_a_strong_one_does_not():
    A = np.array([[1e6]])
    gain = [by_all_scales(A, A @ np.array([size])) for size in (0.005, 0.05, 1.0)]
    assert gain[0] > gain[1] > 0.0 > gain[2] > -np.log(3.0) - 0.1
