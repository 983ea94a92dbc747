"""Records that are read some rows at a time: the same answer as in memory, and sums that survive."""

from __future__ import annotations

import json
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import bayeq as bq
from bayeq.cli.app import main
from bayeq.discovery.entry import extents_of
from bayeq.discovery.streaming.checkpoint import Checkpoint
from bayeq.discovery.streaming.work import (
    LAGS,
    Extent,
    Folded,
    Lagged,
    OfRows,
    by_threads,
    fold,
    fold_columns,
    stretches,
    units_of,
)
from bayeq.errors import FileFormatError, InputError, RecordError
from bayeq.expressions import parse
from bayeq.inference.gram import from_moments, grams_from_data
from bayeq.records.stream import RecordStream, open_streams, units_between
from bayeq.regression.residuals import inspect_residuals
from tests.draws import draws

OSCILLATOR = {"displacement": "x", "velocity": "v", "acceleration": "a", "force": "u"}
TERMS = [
    parse(text)
    for text in ("x", "v", "x**2*v", "sign(v)", "v*abs(x)", "exp(x)", "max(x, v)", "x/(1 + v**2)", "tanh(u)")
]


@pytest.fixture(scope="module")
def record():
    return bq.simulate("duffing", n=60_000, seed=3)


def divide(patch, rows_each, unit=7000):
    """Units and stretches of few rows, so that short files have several."""
    for module in ("parquet", "text"):
        patch.setattr(f"bayeq.records.formats.{module}.UNIT_ROWS", unit)
    patch.setattr("bayeq.records.formats.protocol.grid.__defaults__", (unit,))
    patch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", rows_each)


@pytest.fixture(autouse=True)
def small_units(monkeypatch):
    divide(monkeypatch, 300)


SEVERAL = {"dictionary": "x, v, x**2, x**3, u"}


@pytest.fixture(scope="module")
def streamed(record, tmp_path_factory):
    """What is found of the first 7,000 rows in a file, from stretches of 75."""
    with pytest.MonkeyPatch.context() as patch:
        divide(patch, 75, 3500)
        path = written(record.take(slice(0, 7000)), tmp_path_factory.mktemp("streamed") / "r.parquet")
        return quietly(path, stream=True, **SEVERAL)


def written(record, path):
    if path.suffix == ".npy":
        np.save(path, np.column_stack([record.time, *(record[name] for name in record.names)]))
    elif path.suffix == ".parquet":
        pa = pytest.importorskip("pyarrow", reason="needs the extra parquet")
        import pyarrow.parquet as pq

        table = pa.table({"t": record.time, **{name: record[name] for name in record.names}})
        pq.write_table(table, path, row_group_size=5000)
    else:
        bq.write(record, path)
    return path


# --- files -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["r.parquet", "r.csv", pytest.param("r.tsv", marks=pytest.mark.slow), "r.h5", "r.npy"])
def test_rows_of_a_file_are_those_that_reading_it_gives(name, record, tmp_path):
    path = written(record, tmp_path / name)
    whole = bq.read(path)
    (stream,) = open_streams([path])
    assert stream.bounds[0] == 0
    assert stream.bounds[-1] == record.n
    assert len(stream.bounds) > 5
    channels = list(whole.names)[-2:]
    for start, stop in ((0, 10), (6999, 7001), (12_345, 40_000), (59_999, 60_000)):
        part = stream.of(channels).read(start, stop)
        assert sorted(part.names) == sorted(channels)
        for channel in channels:
            np.testing.assert_array_equal(part[channel], whole[channel][start:stop])
        if whole.time is not None:
            np.testing.assert_array_equal(part.time, whole.time[start:stop])


def test_units_and_rates_come_with_the_rows(tmp_path):
    path = tmp_path / "r.csv"
    path.write_text("time [ms],x [mm]\n" + "".join(f"{k * 2},{k % 7}\n" for k in range(20_000)))
    (stream,) = open_streams([path])
    part = stream.read(9000, 9010)
    assert part.units["x"] == "mm"
    assert part.time[0] == 18.0
    (by_rate,) = open_streams([path], fs=500.0)
    assert by_rate.read(9000, 9010).time[0] == 18.0


