"""The record itself: what it refuses, and what can be done with it."""

from __future__ import annotations

import copy
import pickle
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayeq.errors import DataWarning, RecordError, UnknownNameError
from bayeq.records import Record, Truth


def make(n: int = 6, **kwargs: Any) -> Record:
    return Record.from_arrays(x=np.arange(n), v=-np.arange(n), fs=10, units={"x": "m"}, name="r", **kwargs)


@pytest.mark.parametrize(
    ("channels", "time", "message"),
    [
        ({}, None, "no channels"),
        ({"x": []}, None, "no rows"),
        ({"x": [1, 2], "v": [1]}, None, "unequal lengths: x 2, v 1"),
        ({"x": [1, 2]}, [0.0], "unequal lengths: time 1, x 2"),
        ({"x": [[1, 2]]}, None, r"'x' has shape \(1, 2\)"),
        ({"x": [[1, 2], [3]]}, None, "'x' is not an array of numbers"),
        ({"x": ["a"]}, None, "'x' does not hold numbers"),
        ({"x": [1, None]}, None, "'x' does not hold numbers"),
        ({"x": [1j]}, None, "'x' is complex"),
        ({"2x": [1]}, None, "'2x' cannot name a channel in a term; call it '_2x'"),
        ({"sin": [1]}, None, "call it 'sin_'"),
        ({"lambda": [1]}, None, "call it 'lambda_'"),
        ({3: [1]}, None, "must be text, not 3"),
        ({"x": [1, 2, 3]}, [0, 2, 1], r"from 2.0 to 1.0 in row 3; sort the rows"),
        ({"x": [1, 2, 3]}, [0, 1, 1], r"from 1.0 to 1.0 in row 3; leave out the repeated row"),
        ({"x": [1, 2, 3]}, [0, 1, 0], r"from 1.0 to 0.0 in row 3; it restarts there.*--group"),
        ({"x": [1, 2, 3]}, [0, np.nan, 1], r"missing \(NaN\) in row 2 \(1 such row\)"),
        ({"x": [1, 2, 3]}, [0, np.inf, 1], "infinite in row 2"),
        ({"x": [1]}, ["a"], "time does not hold numbers"),
    ],
)
def test_refusals(channels: dict[str, Any], time: Any, message: str) -> None:
    with pytest.raises(RecordError, match=message) as caught:
        Record(channels, time, name="run.csv")
    assert str(caught.value).startswith("run.csv: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fs", [0, -1, np.nan, np.inf, "10"])
def test_sampling_rate_must_be_positive(fs: Any) -> None:
    with pytest.raises(RecordError, match="sampling rate fs must be positive"):
        Record.from_arrays(x=[1.0], fs=fs)


@pytest.mark.parametrize("fs", [1e-320, 1e-308])
def test_sampling_rate_must_give_times_that_differ(fs: float) -> None:
    with pytest.raises(RecordError, match=r"sampling rate .* out of range for 40 rows"):
        Record.from_arrays(x=np.arange(40.0), fs=fs)


def test_time_and_rate_exclude_each_other() -> None:
    with pytest.raises(RecordError, match="both given"):
        Record.from_arrays(x=[1.0, 2.0], time=[0, 1], fs=1)


def test_units_belong_to_channels() -> None:
    with pytest.raises(UnknownNameError, match="no channel named 'y'"):
        Record({"x": [1.0]}, units={"y": "m"})
    with pytest.raises(RecordError, match="unit of 'x', 'm]', cannot be written in a header: leave out square br"):
        Record({"x": [1.0]}, units={"x": "m]"})
    for unit, what in {
        "[m": "square",
        "m\ns": r"'\\n'",
        "\u00a0": r"'\\xa0'",
        "m\ts": r"'\\t'",
        "\ud800": r"ud800",
    }.items():
        with pytest.raises(RecordError, match=f"unit of 'x'.*leave out .*{what}"):
            Record({"x": [1.0]}, units={"x": unit})
    with pytest.raises(RecordError, match=r"unit of 'x' must be text, not 3"):
        Record({"x": [1.0]}, units={"x": 3})  # type: ignore[dict-item]
    with pytest.raises(RecordError, match=r"time is kept in seconds, not ms; multiply it by 0.001"):
        Record({"x": [1.0]}, [0.0], units={"t": "ms"})


