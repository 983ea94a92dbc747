"""Options of the tests.

Continuous integration draws the same examples every time; at a desk hypothesis looks for new ones. Statistical tests
run on few records unless `--full-statistics` asks for all.
"""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full-statistics", action="store_true", help="statistical tests with the full number of records")


@pytest.fixture
def number(request: pytest.FixtureRequest) -> int:
    """How many records, problems or sweeps a test marked `statistical(short=..., full=...)` is to draw."""
    marker = request.node.get_closest_marker("statistical")
    return int(marker.kwargs["full" if request.config.getoption("--full-statistics") else "short"])
