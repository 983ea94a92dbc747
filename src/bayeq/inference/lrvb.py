"""Linear-response covariance of spike-and-slab variational Bayes (Giordano, Broderick and Jordan 2018).

A factorised q takes sigma^2, p_0 and the indicators as known where it states the covariance Sigma of theta. But the
exact covariance is also a sensitivity: add t'theta to the log joint, and the posterior mean moves by Cov(theta) dt.
Linear response takes d mu/dt at the optimum of variational Bayes, where all factors give way, for the covariance.

Definition. The factors are exponential families with mean parameters m (means of their statistics) and covariance V of
the statistics; E_q[ln joint] = f(m) is linear in the m of each factor, and H is its Hessian. At the optimum the natural
parameters are f'(m), to which t adds, and dm = V d(natural). So dm/dt = (V^-1 - H)^-1 = (I - V H)^-1 V; its block of
theta is wanted.

Elimination. H has no block within q(theta), whose moments are those of theta and theta theta'. By the Schur complement
on what else theta is coupled with, x = (tau, w), tau = E[1/sigma^2] (ln sigma^2 is in no cross term),

    Cov = Sigma + J (V_x^-1 - K)^-1 J',    V_x = diag(tau^2/a, w_i (1 - w_i)),    J = d mu/dx,    K = Hessian of G,

where J and K contain the answer of q(theta) to x: G(x) is f with the entropy of q(theta), maximised over q(theta). With
G_ij = (D'D)_ij, g = D'y, c_i = w_i g_i, A of eq. (20) without its tau, C = A^-1 = tau Sigma, mu = C c,

    G(x) = tau (c'C c/2 - b_sigma - y'y/2) - P/2 ln tau - 1/2 ln|A| + sum_i w_i logit p_0i
    dA/dw_i = e_i v_i' + v_i e_i',  (v_i)_j = w_j G_ij,  (v_i)_i = G_ii/2;    d_i = (g_i - v_i'mu) e_i - mu_i v_i

    J_tau = 0,                 K_tau,i = mu_i (g_i - v_i'mu),      J_i = C d_i,
    K_tau,tau = P/(2 tau^2),   K_ij = tau d_i'C d_j + (v_i'C e_j)(v_j'C e_i) + C_ij v_i'C v_j
                                      - [i != j] G_ij (tau mu_i mu_j + C_ij).

If p_0 ~ Beta, ln B(a', b') stands in G in place of the logits and adds trigamma(a') + trigamma(b') to every K_ij of
free terms.

At a maximum of the ELBO V_x^-1 - K is positive definite, so no variance is lowered. All of the correction comes from
undecided terms. With binary w there remains tau, and J_tau = 0: the prior of theta scales with sigma^2, so its mean
does not depend on it. The covariance is then Sigma, which is 1 - 1/h of the exact one given the model (h = a_sigma +
N/2): a linear response knows no tails. Under a wide slab (N v_s of some hundreds, as with the default) VB decides
nearly every term, and linear response sees nothing of the doubt that is left: that takes model averaging.
"""

from __future__ import annotations

import warnings

import numpy as np

from bayeq.errors import ConvergenceWarning
from bayeq.inference.collapsed.problem import Floats, Ints, Problem, fetch

__all__ = ["linear_response"]

# Least eigenvalue of I - V^1/2 K V^1/2, the curvature of the ELBO in units of that of its entropy. Where the ELBO is e
# below its maximum, x is off by about sqrt(2e/curvature) of these units: with e = 1e-6, the default at which an ascent
# stops, a lower curvature cannot be told from a saddle.
LEAST_CURVATURE = 1e-2


def linear_response(p: Problem, w: Floats, mu: Floats, sigma: Floats, index: Ints, tau: float) -> Floats:
    """Covariance of theta by linear response at an optimum of variational Bayes.

    Parameters
    ----------
    p : Problem
        Gram and prior.
    w, mu : (P,) arrays
        Inclusion probabilities, and means of q(theta).
    sigma : (r, r) array
        Covariance of q(theta) of the active terms, those with w > 0.
    index : (r,) int array
        The active terms.
    tau : float
        E[1/sigma^2].

    Returns
    -------
    (r, r) array
        Symmetric, and `sigma` plus a positive semi-definite matrix; `sigma` itself if every w is 0 or 1.

    Warns
    -----
    ConvergenceWarning
        The ascent ended where the ELBO is flat or not at a maximum; directions without curvature then count as if they
        had `LEAST_CURVATURE`.
    """
    undecided = np.flatnonzero(w[index] * (1.0 - w[index]) > 0.0)
    if len(undecided) == 0:
        return sigma
    chosen = w[index[undecided]]
    shape = p.noise_shape + 0.5 * p.dof + 0.5 * len(w)
    root = np.sqrt(np.concatenate(([tau * tau / shape], chosen * (1.0 - chosen))))
    J, K = _response(p, w, mu, sigma, index, undecided, tau)
    values, vectors = np.linalg.eigh(np.eye(len(root)) - root[:, None] * K * root)
    if values[0] < LEAST_CURVATURE:
        warnings.warn(
            "linear-response covariance where variational Bayes has not reached a clear maximum: lower tol, raise"
            " max_iter or start elsewhere",
            ConvergenceWarning,
            stacklevel=2,
        )
    half = (J * root) @ (vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE)))
    return sigma + half @ half.T


def _response(
    p: Problem, w: Floats, mu: Floats, sigma: Floats, index: Ints, undecided: Ints, tau: float
) -> tuple[Floats, Floats]:
    """J (r, 1+f) and K (1+f, 1+f) of the module's docstring, for tau and the f undecided among the r active terms."""
    f = np.arange(len(undecided))
    own = index[undecided]
    C, m = tau * sigma, mu[own]
    for j in own[p.columns.slot[own] < 0]:
        fetch(p.columns, int(j))
    G = p.columns.rows[np.ix_(p.columns.slot[own], index)].T.copy()
    v = w[index, None] * G
    v[undecided, f] = 0.5 * G[undecided, f]
    misfit = p.Dty[own] - v.T @ mu[index]
    d = -m * v
    d[undecided, f] += misfit
    Cd, Cv = C @ d, C @ v
    C_own, Cv_own, G_others = C[np.ix_(undecided, undecided)], Cv[undecided], G[undecided]
    G_others[f, f] = 0.0
    K = np.empty((len(f) + 1, len(f) + 1))
    K[0, 0] = len(w) / (2.0 * tau * tau)
    K[0, 1:] = K[1:, 0] = m * misfit
    K[1:, 1:] = tau * d.T @ Cd + Cv_own * Cv_own.T + C_own * (v.T @ Cv) - G_others * (tau * np.outer(m, m) + C_own)
    K[1:, 1:] += _inclusion_rate_response(p, w)
    return np.concatenate((np.zeros((len(index), 1)), Cd), axis=1), K


def _inclusion_rate_response(p: Problem, w: Floats) -> float:
    """Answer of q(p_0) = Beta(a', b') to the indicators of the free terms; 0 where p_0 is given."""
    if len(p.inclusion_beta) == 0:
        return 0.0
    from scipy.special import polygamma

    free = w[np.isfinite(p.log_odds)]
    a, b = p.inclusion_beta
    return float(polygamma(1, a + np.sum(free)) + polygamma(1, b + np.sum(1.0 - free)))
