"""Options of the tests.

Continuous integration draws the same examples every time; at a desk hypothesis looks for new ones. It draws all that a
test asks for with `--slow` or `--full-statistics`, and else a share of them. Statistical tests run on few records
unless `--full-statistics` asks for all, and those marked `slow`, in browsers, on clusters and under kills, only with
`--slow`, or where they are statistical with `--full-statistics`.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Generator
from importlib.util import find_spec

import pytest
from hypothesis import settings

from bayeq.kernels import Kernel

# The tests start Python some hundred times: without bytecode on disk each process compiles the sources again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False  # rewritten tests are kept as well

# Imports selenium, which those who skip the tests in a browser need not have.
collect_ignore = [] if find_spec("selenium") else ["app_driver.py"]

RAN_AT_COLLECTION = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full-statistics", action="store_true", help="statistical tests with the full number of records")
    parser.addoption("--slow", action="store_true", help="also the tests that take long: browsers, clusters, kills")


def pytest_configure(config: pytest.Config) -> None:
    """Draw fewer examples, of tests without a number of their own 30 of 100, unless all tests are asked for."""
    share = 1.0 if config.getoption("--slow") or config.getoption("--full-statistics") else 0.3
    settings.register_profile("share", max_examples=round(100 * share), derandomize="CI" in os.environ, deadline=None)
    settings.load_profile("share")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays until the end: it is not searched for garbage, then or later, which took 5 % of a run."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what takes long, unless it is asked for."""
    if not config.getoption("--slow"):
        skip = pytest.mark.skip(reason="takes long: make slow, or pytest --slow")
        full = config.getoption("--full-statistics")
        for item in items:
            if item.get_closest_marker("slow") and not (full and item.get_closest_marker("statistical")):
                item.add_marker(skip)


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands of tests say nothing of progress, however slow the machine, but where a test asks for it."""
    monkeypatch.setattr("bayeq.cli.terminal.PATIENCE", 600.0)


@pytest.fixture
def number(request: pytest.FixtureRequest) -> int:
    """How many records, problems or sweeps a test marked `statistical(short=..., full=...)` is to draw."""
    marker = request.node.get_closest_marker("statistical")
    return int(marker.kwargs["full" if request.config.getoption("--full-statistics") else "short"])


def pytest_collection_finish(session: pytest.Session) -> None:
    """Note the kernels that ran by now, for `test_collection.py`."""
    session.config.stash[RAN_AT_COLLECTION] = [
        f"{name}.{kernel.__name__}"
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("bayeq", "tests")
        for kernel in vars(module).values()
        if isinstance(kernel, Kernel) and "dispatcher" in vars(kernel) and kernel.dispatcher.overloads
    ]
