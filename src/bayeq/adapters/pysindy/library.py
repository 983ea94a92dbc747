"""Feature libraries of PySINDy as dictionaries of `discover`: the names of the features, as terms."""

from __future__ import annotations

import copy
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from bayeq.errors import InputError
from bayeq.expressions import parse

# A number in front of an operand, as in "sin(2 x)".
_NUMBER = re.compile(r"[0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?")
_PLACEHOLDER = "x{}_"


def is_library(thing: Any) -> bool:
    """Whether something is a feature library of PySINDy, by its methods."""
    return all(callable(getattr(thing, name, None)) for name in ("fit", "transform", "get_feature_names"))


def terms_of(library: Any, names: Sequence[str]) -> list[str]:
    """Terms of a feature library of some channels; its constant is left out, for the intercept is always estimated.

    Names of features are read as docs/terms.md has terms, with spaces for products. The library need not be fitted, and
    stays as it is; the names are those of its columns: states first, then inputs. InputError: it cannot be fitted to
    these channels, or a feature has a name that is no term, or other values than its name says.

    >>> class Squares:
    ...     def fit(self, x): return self
    ...     def transform(self, x): return np.asarray(x) ** 2
    ...     def get_feature_names(self, names): return [f"{name}^2" for name in names]
    >>> terms_of(Squares(), ["x", "v"])
    ['x**2', 'v**2']
    """
    # placeholders, none of which is part of another, whatever the channels are called
    stand = [_PLACEHOLDER.format(k) for k in range(len(names))]
    samples = np.random.default_rng(0).uniform(0.5, 1.5, (8, len(names)))
    kind = type(library).__name__
    try:
        own = copy.deepcopy(library).fit(samples)
        columns = np.asarray(own.transform(samples), dtype=np.float64)
        features = [str(name) for name in own.get_feature_names(stand)]
    except Exception as error:
        # a library may raise whatever its functions do
        raise InputError(
            f"dictionary: {kind} cannot be evaluated on channels {', '.join(names)} ({error}); libraries of partial"
            " differential equations and weak forms are for PySINDy itself"
        ) from error
    if columns.shape != (len(samples), len(features)):
        raise InputError(f"dictionary: {kind} has {len(features)} names for columns of shape {columns.shape}")
    values = dict(zip(stand, samples.T, strict=True))
    terms: dict[str, None] = {}
    for feature, column in zip(features, columns.T, strict=True):
        if feature == "1":
            continue
        terms[_named(_term(feature, kind, stand, values, column, names), stand, names)] = None
    if not terms:
        raise InputError(f"dictionary: {kind} has no feature but the constant")
    return list(terms)


def _term(
    feature: str, kind: str, stand: Sequence[str], values: dict[str, Any], column: Any, names: Sequence[str]
) -> str:
    """A feature as a term of the placeholders, checked by its values."""
    from bayeq.expressions.evaluate import Evaluator

    text, shown = _products(feature.replace("^", "**")), _named(feature, stand, names)
    try:
        found = Evaluator(values)(parse(text, stand))
    except InputError as error:
        why = _named(str(error), stand, names)
        raise InputError(
            f"dictionary: feature {shown!r} of {kind} is no term ({why}); give the terms as text, or names that"
            " can be read by function_names"
        ) from error
    if not np.allclose(found, column, rtol=1e-9, atol=1e-12):
        raise InputError(
            f"dictionary: feature {shown!r} of {kind} does not have the values that its name says; give the terms as"
            " text, or the right function_names"
        )
    return text


def _named(text: str, stand: Sequence[str], names: Sequence[str]) -> str:
    for one, name in zip(stand, names, strict=True):
        text = re.sub(rf"(?<!\w){one}(?!\w)", name, text)
    return text


def _products(text: str) -> str:
    """Insert * between operands that stand side by side: ``2 x0 sin(x1)`` is ``2*x0*sin(x1)``."""
    token = re.compile(rf"\s*({_NUMBER.pattern}|[^\W\d]\w*|\*\*|.)\s*")
    out, before = "", ""
    for part in token.findall(text.strip()):
        operand = part[0].isalnum() or part[0] in "_.("
        ended = bool(before) and (before[-1].isalnum() or before[-1] in "_.)")
        called = part == "(" and bool(re.fullmatch(r"[^\W\d]\w*", before))
        out += "*" + part if operand and ended and not called else part
        before = part
    return out
