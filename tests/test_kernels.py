"""The kernel cache follows callees: an edit anywhere below recompiles what stands above."""

from __future__ import annotations

import linecache
import pickle
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from bayeq.inference.collapsed.tableau import score
from bayeq.kernels import announce_compiling, kernel
from tests.uncovered import WITHOUT_PYC, uncovered

CALLEE = "from bayeq.kernels import kernel\n\n@kernel\ndef inner(x):\n    return x + {shift}\n"
MIDDLE = "from bayeq.kernels import kernel\nfrom callee import inner\n\n@kernel\ndef middle(x):\n    return inner(x)\n"
CALLER = """
from bayeq.kernels import kernel
from middle import middle

SCALE = {scale}

@kernel
def outer(x):
    return SCALE * middle(x)

value = outer(1.0)
hits = sum(outer.stats.cache_hits.values())
"""


def run(folder: Path) -> tuple[float, int]:
    """What the modules of a folder compute as they are now, and how often the cache had it."""
    with pytest.MonkeyPatch.context() as patch:
        # an edit within a second that keeps the length would not be seen where there is bytecode
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.syspath_prepend(folder)
        for name in ("callee", "middle", "layouts", "caller"):
            patch.delitem(sys.modules, name, raising=False)
        linecache.clearcache()
        caller = import_module("caller")
    return caller.value, caller.hits


def test_editing_a_callee_or_a_constant_recompiles_its_callers(tmp_path):
    (tmp_path / "callee.py").write_text(CALLEE.format(shift=1.0))
    (tmp_path / "middle.py").write_text(MIDDLE)
    (tmp_path / "caller.py").write_text(CALLER.format(scale=10.0))
    assert run(tmp_path) == (20.0, 0)
    (tmp_path / "callee.py").write_text(CALLEE.format(shift=2.0))  # two files below
    assert run(tmp_path) == (30.0, 0)
    (tmp_path / "caller.py").write_text(CALLER.format(scale=100.0))
    assert run(tmp_path) == (300.0, 0)
    # comments and places do not matter: from the cache
    (tmp_path / "callee.py").write_text("# a comment\n\n" + CALLEE.format(shift=2.0))
    assert run(tmp_path) == (300.0, 1)


RECORDS = """
from typing import NamedTuple

class Inner(NamedTuple):
    {inner}

class Outer(NamedTuple):
    inner: Inner
    c: float
"""
USER = """
from bayeq.kernels import announce_compiling, kernel
from layouts import Inner, Outer

@kernel
def difference(r: Outer) -> float:
    return r.inner.a - r.inner.b

r = Outer(Inner(a=3.0, b=1.0), 0.0)
value = difference(r)
hits = sum(difference.stats.cache_hits.values())
"""


def test_another_order_of_the_fields_of_a_record_recompiles(tmp_path):
    (tmp_path / "caller.py").write_text(USER)
    file = tmp_path / "layouts.py"
    file.write_text(RECORDS.format(inner="a: float; b: float"))
    assert run(tmp_path) == (2.0, 0)
    file.write_text(RECORDS.format(inner="b: float; a: float"))
    assert run(tmp_path) == (2.0, 0)


def test_nothing_is_compiled_and_numba_not_imported_before_the_first_call(tmp_path):
    (tmp_path / "callee.py").write_text(CALLEE.format(shift=1.0))
    code = "import sys, bayeq.discovery, callee; {}; print('numba' in sys.modules)"
    for call, imported in (("callee.inner", "False"), ("callee.inner(1.0)", "True")):
        command = [sys.executable, "-c", code.format(call)]
        out = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert out.stdout.strip() == imported
    assert list(tmp_path.rglob("callee.inner.*.nbi"))


INNER = """
from bayeq.kernels import kernel

@kernel
def power(x, n):
    if n < 0:
        raise ValueError("negative")
    return 1.0 if n == 0 else x * x ** (n - 1)

@kernel
def total(xs, n):
    out = 0.0
    for x in xs:
        out += power(x, n)
    return out

@kernel
def both(xs):
    return total(xs, 1), total(xs, 2)

import numpy as np

xs = np.array([1.0, 2.0, 4.0])
print(both(xs))
try:
    total(xs, -1)
except ValueError as error:
    print(error)
print(power(2.0, 3))
"""


