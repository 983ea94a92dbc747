"""``parse``: the text of a term, perhaps a stranger's, becomes a tree; nothing is evaluated, imported or looked up."""

from __future__ import annotations

import difflib
import keyword
import math
import re
import unicodedata
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import NamedTuple

from bayeq.errors import ExpressionError, UnknownNameError
from bayeq.expressions.functions import ALIASES, COMPARISONS, CONSTANTS, FUNCTIONS, SQUARE
from bayeq.expressions.nodes import (
    OPERATORS,
    Binary,
    Call,
    Constant,
    Expression,
    Negate,
    Node,
    Number,
    Symbol,
    Unknown,
    arguments_of,
    is_comparison,
    replaced,
)

MAX_LENGTH = 1000
MAX_DEPTH = 50
MAX_NODES = 500

# Brackets, signs and functions within each other, needless ones too.
MAX_NESTING = 2 * MAX_DEPTH

_NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.])"
_NAME = r"[^\W\d]\w*"
_BRACES = r"\{[^{}]*\}"
_BEFORE = r"\[-[1-9][0-9]?\]"
_TOKEN = re.compile(
    rf"(?P<number>{_NUMBER})|(?P<name>{_NAME}(?:{_BEFORE})?)|(?P<unknown>{_BRACES})|(?P<mark>\*\*|[<>=!]=|[-+*/^()<>,])"
)
_SIGNED = r"[-+]?(?:[0-9]+(?:\.(?!\.)[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_ENDS = rf"(?P<low>{_SIGNED})\s*\.\.(?!\.)\s*(?P<high>{_SIGNED})"
_UNKNOWN = re.compile(rf"\{{\s*(?P<name>{_NAME})\s*(?::\s*{_ENDS}\s*)?\}}")

#: An earlier sample of a channel, as ``x[-1]``, by `name` and `back`.
EARLIER = re.compile(rf"(?P<name>{_NAME})\[-(?P<back>[1-9][0-9]?)\]")
# An earlier sample that is written as a function: x(-1), x(k-1).
_BACK = re.compile(r"\s*\(\s*\w?\s*-\s*([1-9][0-9]?)\s*\)")

#: A map of this many earlier samples, at most.
MOST_EARLIER = 20

_BAD_NUMBER = re.compile(r"\.?[0-9][\w.]*")
_ALLOWED = "numbers, names, + - * / **, brackets and functions"
_HINTS = {
    "=": "give the right-hand side only; there are no keyword arguments, and == compares",
    "\n": "a term is one line",
    "\r": "a term is one line",
    ".": "there are no attributes",
    "{": "an unknown constant is {name}, or {name: low..high}, and ends with }",
    "}": "it ends no unknown constant, {name}",
    ";": f"there are {_ALLOWED}, and commas between terms",
    "=>": "write >=",
    "=<": "write <=",
    "x[": f"earlier samples of maps are x[-1] to x[-{MOST_EARLIER}], and this one is x",
    "|": "it stands between whole terms, of which one is in",
}
_CONDITION = "comparisons are conditions of where, as in where(x > 0, x, 0)"


class _Token(NamedTuple):
    kind: str  # number, name, unknown, mark or end
    text: str
    column: int  # counted from 1


def _shown(text: object) -> str:
    shown = repr(text)
    return shown if len(shown) <= 60 else shown[:57] + "..."


def _error(text: object, reason: str) -> ExpressionError:
    return ExpressionError(f"expression {_shown(text)}: {reason}")


