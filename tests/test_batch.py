"""Many files: resumed, changed, refused, killed, in any number of processes the same table."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pandas as pd
import pytest

import bayeq as bq
from bayeq.batches.result import Identity, digest, files_of
from bayeq.cli.app import main
from bayeq.errors import FileFormatError, InputError, UnknownNameError
from bayeq.figures.terms import draw_drift

OPTIONS = {
    "displacement": "x",
    "velocity": "v",
    "acceleration": "a",
    "force": "u",
    "dictionary": "x, v, x**3, u",
    "smooth": "none",
}
WORDS = [
    *("--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"),
    *("--dictionary", "x, v, x**3, u", "--smooth", "none"),
]
ROWS = 400


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """Four files, of which each has a spring that is 50 1/s^2 softer than the one before."""
    folder = tmp_path_factory.mktemp("days")
    for k in range(4):
        record = bq.simulate("duffing", n=ROWS, seed=k, noise=0.01, parameters={"k": 1000.0 - 50.0 * k})
        bq.write(record, folder / f"day{8 + k}.csv")
    return folder


@pytest.fixture
def folder(days, tmp_path):
    """A copy that may be changed."""
    return shutil.copytree(days, tmp_path / "days")


@pytest.fixture(scope="module")
def found(days, tmp_path_factory):
    return bq.batch(days, store=tmp_path_factory.mktemp("store") / "batch.db", **OPTIONS)


def contents(path):
    """The rows of a store, without when and where."""
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as connection, connection:
        rows = connection.execute("SELECT path, sha256, status, answer FROM files ORDER BY path, options").fetchall()
    connection.close()
    return [(os.path.basename(path), *rest) for path, *rest in rows]


# What is found


def test_a_file_is_answered_as_by_discover(found, days):
    assert [one.status for one in found] == ["ok"] * 4
    assert found.refused == ()
    alone = bq.discover(days / "day9.csv", **OPTIONS)
    assert found[1].equations.to_dict() == alone.to_dict()
    row = found.table().query("order == 1 and term == 'x'").iloc[0]
    assert row.coef == alone[0].shown_coef["x"]
    assert (row.ci_low, row.ci_high) == tuple(alone[0].printed_ci95[0])
    assert row.verdict == alone[0].verdict.kind


def test_files_are_in_the_order_of_their_numbers(found):
    table = found.table()
    names = [os.path.basename(name) for name in table.file.unique()]
    assert names == ["day8.csv", "day9.csv", "day10.csv", "day11.csv"]
    assert table.order.is_monotonic_increasing
    assert {"x", "v", "u"} <= set(table.term)


def test_equations_of_different_terms_are_not_compared(found):
    # where the motion is small the cubic term is within the tolerance, or not seen
    assert not found.table().query("term == 'x**3'").shown.all()
    assert "The terms are not those of all files" in str(found)


def test_a_term_that_one_file_lacks_is_a_row_there(found):
    table = found.table()
    sizes = table.groupby("file").size()
    assert sizes.nunique() == 1
    assert (table.loc[~table.shown, "coef"] == 0.0).all()


def test_any_number_of_jobs_finds_the_same(found, days, tmp_path):
    other = bq.batch(days, store=tmp_path / "batch.db", jobs=2, **OPTIONS)
    pd.testing.assert_frame_equal(other.table(), found.table())


# What is kept


def test_what_is_done_is_not_done_twice(folder, tmp_path):
    store, calls = tmp_path / "batch.db", []
    first = bq.batch(folder, store=store, **OPTIONS)
    before = contents(store)
    again = bq.batch(folder, store=store, progress=lambda *step: calls.append(step), **OPTIONS)
    assert (first.done, again.done, calls) == (4, 0, [])
    pd.testing.assert_frame_equal(again.table(), first.table())
    # a file that is written again as it was is the same
    os.utime(folder / "day9.csv")
    assert bq.batch(folder, store=store, **OPTIONS).done == 0
    assert contents(store) == before
    # one that has changed is not, and a new one is
    bq.write(bq.simulate("duffing", n=ROWS, seed=9), folder / "day9.csv")
    shutil.copy(folder / "day8.csv", folder / "day12.csv")
    changed = bq.batch(folder, store=store, **OPTIONS)
    assert (changed.done, len(changed)) == (2, 5)
    assert changed[1].content != first[1].content
    assert len(contents(store)) == 5


def test_two_batches_in_one_store(folder, tmp_path, found):
    store = tmp_path / "batch.db"
    bq.batch(folder, store=store, **OPTIONS)
    other = bq.batch(folder, store=store, **{**OPTIONS, "dictionary": "x, v, u"})
    assert other.done == 4
    assert "x**3" not in set(other.table().term)
    again = bq.batch(folder, store=store, **OPTIONS)
    assert again.done == 0
    np.testing.assert_array_equal(again.table().coef, found.table().coef)
    assert len(contents(store)) == 8


def test_options_tell_batches_apart(tmp_path):
    terms = tmp_path / "terms.txt"
    terms.write_text("x\nv\nu\n")
    given = {**OPTIONS, "dictionary": str(terms)}
    first = digest(given, "read")
    assert digest(dict(reversed(given.items())), "read") == first
    assert digest(given, "otherwise") != first
    assert digest({**given, "prior": bq.Prior(prior_inclusion=np.array([0.1, 0.1, 1.0]))}, "read") != first
    terms.write_text("x\nv\n")
    assert digest(given, "read") != first


KILLED = """
import sys
import bayeq as bq
options = {options!r}
print(bq.batch(sys.argv[1], store=sys.argv[2], jobs=int(sys.argv[3]), **options).done)
"""


def rows_in(path):
    try:
        return len(contents(path))
    except sqlite3.Error:  # not there yet, or just being written
        return 0


@pytest.mark.parametrize("jobs", [pytest.param("1", marks=pytest.mark.slow), "2"])
def test_killed_it_goes_on_where_it_was(days, tmp_path, found, jobs):
    store = tmp_path / "batch.db"
    program = KILLED.format(options=OPTIONS)
    process = subprocess.Popen([sys.executable, "-c", program, str(days), str(store), jobs])
    while process.poll() is None and rows_in(store) < 1:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = rows_in(store)
    assert 1 <= kept <= 4
    rest = bq.batch(days, store=store, **OPTIONS)
    assert rest.done == 4 - kept
    pd.testing.assert_frame_equal(rest.table(), found.table())
    assert len(contents(store)) == 4


# What cannot be used


def test_a_bad_file_does_not_stop_the_others(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (folder / "day9.csv").write_text("t,x\n0,1\n1,one\n")
    (folder / "notes.md").write_text("not a record")
    assert main(["batch", "days", "absent.csv", *WORDS, "--json"]) == 1
    out, err = capsys.readouterr()
    answer = json.loads(out)
    assert [one["status"] for one in answer["files"]] == ["ok", "refused", "ok", "ok", "refused"]
    assert set(answer) == {"version", "store", "done", "files", "common", "table"}
    assert set(answer["files"][0]["equations"]) == {"a"}
    assert {row["file"] for row in answer["table"]} == {"days/day8.csv", "days/day10.csv", "days/day11.csv"}
    assert "bayeq: refused: days/day9.csv: " in err
    assert err.splitlines()[-1] == "bayeq: error: 2 of 5 files could not be used; the others are done"
    assert "bayeq: refused: absent.csv: No such file or directory" in err
    # one that is refused is tried again, and mended it is done
    shutil.copy(folder / "day8.csv", folder / "day9.csv")
    assert main(["batch", "days", *WORDS, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 1


def test_names_of_bytes_that_are_no_characters(folder, tmp_path):
    odd = os.fsdecode(os.fsencode(folder) + b"/day\xff.csv")
    shutil.move(folder / "day9.csv", odd)
    store = tmp_path / "batch.db"
    assert [one.status for one in bq.batch(folder, store=store, **OPTIONS)] == ["ok"] * 4
    assert bq.batch(odd, store=store, **OPTIONS).done == 0


def test_no_file_that_can_be_used(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    assert main(["batch", "a.csv", "b.csv", *WORDS, "--figure", "drift.png"]) == 2
    assert "none of the 2 files could be used" in capsys.readouterr().err
    assert not (tmp_path / "drift.png").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([*WORDS, "--table", "drift.png"], "end it in .csv"),
        ([*WORDS, "--figure", "drift.csv"], "to be written as a figure: end it in .png"),
        ([*WORDS, "--store", "nowhere/batch.db"], "no directory"),
        ([*WORDS, "--store", "run.csv"], "is a file that is read"),
        ([*WORDS, "--jobs", "0"], "jobs is a number of processes"),
        ([*WORDS, "--dictionary", "sine(x)"], "more than once"),
        (["--chain", "x:x"], "x"),
        (["-", *WORDS], "write standard input to one"),
        (["run.csv", *WORDS], "named twice"),
        ([*WORDS, "--common", "--differs", "x"], "compare the files with bayeq discover FILES --differs"),
        (["empty", *WORDS], "no file of a known format"),
    ],
)
def test_arguments_that_are_wrong(words, message, days, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copy(days / "day8.csv", tmp_path / "run.csv")
    (tmp_path / "empty").mkdir()
    assert main(["batch", "run.csv", *words]) == 2
    err = capsys.readouterr().err
    assert err.startswith("bayeq: error: ")
    assert err.count("\n") == 1
    assert message in err
    assert not (tmp_path / "batch.db").exists() or message == "no file of a known format"


def test_options_that_are_wrong(days, tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean 'displacement'"):
        bq.batch(days, store=tmp_path / "a.db", displacment="x")
    with pytest.raises(InputError, match="batch takes no client"):
        bq.batch(days, store=tmp_path / "a.db", client=1, **OPTIONS)
    with pytest.raises(InputError, match="no files are given"):
        bq.batch([], store=tmp_path / "a.db", **OPTIONS)
    other = tmp_path / "other.db"
    with closing(sqlite3.connect(other)) as connection, connection:
        connection.execute("CREATE TABLE t (a)")
    connection.close()
    with pytest.raises(FileFormatError, match="is not a store of batches"):
        bq.batch(days, store=other, **OPTIONS)


def test_what_is_no_error_of_ours_is_kept_too(days, tmp_path, monkeypatch):
    def broken(*arguments, **options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("bayeq.batches.run.discover", broken)
    found = bq.batch(days / "day8.csv", store=tmp_path / "a.db", **OPTIONS)
    assert found[0].status == "failed"
    assert found[0].message.endswith("day8.csv: ZeroDivisionError: division by zero")
    with pytest.raises(InputError, match="has no equations"):
        _ = found[0].equations
    assert len(found.table()) == 0
    with pytest.raises(InputError, match="nothing to draw"):
        found.plot()


def test_an_interrupted_command_says_how_to_go_on(days, tmp_path, capsys, monkeypatch):
    def stopped(paths, options, read, store, jobs, common, progress):
        progress("files", 0, 20)
        progress("files", 7, 20)
        raise KeyboardInterrupt

    monkeypatch.setattr("bayeq.batches.run.run_batch", stopped)
    assert main(["batch", str(days), *WORDS, "--store", str(tmp_path / "batch.db")]) == 130
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "7 files were added" in err
    assert "the same command continues" in err


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_a_stop_keeps_what_is_done(days, tmp_path, capsys, jobs):
    store = tmp_path / "batch.db"
    command = [sys.executable, "-m", "bayeq", "batch", str(days), *WORDS, "--store", str(store), "--jobs", jobs]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and rows_in(store) < 1:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    kept = rows_in(store)
    if process.returncode == 0:  # it was too late
        assert kept == 4
    else:
        assert process.returncode == 130
        assert err.splitlines()[-1].startswith(f"bayeq: interrupted: {kept} files were added to {store}")
        assert "Traceback" not in err
    assert main([*command[3:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 4 - kept


def test_two_at_once_in_one_store(days, tmp_path, found):
    store = tmp_path / "batch.db"
    program = KILLED.format(options=OPTIONS)
    command = [sys.executable, "-c", program, str(days), str(store), "1"]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    assert sum(int(process.communicate()[0]) for process in both) == 4  # none twice
    again = bq.batch(days, store=store, **OPTIONS)
    assert again.done == 0
    pd.testing.assert_frame_equal(again.table(), found.table())
    assert len(contents(store)) == 4


# A common equation


def test_coefficients_of_a_common_equation(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (folder / "day12.csv").write_text("t,x\n0,1\n1,2\n")
    words = ["batch", "days", *WORDS, "--common", "--json"]
    assert main(words) == 1
    answer = json.loads(capsys.readouterr().out)
    terms = [term["name"] for term in answer["common"]["equations"][0]["terms"] if term["shown"]]
    table = pd.DataFrame(answer["table"])
    assert table.shown.all()
    named = table[table.term != "1"]
    assert (named.pip == 1.0).all()
    assert [list(own.term) for _, own in named.groupby("order")] == [terms] * 4
    # known terms, a flat prior: least squares
    record = bq.read(folder / "day9.csv")
    columns = {"x": record["x"], "v": record["v"], "x**3": record["x"] ** 3, "u": record["u"]}
    D = np.column_stack([*(columns[name] for name in terms), np.ones(record.n)])
    rows = slice(0, int(0.8 * record.n))
    expected = np.linalg.lstsq(D[rows], record["a"][rows], rcond=None)[0][:-1]
    np.testing.assert_allclose(named.query("order == 1").coef, expected, rtol=1e-3)
    stiffness = -named.query("term == 'x'").coef
    np.testing.assert_allclose(np.diff(stiffness), -50.0, atol=20.0)
    stiffness = answer["common"]["equations"][0]["terms"][0]
    assert (named.query("term == 'x'").common_coef == stiffness["shown_coef"]).all()
    # kept as well: nothing is done twice, the common equation neither
    with monkeypatch.context() as patch:
        patch.setattr("bayeq.batches.run.discover", None)
        (folder / "day12.csv").unlink()
        assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["table"] == answer["table"]


def test_a_batch_that_is_stopped_goes_on_with_the_common_equation_that_it_had(days, folder, tmp_path, monkeypatch):
    """No file is read for it again; a file that changes, or other options, ask for another one."""
    store, options = tmp_path / "batch.db", {**OPTIONS, "common": True}
    days, folder = ([where / f"day{k}.csv" for k in (8, 9)] for where in (days, folder))
    expected = bq.batch(days, store=tmp_path / "undisturbed.db", **options).table()

    def stopped(stage, done, total):
        if stage == "files" and done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bq.batch(days, store=store, progress=stopped, **options)
    kept = rows_in(store)
    asked = []

    def counted(source, **options):
        asked.append(source)
        return bq.discover(source, **options)

    monkeypatch.setattr("bayeq.batches.run.discover", counted)
    monkeypatch.setattr("bayeq.batches.run.as_records", None)
    rest = bq.batch(days, store=store, **options)
    assert [type(source) for source in asked] == [type(days[0])] * (2 - kept) == [type(days[0])] * rest.done
    pd.testing.assert_frame_equal(rest.table(), expected)
    monkeypatch.undo()
    monkeypatch.setattr("bayeq.batches.run.discover", counted)
    for changed in ({**options, "seed": 1}, {**options, "read": {"fs": 1000.0}}):
        asked.clear()
        bq.batch(days, store=store, **changed)
        assert isinstance(asked[0], list)
    day = folder[1]
    day.write_text("".join(day.read_text().splitlines(keepends=True)[:-1]))
    asked.clear()
    bq.batch(folder, store=store, **options)
    assert isinstance(asked[0], list)


def test_files_that_are_read_some_rows_at_a_time(days, tmp_path, capsys):
    files = [str(days / "day8.csv"), str(days / "day9.csv")]
    tables = []
    for way in ("--stream", "--no-stream"):
        words = ["batch", *files, *WORDS, "--common", way, "--json", "--store", str(tmp_path / "a.db")]
        assert main(words) == 0
        tables.append(pd.DataFrame(json.loads(capsys.readouterr().out)["table"]))
    streamed, whole = (table.query("term != '1'") for table in tables)
    np.testing.assert_allclose(streamed.coef, whole.coef, rtol=0.05)


def test_no_common_equation(tmp_path):
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r"none of the 1 files can be used; the first: .*no .* named 'v'"):
        bq.batch(tmp_path / "a.csv", store=tmp_path / "a.db", common=True, **OPTIONS)


# Files and figures


def test_arguments_of_reading_reach_the_files(days, tmp_path):
    record = bq.read(days / "day8.csv")
    in_mm = bq.Record({name: record[name] * (1e3 if name == "x" else 1.0) for name in record.names}, time=record.time)
    bq.write(in_mm, tmp_path / "mm.csv")
    table = bq.batch(
        tmp_path / "mm.csv", store=tmp_path / "a.db", read={"units": {"x": "mm", "v": "m/s", "a": "m/s^2"}}, **OPTIONS
    ).table()
    assert table.set_index("term").loc["x", "unit"] == "m/s^2/mm"
    mixed = bq.batch([days / "day8.csv", tmp_path / "mm.csv"], store=tmp_path / "b.db", **OPTIONS)
    assert "The units of u, v, x, x**3 differ over files" in str(mixed)
    assert "units differ" in mixed.plot().axes[0].get_ylabel()


def test_an_identity_is_that_of_the_content(tmp_path):
    path = tmp_path / "a"
    path.write_text("one")
    identity = Identity.of(path)
    assert identity.holds(path)
    os.utime(path, (1, 1))
    assert identity.holds(path)
    path.write_text("two")
    assert not identity.holds(path)
    path.unlink()
    assert not identity.holds(path)
    with pytest.raises(InputError, match="named twice"):
        files_of([path, tmp_path / "." / "a"])


def test_table_and_figure_are_written(days, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["batch", str(days), *WORDS, "--common", "--table", "drift.csv", "--figure"]
    assert main([*words, "drift.svg"]) == 0
    out = capsys.readouterr().out
    assert "4 files, 4 with equations" in out
    spread = {line.split()[0]: line.split()[-1] for line in out.splitlines() if line.count(".") > 3}
    assert float(spread["x"]) > 5.0  # no chance
    assert float(spread["u"]) < 3.0
    table = pd.read_csv("drift.csv")
    assert {"order", "file", "target", "term", "coef", "sd", "common_coef"} <= set(table.columns)
    first = (tmp_path / "drift.svg").read_bytes()
    assert main([*words, "again.svg"]) == 0
    assert (tmp_path / "again.svg").read_bytes() == first


def test_the_figure_has_a_panel_for_each_term(found):
    figure = found.plot()
    table = found.table()
    assert len(figure.axes) == table.term.nunique()
    drawn = figure.axes[0].lines[0]
    for line in figure.axes[0].lines:
        if len(line.get_xdata()):
            drawn = line
    own = table[(table.term == "x") & (table.verdict == table.verdict.iloc[-1])]
    assert set(drawn.get_ydata()) <= set(own.coef) | set(table[table.term == "x"].coef)
    labels = [text.get_text() for text in figure.axes[-1].get_xticklabels()]
    assert labels == ["day8", "day9", "day10", "day11"]


def test_most_terms_have_a_panel_and_the_rest_are_counted():
    rows = [
        {"order": k, "file": f"{k}.csv", "target": "a", "term": f"x**{j}", "coef": 1.0, "sd": 0.1, "ci_low": 0.8}
        | {
            "ci_high": 1.2,
            "pip": 1.0,
            "included": True,
            "shown": k == 0 or j < 12,
            "verdict": "found",
            "unit": "1/m^4/s^2",
        }
        for k in range(3)
        for j in range(1, 16)
    ]
    figure = draw_drift(pd.DataFrame(rows))
    assert len(figure.axes) == 12
    assert [text.get_text() for text in figure.texts] == [
        "3 more terms, each in at most 1 of the files, are in the table"
    ]


def test_constraints_on_terms_that_are_left_stay(days, tmp_path):
    known = ["u == 1", "v*abs(v) <= 0", "x <= 0"]
    options = {**OPTIONS, "dictionary": "x, v, x**3, u, v*abs(v)", "constraints": known}
    found = bq.batch(days / "day8.csv", store=tmp_path / "a.db", common=True, **options)
    assert found[0].status == "ok"
    assert found[0].equations.constraints == ("u == 1", "x <= 0")
    assert (found.table().query("term == 'u'").coef == 1.0).all()
    assert "v*abs(v)" not in set(found.table().term)


def test_coefficients_differ_between_the_records_of_a_file(days, tmp_path, capsys):
    parts = [pd.read_csv(days / f"day{k}.csv").assign(run=k) for k in (8, 11)]
    pd.concat(parts).to_csv(tmp_path / "two.csv", index=False)
    words = ["batch", str(tmp_path / "two.csv"), *WORDS, "--differs", "x", "--store", str(tmp_path / "a.db")]
    assert main([*words, "--group", "run", "--json"]) == 0
    (differs,) = [row for row in json.loads(capsys.readouterr().out)["table"] if row["term"] == "x*run2"]
    assert differs["coef"] == pytest.approx(150.0, abs=30.0)
    words[1] = str(days / "day8.csv")
    assert main(words) == 2
    assert "not 1; bayeq discover FILES --differs takes each file as one" in capsys.readouterr().err


def test_an_output_is_no_record(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "drift.csv").write_text("order,file\n")
    assert main(["batch", ".", *WORDS, "--table", "drift.csv"]) == 2
    assert "drift.csv: is a file that is read; name another file" in capsys.readouterr().err
