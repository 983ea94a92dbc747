"""The right-hand side as a vectorised function of NumPy or JAX."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from bayeq.errors import InputError, MissingExtraError, UnknownNameError
from bayeq.expressions import Binary, Call, Constant, Evaluator, Expression, Negate, Node, Number, Unknown
from bayeq.expressions.functions import COMPARISONS, CONSTANTS, FUNCTIONS, TIME
from bayeq.expressions.parse import substituted, template
from bayeq.forecast.dynamics import Law, solved_laws
from bayeq.states import rates

__all__ = ["MODULES", "to_callable"]

MODULES = ("numpy", "jax")


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
        rows = [row for law in laws for row in _derivatives(law, columns, evaluate, not states)]
        return array.stack(array.broadcast_arrays(*rows))

    return rhs


def _derivatives(
    law: Law, columns: Mapping[str, Any], evaluate: Callable[[Expression], Any], static: bool
) -> list[Any]:
    """Of the states of a chain; the target of a law where there are only `static` ones."""
    total: Any = law.posterior.intercept
    for j in np.flatnonzero(law.posterior.support).tolist():
        total = total + float(law.posterior.coef[j]) * evaluate(law.terms[j])
    above = [*(columns[name] for name in law.chain.states[1:]), total]
    factors = rates(law.chain, law.unit_gains) or (1.0,) * static
    return [factor * row for factor, row in zip(factors, above, strict=False)]


def _value(node: Node, columns: Mapping[str, Any], array: Any) -> Any:
    """Value of an expression by the functions of an array module that has NumPy's names."""
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
            return _operated(op, array.asarray(a) if op == "/" else a, b, array)
        case Call(function, arguments) if FUNCTIONS[function].definition:
            return _value(substituted(template(FUNCTIONS[function].definition), arguments), columns, array)
        case Call(function, arguments):
            return _called(function, [_value(argument, columns, array) for argument in arguments], array)
        case _:
            return columns[node.name]


def _operated(op: str, a: Any, b: Any, array: Any) -> Any:
    if op == "**":
        return a**b if isinstance(b, int) and not isinstance(a, int) else array.power(array.asarray(a, dtype=float), b)
    return a + b if op == "+" else a - b if op == "-" else a * b if op == "*" else a / b


def _called(function: str, arguments: list[Any], array: Any) -> Any:
    if function == "erf":
        return import_module("jax.scipy.special").erf(*arguments)
    if function in ("max", "min"):
        combine = array.maximum if function == "max" else array.minimum
        total = arguments[0]
        for argument in arguments[1:]:
            total = combine(total, argument)
        return total
    if function == "where":
        return array.where(*arguments)
    return getattr(array, FUNCTIONS[function].numpy.__name__)(*arguments)
