from __future__ import annotations

import os

import pytest

import bayeq as bq
from tests.reliability.commands import mounted


@pytest.fixture(scope="session", autouse=True)
def _shorter(pytestconfig):
    """Jobs that are killed or interrupted read a third of the rows, five units, but in the long form."""
    with pytest.MonkeyPatch.context() as patch:
        if not pytestconfig.getoption("--full-statistics"):
            patch.setattr("studies.kills.ROWS", 20_000)
        yield


@pytest.fixture
def folder(tmp_path):
    """A folder with a short record, run.csv."""
    bq.write(bq.simulate("linear", n=300, seed=0), tmp_path / "run.csv")
    return tmp_path


@pytest.fixture
def read_only(folder):
    """A folder that cannot be written to."""
    place = folder / "locked"
    place.mkdir()
    if os.name == "posix" and os.geteuid():
        place.chmod(0o500)
        yield place
        place.chmod(0o700)
        return
    with mounted(place, "ro"):
        yield place


@pytest.fixture
def full_disk(folder):
    """A folder on a disk of 40 kB."""
    place = folder / "small"
    place.mkdir()
    with mounted(place, "size=40k"):
        yield place
