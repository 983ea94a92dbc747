"""Families of terms: functions from variables and the text after the colon (or None) to the texts of terms."""

from __future__ import annotations

from collections import Counter
from itertools import combinations_with_replacement
from math import comb

from bayeq.dictionary.specification import Variables
from bayeq.errors import InputError
from bayeq.expressions import Binary, Expression, Node, Number

OSCILLATOR_DEGREE, POLYNOMIAL_DEGREE, HARMONICS = 6, 3, 1


def oscillator(variables: Variables, argument: str | None = None) -> list[str]:
    """P^1(x) ... P^6(x), sgn(x), |x|, x (x) |x| of the states, and the inputs, eq. (31): 36 terms of one x, v, u."""
    s = variables.states
    return [
        *monomials(s, OSCILLATOR_DEGREE if argument is None else int(argument)),
        *(f"sign({a})" for a in s),
        *(f"abs({a})" for a in s),
        *(f"{a}*abs({b})" for a in s for b in s),
        *variables.inputs,
    ]


def polynomial(variables: Variables, argument: str | None = None) -> list[str]:
    """Monomials of the states up to a degree (default 3), and the inputs: ``polynomial:2`` is degree 2."""
    return [*monomials(variables.states, POLYNOMIAL_DEGREE if argument is None else int(argument)), *variables.inputs]


def fourier(variables: Variables, argument: str | None = None) -> list[str]:
    """sin(th), cos(th), ..., sin(k*th), cos(k*th) of each coordinate, and the inputs: ``fourier:2`` is k = 2.

    >>> fourier(Variables(("th", "om"), ("u",), (("th", "om"),)), "2")
    ['sin(th)', 'cos(th)', 'sin(2*th)', 'cos(2*th)', 'u']
    """
    orders = range(1, (HARMONICS if argument is None else int(argument)) + 1)
    angles = [name if i == 1 else f"{i}*{name}" for name in variables.coordinates for i in orders]
    return [*(f"{wave}({angle})" for angle in angles for wave in ("sin", "cos")), *variables.inputs]


def neighbours(variables: Variables, argument: str | None = None) -> list[str]:
    """Linear and cubic springs and dampers at one mass of a row, in the order of the chains, and the inputs.

    At mass i these are its displacement and velocity (to the ground), their differences to those of the masses before
    and after it, and the cubes of all; of the whole row, those of every mass. InputError: less than two chains.

    >>> variables = Variables(("x1", "v1", "x2", "v2"), (), (("x1", "v1"), ("x2", "v2")), 0)
    >>> neighbours(variables)
    ['x1', 'x1**3', 'x2-x1', '(x2-x1)**3', 'v1', 'v1**3', 'v2-v1', '(v2-v1)**3']
    """
    del argument
    chains = variables.chains
    if len(chains) < 2:
        raise InputError("dictionary 'neighbours' is for two coordinates or more, a chain each; use oscillator for one")
    own = range(len(chains)) if variables.own is None else [variables.own]
    out: list[str] = []
    for i in own:
        for k, name in enumerate(chains[i]):
            out += [name, f"{name}**3"]
            for a, b in ((i - 1, i), (i, i + 1)):
                if a >= 0 and b < len(chains) and k < min(len(chains[a]), len(chains[b])):
                    difference = f"{chains[b][k]}-{chains[a][k]}"
                    out += [difference, f"({difference})**3"]
    return [*dict.fromkeys(out), *variables.inputs]


def monomials(names: tuple[str, ...], degree: int) -> list[str]:
    """All monomials of total degree 1 to `degree`, by degree: ``x``, ``v``, ``x**2``, ``x*v``, ``v**2`` ...

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
    """Number of monomials of degree 0, the constant, to `degree`."""
    return comb(names + degree, degree)


def degree(term: Expression) -> int:
    """Total degree of a monomial.

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
