"""The expression tree: seven kinds of frozen, hashable nodes, and their canonical text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

from bayeq.errors import ExpressionError
from bayeq.expressions.functions import COMPARISONS

# Binding strength of the operators in Python's grammar; unary minus stands between * and **.
OPERATORS = {**dict.fromkeys(COMPARISONS, 0), "+": 1, "-": 1, "*": 2, "/": 2, "**": 4}
_UNARY, _ATOM = 3, 5


class _Node:
    """Nodes are dictionary keys in inner loops, so the hash of a tree is computed once, on construction."""

    __slots__ = ("_hash", "_parts")
    __match_args__: tuple[str, ...] = ()
    _hash: int
    _parts: tuple[Any, ...]

    def __post_init__(self) -> None:
        parts = tuple([getattr(self, name) for name in self.__match_args__])
        object.__setattr__(self, "_parts", parts)
        object.__setattr__(self, "_hash", hash((type(self).__name__, parts)))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._parts == other._parts

    # Hashes of strings differ between processes: a pickled node is built again.
    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._parts


@dataclass(frozen=True, slots=True, eq=False)
class Number(_Node):
    """A non-negative finite constant; one value has one form (integral up to 2**53 as int, else float)."""

    value: int | float

    def __post_init__(self) -> None:
        value = float(self.value)
        if not math.isfinite(value) or math.copysign(1.0, value) < 0:
            raise ExpressionError(f"a number in a term must be finite and not negative, not {value!r}")
        object.__setattr__(self, "value", int(value) if value.is_integer() and value <= 2**53 else value)
        _Node.__post_init__(self)


@dataclass(frozen=True, slots=True, eq=False)
class Symbol(_Node):
    """A channel or a parameter."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Constant(_Node):
    """A number that has a name: a key of `CONSTANTS`."""

    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Unknown(_Node):
    """A constant whose value is to be found, ``{name}`` or ``{name: low..high}``; one name is one constant."""

    name: str
    low: float = math.nan  # ends of its range; NaN if it is read from the record
    high: float = math.nan
    value: float = math.nan  # current value; NaN before one is found

    def __post_init__(self) -> None:
        for field_name in ("low", "high", "value"):
            if math.isnan(getattr(self, field_name)):
                object.__setattr__(self, field_name, math.nan)  # the one NaN that equals itself in tuples
        _Node.__post_init__(self)


@dataclass(frozen=True, slots=True, eq=False)
class Negate(_Node):
    """Unary minus."""

    operand: Node


@dataclass(frozen=True, slots=True, eq=False)
class Binary(_Node):
    """``left op right`` with `op` one of `OPERATORS`; comparisons are 1 or 0, and conditions of ``where`` only."""

    op: str
    left: Node
    right: Node


@dataclass(frozen=True, slots=True, eq=False)
class Call(_Node):
    """``function(arguments)`` with `function` a key of `FUNCTIONS`."""

    function: str
    arguments: tuple[Node, ...]


Node: TypeAlias = Number | Constant | Symbol | Unknown | Negate | Binary | Call


def number(value: float) -> Node:
    """Node of a finite constant of either sign (``-2.5`` is ``Negate(Number(2.5))``)."""
    return Negate(Number(-value)) if math.copysign(1.0, value) < 0 else Number(value)


def is_comparison(node: Node) -> bool:
    """Whether a node is a comparison."""
    return isinstance(node, Binary) and node.op in COMPARISONS


def arguments_of(node: Node) -> tuple[Node, ...]:
    """Operands or arguments of a node; empty for numbers, constants and symbols."""
    match node:
        case Negate(operand):
            return (operand,)
        case Binary(_, left, right):
            return (left, right)
        case Call(_, arguments):
            return arguments
    return ()


def with_arguments(node: Node, arguments: tuple[Node, ...]) -> Node:
    """The same operation or function with other arguments."""
    match node:
        case Negate():
            return Negate(arguments[0])
        case Binary(op):
            return Binary(op, *arguments)
        case Call(function):
            return Call(function, arguments)
    return node


