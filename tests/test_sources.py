"""Records from files of many arrays, from arrays and objects, and from two recorders; and the command on them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.options import named_channels
from bayeq.errors import FileFormatError, InputError, RecordError, UnknownNameError
from bayeq.records import Record, as_record, as_records, join, read
from bayeq.records.formats import FORMATS, protocol
from tests.data import measured
from tests.draws import draws

FS = 100.0
N = 200
T = np.arange(N) / FS


def put(tmp_path: Path, text: str, name: str = "run.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def cells(tmp_path: Path) -> Path:
    """A .mat file with nested cells, structs, and a time for each piece."""
    from scipy.io import savemat

    pieces, times, grid = np.empty((1, 3), object), np.empty((1, 3), object), np.empty((2, 2), object)
    for k in range(3):
        n = N - k
        pieces[0, k] = np.vstack([np.sin(T[:n] + k), np.cos(T[:n] + k)])
        times[0, k] = T[:n, None]
    for i in range(2):
        for j in range(2):
            grid[i, j] = np.full(N, 10.0 * i + j) + np.arange(N)
    inner = np.empty((1, 1), object)
    inner[0, 0] = pieces[0, 0]
    rec = {"acc": {"data": np.sin(T), "unit": "m/s^2"}, "force": {"data": np.cos(T), "unit": "N"}, "Fs": FS}
    path = tmp_path / "cells.mat"
    savemat(path, {"Y_id": pieces, "Time_id": times, "grid": grid, "deep": {"er": inner}, "rec": rec})
    return path


def test_paths_of_cells_structs_and_rows(cells: Path) -> None:
    one = read(cells, channels={"th": "Y_id[1].0", "om": "Y_id[1].1"}, time="Time_id[1]", units={"th": "rad"})
    assert isinstance(one, Record)
    assert (one.names, one.n, one.units["th"]) == (("th", "om"), N - 1, "rad")
    assert np.array_equal(one["th"], np.sin(T[: N - 1] + 1))
    assert one.fs == pytest.approx(FS)
    rec = read(cells, channels={"a": "rec.acc.data", "u": "rec.force.data"})
    assert isinstance(rec, Record)
    assert dict(rec.units) == {"a": "m/s^2", "u": "N"}
    assert rec.fs == pytest.approx(FS)  # by rec.Fs
    assert read(cells, columns=["grid[1,0]"])["grid_1_0"][0] == 10.0
    assert read(cells, columns=["deep.er[0].1"]).names == ("deep_er_0_1",)
    # the row that has no rate of its own is without time, and --fs gives one
    assert read(cells, channels={"g": "grid[0,1]"}, fs=10.0).fs == pytest.approx(10.0)


def test_a_star_is_several_records(cells: Path) -> None:
    records = read(cells, channels={"th": "Y_id[*].0", "om": "Y_id[*].1"}, time="Time_id[*]")
    assert [r.n for r in records] == [N, N - 1, N - 2]
    assert [r.name for r in records] == [f"cells.mat [{k}]" for k in range(3)]
    with pytest.raises(InputError, match="two stars"):
        read(cells, channels={"th": "Y_id[*].[*]"})
    with pytest.raises(UnknownNameError, match=r"no array named 'Z\[\*\]'"):
        read(cells, channels={"th": "Z[*]"})


def test_what_cannot_be_one_record_is_refused(cells: Path) -> None:
    with pytest.raises(FileFormatError, match=r"arrays of several lengths: .*name the channels to read"):
        read(cells)
    with pytest.raises(FileFormatError, match=r"channels of several lengths: Y_id\[0\].0 \(200\), Y_id\[1\].0 \(199\)"):
        read(cells, channels={"a": "Y_id[0].0", "b": "Y_id[1].0"}, time="Time_id[0]")
    with pytest.raises(UnknownNameError, match=r"no column named 'Y_id\[9\].0'; did you mean 'Y_id\[2\].0'"):
        read(cells, channels={"th": "Y_id[9].0"})
    with pytest.raises(RecordError, match="cannot name a channel in a term"):
        read(cells, channels={"2x": "Y_id[0].0"}, fs=1)


def test_structs_and_cells_of_v73_are_named_as_those_of_v5(tmp_path: Path) -> None:
    """An array of structs, with cells in a field, as MATLAB saves it with -v7.3 and with -v7."""
    h5py = pytest.importorskip("h5py")
    from scipy.io import savemat

    def as_class(dataset: Any, name: str) -> Any:
        dataset.attrs["MATLAB_class"] = np.bytes_(name)
        return dataset

    path = tmp_path / "new.mat"
    with h5py.File(path, "w") as file:
        kept, runs = file.create_group("#refs#"), as_class(file.create_group("runs"), "struct")
        x, y = [], []
        for k in range(2):
            x.append(as_class(kept.create_dataset(f"x{k}", data=T[None, :] + k), "double").ref)
            piece = as_class(kept.create_dataset(f"p{k}", data=np.column_stack([T, T + k])), "double").ref
            y.append(as_class(kept.create_dataset(f"y{k}", data=np.array([[piece]], h5py.ref_dtype)), "cell").ref)
        runs.create_dataset("x", data=np.array([x], h5py.ref_dtype).T)
        runs.create_dataset("y", data=np.array([y], h5py.ref_dtype).T)
        words = as_class(file.create_dataset("words", data=np.arange(N, dtype=np.uint32)[None, :]), "string")
        words.attrs["MATLAB_object_decode"] = 3
        file.create_group("sparse").attrs["MATLAB_sparse"] = N
    old = tmp_path / "old.mat"
    structs = np.zeros((1, 2), [("x", object), ("y", object)])
    for k in range(2):
        structs[0, k]["y"] = np.empty((1, 1), object)
        structs[0, k]["x"], structs[0, k]["y"][0, 0] = T[:, None] + k, np.vstack([T, T + k])
    savemat(old, {"runs": structs})
    for file_of in (path, old):
        records = read(file_of, channels={"x": "runs[*].x", "y": "runs[1].y[0].1"}, fs=FS)
        assert [record["x"][0] for record in records] == [0.0, 1.0]
        assert records[0]["y"][0] == 1.0
        assert read(file_of, fs=FS).names == tuple(
            f"runs_{k}_{name}" for k in (0, 1) for name in ("x", "y_0_0", "y_0_1")
        )


def test_channels_of_a_table_are_renamed(tmp_path: Path) -> None:
    path = put(tmp_path, "Zeit [s],Weg [mm],Kraft [N],Notiz\n0,1,2,a\n1,2,3,b\n2,3,4,c\n")
    rec = read(path, channels={"x": "Weg [mm]", "u": "Kraft"})
    assert isinstance(rec, Record)
    assert rec.names == ("x", "u")
    assert dict(rec.units) == {"t": "s", "x": "mm", "u": "N"}
    assert read(path, channels={"x": "Weg", "y": "Weg"}).names == ("x", "y")
    with pytest.raises(InputError, match="the file is one table"):
        read(path, channels={"x": "Weg[*]"})


@pytest.mark.parametrize(
    ("header", "cells", "step"),
    [
        ("Zeit [s],x", ("0,1", "0.5,2", "1,3"), 0.5),
        ("x,temps (ms)", ("1,0", "2,2", "3,4"), 2e-3),
        ("time_ms,x", ("0,1", "5,2", "10,3"), 5e-3),
        ("x,время", ("1,0", "2,1", "3,2"), 1.0),
        ("no,x [mm],stamp [ms]", ("1,5,0", "2,4,4", "3,6,8"), 4e-3),  # a time by its unit
        ("time,x", ("1700000000.0,1", "1700000000.5,2", "1700000001.0,3"), 0.5),
        ("time,x", ("1700000000000,1", "1700000000500,2", "1700000001000,3"), 0.5),
        ("timestamp,x", ("2024-03-01T12:00:00Z,1", "2024-03-01T12:00:00.250Z,2", "2024-03-01T12:00:00.500Z,3"), 0.25),
        ("Clock,x", ("12:00:00.1,1", "12:00:00.3,2", "12:00:00.5,3"), 0.2),
        ("x,Ts", ("1,4", "2,", "3,"), 4.0),
        ("No,x,index", ("1,1,1", "2,5,2", "3,3,3"), None),  # row counters are no time
        ("x [s]", ("1", "2", "3"), None),  # the only channel is no time
    ],
)
def test_which_column_is_time(tmp_path: Path, header: str, cells: tuple[str, ...], step: float | None) -> None:
    rec = read(put(tmp_path, "\n".join([header, *cells]) + "\n"))
    assert rec.dt == (None if step is None else pytest.approx(step))
    if step is not None and "T" not in header:
        assert rec.time is not None
        assert rec.time[0] == 0.0


def test_a_rate_that_contradicts_the_file_is_refused(tmp_path: Path) -> None:
    path = put(tmp_path, "Title\nSample rate: 100 Hz\nShaker run\nx,u\n1,2\n2,3\n3,4\n")
    assert read(path).fs == pytest.approx(100.0)
    assert read(path, fs=100).fs == pytest.approx(100.0)
    with pytest.raises(RecordError, match="fs 50 contradicts the file, whose sampling rate is 100 Hz"):
        read(path, fs=50)


def test_faults_below_a_preamble_keep_their_place(tmp_path: Path) -> None:
    text = "Title\nOperator: A\nt,x\n0,1\n1,2\n2,3\n3,oops\n"
    with pytest.raises(FileFormatError, match="line 7, column 'x': 'oops' is not a number"):
        read(put(tmp_path, text))
    with pytest.raises(FileFormatError, match="line 5, column 'when': 'later' is not a time stamp"):
        read(put(tmp_path, "when,x\n12:00:00,1\n12:00:01,2\n12:00:02,3\nlater,4\n"))


words = st.sampled_from(["oops", "run 7", "", "NA", "5", "a,b", "1,2,3"])


@settings(max_examples=draws(150), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    width=st.integers(2, 4), count=st.integers(3, 8), header=st.booleans(), faults=st.lists(
        st.tuples(st.integers(0, 7), words), max_size=2, unique_by=lambda fault: fault[0]
    ),
)  # fmt: skip
@example(width=2, count=5, header=False, faults=[(0, "oops"), (1, "a,b")])
@example(width=2, count=5, header=False, faults=[(0, "a,b"), (1, "a,b")])
@example(width=2, count=5, header=True, faults=[(0, "a,b"), (1, "a,b")])
def test_no_row_is_lost_to_a_preamble(
    tmp_path: Path, width: int, count: int, header: bool, faults: list[tuple[int, str]]
) -> None:
    """Faulty rows below a header are refused or kept; they are never taken for a preamble."""
    rows = [[f"{k + 0.5}"] * width for k in range(count)]
    for row, word in faults:
        if row < count:
            rows[row][-1] = word
    names = [["t", "x", "y", "z"][:width]] if header else []
    path = put(tmp_path, "\n".join(",".join(cells) for cells in [*names, *rows]) + "\n")
    try:
        record = read(path)
    except InputError:
        return
    assert record.n == count


class Benchmark:
    """As the nonlinear benchmarks' Input_output_data."""

    def __init__(self, u: object, y: object, sampling_time: object, name: str = "bench") -> None:
        self.u, self.y, self.sampling_time, self.name = u, y, sampling_time, name

    def __len__(self) -> int:
        return 2

    def __getitem__(self, k: int) -> object:
        return (self.u, self.y)[k]