def test_kernels_that_kernels_call_are_part_of_these(tmp_path):
    # both is compiled first, with the inner kernels; then these are, for calls from Python
    (tmp_path / "inner.py").write_text(INNER)
    for _ in range(2):
        command = [sys.executable, "inner.py"]
        out = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        assert out.stdout.splitlines() == ["(7.0, 21.0)", "negative", "8.0"]
    lines = INNER.splitlines()
    (tmp_path / "inner.py").write_text("\n".join(lines[: lines.index("try:")]))
    for file in tmp_path.rglob("*.nb?"):
        file.unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        patch.delitem(sys.modules, "inner", raising=False)
        import_module("inner")
    (code,) = tmp_path.rglob("*.nbc")  # machine code of one kernel, that Python calls
    assert code.name.startswith("inner.both")


MANY = """
import sys
import numpy as np
from bayeq.kernels import kernel

@kernel
def solved(A, b):
    return np.linalg.solve(A, b).copy()

@kernel
def counted(x):
    seen = {x[0]: 0}
    for value in x:
        seen[value] = seen.get(value, 0) + 1
    return len(seen)

@kernel
def drawn(rng, n):
    return rng.normal(0.0, 1.0, n).sum()

@kernel
def refused(n):
    if n < 0:
        raise ValueError("negative")
    return "even" if n % 2 == 0 else "odd"

print(solved(np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([3.0, 4.0])))
print(counted(np.array([1.5, 2.5, 1.5])), drawn(np.random.default_rng(0), 5), refused(3))
try:
    refused(-1)
except ValueError as error:
    print(error)
kernels = (solved, counted, drawn, refused)
print(sum(sum(k.stats.cache_hits.values()) for k in kernels), "numba.np.npyimpl" in sys.modules)
if sys.argv[1:]:
    print(kernel(lambda x: x[::-1])(np.array([1.0, 2.0])))
"""


@pytest.mark.parametrize("dictionaries", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_loaded_kernels_run_without_what_compiling_needs(dictionaries, tmp_path):
    # dictionaries and equations take most of the time
    few = MANY.replace("@kernel\ndef counted", "def counted").replace("(solved, counted, ", "(solved, ")
    few = few.replace("np.linalg.solve(A, b).copy()", "A @ b").replace(
        "rng.normal(0.0, 1.0, n).sum()", "n * rng.random()"
    )
    (tmp_path / "many.py").write_text(MANY if dictionaries else few)

    def run(*arguments):
        command = [sys.executable, "many.py", *arguments]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.splitlines()

    *compiled, how = run()
    assert how == "0 True"
    *loaded, how, more = run("more")
    assert (loaded, how) == (compiled, f"{3 + dictionaries} False")
    # and something can be compiled after it
    assert more == "[2. 1.]"


def thirds(x):
    total = 0.0
    for k in range(3):
        total += x / (3 - k)
    return total


def load(cache_hits):
    """Compile `thirds`, or load it from the cache, as a new process would."""
    compiled = kernel(thirds)
    assert compiled(6.0) == 11.0
    assert sum(compiled.stats.cache_hits.values()) == cache_hits


def test_kernels_travel_to_other_processes_by_name():
    assert pickle.loads(pickle.dumps(score)) is score  # noqa: S301


DAMAGES = {
    "empty": lambda good: b"",
    "garbage": lambda good: b"garbage" * 500,
    "zeros": lambda good: bytes(len(good)),
    "half": lambda good: good[: len(good) // 2],
    "block": lambda good: good[: len(good) // 2] + bytes(200) + good[len(good) // 2 + 200 :],
}


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_cache_mends_itself(tmp_path, monkeypatch, suffix, damage):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    load(cache_hits=0)
    load(cache_hits=1)
    (file,) = tmp_path.rglob(f"*.{suffix}")
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    load(cache_hits=0)
    load(cache_hits=1)


@pytest.mark.parametrize("damage", [None, pytest.param("garbage", marks=pytest.mark.slow)])
def test_a_full_disk_costs_the_cache_alone(tmp_path, damage):
    (tmp_path / "caller.py").write_text(CALLEE.format(shift=1.0) + "print(inner(1.0))\n")
    command = [sys.executable, "caller.py"]
    if damage:
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        (index,) = tmp_path.rglob("*.nbi")
        index.write_bytes(DAMAGES[damage](b""))
    full = ["sh", "-c", 'ulimit -f 0; exec "$0" "$@"', *command]
    out = subprocess.run(
        full, cwd=tmp_path, capture_output=True, text=True, check=True, env={**uncovered(), **WITHOUT_PYC}
    )
    assert (out.stdout, out.stderr) == ("2.0\n", "")


def test_compiling_is_announced_once(tmp_path, monkeypatch):
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    told = []
    announce_compiling(lambda: told.append("now"))

    @kernel
    def twice(x):
        return 2 * x

    @kernel
    def thrice(x):
        return 3 * x

    assert (twice(2), thrice(2)) == (4, 6)
    assert told == ["now"]
