"""Slow, obvious twins: the paper's equations as printed, on full matrices, for the tests to compare with."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy import stats
from scipy.special import expit, gammaln, logit, logsumexp, xlogy

from bayeq.likelihood.linear import sources_of


def centred(D, y):
    """Eq. (32) without the scaling."""
    return D - D.mean(axis=0), y - y.mean()


def vb(D, y, w, tau, *, v_s=10.0, p0=0.1, a=1e-4, b=1e-4, tolerance=1e-6, max_iter=1000, N=None):
    """Eqs. (20)-(28) in the order Sigma, mu -> b, tau -> ELBO -> w; a ln b in place of (28)'s a ln Gamma(b)."""
    N = len(y) if N is None else N
    P = D.shape[1]
    w = np.array(w, dtype=float)
    trace = []
    while True:
        W = np.diag(w)
        Omega = np.outer(w, w) + W @ (np.eye(P) - W)
        A = (D.T @ D) * Omega + np.eye(P) / v_s
        Sigma = np.linalg.inv(tau * A)
        mu = tau * Sigma @ W @ D.T @ y
        a_q = a + 0.5 * N + 0.5 * P
        second = np.outer(mu, mu) + Sigma
        b_q = b + 0.5 * (y @ y - 2 * y @ D @ W @ mu + np.trace(A @ second))
        tau = a_q / b_q
        elbo = (
            0.5 * P
            - 0.5 * N * math.log(2 * math.pi)
            - 0.5 * P * math.log(v_s)
            + a * math.log(b)
            - gammaln(a)
            + gammaln(a_q)
            - a_q * math.log(b_q)
            + 0.5 * np.linalg.slogdet(Sigma)[1]
            + np.sum(xlogy(w, p0) - xlogy(w, w) + xlogy(1 - w, 1 - p0) - xlogy(1 - w, 1 - w))
        )
        trace.append(elbo)
        if (len(trace) > 1 and trace[-1] - trace[-2] < tolerance) or len(trace) == max_iter:
            return w, mu, Sigma, a_q, b_q, np.array(trace)
        for i in range(P):
            others = [j for j in range(P) if j != i]
            f = D[:, i]
            rest = D[:, others] @ (w[others] * (mu[others] * mu[i] + Sigma[others, i]))
            eta = logit(p0) - 0.5 * tau * (mu[i] ** 2 + Sigma[i, i]) * f @ f + tau * f @ (y * mu[i] - rest)
            w[i] = expit(eta)


def elbo_by_definition(D, y, w, mu, Sigma, a_q, b_q, *, v_s, p0, a, b, N):
    """E_q[ln p(y, theta, z, sigma^2)] + entropy of q, term by term (13), (16), (18)."""
    from scipy.special import digamma

    P = len(w)
    tau = a_q / b_q
    log_s2 = math.log(b_q) - digamma(a_q)
    Omega = np.outer(w, w) + np.diag(w * (1 - w))
    second = np.outer(mu, mu) + Sigma
    misfit = y @ y - 2 * y @ D @ (w * mu) + np.sum((D.T @ D) * Omega * second)
    value = -0.5 * N * math.log(2 * math.pi) - 0.5 * N * log_s2 - 0.5 * tau * misfit
    value += -0.5 * P * math.log(2 * math.pi * v_s) - 0.5 * P * log_s2 - 0.5 * tau / v_s * np.trace(second)
    value += np.sum(xlogy(w, p0) + xlogy(1 - w, 1 - p0))
    value += a * math.log(b) - gammaln(a) - (a + 1) * log_s2 - b * tau
    value += 0.5 * P * (1 + math.log(2 * math.pi)) + 0.5 * np.linalg.slogdet(Sigma)[1]
    value += -np.sum(xlogy(w, w) + xlogy(1 - w, 1 - w))
    value += a_q + math.log(b_q) + gammaln(a_q) - (1 + a_q) * digamma(a_q)
    return value


