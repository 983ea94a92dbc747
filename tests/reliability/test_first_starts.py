"""Two first starts at once: they share a cache of kernels that is being filled."""

from __future__ import annotations

import os

from tests.reliability.commands import QUICK, bayeq, start


def test_two_first_starts_at_once_both_answer(folder):
    cache = folder / "cache"
    cache.mkdir()
    # without model averaging: a few kernels to compile
    command = ["discover", "run.csv", *QUICK, "--method", "stlsq", "--json"]
    processes = [start(*command, cwd=folder, NUMBA_CACHE_DIR=cache) for _ in range(2)]
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    assert ends[0][0] == ends[1][0] != ""
    kept = {path.name for path in cache.rglob("*") if path.is_file()}
    assert any(name.endswith(".nbc") for name in kept)
    assert all(name.endswith((".nbc", ".nbi")) for name in kept)
    before = {path: os.stat(path).st_mtime_ns for path in cache.rglob("*.nbc")}
    code, out, said = bayeq(*command, cwd=folder, NUMBA_CACHE_DIR=cache)
    assert (code, out, said) == (0, ends[0][0], [])
    assert {path: os.stat(path).st_mtime_ns for path in cache.rglob("*.nbc")} == before