def _tokens(text: str) -> list[_Token]:
    """The tokens of a text, which refuses every character, number and word outside the language, by name and place."""
    out, at = [], 0
    while (at := len(text) - len(text[at:].lstrip(" \t"))) < len(text):
        token = _TOKEN.match(text, at)
        if token is None:
            bad = _BAD_NUMBER.match(text, at)
            if bad is not None:
                raise _error(text, f"{_shown(bad[0])} is not a number, at column {at + 1}; write 2, 0.5 or 1e-3")
            mark = text[at : at + 2] if text[at : at + 2] in _HINTS else text[at]
            behind = re.search(r"(\w+)\s*$", text[:at]) if mark == "[" else None
            hint = _HINTS.get("x[" if behind else mark, f"there are {_ALLOWED}")
            if behind and behind[1] in FUNCTIONS:
                hint = f"arguments stand in round brackets, {behind[1]}(...)"
            raise _error(text, f"{mark!r} at column {at + 1} is not allowed: {hint}")
        kind, part = str(token.lastgroup), token[0]
        if kind == "name":
            part = _name(text, part, at + 1)
        elif kind == "number" and re.fullmatch(r"0+[1-9][0-9]*", part):
            raise _error(text, f"{_shown(part)} is not a number, at column {at + 1}; leave out the zeros in front")
        out.append(_Token(kind, "**" if part == "^" else part, at + 1))
        at = token.end()
    return [*out, _Token("end", "", len(text.rstrip(" \t")) + 1)]


def _name(text: str, written: str, column: int) -> str:
    """A name in Python's normal form (NFKC), with the ``[-k]`` of an earlier sample; ExpressionError if refused."""
    written, bracket, back = written.partition("[")
    name = unicodedata.normalize("NFKC", written)
    if not written.isidentifier() or not re.fullmatch(_NAME, name):
        raise _error(text, f"{_shown(written)} at column {column} is not allowed as a name")
    if keyword.iskeyword(name):
        raise _error(text, f"the word {name!r} is not allowed: there are {_ALLOWED}")
    if name.startswith("__"):
        raise _error(text, f"the name {_shown(name)} is not allowed: names must not begin with two underscores")
    return name + bracket + back


