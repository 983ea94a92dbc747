"""Delimited text: every layout that is read, and the message for every fault."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayeq.errors import DataWarning, FileFormatError, InputError, MissingExtraError, RecordError, UnknownNameError
from bayeq.records import Record, join, read, write
from bayeq.records.columns import Headers
from bayeq.records.formats import parquet
from bayeq.records.formats.layout import sniff
from bayeq.records.formats.text import _Lines, read_columns
from tests.draws import draws

DATA = Path(os.environ.get("BAYEQ_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured records in {DATA}; set BAYEQ_DATA")


def put(tmp_path: Path, content: str | bytes, name: str = "run.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "content",
    [
        "t,x\n0,1.5\n1,-2e3\n",
        "t,x\r\n0,1.5\r\n1,-2e3\r\n",
        "t,x\r0,1.5\r1,-2e3",
        "\ufefft,x\n0,1.5\n1,-2e3",
        "t, x\n0, 1.5\n\n1, -2.0e+003\n\n",
        '"t","x"\n0,1.5\n"1","-2e3"\n',
        "t,x,\n0,1.5,\n1,-2e3,\n",
        "t,x\n0,1.5,\n1,-2e3,\n",
        "t,x,\n0,1.5\n1,-2e3\n",
        "t,x\n0,1.5\n1,-2.0D+03\n,\n,\n",
        "t;x\n0;1,5\n1;-2e3\n",
        "t;x\n0;1.5\n1;-2e3\n",
        "sep=;\nt;x\n0;1,5\n1;-2e3\n",
        "t\tx\n0\t1,5\n1\t-2e3\n",
        "t\tx\n0 \t 1.5\n1\t-2e3\n",
        "  t   x\n  0   1.5\n  1  -2e3\n",
        "t x\n0\t 1.5\n1  -2e3\n",
        "# t x\n0 1.5\n1 -2e3\n",
        "# a comment\n# t,x\n0,1.5\n1,-2e3\n",
        "% header below\nt,x\n% units follow\n0,1.5\n# gap\n1,-2e3\n",
        "t,x\n[s],(-)\n0,1.5\n1,-2e3\n",
    ],
)
def test_layouts(tmp_path: Path, content: str) -> None:
    rec = read(put(tmp_path, content))
    assert rec.names == ("x",)
    assert rec.time is not None
    assert rec.time.tolist() == [0.0, 1.0]
    assert rec["x"].tolist() == [1.5, -2000.0]
    assert rec.name == "run.csv"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    rec = read(put(tmp_path, "t,temp [°C]\n0,1\n1,2\n".encode(encoding)))
    assert rec.units == {"temp": "°C"}


def test_missing_cells(tmp_path: Path) -> None:
    rec = read(put(tmp_path, "t,x,v\n0,,NA\n1,nan,2\n2,null,-NaN\n3,#N/A,n/a\n4,1,\n"))
    assert np.isnan(rec["x"]).tolist() == [True, True, True, True, False]
    assert np.isnan(rec["v"]).tolist() == [True, False, True, True, True]


def test_a_gap_in_the_middle_keeps_its_row(tmp_path: Path) -> None:
    assert np.isnan(read(put(tmp_path, "a,b\n1,2\n,\n3,4\n,\n"), fs=1)["a"]).tolist() == [False, True, False]


def test_without_header(tmp_path: Path) -> None:
    path = put(tmp_path, "0,1,2,\n1,2,3,\n")
    assert read(path).names == ("c1", "c2", "c3")
    assert read(path).time is None
    assert read(path, names="t x v").names == ("x", "v")
    assert read(path, columns="c2").names == ("c2",)
    assert read(put(tmp_path, "x\n1\n2\n")).names == ("x",)
    assert read(put(tmp_path, "wheel speed [m/s]\n1\n2\n")).units == {"wheel_speed": "m/s"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "the file is empty"),
        ("\n \n", "the file is empty"),
        ("# a\n", "the file is empty but for comments"),
        ("t,x\n", "a header but no rows"),
        ("t,x\ns,m\n", "a header but no rows"),
        ("t,x\n0,1\n1,oops\n", "line 3, column 'x': 'oops' is not a number"),
        ("# c\n\nt,x\n0,1\n\n1,oops\n", "line 6, column 'x': 'oops' is not a number"),
        ("t,x\n0,1_0\n", "line 2, column 'x': '1_0' is not a number"),
        ("t,acc [g]\n0," + "z" * 99, r"column 'acc \[g\]': 'z{37}\.\.\.' is not a number"),
        ("1,x\n0,1\n", "line 1, column 'c2': 'x' is not a number; if the line is a header"),
        ("t,x\n0,1\n1\n", "line 3: 1 value where 2 are expected"),
        ("t,x\n0,1\n1,2,3\n", "line 3: 3 values where 2 are expected"),
        ("t,x\n0,1,2\n", "line 2: 3 values, but the header in line 1 names 2 columns"),
        ("t,x\n0,5,1,5\n", "if the comma is the decimal mark, write points"),
        ("t x\n0,5 1,5\n", "line 2, column 't': '0,5' is not a number; write the decimal mark as a point"),
        ("t;x\n0;1.234,5\n", "'1.234,5' is not a number; write the decimal mark as a point"),
        (b"\x00\x01\x02", "not a text file"),
        (b"t,x\n0,\x071\n", "not a text file"),
    ],
)
def test_faults(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(FileFormatError, match=message) as caught:
        read(put(tmp_path, content))
    assert "run.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_time(tmp_path: Path) -> None:
    path = put(tmp_path, "Time [ms],x,y\n0,5,1\n2,6,1\n")
    assert read(path).fs == pytest.approx(500.0)
    assert read(path, time="Time [ms]").names == ("x", "y")
    assert read(path, time="Time").units == {"t": "s"}
    assert read(path, time="x").names == ("Time", "y")
    assert read(path, fs=10).names == ("Time", "x", "y")
    assert read(path, units={"Time": "year", "x": "m"}).units == {"t": "year", "x": "m"}
    with pytest.raises(InputError, match="time and fs are both given"):
        read(path, time="Time", fs=10)
    with pytest.raises(RecordError, match=r"run.csv, column 'y': time must increase strictly.*row 2"):
        read(path, time="y")
    with pytest.raises(UnknownNameError, match=r"run.csv: no column named 'tme'; did you mean 'Time'"):
        read(path, time="tme")
    with pytest.raises(RecordError, match="no channels besides time"):
        read(put(tmp_path, "t\n0\n1\n"))


@pytest.mark.parametrize(
    ("foot", "said"),
    [
        ("Mean,2.5\nMax,9\n", "line 52: 2 lines begin with words ('Mean'): left out"),
        ("5", "line 52: 1 of 2 values, as where a file was cut off: left out"),
        ("2.45,4.5\n", "time goes back in row 51, the last: it is left out"),
    ],
)
def test_a_summary_and_a_line_that_is_cut_short_are_left_out(tmp_path: Path, foot: str, said: str) -> None:
    body = "t,x\n" + "".join(f"{k / 10},{k % 7}\n" for k in range(50))
    whole = read(put(tmp_path, body))
    with pytest.warns(DataWarning, match=re.escape(said)):
        record = read(put(tmp_path, body + foot))
    assert record.time.tolist() == whole.time.tolist()
    assert record["x"].tolist() == whole["x"].tolist()


@pytest.mark.parametrize("foot", ["5,oops\n", "5,1,2\n", "Mean,2\n5.1,3\n", "5\n5.1,3\n", "Mean,2\n" * 20])
def test_rows_above_a_fault_can_be_read(tmp_path: Path, foot: str) -> None:
    path = put(tmp_path, "t,x\n" + "".join(f"{k / 10},{k % 7}\n" for k in range(50)) + foot)
    with pytest.raises(FileFormatError, match="line 52"):
        read(path)
    assert read(path, rows=slice(10, 50))["x"].tolist() == [k % 7 for k in range(10, 50)]
    with pytest.raises(FileFormatError, match="line 52"):
        read(path, rows=slice(0, 51))


def test_columns_pass_over_text(tmp_path: Path) -> None:
    path = put(tmp_path, "t,x,label,date\n0,1,a,2024-01-01\n1,2,b,2024-01-01\n")
    with pytest.raises(FileFormatError, match="'a' is not a number; if the column is not needed"):
        read(path)
    assert read(path, columns=["x"]).names == ("x",)
    assert read(path, columns="b", names="t b c d").names == ("b",)


def test_group(tmp_path: Path) -> None:
    path = put(tmp_path, "trial,t,x [m]\n0,0,1\n0,1,2\n1,0,3\n1,1,4\n0,0,5\n")
    with pytest.raises(RecordError, match=r"from 1.0 to 0.0 in row 3; it restarts there.*--group"):
        read(path)
    trials = read(path, group="trial")
    assert [trial.name for trial in trials] == ["run.csv [trial 0]", "run.csv [trial 1]", "run.csv [trial 2]"]
    assert [trial["x"].tolist() for trial in trials] == [[1.0, 2.0], [3.0, 4.0], [5.0]]
    assert trials[0].names == ("x",)
    assert trials[0].units == {"x": "m"}
    assert len(read(path, group="trial", columns="x")) == 3
    by_rate = read(path, group="trial", fs=2)[1]
    assert by_rate.time is not None
    assert by_rate.time.tolist() == [0.0, 0.5]
    with pytest.raises(RecordError, match="in row 4"):
        read(put(tmp_path, "g,t,x\n0,0,1\n0,1,2\n1,5,3\n1,4,4\n"), group="g")


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "xlsx", "parquet"])
def test_a_group_may_hold_words(suffix, tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip({"parquet": "pyarrow", "xlsx": "openpyxl"}.get(suffix, "numpy"))
    labels = ["R1"] * 4 + ["R2", "R2", "long run", "long run"]
    frame = pd.DataFrame({"t": [0.0, 1, 2, 3, 0, 1, 0, 1], "label": labels, "x": np.arange(8.0)})
    path = tmp_path / f"run.{suffix}"
    {"parquet": frame.to_parquet, "xlsx": frame.to_excel}.get(suffix, frame.to_csv)(path, index=False)
    trials = read(path, group="label")
    assert [list(trial.channels) for trial in trials] == [["x"]] * 3
    assert [trial["x"].tolist() for trial in trials] == [[0, 1, 2, 3], [4, 5], [6, 7]]
    frame.loc[5, "label"] = None
    if suffix == "csv":
        frame.to_csv(path, index=False)
        with pytest.raises(RecordError, match="the group is missing"):
            read(path, group="label")
    with pytest.raises(FileFormatError, match="line 3, column 'g': 'l' is not a number"):  # for a 1
        read(put(tmp_path, "g,x\n1,0\nl,1\n2,2\n"), group="g", fs=1)


def test_suffixes(tmp_path: Path) -> None:
    assert read(put(tmp_path, "1 2\n", "run.asc")).names == ("c1", "c2")
    with pytest.raises(FileFormatError, match=r"no format for the suffix '.bin', and not text; known: .csv"):
        read(put(tmp_path, b"\x00", "run.bin"))
    with pytest.raises(FileFormatError, match=r"no format for the suffix '.xyz' is written; written are: .csv"):
        write(Record.from_arrays(x=[1.0]), tmp_path / "run.xyz")
    with pytest.raises(FileFormatError, match="there is no directory"):
        read(tmp_path / "nowhere" / "run.csv")


cells = st.one_of(st.floats().map(repr), st.integers(-(10**20), 10**20).map(str), st.sampled_from(["1.", ".5", "inf"]))


@settings(max_examples=draws(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(cells, cells, cells), min_size=1, max_size=8), st.sampled_from([",", ";", "\t", " "]))
def test_both_paths_agree(tmp_path: Path, rows: list[tuple[str, str, str]], mark: str) -> None:
    """NumPy's reader and the thorough one give the same numbers, bit by bit."""
    path = put(tmp_path, f"a{mark}b{mark}c\n" + "".join(mark.join(row) + "\n" for row in rows))
    fast = read(path)
    slow = _Lines(path, sniff(path, "utf-8"), Headers.parse("abc"), ()).read()
    for column, name in enumerate("abc"):
        assert np.array_equal(fast[name], slow[:, column], equal_nan=True)
        assert np.array_equal(np.signbit(fast[name]), np.signbit(slow[:, column]))


