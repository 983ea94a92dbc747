"""``parse``: the text of a term becomes a tree, and nothing else can happen.

The text is scanned by a small lexer, parsed (never compiled) by Python's own grammar, and every node has to
be on a short list. Terms come from files and command lines: nothing here evaluates, imports or looks up
anything.
"""

from __future__ import annotations

import ast
import difflib
import keyword
import math
import re
from collections.abc import Iterable
from functools import lru_cache

from bayeq.errors import ExpressionError, UnknownNameError
from bayeq.expressions.functions import FUNCTIONS
from bayeq.expressions.nodes import Binary, Call, Expression, Negate, Node, Number, Symbol

__all__ = ["MAX_DEPTH", "MAX_LENGTH", "MAX_NODES", "parse"]

MAX_LENGTH = 1000
MAX_DEPTH = 50
MAX_NODES = 500

_NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.])"
_TOKEN = re.compile(rf"[ \t]+|(?P<number>{_NUMBER})|(?P<name>[^\W\d]\w*)|\*\*|[-+*/()]")
_BAD_NUMBER = re.compile(r"\.?[0-9][\w.]*")
_HINTS = {
    "^": "use ** for powers",
    ",": "a function takes exactly one argument",
    "=": "give the right-hand side only; there are no comparisons and no keyword arguments",
    "\n": "a term is one line",
    "\r": "a term is one line",
    ".": "there are no attributes",
}
_ALLOWED = "numbers, names, + - * / **, brackets and functions of one argument"
_OPERATORS: dict[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}


def _shown(text: object) -> str:
    shown = repr(text)
    return shown if len(shown) <= 60 else shown[:57] + "..."


def _error(text: object, reason: str) -> ExpressionError:
    return ExpressionError(f"expression {_shown(text)}: {reason}")


def _scan(text: str) -> None:
    """Refuse every character, number and keyword outside the language, by name and place."""
    at = 0
    while at < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            bad = _BAD_NUMBER.match(text, at)
            if bad is not None:
                raise _error(text, f"{_shown(bad[0])} is not a number; write 2, 0.5 or 1e-3")
            hint = _HINTS.get(text[at], f"there are {_ALLOWED}")
            raise _error(text, f"{text[at]!r} at column {at + 1} is not allowed: {hint}")
        name = token["name"]
        if name is not None:
            _check_name(text, name)
        at = token.end()


def _check_name(text: str, name: str) -> None:
    if keyword.iskeyword(name):
        raise _error(text, f"the word {name!r} is not allowed: there are {_ALLOWED}")
    if name.startswith("__"):
        raise _error(text, f"the name {_shown(name)} is not allowed: names must not begin with two underscores")


@lru_cache(maxsize=8192)
def _shared(node: Node) -> Node:
    """The first node made that equals this one: what is identical is found faster in dictionaries."""
    return node


