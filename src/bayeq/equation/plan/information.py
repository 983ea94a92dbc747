"""The likeliest models of an equation, and the expected log Bayes factors between them along a motion.

Two models of a target y, with terms D_L and D_R, are both fitted to a new record. With noise of variance sigma^2 the
log Bayes factor of a true L against R, by Schwarz's approximation of both evidences, is expected to be

    E ln B = lambda + (r_R - r_L) (ln n - 1)/2,    lambda = min over b of |D_L theta_L - D_R b|^2 / (2 sigma^2),

with r the numbers of coefficients: lambda is the misfit of R, with coefficients of its own, to the target of L along
L's motion (Atkinson and Fedorov 1975). It grows with the length of the record; if R contains L it is zero, and only the
Occam factor grows. With noise sigma^2, terms D and a prior covariance S of the coefficients, the expected information
about them in a record is 1/2 ln det(I + S D'D/sigma^2) nats (Lindley 1956; Chaloner and Verdinelli 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.inference.collapsed.search import neighbours
from bayeq.inference.engines import ENGINES
from bayeq.inference.posterior import Posterior
from bayeq.numerics.settings import PLAN
from bayeq.regression.fit import RegressionFit

# Number of likeliest models that are kept with an equation.
KEPT = 10


@dataclass(frozen=True, slots=True)
class CandidateModel:
    """A model of one equation."""

    probability: float  # posterior probability; without model averaging among the model found and its neighbours
    members: tuple[int, ...]  # indices of its terms among the candidates
    coef: tuple[float, ...]  # posterior means given the model, in original units
    intercept: float

    def posterior(self, like: Posterior) -> Posterior:
        """The model as a posterior with a covariance of zero; all other fields are those of `like`."""
        index, size = np.array(self.members, dtype=np.intp), len(self.members)
        support, coef = np.zeros(len(like.names), dtype=np.bool_), np.zeros(len(like.names))
        support[index], coef[index] = True, self.coef
        return replace(
            like,
            support=support,
            coef=coef,
            covariance=np.zeros((size, size)),
            constant=replace(like.constant, center=np.zeros(len(coef)), mean=self.intercept),
        )


def likeliest_models(fit: RegressionFit) -> tuple[CandidateModel, ...]:
    """The likeliest models, best first: of the model average, else the model found and its neighbours by their odds."""
    posterior, out = fit.posterior, []
    if posterior.average is not None:
        models, probability = posterior.average.models, posterior.average.probability
    else:
        compares = ENGINES[posterior.details.method].spike_slab
        moves = neighbours(fit.problem, posterior.support, PLAN.models_within) if compares else []
        listed = np.array([posterior.support, *(move.apply(posterior.support) for move in moves)])
        log_odds = np.array([0.0, *(move.gain for move in moves)])
        order = np.argsort(-log_odds, kind="stable")
        weight = np.exp(log_odds[order] - log_odds.max())
        models, probability = listed[order], weight / weight.sum()
    for model, share in zip(models[:KEPT], probability[:KEPT], strict=True):
        found = fit.expanded(fit.given(model))
        members = np.flatnonzero(found.support)
        coef = tuple(found.coef[members].tolist())
        out.append(CandidateModel(float(share), tuple(members.tolist()), coef, found.intercept))
    return tuple(out)


# Singular values of the centred and scaled terms below this share of the largest are rounding.
RANK = 1e-10


def _centred(D: Floats) -> tuple[Floats, Floats]:
    """Columns without their means, of unit length, and their lengths."""
    Z = D - D.mean(axis=0)
    size = np.linalg.norm(Z, axis=0)
    scale = np.where(size > 0, size, 1.0)
    return Z / scale, scale


def unexplained(y: Floats, D: Floats) -> float:
    """Residual sum of squares of y after least squares on the columns of D and an intercept.

    >>> x = np.linspace(-1, 1, 1001)
    >>> unexplained(3 * x + 2, x[:, None]) < 1e-20
    True
    >>> round(2 * unexplained(x**3, x[:, None]) / 1001, 3)  # 1/7 - 9/25/3 of the integral of x^6 stays, over length 2
    0.046
    """
    rest = y - y.mean()
    basis, sizes, _ = np.linalg.svd(_centred(D)[0], full_matrices=False)
    kept = basis[:, sizes > RANK * float(sizes.max(initial=RANK))]
    rest = rest - kept @ (kept.T @ rest)
    return float(rest @ rest)


def seconds_until(needed: float, rate: float, occam: float, fs: float) -> float:
    """Time after which ``rate t + occam (ln(fs t) - 1)/2`` stays at or above `needed`; infinite if it never does.

    `needed` is in nats, `rate` is lambda per second, at least 0, `occam` the number of coefficients of the rival less
    that of the true model, and `fs` in Hz.

    >>> round(seconds_until(10.0, 2.0, 0, 100.0), 6)
    5.0
    >>> seconds_until(10.0, 0.0, -1, 100.0)
    inf
    """

    def value(t: float) -> float:
        return rate * t + 0.5 * occam * (math.log(fs * t) - 1.0)

    if rate <= 0.0 and occam <= 0:
        return 0.0 if occam == 0 and needed <= 0 else math.inf
    # a record has at least one sample; beyond its minimum `value` rises
    low = 1.0 / fs if occam >= 0 else max(1.0 / fs, -0.5 * occam / rate)
    if value(low) >= needed:
        return low if occam < 0 or needed > 0 else 0.0
    return _reached(value, needed, low, low)


def coefficient_gain(D: Floats, covariance: Floats, noise_variance: float) -> Floats:
    """Eigenvalues of S D'D/sigma^2 with the columns centred, (r,): the gain is half the sum of ln(1 + each)."""
    Z, scale = _centred(D)
    # prior covariance in units in which the columns have length 1
    prior = covariance * np.outer(scale, scale) / noise_variance
    values, vectors = np.linalg.eigh(0.5 * (prior + prior.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.maximum(np.linalg.eigvalsh(root.T @ (Z.T @ Z) @ root), 0.0)


def seconds_to_halve(gains: Floats, seconds: float) -> float:
    """Time [s] that halves the geometric mean of standard deviations; `gains` of all equations are after `seconds`."""
    wanted = len(gains) * math.log(2.0)

    def value(t: float) -> float:
        return 0.5 * float(np.log1p(gains * (t / seconds)).sum())

    if not len(gains) or gains.max() <= 0.0:
        return math.inf
    return _reached(value, wanted, 0.0, seconds)


def _reached(value: Callable[[float], float], needed: float, low: float, high: float) -> float:
    """Argument at which a rising function reaches `needed`, from `low` on, maybe beyond `high`; infinite if none."""
    from scipy.optimize import brentq

    while value(high) < needed:
        high *= 2.0
        if not math.isfinite(high):
            return math.inf
    return float(brentq(lambda t: value(t) - needed, low, high, xtol=np.finfo(np.float64).tiny))
