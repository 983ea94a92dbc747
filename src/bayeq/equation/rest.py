"""Where an oscillator rests, and its forces about that: a displacement need not be measured from there.

With x = x_0 + xi, theta x**p gives binomial(p, n) theta x_0**(p - n) of xi**n. What is called stiffness is that of
small motion about the position of rest, where without input all forces on the mass at rest vanish.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bayeq.arrays import Floats
from bayeq.dictionary import evaluate_terms
from bayeq.errors import InputError
from bayeq.expressions import Binary, Expression, Node, Number, Symbol, parse
from bayeq.likelihood.signs import jumps_of

# Places at which a zero of the force is looked for, and how far beyond the record's range, as a share of that.
PLACES, BEYOND = 2001, 0.5

# Newton's steps, and the step of derivatives as a share of the range.
STEPS, STEP = 20, 1e-4

# Draws that may have no position of rest.
FEW = 0.025


def is_displaced(
    coefficients: Mapping[Expression, Floats], constant: bool, x: str, v: str, span: tuple[float, float]
) -> bool:
    """Whether coefficients are to be taken about the position of rest: it is not zero, or the spring no polynomial.

    Of the terms' coefficients only which terms there are counts; `constant` says whether the equation has one, and the
    span is that of the samples of the displacement `x`.
    """
    alone = [term for term in coefficients if term.names == {x}]
    forced = any(abs(float(evaluate_terms([term], {x: np.zeros(1)})[0, 0])) > 0.0 for term in alone)
    bent = any(_powers(term.tree, x, v) is None and not any(jumps_of(term.tree)) for term in alone)
    return constant or forced or bent or not span[0] <= 0.0 <= span[1]


def about_rest(
    coefficients: Mapping[Expression, Floats], constant: Floats, x: str, v: str, span: tuple[float, float]
) -> tuple[Floats, dict[Expression, Floats]]:
    """The positions of rest (n,), and the coefficients about them, (n,) each.

    Given are n draws of the terms' coefficients and of the constant, and the least and largest displacement of the
    record. Coefficients are of terms in the displacement from the position of rest; other terms in `x` alone add their
    slope to that of `x`, and those that are not powers of displacement and velocity stay. InputError if there is no
    such position in or near the range of the record.
    """
    alone = {term: values for term, values in coefficients.items() if term.names == {x}}
    width = span[1] - span[0]
    low, high = span[0] - BEYOND * width, span[1] + BEYOND * width

    def force(position: Floats, thetas: Mapping[Expression, Floats], level: Floats) -> Floats:
        columns = evaluate_terms(list(thetas), {x: position})
        return np.zeros(position.shape) + level + sum(theta * columns[:, j] for j, theta in enumerate(thetas.values()))

    places = np.linspace(low, high, PLACES)
    mean = {term: np.asarray(values.mean()) for term, values in alone.items()}
    along = force(places, mean, np.asarray(constant.mean()))
    stable = np.flatnonzero((along[:-1] > 0.0) & (along[1:] <= 0.0))
    if not len(stable):
        raise _not_at_rest(x, span)
    nearest = places[stable[np.argmin(np.abs(places[stable] - 0.5 * (span[0] + span[1])))]]
    position, step = np.full(len(constant), nearest), STEP * width

    def slope(position: Floats, thetas: Mapping[Expression, Floats]) -> Floats:
        nothing = np.zeros(len(position))
        return (force(position + step, thetas, nothing) - force(position - step, thetas, nothing)) / (2.0 * step)

    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            position = position - force(position, alone, constant) / slope(position, alone)
    position = np.where((position > low) & (position < high), position, np.nan)
    if np.isnan(position).mean() > FEW:
        raise _not_at_rest(x, span)

    moved: dict[Expression, Floats] = {}
    others: dict[Expression, Floats] = {}
    for term, theta in coefficients.items():
        powers = _powers(term.tree, x, v)
        if powers is None:
            others[term] = theta
            continue
        p, q = powers
        for n in range(p + 1):
            if n + q > 0:
                key = _monomial(x, n, v, q)
                moved[key] = moved.get(key, 0.0) + math.comb(p, n) * theta * position ** (p - n)
    bent = {term: theta for term, theta in others.items() if term in alone}
    if bent:
        key = parse(x)
        moved[key] = moved.get(key, 0.0) + slope(position, bent)
    return position, {**moved, **others}


def _not_at_rest(x: str, span: tuple[float, float]) -> InputError:
    return InputError(
        f"the equation has no certain position of rest near the record's range of {x}, {span[0]:.4g} to {span[1]:.4g}:"
        f" measure {x} from the position of rest (bayeq.remove_offset, --remove-offset {x}) and look again"
    )


def _powers(node: Node, x: str, v: str) -> tuple[int, int] | None:
    """Powers of displacement and velocity of a monomial; None of other terms."""
    match node:
        case Symbol(name) if name in (x, v):
            return (1, 0) if name == x else (0, 1)
        case Binary("**", Symbol(name), Number(int(power))) if name in (x, v):
            return (power, 0) if name == x else (0, power)
        case Binary("*", left, right):
            one, other = _powers(left, x, v), _powers(right, x, v)
            return None if one is None or other is None else (one[0] + other[0], one[1] + other[1])
        case _:
            return None


def _monomial(x: str, p: int, v: str, q: int) -> Expression:
    parts = [name if power == 1 else f"{name}**{power}" for name, power in ((x, p), (v, q)) if power]
    return parse("*".join(parts))
