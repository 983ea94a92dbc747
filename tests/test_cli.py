"""The command as a user runs it."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

import bayeq as bq
from bayeq.cli.app import main
from bayeq.cli.terminal import COMPILING, PROGRESS
from bayeq.errors import DataWarning
from tests.uncovered import uncovered


@pytest.fixture(scope="module")
def duffing(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "duffing.csv"
    assert main(["simulate", "duffing", "-o", str(path), "--seed", "1"]) == 0
    return path


OSCILLATOR = ["--disp", "x", "--vel", "v", "--acc", "a", "--force", "u"]
# A tenth of the time, where it is not of the states that a test speaks.
AS_MEASURED = [*OSCILLATOR, "--smooth", "none"]


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_simulate_then_discover_as_json(duffing, capsys):
    assert main(["discover", str(duffing), *AS_MEASURED, "--json"]) == 0
    printed, said = capsys.readouterr()
    out = json.loads(printed)
    assert out["version"] == bq.__version__
    assert out["method"] == "auto"
    assert out["data"]["file"] == "duffing.csv"
    assert out["data"]["n"] == 4000
    (equation,) = out["equations"]
    assert equation["target"] == "a"
    assert {t["name"] for t in equation["terms"] if t["included"]} == {"x", "v", "x**3", "u"}
    assert all(line == COMPILING or line.startswith(("bayeq: warning: ", PROGRESS)) for line in said.splitlines())


@pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")
def test_the_installed_command_is_that_of_the_module(duffing, capsys):
    command = Path(sys.executable).parent / "bayeq"
    done = subprocess.run([command, "discover", duffing, *AS_MEASURED], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert main(["discover", str(duffing), *AS_MEASURED]) == 0
    assert done.stdout == capsys.readouterr().out
    assert "\na = " in done.stdout
    assert "\x1b" not in done.stdout


def test_all_of_the_paper_s_systems_through_the_command(tmp_path, capsys):
    # a sample of the 100 seeds that the Python tests run: the command gives the same answers
    for system in ("linear", "duffing"):
        path = tmp_path / f"{system}.csv"
        assert main(["simulate", system, "-o", str(path), "--seed", "0", "--n", "1500"]) == 0
        capsys.readouterr()
        assert main(["discover", str(path), *AS_MEASURED, "--json"]) == 0
        found = {t["name"] for t in json.loads(capsys.readouterr().out)["equations"][0]["terms"] if t["included"]}
        record = bq.simulate(system, seed=0, n=1500)
        direct = bq.discover(record, displacement="x", velocity="v", acceleration="a", force="u", smooth="none")
        assert found == set(direct[0].included)


pytestmark = pytest.mark.filterwarnings("ignore::bayeq.errors.BayeqWarning")


def test_chains_inputs_and_dictionary_file(tmp_path, capsys):
    terms = tmp_path / "terms.txt"
    terms.write_text("x\nv\nx**3\nu\n")
    path = tmp_path / "run.csv"
    main(["simulate", "duffing", "-o", str(path)])
    capsys.readouterr()
    given = ["--chain", "x:v:a", "--input", "u", "--dictionary", str(terms), "--smooth", "none"]
    assert main(["discover", str(path), *given, "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [t["name"] for t in out["equations"][0]["terms"]] == ["x", "v", "x**3", "u"]


def test_first_order_system(tmp_path, capsys):
    path = tmp_path / "lorenz.npz"
    main(["simulate", "lorenz", "-o", str(path), "--noise", "0"])
    capsys.readouterr()
    arguments = ["--chain", "x", "--chain", "y", "--chain", "z", "--dictionary", "polynomial:2", "--json"]
    assert main(["discover", str(path), *arguments]) == 0
    out = json.loads(capsys.readouterr().out)
    assert [e["target"] for e in out["equations"]] == ["dx", "dy", "dz"]
    assert all(len(e["terms"]) == 9 for e in out["equations"])


def test_trials_within_a_file_and_several_files(tmp_path, capsys):
    a, b = (bq.simulate("linear", n=500, seed=seed) for seed in (0, 1))
    both = tmp_path / "both.csv"
    rows = ["run,t,x,v,a,u"]
    for k, rec in enumerate((a, b)):
        columns = [np.full(500, k), rec.time, *(rec[c] for c in "xvau")]
        rows += [",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
    both.write_text("\n".join(rows) + "\n")
    bq.write(a, tmp_path / "a.parquet")
    bq.write(b, tmp_path / "b.npz")
    assert main(["discover", str(both), "--group", "run", *AS_MEASURED, "--json"]) == 0
    grouped = json.loads(capsys.readouterr().out)
    assert main(["discover", str(tmp_path / "a.parquet"), str(tmp_path / "b.npz"), *AS_MEASURED, "--json"]) == 0
    separate = json.loads(capsys.readouterr().out)
    for equation in (*grouped["equations"], *separate["equations"]):
        for term in equation["terms"]:
            term.pop("unit", None)  # a CSV file states none
    assert grouped["equations"] == separate["equations"]
    assert grouped["data"]["n"] == 1000


def test_save_and_load(duffing, tmp_path, capsys):
    path = tmp_path / "eq.json"
    assert main(["discover", str(duffing), *AS_MEASURED, "--save", str(path)]) == 0
    assert bq.load(path)[0].included == ("x", "v", "x**3", "u")
    capsys.readouterr()


def test_simulate_is_reproducible_and_systems_are_listed(tmp_path, capsys):
    paths = [tmp_path / f"{k}.csv" for k in range(3)]
    for path, seed in zip(paths, (4, 4, 5), strict=True):
        assert main(["simulate", "coulomb", "-o", str(path), "--seed", str(seed), "--n", "50"]) == 0
    assert paths[0].read_bytes() == paths[1].read_bytes() != paths[2].read_bytes()
    assert capsys.readouterr().out == ""
    assert main(["systems"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in bq.SYSTEMS)
    assert main(["systems", "--json"]) == 0
    assert [s["name"] for s in json.loads(capsys.readouterr().out)["systems"]] == list(bq.SYSTEMS)


def test_version_and_help(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == bq.__version__
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert "discover" in text
    assert "study" in text


def test_colour_on_a_terminal_only(duffing):
    leader, follower = pty.openpty()
    done = subprocess.Popen(
        [sys.executable, "-m", "bayeq", "discover", str(duffing), *AS_MEASURED, "--dictionary", "x, v, x**3, u"],
        stdout=follower, stderr=subprocess.PIPE, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    os.close(follower)
    shown = b""
    while True:
        try:
            chunk = os.read(leader, 4096)
        except OSError:  # the other end has closed: how a pseudo-terminal says end of file on Linux
            break
        if not chunk:
            break
        shown += chunk
    done.communicate()
    os.close(leader)
    assert done.returncode == 0
    assert b"\x1b[1m" in shown


def test_compiling_is_announced_in_a_pipe_too(duffing, tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "bayeq", "discover", str(duffing), *OSCILLATOR],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )  # fmt: skip
    said = next(line for line in process.stderr if not line.startswith(PROGRESS))
    assert said == f"{COMPILING}\n"
    process.kill()  # the rest takes a minute
    process.communicate()


BESIDE = """
import bayeq as bq
from bayeq.cli.beside import main
from bayeq.inference.collapsed.listing import _search
from bayeq.inference.collapsed.search import explore
from bayeq.inference.vb import _best_ascent
from bayeq.numerics.rk4 import free_runs, shoot

