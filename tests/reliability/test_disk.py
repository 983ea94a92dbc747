"""Disks that are full, folders that are read-only, no home, and nowhere to keep compiled kernels."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import suppress

import pytest

from bayeq.cli.app import main
from tests.reliability.commands import QUICK, bayeq, environment, mounted, remarks

STUDY = ["study", "table2", "--systems", "linear", "--algorithms", "sindy", "--jobs", "1"]


@pytest.fixture
def run(folder, monkeypatch, capsys):
    """A command in this process, where the record is: exit code, standard output, and standard error."""
    monkeypatch.chdir(folder)

    def command(*arguments):
        code = main(list(map(str, arguments)))
        return code, *capsys.readouterr()

    return command


def fill(disk):
    with suppress(OSError):
        (disk / "other").write_bytes(bytes(80_000))


def test_a_full_disk_names_the_file(run, full_disk, monkeypatch):
    monkeypatch.setattr("bayeq.equation.report.page.pictures", lambda *_: ([], []))
    fill(full_disk)
    page = full_disk / "page.html"
    code, out, err = run("discover", "run.csv", *QUICK, "--report", page)
    assert (code, remarks(err)) == (2, [f"bayeq: error: {page}: No space left on device"])
    assert "\na = " in out
    code, _, err = run("simulate", "linear", "-o", full_disk / "new.csv")
    assert code == 2
    assert remarks(err) == [f"bayeq: error: {full_disk}/new.csv: cannot be written (No space left on device)"]
    assert [path.name for path in full_disk.rglob("*") if path.is_file()] == ["other"]


def test_a_study_on_a_full_disk_goes_on_when_there_is_room(run, full_disk):
    store, size = full_disk / "study.db", ["--realisations", "60"]
    code, _, err = run(*STUDY, *size, "--store", store)
    assert (code, remarks(err)) == (2, [f"bayeq: error: {store}: database or disk is full"])
    kept = json.loads(run("study", "show", store, "--json")[1])
    assert all(row["n"] < 60 for row in kept["rows"])
    subprocess.run(["mount", "-o", "remount,size=1m", str(full_disk)], check=True)
    assert run(*STUDY, *size, "--store", store)[0] == 0
    (row,) = json.loads(run("study", "show", store, "--json")[1])["rows"]
    assert row["n"] == 60


def test_a_full_disk_keeps_no_sums_and_the_run_goes_on(run, folder, full_disk):
    def answer(place):
        code, out, err = run("discover", "run.csv", *QUICK, "--stream", "--checkpoint", place)
        assert code == 0, err
        return out, [line for line in err.splitlines() if "sums" in line]

    expected, said = answer(folder / "room")
    assert said == []
    sums = full_disk / "sums"
    sums.mkdir()
    fill(full_disk)
    out, said = answer(sums)
    assert out == expected
    (line,) = said
    assert line.startswith(f"bayeq: warning: {sums}/")
    assert "npz: No space left on device: sums are not kept, the run goes on without; make room or" in line
    assert list(sums.iterdir()) == []


def test_a_full_cache_is_done_without_in_silence(run, full_disk, monkeypatch):
    """What nobody asked for is missed by nobody."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(full_disk))
    monkeypatch.setattr("bayeq.discovery.streaming.checkpoint.EVERY", 0.0)
    fill(full_disk)
    code, out, err = run("discover", "run.csv", *QUICK, "--stream")
    assert (code, remarks(err)) == (0, [])
    assert "\na = " in out
    assert "sums" not in err
    assert [path for path in (full_disk / "bayeq").rglob("*") if path.is_file()] == []


def test_read_only_folders_are_refused_before_the_work(run, read_only):
    for command in (
        ["discover", "run.csv", *QUICK, "--save", read_only / "eq.json"],
        ["discover", "run.csv", *QUICK, "--report", read_only / "page.html"],
        ["discover", "run.csv", *QUICK, "--stream", "--checkpoint", read_only / "sums"],
        ["simulate", "linear", "-o", read_only / "new.csv"],
        [*STUDY, "--store", read_only / "study.db"],
    ):
        code, out, err = run(*command)
        said = remarks(err)
        assert (code, out, len(said)) == (2, "", 1)
        assert said[0].startswith(f"bayeq: error: {read_only}/")


@pytest.mark.parametrize("home", [pytest.param("none", marks=pytest.mark.slow), "read-only"])
def test_without_a_home_everything_works_in_silence(home, folder, read_only):
    homes = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"))
    homes["HOME"] = None if home == "none" else read_only
    code, out, said = bayeq("discover", "run.csv", *QUICK, "--stream", "--forecast", "run.png", cwd=folder, **homes)
    assert (code, said) == (0, [])
    assert "\na = " in out
    assert (folder / "run.png").stat().st_size > 5000


KERNEL = """
from bayeq.kernels import kernel

@kernel
def double(x):
    return 2 * x

print(double(21))
"""


def test_an_installation_that_cannot_be_written_compiles_in_memory(tmp_path):
    place, home = tmp_path / "installed", tmp_path / "home"
    place.mkdir()
    home.mkdir()
    with mounted(place, "size=1m"):
        (place / "caller.py").write_text(KERNEL)
        subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)

        def run(home):
            done = subprocess.run(
                [sys.executable, str(place / "caller.py")],
                env=environment(HOME=home, XDG_CACHE_HOME=None), capture_output=True, text=True, check=True,
            )  # fmt: skip
            return done.stdout, done.stderr

        # the user's cache, or none
        assert run(home) == ("42\n", "")
        assert list(home.rglob("*.nbi"))
        assert run(place) == ("42\n", "")
