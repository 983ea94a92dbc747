"""Gibbs sampling where signs of coefficients are known.

The posterior of (z, theta, sigma^2) is that without the signs, times 2^k for k included terms of known sign, where all
of them have their signs, and zero elsewhere (`inference.signs`). One sample is made of two parts, each of which leaves
it unchanged.

Jumps. As in the sampler without signs theta and sigma^2 are integrated out and z moves by flips and an exchange. With
each move sigma^2 and theta are proposed from their posterior given the new model and without the signs; if one has the
wrong sign all stays as it was. The Metropolis ratio is that of the collapsed posteriors (34), times 2 for a term of
known sign that enters, times whether all signs are right. Where the data agree with the signs this mixes as well as
the sampler without them; where right signs are improbable hardly anything is accepted.

Scan. Given the coefficients of known sign, the indicators of the others are drawn from their conditionals with their
coefficients and sigma^2 integrated out; then sigma^2; then, term by term, indicator and coefficient of known sign
together given the others of known sign, by integrals of a normal over a half line;
and at last the other coefficients. This works however improbable the signs are. The tableau is that of y less what the
terms of known sign explain.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from bayeq.inference.collapsed.problem import Bools, Floats, Problem, fetch
from bayeq.inference.collapsed.tableau import Tableau, build, data_gain, enter, flip, flip_gain, leave, swept
from bayeq.inference.gibbs import draw_theta, exchange_terms
from bayeq.inference.signs.halfline import draw_beyond, log_ndtr
from bayeq.inference.signs.truncation import coarse_scores
from bayeq.kernels import kernel

__all__ = ["doubled", "right_signs", "sample_signed_chain", "signed_levels"]

Draw = Callable[[int], tuple[Floats, Floats]]

# Draws of a model without the signs are repeated so many times where the signs are wrong. Those still wrong give way to
# samples of a chain within the model, so many apart.
ATTEMPTS = 50
APART = 20
BURN_IN = 200


def doubled(p: Problem) -> Problem:
    """The problem with the twofold density of half normal slabs in the log-odds of their terms."""
    return p._replace(log_odds=p.log_odds + math.log(2.0) * np.abs(p.signs))


def signed_levels(p: Problem, z: Bools) -> Floats:
    """ln p(y, z) of each of z (..., P), up to a constant and to 2e-3 of the probability of right signs."""
    models, which = np.unique(z.reshape(-1, z.shape[-1]), axis=0, return_inverse=True)
    return coarse_scores(p, models)[which].reshape(z.shape[:-1])


@kernel
def _expit(log_odds: float) -> float:
    if log_odds >= 0.0:
        return 1.0 / (1.0 + math.exp(-log_odds))
    e = math.exp(log_odds)
    return e / (1.0 + e)


@kernel
def _propose(p: Problem, T: Tableau, active: Bools, rng: np.random.Generator, theta: Floats) -> float:
    """sigma^2 and, into `theta`, the coefficients given the model without the signs; 0 if a sign is wrong."""
    variance = 0.5 * max(T.diagonal[-1], p.floor) / rng.standard_gamma(p.h)
    draw_theta(T, active, variance, rng, theta)
    for j in range(len(active)):
        if p.signs[j] * theta[j] < 0.0:
            return 0.0
    return variance


@kernel
def _jumps(
    p: Problem, active: Bools, theta: Floats, variance: float, exchange: bool, rng: np.random.Generator, trial: Floats
) -> float:
    """Moves with theta and sigma^2 integrated out; `active` and `theta` are changed in place, returns sigma^2."""
    T = swept(p, active)
    if exchange:
        before = active.copy()
        if exchange_terms(p, T, active, rng, trial) > 0:
            new = _propose(p, T, active, rng, trial)
            if new > 0.0:
                variance = new
                theta[:] = trial
            else:
                active[:] = before
                T = swept(p, active)
    for j in range(len(active)):
        if math.isinf(p.log_odds[j]):
            continue
        gain = flip_gain(p, T, j)
        if gain < 0.0 and rng.random() >= math.exp(gain):
            continue
        flip(p, T, j)
        active[j] = not active[j]
        new = _propose(p, T, active, rng, trial)
        if new > 0.0:
            variance = new
            theta[:] = trial
        else:
            flip(p, T, j)
            active[j] = not active[j]
    new = _propose(p, T, active, rng, trial)
    if new > 0.0:
        variance = new
        theta[:] = trial
    return variance


@kernel
def _rest(p: Problem, active: Bools, theta: Floats) -> tuple[Floats, Tableau]:
    """D'y of y less what the terms of known sign explain, and the tableau swept on the others.

    s of the tableau holds theta_j^2/v_s of the former besides.
    """
    Dty, ridge = p.Dty.copy(), 1.0 / p.slab_variance
    s = p.yty + 2.0 * p.noise_rate
    for j in range(len(active)):
        if p.signs[j] != 0 and theta[j] != 0.0:
            if p.columns.slot[j] < 0:
                fetch(p.columns, j)
            own = p.columns.rows[p.columns.slot[j]]
            s += theta[j] * (theta[j] * (p.columns.diagonal[j] + ridge) - 2.0 * Dty[j])
            for k in range(len(Dty)):
                Dty[k] -= theta[j] * own[k]
    T = build(p.columns, Dty, s, ridge)
    for j in range(len(active)):
        if active[j] and p.signs[j] == 0:
            enter(p.columns, Dty, T, j, ridge)
    return Dty, T


@kernel
def _shift(p: Problem, T: Tableau, j: int, change: float, pull: float, old: float) -> None:
    """Let column and corner of y follow a change of the coefficient of term j, which T is not swept on.

    `old` is the coefficient before, `pull` the M_jy with a coefficient of zero.
    """
    if p.columns.slot[j] < 0:
        fetch(p.columns, j)
    own = p.columns.rows[p.columns.slot[j]]
    terms = len(own)
    row = own.copy()
    for a in range(T.size[0]):
        factor = own[T.term[a]]
        for k in range(terms):
            row[k] -= factor * T.rows[a, k]
    for a in range(T.size[0]):
        row[T.term[a]] = T.rows[a, j]
    for k in range(terms):
        T.partial[k] -= change * row[k]
    T.diagonal[terms] += change * (T.diagonal[j] * (2.0 * old + change) - 2.0 * pull)


@kernel
def _size_gain(p: Problem, others: int) -> float:
    """Change of the log prior, apart from the term's own log-odds, when a term enters a model of so many others."""
    return p.size_prior[others + 1] - p.size_prior[others] - p.half_log_slab


