"""The house: who may import whom, and what an import costs."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import bayeq

SOURCE = Path(bayeq.__file__).parent

# Rooms from the ground up; a module imports from rooms below its own, and from its own room.
LEVELS = [
    {"errors", "files", "kernels"},
    {"expressions", "records", "posterior", "diagnostics"},
    {"gram", "lazy_gram", "spectral"},
    {"systems", "states", "dictionary", "inference"},
    {"seen"},
    {"weighting"},
    {"propagation"},
    {"adapters", "constraints", "equalities", "forecast", "report"},
    {
        "_equations_base",
        "_equations_runs",
        "_estimator_base",
        "estimators",
        "equation",
        "equations",
        "storage",
        "render",
        "sensitivity",
        "choice",
        "coarsening",
        "coef_units",
        "parsimony",
    },
    {"stand_in"},
    {"infer", "notes"},
    {"inspection", "negligible"},
    {"discovery"},
    {"study"},
    {"cli_outputs", "cli_study"},
    {"cli"},
    {"__main__"},
]
LEVEL = {room: k for k, rooms in enumerate(LEVELS) for room in rooms}
STAGES = LEVELS[3]


def modules():
    return sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")


def room(path):
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported_rooms(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("bayeq."):
            yield node.module.split(".")[1]
        elif isinstance(node, ast.Import):
            yield from (alias.name.split(".")[1] for alias in node.names if alias.name.startswith("bayeq."))


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_point_down(path):
    here = room(path)
    assert here in LEVEL, f"give {here} a level"
    for other in imported_rooms(path):
        if other == here:
            continue
        if here in STAGES and other in STAGES:
            pytest.fail(f"{path.name}: stages do not import each other ({here} imports {other})")
        assert LEVEL[other] < LEVEL[here] or (LEVEL[other] == LEVEL[here] and here not in STAGES), (here, other)


def test_no_relative_imports_which_the_rule_would_not_see():
    for path in modules():
        for node in ast.walk(ast.parse(path.read_text())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), path


def test_the_reader_of_imports_sees_them():
    assert "gram" in set(imported_rooms(SOURCE / "infer.py"))
    assert "records" in set(imported_rooms(SOURCE / "cli.py"))


def loaded_after(statement):
    code = f"import sys\n{statement}\nprint(' '.join(m for m in sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(out.stdout.split())


def test_import_is_lazy():
    heavy = {"numpy", "numba", "scipy", "pandas", "sympy", "sklearn", "matplotlib", "typer", "rich", "pyarrow"}
    assert not heavy & loaded_after("import bayeq")


def test_reading_and_discovering_do_not_load_what_they_do_not_use():
    loaded = loaded_after("import bayeq; bayeq.discover, bayeq.read, bayeq.simulate")
    assert not {"pandas", "sklearn", "sympy", "matplotlib", "pyarrow", "typer"} & loaded
    assert not {"scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats"} & loaded
