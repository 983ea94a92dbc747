"""The JSON schema of saved equations and of ``discover --json``, and checks of content.

Only keywords that `schema.json` uses are implemented; `tests/test_saved_files.py` checks that they are all.
"""

from __future__ import annotations

import json
import operator
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from bayeq.inference.engines import ENGINES
from bayeq.states import Chain

Schema = Mapping[str, Any]
Saved = Mapping[str, Any]

MOST = sys.float_info.max

TYPES: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "object": ("an object", lambda value: isinstance(value, dict)),
    "array": ("a list", lambda value: isinstance(value, list)),
    "string": ("text", lambda value: isinstance(value, str)),
    "boolean": ("true or false", lambda value: isinstance(value, bool)),
    "integer": ("a whole number", lambda value: _is_number(value) and value == value // 1),
    "number": ("a number", lambda value: _is_number(value)),
    "null": ("null", lambda value: value is None),
}
BOUNDS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "minimum": ("at least", operator.ge),
    "exclusiveMinimum": ("more than", operator.gt),
    "maximum": ("at most", operator.le),
    "exclusiveMaximum": ("less than", operator.lt),
}


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of what ``bayeq discover --json`` prints and ``Equations.save`` writes.

    Returns
    -------
    dict
        The schema; its ``$id`` ends with the version of the format of saved files.

    Examples
    --------
    >>> json_schema()["$id"]
    'urn:bayeq:equations:1'
    """
    found: dict[str, Any] = json.loads((files("bayeq.equation") / "schema.json").read_text(encoding="utf-8"))
    found["properties"]["method"]["enum"] = list(ENGINES.load())
    return found


@cache
def _schema() -> dict[str, Any]:
    return json_schema()


def first_fault(content: object) -> str | None:
    """The first violation of the schema in parsed JSON, with its place; None if there is none.

    >>> first_fault({"method": 1})
    'data is missing'
    """
    return next(_faults(content, _schema(), ""), None)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value - value == 0  # neither NaN nor inf


def _resolved(schema: Schema) -> Schema:
    return _schema()["$defs"][schema["$ref"].removeprefix("#/$defs/")] if "$ref" in schema else schema


def _shown(value: object) -> str:
    text = ascii(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _faults(value: Any, schema: Schema, place: str) -> Iterator[str]:
    schema = _resolved(schema)
    where = place or "the file"
    if "enum" in schema and not any(type(value) is type(one) and value == one for one in schema["enum"]):
        yield f"{where}: one of {', '.join(map(repr, schema['enum']))} is expected, not {_shown(value)}"
    if "type" in schema:
        kinds = [schema["type"]] if isinstance(schema["type"], str) else schema["type"]
        if not any(TYPES[kind][1](value) for kind in kinds):
            yield f"{where}: {' or '.join(TYPES[kind][0] for kind in kinds)} is expected, not {_shown(value)}"
            return
    if _is_number(value):
        for keyword, (words, holds) in BOUNDS.items():
            if keyword in schema and not holds(value, schema[keyword]):
                yield f"{where}: {words} {schema[keyword]:g} is expected, not {_shown(value)}"
    elif isinstance(value, list):
        yield from _faults_of_list(value, schema, where, place)
    elif isinstance(value, dict):
        yield from _faults_of_object(value, schema, place)


def _faults_of_list(value: list[Any], schema: Schema, where: str, place: str) -> Iterator[str]:
    least, most = schema.get("minItems", 0), schema.get("maxItems", len(value))
    if not least <= len(value) <= most:
        expected = f"{least}" if least == most else f"at least {least}"
        yield f"{where}: {expected} entries are expected, not {len(value)}"
    items = _resolved(schema.get("items", {}))
    if items and not _are_numbers(value, items):
        for k, item in enumerate(value):
            yield from _faults(item, items, f"{place}[{k}]")


def _are_numbers(values: list[Any], schema: Schema) -> bool:
    """Whether all entries are numbers within bounds: a fast check that spares long lists one for each entry."""
    if not set(schema) <= {"type", "minimum", "maximum"} or schema["type"] not in ("integer", "number"):
        return False
    if not set(map(type, values)) <= ({int} if schema["type"] == "integer" else {int, float}):
        return False
    least, most = min(values, default=0), max(values, default=0)
    within = schema.get("minimum", -MOST) <= least and most <= schema.get("maximum", MOST)
    return bool(within and sum(values) == sum(values))  # NaN is not equal to itself


def _faults_of_object(value: dict[str, Any], schema: Schema, place: str) -> Iterator[str]:
    prefix = f"{place}." if place else ""
    beside = schema.get("dependentRequired", {})
    for name in (*schema.get("required", ()), *(other for key in beside if key in value for other in beside[key])):
        if name not in value:
            yield f"{prefix}{name} is missing"
    properties, further = schema.get("properties", {}), schema.get("additionalProperties", True)
    for name, item in value.items():
        shown = name if name.isidentifier() and name.isascii() else _shown(name)
        if name in properties:
            yield from _faults(item, properties[name], prefix + shown)
        elif further is False:
            yield f"{prefix}{shown}: no such key"
        elif further is not True:
            yield from _faults(item, further, prefix + shown)


# --- checks beyond the schema: lengths and names that must agree, indices that exist, covariances --------------------

# Saved covariances must be symmetric and positive semidefinite within this tolerance; eigenvalues are checked for
# matrices up to this size, whose decomposition takes no time.
ROUNDING = 1e-6
MOST_DECOMPOSED = 200

# Columns of the terms that all of them have, or none.
ALL_OR_NONE = ("averaged_coef", "averaged_sd", "averaged_ci95", "printed_ci95", "likelihood_coef", "likelihood_sd")


def check_content(content: Saved, chains: Sequence[Chain]) -> None:
    """Check that valid entries agree with each other and with the chains parsed from them; ValueError if not."""
    equations, posteriors, data = content["equations"], content["posteriors"], content["data"]
    for place, entries in (("equations", equations), ("posteriors", posteriors)):
        _require(len(entries) == len(chains), f"{place} has {len(entries)} entries, data.chains {len(chains)}")
    diagnostics = content["diagnostics"]["equations"]
    states = {name for chain in chains for name in chain.names} | set(data["inputs"])
    for k, (chain, saved) in enumerate(zip(chains, equations, strict=True)):
        target, place = chain.target, f"equations[{k}]"
        expected = f"{place}.target: {target!r} is expected, the highest derivative of the chain"
        _require(saved["target"] == target, expected)
        _require(target in diagnostics, f"diagnostics.equations.{target} is missing")
        gains, factors = saved.get("unit_gains", ()), chain.order + 1
        right = len(gains) in (0, factors) and 0.0 not in gains
        _require(right, f"{place}.unit_gains: {factors} factors other than 0 are expected, or none")
        _check_terms(saved["terms"], f"{place}.terms", posteriors[k]["shown"] is not None)
        _check_intervals(saved, place, ("intercept_ci95", "intercept_printed_ci95"))
        with_sd = saved.get("intercept_included", True) or "intercept_sd" in saved
        _require(with_sd, f"{place}.intercept_sd is missing")
        names = {term["name"] for term in saved["terms"]}
        _check_names(saved.get("undetermined", ()), names, f"{place}.undetermined")
        _check_diagnostics(diagnostics[target], names, states, f"diagnostics.equations.{target}")
        _check_posterior(posteriors[k], saved["terms"], f"posteriors[{k}]")
    scores = content["diagnostics"].get("scores") or {"one_step": (), "free_run": ()}
    for name, known in (("one_step", {chain.target for chain in chains}), ("free_run", states)):
        _check_names(scores[name], known, f"diagnostics.scores.{name}")
    _check_names(scores.get("still", ()), states | {chain.target for chain in chains}, "diagnostics.scores.still")
    measured = data.get("measured") or {"ranges": {}, "bands": {}}
    for of in ("ranges", "bands"):
        _check_intervals(measured[of], f"data.measured.{of}", measured[of])


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise ValueError(fault)


def _check_names(found: Iterable[str], known: set[str], place: str) -> None:
    for name in found:
        _require(name in known, f"{place}: there is no {ascii(name)[:60]}")


def _check_intervals(saved: Saved, place: str, names: Iterable[str]) -> None:
    for name in names:
        low, high = saved.get(name, (0.0, 0.0))
        _require(low <= high, f"{place}.{name}: an interval from {low!r} down to {high!r}")


def _check_terms(terms: Sequence[Saved], place: str, simplified: bool) -> None:
    """Check that terms are distinct and their entries agree: coefficients, reasons and intervals."""
    seen: set[str] = set()
    for j, term in enumerate(terms):
        here, included, shown = f"{place}[{j}]", term["included"], term["shown"]
        _require(term["name"] not in seen, f"{here}.name: a term that was there before")
        seen.add(term["name"])
        _require(included or term["coef"] == 0, f"{here}.coef: 0 is expected of a term that is not included")
        explained = included == shown or (simplified and term["why"] is not None)
        _require(explained, f"{here}: a term is included or shown and not both without a reason")
        alike = all((name in term) == (name in terms[0]) for name in ALL_OR_NONE)
        _require(alike, f"{here}: {' and '.join(ALL_OR_NONE)} are those of all terms or of none")
        _check_intervals(term, here, ("ci95", "shown_ci95", "likelihood_ci95", "printed_ci95", "averaged_ci95"))


def _check_diagnostics(checks: Saved, names: set[str], states: set[str], place: str) -> None:
    for k, one in enumerate(checks["runners_up"]):
        here, changed = f"{place}.runners_up[{k}]", [one[key] for key in ("leaves", "enters") if one[key] is not None]
        _require(bool(changed), f"{here}: a term that enters or leaves is expected")
        _check_names(changed, names, here)
    _check_names([one["name"] for one in checks.get("left_out", ())], names, f"{place}.left_out")
    driver = checks["residuals"].get("driver")
    _check_names([driver["name"]] if driver else [], states, f"{place}.residuals.driver")


def _check_posterior(state: Saved, terms: Sequence[Saved], place: str) -> None:
    size = len(terms)
    for which, model, here in (("included", state, place), ("shown", state["shown"], f"{place}.shown")):
        inside = [j for j, term in enumerate(terms) if term[which]]
        if model is None:
            continue
        members = model.get("terms", inside)
        _require(members == inside, f"{here}.terms: the terms that are {which} are expected, {inside}")
        _check_length(model.get("center", terms), size, f"{here}.center")
        _check_length(model.get("freedom") or terms, size, f"{here}.freedom")
        _check_length(model.get("coef", inside), len(inside), f"{here}.coef")
        _check_covariance(model["covariance"], len(inside), f"{here}.covariance")
    _check_places(state["optimum"] or [], size, f"{place}.optimum")
    for k, model in enumerate(state.get("models", ())):
        _check_places(model["members"], size, f"{place}.models[{k}].members")
        _check_length(model["coef"], len(model["members"]), f"{place}.models[{k}].coef")
    average, place = state["average"], f"{place}.average"
    if average is None:
        return
    for k, model in enumerate(average["models"]):
        _check_places(model, size, f"{place}.models[{k}]")
    _check_length(average["probability"], len(average["models"]), f"{place}.probability")
    sums = abs(sum(average["probability"]) - 1.0) <= ROUNDING
    _require(sums, f"{place}.probability: probabilities that sum to 1 are expected")
    _check_places(average["terms"], size, f"{place}.terms")
    _check_covariance(average["covariance"], len(average["terms"]), f"{place}.covariance")


def _check_length(found: Sequence[Any], expected: int, place: str) -> None:
    _require(len(found) == expected, f"{place}: {expected} entries are expected, not {len(found)}")


def _check_places(places: Sequence[float], size: int, place: str) -> None:
    _require(list(places) == sorted(set(places)), f"{place}: places of terms in ascending order are expected")
    if places:
        _require(places[-1] < size, f"{place}: there is no term at {places[-1]}, only {size} terms")


def _check_covariance(rows: Sequence[Sequence[float]], size: int, place: str) -> None:
    """Check that a covariance is square, symmetric and, up to rounding, positive semidefinite."""
    square = len(rows) == size and all(len(row) == size for row in rows)
    _require(square, f"{place}: {size} rows of {size} numbers are expected")
    if not size:
        return
    matrix = np.array(rows, dtype=np.float64)
    variances = np.diagonal(matrix)
    _require(bool((variances >= 0).all()), f"{place}: a variance is negative")
    # scaled to correlations; rows without variance stay as they are
    sd = np.where(variances > 0, np.sqrt(variances), 1.0)
    with np.errstate(over="ignore"):
        scaled = matrix / sd[:, None] / sd
    symmetric = np.isfinite(scaled).all() and np.abs(scaled - scaled.T).max() <= ROUNDING
    _require(bool(symmetric), f"{place}: it is not symmetric")
    least = np.linalg.eigvalsh(scaled).min() if size <= MOST_DECOMPOSED else 0.0
    possible = np.abs(scaled).max() <= 1.0 + ROUNDING and least >= -ROUNDING * size
    _require(bool(possible), f"{place}: no variables have these covariances")
