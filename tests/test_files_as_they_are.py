"""Files and frames as people have them: sheets, gains, headers with spaces, impossible samples, times, dates."""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.errors import DataWarning, InputError, RecordError, UnknownNameError, WordsError
from tests.uncovered import WITHOUT_PYC, uncovered

AS_MEASURED = ("--smooth", "none", "--dictionary", "x, v, x**3, u")


@pytest.fixture(scope="module")
def frame():
    return bq.simulate("duffing", n=400, seed=1).to_dataframe()


def ran(capsys, *arguments):
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    return code, out, err


def refused(capsys, *arguments):
    code, _, err = ran(capsys, *arguments)
    assert code == 2, err
    (line,) = [line for line in err.splitlines() if line.startswith("bayeq: error: ")]
    return line


# --- sheets ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def book(tmp_path, frame):
    pytest.importorskip("openpyxl")
    path = tmp_path / "book.xlsx"
    with pd.ExcelWriter(path) as writer:
        pd.DataFrame({"name": ["mass", "k"], "value": [2.0, 3.0]}).to_excel(writer, sheet_name="Notes", index=False)
        frame.head(100).to_excel(writer, sheet_name="Run 1", index=False)
        frame.to_excel(writer, sheet_name="Run 2", index=False)
    return path


def test_the_sheet_with_most_rows_of_numbers_is_read(book):
    with pytest.warns(
        DataWarning, match=r"sheet 'Run 2' is read, of 400 rows, not 'Notes', 'Run 1'; give another: --sheet"
    ):
        assert bq.read(book).n == 400


def test_a_sheet_by_its_name(book, capsys, monkeypatch):
    monkeypatch.setattr("bayeq.equation.report.page.pictures", lambda *_: ([], []))
    assert bq.read(book, sheet="Run 1").n == 100
    record = bq.read(f"{book}[Run 1]")
    assert (record.n, record.name) == (100, "book.xlsx[Run 1]")
    report = book.with_name("page.html")
    code, out, err = ran(
        capsys, "discover", f"{book}[Run 1]", "--chain", "x:v:a", "--input", "u", *AS_MEASURED, "--report", report
    )
    assert code == 0, err
    assert "100 rows" in out
    assert hashlib.sha256(book.read_bytes()).hexdigest() in report.read_text(encoding="utf-8")
    given = ("discover", f"{book}[Run 1]", "--chain", "x:v:a", "--report", book.with_suffix(".html"), "--save", book)
    assert "is a file that is read" in refused(capsys, *given)
    code, out, _ = ran(capsys, "discover", book, "--sheet", "Run 1", "--chain", "x:v:a", "--input", "u", *AS_MEASURED)
    assert "100 rows" in out


def test_a_sheet_that_is_not_there(book, frame, capsys):
    line = refused(capsys, "discover", book, "--sheet", "Run3", "--chain", "x:v:a")
    assert "no sheet named 'Run3'; did you mean 'Run 2' or 'Run 1'?" in line
    frame.to_csv(book.with_name("run.csv"), index=False)
    line = refused(capsys, "discover", book.with_name("run.csv"), "--sheet", "Run 1", "--chain", "x:v:a")
    assert "only Excel files have sheets" in line


# --- names, gains ----------------------------------------------------------------------------------------------------


def test_channels_by_their_headers(frame, tmp_path, capsys):
    names = {"x": "Position 1 [m]", "v": "Vel. 1", "a": "Accel. 1", "u": "Force in"}
    path = tmp_path / "run.csv"
    frame.rename(columns=names).to_csv(path, index=False)
    chain = ("--chain", "Position 1:Vel. 1:Accel. 1", "--input", "Force in", "--smooth", "none")
    terms = ("--dictionary", "Position_1, Vel_1, Position_1**3, Force_in", "--gain-sd", "Vel. 1=0.01")
    code, out, err = ran(capsys, "discover", path, *chain, *terms)
    assert code == 0, err
    assert "\nAccel_1 = " in out
    code, out, err = ran(capsys, "discover", path, "--chain", "Position 1::Accel. 1", "--smooth", "none")
    assert code == 0, err
    eq = bq.discover(path, chains="Position 1:~Vel. 1:Accel. 1", inputs=["Force in"], smooth="none")
    assert eq.chains[0].names == ("Position_1", "Vel_1", "Accel_1")


