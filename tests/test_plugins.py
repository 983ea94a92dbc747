"""Members that other packages add by entry points: found when asked for, left out with a warning when faulty."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[1]
ADDED = ROOT / "tests" / "added"


def install(folder, name, entry_points):
    """Write what an installer writes beside a package, so that its entry points are found."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = (f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in rows.items()) for group, rows in entry_points.items())
    (info / "entry_points.txt").write_text("\n".join(groups))


@pytest.fixture(scope="module")
def added(tmp_path_factory):
    """A folder in which the package of `tests/added` is installed."""
    folder = tmp_path_factory.mktemp("site-packages")
    shutil.copy(ADDED / "bayeq_added.py", folder)
    project = tomllib.loads((ADDED / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    install(folder, project["name"], project["entry-points"])
    return folder


def run(folder, *arguments, cwd=None, code=0):
    """Run Python with the packages of a folder; returns what it printed, and its lines on standard error."""
    paths = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTEST_XDIST_WORKER", None)
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout, done.stderr


def commands(folder, *each, cwd):
    """Several commands in one process, with a line of two dashes between them."""
    code = f"from bayeq.cli.app import main\nfor k, words in enumerate({each}):\n    k and print('--')\n"
    return run(folder, "-c", f"{code}    assert not main(words)", cwd=cwd)


def command(folder, *arguments, cwd=None, code=0):
    return run(folder, "-m", "bayeq", *arguments, cwd=cwd, code=code)


def test_all_four_work_together_and_can_be_saved(added, tmp_path):
    listed, _ = commands(added, ["simulate", "softening", "--seed", "1", "-o", "run.csv"], ["systems"], cwd=tmp_path)
    assert "Oscillator with a softening spring" in listed
    frame = pd.read_csv(tmp_path / "run.csv").rename(columns=lambda name: name.split(" ")[0])
    frame.to_json(tmp_path / "run.jsonl", orient="records", lines=True, double_precision=15)
    roles = ("--disp", "x", "--vel", "v", "--acc", "a", "--force", "u")
    options = ("--method", "forward", "--dictionary", "friction + x**3 + x**5", "--save", "eq.json", "--verbose")
    both, _ = commands(added, ["discover", "run.jsonl", *roles, *options], ["show", "eq.json"], cwd=tmp_path)
    answer, shown = both.split("\n--\n")
    assert "method: forward" in answer
    assert "verdict" in shown
    _, errors = run(tmp_path, "-m", "bayeq", "show", "eq.json", cwd=tmp_path, code=2)
    assert "method: one of 'auto'" in errors


@pytest.mark.slow  # those of docs/extending.md are taken in as well: test_extending
def test_the_conformance_tests_take_them_in(added):
    files = ("tests/conformance/test_engines.py", "tests/conformance/test_systems.py")
    options = ("-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-k", "forward or softening")
    report, _ = run(added, "-m", "pytest", *options, *files, cwd=ROOT)
    assert " passed" in report


FAULTY = {
    "raises = 'bayeq_bad:MISSING'": (
        "engines",
        "raises",
        "bayeq_bad:MISSING",
        "AttributeError: module 'bayeq_bad' has",
    ),
    "another kind": ("engines", "kind", "bayeq_bad:THING", "TypeError: bayeq_bad:THING is no Engine"),
    "no module": ("engines", "absent", "bayeq_absent:THING", "ModuleNotFoundError: No module named 'bayeq_absent'"),
    "a name of bayeq": ("engines", "vb", "bayeq_bad:THING", "ValueError: bayeq has one of this name"),
    "ends the process": ("engines", "ends", "bayeq_ends:THING", "SystemExit: 3"),
}


@pytest.mark.parametrize("case", FAULTY)
def test_a_faulty_package_is_named_once_and_left_out(case, tmp_path):
    table, name, value, why = FAULTY[case]
    (tmp_path / "bayeq_bad.py").write_text("THING = 1\n")
    (tmp_path / "bayeq_ends.py").write_text("raise SystemExit(3)\n")
    install(tmp_path, "bayeq-bad", {f"bayeq.{table}": {name: value}})
    code = "from bayeq.inference.engines import ENGINES as e; print(len(e), len(e.load()), len(e.load()), 'no' in e)"
    out, errors = run(tmp_path, "-W", "always", "-c", code)
    assert out.split() == ["6", "6", "6", "False"]
    said = [line for line in errors.splitlines() if "Warning: " in line]
    assert len(said) == 1
    assert f"BayeqWarning: bayeq-bad: {name!r} of bayeq.{table} is left out: {why}" in said[0]


def test_the_command_line_says_so_in_one_line(tmp_path):
    install(tmp_path, "bayeq-bad", {"bayeq.engines": {"lasso": "bayeq_absent:THING"}})
    _, errors = command(tmp_path, "discover", "run.csv", "--disp", "x", "--method", "lasso", code=2)
    first, second = errors.splitlines()
    assert first.startswith("bayeq: warning: bayeq-bad: 'lasso' of bayeq.engines is left out: ModuleNotFoundError")
    assert "'lasso' is not one of" in second


@pytest.mark.parametrize(
    "code",
    [
        "import bayeq",
        pytest.param("from bayeq.cli.app import main; main(['--help'])", marks=pytest.mark.slow),
        "from bayeq.cli.app import main; main(['discover', '--help'])",
        "import bayeq; bayeq.simulate('duffing', n=9); from bayeq.discovery import discover",
        "from bayeq.dictionary import *; build_dictionary('oscillator + sin(x) - v', Variables(('x', 'v'), ('u',)))",
    ],
)
def test_nobody_is_looked_for_where_none_is_asked_for(added, code):
    asked = "from bayeq.plugins import Table; Table.load = lambda self: 1 / 0; "
    out, _ = run(added, "-c", f"{asked}{code}; import sys; print('bayeq_added' in sys.modules)")
    assert out.splitlines()[-1] == "False"


@pytest.mark.slow
def test_the_package_can_be_installed(tmp_path):
    uv = Path(sys.executable).parent / "uv"
    if not uv.exists():
        pytest.skip("uv is not installed")
    shutil.copytree(ADDED, tmp_path / "source")
    options = ("--quiet", "--no-deps", "--target", tmp_path / "installed", tmp_path / "source")
    done = subprocess.run([uv, "pip", "install", *options], capture_output=True, text=True, check=False)
    if done.returncode and "fetch" in done.stderr:
        pytest.skip("setuptools cannot be downloaded")
    assert done.returncode == 0, done.stderr
    assert "softening" in command(tmp_path / "installed", "systems")[0]
