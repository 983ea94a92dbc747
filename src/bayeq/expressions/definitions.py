"""Functions by other functions: the expressions in a and b of the table, with arguments in their places."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from bayeq.expressions.nodes import Node, Symbol, arguments_of, with_arguments
from bayeq.expressions.parse import parse

__all__ = ["substituted", "template"]

PLACES = ("a", "b")


@lru_cache(maxsize=64)
def template(text: str) -> Node:
    """An expression in a and b."""
    return parse(text, PLACES).tree


def substituted(node: Node, arguments: Sequence[Node]) -> Node:
    """A template with arguments for a and b.

    Examples
    --------
    >>> from bayeq.expressions.nodes import Expression
    >>> Expression(substituted(template("(1+sign(a))/2"), [parse("x-v").tree])).text
    '(1+sign(x-v))/2'
    """
    if isinstance(node, Symbol):
        return arguments[PLACES.index(node.name)]
    return with_arguments(node, tuple(substituted(part, arguments) for part in arguments_of(node)))