def test_arrays_are_copies_that_cannot_be_written() -> None:
    source = np.array([1.0, 2.0])
    rec = Record.from_arrays({"x": source}, time=source)
    source[0] = 9.0
    assert rec["x"][0] == 1.0
    assert rec.time is not None
    for array in (rec["x"], rec.time):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(TypeError):
        rec.channels["x"] = source
    with pytest.raises(AttributeError):
        rec.name = "other"


def test_masked_samples_become_nan() -> None:
    assert np.isnan(Record({"x": np.ma.array([1, 2], mask=[False, True])})["x"][1])


def test_dates_become_seconds() -> None:
    time = np.array(["2024-01-01T00:00:00", "2024-01-01T00:00:01.5"], dtype="datetime64[ms]")
    rec = Record({"x": [1, 2]}, time)
    assert rec.time is not None
    assert rec.time.tolist() == [0.0, 1.5]


def test_looking_up() -> None:
    rec = make()
    assert rec.names == ("x", "v")
    assert len(rec) == rec.n == 6
    assert "x" in rec
    with pytest.raises(UnknownNameError, match="r: no channel named 'X'; did you mean 'x'"):
        rec["X"]


@given(st.integers(2, 3000), st.floats(1e-3, 1e6), st.floats(-1e4, 1e4))
def test_a_grid_is_uniform_and_has_its_rate(n: int, fs: float, start: float) -> None:
    time = start + np.arange(n) / fs
    rec = Record({"x": np.zeros(n)}, time)
    assert rec.is_uniform()
    assert rec.fs == pytest.approx(fs, rel=1e-4)
    assert Record.from_arrays(x=np.zeros(n), fs=fs).fs == pytest.approx(fs, rel=1e-12)


def test_steps() -> None:
    assert Record({"x": [1.0]}).dt is None
    assert Record({"x": [1.0]}).fs is None
    assert not Record({"x": [1.0]}).is_uniform()
    assert Record({"x": [1.0]}, [0.0]).dt is None
    uneven = Record.from_arrays(x=[0, 0, 0, 0], time=[0.0, 1.0, 2.0, 4.0])
    assert uneven.dt == 1.0
    assert not uneven.is_uniform()
    # one tolerance everywhere: a thousandth of the step, and the rounding of the times
    jitter = np.array([0.0, 1.0, -1.0, 0.0])
    for size, even in ((4e-4, True), (2e-3, False)):
        rec = Record({"x": np.zeros(4)}, 1e6 + np.arange(4) + size * jitter)
        assert rec.is_uniform() is even
        assert (repr(rec).count("at 1 Hz") == 1) is even


def test_rows() -> None:
    truth = Truth("s", clean={"x": np.arange(6.0)})
    rec = Record.from_arrays(x=np.arange(6), fs=10, units={"x": "m"}, name="r")
    rec = Record(rec.channels, rec.time, rec.units, rec.name, truth)
    part = rec.slice(2, 4)
    assert part["x"].tolist() == [2.0, 3.0]
    assert part.truth is not None
    assert part.truth.clean["x"].tolist() == [2.0, 3.0]
    assert (part.units, part.name) == ({"x": "m"}, "r")
    assert rec.take(rec["x"] > 3)["x"].tolist() == [4.0, 5.0]
    assert rec.take([0, 5])["x"].tolist() == [0.0, 5.0]
    assert rec.slice(step=2).dt == pytest.approx(0.2)
    with pytest.raises(RecordError, match="no rows"):
        rec.slice(6)
    with pytest.raises(RecordError, match="increase strictly"):
        rec.take([1, 0])


def test_truth_fits_the_record() -> None:
    with pytest.raises(RecordError, match="clean channel 'x'"):
        Record({"x": [1.0, 2.0]}, truth=Truth("s", clean={"x": np.zeros(3)}))


def test_with_channels() -> None:
    rec = make().with_channels({"x": np.ones(6), "u": np.zeros(6)}, units={"u": "N"})
    assert rec.names == ("x", "v", "u")
    assert rec.units == {"u": "N"}
    with pytest.raises(RecordError, match="unequal lengths"):
        rec.with_channels({"w": [1.0]})


@given(st.lists(st.integers(0, 2), min_size=1, max_size=20))
def test_split_by_runs(labels: list[int]) -> None:
    n = len(labels)
    rec = Record.from_arrays(x=np.arange(n), g=labels, fs=1, name="r")
    for group in (labels, "g", lambda record: record["g"]):
        trials = rec.split_by(group)
        assert np.concatenate([trial["x"] for trial in trials]).tolist() == list(range(n))
        assert [trial.name for trial in trials] == [f"r [trial {i}]" for i in range(len(trials))]
        if group == "g":
            assert trials[0].names == ("x",)
        else:
            assert all(len(set(trial["g"])) == 1 for trial in trials)
            assert all(a["g"][-1] != b["g"][0] for a, b in pairwise(trials))


