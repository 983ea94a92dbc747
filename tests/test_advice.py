"""Every warning says what to do."""

from __future__ import annotations

import ast
import re

import numpy as np
import pytest

import bayeq as bq
from bayeq import errors
from bayeq.records import Record
from bayeq.records.findings import check_record
from bayeq.states.bad_samples import ADVICE
from tests.headers import noisy, solve, tones
from tests.layers import SOURCE, modules

CATEGORIES = {name for name in errors.__all__ if name.endswith("Warning")}

# What a user can do, in the words of the messages.
DOES = re.compile(
    r"\b(add|check|compare|drop|give|keep|[Ll]eave|look|show|measure|rename|resample|reverse|shift|use)\b"
    r"|would (decide|tell)|asks for|refine the result|takes (it out|them as they are)|shifts it back|do not rely"
)


def _text(node: ast.expr) -> str:
    """What of a message is written in the source: its constant parts."""
    return "".join(
        part.value for part in ast.walk(node) if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )


def _messages() -> list[tuple[str, str]]:
    """Messages that are written where they are given, with their file and line."""
    out = []
    for path in modules():
        source = path.read_text(encoding="utf-8")
        if "Warning" not in source:
            continue
        constants: dict[str, str] = {}
        advised: set[str] = set()
        tree = ast.parse(source)
        for node in ast.walk(tree):
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                constants[node.targets[0].id] = _text(node.value)
                if any(getattr(part, "attr", "") == "advice" for part in ast.walk(node.value)):
                    advised.add(node.targets[0].id)
        for node in ast.walk(tree):
            match node:  # given, or yielded to what gives it
                case ast.Call(func=ast.Attribute(attr="warn"), args=[message, category, *_]):
                    pass
                case ast.Yield(value=ast.Tuple(elts=[message, category])):
                    pass
                case _:
                    continue
            if not (isinstance(category, ast.Name) and category.id in CATEGORIES):
                continue
            names = [part.id for part in ast.walk(message) if isinstance(part, ast.Name)]
            whole = " ".join([_text(message), *(constants.get(name, "") for name in names)])
            if any(name in advised for name in names):
                continue  # its advice is looked at where it is written
            if not isinstance(message, ast.Name) or names[0] in constants:
                out.append((f"{path.relative_to(SOURCE)}:{node.lineno}", whole))
    return out


MESSAGES = _messages()


def test_messages_are_found():
    assert len(MESSAGES) > 25
    assert {where.split(":")[0] for where, _ in MESSAGES} >= {
        "discovery/question.py",
        "equation/build.py",
        "equation/refine/refine.py",
    }


@pytest.mark.parametrize(("where", "message"), MESSAGES, ids=[where for where, _ in MESSAGES])
def test_a_warning_says_what_to_do(where, message):
    assert DOES.search(message), f"{where}: {message}"


def test_what_is_not_refined_comes_with_advice():
    calls = [
        node
        for path in modules()
        if "Unrefined(" in (source := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Unrefined"
    ]
    assert len(calls) >= 4
    for call in calls:
        assert DOES.search(_text(call.args[1]))


def test_bad_samples_come_with_advice():
    assert all(DOES.search(text) for text in ADVICE.values())


def test_findings_come_with_advice():
    t, rng = np.arange(4000) / 500, np.random.default_rng(0)
    x, v = np.sin(9 * t) + np.sin(23 * t), 9 * np.cos(9 * t) + 23 * np.cos(23 * t)
    noise = rng.normal(size=(2, 4000))
    found = []
    spoilt = {
        "sign offset": (x, 0.5 - v),
        "gain": (x, 1.2 * v),
        "delay": (x, np.roll(v, 3)),
        "drift": (x, v + 3.0 * t),
        "clipping": (x, np.clip(v, -20.0, 20.0)),
        "inconsistent": (x, v * np.sign(np.sin(16.0 * t))),
        "repeated": (x, np.where(np.arange(4000) % 50 == 0, np.nan, v)),
    }
    for kind, (position, speed) in spoilt.items():
        position, speed = position + 0.01 * noise[0], speed + 0.05 * noise[1]
        if kind == "clipping":
            speed = np.clip(speed, -20.0, 20.0)
        lost = np.flatnonzero(np.isnan(speed))
        speed[lost] = speed[lost - 1]
        found += check_record(Record({"x": position, "v": speed}, time=t), ["x:v:"])
    kept = np.delete(np.arange(4000), [100, 200, 300])
    found += check_record(Record({"x": x[kept]}, time=t[kept]), ["x::"])
    assert {one.kind for one in found} >= {
        "sign",
        "offset",
        "gain",
        "delay",
        "drift",
        "clipping",
        "dropped",
        "repeated",
    }
    for one in found:
        assert DOES.search(one.message), one.message


def _two_places(first: float, second: float) -> Record:
    """Two masses with springs, which a force of these transfers drives."""
    t = np.arange(1500) / 100
    force = tones(t, 1, 0.5, 6.0)

    def rate(s: float, y: np.ndarray) -> list[float]:
        push, (x1, x2, v1, v2) = np.interp(s, t, force), y
        return [v1, v2, first * push - 200 * x1 + 90 * x2 - v1, second * push + 90 * x1 - 300 * x2 - 1.5 * v2]

    y = solve(rate, [0.0] * 4, t)
    a = np.array([rate(s, row)[2:] for s, row in zip(t, y, strict=True)])
    made = {"x1": y[:, 0], "a1": a[:, 0], "x2": y[:, 1], "a2": a[:, 1], "F": force}
    return Record(noisy(made, 0.002), t)


@pytest.mark.parametrize(("first", "second", "warned"), [(2.0, -0.7, []), (-2.0, -0.7, ["x1", "x2"])])
@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_a_force_is_reversed_only_if_it_pushes_nothing_forward(first: float, second: float, warned: list[str]) -> None:
    found = bq.discover(
        _two_places(first, second), chains=["x1::a1", "x2::a2"], inputs=["F"], dictionary="x1, dx1, x2, dx2, F"
    )
    coefficients = [equation.shown_model.coefficients["F"] for equation in found.equations]
    assert coefficients == pytest.approx([first, second], abs=0.05)
    against = [one for one in found.warnings if "F acts against" in one]
    assert [one.partition("against ")[2].partition(":")[0] for one in against] == warned
