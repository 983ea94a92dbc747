"""The JSON schema of saved equations and of ``discover --json``, and a check of content against it.

The keywords are those that `schema.json` uses; `tests/test_saved_files.py` compares them with this list.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from bayeq.inference.engines import ENGINES

Schema = Mapping[str, Any]

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
    "minimum": ("at least", lambda value, bound: value >= bound),
    "exclusiveMinimum": ("more than", lambda value, bound: value > bound),
    "maximum": ("at most", lambda value, bound: value <= bound),
    "exclusiveMaximum": ("less than", lambda value, bound: value < bound),
}


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of what ``bayeq discover --json`` prints and ``Equations.save`` writes.

    Returns
    -------
    dict
        Its ``$id`` ends with the version, that of the format of saved files.

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
    """The first thing in some JSON that the schema does not allow, with its place; None if there is none.

    Examples
    --------
    >>> first_fault({"method": 1})
    'data is missing'
    """
    return next(_faults(content, _schema(), ""), None)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value - value == 0  # neither NaN nor inf


def _resolved(schema: Schema) -> Schema:
    """What a schema refers to, if it does."""
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
    """Whether all are numbers within bounds: a quick look at long lists, before each entry is looked at."""
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
