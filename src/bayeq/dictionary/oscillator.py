"""The oscillator dictionary, eq. (31)."""

from __future__ import annotations

from bayeq.dictionary.polynomial import monomials
from bayeq.dictionary.specification import Variables

MAX_DEGREE = 6


def terms(variables: Variables, argument: str | None = None) -> list[str]:
    """P^1(x) ... P^6(x), sgn(x), |x|, x (x) |x| of the states, and the inputs: 36 terms for one x, v and u.

    ``oscillator:3`` has 3 as the highest order of the polynomials instead of 6.
    """
    degree = MAX_DEGREE if argument is None else int(argument)
    s = variables.states
    return [
        *monomials(s, degree),
        *(f"sign({a})" for a in s),
        *(f"abs({a})" for a in s),
        *(f"{a}*abs({b})" for a in s for b in s),
        *variables.inputs,
    ]
