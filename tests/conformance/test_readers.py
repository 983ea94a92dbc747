"""One suite for every file format that is read: a new row of the table needs a sample, and inherits all of this."""

from __future__ import annotations

import random
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bayeq import Record, read
from bayeq.errors import InputError, MissingExtraError
from bayeq.records.formats import FORMATS
from tests.conformance.samples import SAMPLES, T, U, X

PACKAGES = {"HDF5 and MATLAB v7.3": "h5py", "universal file, dataset 58": "pyuff", "TDMS": "nptdms"}


@pytest.fixture(params=sorted(SAMPLES))
def name(request: pytest.FixtureRequest) -> str:
    found: str = request.param
    return found


@pytest.fixture
def path(name: str, tmp_path: Path) -> Path:
    sample = SAMPLES[name]
    path = tmp_path / f"run{sample.suffix}"
    sample.make(path)
    return path


def choose(name: str) -> dict[str, dict[str, str]]:
    """How the two channels are asked for, where a file holds more."""
    return {"channels": {"rec_x": "rec.x", "rec_u": "rec.u"}} if name == "MATLAB v7.3" else {}


def test_every_format_has_a_sample() -> None:
    assert {row.title for row in FORMATS} <= set(SAMPLES)


def test_values_units_and_rate(name: str, path: Path) -> None:
    sample = SAMPLES[name]
    record = read(path, **choose(name))
    assert isinstance(record, Record)
    assert set(record.names) == set(sample.names)
    for channel, values in zip(sample.names, (X, U), strict=True):
        assert np.allclose(record[channel], values, rtol=0, atol=sample.digits), channel
    assert record.time is not None
    assert np.allclose(record.time, T, rtol=0, atol=1e-6)
    assert record.fs == pytest.approx(sample.fs)
    assert {k: v for k, v in record.units.items() if k != "t"} == {k: v for k, v in sample.units.items() if k != "t"}


def test_the_content_tells_where_the_suffix_does_not(name: str, path: Path) -> None:
    other = path.rename(path.with_suffix(".dat"))
    assert set(read(other, **choose(name)).names) == set(SAMPLES[name].names)


def test_channels_are_renamed_and_a_rate_replaces_time(name: str, path: Path) -> None:
    x, u = SAMPLES[name].names
    if name == "MATLAB v7.3":
        x, u = "rec.x", "rec.u"
    record = read(path, channels={"q": x, "f": u}, units={"q": "km"})
    assert isinstance(record, Record)
    assert record.names == ("q", "f")
    assert record.units["q"] == "km"
    assert record.fs == pytest.approx(50.0)
    assert np.allclose(record["f"], U, atol=1e-9)
    with pytest.raises(InputError, match="no column named 'nothing'"):
        read(path, channels={"q": "nothing"})


def refusal(path: Path) -> str | None:
    """What a file is refused with; None if it is read."""
    try:
        read(path)
    except InputError as error:
        return str(error)
    return None


def damaged(whole: bytes, rng: random.Random) -> bytes:
    data = bytearray(whole)
    if rng.random() < 0.7:
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    if rng.random() < 0.5:
        data = data[: rng.randint(0, len(data))]
    return bytes(data)


@pytest.mark.filterwarnings("ignore::bayeq.errors.DataWarning")
def test_a_damaged_copy_is_read_or_refused_in_one_line(name: str, path: Path) -> None:
    """Cut off or changed at random: never another exception, never long."""
    whole = path.read_bytes()
    rng = random.Random(14)
    refused = 0
    for _ in range(120):
        path.write_bytes(damaged(whole, rng))
        started = time.monotonic()
        message = refusal(path)
        if message is not None:
            refused += 1
            assert "\n" not in message
            assert path.name in message
        assert time.monotonic() - started < 5.0
    assert refused > 10


def test_nothing_but_the_beginning(name: str, path: Path) -> None:
    whole = path.read_bytes()
    for size in (0, 1, 8, 2 * len(whole) // 3):
        path.write_bytes(whole[:size])
        try:
            record = read(path, **choose(name))
        except InputError as error:
            assert path.name in str(error)  # noqa: PT017
        else:  # text goes on to where it ends
            assert name == "delimited text"
            assert isinstance(record, Record)
            assert record.n < len(X)


def test_the_extra_is_named(name: str, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = PACKAGES.get(name) or {".xlsx": "openpyxl", ".xls": "xlrd"}.get(path.suffix)
    if package is None:
        pytest.skip("needs no extra")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'bayeq\[files\]'"):
        read(path)