def test_sources(tmp_path: Path) -> None:
    path = put(tmp_path, "t,x [mm]\n0,1\n1,2\n2,3\n")
    assert as_record(path).units["x"] == as_record(str(path)).units["x"] == "mm"
    assert as_record(path, t="x").names == ("t",)
    frame = pd.DataFrame({"Zeit [s]": [0.0, 0.5, 1.0], "x": [1.0, 2.0, 4.0]})
    assert as_record(frame).dt == 0.5
    assert as_record({"x": T, "u": T}, t=T).fs == pytest.approx(FS)
    assert as_record({"time [ms]": [0, 1, 2], "x": [1, 2, 3]}).fs == pytest.approx(1000)
    assert as_record({"x": [1, 2, 3], "s": [0, 1, 2]}, t="s").names == ("x",)
    one = as_record(Benchmark(T, 2 * T, 0.01))
    assert (one.names, one.name) == (("u", "y"), "bench")
    assert one.fs == pytest.approx(100)
    two = as_record(Benchmark(T[:, None], np.column_stack([T, T]), None))
    assert (two.names, two.time) == (("u", "y1", "y2"), None)
    assert as_record(Benchmark(None, T, None), t=T).names == ("y",)
    assert len(as_records([frame, path, one])) == 3
    assert len(as_records(Benchmark(T, T, 1.0))) == 1  # a sequence of two, and yet one record