@pytest.mark.parametrize("text", ["x,v\n1,2\n\n3,4\n", "x,v\r\n1,2\r\n3,4\r\n\r\n", "x,v\n1,2\n3,4"])
def test_lines_that_are_empty_are_no_rows(text, tmp_path):
    path = tmp_path / "r.csv"
    path.write_bytes(text.encode())
    (stream,) = open_streams([path])
    assert stream.bounds == (0, 2)
    np.testing.assert_array_equal(stream.read(0, 2)["v"], [2.0, 4.0])


def test_a_folder_is_its_files_in_the_order_of_their_numbers(record, tmp_path):
    for k in (10, 2, 1):
        written(record.take(slice(k * 100, k * 100 + 50)), tmp_path / f"part-{k}.csv")
    (tmp_path / "notes.doc").write_text("no record")
    assert [stream.name for stream in open_streams([tmp_path])] == ["part-1.csv", "part-2.csv", "part-10.csv"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "x,v\n1,2\n3,word\n", "word"),
        ("a.csv", "t,x\n2024-01-01 10:00:00,1\n2024-01-01 10:00:01,2\n", "dates"),
        ("a.wav", "RIFF....WAVE", "not read some rows at a time"),
        ("a.npy", "no array", "npy"),
        ("a.parquet", "PAR1 nothing", "Parquet"),
    ],
)
def test_a_file_that_cannot_be_streamed_says_why(name, text, message, tmp_path):
    (tmp_path / name).write_text(text)

    def read():
        (stream,) = open_streams([tmp_path / name])
        return stream.read(0, stream.bounds[-1])

    with pytest.raises(FileFormatError, match=message) as error:
        read()
    assert name in str(error.value)


def test_a_file_that_changes_while_it_is_read_is_refused(record, tmp_path):
    path = written(record, tmp_path / "r.csv")
    (stream,) = open_streams([path])
    assert stream.bounds[-1] == record.n
    written(record.take(slice(0, 500)), path)
    with pytest.raises(FileFormatError, match="changed"):
        stream.read(0, 100)


# --- sums ------------------------------------------------------------------------------------------------------------


@settings(max_examples=draws(25), deadline=None)
@given(st.integers(1, 9000), st.integers(0, 10**6), st.sampled_from([1e-6, 1.0, 1e8]))
def test_moments_of_blocks_are_those_of_all_rows(n, seed, offset):
    rng = np.random.default_rng(seed)
    columns = {name: rng.normal(size=n) for name in "xvu"}
    columns["a"] = offset + columns["x"]
    found = fold_columns(TERMS, columns, ["a"]).moments
    from bayeq.dictionary import evaluate_terms

    slow = grams_from_data(evaluate_terms(TERMS, columns), columns["a"][:, None])[0]
    fast = from_moments(found, slow.names, 1)[0]
    scale = np.sqrt(np.outer(slow.diagonal, slow.diagonal)) + 1e-300
    np.testing.assert_allclose(fast.DtD / scale, slow.DtD / scale, atol=1e-11)
    np.testing.assert_allclose(fast.mean, slow.mean, rtol=1e-11, atol=1e-13)
    # the target's offset leaves that many digits of its products
    np.testing.assert_allclose(fast.Dty, slow.Dty, atol=1e-11 * n * max(1.0, offset * 1e-5))


def test_values_without_a_square_are_counted_and_taken_as_zero():
    columns = {"x": np.array([1.0, 1e200, 3.0, -2.0]), "a": np.array([1.0, 2.0, 3.0, 4.0])}
    found = fold_columns([parse("x"), parse("1/(x - 3)")], columns, ["a"])
    assert found.bad.tolist() == [1, 1]
    assert found.moments.mean[0] == pytest.approx(0.5)


@settings(max_examples=draws(20), deadline=None)
@given(st.lists(st.integers(1, 9000), min_size=1, max_size=5), st.integers(0, 10**6))
def test_autocorrelation_of_units_is_that_of_all_rows(lengths, seed):
    rng = np.random.default_rng(seed)
    e = np.convolve(rng.normal(size=sum(lengths)), [0.5, 0.3, 0.2])[: sum(lengths)]
    parts = np.split(e, np.cumsum(lengths)[:-1])
    total = Lagged.of(parts[0], 0)
    for part in parts[1:]:
        total = total + Lagged.of(part, 0)
    direct = np.array([e[k:] @ e[: len(e) - k] for k in (0, 1, 5, 100) if k < len(e)])
    lags = [k for k in (0, 1, 5, 100) if k < len(e)]
    np.testing.assert_allclose(total.products[lags], direct, atol=1e-9 * len(e))
    assert total.n == len(e)
    assert len(total.products) == LAGS


