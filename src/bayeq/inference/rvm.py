"""The relevance vector machine by the sequential algorithm of Tipping and Faul (2003).

theta_i ~ N(0, 1/alpha_i) with every alpha_i and the noise variance set to maximise the marginal likelihood. One
step adds, re-estimates or deletes the one term that raises the marginal likelihood most. Written with
lambda_i = alpha_i sigma^2 instead of alpha_i: the optimum is the same, the noise variance then has the closed
form s/N at every step, and all of S_m, Q_m, Sigma and mu are entries of the same swept tableau that
`bayeq.inference.collapsed.tableau` uses (here swept with ridge lambda_i on active terms only):

    S_m = beta M_mm,   Q_m = beta M_my,   Sigma = -sigma^2 M_rr,   mu = M_ry,   s = M_yy,   beta = N/s.
"""

from __future__ import annotations

import math

import numpy as np

from bayeq.arrays import Bools, Floats
from bayeq.errors import whole_number
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.tableau import LOOK, Tableau, active_block, build, enter, leave, strayed
from bayeq.inference.gram import GramLike
from bayeq.inference.posterior import Details, Posterior, of_standardised
from bayeq.inference.prior import Prior
from bayeq.kernels import kernel

# A step that raises the log marginal likelihood by less is not taken.
MIN_GAIN = 1e-6


@kernel
def _best_action(T: Tableau, lam: Floats, beta: float) -> tuple[int, float]:
    """The action that raises the marginal likelihood most: term (-1: none), and its new lambda (inf: delete)."""
    p = len(lam)
    best, best_j, best_lam = MIN_GAIN, -1, math.inf
    for j in range(p):
        # sparsity and quality factors of term j, the term itself left out: their eqs. (23)-(24), for beta = 1
        if lam[j] < math.inf:
            variance = -T.diagonal[j]
            room = 1.0 - lam[j] * variance
            if room <= 0.0:
                continue
            s = room / variance
            q = T.partial[j] / variance
        else:
            s = T.diagonal[j]
            q = T.partial[j]
        if not s > 0.0:
            continue
        relevance = beta * q * q - s
        if relevance > 0.0:
            new = s * s / relevance
        elif lam[j] < math.inf:
            new = math.inf
        else:
            continue
        # L(lambda) = 1/2 [ln lambda/(lambda + s) + beta q^2/(lambda + s)], 0 at lambda = inf
        gain = 0.0
        if new < math.inf:
            gain += 0.5 * (math.log(new / (new + s)) + beta * q * q / (new + s))
        if lam[j] < math.inf:
            gain -= 0.5 * (math.log(lam[j] / (lam[j] + s)) + beta * q * q / (lam[j] + s))
        if gain > best:
            best, best_j, best_lam = gain, j, new
    return best_j, best_lam


@kernel
def _shift_ridge(T: Tableau, j: int, delta: float) -> None:
    """Add `delta` to the ridge of active term j: one rank-one update of the swept tableau."""
    kappa = delta / (1.0 - delta * T.diagonal[j])
    p, own = len(T.partial), T.rows[T.row[j]]
    column = np.empty(p + 1)
    for k in range(p + 1):
        column[k] = own[k]
    for a in range(T.size[0]):
        factor = kappa * column[T.term[a]]
        row = T.rows[a]
        for k in range(p + 1):
            row[k] += factor * column[k]
    for k in range(p):
        T.diagonal[k] += kappa * column[k] * column[k]
        T.partial[k] += kappa * column[k] * column[p]
    T.diagonal[p] += kappa * column[p] * column[p]


@kernel
def rvm_ascent(p: Problem, max_iter: int) -> tuple[Floats, Tableau, float, int, bool]:
    """Sequential maximisation; returns gamma (P,), the swept tableau, noise variance, steps, whether it converged."""
    terms, yty = len(p.Dty), p.yty
    T = build(p, yty, 0.0)
    lam = np.full(terms, math.inf)
    floor = max(1e-14 * yty, 1e-300)
    steps, converged = 0, False
    while steps < max_iter:
        beta = p.dof / max(T.diagonal[terms], floor)
        j, new = _best_action(T, lam, beta)
        if j < 0:
            converged = True
            break
        steps += 1
        if lam[j] == math.inf:
            if T.size[0] == len(T.rows):
                break
            enter(p, T, j, new)
        elif new == math.inf:
            leave(T, j)
            T.diagonal[j] -= lam[j]
        else:
            _shift_ridge(T, j, new - lam[j])
        lam[j] = new
        if steps % LOOK == 0 and strayed(p, T, yty, np.where(lam < math.inf, lam, 0.0), floor):
            T = build(p, yty, 0.0)
            for k in range(terms):
                if lam[k] < math.inf:
                    enter(p, T, k, lam[k])
    gamma = np.zeros(terms)
    for j in range(terms):
        if lam[j] < math.inf:
            gamma[j] = min(max(1.0 + lam[j] * T.diagonal[j], 1e-300), 1.0)
    return gamma, T, max(T.diagonal[terms], floor) / p.dof, steps, converged


@kernel
def rvm_gamma(p: Problem) -> Floats:
    """gamma (P,) of the RVM, from which another engine starts; 0 for a term left out."""
    return rvm_ascent(p, 50 * len(p.Dty) + 100)[0]


def rvm(gram: GramLike, prior: Prior | None = None, *, least_gamma: float = 0.0, max_iter: int = 10_000) -> Posterior:
    """Relevance vector machine of a standardised Gram, in at most `max_iter` add, re-estimate and delete steps.

    The machine learns its own prior: `prior` is ignored, except that known signs or bounds are refused. Terms whose
    gamma is not above `least_gamma` are taken out after convergence. `pip` holds gamma_i = 1 - alpha_i Sigma_ii, how
    well the data determine each weight: a measure of relevance, not a probability.
    """
    if prior is not None:
        prior.refuse_signs("rvm")
    whole_number("max_iter", max_iter, 1)
    gamma, T, noise, steps, converged = rvm_ascent(Problem.of(gram, Prior()), max_iter)
    support: Bools = gamma > 0.0
    for j in np.flatnonzero(support & (gamma <= least_gamma)):
        leave(T, int(j))
        support[j] = False
    coef, covariance = np.where(support, T.partial, 0.0), noise * active_block(T, np.flatnonzero(support))
    return of_standardised(gram, gamma, support, coef, covariance, noise, Details("rvm", int(steps), bool(converged)))
