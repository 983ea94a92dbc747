"""Files of equations that somebody has changed: refused in one line, or as good as any other."""

from __future__ import annotations

import copy
import json
import random
import warnings
from dataclasses import fields
from importlib.resources import files

import pytest

import bayeq as bq
from bayeq.equation.equation import RunnerUp
from bayeq.equation.plan.designs import Measured
from bayeq.equation.plan.information import CandidateModel
from bayeq.equation.refine.refine import Refinement
from bayeq.equation.schema import BOUNDS, TYPES, first_fault, json_schema
from bayeq.equation.selection.select import LeftOut
from bayeq.equation.verdict import Verdict
from bayeq.errors import BayeqError, FileFormatError
from bayeq.forecast.score import Scores
from bayeq.inference.engines import ENGINES
from bayeq.regression.design import DroppedTerm
from bayeq.regression.residuals import Driver, Fit, Residuals
from bayeq.states import Sensors

VALUES = (
    None, True, 0, -1, 1e308, -1e308, 1e-300, float("nan"), float("inf"), "", "x", "é\u0000\n", "\ud800", "\x1b[31m",
    [], {}, [[]], {"a": 1}, [1, 2], "1e400", 10**400, 0.5, "sin(", "[bold]x", 2**70, -0.0, "t",
)  # fmt: skip
KEYWORDS = {
    "$schema", "$id", "$defs", "$ref", "title", "description", "type", "enum", "required", "properties", "items",
    "minItems", "maxItems", "additionalProperties", "dependentRequired", *BOUNDS,
}  # fmt: skip


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Small files and the records that their equations came from."""
    folder = tmp_path_factory.mktemp("saved")
    terms = ["x", "v", "x**3", "v*abs(v)", "u", "sign(v)"]
    oscillator, cycle = bq.simulate("duffing", n=150, seed=1), bq.simulate("vanderpol", n=120, seed=1)
    driven = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u", "dictionary": terms}
    out = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, record, options in (
            ("band", oscillator, {**driven, "band": (0.1, 400.0)}),
            ("limit", oscillator, {**driven, "smooth": "none", "max_terms": 2, "method": "vb"}),
            ("chains", cycle, {"chains": list(cycle.names), "dictionary": "polynomial:2"}),
        ):
            bq.discover(record, **options).save(folder / f"{name}.json")
            out.append((json.loads((folder / f"{name}.json").read_text()), record))
    return out


def places(content, path=()):
    """Paths to all entries, of lists to the first six."""
    yield path
    if isinstance(content, dict):
        for key, value in content.items():
            yield from places(value, (*path, key))
    elif isinstance(content, list):
        for k, value in enumerate(content[:6]):
            yield from places(value, (*path, k))


def mutated(content, rng):
    """A copy with one to three entries changed, left out, scaled, doubled or added."""
    content = copy.deepcopy(content)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        *way, last = rng.choice([path for path in places(content) if path])
        at = content
        for key in way:
            at = at[key]
        operation, value = rng.randrange(5), at[last]
        if operation == 0:
            at[last] = rng.choice(VALUES)
        elif operation == 1:
            del at[last]
        elif operation == 2 and isinstance(value, int | float):
            at[last] = value * rng.choice([-1, 0, 1e300, 1e-300, 1.5, 1e140])
        elif isinstance(at, list):
            at.append(copy.deepcopy(value))
        elif operation == 3 and isinstance(value, dict | list):
            at[last] = rng.choice([value[key] for key in value] if isinstance(value, dict) else value) if value else 0
        else:
            at["new"] = 1
    return content


def uses(eq, record, folder):
    """What one does with equations that were loaded."""
    yield "print", lambda: str(eq)
    yield "save", lambda: eq.save(folder / "again.json")
    yield "load", lambda: bq.load(folder / "again.json")
    yield "predict", lambda: eq.predict(record, return_std=True)
    yield "score", lambda: eq.score(record)
    yield "simulate", lambda: eq.simulate(record, draws=2)
    yield "table", eq.table
    yield "to_latex", eq.to_latex
    yield "to_sympy", eq.to_sympy
    yield "physical", lambda: eq.physical(draws=100)


@pytest.mark.statistical(short=30, full=3000)
@pytest.mark.filterwarnings("ignore")
def test_files_that_load_can_be_used(saved, tmp_path, number):
    rng = random.Random(15)
    loaded, found = 0, []
    for k in range(number):
        content, record = saved[rng.randrange(len(saved))]
        (tmp_path / "changed.json").write_text(json.dumps(mutated(content, rng)))
        try:
            eq = bq.load(tmp_path / "changed.json")
        except Exception as error:  # noqa: BLE001
            if not isinstance(error, FileFormatError) or not str(error).isprintable():
                found.append((k, "load", repr(error)))
            continue
        loaded += 1
        for name, use in uses(eq, record, tmp_path):
            try:
                use()
            except BayeqError as error:
                # what was loaded can be saved and loaded again, and shown
                if name not in ("predict", "score", "simulate", "physical"):
                    found.append((k, name, repr(error)))
            except Exception as error:  # noqa: BLE001
                found.append((k, name, repr(error)))
    assert not found, "\n".join(map(str, found))
    assert 0.1 * number < loaded < 0.6 * number


@pytest.mark.parametrize(
    ("kind", "place"),
    [
        (Scores, "properties.diagnostics.properties.scores"),
        (Refinement, "properties.diagnostics.properties.refined"),
        (Measured, "properties.data.properties.measured"),
        (Sensors, "properties.data"),
        (DroppedTerm, "properties.diagnostics.properties.dropped_terms.items"),
        (Verdict, "$defs.equation.properties.verdict"),
        (Fit, "$defs.diagnostics.properties.fit.properties.train"),
        (Residuals, "$defs.diagnostics.properties.residuals"),
        (Driver, "$defs.diagnostics.properties.residuals.properties.driver"),
        (RunnerUp, "$defs.diagnostics.properties.runners_up.items"),
        (LeftOut, "$defs.diagnostics.properties.left_out.items"),
        (CandidateModel, "$defs.posterior.properties.models.items"),
    ],
)
def test_entries_that_become_a_dataclass_are_checked(kind, place):
    schema = json_schema()
    for key in place.split("."):
        schema = schema[key]
    assert {one.name for one in fields(kind)} <= set(schema["properties"])


def test_files_as_they_are_saved_agree_with_the_schema(saved):
    for content, _ in saved:
        assert first_fault(content) is None
        printed = {name: value for name, value in content.items() if name not in ("format", "posteriors")}
        assert first_fault(printed) is None  # what discover --json prints
    assert first_fault({**printed, "format": "bayeq-equations-1"}) == "posteriors is missing"


def keywords(schema):
    yield from schema
    for name in ("properties", "$defs"):
        for one in schema.get(name, {}).values():
            yield from keywords(one)
    for name in ("items", "additionalProperties"):
        if isinstance(schema.get(name), dict):
            yield from keywords(schema[name])


def test_the_schema_uses_keywords_that_are_checked():
    schema = json_schema()
    assert set(keywords(schema)) <= KEYWORDS
    in_file = json.loads((files("bayeq.equation") / "schema.json").read_text(encoding="utf-8"))
    assert schema["properties"]["method"]["enum"] == in_file["properties"]["method"]["enum"] == list(ENGINES)
    assert (files("bayeq.equation") / "schema.json").read_text().startswith("{")
    assert set(TYPES) == {"object", "array", "string", "boolean", "integer", "number", "null"}


def changed(content, path, value):
    content = copy.deepcopy(content)
    at = content
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("equations", 0, "terms", 3, "coef"), "x", "equations[0].terms[3].coef: a number is expected, not 'x'"),
        (("equations", 0, "terms", 3, "pip"), 1.5, "equations[0].terms[3].pip: at most 1 is expected, not 1.5"),
        (("equations", 0, "target"), "b", "equations[0].target: 'a' is expected"),
        (("equations", 0, "terms", 0, "name"), "v", "equations[0].terms[1].name: a term that was there before"),
        (("equations", 0, "terms", 0, "name"), "q", "no channel named 'q'"),
        (("equations", 0, "unit_gains"), [1.0], "equations[0].unit_gains: 3 factors other than 0 are expected"),
        (("posteriors", 0, "center"), [1.0], "posteriors[0].center: 6 entries are expected, not 1"),
        (("posteriors", 0, "freedom"), [3.0], "posteriors[0].freedom: 6 entries are expected, not 1"),
        (("equations", 0, "error_lines"), [-1.0], "equations[0].error_lines[0]: at least 0 is expected, not -1.0"),
        (("posteriors", 0, "covariance", 0, 0), -1.0, "posteriors[0].covariance: a variance is negative"),
        (("posteriors", 0, "covariance", 0, 0), 1e-12, "posteriors[0].covariance: no variables have these"),
        (("posteriors", 0, "covariance", 0, 1), 1e3, "posteriors[0].covariance: it is not symmetric"),
        (("posteriors", 0, "covariance", 0), [], "posteriors[0].covariance: "),
        (("posteriors", 0, "n"), 10**400, "posteriors[0].n: at most 1e+150 is expected"),
        (("posteriors",), [], "posteriors has 0 entries, data.chains 1"),
        (("method",), "magic", "method: one of 'auto', "),
        (("data", "inputs"), ["x"], "both an input and part of a chain"),
        (("data", "smooth"), None, "data.smooth: one of 'auto', 'band', 'none' is expected, not None"),
        (("diagnostics", "equations"), {}, "diagnostics.equations.a is missing"),
        (("diagnostics", "equations", "a", "fit", "train"), {}, "diagnostics.equations.a.fit.train.n is missing"),
        (("posteriors", 0, "optimum"), [99], "posteriors[0].optimum: there is no term at 99, only 6 terms"),
    ],
)
def test_what_is_wrong_is_said(saved, tmp_path, path, value, message):
    (tmp_path / "changed.json").write_text(json.dumps(changed(saved[0][0], path, value)))
    with pytest.raises(FileFormatError) as error:
        bq.load(tmp_path / "changed.json")
    assert message in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 'changed.json'}: damaged: ")


def test_an_intercept_that_is_left_out_needs_its_standard_deviation(saved, tmp_path):
    content = changed(saved[0][0], ("equations", 0, "intercept_included"), False)
    del content["equations"][0]["intercept_sd"]
    (tmp_path / "changed.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"damaged: equations\[0\]\.intercept_sd is missing"):
        bq.load(tmp_path / "changed.json")


def test_keys_of_later_versions_are_let_through(saved, tmp_path):
    content = saved[0][0]
    # some of them have the names of attributes that this version does not save
    own = (("data", "sensors"), ("equations", 0, "fit"), ("equations", 0, "stored"), ("posteriors", 0, "draws"))
    for path in (("new",), ("diagnostics", "equations", "a", "fit", "train", "new"), ("equations", 0, "new"), *own):
        content = changed(content, path, 1)
    (tmp_path / "later.json").write_text(json.dumps(content))
    bq.load(tmp_path / "later.json")


@pytest.mark.parametrize("terminal", [True, False])
def test_text_of_a_file_is_printed_as_text(saved, tmp_path, monkeypatch, terminal):
    hostile = "\x1b]0;title\x07\x1b[31m[bold red]x[/bold red]\r\u202e\ud800 \x9b"
    content = copy.deepcopy(saved[0][0])
    content["data"]["file"] = content["diagnostics"]["warnings"][:] = [hostile]
    content["data"]["estimated"], content["equations"][0]["verdict"]["reason"] = [hostile], hostile
    content["diagnostics"]["equations"]["a"]["left_out"] = [
        {"name": "sign(v)", "pip": 0.9, "share": 0.1, "reason": hostile}
    ]
    (tmp_path / "hostile.json").write_text(json.dumps(content))
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal, raising=False)
    text = str(bq.load(tmp_path / "hostile.json"))
    assert text.count("[bold red]x[/bold red]") == 5
    assert not any(sign in text for sign in ("\x1b]", "\x1b[31m", "\x07", "\r", "\u202e", "\ud800", "\x9b"))


def test_physical_of_an_equation_without_a_spring(saved, tmp_path):
    content, _ = saved[0]
    for term in content["equations"][0]["terms"]:
        if term["name"] in ("x", "x**3") and term["shown"] and not term["included"]:
            pytest.skip("the terms shown are others than those included")
    dropped = {j for j, term in enumerate(content["equations"][0]["terms"]) if term["name"] in ("x", "x**3")}
    content = copy.deepcopy(content)
    state = content["posteriors"][0]
    kept = [j for j, term in enumerate(content["equations"][0]["terms"]) if term["included"]]
    rows = [k for k, j in enumerate(kept) if j not in dropped]
    for j in dropped:
        content["equations"][0]["terms"][j].update(included=False, shown=False, coef=0.0, shown_coef=0.0, why=None)
    state["covariance"] = [[state["covariance"][a][b] for b in rows] for a in rows]
    state.update(shown=None, full=None, target_mean=50.0)
    for term in content["equations"][0]["terms"]:
        term["shown"], term["why"] = term["included"], None
    (tmp_path / "free.json").write_text(json.dumps(content))
    try:  # as of a drive: its damping, or nothing
        found = [q.symbol for q in bq.load(tmp_path / "free.json").physical()]
    except BayeqError:
        found = []
    assert not any(symbol.startswith(("k", "f_", "omega")) for symbol in found)