@kernel
def _scan_free(p: Problem, Dty: Floats, T: Tableau, active: Bools, rng: np.random.Generator, inclusion: Floats) -> None:
    """Indicators of the terms of unknown sign, given the coefficients of the others."""
    total = int(active.sum())
    h = p.h + 0.5 * (total - T.size[0])
    for j in range(len(active)):
        if p.signs[j] != 0:
            continue
        if math.isinf(p.log_odds[j]):
            inclusion[j] = 1.0 if active[j] else 0.0
            continue
        others = total - 1 if active[j] else total
        gain = data_gain(T.diagonal[j], T.partial[j], T.diagonal[-1], p.floor, h)
        own = p.log_odds[j] + _size_gain(p, others)
        if not active[j] and T.size[0] == len(T.rows):
            own = -math.inf
        inclusion[j] = _expit(own - gain if active[j] else own + gain)
        if (rng.random() < inclusion[j]) == active[j]:
            continue
        if active[j]:
            leave(T, j)
        else:
            enter(p.columns, Dty, T, j, 1.0 / p.slab_variance)
        active[j] = not active[j]
        total = others + 1 if active[j] else others


@kernel
def _scan_signed(
    p: Problem, T: Tableau, active: Bools, theta: Floats, variance: float, rng: np.random.Generator, inclusion: Floats
) -> None:
    """Indicators and coefficients of the terms of known sign one by one, given sigma^2 and each other."""
    total = int(active.sum())
    for j in range(len(active)):
        sign = p.signs[j]
        if sign == 0:
            continue
        pivot, old = T.diagonal[j], theta[j]
        pull = T.partial[j] + old * (pivot - 1.0 / p.slab_variance)
        spread = math.sqrt(variance / pivot)
        # how many of its standard deviations the coefficient's mean lies on the right side
        t = sign * pull / pivot / spread
        others = total - 1 if active[j] else total
        if math.isinf(p.log_odds[j]):
            inclusion[j] = 1.0 if active[j] else 0.0
        else:
            gain = p.log_odds[j] + _size_gain(p, others) - 0.5 * math.log(pivot) + 0.5 * t * t + log_ndtr(t)
            inclusion[j] = _expit(gain)
            active[j] = rng.random() < inclusion[j]
            total = others + 1 if active[j] else others
        theta[j] = sign * spread * draw_beyond(-t, rng) if active[j] else 0.0
        if theta[j] != old:
            _shift(p, T, j, theta[j] - old, pull, old)


