"""A short run of every target of fuzzing, and all that it ever found; the long form is ``make fuzz``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from tests.fuzz.__main__ import CORPUS, run_own, starts
from tests.fuzz.mutate import mutated
from tests.fuzz.targets import TARGETS

NEEDS = {"excel": "openpyxl", "hdf5": "h5py", "parquet": "pyarrow", "uff": "pyuff"}
FOLDER = Path(__file__).resolve().parents[1]


@pytest.fixture
def quiet():
    here = os.getcwd()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    os.chdir(here)  # commands run in a folder of their own


@pytest.mark.parametrize("name", TARGETS)
def test_short_run(name, tmp_path, quiet):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"needs {NEEDS[name]}, pip install 'bayeq[files,parquet]'")
    counts = run_own(name, 150, tmp_path, seconds=0.5)
    assert counts["own"] > 0
    found = [path.read_text() for path in tmp_path.glob("*.txt")]
    assert not found, found[0]


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_are_answered_and_kept_inputs_do_not_crash(name, quiet):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"needs {NEEDS[name]}, pip install 'bayeq[files,parquet]'")
    for data in starts(name, TARGETS[name]):
        TARGETS[name].run(data)


def test_kept_inputs_belong_to_a_target():
    assert {path.name for path in CORPUS.iterdir() if path.is_dir()} <= set(TARGETS)


def test_mutations_are_those_of_the_seed():
    import numpy as np

    pool, words = [b"x**3 + v", b"1,2,3"], (b"(", b"nan")
    first = [mutated(np.random.default_rng(5), pool, words) for _ in range(2)]
    assert first[0] == first[1]
    rng = np.random.default_rng(5)
    assert len({mutated(rng, pool, words) for _ in range(50)}) > 40


def test_a_finding_is_kept_and_the_command_says_so(tmp_path, monkeypatch, capsys):
    def broken(data: bytes) -> None:
        if b"9" in data:
            raise KeyError("nine")

    monkeypatch.setitem(TARGETS, "expressions", TARGETS["expressions"]._replace(run=broken))
    counts = run_own("expressions", 200, tmp_path)
    assert counts["findings"] == 1
    assert "KeyError" in capsys.readouterr().err
    kept = [path for path in tmp_path.glob("expressions-*") if path.suffix != ".txt"]
    assert b"9" in kept[0].read_bytes()
    again = run_own("expressions", 300, tmp_path)
    assert (again["own"], again["findings"]) == (300, 1)  # it goes on, and the same is not found twice


def test_the_command(tmp_path):
    command = [sys.executable, "-m", "tests.fuzz", "expressions", "--runs", "50", "--engine", "own"]
    command += ["--state", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=FOLDER, check=False)
    assert ended.returncode == 0, ended.stderr
    assert json.loads((tmp_path / "expressions.json").read_text())["own"] == 50
    table = subprocess.run(
        [*command[:3], "--state", str(tmp_path), "--table"], capture_output=True, text=True, cwd=FOLDER
    )
    assert "expressions,own,50,0,0" in table.stdout
    unknown = subprocess.run([*command[:3], "nothing"], capture_output=True, text=True, cwd=FOLDER, check=False)
    assert unknown.returncode == 2
