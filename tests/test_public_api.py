"""The public contract: names that users and checks rely on."""

from __future__ import annotations

import ast
import inspect
import tomllib
from pathlib import Path

import pytest

import bayeq as bq


def test_every_public_name_is_found():
    for name in bq.__all__:
        assert getattr(bq, name) is not None
    assert {"discover", "read", "Record", "__version__"} <= set(dir(bq))
    with pytest.raises(AttributeError, match="nothing"):
        bq.nothing  # noqa: B018


def test_type_checkers_see_the_names_that_the_program_sees():
    tree = ast.parse(Path(bq.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    # only `X as X` is public to a type checker
    assert all(alias.asname == alias.name for node in imports for alias in node.names)
    assert {alias.name: node.module for node in imports for alias in node.names} == {
        **bq._HOME,
        "errors": "bayeq",
        "figures": "bayeq",
    }


def test_the_version_stands_in_one_place():
    root = Path(__file__).parents[1]
    declared = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    assert bq.__version__ == declared
    for path in (root / "src").rglob("*.py"):
        assert f'"{declared}"' not in path.read_text(encoding="utf-8"), path


def test_every_public_name_is_documented():
    for name in bq.__all__:
        thing = getattr(bq, name)
        if callable(thing):
            assert inspect.getdoc(thing), name
            assert len(inspect.getdoc(thing)) > 40, name


def parameters(function):
    return list(inspect.signature(function).parameters)


def test_signatures():
    assert parameters(bq.discover)[:11] == [
        "records",
        "chains",
        "displacement",
        "velocity",
        "acceleration",
        "force",
        "inputs",
        "target",
        "dictionary",
        "method",
        "smooth",
    ]
    assert parameters(bq.simulate)[:2] == ["system", "n"]
    assert parameters(bq.read)[0] == "path"
    reading = ["time", "fs", "names", "units", "group"]
    assert parameters(bq.info) == ["source", *reading, "channels", "skip", "rows", "sheet"]
    assert parameters(bq.Equations.plot) == ["self", "record", "ax"]
    for name in (
        "coefficients",
        "plot",
        "table",
        "to_sympy",
        "to_latex",
        "rhs",
        "predict",
        "simulate",
        "score",
        "refine",
        "physical",
        "save",
    ):
        assert callable(getattr(bq.Equations, name))


@pytest.mark.parametrize(
    ("name", "value"),
    [("slab_variance", 10.0), ("prior_inclusion", 0.1), ("noise_shape", 1e-4), ("noise_rate", 1e-4)],
)
def test_the_paper_s_prior_is_the_default(name, value):
    assert bq.SpikeSlabVB().get_params()[name] == value
    assert getattr(bq.Prior(), name) == value
