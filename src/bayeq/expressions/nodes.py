"""The expression tree: five kinds of frozen, hashable nodes, and their canonical text."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

from bayeq.errors import ExpressionError
from bayeq.expressions.functions import FUNCTIONS

__all__ = ["OPERATORS", "Binary", "Call", "Expression", "Negate", "Node", "Number", "Symbol", "number"]

# Binding strength of the operators in Python's grammar; unary minus stands between * and **.
OPERATORS = {"+": 1, "-": 1, "*": 2, "/": 2, "**": 4}
_UNARY, _ATOM = 3, 5


class _Hashed:
    """Nodes are dictionary keys in inner loops, so the hash of a tree is computed once, on construction."""

    __slots__ = ()

    def _remember(self, *parts: object) -> None:
        object.__setattr__(self, "_hash", hash((type(self).__name__, *parts)))


@dataclass(frozen=True, slots=True)
class Number(_Hashed):
    """A non-negative finite constant; one value has one form (integral up to 2**53 as int, else float)."""

    value: int | float
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        value = float(self.value)
        if not math.isfinite(value) or math.copysign(1.0, value) < 0:
            raise ExpressionError(f"a number in a term must be finite and not negative, not {value!r}")
        object.__setattr__(self, "value", int(value) if value.is_integer() and value <= 2**53 else value)
        self._remember(self.value)

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return Number, (self.value,)


@dataclass(frozen=True, slots=True)
class Symbol(_Hashed):
    """A channel or a parameter."""

    name: str
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._remember(self.name)

    def __hash__(self) -> int:
        return self._hash

    # Hashes of strings differ between processes: a pickled node is built again (here and below).
    def __reduce__(self) -> tuple[Any, ...]:
        return Symbol, (self.name,)


@dataclass(frozen=True, slots=True)
class Negate(_Hashed):
    """Unary minus."""

    operand: Node
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._remember(self.operand)

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return Negate, (self.operand,)


@dataclass(frozen=True, slots=True)
class Binary(_Hashed):
    """``left op right`` with `op` one of `OPERATORS`."""

    op: str
    left: Node
    right: Node
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.op not in OPERATORS:
            raise ExpressionError(f"no operator {self.op!r}; there are: {' '.join(OPERATORS)}")
        self._remember(self.op, self.left, self.right)

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return Binary, (self.op, self.left, self.right)


@dataclass(frozen=True, slots=True)
class Call(_Hashed):
    """``function(argument)`` with `function` a key of `FUNCTIONS`."""

    function: str
    argument: Node
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.function not in FUNCTIONS:
            raise ExpressionError(f"no function {self.function!r}; there are: {', '.join(FUNCTIONS)}")
        self._remember(self.function, self.argument)

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        return Call, (self.function, self.argument)


Node: TypeAlias = Number | Symbol | Negate | Binary | Call


def number(value: float) -> Node:
    """Node of a finite constant of either sign (``-2.5`` is ``Negate(Number(2.5))``)."""
    return Negate(Number(-value)) if math.copysign(1.0, value) < 0 else Number(value)


def _written(node: Node) -> tuple[str, int]:
    """Text of a node, and how strongly it binds."""
    match node:
        case Number(value):
            return repr(value), _ATOM
        case Symbol(name):
            return name, _ATOM
        case Call(function, argument):
            return f"{function}({_written(argument)[0]})", _ATOM
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


def _symbols(node: Node) -> frozenset[str]:
    match node:
        case Number():
            return frozenset()
        case Symbol(name):
            return frozenset((name,))
        case Negate(operand) | Call(_, operand):
            return _symbols(operand)
        case Binary(_, left, right):
            return _symbols(left) | _symbols(right)


def _size(node: Node) -> int:
    match node:
        case Number() | Symbol():
            return 1
        case Negate(operand) | Call(_, operand):
            return 1 + _size(operand)
        case Binary(_, left, right):
            return 1 + _size(left) + _size(right)


@dataclass(frozen=True, repr=False)
class Expression:
    """A term or a right-hand side, as made by `parse`; equal, and hashed, by its tree.

    Attributes
    ----------
    tree : Node
        The root of the expression tree.
    text : str
        Canonical text: no spaces, no needless brackets, valid in Python and in SymPy;
        ``parse(e.text) == e``.
    names : frozenset of str
        The symbols that occur.
    size : int
        Number of nodes: 1 of ``x``, 2 of ``sign(v)``, 3 of ``x**3``.

    Examples
    --------
    >>> from bayeq.expressions import parse
    >>> e = parse("(x ** 2) * v - sin(th)")
    >>> e.text, sorted(e.names)
    ('x**2*v-sin(th)', ['th', 'v', 'x'])
    """

    tree: Node

    @cached_property
    def text(self) -> str:
        return _written(self.tree)[0]

    @cached_property
    def names(self) -> frozenset[str]:
        return _symbols(self.tree)

    @cached_property
    def size(self) -> int:
        return _size(self.tree)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"parse({self.text!r})"