def log_evidence(D, y, z, *, v_s=10.0, p0=0.1, a=1e-4, b=1e-4, N=None):
    """ln p(y | z) + ln p(z), eq. (34), with the determinants and inverses written out."""
    N = len(y) if N is None else N
    z = np.asarray(z, dtype=bool)
    r = int(z.sum())
    Dr = D[:, z]
    A = Dr.T @ Dr + np.eye(r) / v_s
    quadratic = y @ y - (y @ Dr) @ np.linalg.solve(A, Dr.T @ y) if r else y @ y
    value = gammaln(a + 0.5 * N) + a * math.log(b) - 0.5 * N * math.log(2 * math.pi) - 0.5 * r * math.log(v_s)
    value += -gammaln(a) - 0.5 * np.linalg.slogdet(A)[1] - (a + 0.5 * N) * math.log(b + 0.5 * quadratic)
    p0 = np.broadcast_to(p0, z.shape)
    return value + np.sum(np.log(np.where(z, p0, 1 - p0)))


def enumerate_models(D, y, **prior):
    """All 2^P models: (models, ln p(y, z)), the log evidence ln p(y), and the exact PIPs."""
    P = D.shape[1]
    models = np.array(list(itertools.product([False, True], repeat=P)))
    logs = np.array([log_evidence(D, y, z, **prior) for z in models])
    total = logsumexp(logs)
    return models, logs, total, np.exp(logs - total) @ models


def signed_models(D, y, signs, *, v_s=10.0, p0=0.1, a=1e-4, b=1e-4, window=12.0):
    """All 2^P models, and their probabilities given known signs, on centred data.

    The evidence (34) times 2^k P(k signs right | z, y), a multivariate Student t distribution function. Models that are
    `window` nats behind the best even without this factor have the probability 0.
    """
    N = len(y) - 1
    models, logs, _, _ = enumerate_models(D, y, v_s=v_s, p0=p0, a=a, b=b, N=N)
    logs = logs + math.log(2) * (models & (signs != 0)).sum(axis=1)
    out = np.full(len(models), -np.inf)
    for k in np.argsort(-logs):
        if logs[k] < out.max() - window:
            break
        z = models[k]
        known = np.flatnonzero(z & (signs != 0))
        if len(known):
            A = np.linalg.inv(D[:, z].T @ D[:, z] + np.eye(z.sum()) / v_s)
            mean, s = A @ D[:, z].T @ y, 2 * b + y @ y - y @ D[:, z] @ A @ D[:, z].T @ y
            among = np.searchsorted(np.flatnonzero(z), known)
            scale = A[np.ix_(among, among)] * np.outer(signs[known], signs[known]) * s / (N + 2 * a)
            t, df = signs[known] * mean[among], N + 2 * a
            if len(known) == 1:
                right = stats.t.cdf(t[0] / math.sqrt(scale[0, 0]), df)
            else:
                right = stats.multivariate_t.cdf(
                    t, np.zeros(len(t)), scale, df=df, maxpts=2000 * len(t), random_state=0
                )
            out[k] = logs[k] + math.log(max(right, 1e-300))
        else:
            out[k] = logs[k]
    return models, np.exp(out - logsumexp(out))


def rvm_log_marginal(D, y, alpha, noise_variance, N=None):
    """ln p(y | alpha, sigma^2) of the relevance vector machine: a Gaussian of covariance s2 I + D diag(1/alpha) D'.

    For centred data of N - 1 degrees of freedom the direction of the ones is left out.
    """
    n = len(y)
    N = n if N is None else N
    kept = np.isfinite(alpha)
    C = noise_variance * np.eye(n) + (D[:, kept] / alpha[kept]) @ D[:, kept].T
    logdet = np.linalg.slogdet(C)[1] - (n - N) * math.log(noise_variance)
    return -0.5 * (N * math.log(2 * math.pi) + logdet + y @ np.linalg.solve(C, y))