@settings(max_examples=draws(50), deadline=None)
@given(st.integers(1, 100), st.integers(1, 40), st.data())
def test_units_cover_every_row_once(n, unit, data):
    start = data.draw(st.integers(0, n))
    stop = data.draw(st.integers(start, n))
    bounds = (*range(0, n, unit), n)
    rows = [row for a, b in units_between(bounds, start, stop) for row in range(a, b)]
    assert rows == list(range(start, stop))


# --- the answer ------------------------------------------------------------------------------------------------------


def quietly(*args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return bq.discover(*args, **OSCILLATOR, **options)


def compare(found, expected, rtol, pip=1e-5):
    a, b = found.table(), expected.table()
    assert a.term.tolist() == b.term.tolist()
    assert a.included.tolist() == b.included.tolist()
    np.testing.assert_allclose(a.coef, b.coef, rtol=rtol)
    np.testing.assert_allclose(a.sd, b.sd, rtol=rtol)
    np.testing.assert_allclose(a.pip, b.pip, atol=pip)


# that other files have the same rows: above
@pytest.mark.parametrize(
    "name", ["r.parquet", *(pytest.param(name, marks=pytest.mark.slow) for name in ("r.csv", "r.h5"))]
)
def test_without_smoothing_the_answer_is_that_in_memory(name, record, tmp_path):
    path = written(record.take(slice(0, 24_000)), tmp_path / name)
    found, expected = quietly(path, smooth="none", stream=True), quietly(path, smooth="none", stream=False)
    compare(found, expected, rtol=1e-8)
    assert found[0].train.n == expected[0].train.n == 19_200
    assert found[0].held_out.r2 == pytest.approx(expected[0].held_out.r2, abs=1e-10)
    assert (found.data.n, found.data.stretches) == (24_000, 20)


def test_derivatives_by_differences_do_not_see_where_units_meet(record, tmp_path):
    path = written(record.take(slice(0, 24_000)), tmp_path / "r.parquet")
    options = {"chains": "x:v:", "inputs": ["u"], "dictionary": ["x", "v", "x**3", "u"], "smooth": "none"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, expected = (bq.discover(path, **options, stream=stream) for stream in (True, False))
    compare(found, expected, rtol=1e-6)


def test_correlated_residuals_count_as_in_memory(tmp_path):
    rng = np.random.default_rng(0)
    n = 24_000
    x, v = rng.normal(size=(2, n))
    noise = np.convolve(rng.normal(size=n), np.full(20, 1.0 / 20.0))[:n]
    rec = bq.Record({"x": x, "v": v, "u": rng.normal(size=n), "a": -3.0 * x - 0.1 * v + noise}, np.arange(n) / 100.0)
    path = written(rec, tmp_path / "r.parquet")
    found, expected = quietly(path, smooth="none", stream=True), quietly(path, smooth="none", stream=False)
    assert inspect_residuals([noise]).correlated
    compare(found, expected, rtol=1e-7)


def test_the_likelihood_of_all_rows_is_that_in_memory(record, streamed):
    record = record.take(slice(0, 7000))
    found, expected = streamed, quietly(record, **SEVERAL)
    assert found[0].included == expected[0].included == ("x", "v", "x**3", "u")
    for name in found[0].included:
        sd = expected.table().set_index("term").sd[name]
        # units of 5,000 and 2,000 rows, of whose first states nothing is known, leave out some of what the record tells
        assert abs(found[0].coef[name] - expected[0].coef[name]) < 0.35 * sd
    assert found.data.n == record.n
    assert found.verdict.kind == expected.verdict.kind == "found"


def test_bad_samples_outside_of_the_stretches_are_counted(record, streamed, tmp_path, monkeypatch):
    divide(monkeypatch, 75, 3500)
    record = record.take(slice(0, 7000))
    x, u = np.array(record["x"]), np.array(record["u"])
    # 20 stretches of 75 rows begin every 364.5 rows
    x[[200, 600, 2500]] += 20.0 * x.std()
    u[[1350, 1351]] = np.nan
    path = written(record.with_channels({"x": x, "u": u}), tmp_path / "r.parquet")
    found = quietly(path, stream=True, **SEVERAL)
    assert found[0].included == ("x", "v", "x**3", "u")
    said = [line for line in found.warnings if "all 7,000 rows" in line]
    assert said == [
        "of all 7,000 rows these samples are missing: 2 of u; check the sensors",
        "of all 7,000 rows these samples were left out as bad: 3 of x; check the sensors",
    ]
    assert not any("all 7,000 rows" in line for line in streamed.warnings)
    for name in found[0].included:
        sd = streamed.table().set_index("term").sd[name]
        assert abs(found[0].coef[name] - streamed[0].coef[name]) < 0.1 * sd


def test_any_number_of_threads_gives_the_same_bytes(record):
    extents = (Extent(RecordStream(record), 0, record.n),)
    from bayeq.discovery.streaming.work import AsMeasured
    from bayeq.states import Roles

    work = AsMeasured(extents, Roles.parse(**OSCILLATOR), tuple(TERMS), 0.2)
    sums = [fold(work, units_of(extents), partial(by_threads, workers=k), lambda *_: None, "rows") for k in (1, 2, 5)]
    for other in sums[1:]:
        assert other.train.moments.cross.tobytes() == sums[0].train.moments.cross.tobytes()


def test_stretches_are_spread_over_all_rows(record, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", 2500)
    found = stretches([Extent(RecordStream(record), 0, 60_000), Extent(RecordStream(record), 0, 2000)])
    assert sum(one.n for one in found) <= 55_000
    assert found[0].time[0] == record.time[0]
    assert found[-2].time[-1] == record.time[-1]
    assert found[-1].n == 2000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dictionary": "x, v, sin(t)"}, "time"),
        ({"band": (0.5, 40)}, "in no band"),
        ({"tails": "student"}, "tails"),
    ],
)
def test_what_takes_whole_records_is_refused(options, message, record, tmp_path):
    path = written(record, tmp_path / "r.npz")
    path = written(record, tmp_path / "r.h5")
    with pytest.raises(InputError, match=message):
        quietly(path, stream=True, **options)


def test_time_that_goes_back_between_units_is_refused(record, tmp_path):
    time = np.asarray(record.time).copy()
    time[7000:] -= 3.0
    (tmp_path / "r.csv").write_text("")
    pa = pytest.importorskip("pyarrow", reason="needs the extra parquet")
    import pyarrow.parquet as pq

    table = pa.table({"t": time, **{name: record[name] for name in record.names}})
    pq.write_table(table, tmp_path / "r.parquet", row_group_size=7000)
    with pytest.raises(RecordError, match=r"t.*from 6.999"):
        quietly(tmp_path / "r.parquet", stream=True, smooth="none")


def test_times_are_compared_where_units_meet():
    nothing = Folded(None, np.zeros(1, dtype=np.int64))
    first = OfRows(nothing, nothing, 0, 0.0, 6.9)
    assert (first + OfRows(nothing, nothing, 0, 7.0, 8.0)).last == 8.0
    assert (first + OfRows(nothing, nothing, 1, 0.0, 8.0)).last == 8.0
    with pytest.raises(RecordError, match=r"record 1: time goes back from 6.9 to 6.8 s"):
        _ = first + OfRows(nothing, nothing, 0, 6.8, 8.0)


def test_missing_samples_are_an_error_without_smoothing(record, tmp_path):
    x = np.asarray(record["x"]).copy()
    x[33_333] = np.nan
    rec = bq.Record({**record.channels, "x": x}, record.time)
    path = written(rec, tmp_path / "r.csv")
    with pytest.raises(RecordError, match="x"):
        quietly(path, stream=True, smooth="none")


# --- sums on the way -------------------------------------------------------------------------------------------------


def test_a_sum_that_is_kept_goes_on_where_it_was(record, tmp_path, monkeypatch):
    from bayeq.discovery.streaming.work import AsMeasured
    from bayeq.states import Roles

    monkeypatch.setattr("bayeq.discovery.streaming.checkpoint.EVERY", 0.0)
    extents = (Extent(RecordStream(record), 0, record.n),)
    work = AsMeasured(extents, Roles.parse(**OSCILLATOR), tuple(TERMS), 0.2)
    units = units_of(extents)
    whole = fold(work, units, partial(by_threads, workers=1), lambda *_: None, "rows")
    done = []

    def stopped(unit):
        if len(done) == 4:
            raise KeyboardInterrupt
        done.append(unit)
        return work(unit)

    path = tmp_path / "sum.npz"
    with pytest.raises(KeyboardInterrupt):
        fold(stopped, units, partial(by_threads, workers=1), lambda *_: None, "rows", Checkpoint(path))
    count, _ = Checkpoint(path).load()
    assert 2 <= count <= 4
    seen = []

    def counted(unit):
        seen.append(unit)
        return work(unit)

    again = fold(counted, units, partial(by_threads, workers=1), lambda *_: None, "rows", Checkpoint(path))
    assert seen == units[count:]
    assert again.train.moments.cross.tobytes() == whole.train.moments.cross.tobytes()


def test_units_that_are_counted_are_in_the_sum_wherever_an_interrupt_falls(record, tmp_path):
    extents = (Extent(RecordStream(record), 0, record.n),)
    units = units_of(extents)
    assert len(units) > 3

    def rows_of(unit):
        return np.array([unit.n])

    def interrupted_at(step):
        """Stopped before the instruction of this number within `fold`; False if it has fewer."""
        seen = 0

        def trace(frame, event, argument):
            nonlocal seen
            if frame.f_code is not fold.__code__:
                return None
            frame.f_trace_opcodes = True
            if event == "opcode":
                seen += 1
                if seen == step:
                    raise KeyboardInterrupt
            return trace

        kept = Checkpoint(tmp_path / f"{step}.npz", every=True)
        before = sys.gettrace()
        sys._getframe().f_trace_opcodes = True  # Python 3.12 asks for it before there is a trace
        sys.settrace(trace)
        try:
            fold(rows_of, units[:4], _in_order, lambda *_: None, "rows", kept)
        except KeyboardInterrupt:
            done, total = kept.load()
            assert (0 if total is None else int(total[0])) == sum(unit.n for unit in units[:done])
            return True
        finally:
            sys.settrace(before)
        return False

    step = 1
    while interrupted_at(step):
        step += 1
    assert step > 100


def _in_order(work, units):
    for unit in units:
        yield 1, work(unit)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 damaged", b"\x93NUMPY"])
def test_a_damaged_sum_is_no_sum(content, tmp_path):
    path = tmp_path / "sum.npz"
    path.write_bytes(content)
    assert Checkpoint(path).load() == (0, None)


def test_sums_of_a_run_that_is_through_are_removed(record, tmp_path, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.streaming.checkpoint.EVERY", 0.0)
    path = written(record, tmp_path / "r.h5")
    quietly(path, stream=True, smooth="none", checkpoint=tmp_path / "sums")
    assert list((tmp_path / "sums").glob("*")) == []


def test_readers_in_threads_leave_the_filters_of_warnings_alone(record, tmp_path):
    streams = open_streams([written(record, tmp_path / name) for name in ("r.parquet", "r.h5", "r.csv", "r.npy")])
    before = list(warnings.filters)
    with ThreadPoolExecutor(8) as pool:
        for k in range(40):
            pool.submit(streams[k % 4].read, 1000 * k, 1000 * k + 900)
    assert list(warnings.filters) == before


# --- the command -----------------------------------------------------------------------------------------------------


def test_an_interrupted_command_says_where_its_sums_are_and_goes_on_to_the_same_answer(
    record, tmp_path, capsys, monkeypatch
):
    """Without a folder that was asked for, nothing is kept of a short run, and nothing said."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("bayeq.cli.terminal.PATIENCE", 100.0)
    path = written(record.take(slice(0, 25_000)), tmp_path / "r.csv")
    channels = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
    command = ["discover", path.name, *channels, "--smooth", "none", "--stream"]
    assert main(command) == 0
    expected = capsys.readouterr()
    whole, seen = by_threads, []

    def stopped(work, units):
        for done in whole(work, units):
            yield done
            seen.append(units)
            if len(seen) == 2:
                raise KeyboardInterrupt

    for extra, line in (
        ([], "bayeq: interrupted\n"),
        (
            ["--checkpoint", "sums"],
            "bayeq: interrupted: sums over the rows are kept in sums; the same command continues\n",
        ),
    ):
        seen.clear()
        with monkeypatch.context() as patch:
            patch.setattr("bayeq.discovery.entry.by_threads", stopped)
            assert main([*command, *extra]) == 130
        assert capsys.readouterr() == ("", line)
    assert len(list((tmp_path / "sums").iterdir())) == 1
    assert not (tmp_path / "cache").exists()
    assert main([*command, "--checkpoint", "sums"]) == 0
    assert capsys.readouterr() == expected
    assert list((tmp_path / "sums").iterdir()) == []


def test_the_command_streams_what_it_is_asked_to(record, tmp_path, capsys):
    path = written(record, tmp_path / "r.parquet")
    command = [
        "discover",
        str(path),
        "--disp",
        "x",
        "--vel",
        "v",
        "--acc",
        "a",
        "--force",
        "u",
        "--smooth",
        "none",
        "--json",
    ]
    assert main([*command, "--stream", "--rows", "1000:21000"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert main([*command, "--rows", "1000:21000"]) == 0
    expected = json.loads(capsys.readouterr().out)
    assert found["data"]["n"] == expected["data"]["n"] == 20_000
    for a, b in zip(found["equations"][0]["terms"], expected["equations"][0]["terms"], strict=True):
        assert a["coef"] == pytest.approx(b["coef"], rel=1e-8)


@pytest.mark.parametrize("option", [["--refine"], ["--group", "x"], ["--remove-offset", "x"]])
def test_the_command_refuses_what_takes_whole_records(option, record, tmp_path, capsys):
    path = written(record.take(slice(0, 500)), tmp_path / "r.csv")
    assert main(["discover", str(path), "--disp", "x", "--acc", "a", "--stream", *option]) == 2
    error = capsys.readouterr().err
    assert option[0] in error
    assert error.count("\n") == 1


def test_a_name_that_is_too_long_is_one_line():
    with pytest.raises(FileFormatError, match="File name too long"):
        quietly("x" * 300)


def test_data_in_memory_is_not_streamed(record):
    assert extents_of(record, None, None) is None
    with pytest.raises(InputError, match="in memory"):
        extents_of(record, None, True)


@pytest.mark.slow  # against the answer of all rows: test_relearn
def test_long_records_in_memory_have_the_likelihood_too(record, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.entry.MOST_ROWS", 10_000)
    monkeypatch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", 150)
    record = record.take(slice(0, 14_000))
    found = quietly(record, dictionary="x, v, x**2, x**3, u")
    assert (found.data.stretches, found.data.n) == (20, record.n)
    assert found[0].included == ("x", "v", "x**3", "u")


# all rows of one in memory: test_relearn
@pytest.mark.parametrize("where", [pytest.param("in memory", marks=pytest.mark.slow), "in a file"])
def test_long_records_with_what_takes_whole_records_are_some_stretches(record, where, tmp_path, monkeypatch):
    monkeypatch.setattr("bayeq.discovery.entry.MOST_ROWS", 5000)
    monkeypatch.setattr("bayeq.records.stream.LARGE", 5000)
    monkeypatch.setattr("bayeq.discovery.streaming.work.ROWS_EACH", 75)
    rows = record.take(slice(0, 7000))
    asked = {"dictionary": "x, v, x**3, u, cos(3*t)"}
    found = quietly(rows if where == "in memory" else written(rows, tmp_path / "r.h5"), **asked)
    assert (found.data.stretches, found.data.n) == (0, 1500)
    assert found[0].included == ("x", "v", "x**3", "u")
    assert any(one.startswith("1,500 of 7,000 rows are used, 20 stretches: a term uses t") for one in found.warnings)


def test_the_answer_says_what_is_of_stretches_only(record, tmp_path):
    path = written(record.take(slice(0, 21_000)), tmp_path / "r.h5")
    found = quietly(path, smooth="none", stream=True)
    assert "16800 used; residuals, free runs and verdict are those of 20 stretches of them" in " ".join(
        str(found).split()
    )
    found.save(tmp_path / "eq.json")
    assert bq.load(tmp_path / "eq.json").data.stretches == 20