@pytest.mark.parametrize("blank", ["\x85", "\u3000\n", "\xa0\n\x1a", "\t \v\n"])
def test_white_space_of_any_script_is_blank(tmp_path: Path, blank: str) -> None:
    with pytest.raises(FileFormatError, match="the file is empty"):
        read(put(tmp_path, blank))
    assert read(put(tmp_path, f"{blank}\nx,y\n1,2\n{blank}\n3,4\n{blank}"))["x"].tolist() == [1.0, 3.0]


printable = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=60)
tabular = st.text(st.sampled_from("0123456789.,;-+eEdDx#%\"'[]() \t\n\r"), max_size=80)


@settings(max_examples=draws(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(printable, tabular))
def test_any_text_is_read_or_refused_in_one_line(tmp_path: Path, content: str) -> None:
    try:
        read(put(tmp_path, content))
    except InputError as error:
        message = str(error)
    else:
        message = ""
    assert "\n" not in message


def test_formats_by_hand(tmp_path: Path) -> None:
    np.savez(tmp_path / "o.npz", x=np.array([{}], dtype=object))
    with pytest.raises(FileFormatError, match="holds pickled objects, which are refused"):
        read(tmp_path / "o.npz")
    np.savez(tmp_path / "m.npz", t=np.arange(3), x=np.zeros((3, 1)), fs=10, i=np.arange(3))
    assert read(tmp_path / "m.npz").names == ("x", "i")
    np.savez(tmp_path / "u.npz", x=np.arange(3), y=np.arange(2))
    with pytest.raises(FileFormatError, match=r"unequal lengths: x \(3,\), y \(2,\)"):
        read(tmp_path / "u.npz")
    np.savez(tmp_path / "d.npz", x=np.zeros((3, 2)))
    with pytest.raises(FileFormatError, match=r"column 'x' has shape \(3, 2\)"):
        read(tmp_path / "d.npz")
    with (tmp_path / "a.npz").open("wb") as file:
        np.save(file, np.arange(3))
    assert read(tmp_path / "a.npz").names == ("c1",)  # its content tells


def test_parquet_types(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    table = pa.table(
        {
            "time": pa.array([0, 1_500_000], pa.timestamp("us")),
            "i": pa.array([1, None], pa.int32()),
            "f": pa.array([None, 1.5], pa.float32()),
            "b": pa.array([True, False]),
            "label": ["a", None],
        }
    )
    pq.write_table(table, tmp_path / "r.parquet")
    with pytest.raises(FileFormatError, match="column 'label' does not hold numbers"):
        read(tmp_path / "r.parquet")
    rec = read(tmp_path / "r.parquet", columns="i,f,b")
    assert rec.time is not None
    assert rec.time.tolist() == [0.0, 1.5]
    assert rec["b"].tolist() == [1.0, 0.0]
    assert np.isnan([rec["i"][1], rec["f"][0]]).all()


def test_parquet_names_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'bayeq\[parquet\]'"):
        parquet.read_columns(tmp_path / "r.parquet")


def test_import_is_light() -> None:
    code = "import sys, bayeq.records; print([m for m in ('pandas', 'pyarrow', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_columns_of_the_same_name_are_named(tmp_path: Path) -> None:
    path = put(tmp_path, "t,x [m],v,x,V-1,V_1\n0,1,2,3,4,5\n1,2,3,4,5,6\n")
    with pytest.warns(DataWarning) as given:
        rec = read(path)
    assert rec.names == ("x", "v", "x_2", "V_1", "V_1_2")
    assert [str(w.message) for w in given] == [
        f"{path}: columns 2 and 4 have the same name: they are read as x, x_2; rename them",
        f"{path}: columns 5 and 6 have the same name: they are read as V_1, V_1_2; rename them",
    ]
    assert given[0].filename == __file__
    with pytest.warns(DataWarning, match="columns 2 and 4"):
        assert read(path, columns=["x", "v"]).names == ("x", "v")
    # nothing is in doubt where neither is used
    assert read(path, columns="v").names == ("v",)
    with pytest.warns(DataWarning, match="data frame: columns 1 and 2 have"):
        Record.from_dataframe(pd.DataFrame([[1.0, 2.0]], columns=["x", "x"]))


@needs_data
@pytest.mark.data
def test_measured_records() -> None:
    folder = DATA / "schmidt_lipson"
    rec = read(folder / "real_linear_a_1.txt")
    assert rec.names == ("trial", "x", "a", "v")
    assert (rec.n, rec["x"][0]) == (870, -102.0)
    assert rec.time is not None
    assert rec.time[0] == 0.033
    names = "trial t o1 o2 w1 w2 w1 w2 a1 a2"
    with pytest.warns(DataWarning, match="columns 5 and 7 .*as w1, w1_2|columns 6 and 8 .*as w2, w2_2"):
        trials = read(folder / "real_double_pend_h_1.txt", names=names, group="trial")
    assert [trial.n for trial in trials] == [819, 701]
    assert trials[0].names == ("o1", "o2", "w1", "w2", "w1_2", "w2_2", "a1", "a2")
    tanks = read(DATA / "cascaded_tanks" / "dataBenchmark.csv", fs=0.25)
    assert tanks.n == 1024
    assert tanks.names == ("uEst", "uVal", "yEst", "yVal", "Ts")
    hares = read(DATA / "lynx_hare" / "hudson-bay-lynx-hare.csv", time="Year", units={"Year": "year"})
    assert (hares.n, hares.names, hares.dt) == (21, ("Lynx", "Hare"), 1.0)


def test_an_increment_with_an_exponent_of_fortran_is_read(tmp_path: Path) -> None:
    rows = "\n".join(f"{k},{k / 10}" for k in range(6))
    path = put(tmp_path, f"X,CH1,Start,Increment\nSequence,Volt,0.0,2.0d-03\n{rows}\n")
    rec = read(path)
    assert rec.dt == pytest.approx(2e-3)


def test_a_comment_names_trial_and_time_only_of_columns_that_are_there(tmp_path: Path) -> None:
    path = put(tmp_path, "%DI-x [m,v\n0,1,\n,1,\n")
    found = read_columns(path)
    assert len(found.names) == len(found.values) == 2


def test_files_with_dates_are_joined_by_their_clocks(tmp_path):
    def written(name, channel, first, n=40):
        rows = [f"02/05/2024 10:00:{(first + k) / 10:09.6f},{first + k}\n" for k in range(n)]
        path = tmp_path / name
        path.write_text(f"Time,{channel}\n" + "".join(rows))
        return read(path)

    one, two = written("a.csv", "x", 0), written("b.csv", "F", 5)
    assert (one.time[0], two.time[0]) == (0.0, 0.0)
    joined = join(one, two.slice(3))
    np.testing.assert_allclose(joined["x"], joined["F"], atol=1e-5)
    assert joined.n == 32
    frames = [
        Record.from_dataframe(pd.DataFrame({"t": pd.to_datetime(1e9 * np.arange(k, k + 9), unit="ns"), name: range(9)}))
        for k, name in ((0, "x"), (2, "F"))
    ]
    np.testing.assert_array_equal(join(*frames)["F"], np.arange(7.0))
    stamps = [
        {"timestamp": 1.7e9 + np.arange(k, k + 9.0), name: np.arange(k, k + 9.0)} for k, name in ((0, "x"), (2, "F"))
    ]
    both = join(*(Record.from_dataframe(pd.DataFrame(one)) for one in stamps))
    np.testing.assert_allclose(both["x"], both["F"], atol=1e-5)


def test_files_are_joined_by_dates_of_whatever_kind(tmp_path):
    path = put(tmp_path, "Time,x\n" + "".join(f"2024-03-01 12:00:{k:02d},{k}\n" for k in range(9)))
    moments = pd.to_datetime("2024-03-01 12:00:02") + pd.to_timedelta(np.arange(9.0), unit="s")
    excel = 25569.0 + (moments - pd.Timestamp(0)) / pd.Timedelta(days=1)  # days since 1899-12-30
    for time in (moments, excel):
        other = Record.from_dataframe(pd.DataFrame({"Date": time, "F": np.arange(2.0, 11.0)}), time="Date")
        both = join(read(path), other)
        np.testing.assert_allclose(both["x"], both["F"], atol=1e-3)
        assert both.n >= 6  # days of Excel are rounded


@pytest.mark.parametrize("title", ["Test: cable mode 1\n", ""])
@pytest.mark.parametrize("units", ["Units: s, mm, g, N", '"Units: s, mm, g, N"', "Einheiten: s; mm; g; N"])
def test_a_line_of_units_above_the_names_is_read_where_it_fits(tmp_path, title, units):
    path = tmp_path / "run.csv"
    rows = "".join(f"{0.002 * k:.3f},{k % 7},{k % 5},{k % 3}\n" for k in range(20))
    path.write_text(f"{title}{units}\nTime,Laser,Acc,Load\n{rows}")
    rec = read(path)
    assert dict(rec.units) == {"t": "s", "Laser": "mm", "Acc": "g", "Load": "N"}
    assert rec.n == 20
    path.write_text(f"{title}Units: s, mm\nTime,Laser,Acc,Load\n{rows}")
    assert "Laser" not in read(path).units
