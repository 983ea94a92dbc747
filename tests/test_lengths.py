"""What `discover` and `info` warn of is said in a line each, of at most 120 characters."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import BayeqWarning, TermWarning
from bayeq.inspection.info import info
from tests.layers import SOURCE, modules

LONGEST = 120

T = np.arange(600) / 100
X = np.sin(3 * T) + 0.6 * np.sin(8 * T + 1)
V = 3 * np.cos(3 * T) + 4.8 * np.cos(8 * T + 1)
A = -9 * np.sin(3 * T) - 38.4 * np.sin(8 * T + 1)
NOISE = np.random.default_rng(0).normal(size=(5, 600))
U = A + 0.3 * V + 9 * X


def _record(**changed: np.ndarray) -> bq.Record:
    channels = {"x": X + 0.01 * NOISE[0], "v": V + 0.03 * NOISE[1], "a": A + 0.1 * NOISE[2], "u": U + 0.1 * NOISE[3]}
    return bq.Record.from_arrays({**channels, **changed}, time=T)


def _with_spikes(values: np.ndarray) -> np.ndarray:
    out = values.copy()
    out[[50, 170, 333, 480]] += 400.0
    return out


def _with_gap(record: bq.Record) -> bq.Record:
    x = record["x"].copy()
    x[100:180] = np.nan
    return record.with_channels({"x": x}, {})


AWKWARD: dict[str, Callable[[], tuple[bq.Record | list[bq.Record], dict[str, object]]]] = {
    "a sign": lambda: (_record(v=-V + 0.03 * NOISE[1]), {"chains": "x:v:a", "inputs": ["u"]}),
    "an offset and a delay": lambda: (_record(v=V + 1.0, a=np.roll(A, 4)), {"chains": "x:v:a", "inputs": ["u"]}),
    "wrong units": lambda: (_record(a=A / 9.80665), {"chains": "x:v:a", "inputs": ["u"]}),
    "nothing in common": lambda: (_record(v=NOISE[1], a=NOISE[2]), {"chains": "x:v:a", "inputs": ["u"]}),
    "rows as measured": lambda: (_record(), {"chains": "x:v:a", "inputs": ["u"], "smooth": "none"}),
    "spikes": lambda: (_record(x=_with_spikes(X)), {"chains": "x::", "inputs": ["u"]}),
    "clipped": lambda: (_record(x=np.clip(X, -0.8, 0.8)), {"chains": "x::", "inputs": ["u"]}),
    "a gap": lambda: (_with_gap(_record()), {"chains": "x::", "inputs": ["u"]}),
    "few rows": lambda: (_record().slice(0, 30), {"chains": "x:v:a", "inputs": ["u"]}),
    "beside zero": lambda: (_record(x=X + 5.0), {"chains": "x:v:a", "inputs": ["u"]}),
    "twice": lambda: ([_record(), _record()], {"chains": "x:v:a", "inputs": ["u"]}),
    "the same rows": lambda: (
        bq.Record.from_arrays({"x": np.tile(X[:300] + 0.01 * NOISE[0][:300], 2), "u": U}, time=T),
        {"chains": "x::", "inputs": ["u"]},
    ),
    "milliseconds": lambda: (
        bq.Record.from_arrays({"x": X + 0.01 * NOISE[0]}, time=T * 100),
        {"chains": "x::", "dictionary": "x, dx, x**3"},
    ),
    "degrees": lambda: (
        bq.Record.from_arrays({"x": X, "u": U}, time=T, units={"x": "deg", "u": "N"}),
        {"chains": "x::", "inputs": ["u"], "dictionary": ["x", "dx", "sin(x)", "exp(x)", "log(1+u**2)", "u"]},
    ),
    "free": lambda: (_record(), {"chains": "x::"}),
    "copies": lambda: (_record(x=X + 2.0), {"chains": "x::", "inputs": ["u"], "dictionary": "oscillator"}),
    "gibbs": lambda: (_record(), {"chains": "x:v:a", "inputs": ["u"], "method": "gibbs"}),
    "vb": lambda: (_record(), {"chains": "x:v:a", "inputs": ["u"], "method": "vb"}),
    "noise given": lambda: (_record(), {"chains": "x:v:a", "inputs": ["u"], "noise": {"x": 0.01}, "smooth": "none"}),
    "a wrong sign": lambda: (_record(), {"chains": "x:v:a", "inputs": ["u"], "constraints": "x >= 0"}),
}


# Of these no candidates are the law, which takes long to find out.
HARD = (
    "the same rows",
    "nothing in common",
    "free",
    "an offset and a delay",
    "milliseconds",
    "clipped",
    "a wrong sign",
)

# Their warnings are among those of others, or are read by tests of engines, of several and of prepared records.
SEEN = ("twice", "gibbs", "vb", "spikes", "a gap")


@cache
def found(name: str) -> tuple[bq.Equations, list[BayeqWarning]]:
    """The answer, and its warnings."""
    record, options = AWKWARD[name]()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        eq = bq.discover(record, **options)  # type: ignore[arg-type]
    return eq, [one.message for one in caught if isinstance(one.message, BayeqWarning)]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in HARD + SEEN else []) for name in AWKWARD]
)
def test_a_line_each(name: str) -> None:
    record = AWKWARD[name]()[0]
    eq, warned = found(name)
    said = [str(one) for one in warned]
    assert sorted(said) == sorted(eq.warnings)
    for one in [record] if isinstance(record, bq.Record) else record:
        inspected = info(one)
        said += [*inspected.findings, *inspected.proposal.notes, *inspected.guess.questions]
    assert [message for message in said if len(message) > LONGEST] == []


@pytest.mark.filterwarnings("ignore")
def test_sines_of_degrees_are_of_radians() -> None:
    eq, warned = found("degrees")
    said = "sin(x) is of an angle in degrees: taken of radians, as sin(pi*x/180)"
    assert [str(one).endswith(said) for one in warned if isinstance(one, TermWarning)].count(True) == 1
    assert "sin(pi*x/180)" in eq.table().term.tolist()
    assert any("exp(x): its argument has the unit deg:" in one for one in eq.warnings)


# Characters of a name, a number and what a call makes of them, in a message.
NAME, NUMBER, MADE = 12, 6, 10


def _width(node: ast.expr, known: Mapping[str, ast.expr]) -> int:
    """About how long a text may be, of names of 12 characters."""
    match node:
        case ast.Constant(value):
            return len(str(value))
        case ast.JoinedStr(parts):
            return sum(_width(part, known) for part in parts)
        case ast.FormattedValue(value, _, format_spec):
            return _width(value, known) if format_spec is None else NUMBER
        case ast.BinOp(left, ast.Add(), right):
            return _width(left, known) + _width(right, known)
        case ast.IfExp(_, body, orelse):
            return max(_width(body, known), _width(orelse, known))
        case ast.Call(ast.Name("some_of"), [_, ast.Constant(int(width)), *_]):
            return width
        case ast.Call(ast.Name("len" | "int" | "in_digits")) | ast.BinOp():
            return NUMBER
        case ast.Call():
            return MADE
        case ast.Name(name) if name in known:
            return _width(known[name], {other: one for other, one in known.items() if other != name})
    return NAME


def _given() -> list[tuple[str, int]]:
    """Where warnings and findings are given, and about how long they may be."""
    out = []
    for path in modules():
        source = path.read_text(encoding="utf-8")
        if not any(mark in source for mark in (".warn(", "Finding(")):
            continue
        tree = ast.parse(source)
        scopes = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
        for scope in scopes:
            known: dict[str, ast.expr] = {}
            for node in ast.walk(scope):
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                    known[node.targets[0].id] = node.value
                called = getattr(node, "func", None)
                name = getattr(called, "attr", getattr(called, "id", ""))
                if isinstance(node, ast.Call) and len(node.args) > 1 and name in ("warn", "Finding"):
                    message = node.args[0 if name == "warn" else 2]
                    out.append((f"{path.relative_to(SOURCE)}:{node.lineno}", _width(message, known)))
    return out


def test_no_warning_can_be_longer() -> None:
    found = _given()
    assert len(found) > 50
    assert [(where, width) for where, width in found if width > LONGEST] == []


@pytest.mark.filterwarnings("ignore")
def test_long_names_are_said_once() -> None:
    name, rng = "Schwingbeschleunigung_Aufbau_vorne_links", np.random.default_rng(0)
    record = bq.Record.from_arrays(fs=10.0, u=rng.normal(size=300), **{name: rng.normal(size=300)})
    (said,) = [one for one in bq.discover(record, target=name, inputs=["u"], dictionary="u").warnings if name in one]
    assert said == f"{name}: no equation: the terms explain little on the held-out rows; check channels"
    assert len(said) <= LONGEST