record = bq.simulate("duffing", n=600, seed=1)
main()
kernels = (explore, _search, _best_ascent, free_runs, shoot)
before = [list(kernel.signatures) for kernel in kernels]
bq.discover(record, chains="x:v:a", inputs=["u"])
print(all(before), before == [list(kernel.signatures) for kernel in kernels])
"""


def test_the_process_beside_compiles_what_a_discovery_needs():
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", BESIDE], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True"]


def test_an_interrupt_is_one_line_and_leaves_no_half_file(tmp_path):
    target = tmp_path / "big.csv"
    target.write_text("what was there before")
    bq.simulate("duffing", n=50)  # compiled before the clock runs
    process = subprocess.Popen(
        [sys.executable, "-m", "bayeq", "simulate", "duffing", "--n", "600000", "-o", str(target)],
        stderr=subprocess.PIPE, text=True,
        env=uncovered(),
        # tests that run in the background inherit that interrupts are ignored
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not list(tmp_path.glob(".big.*")):
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    try:
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert err == "bayeq: interrupted\n"
    assert target.read_text() == "what was there before"
    assert list(tmp_path.iterdir()) == [target]


def test_inputs_are_not_overwritten_nor_counted_twice(duffing, tmp_path, capsys):
    assert main(["discover", str(duffing), *OSCILLATOR, "--save", str(duffing)]) == 2
    assert "is a file that is read" in capsys.readouterr().err
    assert main(["discover", str(duffing), str(duffing), *OSCILLATOR]) == 2
    assert "named twice" in capsys.readouterr().err
    assert main(["discover", str(duffing), *OSCILLATOR, "--fs", "500"]) == 2
    assert "contradicts column 't'" in capsys.readouterr().err
    assert main(["discover", str(duffing), *OSCILLATOR, "--seed", "-1", "--method", "gibbs"]) == 2
    assert "a seed is a whole number" in capsys.readouterr().err
    assert main(["discover", str(duffing), *OSCILLATOR, "--holdout", "0.9999"]) == 2
    assert "too few" in capsys.readouterr().err


def test_a_second_clock_among_the_channels_is_no_contradiction(tmp_path, capsys):
    record = bq.simulate("linear", n=400, seed=0)
    path = tmp_path / "clocks.csv"
    rows = zip(record.time, 1000 * record.time, *(record[c] for c in "xvau"), strict=True)
    path.write_text("\n".join(["t,time,x,v,a,u", *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
    assert main(["discover", str(path), *AS_MEASURED, "--json"]) == 0
    capsys.readouterr()


def test_channels_by_their_headers(tmp_path, capsys):
    record = bq.simulate("linear", n=400, seed=0)
    path = tmp_path / "odd.csv"
    rows = zip(record.time, *(record[c] for c in "xvau"), strict=True)
    lines = ['t,Displ. (m),"Vel, ""rel""",Acc-1,F#1', *(",".join(map(repr, map(float, row))) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    arguments = ["--disp", "Displ. (m)", "--vel", 'Vel, "rel"', "--acc", "Acc-1", "--force", "F#1", "--json"]
    assert main(["discover", str(path), *arguments, "--smooth", "none"]) == 0
    assert json.loads(capsys.readouterr().out)["equations"][0]["target"] == "Acc_1"


def test_no_warning_of_numpy_s_own_is_printed(capsys):
    main(["systems"])
    capsys.readouterr()
    warnings.showwarning("overflow encountered in square", RuntimeWarning, "a.py", 1)
    warnings.showwarning("few rows", DataWarning, "a.py", 1)
    assert capsys.readouterr().err == "bayeq: warning: few rows\n"
