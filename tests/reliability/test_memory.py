"""Less memory than is needed: one line, and no words of libraries."""

from __future__ import annotations

import sys

import pytest

from tests.reliability.commands import QUICK, bayeq

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of address space hold on Linux")

MB = 2**20


def limited(megabytes):
    """What limits a process before it starts."""
    import resource

    return lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes * MB, megabytes * MB))


@pytest.mark.parametrize("megabytes", [100, 300, 500])
def test_too_little_for_any_command_is_one_clear_line(megabytes, folder):
    others = [["info", "run.csv"], ["study", "table2"]] if megabytes == 300 else []
    for command in (["discover", "run.csv", *QUICK], *others):
        code, out, said = bayeq(*command, cwd=folder, before=limited(megabytes))
        assert (code, out, len(said)) == (1, "", 1)
        assert said[0].startswith(
            f"bayeq: error: not enough memory: this process is limited to {megabytes} MB of address space, and needs "
        )
    assert bayeq("discover", "--help", cwd=folder, before=limited(megabytes))[0] == 0


def test_the_least_that_is_asked_for_is_enough(folder):
    # of the threads of OpenBLAS, each of which takes its share, there is one then
    for command in (["discover", "run.csv", *QUICK], ["info", "run.csv"]):
        code, out, said = bayeq(*command, cwd=folder, before=limited(640), OPENBLAS_NUM_THREADS=None)
        assert (code, said) == (0, [])
        assert out


def test_too_little_for_what_is_asked_for_is_one_clear_line(folder):
    before = limited(660)  # drawing takes more
    code, out, said = bayeq("discover", "run.csv", *QUICK, "--forecast", "runs.png", cwd=folder, before=before)
    if code:
        assert (code, len(said)) == (1, 1)
        assert said[0].startswith("bayeq: error: not enough memory: this process is limited to 660 MB")
        assert not (folder / "runs.png").exists()
    else:
        assert "\na = " in out
