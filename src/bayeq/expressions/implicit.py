"""Equations whose terms hold highest derivatives of each other: ``a1 = ... + theta a2 cos(p - q)``.

In matrices a = b + A a, where b sums the other terms and A holds the factors of the highest derivatives: the mass
matrix is I - A. The equations are solved for a symbolically, so that tapes, their derivatives and the integration need
no special case.
"""

from __future__ import annotations

from collections.abc import Sequence

from bayeq.expressions.nodes import Binary, Expression, Negate, Node, Number, Symbol

#: Equations that are solved together, at most: the entries of the inverse grow with each.
MOST_COUPLED = 4

_ZERO, _ONE = Number(0), Number(1)


def multiplied(term: Expression, targets: Sequence[str]) -> tuple[int, Expression] | None:
    """The highest derivative (its index) in a term, and its factor; None without any, ValueError if not proportional.

    >>> from bayeq.expressions import parse
    >>> multiplied(parse("a2*cos(p-q)"), ["a1", "a2"])
    (1, parse('cos(p-q)'))
    """
    inside = [k for k, name in enumerate(targets) if name in term.names]
    if not inside:
        return None
    if len(inside) == 1:
        rest = _without(term.tree, Symbol(targets[inside[0]]))
        if rest is not None and targets[inside[0]] not in Expression(rest).names:
            return inside[0], Expression(rest)
    names = " and ".join(targets[k] for k in inside)
    raise ValueError(f"{term.text} is not proportional to {names}")


def _without(node: Node, factor: Symbol) -> Node | None:
    """A product, or a sum of products, without a factor of each; None if it is not such a factor."""
    if node == factor:
        return _ONE
    match node:
        case Negate(operand):
            rest = _without(operand, factor)
            return None if rest is None else Negate(rest)
        case Binary("*", left, right):
            first = _without(left, factor)
            if first is not None:
                return product(first, right)
            second = _without(right, factor)
            return None if second is None else product(left, second)
        case Binary("/", left, right):
            rest = _without(left, factor)
            return None if rest is None else Binary("/", rest, right)
        case Binary("+" | "-" as sign, left, right):
            parts = _without(left, factor), _without(right, factor)
            return None if parts[0] is None or parts[1] is None else Binary(sign, parts[0], parts[1])
    return None


def product(left: Node, right: Node) -> Node:
    """The product of two nodes, without factors of 1 and 0."""
    if _ZERO in (left, right):
        return _ZERO
    return right if left == _ONE else left if right == _ONE else Binary("*", left, right)


def total(nodes: Sequence[Node]) -> Node:
    """The sum of some nodes."""
    out: Node = _ZERO
    for node in nodes:
        out = node if out == _ZERO else out if node == _ZERO else Binary("+", out, node)
    return out


def _minus(left: Node, right: Node) -> Node:
    return left if right == _ZERO else Negate(right) if left == _ZERO else Binary("-", left, right)


def inverse(A: Sequence[Sequence[Node]]) -> list[list[Node]]:
    """(I - A)^-1 of symbolic A, by Gauss-Jordan elimination without pivoting; zero pivots are not checked."""
    n = len(A)
    unit: list[list[Node]] = [[_ONE if i == j else _ZERO for j in range(n)] for i in range(n)]
    rows = [[*map(_minus, own, row), *own] for own, row in zip(unit, A, strict=True)]
    for k in range(n):
        pivot = rows[k][k]
        if pivot != _ONE:
            rows[k] = [one if one == _ZERO else Binary("/", one, pivot) for one in rows[k]]
        for i in range(n):
            factor = rows[i][k]
            if i != k and factor != _ZERO:
                rows[i] = [_minus(a, product(factor, b)) for a, b in zip(rows[i], rows[k], strict=True)]
                rows[i][k] = _ZERO
    return [row[n:] for row in rows]


def solved(
    equations: Sequence[Sequence[tuple[Node, Expression]]], targets: Sequence[str]
) -> tuple[list[Node], list[list[Node]]]:
    """The highest derivatives (I - A)^-1 b of equations, lists of coefficients and terms, and (I - A)^-1."""
    b: list[list[Node]] = [[] for _ in targets]
    A: list[list[list[Node]]] = [[[] for _ in targets] for _ in targets]
    for c, summed in enumerate(equations):
        for coefficient, term in summed:
            part = multiplied(term, targets)
            place = b[c] if part is None else A[c][part[0]]
            place.append(product(coefficient, term.tree if part is None else part[1].tree))
    inverted = inverse([[total(one) for one in row] for row in A])
    sides = [total(one) for one in b]
    return [total([product(g, one) for g, one in zip(row, sides, strict=True)]) for row in inverted], inverted
