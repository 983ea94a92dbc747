"""What a command loads: help and errors of arguments and files need neither a compiler nor numerical libraries."""

from __future__ import annotations

import subprocess
import sys

import pytest

import bayeq as bq

RUN = """
import sys
from bayeq.cli.app import main

code = main(sys.argv[1:])
print(code, *sys.modules, file=sys.stderr)
"""
HEAVY = {"numba", "scipy", "pandas", "sympy", "sklearn", "matplotlib", "pyarrow", "joblib", "rich"}


def run(*arguments, cwd=None):
    """Exit code and the modules that were loaded."""
    done = subprocess.run([sys.executable, "-c", RUN, *arguments], cwd=cwd, capture_output=True, text=True, check=True)
    code, *modules = done.stderr.splitlines()[-1].split()
    return int(code), set(modules)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["--cite"],
        ["discover", "--help"],
        ["info", "--help"],
        ["plan", "--help"],
        ["app", "--help"],
        ["simulate", "--help"],
        ["discover"],
    ],
)
def test_help_loads_no_numerical_library(arguments):
    _, loaded = run(*arguments)
    assert not (HEAVY | {"numpy"}) & loaded


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    bq.write(bq.simulate("linear", n=50, seed=0), path / "run.csv")
    (path / "bad.csv").write_text("t,x\n0,1\n1,one\n")
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ["missing.csv", "--disp", "x"],
        ["bad.csv", "--disp", "x"],
        ["run.csv", "--dips", "x"],
        ["run.csv", "--disp", "y"],
        ["run.csv", "--chain", "x:x"],
        ["run.csv", "--disp", "x", "--dictionary", "x, sine(x)"],
        ["run.csv", "--disp", "x", "--method", "lasso"],
        ["run.csv", "--disp", "x", "--save", "nowhere/eq.json"],
        ["run.csv", "--disp", "x", "--constraint", "x = 1"],
    ],
)
def test_errors_of_arguments_and_files_load_no_compiler(folder, arguments):
    code, loaded = run("discover", *arguments, cwd=folder)
    assert code == 2
    assert not HEAVY & loaded


def test_discovery_loads_no_library_that_it_does_not_need(folder):
    options = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, u"]
    code, loaded = run("discover", "run.csv", *options, cwd=folder)
    assert code == 0
    assert not (HEAVY - {"numba", "scipy", "rich"}) & loaded
    # numba imports scipy itself, which is light
    assert not {"scipy.linalg", "scipy.special", "scipy.optimize", "scipy.interpolate", "rich.progress"} & loaded
