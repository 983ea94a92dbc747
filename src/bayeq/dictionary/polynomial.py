"""Polynomials of the states, and the inputs."""

from __future__ import annotations

from collections import Counter
from itertools import combinations_with_replacement
from math import comb

from bayeq.dictionary.specification import Variables
from bayeq.expressions import Binary, Expression, Node, Number

DEFAULT_DEGREE = 3


def monomials(names: tuple[str, ...], degree: int) -> list[str]:
    """All monomials of total degree 1 to `degree`, by degree: ``x``, ``v``, ``x**2``, ``x*v``, ``v**2`` ...

    Examples
    --------
    >>> monomials(("x", "v"), 2)
    ['x', 'v', 'x**2', 'x*v', 'v**2']
    """
    out = []
    for total in range(1, degree + 1):
        for combination in combinations_with_replacement(names, total):
            powers = Counter(combination).items()
            out.append("*".join(name if power == 1 else f"{name}**{power}" for name, power in powers))
    return out


def count(names: int, degree: int) -> int:
    """How many monomials of degree 1 to `degree` there are, and the constant."""
    return comb(names + degree, degree)


def terms(variables: Variables, argument: str | None = None) -> list[str]:
    """Monomials of the states up to a degree (default 3), and the inputs: ``polynomial:2`` is degree 2."""
    degree = DEFAULT_DEGREE if argument is None else int(argument)
    return [*monomials(variables.states, degree), *variables.inputs]


def degree(term: Expression) -> int:
    """Total degree of a monomial.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> degree(parse("x**2*v"))
    3
    """
    return _degree(term.tree)


def _degree(node: Node) -> int:
    match node:
        case Number():
            return 0
        case Binary("*", left, right):
            return _degree(left) + _degree(right)
        case Binary("**", left, Number(power)):
            return _degree(left) * int(power)
        case _:
            return 1
