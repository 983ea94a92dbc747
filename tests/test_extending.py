"""The files and rows of docs/extending.md, put into a copy of the source: they pass the conformance tests there."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from examples.run_page import blocks

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "extending.md"
COPIED = ("src", "tests", "examples", "docs", "pyproject.toml", "README.md", "CONTRIBUTING.md")

# Compiled kernels are copied as well, but not what another process is writing just now.
PASSED_OVER = shutil.ignore_patterns("*.png", "*.svg", "*.tmp.*")

# Of the folders' tests, those of what the page adds.
ADDED = (
    "forward or softening or friction or (JSON and Lines) or terms_page or lists_every_format"
    " or test_the_schema_uses_keywords_that_are_checked"
)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A copy of the source with all that the page adds."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=PASSED_OVER)
        else:
            shutil.copy(ROOT / name, folder)
    for block in blocks(PAGE):
        if block.language == "python":
            path = folder / block.text.splitlines()[0].removeprefix("# ")
            assert not path.exists(), f"{path.name} is there already"
            path.write_text(block.text.split("\n", 1)[1], encoding="utf-8")
        elif block.language == "diff":
            for change in block.text.split("--- ")[1:]:
                apply(folder, change)
    return folder


def apply(folder, change):
    """Replace the lines before by those after, which stand once in the file."""
    name, *lines = change.splitlines()
    before = "\n".join(line[1:] for line in lines if line[:1] != "+").rstrip("\n")
    after = "\n".join(line[1:] for line in lines if line[:1] != "-")
    path = folder / name
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{name}: not once in it: {before!r}"
    path.write_text(text.replace(before, after), encoding="utf-8")


def run(folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": f"{folder / 'src'}{os.pathsep}{folder}", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTEST_XDIST_WORKER", None)
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def test_what_the_page_adds_passes_the_conformance_tests(copy):
    names = ("layers", "terms_page", "dictionary_unions", "saved_files", "sources")
    files = ["tests/conformance", *(f"tests/test_{name}.py" for name in names)]
    report = run(copy, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *files, "-k", ADDED)
    assert " passed" in report


@pytest.mark.slow
def test_what_the_page_adds_works_together(copy):
    code = "from pathlib import Path; from examples.run_page import run_page; run_page(Path('docs/extending.md'))"
    run(copy, "-c", code)


@pytest.mark.skipif(shutil.which("ruff", path=Path(sys.executable).parent) is None, reason="ruff is absent: extra dev")
def test_what_the_page_adds_is_clean(copy):
    files = [block.text.splitlines()[0].removeprefix("# ") for block in blocks(PAGE) if block.language == "python"]
    run(copy, "-m", "ruff", "check", *files)
    run(copy, "-m", "ruff", "format", "--check", *files)


def test_a_change_that_does_not_fit_is_refused(tmp_path):
    (tmp_path / "a.py").write_text("ROWS = [\n    1,\n]\n")
    apply(tmp_path, "a.py\n     1,\n+    2,\n")
    assert (tmp_path / "a.py").read_text() == "ROWS = [\n    1,\n    2,\n]\n"
    with pytest.raises(AssertionError, match=r"a\.py: not once"):
        apply(tmp_path, "a.py\n     3,\n+    4,\n")