class _Parser:
    """Tokens to a tree, counting nodes and depth."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = _tokens(text)
        self.at = 0
        self.nodes = 0
        self.nesting = 0
        self.depth: dict[Node, int] = {}
        self.compared: dict[Node, int] = {}  # columns of comparisons

    @property
    def next(self) -> _Token:
        return self.tokens[self.at]

    def take(self) -> _Token:
        self.at += 1
        return self.tokens[self.at - 1]

    def accept(self, *marks: str) -> _Token | None:
        return self.take() if self.next.kind == "mark" and self.next.text in marks else None

    def error(self, reason: str) -> ExpressionError:
        return _error(self.text, reason)

    def made(self, node: Node) -> Node:
        """A new node, unless there are too many or it is too deep."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise self.error(f"more than {MAX_NODES} operations, names and numbers")
        depth = 1 + max((self.depth[part] for part in arguments_of(node)), default=0)
        if depth > MAX_DEPTH:
            raise self.error(f"nested deeper than {MAX_DEPTH} levels")
        self.depth[node] = depth
        return node

    def whole(self) -> Node:
        node = self.value()
        if self.next.kind != "end":
            raise self.error(self.misplaced())
        return node

    def misplaced(self) -> str:
        """Message about a token where an operator, or the end, should be."""
        token = self.next
        where = f"{_shown(token.text)} at column {token.column}"
        if token.text == ")":
            return f"{where} closes no bracket"
        if token.text == ",":
            return f"{where} is not allowed: commas stand between the arguments of a function"
        if token.text == "(":
            return f"{where} follows a value; write * for products"
        return f"malformed: an operator is missing before {where}; words of a name are joined by _, as Position_1"

    def value(self) -> Node:
        """Anything but a comparison."""
        node = self.operation()
        if isinstance(node, Binary) and node.op in COMPARISONS:
            raise self.error(f"{node.op!r} at column {self.compared[node]} is not allowed: {_CONDITION}")
        return node

    def operation(self, least: int = 0) -> Node:
        """Values and the operators between them that bind at least as strongly as `least`; comparisons bind weakest."""
        left = self.signed()
        while (op := self.next).kind == "mark" and OPERATORS.get(op.text, -1) >= least:
            if op.text in COMPARISONS and is_comparison(left):
                raise self.error(f"{op.text!r} at column {op.column}: one comparison each; nest where in where")
            self.take()
            right = self.operation(OPERATORS[op.text] + 1)
            left = self.made(Binary(op.text, self.number(left, op), self.number(right, op)))
            if op.text in COMPARISONS:
                self.compared[left] = op.column
        return left

    def number(self, node: Node, op: _Token) -> Node:
        """An operand, which must be no comparison."""
        if is_comparison(node):
            raise self.error(f"{op.text!r} at column {op.column} has a comparison beside it: {_CONDITION}")
        return node

    def condition(self) -> Node:
        """The first argument of where."""
        column = self.next.column
        node = self.operation()
        if not is_comparison(node):
            raise self.error(f"where needs a condition at column {column}, as in where(x > 0, x, 0)")
        return node

    def signed(self) -> Node:
        """A value with signs in front and a power behind."""
        self.nesting += 1
        if self.nesting > MAX_NESTING:
            raise self.error(f"nested deeper than {MAX_DEPTH} levels")
        sign = self.accept("-", "+")
        if sign is not None:
            node = self.number(self.signed(), sign)
            node = self.made(Negate(node)) if sign.text == "-" else node
        else:
            node = self.atom()
            power = self.accept("**")
            if power is not None:
                exponent = self.number(self.signed(), power)
                node = self.made(Binary("**", self.number(node, power), exponent))
        self.nesting -= 1
        return node

    def atom(self) -> Node:
        token = self.take()
        if token.kind == "number":
            return self.made(self.constant(token))
        if token.kind == "unknown":
            return self.made(self.unknown(token))
        if token.kind == "name":
            opened = self.accept("(")
            return self.call(token, opened) if opened else self.made(Symbol(token.text))
        if token.text == "(":
            node = self.operation()
            self.close(token)
            return node
        self.at -= 1
        what = "at the end" if token.kind == "end" else f"before {token.text!r}"
        raise self.error(f"malformed: a number, a name or a bracket is missing {what}, at column {token.column}")

    def close(self, opened: _Token) -> None:
        if self.accept(")") is None:
            if self.next.kind != "end":
                raise self.error(self.misplaced())
            raise self.error(f"missing ')' at column {self.next.column}, of the bracket at column {opened.column}")

    def unknown(self, token: _Token) -> Unknown:
        found = _UNKNOWN.fullmatch(token.text)
        if found is None:
            place = f"{_shown(token.text)} at column {token.column}"
            raise self.error(f"{place}: an unknown constant is {{name}}, or {{name: low..high}}, as in {{v0: 0.01..3}}")
        name = _name(self.text, found["name"], token.column)
        ends = [math.nan if end is None else float(end) for end in (found["low"], found["high"])]
        if not math.isnan(ends[0]) and not -math.inf < ends[0] < ends[1] < math.inf:
            raise self.error(f"the range of {{{name}}} at column {token.column} is empty: write the lower end first")
        return Unknown(name, *ends)

    def constant(self, token: _Token) -> Number:
        value = float(token.text)
        if not math.isfinite(value):
            raise self.error(f"a number is too large, at column {token.column}")
        return Number(int(token.text) if token.text.isdigit() else value)

    def call(self, name: _Token, opened: _Token) -> Node:
        function = ALIASES.get(name.text, name.text)
        if function not in FUNCTIONS and function != SQUARE:
            raise self.error(self.no_function(name))
        arguments: list[Node] = []
        if self.accept(")") is None:
            while True:
                first = function == "where" and not arguments
                arguments.append(self.condition() if first else self.value())
                if self.accept(",") is None:
                    break
            self.close(opened)
        least, most = (1, 1) if function == SQUARE else FUNCTIONS[function].arguments
        if not least <= len(arguments) <= (most or len(arguments)):
            words = {1: "one argument", 2: "two arguments", 3: "three arguments"}
            takes = f"exactly {words[least]}" if most == least else f"{words[least]} or more"
            raise self.error(f"{name.text} takes {takes}, not {len(arguments)}, at column {name.column}")
        if function == SQUARE:
            return self.made(Binary("**", arguments[0], self.made(Number(2))))
        return self.made(Call(function, tuple(arguments)))

    def no_function(self, name: _Token) -> str:
        near = difflib.get_close_matches(name.text, [*FUNCTIONS, *ALIASES, SQUARE], n=1, cutoff=0.6)
        missing = f"at column {name.column} there is no function {_shown(name.text)}"
        if (back := _BACK.match(self.text, name.column - 1 + len(name.text))) is not None:
            return f"{missing}; an earlier sample of a map is written {name.text}[-{back[1]}]"
        if near:
            return f"{missing}; did you mean {near[0]!r}?"
        return f"{missing}; write * for products (there are: {', '.join(FUNCTIONS)})"


