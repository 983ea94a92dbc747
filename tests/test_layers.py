"""The house: who may import whom, and what an import costs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.layers import SOURCE, circles, files, floors, imported, modules, room, rooms

# From the ground up: a room imports from lines above its own, which here means from floors below.
ORDER = [
    "arrays citation errors kernels markup",
    "expressions plugins resumable",
    "numerics",
    "inference records",
    "dictionary states systems",
    "adapters figures inspection likelihood",
    "forecast regression",
    "equation",
    "app discovery estimators",
    "batches study",
    "cli",
    "__main__",
]
FLOOR = {name: floor for floor, names in enumerate(ORDER) for name in names.split()}
CONTRIBUTING = Path(__file__).resolve().parents[1] / "CONTRIBUTING.md"


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_point_down(path):
    here = room(path)
    assert here in FLOOR, f"give {here} a floor"
    for other in imported(path):
        if other != SOURCE / "__init__.py" and room(other) != here:
            assert FLOOR[room(other)] < FLOOR[here], f"{path.name} imports {other.relative_to(SOURCE)}"


def test_no_circles():
    assert circles(rooms()) == []
    assert circles(files()) == []


def test_rooms_stand_as_low_as_they_can():
    assert floors(rooms()) == FLOOR


def test_the_picture_is_that_of_the_code():
    lines = CONTRIBUTING.read_text(encoding="utf-8").splitlines()
    drawn = [line.split("#")[0].split() for line in lines if line.startswith("    ") and "#" in line]
    picture = [sorted(names) for names in drawn if names and set(names) <= set(FLOOR)]
    assert picture == [sorted(names.split()) for names in reversed(ORDER)]


def test_one_file_asks_which_system_it_runs_on():
    """What needs POSIX is in `posix.py`, so that it is known what other systems lack."""
    asks = re.compile(
        r"os\.name\b|sys\.platform|platform\.system|getattr\(signal|hasattr\((signal|os)\b|import (resource|fcntl)"
    )
    found = [path for path in SOURCE.rglob("*.py") if asks.search(path.read_text(encoding="utf-8"))]
    assert [path.name for path in found] == ["posix.py"]


def test_few_files_at_the_root():
    assert len(list(SOURCE.glob("*.py"))) <= 8


def test_no_relative_imports_which_the_rule_would_not_see():
    for path in modules():
        assert "from ." not in path.read_text(encoding="utf-8"), path


def test_the_reader_of_imports_sees_them(tmp_path):
    source = tmp_path / "bayeq"
    for name, text in {
        "a.py": "from bayeq.b import c",
        "b/__init__.py": "",
        "b/c.py": "def f():\n    import bayeq.d",
        "d.py": "from bayeq.a import x\nimport numpy",
    }.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text)
    assert rooms(source) == {"a": {"b"}, "b": {"d"}, "d": {"a"}}
    assert circles(rooms(source)) == [{"a", "b", "d"}]
    assert floors({"a": {"b"}, "b": {"c"}, "c": set()}) == {"a": 2, "b": 1, "c": 0}


def loaded_after(statement):
    code = f"import sys\n{statement}\nprint(' '.join(m for m in sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(out.stdout.split())


def test_import_is_lazy():
    heavy = {"numpy", "numba", "scipy", "pandas", "sympy", "sklearn", "matplotlib", "click", "rich", "pyarrow"}
    assert not heavy & loaded_after("import bayeq")


def test_reading_and_discovering_do_not_load_what_they_do_not_use():
    loaded = loaded_after("import bayeq; bayeq.discover, bayeq.read, bayeq.simulate")
    assert not {"pandas", "sklearn", "sympy", "matplotlib", "pyarrow", "click"} & loaded
    assert not {"scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats"} & loaded