def test_gains(frame, tmp_path, capsys):
    path = tmp_path / "run.csv"
    frame.to_csv(path, index=False)
    plain = bq.read(path)
    record = bq.read(path, units={"a": "10 g", "x": "-2", "t": "2ms", "v": "1/s"})
    np.testing.assert_array_equal(record["a"], 10 * plain["a"])
    np.testing.assert_array_equal(record["x"], -2 * plain["x"])
    np.testing.assert_allclose(record.time, plain.time * 2e-3, rtol=1e-12)
    assert dict(record.units) == {"a": "g", "v": "1/s", "t": "s"}
    given = ("discover", path, "--chain", "x:v:a", "--input", "u", *AS_MEASURED, "--json")
    answer = json.loads(ran(capsys, *given, "--scale", "a=4", "--units", "a=2m/s^2,u=8N")[1])
    by_hand = plain.with_channels({"a": 8 * plain["a"], "u": 8 * plain["u"]}, {"a": "m/s^2", "u": "N"})
    wanted = bq.discover(by_hand, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u", smooth="none")
    assert answer["equations"] == json.loads(json.dumps(wanted.to_dict()["equations"]))
    for option, text, said in (
        ("--scale", "v=0", "a gain is a number other than 0"),
        ("--scale", "v=nan", "a gain is a number other than 0"),
        ("--scale", "v", "write a channel and its gain"),
        ("--units", "v=0g", "a gain is a number other than 0"),
        ("--units", "v=10xyz", "'xyz' is no unit that is known"),
    ):
        assert said in refused(capsys, *given, option, text)


# --- samples, times --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.inf, pytest.param(-np.inf, marks=pytest.mark.slow), 1e300])
def test_an_impossible_sample_is_a_missing_one(frame, value):
    bad, missing = frame.copy(), frame.copy()
    bad.loc[200, "v"], missing.loc[200, "v"] = value, np.nan
    roles = {"chains": "x:v:a", "inputs": ["u"], "dictionary": "x, v, x**3, u"}
    with pytest.warns(DataWarning, match=r"v: 1 sample is infinite or beyond 1e\+50 \(row 201\): taken as missing"):
        found = bq.discover(bad, **roles)
    with pytest.warns(DataWarning, match="v: 1 sample is missing"):
        assert found[0].coef == bq.discover(missing, **roles)[0].coef


def test_repeated_times(frame, tmp_path):
    path = tmp_path / "run.csv"
    again = frame.copy()
    again.loc[200, "t"] = again.loc[199, "t"]
    again.to_csv(path, index=False)
    with pytest.warns(DataWarning, match=r"column 't': 1 row repeats the time of the row before \(201\): the first"):
        record = bq.read(path)
    np.testing.assert_array_equal(record["x"], frame["x"].drop(index=200))
    again["trial"] = np.arange(400) // 100
    again.loc[:, "t"] = np.tile(frame["t"][:100], 4)
    again.loc[250, "t"] = again.loc[249, "t"]
    again.to_csv(path, index=False)
    with pytest.warns(DataWarning, match=r"\(251\)"):
        assert [trial.n for trial in bq.read(path, group="trial")] == [100, 100, 99, 100]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (lambda t: 0 * t + 1.5, r"all 400 times are 1.5: the clock is too coarse; give the sampling rate"),
        (lambda t: np.floor(t * 100) / 100, r"rows repeat the time before: the clock is too coarse"),
    ],
)
def test_a_coarse_clock_is_refused(frame, times, said):
    with pytest.raises(RecordError, match=said):
        bq.Record.from_dataframe(frame.assign(t=times(frame["t"])))


