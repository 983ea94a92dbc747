"""The right-hand side as a vectorised function of NumPy or JAX, or as source text of a language.

Source text is by SymPy's printers. A new language is a row of `LANGUAGES`.
"""

from __future__ import annotations

import keyword
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from importlib import import_module
from math import floor, isfinite, log10
from typing import Any, Literal, NamedTuple

import numpy as np

from bayeq.errors import InputError, MissingExtraError, UnknownNameError
from bayeq.expressions import Binary, Call, Constant, Evaluator, Expression, Negate, Node, Number, Unknown, to_sympy
from bayeq.expressions.functions import COMPARISONS, CONSTANTS, FUNCTIONS, TIME
from bayeq.expressions.parse import EARLIER, substituted, template
from bayeq.forecast.dynamics import Law, solved_laws
from bayeq.states import rates

MODULES = ("numpy", "jax")
OPERATORS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow}


def to_callable(laws: Sequence[Law], inputs: Sequence[str], timed: bool, module: str) -> Callable[..., Any]:
    """See `bayeq.Equations.to_callable`."""
    if module not in MODULES:
        raise UnknownNameError("module", module, MODULES)
    array: Any = np
    if module == "jax":
        try:
            array = import_module("jax.numpy")
        except ImportError:
            raise MissingExtraError("jax", "jax", "a function of JAX") from None
    states, laws = [name for law in laws for name in law.chain.states], solved_laws(laws)

    def rhs(t: Any, y: Any, u: Any = None) -> Any:
        y, u = array.asarray(y), array.asarray([] if u is None else u)
        u = u[None] if u.ndim == 0 else u
        for what, names, given in (("state", states, y), ("input", inputs, u)):
            if given.ndim not in (1, 2) or given.shape[0] != len(names):
                raise InputError(f"{len(names)} rows of the {what} are needed {tuple(names)}, got shape {given.shape}")
        columns = dict(zip(states, y, strict=True)) | dict(zip(inputs, u, strict=True))
        if timed:
            columns[TIME] = array.asarray(t)
        evaluate = Evaluator(columns) if module == "numpy" else lambda term: _value(term.tree, columns, array)
        rows = [row for law in laws for row in derivatives(law, columns, evaluate, not states)]
        return array.stack(array.broadcast_arrays(*rows))

    return rhs


def right_hand_side(law: Law, evaluate: Callable[[Expression], Any], number: Callable[[float], Any] = float) -> Any:
    """Intercept and terms of a law, summed, in numbers or in SymPy."""
    p = law.posterior
    total = number(p.intercept)
    for j in np.flatnonzero(p.support).tolist():
        total = total + number(float(p.coef[j])) * evaluate(law.terms[j])
    return total


def derivatives(
    law: Law,
    columns: Mapping[str, Any],
    evaluate: Callable[[Expression], Any],
    static: bool,
    number: Callable[[float], Any] = float,
) -> list[Any]:
    """Time derivatives of a chain's states, in numbers or SymPy; the law's target with `static`, if all laws are."""
    above = [*(columns[name] for name in law.chain.states[1:]), right_hand_side(law, evaluate, number)]
    factors = rates(law.chain, law.unit_gains) or (1.0,) * static
    return [row if factor == 1.0 else number(factor) * row for factor, row in zip(factors, above, strict=False)]


def _value(node: Node, columns: Mapping[str, Any], array: Any) -> Any:
    """Value of an expression by the functions of `array`, a module with NumPy's names."""
    match node:
        case Number(value) | Unknown(value=value):
            return value
        case Constant(name):
            return CONSTANTS[name]
        case Negate(operand):
            return -_value(operand, columns, array)
        case Binary(op, left, right):
            a, b = _value(left, columns, array), _value(right, columns, array)
            if op in COMPARISONS:
                return getattr(array, COMPARISONS[op].numpy.__name__)(a, b)
            if op == "**" and not (isinstance(b, int) and not isinstance(a, int)):
                return array.power(array.asarray(a, dtype=float), b)
            return OPERATORS[op](array.asarray(a) if op == "/" else a, b)
        case Call(function, arguments) if FUNCTIONS[function].definition:
            return _value(substituted(template(FUNCTIONS[function].definition), arguments), columns, array)
        case Call(function, arguments):
            values = [_value(argument, columns, array) for argument in arguments]
            if function == "erf":
                return import_module("jax.scipy.special").erf(*values)
            if function in ("max", "min"):
                return reduce(array.maximum if function == "max" else array.minimum, values)
            name = "where" if function == "where" else FUNCTIONS[function].numpy.__name__
            return getattr(array, name)(*values)
        case _:
            return columns[node.name]


# --- source text -----------------------------------------------------------------------------------------------------

# Significant digits that determine a float.
DIGITS = 17