@kernel
def sample_signed_chain(
    p: Problem,
    active: Bools,
    coef: Floats,
    variance: float,
    burn_in: int,
    exchange: bool,
    rng: np.random.Generator,
    z: Bools,
    theta: Floats,
    noise: Floats,
    pip: Floats,
) -> None:
    """Run one chain on a `doubled` problem, from `active` and `coef` (changed in place) and `variance`.

    The other arguments are those of `gibbs.sample_chain`; pip sums up the probabilities of the scans.
    """
    terms = len(active)
    inclusion, trial = np.zeros(terms), np.empty(terms)
    for t in range(burn_in + len(noise)):
        variance = _jumps(p, active, coef, variance, exchange, rng, trial)
        Dty, T = _rest(p, active, coef)
        _scan_free(p, Dty, T, active, rng, inclusion)
        known = active.sum() - T.size[0]
        variance = 0.5 * max(T.diagonal[terms], p.floor) / rng.standard_gamma(p.h + 0.5 * known)
        _scan_signed(p, T, active, coef, variance, rng, inclusion)
        draw_theta(T, active & (p.signs == 0), variance, rng, trial)
        for j in range(terms):
            if p.signs[j] == 0:
                coef[j] = trial[j]
        k = t - burn_in
        if k >= 0:
            z[k] = active
            theta[k] = coef
            noise[k] = variance
            for j in range(terms):
                pip[j] += inclusion[j]


def right_signs(p: Problem, active: Bools, n: int, draw: Draw, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """theta (n, P) and sigma^2 (n,) given a model and the signs; ``draw(n)`` draws them without the signs."""
    theta, noise = draw(n)
    for _ in range(ATTEMPTS):
        wrong = np.flatnonzero((theta * p.signs < 0.0).any(axis=1))
        if not len(wrong):
            return theta, noise
        theta[wrong], noise[wrong] = draw(len(wrong))
    wrong = np.flatnonzero((theta * p.signs < 0.0).any(axis=1))
    if not len(wrong):
        return theta, noise
    # the sampler, with all other models ruled out
    only = doubled(p._replace(log_odds=np.where(active, math.inf, -math.inf)))
    size = APART * len(wrong), len(active)
    z, chain, variance = np.empty(size, dtype=np.bool_), np.empty(size), np.empty(size[0])
    start = active.copy(), np.zeros(len(active)), noise[0]
    sample_signed_chain(only, *start, BURN_IN, False, rng, z, chain, variance, np.zeros(len(active)))
    theta[wrong], noise[wrong] = chain[APART - 1 :: APART], variance[APART - 1 :: APART]
    return theta, noise
