"""Quality of the fit of an equation, diagnostics of its residuals, and the effective number of rows by these."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayeq.arrays import Floats
from bayeq.inference.collapsed.problem import Problem
from bayeq.inference.collapsed.search import best_models
from bayeq.inference.collapsed.slab import learned
from bayeq.inference.gram import Gram
from bayeq.inference.posterior import Posterior
from bayeq.inference.prior import Prior
from bayeq.inference.vb import spike_slab_vb
from bayeq.numerics.distributions import correlation, memory_of, shape_of
from bayeq.numerics.settings import REGRESSION

# Cross-correlations are looked at up to this many lags, and up to this share of the longest piece.
MOST_LAGS = 100
SHARE_OF_LAGS = 0.25

# Residuals follow a channel if their largest cross-correlation has a smaller p value than this ...
CHANCE = 1e-4
# ... and is larger than this.
LEAST_CORRELATION = 0.1


@dataclass(frozen=True, slots=True)
class Fit:
    """How well an equation gives the target on some rows."""

    n: int  # rows
    r2: float  # share of the target's variance explained
    nrmse: float  # root mean squared error over the standard deviation of the target


@dataclass(frozen=True, slots=True)
class Driver:
    """The channel that residuals follow most."""

    name: str  # an input or a state
    lag: int  # rows by which the residuals come after it
    correlation: float  # cross-correlation at that lag
    p_value: float  # probability of one as large, at any lag of any channel, if residuals were independent of these

    def __str__(self) -> str:
        when = "" if not self.lag else f" {abs(self.lag)} rows {'before' if self.lag > 0 else 'after'}"
        return f"{self.name}{when} (correlation {self.correlation:.2f})"


@dataclass(frozen=True, slots=True)
class Residuals:
    """Diagnostics of residuals, which for an adequate model are uncorrelated, normal and independent of channels."""

    n: int  # rows
    lag1: float  # autocorrelation at lag 1
    n_eff: float  # effective sample size n / (1 + 2 sum rho_k), the sum over the lags up to the first rho_k <= 0
    # as in `bayeq.numerics.distributions.Shape`; with the likelihood of the record, the shape of the standardised
    # innovations of the channel of the chain that is least normal
    skewness: float = 0.0
    kurtosis: float = 0.0
    normality: float = 1.0
    driver: Driver | None = None  # the input or state that they follow most, where channels were given
    # with the likelihood of the record: standard deviation of the discrepancy, as a share of the target's
    discrepancy: float | None = None

    @property
    def correlated(self) -> bool:
        """Whether standard deviations that assume white residuals are too small to be trusted."""
        return bool(
            self.n_eff < REGRESSION.effective_share * self.n
            and self.lag1 > REGRESSION.lag1_significant / math.sqrt(self.n)
        )

    @property
    def driven(self) -> bool:
        """Whether the residuals follow an input or a state: something is missing from the model."""
        d = self.driver
        return d is not None and d.p_value < CHANCE and abs(d.correlation) > LEAST_CORRELATION


def inspect_residuals(pieces: Sequence[Floats], channels: Mapping[str, Sequence[Floats]] | None = None) -> Residuals:
    """Correlation and shape of residuals that come in one or more uninterrupted pieces, (n,) each.

    `channels` are inputs and states in the same pieces, which the residuals should not follow.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> inspect_residuals([rng.normal(size=1000)]).correlated
    False
    >>> inspect_residuals([np.cumsum(rng.normal(size=1000))]).correlated
    True
    >>> u = rng.normal(size=1000)
    >>> found = inspect_residuals([np.roll(u, 3) + rng.normal(size=1000)], {"u": [u]})
    >>> found.driven, found.driver.name, found.driver.lag
    (True, 'u', 3)
    """
    n = sum(len(piece) for piece in pieces)
    centred = _centred(pieces)
    covariance = correlation(centred, centred)
    memory = memory_of(covariance, n)
    if not covariance[0] > 0:
        return Residuals(n, *memory)
    rho = covariance / covariance[0]
    third, fourth = (max(1.0 + 2.0 * float(np.sum(rho[1:] ** k)), 0.1) for k in (3, 4))
    return Residuals(
        n, *memory, *shape_of(np.concatenate(centred), third, fourth), _strongest(centred, rho, channels or {})
    )


def _centred(pieces: Sequence[Floats]) -> list[Floats]:
    mean = sum(float(piece.sum()) for piece in pieces) / sum(len(piece) for piece in pieces)
    return [piece - mean for piece in pieces]


def _both_ways(first: Sequence[Floats], second: Sequence[Floats], lags: int) -> Floats:
    """Sums of products of two channels at lags of the first behind the second, from -lags to lags."""
    return np.concatenate([correlation(second, first)[lags:0:-1], correlation(first, second)[: lags + 1]])


def _strongest(centred: Sequence[Floats], rho: Floats, channels: Mapping[str, Sequence[Floats]]) -> Driver | None:
    """The channel with the most significant cross-correlation.

    Under independence cross-correlations have variance 1/n sum rho_k rho'_k over all lags (Bartlett 1946), times the
    mean product of the squares over the product of their means: after a blow both are large (White 1980). The p value
    of the largest is by a normal distribution, times the number of lags and channels that it was chosen from.
    """
    n = sum(len(piece) for piece in centred)
    own = math.sqrt(sum(float(e @ e) for e in centred))
    lags = min(MOST_LAGS, int(SHARE_OF_LAGS * len(rho)))
    found: list[tuple[float, Driver]] = []
    for name, pieces in channels.items():
        z = _centred(pieces)
        other = correlation(z, z)
        if not other[0] > 0:
            continue
        r = _both_ways(centred, z, lags) / (own * math.sqrt(other[0]))
        squares = _both_ways([e**2 for e in centred], [one**2 for one in z], lags)
        together = np.maximum(1.0, n * squares / (own**2 * other[0]))
        variance = together * max(1.0 + 2.0 * float(rho[1:] @ other[1:]) / other[0], 0.1) / n
        k = int(np.argmax(np.abs(r) / np.sqrt(variance)))
        t = abs(float(r[k])) / math.sqrt(variance[k])
        p = min(1.0, len(channels) * len(r) * math.erfc(t / math.sqrt(2.0)))
        found.append((t, Driver(name, k - lags, float(r[k]), p)))
    return max(found, key=lambda entry: entry[0])[1] if found else None


# Pilot fits, at most, that estimate the effective sample size of residuals, or the coefficients of noisy inputs.
PILOTS = 3

# At most this share of a column's sum of squares is subtracted as noise.
MOST_NOISE = 0.5


def _pilot(gram: Gram) -> Posterior:
    standard, prior = learned(gram, Prior())
    best = [model for _, model in best_models(Problem.of(standard.gram, prior))]
    return spike_slab_vb(standard.gram, prior, models=best).rescaled(standard)


def without_noise(gram: Gram, noise: Mapping[int, float]) -> Gram:
    """The Gram without the known noise variances of input columns; they remain in the residual sum of squares."""
    removed = np.zeros(len(gram.names))
    for j, variance in noise.items():
        removed[j] = min(gram.n * variance, MOST_NOISE * gram.DtD[j, j])
    if not removed.any():
        return gram
    less = replace(gram, DtD=gram.DtD - np.diag(removed))
    found = less
    for _ in range(PILOTS):
        coef = _pilot(found).coef
        found = replace(less, yty=gram.yty + float(coef**2 @ removed))
    return found


def thinned_gram(gram: Gram, residuals: Callable[[Posterior], Residuals]) -> Gram:
    """The Gram raised to the effective sample size: N_eff rows instead of N where residuals are correlated.

    Model and N_eff are found iteratively, since a model of fewer terms has more correlated residuals. If a model
    explains less than half of the target, its residuals are the motion itself, and the Gram is unchanged. `residuals`
    inspects the residuals of a posterior.
    """
    share = 1.0
    for _ in range(PILOTS):
        model = _pilot(gram.raised(share))
        if gram.squared_error(model.coef) > REGRESSION.rejected * gram.yty:
            return gram
        found = residuals(model)
        # so that the weight of at least three rows remains
        share = min(max(found.n_eff / found.n, 3.0 / gram.n), 1.0) if found.correlated else 1.0
        if share == 1.0:
            break
    return gram.raised(share)
