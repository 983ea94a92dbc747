"""One suite for every format that can be written: a new one inherits all of it. Others: `test_readers`."""

from __future__ import annotations

import contextlib
import random
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bayeq.errors import FileFormatError, UnknownNameError
from bayeq.records import Record, read, write
from bayeq.records.columns import RATE_NAMES, STEP_NAMES
from bayeq.records.formats import suffixes, writers
from bayeq.records.names import clean_name, is_time_name
from bayeq.records.validate import SECONDS
from tests.draws import draws

QUICK = settings(max_examples=draws(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

channel_names = (
    st.text(min_size=1, max_size=6)
    .map(lambda text: clean_name(text)[0])
    .filter(lambda name: name.isprintable() and not is_time_name(name) and clean_name(name)[0] == name)
    .filter(lambda name: name not in (*STEP_NAMES, *RATE_NAMES))  # a constant of that name is no channel
)
PLAIN_UNITS = ["m", "m/s^2", "µm", "°", "N m", "-", "m²", "year"]
HARD_UNITS = [
    *('in"', '"', '""', '"in"', '"1"', "'", "'in'", "a, b", "1;2", "1 2", "1 2 3", "3", "nan", "nan nan", "-1e5"),
    *("(a)", "(1", "1)", ")(", "{}", "#", "% #", "sep=;", ";", ",", ",,", "t", "\\", "Ω", "米", "é è", "𝒳", "  m  s "),
]
any_text = st.text(st.characters(exclude_characters="[]", codec="utf-8"), max_size=8).filter(str.isprintable)
units = st.sampled_from([*PLAIN_UNITS, *HARD_UNITS]) | any_text


@st.composite
def records(draw: st.DrawFn) -> Record:
    names = draw(st.lists(channel_names, min_size=1, max_size=4, unique=True))
    n = draw(st.integers(1, 12))
    every_float = st.floats(width=64, allow_nan=True, allow_infinity=True, allow_subnormal=True)
    channels = {name: draw(hnp.arrays(np.float64, n, elements=every_float)) for name in names}
    time = None
    if draw(st.booleans()):
        times = st.floats(-1e300, 1e300, allow_subnormal=True)
        time = np.sort(draw(hnp.arrays(np.float64, n, elements=times, unique=True)))
    with_unit = [*names, "t"] if time is not None and "t" not in names else names
    chosen = draw(st.dictionaries(st.sampled_from(with_unit), units))
    if time is None:  # a rising channel whose unit is a time would be time, and one called dt the step
        chosen = {name: unit for name, unit in chosen.items() if " ".join(unit.split()) not in SECONDS}
    if "t" not in names and SECONDS.get(" ".join(chosen.get("t", "").split()), 1.0) != 1.0:
        del chosen["t"]  # time is kept in seconds
    return Record(channels, time, chosen, "r")


def assert_same(got: Record, wanted: Record) -> None:
    """Equal to the bit; NaN to NaN of any payload, for text has but one."""
    assert got.names == wanted.names
    assert got.units == wanted.units
    pairs = [(got[name], wanted[name]) for name in wanted.names]
    assert (got.time is None) == (wanted.time is None)
    if got.time is not None and wanted.time is not None:
        pairs.append((got.time, wanted.time))
    for a, b in pairs:
        assert a.dtype == b.dtype == np.float64
        assert np.array_equal(np.isnan(a), np.isnan(b))
        assert a[~np.isnan(a)].tobytes() == b[~np.isnan(b)].tobytes()


EXTRAS = {"parquet": "pyarrow", "files": "h5py"}


# Suffixes that are others by another name.
OTHERS = (".txt", ".dat", ".asc", ".pq", ".hdf5", ".hdf")


@pytest.fixture(params=[pytest.param(one, marks=[pytest.mark.slow] * (one in OTHERS)) for one in sorted(writers())])
def suffix(request: pytest.FixtureRequest) -> str:
    suffix: str = request.param
    if extra := suffixes()[suffix].extra:
        pytest.importorskip(EXTRAS[extra])
    return suffix


def example() -> Record:
    return Record.from_arrays(x=[1.0, -0.0, np.nan], v=[5e-324, 1e308, np.inf], fs=100, units={"x": "m"})


@QUICK
@given(record=records())
def test_round_trip_is_exact(suffix: str, tmp_path: Path, record: Record) -> None:
    path = tmp_path / f"r{suffix}"
    write(record, path)
    assert_same(read(path), record)


def test_units_are_kept(suffix: str, tmp_path: Path) -> None:
    record = Record({"x": [1.0, 2.0], "v": [3.0, 4.0]}, [0.0, 1.0], {"x": "mm", "v": "m/s", "t": "year"})
    write(record, tmp_path / f"r{suffix}")
    assert dict(read(tmp_path / f"r{suffix}").units) == {"t": "year", "x": "mm", "v": "m/s"}


def test_a_name_that_ends_in_a_unit_gives_none(suffix: str, tmp_path: Path) -> None:
    for units in ({}, {"x": "m"}, {"disp_mm": "in"}):
        record = Record({"disp_mm": [1.0, 2.0], "x": [3.0, 4.0]}, [0.0, 1.0], units)
        write(record, tmp_path / f"r{suffix}")
        assert_same(read(tmp_path / f"r{suffix}"), record)


@pytest.mark.parametrize("unit", HARD_UNITS)
def test_units_of_any_text_are_kept(suffix: str, tmp_path: Path, unit: str) -> None:
    path = tmp_path / f"r{suffix}"
    kept = " ".join(unit.split())
    one = Record({"x": [1.0, 2.0]}, None, {"x": unit})
    two = Record({"x": [1.0, 2.0], "v": [3.0, np.nan]}, [0.0, 1.0], {"x": unit, "v": unit, "t": unit})
    row = Record({"x": [np.nan]}, None, {"x": unit})
    for record in (one, two, row):
        write(record, path)
        back = read(path)
        assert_same(back, record)
        assert back.units["x"] == kept


def test_every_spelling_of_seconds_is_s(suffix: str, tmp_path: Path) -> None:
    record = Record({"x": [1.0, 2.0]}, [0.0, 1.0], {"t": "sec"})
    write(record, tmp_path / f"r{suffix}")
    assert_same(read(tmp_path / f"r{suffix}"), record)
    assert record.units["t"] == "s"


def test_a_channel_t_stays_apart_from_time(suffix: str, tmp_path: Path) -> None:
    record = Record({"t": [5.0, 3.0], "x": [1.0, 2.0]}, [0.0, 1.0], {"t": "N"})
    write(record, tmp_path / f"r{suffix}")
    assert_same(read(tmp_path / f"r{suffix}"), record)


def test_the_same_record_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    write(example(), tmp_path / f"a{suffix}")
    write(example(), tmp_path / f"b{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_columns_names_and_time_can_be_asked_for(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"r{suffix}"
    write(example(), path)
    assert read(path, columns="v").names == ("v",)
    assert read(path, columns=["v"]).time is not None
    renamed = read(path, names="seconds a b", time="seconds")
    assert renamed.names == ("a", "b")
    assert renamed.time is not None
    with pytest.raises(UnknownNameError, match="no column named 'w'"):
        read(path, columns="w")
    with pytest.raises(FileFormatError, match="2 names for 3 columns"):
        read(path, names="a b")


def test_missing_file(suffix: str, tmp_path: Path) -> None:
    write(example(), tmp_path / f"run1{suffix}")
    with pytest.raises(FileFormatError, match=f"no such file: .*run2.*did you mean 'run1{suffix}'"):
        read(tmp_path / f"run2{suffix}")


def test_empty_file(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"r{suffix}"
    path.write_bytes(b"")
    with pytest.raises(FileFormatError, match=f"r{suffix}"):
        read(path)


def test_directory_and_no_directory(suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"d{suffix}").mkdir()
    with pytest.raises(FileFormatError, match="is a directory"):
        read(tmp_path / f"d{suffix}")
    with pytest.raises(FileFormatError, match="cannot be written"):
        write(example(), tmp_path / "nowhere" / f"r{suffix}")


@QUICK
@given(garbage=st.binary(max_size=200))
def test_garbage_is_a_format_error(suffix: str, tmp_path: Path, garbage: bytes) -> None:
    path = tmp_path / f"r{suffix}"
    path.write_bytes(b"\x00" + garbage)
    with pytest.raises(FileFormatError) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_damaged_file_is_a_format_error_or_reads(suffix: str, tmp_path: Path) -> None:
    """Bytes changed, lost or cut off: an answer or a FileFormatError, never anything else."""
    path = tmp_path / f"r{suffix}"
    write(example(), path)
    whole = path.read_bytes()
    rng = random.Random(0)
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        path.write_bytes(bytes(data[: rng.randint(1, len(data))] if rng.random() < 0.3 else data))
        with contextlib.suppress(FileFormatError):
            read(path, fs=1)
