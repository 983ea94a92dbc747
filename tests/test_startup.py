"""What a command loads: help and errors of arguments and files need neither a compiler nor numerical libraries."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

import bayeq as bq

RUN = """
import json
import sys
from bayeq.cli.app import main

for words in json.loads(sys.argv[1]):
    code = main(words)
    print("loaded:", code, *sys.modules, file=sys.stderr)
"""
HEAVY = {"numba", "scipy", "pandas", "sympy", "sklearn", "matplotlib", "pyarrow", "joblib", "rich"}


def run(*commands, cwd=None):
    """Exit codes of commands in one process, and the modules that were loaded after each."""
    command = [sys.executable, "-c", RUN, json.dumps(commands)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=True)
    lines = [line.split()[1:] for line in done.stderr.splitlines() if line.startswith("loaded: ")]
    assert len(lines) == len(commands)
    return [(int(code), set(modules)) for code, *modules in lines]


def test_help_loads_no_numerical_library():
    commands = (
        ["--help"],
        ["--version"],
        ["--cite"],
        ["discover", "--help"],
        ["info", "--help"],
        ["plan", "--help"],
        ["app", "--help"],
        ["simulate", "--help"],
        ["discover"],
    )
    for words, (_, loaded) in zip(commands, run(*commands), strict=True):
        assert not (HEAVY | {"numpy"}) & loaded, words


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    bq.write(bq.simulate("linear", n=50, seed=0), path / "run.csv")
    (path / "bad.csv").write_text("t,x\n0,1\n1,one\n")
    return path


def test_errors_of_arguments_and_files_load_no_compiler(folder):
    commands = [
        ["discover", *words]
        for words in (
            ["missing.csv", "--disp", "x"],
            ["bad.csv", "--disp", "x"],
            ["run.csv", "--dips", "x"],
            ["run.csv", "--disp", "y"],
            ["run.csv", "--chain", "x:x"],
            ["run.csv", "--disp", "x", "--dictionary", "x, sine(x)"],
            ["run.csv", "--disp", "x", "--method", "lasso"],
            ["run.csv", "--disp", "x", "--save", "nowhere/eq.json"],
            ["run.csv", "--disp", "x", "--constraint", "x = 1"],
        )
    ]
    for words, (code, loaded) in zip(commands, run(*commands, cwd=folder), strict=True):
        assert code == 2, words
        assert not HEAVY & loaded, words


def test_discovery_loads_no_library_that_it_does_not_need(folder):
    options = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u", "--dictionary", "x, v, u"]
    ((code, loaded),) = run(["discover", "run.csv", *options], cwd=folder)
    assert code == 0
    assert not (HEAVY - {"numba", "scipy", "rich"}) & loaded
    # numba imports scipy itself, which is light
    assert not {"scipy.linalg", "scipy.special", "scipy.optimize", "scipy.interpolate", "rich.progress"} & loaded