def dated(path, *stamps):
    path.write_text("Time,x\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(stamps)), encoding="utf-8")
    return bq.read(path).time.tolist()


def test_dates_with_slashes(tmp_path):
    path = tmp_path / "run.csv"
    assert dated(path, "3/31/2024 11:59:59 PM", "4/1/2024 12:00:00 AM", "4/1/2024 12:00:01 am") == [0, 1, 2]
    assert dated(path, "2024/03/31 23:59:59.5", "2024/04/01 00:00:00") == [0, 0.5]
    # which of two numbers is the day, where both may be: midnight is nearer than a month
    assert dated(path, "03/04/2024 23:59:59", "04/04/2024 00:00:00") == [0, 1]
    assert dated(path, "03/04/2024 23:59:59", "03/05/2024 00:00:00") == [0, 1]
    assert dated(path, "12/03/2024 23:59:59", "13/03/2024 00:00:00") == [0, 1]
    with pytest.raises(InputError, match="line 3, column 'Time': '99/99/2024 0:00' is not a time stamp"):
        dated(path, "03/04/2024 23:59", "99/99/2024 0:00")


# --- frames ----------------------------------------------------------------------------------------------------------


def test_columns_of_words(frame):
    words = frame.assign(label="a", kind=pd.Categorical(["u", "w"] * 200))
    with pytest.warns(DataWarning, match="'label', 'kind' hold words, not numbers: left out"):
        assert bq.Record.from_dataframe(words).names == ("x", "v", "a", "u")
    with pytest.raises(WordsError, match="label"):
        bq.Record.from_dataframe(words, columns=["x", "label"])


@pytest.mark.parametrize(
    "convert",
    [lambda x: x, str, Decimal, lambda x: np.float32(x) if x > 0 else float(x)],
    ids=["float", "text", "decimal", "mixed"],
)
def test_numbers_as_objects(frame, convert):
    record = bq.Record.from_dataframe(frame.assign(x=frame["x"].map(convert).astype(object)))
    np.testing.assert_allclose(record["x"], frame["x"], rtol=1e-7)


def test_other_objects(frame):
    huge = [10**25 + k for k in range(400)]
    record = bq.Record.from_dataframe(frame.assign(n=huge, x=frame["x"].astype(object).where(frame.index != 3, None)))
    assert record["n"][0] == 1e25
    assert np.isnan(record["x"][3])
    began = datetime.datetime(2024, 3, 1, 12)
    times = [began + datetime.timedelta(milliseconds=k) for k in range(400)]
    for column in (pd.Series(times, dtype=object), pd.Series(map(str, times))):
        np.testing.assert_allclose(bq.Record.from_dataframe(frame.assign(t=column)).time, frame["t"], atol=1e-9)


# --- arguments -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("columns", 3),
        ("columns", [3]),
        ("names", 3),
        ("channels", 3),
        ("units", 3),
        ("time", 3),
        ("group", 3),
        ("skip", "3"),
        ("sheet", 3),
    ],
)
def test_arguments_of_the_wrong_type(frame, tmp_path, name, value):
    frame.to_csv(tmp_path / "run.csv", index=False)
    with pytest.raises(InputError, match=name):
        bq.read(tmp_path / "run.csv", **{name: value})


