"""Arguments of the wrong type: one line that names the argument, never a traceback from within."""

from __future__ import annotations

import numpy as np
import pytest

import bayeq as bq
from bayeq.errors import (
    BayeqError,
    BayeqWarning,
    InputError,
    as_path,
    require_kind,
    require_mapping,
    require_number,
    require_texts,
)

ODD = [None, 1, 1.5, float("nan"), -1, 10**400, True, b"x", "", "\ud800", [1], [None], (1, 2, 3), {1: 2}, {}]
ODD += [np.zeros(3), object(), "x" * 10_000]
NAMED = pytest.mark.parametrize("odd", ODD, ids=lambda odd: f"{type(odd).__name__} {ascii(odd)[:8]}")
ROLES = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
OPTIONS = ["displacement", "velocity", "acceleration", "force", "chains", "inputs", "dictionary", "method", "smooth"]
OPTIONS += ["holdout", "max_terms", "tolerance", "coarsen", "prior", "constraints", "noise", "gain_sd", "tails", "band"]
OPTIONS += ["lag_sd", "seed", "progress", "t"]


@pytest.fixture(scope="module")
def record() -> bq.Record:
    return bq.simulate("duffing", n=60, seed=1)


@pytest.fixture(scope="module")
def eq(record) -> bq.Equations:
    with pytest.warns(BayeqWarning):
        return bq.discover(record, **ROLES, dictionary=["x", "v", "u"], smooth="none", method="vb")


def decent(use, *arguments, **options) -> str:
    """What it says, if it refuses; that is one line."""
    try:
        use(*arguments, **options)
    except BayeqError as refused:
        said = str(refused)
    else:
        return ""
    assert "\n" not in said
    return said


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@pytest.mark.parametrize("option", OPTIONS)
@NAMED
def test_discover(record, option, odd):
    given = {**ROLES, "dictionary": ["x", "v"], "smooth": "none", "method": "vb", option: odd}
    if option == "chains":
        given = {name: value for name, value in given.items() if name not in ROLES}
    decent(bq.discover, record, **given)


@pytest.mark.parametrize(
    ("option", "odd", "said"),
    [
        ("displacement", 1, "displacement must be text, not 1 (int)"),
        ("method", None, "method must be text, not None (NoneType)"),
        ("holdout", "0.2", "holdout must be a number, not '0.2' (str)"),
        ("noise", ["u"], "noise must be a mapping such as {'x': ...}, not ['u'] (list)"),
        ("inputs", [1], "each of inputs must be text, not 1 (int)"),
        ("seed", 1.5, "seed must be a whole number, not 1.5 (float)"),
        ("seed", -1, "a seed is a whole number, 0 or more, got -1"),
        ("prior", "vague", "prior must be a Prior, not 'vague' (str)"),
        ("dictionary", 7, "dictionary must be text, a list of terms, or a mapping of these, not 7 (int)"),
    ],
)
def test_the_argument_is_named(record, option, odd, said):
    with pytest.raises(InputError) as caught:
        bq.discover(record, **{**ROLES, "dictionary": ["x"], option: odd})
    assert str(caught.value) == said


@NAMED
def test_records_and_files(record, odd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a long text may name a file
    decent(bq.load, odd)
    decent(bq.read, odd)
    decent(bq.write, record, odd)
    decent(bq.write, odd, "a.csv")
    decent(bq.simulate, odd)
    decent(bq.simulate, "duffing", n=20, parameters=odd)
    decent(bq.simulate, "duffing", n=20, noise=odd)
    decent(bq.join, odd)
    decent(bq.join, record, odd)
    decent(bq.Record, odd)
    decent(bq.Record.from_arrays, odd)
    for option in ("time", "fs", "units", "name"):
        decent(bq.Record.from_arrays, {"x": [1.0, 2.0]}, **{option: odd})


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
@NAMED
def test_answers(eq, odd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    decent(eq.rhs, odd, odd, odd)
    decent(eq.predict, odd)
    decent(eq.simulate, odd)
    decent(eq.refine, odd)
    if not isinstance(odd, str) or len(odd) != 10_000:
        decent(eq.save, odd)


def test_loading_nothing():
    with pytest.raises(InputError, match=r"^the file must be a path, not None \(NoneType\)$"):
        bq.load(None)  # type: ignore[arg-type]


def test_checks():
    class Bytes:
        def __fspath__(self) -> bytes:
            return b"x"

    require_kind(1, int, "n", "a whole number")
    require_number(np.float64(1.0), "n")
    require_texts(["a", "b"], "names")
    require_mapping({"x": 1}, "noise")
    with pytest.raises(InputError, match="a key of noise must be text, not 1"):
        require_mapping({1: 2}, "noise")
    with pytest.raises(InputError, match="names must be text or a list of texts, not 1"):
        require_texts(1, "names")
    with pytest.raises(InputError, match="must be a path of text"):
        as_path(Bytes())


@pytest.mark.parametrize("option", ["files", "store", "jobs", "common", "read", "progress", "method"])
@NAMED
def test_batch(tmp_path, monkeypatch, option, odd):
    monkeypatch.chdir(tmp_path)
    # no file is there: what is right is refused at the end
    given = {"files": "absent.csv", "store": "batch.db", **ROLES, option: odd}
    said = decent(bq.batch, given.pop("files"), **given)
    assert said or bq.batch("absent.csv", store="other.db", **ROLES).refused