def _written(node: Node) -> tuple[str, int]:
    """Text of a node, and how strongly it binds."""
    match node:
        case Number(value):
            return repr(value), _ATOM
        case Symbol(name) | Constant(name):
            return name, _ATOM
        case Unknown(name):
            return f"{{{name}}}", _ATOM
        case Call(function, arguments):
            return f"{function}({','.join(_written(argument)[0] for argument in arguments)})", _ATOM
        case Negate(operand):
            return "-" + _bracketed(operand, _UNARY), _UNARY
        case Binary(op, left, right):
            strength = OPERATORS[op]
            if op == "**":
                # Right-associative, and the exponent may carry a sign: x**-y**2 is x**(-(y**2)).
                return f"{_bracketed(left, _ATOM)}**{_bracketed(right, _UNARY)}", strength
            return f"{_bracketed(left, strength)}{op}{_bracketed(right, strength + 1)}", strength


def _bracketed(node: Node, least: int) -> str:
    text, strength = _written(node)
    return text if strength >= least else f"({text})"


def nodes_of(node: Node) -> Iterator[Node]:
    """A node and all nodes below it."""
    yield node
    for part in arguments_of(node):
        yield from nodes_of(part)


def unknowns_of(node: Node) -> Iterator[Unknown]:
    """The unknown constants of a tree, wherever they stand."""
    return (one for one in nodes_of(node) if isinstance(one, Unknown))


def jumps_of(node: Node) -> Iterator[Call]:
    """The jumps in a term, each as sign or floor of the expression that triggers it."""
    return (jump for one in nodes_of(node) if (jump := jump_of(one)) is not None)


def jump_of(node: Node) -> Call | None:
    """The jump of a node, as sign or floor of the expression that triggers it; None without one."""
    match node:
        case Call("sign" | "heaviside", arguments):
            return Call("sign", arguments)
        case Call("floor", arguments):
            return Call("floor", arguments)
        case Call("ceil", (argument,)):
            return Call("floor", (Negate(argument),))
        case Call("mod", (left, right)):
            return Call("floor", (Binary("/", left, right),))
        case Binary("<" | "<=" | ">" | ">=", left, right):
            return Call("sign", (Binary("-", left, right),))
    return None


def replaced(node: Node, values: Mapping[Node, Node]) -> Node:
    """A tree with some of its nodes replaced, by `values`."""
    if node in values:
        return values[node]
    return with_arguments(node, tuple(replaced(part, values) for part in arguments_of(node)))


@dataclass(frozen=True, repr=False)
class Expression:
    """A term or a right-hand side, as made by `parse`; equal, and hashed, by its tree.

    >>> from bayeq.expressions import parse
    >>> e = parse("(x ** 2) * v - sin(th)")
    >>> e.text, sorted(e.names)
    ('x**2*v-sin(th)', ['th', 'v', 'x'])
    """

    tree: Node  # the root of the expression tree
    choice: str = field(default="", compare=False)  # the either-or that the term is a member of, as it was written

    @cached_property
    def text(self) -> str:
        """Canonical text: no spaces, no needless brackets, Python's syntax; ``parse(e.text) == e``."""
        return _written(self.tree)[0]

    @cached_property
    def names(self) -> frozenset[str]:
        """The symbols that occur."""
        return frozenset(node.name for node in nodes_of(self.tree) if isinstance(node, Symbol))

    @cached_property
    def constants(self) -> frozenset[str]:
        """The names of numbers that occur."""
        return frozenset(node.name for node in nodes_of(self.tree) if isinstance(node, Constant))

    @cached_property
    def unknowns(self) -> dict[str, Unknown]:
        """Constants whose values are to be found, by name."""
        return {node.name: node for node in unknowns_of(self.tree)}

    @cached_property
    def size(self) -> int:
        """Number of nodes: 1 of ``x``, 2 of ``sign(v)``, 3 of ``x**3``."""
        return sum(1 for _ in nodes_of(self.tree))

    def named(self) -> Expression:
        """The expression with the names of its unknown constants alone, without ranges and values."""
        return self.with_unknowns({name: Unknown(name) for name in self.unknowns})

    def with_unknowns(self, found: Mapping[str, Unknown]) -> Expression:
        """The expression with its unknown constants replaced, by name."""
        if not self.unknowns:
            return self
        values: dict[Node, Node] = {one: found[one.name] for one in unknowns_of(self.tree) if one.name in found}
        return Expression(replaced(self.tree, values), self.choice)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"parse({self.text!r})"