def test_near_files(frame, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    frame.to_csv("x.csv", index=False)
    assert "did you mean 'x.csv'?" in refused(capsys, "discover", "x", "--chain", "x")
    assert "did you mean 'x.csv'?" in refused(capsys, "discover", "x.mat", "--chain", "x")
    assert "no such file: x.json; did you mean 'x.csv'?" in refused(capsys, "show", "x.json")


def test_what_has_no_end_is_no_file_of_equations(capsys, monkeypatch):
    monkeypatch.setattr("bayeq.equation.load.MOST_BYTES", 2**20)
    assert "/dev/zero: longer than 1 MiB" in refused(capsys, "show", "/dev/zero")


def test_limits_of_constraints_and_dictionaries(frame, tmp_path, capsys):
    frame.to_csv(tmp_path / "run.csv", index=False)
    given = ("discover", tmp_path / "run.csv", "--chain", "x:v:a", "--smooth", "none")
    assert "beyond 1e+50" in refused(capsys, *given, "--constraint", "x == 1e300")
    assert "dictionary 'polynomial:-1': the degree" in refused(capsys, *given, "--dictionary", "polynomial:-1")


def test_a_unit_in_two_brackets(tmp_path):
    (tmp_path / "run.csv").write_text("t,x [(1)],v [(m/s)]\n0,1,2\n1,2,3\n", encoding="utf-8")
    from bayeq.records.names import parse_unit

    units = bq.read(tmp_path / "run.csv").units
    assert parse_unit(units["x"]) == {}
    assert parse_unit(units["v"]) == {"m": 1, "s": -1}


def test_modules_are_listed():
    assert {"errors", "figures"} <= set(dir(bq))
    assert bq.errors.InputError is InputError


def test_a_name_of_any_length_is_a_short_line():
    assert len(str(UnknownNameError("channel", "x" * 5000, ["x"]))) < 200
    said = str(UnknownNameError("channel", "S,I", ["S", "I", "R"]))
    assert said == "no channel named 'S,I': these are 2, give each by itself"


def test_folders_of_killed_applications_are_removed(tmp_path, monkeypatch):
    from bayeq.app.session import Workspace

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    done = subprocess.Popen([sys.executable, "-c", ""])
    done.wait()
    (tmp_path / f"bayeq-app-{done.pid}-abc").mkdir()
    for kept in (f"bayeq-app-{os.getpid()}-abc", "bayeq-app-abc", "bayeq-app-x-y", f"other-{done.pid}-abc"):
        (tmp_path / kept).mkdir()
    workspace = Workspace()
    found = sorted(path.name for path in tmp_path.iterdir())
    assert f"bayeq-app-{done.pid}-abc" not in found
    assert len(found) == 5
    workspace.remove()


def test_a_full_disk_is_no_damaged_file(book):
    # the copy of a sheet is text; no file may grow beyond 512 bytes
    command = shlex.join([sys.executable, "-m", "bayeq", "discover", str(book), "--chain", "x:v:a"])
    limited = ["sh", "-c", f"ulimit -f 1; {command}"]
    done = subprocess.run(limited, capture_output=True, text=True, check=False, env={**uncovered(), **WITHOUT_PYC})
    assert (done.returncode, done.stderr.splitlines()[-1]) == (
        2,
        f"bayeq: error: {book}: cannot be read (File too large)",
    )


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_an_error_that_is_not_known_is_no_run_that_blew_up(frame):
    from bayeq.equation.applied import apply_to

    record = bq.Record.from_dataframe(frame)
    eq = bq.discover(record, chains="x:v:a", inputs=["u"], dictionary="x, v, x**3, u", smooth="none")
    found = apply_to(eq, [record], draws=2)
    nothing = replace(found.free_run["x"], nrmse=np.nan, rms=np.nan)
    text = str(replace(found, free_run={"x": nothing, "v": replace(nothing, nrmse=np.inf, rms=np.inf)}))
    lines = {line.split(",")[0].strip("| "): line for line in text.splitlines() if "free run" in line}
    assert "blew up" not in lines["x"]
    assert "blew up" in lines["v"]


@pytest.mark.parametrize(
    ("header", "cells", "step"),
    [
        ("Time [d]", [k / 1440.0 for k in range(30)], 60.0),
        ("Timestamp", [round(46093.375 + k / 1440.0, 8) for k in range(30)], 60.0),  # Excel's days, 8 decimals
        ("Timestamp", [round(46093.375 + k * 0.001, 3) for k in range(30)], 0.001),  # seconds since midnight
        ("Time [s]", [(86399.9 + k * 0.01) % 86400.0 for k in range(30)], 0.01),  # over midnight
    ],
)
def test_days_and_seconds_of_the_day_are_seconds(header, cells, step, tmp_path):
    path = tmp_path / "logged.csv"
    rows = [f"{cell!r},{0.1 * k * k:.3f}" for k, cell in enumerate(cells)]
    path.write_text("\n".join([f"{header},x [m]", *rows]) + "\n")
    time = bq.read(path).time
    assert np.diff(time) == pytest.approx(step, rel=2e-3)
