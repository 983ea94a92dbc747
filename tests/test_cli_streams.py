"""The command with standard streams that are closed or full."""

from __future__ import annotations

import shlex
import subprocess
import sys

import pytest

import bayeq as bq

CLOSED = "bayeq: error: standard output is closed: the result cannot be printed\n"


def bayeq(*arguments, streams):
    command = shlex.join([sys.executable, "-m", "bayeq", *map(str, arguments)])
    done = subprocess.run(["sh", "-c", f"{command} {streams}"], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "linear.csv"
    bq.write(bq.simulate("linear", n=300, seed=0), path)
    return path


def arguments(record):
    return ["discover", record, "--chain", "x:v:a", "--input", "u", "--dictionary", "x, v, u", "--smooth", "none"]


@pytest.mark.parametrize(
    ("streams", "code", "err"),
    [
        (">&-", 1, CLOSED),
        pytest.param(">&- 2>&-", 1, "", marks=pytest.mark.slow),
        pytest.param("<&- >&- 2>&-", 1, "", marks=pytest.mark.slow),  # of two of them closed: below
        (">/dev/full", 1, "bayeq: error: the result cannot be written: No space left on device\n"),
    ],
)
def test_a_result_that_cannot_be_printed_is_an_error_in_one_line(streams, code, err):
    for command in (["systems"], ["--help"]):
        assert bayeq(*command, streams=streams) == (code, "", err)


@pytest.mark.parametrize(
    "streams", [*(pytest.param(one, marks=pytest.mark.slow) for one in ("2>&-", "<&- 2>&-")), "2>/dev/full"]
)
def test_without_standard_error_the_result_is_printed(record, streams):
    code, out, _ = bayeq(*arguments(record), streams=streams)
    assert code == 0
    assert "\na = " in out
    assert bayeq("discover", "absent.csv", "--disp", "x", streams=streams) == (2, "", "")


@pytest.mark.parametrize("streams", [pytest.param(">&-", marks=pytest.mark.slow), ">&- 2>&-"])
def test_what_prints_nothing_needs_no_standard_output(record, tmp_path, streams):
    file = tmp_path / "run.csv"
    assert bayeq("simulate", "linear", "-o", file, "--n", "300", streams=streams)[0] == 0
    # nothing that was printed is among the rows, as it would be in the file that took the place of a closed stream
    assert file.read_bytes() == record.read_bytes()


def test_the_files_are_written_though_the_equation_cannot_be_printed(record, tmp_path):
    file = tmp_path / "eq.json"
    code, _, err = bayeq(*arguments(record), "--save", file, streams=">&-")
    assert (code, err.splitlines()[-1] + "\n") == (1, CLOSED)
    assert bq.load(file)[0].target == "a"


def test_progress_says_rate_and_time_left(monkeypatch, capsys):
    from bayeq.cli import terminal

    now = [100.0]
    monkeypatch.setattr(terminal.clock, "monotonic", lambda: now[0])
    shown = terminal.Progress()
    shown.stage, shown.began, shown.first, shown.done, shown.total = "rows", 100.0, 1_000_000, 3_000_000, 5_000_000
    shown.said = -100.0
    now[0] = 110.0
    shown._show()
    assert capsys.readouterr().err == (
        "bayeq: progress: rows, 3,000,000 of 5,000,000 (200,000 a second, 10 s left), 10 s\n"
    )
