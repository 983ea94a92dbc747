"""Two first starts at once: they share a cache of kernels that is being filled."""

from __future__ import annotations

from tests.reliability.commands import bayeq, start


def test_two_first_starts_at_once_both_answer(tmp_path):
    cache = tmp_path / "cache"
    cache.mkdir()
    command = ["simulate", "duffing", "--n", "200", "-o"]
    processes = [start(*command, f"{k}.csv", cwd=tmp_path, NUMBA_CACHE_DIR=cache) for k in range(2)]
    ends = [process.communicate(timeout=300) for process in processes]
    assert [process.returncode for process in processes] == [0, 0], ends
    written = {path: path.stat().st_mtime_ns for path in cache.rglob("*") if path.is_file()}
    assert {path.suffix for path in written} == {".nbi", ".nbc"}
    # the next start finds everything there
    assert bayeq(*command, "2.csv", cwd=tmp_path, NUMBA_CACHE_DIR=cache)[0] == 0
    assert {path: path.stat().st_mtime_ns for path in cache.rglob("*") if path.is_file()} == written
    assert len({(tmp_path / f"{k}.csv").read_bytes() for k in range(3)}) == 1
