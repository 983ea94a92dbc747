"""What is shipped: built as for a release, installed into an environment of its own, and run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import bayeq as bq

ROOT = Path(__file__).parents[1]
UV = Path(sys.executable).parent / "uv"


def uv(*arguments):
    """Run uv; skips the test where it would have to download something and cannot."""
    if not UV.exists():
        pytest.skip("uv is not installed")
    done = subprocess.run([UV, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode and re.search(r"Failed to (fetch|download)|error sending request|network", done.stderr):
        pytest.skip(f"a package cannot be downloaded: {done.stderr.strip().splitlines()[0]}")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source distribution, and the wheel that is built from it."""
    folder = tmp_path_factory.mktemp("dist")
    uv("build", "--quiet", "--out-dir", folder)
    (source,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
    assert source.name == f"bayeq-{bq.__version__}.tar.gz"
    assert wheel.name == f"bayeq-{bq.__version__}-py3-none-any.whl"
    return source, wheel


def test_the_wheel_holds_the_package_alone(built):
    with zipfile.ZipFile(built[1]) as archive:
        names = set(archive.namelist())
    assert {name.split("/")[0] for name in names} == {"bayeq", f"bayeq-{bq.__version__}.dist-info"}
    sources = {path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src" / "bayeq").rglob("*.py")}
    assert {name for name in names if name.startswith("bayeq/")} == sources | {
        "bayeq/py.typed",
        "bayeq/equation/report/page.html",
        "bayeq/equation/schema.json",
    }


def test_the_source_distribution_holds_what_git_does(built):
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:
        pytest.skip("this is no checkout of git")
    assert {name for name in tracked.stdout.splitlines() if not name.startswith((".ci/", ".git"))} <= names
    assert not [name for name in names if name.endswith((".pyc", ".nbi", ".nbc"))]


def test_the_wheel_runs_in_a_clean_environment(built, tmp_path):
    uv("venv", "--quiet", "--python", sys.executable, tmp_path / "venv")
    python = tmp_path / "venv" / Path(sys.executable).parent.name / Path(sys.executable).name
    uv("pip", "install", "--quiet", "--python", python, "--constraint", "constraints.txt", built[1])
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(*command):
        done = subprocess.run(command, cwd=tmp_path, env=elsewhere, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    command = python.parent / "bayeq"
    assert run(command, "--help").startswith("Usage: bayeq ")
    assert run(command, "--version").strip() == bq.__version__
    assert "duffing" in run(command, "systems")
    assert Path(run(python, "-c", "import bayeq; print(bayeq.__file__)").strip()).is_relative_to(tmp_path)
