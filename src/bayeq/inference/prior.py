"""The spike-and-slab prior, eqs. (9)-(11), shared by all engines."""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log

import numpy as np
from numpy.typing import ArrayLike

from bayeq.arrays import Bools, Floats, Ints
from bayeq.errors import InputError

# Methods that take signs and bounds of coefficients.
SIGNED = ("auto", "bma")


def half_lines(signs: Ints) -> Floats:
    """Limits (P, 2) of coefficients of known signs (P,), 0 for unknown."""
    return np.column_stack([np.where(signs > 0, 0.0, -np.inf), np.where(signs < 0, 0.0, np.inf)])


def limited(limits: Floats) -> Bools:
    """Whether each coefficient has a finite limit, (P,), from limits (P, 2)."""
    return np.asarray(np.isfinite(limits).any(axis=1), dtype=np.bool_)


def signs_of(limits: Floats) -> Ints:
    """Signs (P,) of coefficients with limits (0, inf) or (-inf, 0); 0 for all other limits."""
    low, high = limits.T
    return ((low == 0.0) & np.isposinf(high)).astype(np.int64) - (np.isneginf(low) & (high == 0.0))


def common(one: Floats, other: Floats) -> Floats:
    """Intersection of two sets of limits, (P, 2) each."""
    return np.column_stack([np.maximum(one[:, 0], other[:, 0]), np.minimum(one[:, 1], other[:, 1])])


@dataclass(frozen=True)
class Prior:
    """theta_i | z_i = 1 ~ N(0, sigma^2 v_s), z_i ~ Bern(p_0), sigma^2 ~ IG(a_sigma, b_sigma).

    Parameters
    ----------
    slab_variance : float
        v_s, relative to sigma^2, on standardised columns.
    prior_inclusion : float or (P,) array
        p_0; 1 forces a term in, 0 keeps it out.
    noise_shape, noise_rate : float
        a_sigma and b_sigma.
    inclusion_beta : (a, b), optional
        Take p_0 as unknown, p_0 ~ Beta(a, b), for all terms whose `prior_inclusion` is neither 0 nor 1: the number of
        included terms is then beta-binomial (Scott and Berger 2010), and the prior adapts to how many there are.
    signs : (P,) array of -1, 0 and +1, optional
        Known signs of coefficients, 0 for unknown. Given inclusion the prior of a coefficient of known sign is the half
        normal on that side. For model averaging (`auto`, `bma`); other methods refuse them.
    bounds : (P, 2) array, optional
        Least and largest value of each coefficient, infinite where there is none: the slab is truncated there. Its
        normalising constant, the mass of the slab within the bounds, is computed for a noise variance of 1.

    Notes
    -----
    The defaults are those of Nayek, Worden and Cross, section 3.2.
    """

    slab_variance: float = 10.0
    prior_inclusion: ArrayLike = 0.1
    noise_shape: float = 1e-4
    noise_rate: float = 1e-4
    inclusion_beta: tuple[float, float] | None = None
    signs: ArrayLike | None = None
    bounds: ArrayLike | None = None

    def validate(self, terms: int) -> None:
        """Check the values against a dictionary.

        Parameters
        ----------
        terms : int
            Number of columns of the dictionary.

        Raises
        ------
        InputError
            A value outside its range, or a p_0 or signs of the wrong length.
        """
        for name in ("slab_variance", "noise_shape", "noise_rate"):
            value: object = getattr(self, name)
            if not (isinstance(value, (int, float, np.floating, np.integer)) and 0 < value < np.inf):
                raise InputError(f"{name} must be a positive number, got {value!r}")
        p0 = np.asarray(self.prior_inclusion, dtype=np.float64)
        if p0.ndim > 1 or (p0.ndim == 1 and len(p0) != terms):
            raise InputError(f"prior_inclusion must be one number or one per term ({terms}), got shape {p0.shape}")
        if not ((p0 >= 0) & (p0 <= 1)).all():
            raise InputError("prior_inclusion must lie between 0 and 1")
        if self.inclusion_beta is not None:
            shapes = np.asarray(self.inclusion_beta, dtype=np.float64)
            if shapes.shape != (2,) or not bool(np.all((shapes > 0) & (shapes < np.inf))):
                raise InputError(f"inclusion_beta must be two positive numbers (a, b), got {self.inclusion_beta!r}")
        if self.signs is not None:
            signs = np.asarray(self.signs)
            if signs.shape != (terms,) or not bool(np.isin(signs, (-1, 0, 1)).all()):
                raise InputError(f"signs must be -1, 0 or +1 for each of the {terms} terms, got {self.signs!r}")
        if self.bounds is not None:
            ends = np.asarray(self.bounds, dtype=np.float64)
            if ends.shape != (terms, 2) or not bool((ends[:, 0] < ends[:, 1]).all()):
                raise InputError(f"bounds must be a lower and a higher number for each of the {terms} terms")

    @property
    def limits(self) -> Floats | None:
        """Intersection of `signs` and `bounds` as limits, (P, 2); None if nothing is known."""
        known = self.signs is not None and bool(np.any(self.signs))
        ends = half_lines(np.asarray(self.signs).astype(np.int64)) if known else None
        if self.bounds is not None and bool(np.isfinite(self.bounds).any()):
            own = np.asarray(self.bounds, dtype=np.float64)
            ends = own if ends is None else common(ends, own)
        return ends

    def refuse_signs(self, method: str) -> None:
        """Check that no sign or bound is known, for engines that cannot use it.

        Parameters
        ----------
        method : str
            The engine, for the message.

        Raises
        ------
        InputError
            A sign or a bound is known.
        """
        if self.limits is not None:
            what = "signs" if self.bounds is None else "bounds"
            raise InputError(f"method {method!r} takes no {what} of coefficients; choose one of: {', '.join(SIGNED)}")

    def log_odds(self, terms: int) -> Floats:
        """logit(p_0) of each term: +inf for a forced, -inf for a forbidden one.

        0 for the others if their p_0 is unknown (`inclusion_beta`): `size_prior` is then their prior.

        Parameters
        ----------
        terms : int
            P, the number of terms.

        Returns
        -------
        (P,) array
            Log odds, in nats.
        """
        p0 = np.asarray(self.prior_inclusion, dtype=np.float64)
        if self.inclusion_beta is not None:
            p0 = np.where((p0 > 0) & (p0 < 1), 0.5, p0)
        with np.errstate(divide="ignore"):
            return np.full(terms, np.log(p0) - np.log1p(-p0))

    def size_prior(self, terms: int) -> Floats:
        """Log prior of a model of r = 0..P terms in addition to the log-odds of its terms.

        With p_0 ~ Beta(a, b) a model with k of the F free terms has probability B(k + a, F - k + b)/B(a, b), here
        relative to 2^-F, its probability by log-odds of 0. Zero if p_0 is given.

        Parameters
        ----------
        terms : int
            P, the number of terms.

        Returns
        -------
        (P + 1,) array
            Log prior by number of terms, in nats.
        """
        out = np.zeros(terms + 1)
        if self.inclusion_beta is not None:
            a, b = self.inclusion_beta
            log_odds = self.log_odds(terms)
            free, forced = int(np.isfinite(log_odds).sum()), int((log_odds == np.inf).sum())
            k = np.clip(np.arange(terms + 1) - forced, 0, free)
            whole = lgamma(a + b) - lgamma(a) - lgamma(b) - lgamma(free + a + b) + free * log(2.0)
            out += whole + np.array([lgamma(a + i) + lgamma(b + free - i) for i in k])
        return out
