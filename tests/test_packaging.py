"""What is shipped: built as for a release, installed into an environment of its own, and run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]

# A wheel or an archive that is larger holds something that it should not [bytes].
LARGEST = 1_500_000

# Of the files of the package.
SUFFIXES = {".py", ".typed", ".html", ".css", ".js", ".json"}

# `tests/`, `studies/` and the like stay in the repository.
SHIPPED = {"src", "pyproject.toml", "setup.cfg", "MANIFEST.in", "PKG-INFO", "README.md", "LICENSE"}
SHIPPED |= {"CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "SECURITY.md"}
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
    assert source.name == f"bayeq-{VERSION}.tar.gz"
    assert wheel.name == f"bayeq-{VERSION}-py3-none-any.whl"
    return source, wheel


def test_the_wheel_holds_the_package_alone(built):
    with zipfile.ZipFile(built[1]) as archive:
        names = set(archive.namelist())
        entry_points = archive.read(f"bayeq-{VERSION}.dist-info/entry_points.txt").decode()
    assert {name.split("/")[0] for name in names} == {"bayeq", f"bayeq-{VERSION}.dist-info"}
    here = ROOT / "src" / "bayeq"
    sources = {path.relative_to(ROOT / "src").as_posix() for path in here.rglob("*") if path.suffix in SUFFIXES}
    assert {name for name in names if name.startswith("bayeq/")} == sources
    pages = {f"bayeq/equation/report/page.{kind}" for kind in ("html", "css", "js")}
    assert {"bayeq/py.typed", "bayeq/equation/schema.json"} | pages <= sources
    assert "[console_scripts]\nbayeq = bayeq.cli.process:run\n" in entry_points


def test_the_source_archive_holds_what_the_wheel_is_built_from(built):
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()} - {""}
    assert {name.split("/")[0] for name in names} == SHIPPED
    assert "src/bayeq/py.typed" in names
    assert not [name for name in names if name.endswith((".pyc", ".nbi", ".nbc"))]


def test_both_are_small(built):
    assert all(path.stat().st_size <= LARGEST for path in built)


def test_the_files_of_the_release_name_its_version():
    assert f"\nversion: {VERSION}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    sections = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    (of_this,) = (text for text in sections if text.splitlines()[0] == VERSION)
    assert len(of_this.splitlines()) <= 80


def installed(wheel, folder, python=sys.executable):
    """An environment with the wheel and what it needs, and a function that runs a command there."""
    uv("venv", "--quiet", "--python", python, folder / "venv")
    scripts = folder / "venv" / Path(sys.executable).parent.name
    interpreter = scripts / Path(sys.executable).name
    uv("pip", "install", "--quiet", "--python", interpreter, "--constraint", "constraints.txt", wheel)
    elsewhere = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run(command, *arguments):
        done = subprocess.run(
            [scripts / command, *arguments], cwd=folder, env=elsewhere, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return interpreter.name, run


def test_the_wheel_runs_in_a_clean_environment(built, tmp_path):
    python, run = installed(built[1], tmp_path)
    assert run("bayeq", "--help").startswith("Usage: bayeq ")
    assert run("bayeq", "--version").strip() == VERSION
    assert "duffing" in run("bayeq", "systems")
    assert Path(run(python, "-c", "import bayeq; print(bayeq.__file__)").strip()).is_relative_to(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_the_wheel_alone_finds_an_equation_on_this_python(built, tmp_path, version):
    ways = [[UV, "python", "find", version], [UV, "python", "install", version]]
    if all(subprocess.run(way, capture_output=True, check=False).returncode for way in ways):
        pytest.skip(f"Python {version} cannot be had here")
    python, run = installed(built[1], tmp_path, version)
    assert run(python, "--version").startswith(f"Python {version}.")
    run("bayeq", "simulate", "duffing", "--seed", "1", "-o", "duffing.csv")
    answer = run("bayeq", "discover", "duffing.csv", "--disp", "x", "--vel", "v", "--acc", "a", "--force", "u")
    assert answer.startswith("verdict: found")
    assert "a = -1003.6*x - 1.971*v - 9.964e+04*x**3 + 1.0002*u" in answer