@pytest.mark.parametrize(
    ("source", "t", "message"),
    [
        (3.0, None, "no record can be made of float"),
        ([], None, "no Record is given"),
        ([1.0, 2.0], None, "no record can be made of float"),
        (Record({"x": T}), T, "a Record has its own time"),
        ("run.csv", T, "t names the column that is time"),
        ({1: T}, None, "needs text as keys"),
        ({"x": T}, T[:-1], "unequal lengths"),
        ({"x": ["a", "b"]}, None, "does not hold numbers"),
        (Benchmark(T, T, -1.0), None, "a positive number, not -1.0"),
        (Benchmark(T, T, 1.0), "t", "an array of sampling times"),
    ],
)
def test_sources_that_are_none(source: object, t: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        as_records(source, t)


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_discover_takes_a_path_a_frame_arrays_and_objects(tmp_path: Path) -> None:
    rec = bq.simulate("linear", n=400, seed=0)
    bq.write(rec, tmp_path / "run.csv")
    roles = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
    options = {**roles, "dictionary": "x, v, u", "smooth": "none"}
    arrays = dict(rec.channels)
    wanted = bq.discover(rec, **options)[0].coef
    for source, t in (
        (tmp_path / "run.csv", None),
        (str(tmp_path / "run.csv"), "t"),
        (rec.to_dataframe(), None),
        (arrays, rec.time),
    ):
        assert bq.discover(source, **options, t=t)[0].coef == pytest.approx(wanted)


def test_join_on_the_time_of_the_first() -> None:
    slow = Record({"x": np.sin(5 * T)}, T, {"x": "m"}, "a.csv")
    times = np.arange(0.103, 1.7, 0.01 / 3)
    fast = Record({"u": np.cos(4 * times)}, times, {"u": "N"}, "b.csv")
    both = join(slow, fast)
    assert (both.names, both.name, dict(both.units)) == (("x", "u"), "a.csv + b.csv", {"x": "m", "u": "N"})
    assert both.time is not None
    assert both.time[0] == pytest.approx(0.11)
    assert both.time[-1] == pytest.approx(1.69)
    assert np.allclose(both["u"], np.cos(4 * both.time), atol=1e-8)
    assert np.array_equal(both["x"], np.sin(5 * both.time))


@settings(max_examples=draws(25), deadline=None)
@given(shift=st.integers(-50, 50))
def test_samples_at_the_same_time_stay_as_they_are(shift: int) -> None:
    rng = np.random.default_rng(shift + 50)
    ticks = np.arange(N)
    a = Record({"x": rng.normal(size=N)}, ticks / 128)
    b = Record({"u": rng.normal(size=N)}, (ticks + shift) / 128)
    both = join(a, b)
    assert both.n == N - abs(shift)
    wanted = b["u"][: N - shift] if shift >= 0 else b["u"][-shift:]
    assert np.allclose(both["u"], wanted[: both.n], atol=1e-12)


def test_join_keeps_gaps_and_refuses_what_it_cannot_do() -> None:
    x = Record({"x": T}, T, name="x.csv")
    holes = np.where((T > 0.5) & (T < 0.6), np.nan, T)
    both = join(x, Record({"u": holes}, T + 0.001))
    assert both.time is not None
    missing = both.time[np.isnan(both["u"])]
    assert missing.min() == pytest.approx(0.51)
    assert missing.max() == pytest.approx(0.6)
    noise = np.random.default_rng(0).normal(size=8 * N)
    fast = np.arange(8 * N) / (8 * FS)
    for other, message in (
        (Record({"u": T}), "record has no time"),
        (Record({"u": T}, T + 10), r"without time in common: x.csv 0 to 1.99 s; record 10 to 11.99 s"),
        (Record({"x": T}, T), "channel 'x' is in another record too"),
        (Record({"u": T[::2]}, T[::2]), r"at 50 Hz, more slowly than x.csv at 100 Hz; put the slowest first"),
        (Record({"u": noise}, fast), r"of the variance of 'u' is above 50 Hz, .* would alias"),
    ):
        with pytest.raises(RecordError, match=message):
            join(x, other)


def test_names_of_options() -> None:
    options, paths = named_channels(
        {
            "displacement": "th=Y[0].0",
            "velocity": "om",
            "inputs": ("u=F[0]",),
            "chains": ("a=p.q[1]:~b:",),
            "force": None,
        }
    )
    assert options["displacement"] == "th"
    assert options["inputs"] == ["u"]
    assert options["chains"] == ["a:~b:"]
    assert paths == {"th": "Y[0].0", "om": "om", "u": "F[0]", "a": "p.q[1]"}
    assert named_channels({"displacement": "Y[0].0"}) == ({"displacement": "Y_0_0", "inputs": []}, {"Y_0_0": "Y[0].0"})
    assert named_channels({"displacement": "Displ. (m)"})[1] == {}
    for text, message in (("2x=Y[0]", "write name=path"), ("x=", "write name=path"), ("=Y", "write name=path")):
        with pytest.raises(InputError, match=message):
            named_channels({"displacement": text})
    with pytest.raises(InputError, match=r"the name 'x' is given to two channels, Y\.0 and Y\.1"):
        named_channels({"displacement": "x=Y.0", "velocity": "x=Y.1"})


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = main(["discover", *map(str, arguments)])
    out, err = capsys.readouterr()
    return code, out, err


FAST = ("--dictionary", "x, v, u", "--smooth", "none", "--json")


def test_the_command_on_a_nested_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scipy.io import savemat

    pieces = np.empty((1, 2), object)
    for k in range(2):
        rec = bq.simulate("linear", n=400, seed=k)  # of the same samples twice one would be left out
        pieces[0, k] = np.vstack([rec.time, *rec.channels.values()])
    path = tmp_path / "run.mat"
    savemat(path, {"Y": pieces, "other": np.arange(99.0)})
    roles = ("--disp", "x=Y[0].1", "--vel", "v=Y[0].2", "--acc", "a=Y[0].3", "--force", "u=Y[0].4")
    code, out, _ = run(capsys, path, *roles, "--time", "t=Y[0].0", *FAST)
    assert code == 0
    one = json.loads(out)
    assert one["data"]["n"] == 400
    assert {term["name"] for term in one["equations"][0]["terms"] if term["included"]} == {"x", "v", "u"}
    chain = ("--chain", "x=Y[*].1:v=Y[*].2:a=Y[*].3", "--input", "u=Y[*].4", "--time", "Y[*].0")
    code, out, _ = run(capsys, path, *chain, *FAST)
    assert code == 0
    assert json.loads(out)["data"]["n"] == 800
    code, _, err = run(capsys, path, "--disp", "x=Y[7].1", *FAST)
    assert code == 2
    assert err.count("\n") == 1
    assert "no column named 'Y[7].1'" in err


def test_a_rate_that_contradicts_time_is_refused_by_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "\n".join(f"{k},{k % 7},{k % 5}" for k in range(60))
    path = put(tmp_path, f"Zeit [ms],x,u\n{rows}\n")
    for disp in ("x", "q=x"):
        code, _, err = run(capsys, path, "--disp", disp, "--fs", 5, "--json")
        assert code == 2
        assert "--fs 5 contradicts" in err
    nothing = put(tmp_path, f"tempo [ms],x,u\n{rows.replace('59,', '3,')}\n", "still.csv")
    code, _, err = run(capsys, nothing, "--disp", "q=nothing", "--fs", 5)
    assert (code, "no column named 'nothing'" in err) == (2, True)


def test_the_command_joins_two_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rec = bq.simulate("linear", n=400, seed=0)
    parts = (("x", "v", "a"), ("u",))
    for names, file in zip(parts, ("motion.csv", "force.csv"), strict=True):
        bq.write(Record({name: rec[name] for name in names}, rec.time), tmp_path / file)
    roles = ("--disp", "x", "--vel", "v", "--acc", "a", "--force", "u")
    files = (tmp_path / "motion.csv", tmp_path / "force.csv")
    code, out, _ = run(capsys, *files, "--join", *roles, *FAST)
    assert code == 0
    assert json.loads(out)["data"]["file"] == "motion.csv + force.csv"
    code, _, err = run(capsys, files[0], "--join", *roles, *FAST)
    assert (code, "--join needs at least two files" in err) == (2, True)
    code, _, err = run(capsys, *files, "--join", "--disp", "x", "--vel", "v", "--acc", "a", *FAST)
    assert (code, "force.csv: none of the channels named is in it" in err) == (2, True)


@pytest.mark.data
def test_the_measured_pendulum() -> None:
    path = measured("multiarm_single_pendulum/SinglePendulumDataForParameterEstimation.mat")
    records = read(path, channels={"th": "Y_id[*].0", "om": "Y_id[*].1"}, time="Time_id[*]")
    assert [record.n for record in records] == [9167] * 4
    assert all(record.fs == pytest.approx(1000) for record in records)
    one = read(path, channels={"th": "Y_vad[1].0"}, time="Time_vad[1]")
    assert one.n == 9166


def test_the_page_lists_every_format() -> None:
    page = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
    for row in FORMATS:
        suffixes = " ".join(f"`{suffix}`" for suffix in row.suffixes)
        extra = f"`{row.extra}`" if row.extra else ""
        assert f"| {row.title} | {suffixes} | {'yes' if row.writer else 'no'} | {extra} | {row.keeps} |\n" in page
    assert f"{protocol.MOST_COLUMNS:,} columns" in page
    assert f"more than {protocol.MOST_RATIO} times" in page
    assert f"{protocol.MOST_BYTES // 2**30} GiB" in page


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(block, "files.md", "exec"), {})  # noqa: S102  # the page's own example
