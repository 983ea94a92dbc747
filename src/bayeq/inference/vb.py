"""Variational Bayes with spike-and-slab priors, eqs. (17)-(28).

q(theta) q(sigma^2) prod q(z_i) with a full covariance for theta. The order of the updates matters: Sigma and mu
(from w), then b and tau, then the ELBO, then the w_i one at a time. Only in this order is the simplified ELBO
(28) exact, and the ascent monotone. Eq. (28) prints a ln Gamma(b) where its derivation gives a ln b.

A term with w_i = 0 decouples (mu_i = 0, Sigma_ii = v_s/tau), so the algebra runs over the active terms only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError, whole_number
from bayeq.inference.collapsed.problem import Problem, fetch
from bayeq.inference.collapsed.search import RVM_START_TERMS, candidate_models, default_starts, greedy_model, neighbours
from bayeq.inference.collapsed.tableau import GAIN_TOLERANCE, expit
from bayeq.inference.gram import GramLike
from bayeq.inference.posterior import Details, Posterior, of_standardised
from bayeq.inference.prior import Prior
from bayeq.inference.rvm import rvm_gamma
from bayeq.kernels import kernel

# Returned by `vb_ascent`: mu, Sigma of the active terms, their indices, a, b, ELBO trace.
Ascent = tuple[Floats, Floats, Ints, float, float, Floats]

# VB restarts from this many flips and swaps, the best, that improve the model at its optimum.
RETESTS = 4

# Noise precision that goes with the RVM's start (the paper's section 3.2).
RVM_PRECISION = 1000.0

# Below this log-odds (w = 1e-20) a term counts as out: exp underflows soon after, and w = 0 is exact.
ETA_OUT = -46.0


@kernel
def _factorise(A: Floats, C: Floats) -> float:
    """C = A^-1 by Cholesky (A is overwritten); returns ln|A|, or NaN if A is not positive definite."""
    r = A.shape[0]
    logdet = 0.0
    # A = U'U; all three parts run along rows
    for j in range(r):
        own = A[j]
        if not own[j] > 0.0:
            return math.nan
        root = math.sqrt(own[j])
        logdet += 2.0 * math.log(root)
        for k in range(j, r):
            own[k] /= root
        for i in range(j + 1, r):
            factor, row = own[i], A[i]
            for k in range(i, r):
                row[k] -= factor * own[k]
    # C = U'^-1
    for i in range(r):
        for j in range(r):
            C[i, j] = 0.0
    for i in range(r):
        row, pivot = C[i], A[i, i]
        for k in range(i):
            factor, other = A[k, i], C[k]
            for j in range(k + 1):
                row[j] -= factor * other[j]
        for j in range(i):
            row[j] /= pivot
        row[i] = 1.0 / pivot
    # A^-1 = C'C
    for i in range(r):
        for j in range(r):
            A[i, j] = 0.0
    for k in range(r):
        other = C[k]
        for i in range(k + 1):
            factor, row = other[i], A[i]
            for j in range(i + 1):
                row[j] += factor * other[j]
    for i in range(r):
        for j in range(i + 1):
            C[i, j] = A[i, j]
            C[j, i] = A[i, j]
    return logdet


@kernel
def _indicator_bound(w: Floats, log_odds: Floats) -> float:
    """Sum of w ln(p0/w) + (1-w) ln((1-p0)/(1-w)): minus the divergence of q(z) from its prior."""
    total = 0.0
    for i in range(len(w)):
        if w[i] > 0.0:
            log_in = 0.0 if log_odds[i] == math.inf else -math.log1p(math.exp(-log_odds[i]))
            total += w[i] * (log_in - math.log(w[i]))
        if w[i] < 1.0:
            log_out = 0.0 if log_odds[i] == -math.inf else -math.log1p(math.exp(log_odds[i]))
            total += (1.0 - w[i]) * (log_out - math.log1p(-w[i]))
    return total


@kernel
def _digamma(x: float) -> float:
    """Derivative of ln Gamma at x > 0: recurrence up to x >= 6, then the asymptotic series (error below 1e-11)."""
    value = 0.0
    while x < 6.0:
        value -= 1.0 / x
        x += 1.0
    t = 1.0 / (x * x)
    series = t * (1.0 / 12.0 - t * (1.0 / 120.0 - t * (1.0 / 252.0 - t * (1.0 / 240.0 - t / 132.0))))
    return value + math.log(x) - 0.5 / x - series


@kernel
def _inclusion_rate(p: Problem, w: Floats, log_odds: Floats) -> float:
    """q(p_0) = Beta(a', b') = Beta(a + sum w, b + sum(1 - w)): fills `log_odds` of free terms, E ln p_0 - E ln(1-p_0).

    Returns the contribution of p(z | p_0) p(p_0) to the ELBO: ln B(a', b') - ln B(a, b).
    """
    a, b = p.inclusion_beta[0], p.inclusion_beta[1]
    new_a, new_b = a, b
    for i in range(len(w)):
        if not math.isinf(p.log_odds[i]):
            new_a += w[i]
            new_b += 1.0 - w[i]
    value = _digamma(new_a) - _digamma(new_b)
    for i in range(len(w)):
        log_odds[i] = p.log_odds[i] if math.isinf(p.log_odds[i]) else value
    bound = math.lgamma(new_a) + math.lgamma(new_b) - math.lgamma(new_a + new_b)
    return bound - math.lgamma(a) - math.lgamma(b) + math.lgamma(a + b)


@kernel
def _entropy(w: Floats) -> float:
    total = 0.0
    for i in range(len(w)):
        if 0.0 < w[i] < 1.0:
            total -= w[i] * math.log(w[i]) + (1.0 - w[i]) * math.log1p(-w[i])
    return total


@kernel
def _update_indicators(
    p: Problem, log_odds: Floats, w: Floats, index: Ints, mu: Floats, C: Floats, tau_old: float, tau: float
) -> None:
    """Eqs. (25)-(26) for each term in turn, with the newest w of the others."""
    position = np.full(len(w), -1, np.int64)
    rows, slot = p.columns.rows, p.columns.slot
    for a in range(len(index)):
        position[index[a]] = a
    for i in range(len(w)):
        if math.isinf(p.log_odds[i]):
            continue
        a = position[i]
        if a < 0:
            eta = log_odds[i] - 0.5 * tau * p.slab_variance / tau_old * p.columns.diagonal[i]
        else:
            own = rows[slot[i]]
            eta = log_odds[i] - 0.5 * tau * (mu[a] * mu[a] + C[a, a] / tau_old) * own[i]
            cross = mu[a] * p.Dty[i]
            for b in range(len(index)):
                if b != a:
                    cross -= w[index[b]] * own[index[b]] * (mu[a] * mu[b] + C[a, b] / tau_old)
            eta += tau * cross
        w[i] = 0.0 if eta < ETA_OUT else expit(eta)


@kernel
def vb_ascent(p: Problem, w: Floats, tau: float, tolerance: float, max_iter: int) -> Ascent:
    """Coordinate ascent of the ELBO from probabilities `w` (changed in place) and noise precision `tau` (0: best).

    Returns mu (P,), Sigma of the active terms, their indices, a, b and the ELBO trace, empty if D'D is indefinite.
    """
    terms = len(w)
    shape = p.noise_shape + 0.5 * p.dof + 0.5 * terms
    trace = np.empty(max_iter)
    steps = 0
    for i in range(terms):
        if p.log_odds[i] == math.inf:
            w[i] = 1.0
        elif p.log_odds[i] == -math.inf:
            w[i] = 0.0
    log_odds, index = p.log_odds.copy(), np.empty(terms, np.int64)
    rows, slot = p.columns.rows, p.columns.slot
    while True:
        r = 0
        for i in range(terms):
            if w[i] > 0.0:
                index[r] = i
                r += 1
        A, C, mu = np.empty((r, r)), np.empty((r, r)), np.empty(r)
        for a in range(r):
            i = index[a]
            if slot[i] < 0:
                fetch(p.columns, i)
            own = rows[slot[i]]
            for b in range(a):
                A[a, b] = w[i] * w[index[b]] * own[index[b]]
                A[b, a] = A[a, b]
            A[a, a] = w[i] * own[i] + 1.0 / p.slab_variance
        logdet = _factorise(A, C)
        if math.isnan(logdet):
            return log_odds, C, index[:r], shape, math.nan, trace[:0]
        explained = 0.0
        for a in range(r):
            mu[a] = 0.0
            for b in range(r):
                mu[a] += C[a, b] * w[index[b]] * p.Dty[index[b]]
            explained += mu[a] * w[index[a]] * p.Dty[index[a]]
        residual = max(p.yty - explained, 0.0)
        if tau <= 0.0:
            tau = (shape - 0.5 * terms) / (p.noise_rate + 0.5 * residual)
        rate = p.noise_rate + 0.5 * (residual + terms / tau)
        tau_new = shape / rate
        log_det_sigma = (terms - r) * math.log(p.slab_variance) - logdet - terms * math.log(tau)
        elbo = 0.5 * terms - 0.5 * p.dof * math.log(2.0 * math.pi) - 0.5 * terms * math.log(p.slab_variance)
        elbo += p.noise_shape * math.log(p.noise_rate) - math.lgamma(p.noise_shape) + math.lgamma(shape)
        elbo += 0.5 * log_det_sigma - shape * math.log(rate)
        if len(p.inclusion_beta) > 0:
            elbo += _inclusion_rate(p, w, log_odds) + _entropy(w)
        else:
            elbo += _indicator_bound(w, log_odds)
        trace[steps] = elbo
        steps += 1
        done = steps > 1 and elbo - trace[steps - 2] < tolerance
        if done or steps == max_iter:
            break
        _update_indicators(p, log_odds, w, index[:r], mu, C, tau, tau_new)
        tau = tau_new
    full = np.zeros(terms)
    for a in range(r):
        full[index[a]] = mu[a]
        for b in range(r):
            C[a, b] /= tau
    return full, C, index[:r], shape, rate, trace[:steps]


@kernel
def _best_ascent(p: Problem, starts: Floats, taus: Floats, tolerance: float, max_iter: int) -> tuple[Floats, Ascent]:
    """w and result of the ascent with the highest ELBO, from the rows of `starts` (changed in place) and `taus`."""
    best = 0
    best_run = vb_ascent(p, starts[0], taus[0], tolerance, max_iter)
    for k in range(1, len(starts)):
        run = vb_ascent(p, starts[k], taus[k], tolerance, max_iter)
        if len(run[5]) > 0 and (len(best_run[5]) == 0 or run[5][-1] > best_run[5][-1]):
            best, best_run = k, run
    return starts[best], best_run


def _starts(
    problem: Problem, init: Literal["search", "greedy", "rvm"] | Floats, models: Sequence[Bools]
) -> tuple[Floats, Floats, Bools | None]:
    """Starts of the ascents, w (K, P) and tau (K,), and the best model of the search (None without a search)."""
    terms = len(problem.Dty)
    if not isinstance(init, str):
        w = np.array(init, dtype=np.float64)
        if w.shape != (terms,) or not np.all((w >= 0) & (w <= 1)):
            raise InputError(f"init must hold one probability per term ({terms})")
        return w[None], np.zeros(1), None
    if init == "rvm":
        return rvm_gamma(problem)[None], np.full(1, RVM_PRECISION), None
    if init == "greedy":
        return greedy_model(problem).astype(np.float64)[None], np.zeros(1), None
    if init != "search":
        raise InputError(f"init must be 'search', 'greedy', 'rvm' or an array of inclusion probabilities, got {init!r}")
    gamma = rvm_gamma(problem) if not models and terms <= RVM_START_TERMS else None
    climbing = list(models) or default_starts(problem)
    found = candidate_models(problem, climbing if gamma is None else [*climbing, gamma > 0.0])
    starts = np.array([*found, *models] if gamma is None else [*found, gamma], dtype=np.float64)
    taus = np.zeros(len(starts))
    if gamma is not None:
        taus[-1] = RVM_PRECISION
    return starts, taus, found[0]


def spike_slab_vb(
    gram: GramLike,
    prior: Prior | None = None,
    *,
    init: Literal["search", "greedy", "rvm"] | Floats = "search",
    models: Sequence[Bools] = (),
    tolerance: float = 1e-6,
    max_iter: int = 1000,
) -> Posterior:
    """Variational posterior under spike-and-slab priors, by default the paper's, of a standardised Gram.

    VB can only prune and keeps false terms of a correlated dictionary, so its optimum depends on its start, `init`.
    "rvm" starts from the RVM's gamma as the paper does; "search" from the RVM and the best models of a search on the
    collapsed tableau, or from `models` (P,) and their neighbours, and keeps the highest ELBO; "greedy" from the model
    that adding and dropping single terms leads to; an array (P,) gives w itself. An ascent stops when the ELBO rises by
    less than the tolerance, eq. (27), or after `max_iter` sweeps.

    `pip` of the posterior holds w, `details.elbo` the bound (28) with its misprint corrected. InputError: options or
    prior parameters out of range, or known signs.
    """
    prior = prior or Prior()
    prior.refuse_signs("vb")
    whole_number("max_iter", max_iter, 1)
    if not (isinstance(tolerance, (int, float, np.number)) and 0.0 <= tolerance < np.inf):
        raise InputError(f"tol must be a number from 0 on, got {tolerance!r}")
    problem = Problem.of(gram, prior)
    starts, taus, tested = _starts(problem, init, models)
    best_w, best = _best_ascent(problem, starts, taus, tolerance, max_iter)
    # every flip and swap is tested at the model where the ascents ended, unless the search has tested that model
    while tested is not None and not np.array_equal(model := best_w > 0.5, tested):
        better = neighbours(problem, model, -GAIN_TOLERANCE)[:RETESTS]
        if not better:
            break
        moved = np.array([move.apply(model) for move in better], dtype=np.float64)
        w, run = _best_ascent(problem, moved, np.zeros(len(moved)), tolerance, max_iter)
        if not len(run[5]) or not run[5][-1] > best[5][-1] + tolerance:
            break
        best_w, best = w, run
    mu, sigma, index, shape, rate, trace = best
    if not len(trace):
        raise InputError("D'D of the starting models is not positive semi-definite, as that of real rows always is")
    kept = np.flatnonzero(best_w[index] > 0.5)
    support = np.zeros(len(best_w), dtype=np.bool_)
    support[index[kept]] = True
    coef, covariance = np.where(support, mu, 0.0), sigma[kept[:, None], kept]
    details = Details("vb", len(trace), len(trace) < max_iter, problem.slab_variance, elbo_trace=trace)
    return of_standardised(gram, best_w, support, coef, covariance, rate / shape, details)