# Names of every generated function, of its arguments and of its result.
OWN = {"rhs", "t", "y", "u", "dy"}


class Language(NamedTuple):
    """How the function is written in one language."""

    printer: str  # name of SymPy's printer
    # beginning of the text; `{states}` and `{inputs}` are names, `{size}` is the number of states
    head: str
    # line that reads a variable, and line that sets a derivative: `{name}`, `{of}` ("y" or "u"), `{k}`, `{value}`
    take: str
    give: str
    tail: str
    first: int  # number of the first entry of an array
    reserved: frozenset[str]  # words and functions that no variable may be called
    options: Mapping[str, Any] = {}  # options of the printer


C_WORDS = """auto break case char const continue default do double else enum extern float for goto if inline int long
register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while main pow
fabs fmax fmin sqrt cbrt exp log log1p log10 log2 exp2 expm1 sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh
atanh erf floor ceil hypot"""
JULIA_WORDS = """baremodule begin break catch const continue do else elseif end export false finally for function global
if import let local macro module quote return struct true try using while abstract mutable primitive type where in isa
abs sqrt cbrt exp log sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh erf floor ceil pi im"""
MATLAB_WORDS = """break case catch classdef continue else elseif end for function global if otherwise parfor persistent
return spmd switch try while abs sqrt exp log sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh erf
floor ceil max min pi zeros"""

LANGUAGES: dict[str, Language] = {
    "c": Language(
        "ccode",
        "/* dy = f(t, y, u); y: {states}; u: {inputs} */\n#include <math.h>\n\n"
        "void rhs(double t, const double *y, const double *u, double *dy)\n{{\n    (void)t; (void)y; (void)u;\n",
        "    const double {name} = {of}[{k}];",
        "    dy[{k}] = {value};",
        "}}\n",
        0,
        frozenset(C_WORDS.split()),
        {"math_macros": {}},  # constants as numbers: standard C has no M_PI
    ),
    "julia": Language(
        "julia_code",
        "# dy = f(t, y, u); y: {states}; u: {inputs}. erf is in SpecialFunctions.jl.\nfunction rhs(t, y, u)\n",
        "    {name} = {of}[{k}]",
        "    dy{k} = {value}",
        "    return [{results}]\nend\n",
        1,
        frozenset(JULIA_WORDS.split()),
    ),
    "matlab": Language(
        "octave_code",
        "% dy = f(t, y, u); y: {states}; u: {inputs}\nfunction dy = rhs(t, y, u)\n    dy = zeros({size}, 1);\n",
        "    {name} = {of}({k});",
        "    dy({k}) = {value};",
        "end\n",
        1,
        frozenset(MATLAB_WORDS.split()),
    ),
    "python": Language(
        "pycode",
        'import math\n\n\ndef rhs(t, y, u=()):\n    """dy = f(t, y, u); y: {states}; u: {inputs}."""\n',
        "    {name} = {of}[{k}]",
        "    dy{k} = {value}",
        "    return [{results}]\n",
        0,
        frozenset({*keyword.kwlist, *keyword.softkwlist, "math", "abs", "max", "min", "float"}),
    ),
}


def to_code(laws: Sequence[Law], inputs: Sequence[str], timed: bool, language: str) -> str:
    """See `bayeq.Equations.to_code`."""
    if language not in LANGUAGES:
        raise UnknownNameError("language", language, list(LANGUAGES))
    row = LANGUAGES[language]
    import sympy

    states = [name for law in laws for name in law.chain.states]
    places = {name: ("y", k) for k, name in enumerate(states)} | {name: ("u", k) for k, name in enumerate(inputs)}
    called = _names(list(places), row, len(states) or len(laws))
    renamed = {sympy.Symbol(name): sympy.Symbol(new) for name, new in called.items()}
    symbols = {name: sympy.Symbol(name) for name in states}

    def number(value: float) -> Any:
        return sympy.Float(value, DIGITS)

    rows = (derivatives(law, symbols, _plain, not states, number) for law in solved_laws(laws))
    slopes = [slope.xreplace(renamed) for of_chain in rows for slope in of_chain]
    used = {str(symbol) for slope in slopes for symbol in slope.free_symbols}
    results = [f"dy{row.first + k}" for k in range(len(slopes))]
    about = {
        "states": ", ".join(map(_about, states)) or f"none, dy: {', '.join(_about(law.chain.target) for law in laws)}",
        "inputs": ", ".join(map(_about, inputs)) or "none",
        "size": len(slopes),
        "results": ", ".join(results),
    }
    lines = [
        row.take.format(name=called[name], of=of, k=row.first + k)
        for name, (of, k) in places.items()
        if called[name] in used
    ]
    lines += [row.give.format(k=row.first + k, value=_printed(slope, row, language)) for k, slope in enumerate(slopes)]
    head = row.head.format(**about)
    if laws[0].chain.discrete:
        head = head.replace("dy = f(t, y, u);", "dy, the next y, = f(t, y, u);")
    return head + "\n".join(lines) + "\n" + row.tail.format(**about)


