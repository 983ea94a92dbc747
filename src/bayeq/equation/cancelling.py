"""A common factor of a map's two sides: the same motion as by an equation with fewer earlier samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayeq.arrays import Floats
from bayeq.equation.equation import Equation
from bayeq.expressions.parse import EARLIER
from bayeq.forecast.dynamics import normal_draws

# Roots are the same if they differ by less than this many standard errors, which DRAWS draws of the coefficients give.
ERRORS, DRAWS = 3.0, 200


def common_root(equation: Equation) -> complex | None:
    """A root p of a linear map A(z) x = B(z) u that is one of B as well, within its error; None if there is none.

    ``(1 - p/z)`` on both sides leaves the motion as it is. Noise of a white input acts as a moving average of the
    residual, and such a factor makes it white (Ljung, System Identification, 1999, section 4.2): it then has a high
    probability. A root at zero is a delay.
    """
    shown = equation.shown_posterior
    names = [term.text for term, inside in zip(equation.terms, shown.support, strict=True) if inside]
    if not equation.chain.discrete or not all(term.text in term.names for term in equation.terms if term.text in names):
        return None
    parts = [(one["name"], int(one["back"])) if (one := EARLIER.fullmatch(name)) else (name, 0) for name in names]
    own = equation.chain.target.removesuffix("[+1]")
    channels = [own, *dict.fromkeys(name for name, _ in parts if name != own)]

    def roots(coef: Floats) -> list[Any]:
        """Roots of the polynomial of each channel, in z."""
        out = []
        for channel in channels:
            there = {back: c for (name, back), c in zip(parts, coef.tolist(), strict=True) if name == channel}
            polynomial = [there.get(back, 0.0) for back in range(max(there, default=-1) + 1)]
            out.append(np.roots([1.0, *(-c for c in polynomial)] if channel == own else np.trim_zeros(polynomial, "f")))
        return out

    coef = shown.coef[shown.support]
    poles, *others = roots(coef)
    if not others or not all(map(len, others)):
        return None
    drawn = [roots(one) for one in normal_draws(coef, shown.covariance, DRAWS, np.random.default_rng(0))]
    for pole in poles[np.abs(poles) > 0.0]:
        zeros = [_nearest(one, pole) for one in others]
        apart = pole - np.array(zeros)
        others_apart = np.array(
            [
                [_nearest(own, pole) - _nearest(z, zero) for z, zero in zip(rest, zeros, strict=True)]
                for own, *rest in drawn
            ]
        )
        if (np.abs(apart) < ERRORS * np.sqrt(np.mean(np.abs(others_apart - apart) ** 2, axis=0))).all():
            return complex(pole)
    return None


def _nearest(roots: Any, to: complex) -> complex:
    return complex(roots[np.abs(roots - to).argmin()]) if len(roots) else complex(np.inf)