@lru_cache(maxsize=4096)
def _parse(text: str) -> Expression:
    if not text.strip(" \t"):
        raise _error(text, "empty")
    expression = Expression(_Parser(text).whole())
    if len(expression.text) > MAX_LENGTH:
        # 1e15 is written 1000000000000000: what is accepted must also be accepted in canonical form.
        raise _error(text, f"longer than {MAX_LENGTH} characters in canonical form")
    return expression


def parse(text: str, names: Iterable[str] | None = None) -> Expression:
    """Parse a term or a right-hand side, such as ``"x**2*v"`` or ``"(u - c*v - k*x)/m"``.

    docs/terms.md has the language; the text is never evaluated. ``pi`` and ``e`` are numbers unless `names` has them.
    Without `names` every name may occur that is not a function's. Texts that are equal up to spaces, brackets, spelling
    of numbers and of functions give equal expressions.

    ExpressionError if the text is malformed or uses anything else, a line that says what and where; UnknownNameError if
    a name is not among `names`.

    >>> parse("x ** 2.0 * (v)")
    parse('x**2*v')
    >>> parse("x^2 + arctan2(v, x)")
    parse('x**2+atan2(v,x)')
    >>> parse("sin(x")
    Traceback (most recent call last):
    ...
    bayeq.errors.ExpressionError: expression 'sin(x': missing ')' at column 6, of the bracket at column 4
    >>> parse("k*x", names=["x", "v"])
    Traceback (most recent call last):
    ...
    bayeq.errors.UnknownNameError: expression 'k*x', column 1: no channel named 'k'; there are: x, v
    """
    if not isinstance(text, str):
        raise _error(text, f"a term is text (str), not {type(text).__name__}")
    if len(text) > MAX_LENGTH:
        raise _error(text, f"longer than {MAX_LENGTH} characters")
    expression = _parse(text)
    known = () if names is None else tuple(names)
    for name in sorted(expression.names.difference(known)):
        if name in FUNCTIONS:
            reason = f"{name} is a function and needs its argument: {name}(...), at column {_column(text, name)}"
            raise _error(text, reason)
        if names is not None and name not in CONSTANTS:
            place = f"expression {_shown(text)}, column {_column(text, name)}"
            raise UnknownNameError("channel", name, list(known), where=place)
    constants = expression.names.intersection(CONSTANTS).difference(known)
    named: dict[Node, Node] = {Symbol(name): Constant(name) for name in constants}
    return Expression(replaced(expression.tree, named)) if named else expression


def _column(text: str, name: str) -> int:
    """Where a name stands in a text that has been parsed, counted from 1."""
    return next(token.column for token in _tokens(text) if token.kind == "name" and token.text == name)


# The names of the arguments in the definitions of functions.
_PLACES = ("a", "b")


@lru_cache(maxsize=64)
def template(text: str) -> Node:
    """A function by other functions: an expression in a and b, which stand for its arguments."""
    return parse(text, _PLACES).tree


def substituted(node: Node, arguments: Sequence[Node]) -> Node:
    """A template with arguments for a and b.

    >>> Expression(substituted(template("(1+sign(a))/2"), [parse("x-v").tree])).text
    '(1+sign(x-v))/2'
    """
    places = (Symbol(name) for name in _PLACES)
    return replaced(node, dict(zip(places, arguments, strict=False)))