def random_problem(rng, n=None, P=None, rho=None, noise=None, active=None):
    """A regression with correlated columns and a few true terms: standardised D, centred y, truth."""
    n = n or int(rng.integers(15, 120))
    P = P or int(rng.integers(2, 11))
    rho = rng.uniform(0, 0.98) if rho is None else rho
    common = rng.normal(size=(n, 1))
    D = math.sqrt(1 - rho) * rng.normal(size=(n, P)) + math.sqrt(rho) * common
    D = (D - D.mean(axis=0)) / D.std(axis=0)
    truth = rng.random(P) < (active if active is not None else rng.uniform(0.1, 0.6))
    theta = truth * rng.normal(size=P) * 10 ** rng.uniform(-1, 0.7, size=P)
    noise = noise if noise is not None else 10 ** rng.uniform(-1.5, 0.5)
    y = D @ theta + noise * rng.normal(size=n)
    return D, y - y.mean(), truth


def force_of(linear, noise):
    """Variance of what is left out of each equation over each step, (n - 1, C)."""
    return linear.force + linear.bends @ noise.courses


def state_space_gaussian(linear, chosen, noise):
    """The joint Gaussian of all samples of a linearised record: level, slope and information of the coefficients.

    Returned with them are the mean of the states' deviations from the path, given the samples and coefficients, and the
    covariance of each state. A pull adds a linear function of the states to the log density.
    """
    n, size = linear.path.shape
    r = len(chosen.chain)
    mean, cov = np.zeros((n, size, 1 + r)), np.zeros((n, size, n, size))
    mean[0, :, 0] = noise.mean - linear.path[0]
    cov[0, :, 0] = np.diag(noise.start)
    for k in range(n - 1):
        A = np.diag(noise.memory) @ linear.transition[k]
        mean[k + 1] = A @ mean[k]
        mean[k + 1, :, 0] += noise.memory * linear.end[k] - linear.path[k + 1]
        [own] = sources_of(linear, chosen, k, k + 1)
        mean[k + 1, : len(own), 1:] += own
        cov[k + 1] = np.tensordot(A, cov[k], 1)
        cov[: k + 1, :, k + 1] = cov[k + 1, :, : k + 1].transpose(1, 2, 0)
        push = linear.transition[k][:, linear.discrepancy] * (np.arange(size) < len(own))[:, None]
        cov[k + 1, :, k + 1] = (
            A @ cov[k, :, k] @ A.T + np.diag(noise.steps) + push * force_of(linear, noise)[k] @ push.T
        )
    H, X, y, R = [], [], [], []
    for k, channel in zip(*np.nonzero(np.isfinite(linear.residual)), strict=True):
        kind, row, own = linear.kinds[channel], np.zeros((n, size)), np.zeros(r)
        if kind >= 0:
            row[k, kind] = 1.0
        else:
            row[k] = linear.gradient[k, -1 - kind]
            own = np.where(chosen.chain == -1 - kind, linear.terms[k, chosen.term], 0.0)
        H.append(row.ravel())
        X.append(own)
        y.append(linear.residual[k, channel])
        R.append(noise.channels[channel] * linear.spread[k, channel] + linear.unresolved[k, channel])
    H, mean, cov = np.array(H), mean.reshape(n * size, 1 + r), cov.reshape(n * size, n * size)
    design, left = np.array(X) + H @ mean[:, 1:], y - H @ mean[:, 0]
    C = H @ cov @ H.T + np.diag(R)
    solved = np.linalg.solve(C, np.column_stack([left, design]))
    level = -0.5 * (left @ solved[:, 0] + np.linalg.slogdet(2 * np.pi * C)[1])

    given = mean + cov @ H.T @ solved * np.append(1.0, -np.ones(r))
    pull = linear.pull.ravel() if len(linear.pull) else np.zeros(n * size)
    moved = cov @ pull - cov @ H.T @ np.linalg.solve(C, H @ cov @ pull)
    level += pull @ given[:, 0] + 0.5 * pull @ moved
    slope = design.T @ solved[:, 0] + given[:, 1:].T @ pull

    def smoothed(delta):
        return (given @ np.append(1.0, delta)).reshape(n, size)

    across = (cov @ H.T).reshape(n, size, -1)
    left_out = np.einsum(
        "nia,nja->nij", across, np.linalg.solve(C, across.reshape(n * size, -1).T).T.reshape(across.shape)
    )
    own = np.einsum("ninj->nij", cov.reshape(n, size, n, size)) - left_out
    return level, slope, design.T @ solved[:, 1:], smoothed, own
