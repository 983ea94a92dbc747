"""`Problem`: a Gram and a prior as the flat numbers that compiled kernels take."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayeq.gram import GramLike, dense
from bayeq.inference.prior import Prior

__all__ = ["Bools", "Floats", "Problem"]

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


# Share of y'y below which a residual sum of squares is rounding of the Gram: without noise, terms would otherwise be
# added that fit it. It stands for a noise of 3e-7 of the signal.
ROUNDING = 1e-13


class Problem(NamedTuple):
    """A sparse regression with its prior; made by `of`, taken whole by kernels.

    Attributes
    ----------
    DtD, Dty, yty, dof
        Statistics of the (standardised) Gram.
    log_odds : (P,) array
        logit(p_0); +inf forces a term in, -inf keeps it out.
    slab_variance, noise_shape, noise_rate : float
        v_s, a_sigma, b_sigma.
    half_log_slab : float
        1/2 ln v_s, the price of a term.
    h : float
        a_sigma + N/2.
    floor : float
        Least value of s = 2 b_sigma + RSS that the rounding of y'y lets us tell from zero.
    """

    DtD: Floats
    Dty: Floats
    yty: float
    dof: float
    log_odds: Floats
    slab_variance: float
    noise_shape: float
    noise_rate: float
    half_log_slab: float
    h: float
    floor: float

    @classmethod
    def of(cls, gram: GramLike, prior: Prior) -> Problem:
        """The problem that a Gram and a prior pose.

        Raises
        ------
        InputError
            Prior parameters out of range.
        """
        terms = len(gram.names)
        prior.validate(terms)
        return cls(
            DtD=np.ascontiguousarray(dense(gram)),
            Dty=np.ascontiguousarray(gram.Dty),
            yty=float(gram.yty),
            dof=float(gram.dof),
            log_odds=prior.log_odds(terms),
            slab_variance=float(prior.slab_variance),
            noise_shape=float(prior.noise_shape),
            noise_rate=float(prior.noise_rate),
            half_log_slab=0.5 * math.log(prior.slab_variance),
            h=float(prior.noise_shape) + 0.5 * float(gram.dof),
            floor=max(2.0 * float(prior.noise_rate), ROUNDING * float(gram.yty)),
        )

    def with_slab_variance(self, slab_variance: float) -> Problem:
        """The same problem with another v_s."""
        return self._replace(slab_variance=slab_variance, half_log_slab=0.5 * math.log(slab_variance))
