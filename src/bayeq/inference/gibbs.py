"""The collapsed Gibbs sampler, eqs. (33)-(34), on the tableau.

Each z_i is drawn from its conditional with theta and sigma^2 integrated out: the log-odds of a flip are O(1)
on the tableau, a flip is one rank-one update. sigma^2 | y, z is inverse-Gamma and theta | y, z, sigma^2 Gaussian,
both read off the same tableau.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import InputError
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import greedy_start
from bayeq.inference.collapsed.slab import given_model
from bayeq.inference.collapsed.tableau import (
    LOOK,
    Tableau,
    data_gain,
    drifted,
    expit,
    flip,
    renew,
    residual_sum,
    score,
    size_gains,
    swap_gains,
    swept,
)
from bayeq.inference.gram import GramLike
from bayeq.inference.posterior import Averaged, Details, Draws, Posterior, of_standardised
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

# Multivariate R-hat below which chains count as converged (the paper, section 4), and most coefficients in it.
RHAT_LIMIT = 1.1
MOST_IN_RHAT = 200

# Largest number of terms in the model that a chain starts from.
MOST_AT_START = 30.0


@kernel
def draw_theta(T: Tableau, active: Bools, variance: float, rng: np.random.Generator, out: Floats) -> None:
    """Draw theta_r ~ N(a_r, sigma^2 A_r) into `out`, zero elsewhere, by a Cholesky factor of A_r = -M_rr."""
    index = np.flatnonzero(active)
    r = len(index)
    L = np.empty((r, r))
    for a in range(r):
        for b in range(a + 1):
            value = -T.rows[T.row[index[a]], index[b]]
            for k in range(b):
                value -= L[a, k] * L[b, k]
            L[a, b] = math.sqrt(max(value, 0.0)) if a == b else value / L[b, b] if L[b, b] > 0.0 else 0.0
    out[:] = 0.0
    noise = rng.standard_normal(r)
    scale = math.sqrt(variance)
    for a in range(r):
        value = T.partial[index[a]]
        for k in range(a + 1):
            value += scale * L[a, k] * noise[k]
        out[index[a]] = value


@kernel
def _scan(p: Problem, T: Tableau, active: Bools, rng: np.random.Generator, inclusion: Floats) -> None:
    """One sweep over the indicators in order; writes p(z_i = 1 | z_-i, y)."""
    diagonal, partial, log_odds, floor, h = T.diagonal, T.partial, p.log_odds, p.floor, p.h
    enters, leaves = size_gains(p, T)
    for j in range(len(active)):
        if math.isinf(log_odds[j]):
            inclusion[j] = 1.0 if active[j] else 0.0
            continue
        gain = data_gain(diagonal[j], partial[j], diagonal[-1], floor, h)
        gain += leaves - log_odds[j] if active[j] else enters + log_odds[j]
        inside = expit(-gain if active[j] else gain)
        inclusion[j] = inside
        if (rng.random() < inside) != active[j]:
            flip(p, T, j)
            active[j] = not active[j]
            enters, leaves = size_gains(p, T)


@kernel
def exchange_terms(p: Problem, T: Tableau, active: Bools, rng: np.random.Generator, weight: Floats) -> None:
    """Draw which term replaces a random active one.

    The model without term i is kept, and the term that completes it is drawn from its conditional among i and all
    inactive ones: reversible, for i is drawn uniformly. It carries a chain between models that differ by a swap of
    correlated terms.
    """
    terms = len(active)
    candidates = np.flatnonzero(active & np.isfinite(p.log_odds))
    if len(candidates) == 0:
        return
    leaves = candidates[int(rng.random() * len(candidates))]
    swap_gains(p, T, leaves, -math.inf, weight)
    top = max(0.0, weight.max())
    total = math.exp(-top)
    for j in range(terms):
        weight[j] = math.exp(weight[j] - top)
        total += weight[j]
    left = rng.random() * total - math.exp(-top)
    if left < 0.0:
        return
    for j in range(terms):
        left -= weight[j]
        if left < 0.0:
            flip(p, T, leaves)
            flip(p, T, j)
            active[leaves] = False
            active[j] = True
            return


# One kernel runs a whole chain: its state, and the arrays that it fills, are all passed in.
@kernel
def sample_chain(
    p: Problem,
    active: Bools,
    variance: float,
    burn_in: int,
    exchange: bool,
    rng: np.random.Generator,
    z: Bools,
    theta: Floats,
    noise: Floats,
    log_posterior: Floats,
    pip: Floats,
) -> None:
    """Run one chain from the model `active` (changed in place) and the noise variance `variance`.

    One sample is theta | sigma^2, z, then sigma^2 | z, then z (by a scan of flips, and with `exchange` by
    `exchange_terms` before); after `burn_in` of them the rows of z (S, P), theta (S, P), noise (S,) and log_posterior
    (S,) are filled and pip (P,) summed up.
    """
    terms = len(active)
    inclusion = np.empty(terms)
    draw = np.empty(terms)
    T = swept(p, active)
    for t in range(burn_in + len(noise)):
        s = max(T.diagonal[terms], p.floor)
        if t > 0:
            variance = 0.5 * s / rng.standard_gamma(p.h)
        draw_theta(T, active, variance, rng, draw)
        k = t - burn_in
        if k >= 0:
            z[k] = active
            theta[k] = draw
            noise[k] = variance
            log_posterior[k] = score(p, active, p.slab_variance)
        if exchange:
            exchange_terms(p, T, active, rng, draw)
        _scan(p, T, active, rng, inclusion)
        if k >= 0:
            pip += inclusion
        if t % LOOK == 0 and drifted(p, T):
            renew(p, T, active)


def sample_posterior(
    problem: Problem,
    *,
    chains: int = 4,
    samples: int = 5000,
    burn_in: int = 1000,
    exchange: bool = True,
    seed: int | Sequence[int] = 0,
) -> Draws:
    """Draws of z, theta and sigma^2 from independent chains, each with its own random stream.

    The first `burn_in` of each chain's `samples` are discarded, as in the paper. With `exchange` a term may also be
    exchanged for another in one step. InputError: no chains, or no samples after the burn-in.
    """
    if chains < 1 or burn_in < 0 or samples <= burn_in:
        raise InputError(f"need chains >= 1 and samples > burn_in >= 0, got {chains}, {samples}, {burn_in}")
    terms, kept = len(problem.Dty), samples - burn_in
    z = np.empty((chains, kept, terms), dtype=np.bool_)
    theta, pip = np.empty((chains, kept, terms)), np.zeros((chains, terms))
    noise, levels = np.empty((chains, kept)), np.empty((chains, kept))
    finite = problem.log_odds[np.isfinite(problem.log_odds)]
    # as many terms as the prior expects, as in the paper, but not so many that they would fit anything
    expected = min(float(np.sum(1.0 / (1.0 + np.exp(-finite)))), max(0.1 * problem.dof, 5.0), MOST_AT_START)
    start = greedy_start(problem, max(1, round(expected)))
    nominal = max(residual_sum(problem), problem.floor) / max(problem.dof - terms, 1.0)
    try:
        root = np.random.SeedSequence(seed)
    except (TypeError, ValueError) as error:
        raise InputError(f"a seed is a whole number, 0 or more (or a sequence of them), not {seed!r}") from error
    for k, stream in enumerate(root.spawn(chains)):
        rng = np.random.Generator(np.random.PCG64(stream))
        variance = nominal * math.exp(0.1 * rng.standard_normal())
        samples_of_chain = z[k], theta[k], noise[k], levels[k], pip[k]
        sample_chain(problem, start.copy(), variance, burn_in, exchange, rng, *samples_of_chain)
    return Draws(z=z, theta=theta, noise_variance=noise, log_posterior=levels, pip=pip / kept)


def multivariate_rhat(theta: Floats) -> float:
    """Multivariate potential scale reduction factor of m >= 2 chains of n samples, (m, n, P); 1 if nothing varies.

    The square root of (n-1)/n + (m+1)/m lambda, lambda the largest eigenvalue of W^-1 B/n, with W the mean covariance
    within the chains and B/n that of their means (Brooks and Gelman 1998, section 4.1; the square root as in R's coda).
    It is computed for at most 200 coefficients, those that are nonzero most often.
    """
    m, n, _ = theta.shape
    often = np.count_nonzero(theta, axis=(0, 1))
    # in a large dictionary, the terms that are in most often
    chosen = np.sort(np.argsort(-often, kind="stable")[: min(int((often > 0).sum()), MOST_IN_RHAT)])
    theta = theta[:, :, chosen]
    if m < 2 or n < 2 or theta.shape[2] == 0:
        return 1.0
    means = theta.mean(axis=1)
    centred = theta - means[:, None, :]
    rows = centred.reshape(m * n, -1)
    within = rows.T @ rows / (m * (n - 1))
    between = np.atleast_2d(np.cov(means, rowvar=False))
    sd = np.sqrt(np.diagonal(within))
    if np.any((sd == 0.0) & (np.diagonal(between) > 0.0)):
        return math.inf
    kept = sd > 0.0
    if not kept.any():
        return 1.0
    scale = np.outer(sd[kept], sd[kept])
    values, vectors = np.linalg.eigh(within[np.ix_(kept, kept)] / scale)
    # directions in which the samples never move (a pair always in and out together, in one ratio) say nothing
    moving = values > 1e-10 * values[-1]
    root = vectors[:, moving] / np.sqrt(values[moving])
    largest = np.linalg.eigvalsh(root.T @ (between[np.ix_(kept, kept)] / scale) @ root)[-1]
    return float(math.sqrt((n - 1) / n + (m + 1) / m * max(float(largest), 0.0)))


def spike_slab_gibbs(
    gram: GramLike,
    prior: Prior | None = None,
    *,
    chains: int = 4,
    samples: int = 5000,
    burn_in: int = 1000,
    exchange: bool = True,
    seed: int | Sequence[int] = 0,
    keep_draws: bool = True,
) -> Posterior:
    """Posterior of a standardised Gram by collapsed Gibbs sampling; the spike-and-slab prior is the paper's by default.

    The chains are those of `sample_posterior`. `pip` is Rao-Blackwellised: the mean of p(z_i = 1 | z_-i, y) over the
    samples. Coefficients and covariance are those of the median probability model, exact given the model; `averaged` is
    over all samples. `converged` says whether the multivariate R-hat is below 1.1. InputError: options or prior
    parameters out of range, or known signs.
    """
    prior = prior or Prior()
    prior.refuse_signs("gibbs")
    problem = Problem.of(gram, prior)
    draws = sample_posterior(problem, chains=chains, samples=samples, burn_in=burn_in, exchange=exchange, seed=seed)
    pip = draws.pip.mean(axis=0)
    support = pip > 0.5
    coef, covariance = given_model(problem, support)
    rhat = multivariate_rhat(draws.theta)
    details = Details("gibbs", samples, rhat < RHAT_LIMIT, problem.slab_variance, rhat=rhat)
    mean, sd = draws.theta.mean(axis=(0, 1)), draws.theta.std(axis=(0, 1))
    averaged = Averaged(mean, sd, draws=draws if keep_draws else None)
    noise = draws.noise_variance.mean()
    return of_standardised(gram, pip, support, coef, covariance, noise, details, averaged)