def _names(names: Sequence[str], row: Language, size: int) -> dict[str, str]:
    """Names that the language allows, by the names of channels."""
    taken = OWN | row.reserved | {f"dy{row.first + k}" for k in range(size)}
    out: dict[str, str] = {}
    for name in names:
        new = _ascii(EARLIER.sub(r"\g<name>_back\g<back>", name))
        new = new if new[0].isalpha() else f"v{new}"
        while new in taken:
            new += "_"
        taken = taken | {new}
        out[name] = new
    return out


def _about(name: str) -> str:
    """A channel's name for a comment: in ASCII, with the step in brackets."""
    base, bracket, step = name.partition("[")
    return _ascii(base) + bracket + step


def _ascii(name: str) -> str:
    """A name in letters of ASCII, digits and underscores: theta is written u03b8."""
    return "".join(c if re.fullmatch(r"[A-Za-z0-9_]", c) else f"u{ord(c):04x}" for c in name)


def _plain(term: Expression) -> Any:
    """A term in SymPy; what printers lack or change is rewritten: sign, step and mod, e and pi as numbers."""
    import sympy

    expression, half = to_sympy(term), sympy.Rational(1, 2)
    rules: Mapping[Any, Any] = {
        sympy.sign: lambda a: sympy.Piecewise((1, a > 0), (-1, a < 0), (0, True)),
        sympy.Heaviside: lambda a, *_: sympy.Piecewise((1, a > 0), (0, a < 0), (half, True)),
        sympy.Mod: lambda a, b: a - b * sympy.floor(a / b),
    }
    for function, rule in rules.items():
        expression = expression.replace(function, rule)
    constants = {sympy.E: sympy.Float(sympy.E, DIGITS), sympy.pi: sympy.Float(sympy.pi, DIGITS)}
    # not by `subs`: for SymPy exp(x) is a power of E
    return expression.replace(lambda part: part in constants, lambda part: constants[part])


def _printed(slope: Any, row: Language, language: str) -> str:
    import sympy

    try:
        text = str(getattr(sympy, row.printer)(slope, **row.options))
    except (NotImplementedError, TypeError, ValueError) as error:
        raise InputError(f"the equation cannot be written in {language}: {str(error).splitlines()[0]}") from error
    return " ".join(text.replace("...\n", " ").split())


Uncertainty = Literal["none", "brackets", "plus-minus"]

# Decimal exponents of numbers that are written without a power of ten.
PLAIN_POWERS = range(-3, 5)
MOST_PLACES = 12


def sum_in_latex(parts: Sequence[tuple[float, float, str]], uncertainty: Uncertainty) -> str:
    r"""A sum of numbers, with standard deviations, times terms in LaTeX.

    >>> sum_in_latex([(-992.61, 2.64, "x"), (-2.0e-7, 3.1e-9, "v"), (1.5, 0.012, "")], "brackets")
    '-992.6(2.6)\\,x - 2.000(31) \\times 10^{-7}\\,v + 1.500(12)'
    >>> sum_in_latex([(-992.61, 2.64, "x")], "plus-minus")
    '\\left(-992.6 \\pm 2.6\\right)\\,x'
    """
    out = ""
    for value, sd, term in parts:
        inside = uncertainty == "plus-minus"  # the brackets include the sign
        sign = "-" if value < 0 and not inside else "+"
        number = _with_sd(value if inside else abs(value), sd, uncertainty)
        body = f"{number}\\,{term}" if term else number
        out += f" {sign} {body}" if out else f"-{body}" if sign == "-" else body
    return out or "0"


def _with_sd(value: float, sd: float, uncertainty: Uncertainty) -> str:
    """A number with its standard deviation: the latter with two digits, the number to the same place."""
    if not (sd > 0 and isfinite(sd)):
        return f"{value:.12g}"
    power = floor(log10(max(abs(value), sd)))
    places = 1 - floor(log10(sd))
    shift = 0 if power in PLAIN_POWERS and places >= 0 else power
    places = min(max(places + shift, 0), MOST_PLACES)
    number, error = f"{value / 10.0**shift:.{places}f}", f"{sd / 10.0**shift:.{places}f}"
    factor = f" \\times 10^{{{shift}}}" if shift else ""
    if uncertainty == "plus-minus":
        return f"\\left({number} \\pm {error}\\right){factor}"
    # the last digits of the standard deviation, with a decimal point if it is 1 or more
    digits = error if float(error) >= 1 else error.replace(".", "").lstrip("0")
    return f"{number}({digits or 0}){factor}"
