"""Geweke's joint distribution test (2004) of samplers of (z, theta, sigma^2).

A chain that draws y given theta and sigma^2, then one sample of the posterior given y, visits the prior. The chain is
a kernel, for the samplers would spend most of the time on being called from Python.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from bayeq.arrays import Bools, Floats
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.gibbs import sample_chain
from bayeq.inference.gram import Gram
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

N, P = 12, 3


@kernel
def _with_data(p: Problem, D: Floats, theta: Floats, variance: float, rng: np.random.Generator) -> Problem:
    y = np.empty(len(D))
    for i in range(len(D)):
        y[i] = math.sqrt(variance) * rng.standard_normal()
    y += D @ theta - y.mean()
    return Problem(
        p.columns,
        D.T @ y,
        float(np.dot(y, y)),
        p.dof,
        p.log_odds,
        p.size_prior,
        p.inclusion_beta,
        p.slab_variance,
        p.noise_shape,
        p.noise_rate,
        p.half_log_slab,
        p.h,
        p.floor,
    )


@kernel
def _visit(p: Problem, D: Floats, exchange: bool, rng: np.random.Generator, z: Bools, visited: Floats) -> None:
    terms = D.shape[1]
    theta, variance = np.zeros(terms), 1.5
    zs, thetas = np.empty((2, terms), dtype=np.bool_), np.empty((2, terms))
    noises, levels = np.empty(2), np.empty(2)
    for t in range(len(visited)):
        q = _with_data(p, D, theta, variance, rng)
        sample_chain(q, z, variance, 0, exchange, rng, zs, thetas, noises, levels, np.zeros(terms))
        # theta of row 1 was drawn given row 1's sigma^2 and z
        z[:] = zs[1]
        theta, variance = thetas[1].copy(), noises[1]
        for j in range(terms):
            visited[t, j], visited[t, terms + j] = z[j], theta[j]
        visited[t, 2 * terms] = math.log(variance)


def scores(exchange, sweeps):
    """Standardised differences of moments from those of the prior."""
    rng = np.random.default_rng(11)
    D = rng.normal(size=(N, P)) + 0.8 * rng.normal(size=(N, 1))
    D -= D.mean(axis=0)
    # a prior that can be drawn from; its floor is 2 b_sigma whatever y, which is small here
    blank = Problem.of(Gram.from_data(D, np.zeros(N)), Prior(2.0, 0.4, 3.0, 3.0))
    visited = np.empty((sweeps, 2 * P + 1))
    _visit(blank, np.ascontiguousarray(D), exchange, rng, rng.random(P) < 0.4, visited)
    z, theta = visited[:, :P], visited[:, P : 2 * P]
    samples = np.column_stack([visited, theta**2, z.sum(axis=1) ** 2])
    log_noise = float(stats.invgamma(3.0, scale=3.0).expect(np.log))
    # E theta^2 = p_0 v_s E sigma^2; the number of terms is binomial
    expected = [*[0.4] * P, *[0.0] * P, log_noise, *[0.4 * 2.0 * 1.5] * P, 3 * 0.4 * 0.6 + 1.44]
    batches = samples.reshape(50, -1, samples.shape[1]).mean(axis=1)
    return (batches.mean(axis=0) - expected) / (batches.std(axis=0, ddof=1) / math.sqrt(50))


@pytest.mark.statistical(short=4_000, full=200_000)
@pytest.mark.parametrize("exchange", [False, True], ids=["paper", "exchange"])
def test_the_joint_distribution_is_visited(exchange, number):
    # eleven tests of a t-distribution of 49 degrees of freedom: 4.2 is a family-wise error of one in a thousand
    assert np.max(np.abs(scores(exchange, number))) < 4.2