class _Converter:
    """Python's syntax tree to ours, counting nodes and depth."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.nodes = 0

    def convert(self, node: ast.expr, depth: int = 1) -> Node:
        return _shared(self._converted(node, depth))

    def _converted(self, node: ast.expr, depth: int) -> Node:
        self.nodes += 1
        if depth > MAX_DEPTH:
            raise _error(self.text, f"nested deeper than {MAX_DEPTH} levels")
        if self.nodes > MAX_NODES:
            raise _error(self.text, f"more than {MAX_NODES} operations, names and numbers")
        match node:
            case ast.Constant(value=value):
                return self._number(value)
            case ast.Name(id=name):
                return self._symbol(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return Negate(self.convert(operand, depth + 1))
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.convert(operand, depth + 1)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return Binary(_OPERATORS[type(op)], self.convert(left, depth + 1), self.convert(right, depth + 1))
            case ast.Call():
                return self._call(node, depth)
        what = type(node).__name__
        raise _error(self.text, f"{what} is not allowed: there are {_ALLOWED}")

    def _number(self, value: object) -> Node:
        # The scan lets through decimal literals only: no bool, complex, str or bytes can arrive here.
        if type(value) is not int and type(value) is not float:
            raise _error(self.text, f"{_shown(value)} is not a number")
        try:
            finite = math.isfinite(float(value))
        except OverflowError:
            finite = False
        if not finite:
            raise _error(self.text, "a number is too large")
        return Number(value)

    def _symbol(self, name: str) -> Node:
        _check_name(self.text, name)  # again: Python normalises Unicode names (NFKC), the scan does not
        if name in FUNCTIONS:
            raise _error(self.text, f"{name} is a function and needs its argument: {name}(...)")
        return Symbol(name)

    def _call(self, node: ast.Call, depth: int) -> Node:
        if not isinstance(node.func, ast.Name):
            raise _error(self.text, "only functions can be called; write * for products")
        name = node.func.id
        if name not in FUNCTIONS:
            near = difflib.get_close_matches(name, FUNCTIONS, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]!r}?" if near else "write * for products"
            raise _error(self.text, f"no function {_shown(name)}; {hint} (there are: {', '.join(FUNCTIONS)})")
        if node.keywords or len(node.args) != 1 or isinstance(node.args[0], ast.Starred):
            raise _error(self.text, f"{name} takes exactly one argument")
        return Call(name, self.convert(node.args[0], depth + 1))


@lru_cache(maxsize=4096)
def _parse(text: str) -> Expression:
    stripped = text.strip(" \t")
    if not stripped:
        raise _error(text, "empty")
    _scan(text)
    try:
        body = ast.parse(stripped, mode="eval").body
    except (SyntaxError, ValueError):
        raise _error(text, "malformed: an operator, an operand or a bracket is missing or out of place") from None
    except (MemoryError, RecursionError):
        raise _error(text, f"nested deeper than {MAX_DEPTH} levels") from None
    expression = Expression(_Converter(text).convert(body))
    if len(expression.text) > MAX_LENGTH:
        # 1e15 is written 1000000000000000: what is accepted must also be accepted in canonical form.
        raise _error(text, f"longer than {MAX_LENGTH} characters in canonical form")
    return expression


def parse(text: str, names: Iterable[str] | None = None) -> Expression:
    """Parse a term or a right-hand side.

    Allowed are decimal numbers, names, ``+ - * / **``, unary ``+ -``, brackets and calls of one argument to
    sin, cos, tan, asin, acos, atan, exp, log, sqrt, abs, sign, sinh, cosh and tanh, with Python's precedence.
    At most 1000 characters, 50 levels and 500 nodes. The text is never evaluated.

    Parameters
    ----------
    text : str
        Such as ``"x**2*v"`` or ``"(u - c*v - k*x)/m"``.
    names : iterable of str, optional
        The names that may occur; without it every name may.

    Returns
    -------
    Expression
        Equal texts up to spaces, brackets and spelling of numbers give equal expressions.

    Raises
    ------
    ExpressionError
        If the text is malformed or uses anything else; one line that says what and where.
    UnknownNameError
        If a name is not among `names`.

    Examples
    --------
    >>> parse("x ** 2.0 * (v)")
    parse('x**2*v')
    >>> parse("x^2")
    Traceback (most recent call last):
    ...
    bayeq.errors.ExpressionError: expression 'x^2': '^' at column 2 is not allowed: use ** for powers
    >>> parse("k*x", names=["x", "v"])
    Traceback (most recent call last):
    ...
    bayeq.errors.UnknownNameError: expression 'k*x': no channel named 'k'; there are: x, v
    """
    if not isinstance(text, str):
        raise _error(text, f"a term is text (str), not {type(text).__name__}")
    if len(text) > MAX_LENGTH:
        raise _error(text, f"longer than {MAX_LENGTH} characters")
    expression = _parse(text)
    if names is not None:
        known = list(names)
        for name in sorted(expression.names.difference(known)):
            raise UnknownNameError("channel", name, known, where=f"expression {_shown(text)}")
    return expression