def test_split_by_refusals() -> None:
    with pytest.raises(RecordError, match="one label for each of 6 rows"):
        make().split_by([1, 2])
    with pytest.raises(RecordError, match=r"missing \(NaN\) in row 2"):
        make().split_by([0, np.nan, 1, 1, 1, 1])


def test_require_finite() -> None:
    rec = Record({"x": [1.0, np.nan, np.inf], "v": [1.0, 2.0, 3.0]}, name="r")
    rec.require_finite("v")
    with pytest.raises(RecordError, match="r: channel 'x' has 2 NaN or infinite samples of 3, first in row 2"):
        rec.require_finite()


def test_pickle_and_copy_keep_everything() -> None:
    truth = Truth("s", {"k": 1.0}, {"a": {"x": -1.0}}, {"x": np.zeros(6)}, {"x": 0.1})
    rec = Record(make().channels, make().time, {"x": "m"}, "r", truth)
    for twin in (pickle.loads(pickle.dumps(rec)), copy.deepcopy(rec)):  # noqa: S301
        assert twin.equals(rec)
        assert twin.name == "r"
        assert twin.truth.coefficients == {"a": {"x": -1.0}}
        assert not twin["x"].flags.writeable


def test_equals() -> None:
    assert make().equals(make())
    assert not make().equals(make(5))
    assert not make().equals(make().with_channels({"x": np.ones(6)}))
    assert not make().equals(Record(make().channels, None, {"x": "m"}))
    assert not make().equals(3)


def test_repr_is_short() -> None:
    assert repr(make()) == "Record('r': 6 rows at 10 Hz; x [m], v)"
    many = Record({f"x{i}": [1.0] for i in range(20)})
    assert repr(many).endswith("x7, ... (20 channels))")
    assert "median step 1 s" in repr(Record.from_arrays(x=[0, 0, 0, 0], time=[0.0, 1.0, 2.0, 4.0]))


def test_dataframe_there_and_back() -> None:
    pd = pytest.importorskip("pandas")
    df = make().to_dataframe()
    assert list(df.columns) == ["t", "x", "v"]
    assert Record.from_dataframe(df, units={"x": "m"}).equals(make())
    assert Record.from_dataframe(df, fs=10).names == ("t", "x", "v")
    assert Record.from_dataframe(df, columns="x").names == ("x",)
    assert Record.from_dataframe(df.set_index("t"), units={"x": "m"}).equals(make())
    gaps = pd.DataFrame({"x [m]": pd.array([1, None], dtype="Int64"), "label": ["a", "b"]})
    rec = Record.from_dataframe(gaps, columns="x")
    assert np.isnan(rec["x"][1])
    assert rec.units == {"x": "m"}
    with pytest.warns(DataWarning, match="'label' holds words, not numbers: left out"):
        assert Record.from_dataframe(gaps).names == ("x",)
    dated = pd.DataFrame({"x": [1.0, 2.0]}, index=pd.date_range("2024", periods=2, freq="s", tz="CET", name="time"))
    assert Record.from_dataframe(dated).dt == 1.0


def frozen(values):
    values.setflags(write=False)
    return values


def test_arrays_that_nobody_can_change_are_not_copied():
    values = frozen(np.arange(5.0))
    assert Record({"x": values})["x"] is values
    assert Record({"x": values[:]})["x"].base is values


@pytest.mark.parametrize(
    "values",
    [
        np.arange(5.0),
        frozen(np.arange(10.0)[:5]),  # a part keeps all alive
        frozen(np.arange(5.0)[:]),  # whose owner can be written to
        frozen(np.arange(10.0)[::2]),
        frozen(np.arange(5)),
        frozen(np.frombuffer(bytearray(40), dtype=np.float64)),
    ],
)
def test_other_arrays_are_copied(values):
    kept = Record({"x": values})["x"]
    assert kept.base is None
    assert not kept.flags.writeable
    assert not np.shares_memory(kept, values)


def test_columns_of_arrow_are_not_copied():
    pa = pytest.importorskip("pyarrow")
    column = pa.array([1.0, 2.0, 3.0]).to_numpy()
    assert np.shares_memory(Record({"x": column})["x"], column)
